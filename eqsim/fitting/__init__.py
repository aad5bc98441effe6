"""From measurements to parameters: what they decide, with intervals, and what they
cannot."""
