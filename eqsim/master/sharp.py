"""Instants along a drive at which many contacts are born, or begin to break, at once.

A singularity of the births at an instant s and one of the density of thresholds at xi
make one of the breaks when contacts born at s are stretched by xi, and with it one of
the births (derived). Its order tells how sharp it is: -1 is an atom, -1/2 an integrable
infinity, 0 a jump, 1 a kink. Of orders a and b comes one of order a + b + 1. A grid of
steps that end at these instants is of second order although the density is not smooth.
"""

import heapq
import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from eqsim.laws.threshold import ThresholdLaw
from eqsim.numerics.roots import bisected
from eqsim.numerics.tables import Array

# The order above which steps need not end at a singularity.
SMOOTH = 2.0
# The share of contacts at a singularity that steps end at.
LIGHTEST = 1e-5
# Instants that are followed.
MOST_INSTANTS = 256
# Samples of a segment, where thresholds grow.
SAMPLES = 64
BISECTIONS = 45
# Distances over a threshold: where the density is infinite it is larger at NEAR than at
# FAR, by a factor over STEEP.
NEAR = 1e-12
FAR = 1e-9
STEEP = 3.0


class Levels(NamedTuple):
    """Singularities of a law of thresholds: places in units of its scale, orders,
    shares of contacts, arrays (n,)."""

    xi: Array
    order: Array
    share: Array


class Corners(NamedTuple):
    """The course of the slider: times and displacements of ends of segments, from 0 on,
    arrays (corners,)."""

    t: Array
    X: Array


class Sharp(NamedTuple):
    """An instant, the order of what is born then and its share of the contacts; ordered
    by importance."""

    order: float
    lightness: float
    t: float


def levels_of(law: ThresholdLaw) -> Levels:
    """`Levels` of a law; the share that a kink or jump counts as is that of a tenth of
    the law."""
    xi = law.kinks
    if law.steps.size:
        _, counts = np.unique(law.steps, return_counts=True)
        return Levels(xi / law.scale, np.full(xi.size, -1.0), counts / counts.sum())
    with np.errstate(all="ignore"):
        near, far = (
            np.fmax(law.pdf(xi * (1.0 - gap)), law.pdf(xi * (1.0 + gap)))
            for gap in (NEAR, FAR)
        )
    return Levels(
        xi / law.scale, np.where(near > STEEP * far, -0.5, 0.0), np.full(xi.size, 0.1)
    )


def passages(
    corners: Corners, t: float, xi: Array, growth: Callable[[Array], Array] | None
) -> Array:
    """Times when contacts born at an instant are first stretched by thresholds, ascending,
    that are xi at birth and grow by `growth` with age; infinite if never."""
    after = corners.t > t
    times = np.append(t, corners.t[after])
    if growth is not None:
        parts = np.diff(times)[:, None] * np.arange(SAMPLES) / SAMPLES
        times = np.append((times[:-1, None] + parts).ravel(), times[-1])
    here = np.interp(t, corners.t, corners.X)

    def reached(times: Array) -> Array:
        x = np.abs(np.interp(times, corners.t, corners.X) - here)
        return x if growth is None else x / growth(times - t)

    greatest = np.maximum.accumulate(reached(times))
    last = np.searchsorted(greatest, xi * (1.0 - 1e-14))
    there = (last < times.size) & (last > 0)
    found = np.full(xi.size, math.inf)
    low, high, level = times[last[there] - 1], times[last[there]], xi[there]
    if (
        growth is None
    ):  # on straight pieces |x| grows up to the level at their ends only
        X0, X1 = (np.interp(end, corners.t, corners.X) for end in (low, high))
        share = (here + np.copysign(level, X1 - here) - X0) / (X1 - X0)
        found[there] = low + (high - low) * np.clip(share, 0.0, 1.0)
        return found

    def early(times: Array) -> Array:
        return np.asarray(reached(times) < level)

    found[there] = bisected(early, low, high, BISECTIONS)[1]
    return found


