"""Comparison of contacts with the master equation over the parameter space: `points`,
the `scores` made there, and a `verdict`."""

from eqsim.validation.comparison import REASONS, columns
from eqsim.validation.points import law_text
from eqsim.validation.verdict import ALARM, Validation, left_out, validate

__all__ = [
    "ALARM",
    "REASONS",
    "Validation",
    "columns",
    "law_text",
    "left_out",
    "validate",
]
