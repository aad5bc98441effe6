"""Roots of functions of one variable, inside brackets that shrink."""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from eqsim.numerics.compiled import routine
from eqsim.numerics.tables import Array


class Bracket(NamedTuple):
    """Two points between which a function rises through 0."""

    low: float
    high: float


@routine(inline=True)
def narrowed(
    bracket: Bracket, x: float, excess: float, guess: float
) -> tuple[Bracket, float]:
    """Cut a bracket at x, where the function is `excess`, and say where to look next:
    at `guess`, or in the middle if that is outside or not a number. A kernel cannot
    pass a function to another one, so each loop is its own and takes this step."""
    bracket = Bracket(bracket.low, x) if excess >= 0.0 else Bracket(x, bracket.high)
    if not bracket.low <= guess <= bracket.high:
        guess = 0.5 * (bracket.low + bracket.high)
    return bracket, guess


@routine(inline=True)
def newton(
    bracket: Bracket, x: float, excess: float, slope: float
) -> tuple[Bracket, float]:
    """`narrowed` with the guess of Newton's method, from the slope at x."""
    guess = x - excess / slope if slope > 0.0 else math.nan
    return narrowed(bracket, x, excess, guess)


def bisected(
    below: Callable[[Array], Array], low: Array, high: Array, halvings: int
) -> tuple[Array, Array]:
    """Halve brackets, arrays of any shape; `below` says which points are below their
    roots."""
    for _ in range(halvings):
        middle = 0.5 * (low + high)
        under = below(middle)
        low, high = np.where(under, middle, low), np.where(under, high, middle)
    return low, high
