"""Adaptive panels: intervals are split until 17 Chebyshev nodes resolve a function on
each of them."""

import functools
import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.polynomial import chebyshev

from eqsim.numerics.tables import Array

_HALVES = np.array([0.0, 0.5, 1.0])


class Chebyshev(NamedTuple):
    """The rule of Clenshaw and Curtis on [-1, 1], whose nodes hold both ends; n = order
    + 1."""

    nodes: Array  # (n,)
    weights: Array  # (n,)
    cumulative: Array  # (n, n); values at the nodes times it: integrals from -1 to each
    coefficients: Array  # (n, n); it times values: their Chebyshev coefficients
    tail: Array  # (n, 2); values times it: the two highest ones, 0 if resolved


# A rule takes 0.25 ms, and a solve of 20 ms asks for twenty, of two orders.
@functools.lru_cache(maxsize=8)
def clenshaw_curtis(order: int) -> Chebyshev:
    """The rule with order + 1 nodes."""
    nodes = -np.cos(math.pi * np.arange(order + 1) / order)
    coefficients = np.linalg.inv(chebyshev.chebvander(nodes, order))
    cumulative = chebyshev.chebval(nodes, chebyshev.chebint(coefficients, lbnd=-1))
    tail = coefficients[-2:].T
    return Chebyshev(nodes, cumulative[:, -1], cumulative, coefficients, tail)


ClenshawCurtis = clenshaw_curtis(16)


class Panels(NamedTuple):
    """Pieces of one or several intervals, in order, arrays (panels,)."""

    left: Array
    right: Array
    interval: Array  # number of the interval that each is a piece of
    values: Array  # of `evaluate`, (..., panels)


def refined(
    evaluate: Callable[[Array, Array, Array], Array],
    judge: Callable[[Panels], tuple[Array, Any]],
    edges: Array,
    *,
    intervals: int = 1,
    pieces: Array = _HALVES,
    pieces_at_0: Array | None = None,
    most: float = math.inf,
) -> tuple[Panels, Any]:
    """Split panels until none is too rough, or there are more than `most`. `evaluate`
    goes from `left`, `right` and `interval` of some panels to their `values`, shape
    (..., panels); `judge` from all panels to which of them to split, shape (panels,),
    and anything else, which is returned in the end. `edges` are ends of the first
    panels, the same in each of the `intervals`. A panel is cut at `pieces`, from 0 to
    1, or at `pieces_at_0`, of the same shape, where it begins at 0."""
    interval, first = (part.ravel() for part in np.indices((intervals, edges.size - 1)))
    at = edges[first], edges[first + 1], interval
    p = Panels(*at, evaluate(*at))
    while True:
        split, verdict = judge(p)
        if not split.any() or p.left.size > most:
            return p, verdict
        left, right = p.left[split, None], p.right[split, None]
        first = pieces if pieces_at_0 is None else pieces_at_0
        cuts = left + (right - left) * np.where(left == 0, first, pieces)
        cuts[:, -1] = right[:, 0]
        interval = np.repeat(p.interval[split], pieces.size - 1)
        at = cuts[:, :-1].ravel(), cuts[:, 1:].ravel(), interval
        count = np.where(split, pieces.size - 1, 1)
        merged = [np.repeat(old, count, axis=-1) for old in p]
        for old, new in zip(merged, (*at, evaluate(*at)), strict=True):
            old[..., np.repeat(split, count)] = new
        p = Panels(*merged)