def _again(corners: Corners, X: float, since: int) -> float:
    """The time when the slider passes X again after a corner."""
    side = np.sign(corners.X[since + 1 :] - X)
    moved = np.flatnonzero(side)
    if moved.size == 0:
        return math.inf
    back = np.flatnonzero(side[moved[0] :] != side[moved[0]])
    if back.size == 0:
        return math.inf
    j = since + 1 + moved[0] + back[0]
    share = (X - corners.X[j - 1]) / (corners.X[j] - corners.X[j - 1])
    return float(corners.t[j - 1] + share * (corners.t[j] - corners.t[j - 1]))


def _turns(corners: Corners) -> list[int]:
    """Corners at which the slider begins to move the other way."""
    moves = np.flatnonzero(np.diff(corners.X))
    direction = np.sign(np.diff(corners.X)[moves])
    return [int(j) for j in moves[1:][direction[1:] != direction[:-1]]]


def _resumed(corners: Corners, t: float) -> list[float]:
    """Times when contacts born at an instant, which have been less stretched since, are
    stretched more than ever."""
    after = np.flatnonzero(corners.t > t)
    here = np.interp(t, corners.t, corners.X)
    x = np.append(0.0, np.abs(corners.X[after] - here))
    greatest = np.maximum.accumulate(x)
    found = []
    for j in np.flatnonzero((np.diff(greatest) > 0.0) & (x[:-1] < greatest[:-1])):
        level = math.copysign(greatest[j], corners.X[after[j]] - here)
        X0 = corners.X[after[j - 1]]
        share = (here + level - X0) / (corners.X[after[j]] - X0)
        begin, end = corners.t[after[j - 1]], corners.t[after[j]]
        found.append(float(begin + share * (end - begin)))
    return found


def sharp_instants(
    corners: Corners,
    levels: Levels,
    growth: Callable[[Array], Array] | None,
    delay: float,
    spread: bool,
    fresh: bool,
    by_time: bool,
) -> list[Sharp]:
    """Find when many contacts are born or break at once.

    Parameters
    ----------
    corners : Corners
    levels : Levels
        Of the law of thresholds.
    growth : callable, optional
        By what factor thresholds have grown, at ages.
    delay : float
        The mean one; `spread` if they are not all the same.
    fresh : bool
        Whether all contacts are born at 0.
    by_time : bool
        Whether the births per displacement depend on the velocity.

    Returns
    -------
    list of Sharp
        The most important ones, of instants after 0 and before the end.
    """
    heap = [Sharp(-1.0, -1.0, 0.0)] if fresh else [Sharp(0.0, -0.5, 0.0)]
    turns = _turns(corners)
    for j in range(1, corners.t.size - 1) if by_time else turns:
        heap.append(Sharp(0.0, -0.5, float(corners.t[j])))
    for j in turns:
        heap.append(Sharp(0.0, -0.5, _again(corners, float(corners.X[j]), j)))
    heapq.heapify(heap)
    end = float(corners.t[-1])
    found: list[Sharp] = []
    ascending = np.argsort(levels.xi)
    while heap and len(found) < MOST_INSTANTS:
        birth = heapq.heappop(heap)
        if not birth.t < end or any(abs(birth.t - other.t) < 1e-13 for other in found):
            continue
        found.append(birth)
        if birth.order < 0.0 and growth is None:
            for t in _resumed(corners, birth.t):
                heapq.heappush(heap, Sharp(0.0, birth.lightness, t))
        xi = levels.xi[ascending]
        for i, t in zip(ascending, passages(corners, birth.t, xi, growth), strict=True):
            order = birth.order + levels.order[i] + 1.0
            lightness = birth.lightness * levels.share[i]
            if order > SMOOTH or not t < end or (order < 0.0 and -lightness < LIGHTEST):
                continue
            broken = Sharp(float(order), float(lightness), float(t))
            if delay and not spread:
                found.append(broken)
            if delay and spread:
                broken = broken._replace(order=broken.order + 1.0)
            elif delay:
                broken = broken._replace(t=broken.t + delay)
            heapq.heappush(heap, broken)
    return [instant for instant in found if instant.t > 0.0]
