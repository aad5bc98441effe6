"""Fits of parameters to measurements: intervals, and what data cannot determine."""
