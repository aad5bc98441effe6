"""Instants along a drive at which many contacts are born, or begin to break, at once.

A singularity of the births at an instant s and one of the density of thresholds at xi
make one of the breaks when contacts born at s are stretched by xi, and with it one of
the births (derived). Its order tells how sharp it is: -1 is an atom, -1/2 an integrable
infinity, 0 a jump, 1 a kink. Orders a and b make one of order a + b + 1. With steps
that end at these instants a grid is of second order although the density is not smooth.
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
# Most instants that are followed.
MOST_INSTANTS = 256
# Samples of a segment, where thresholds grow.
SAMPLES = 64
# Bisections of a passage between two samples.
BISECTIONS = 45
# Relative distance from a threshold where its density is compared with that at FAR.
NEAR = 1e-12
FAR = 1e-9
# Ratio of the densities at NEAR and FAR, above which the density is taken as infinite.
STEEP = 3.0


class Levels(NamedTuple):
    """Singularities of a law of thresholds: where they are, in units of its scale,
    orders, and shares of contacts, arrays (n,)."""

    xi: Array
    order: Array
    share: Array


class Corners(NamedTuple):
    """The course of the slider: times and displacements of ends of segments, from 0 on,
    arrays (corners,)."""

    t: Array
    X: Array


class Sharp(NamedTuple):
    """Singularity of births: order, minus the share of the contacts, and instant. The
    most important come first in ascending order."""

    order: float
    lightness: float
    t: float


def levels_of(law: ThresholdLaw) -> Levels:
    """Singularities of a law; a kink or jump counts as a tenth of the contacts."""
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
    """Times when contacts born at t are first stretched by thresholds, which are xi at
    birth, ascending, and grow by the factor `growth` of age; infinite if never."""
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
    passed = np.full(xi.size, math.inf)
    low, high, level = times[last[there] - 1], times[last[there]], xi[there]
    if growth is None:  # X is straight in between, and |x| is greatest at the end
        X0, X1 = (np.interp(end, corners.t, corners.X) for end in (low, high))
        share = (here + np.copysign(level, X1 - here) - X0) / (X1 - X0)
        passed[there] = low + (high - low) * np.clip(share, 0.0, 1.0)
        return passed

    def early(times: Array) -> Array:
        return np.asarray(reached(times) < level)

    passed[there] = bisected(early, low, high, BISECTIONS)[1]
    return passed


def _reaches(corners: Corners, X: float, j: int) -> float:
    """Time when the slider is at X on its way to corner j."""
    share = (X - corners.X[j - 1]) / (corners.X[j] - corners.X[j - 1])
    return float(corners.t[j - 1] + share * (corners.t[j] - corners.t[j - 1]))


def _again(corners: Corners, since: int) -> float:
    """Time when the slider passes corner `since` again; infinite if never."""
    X = float(corners.X[since])
    side = np.sign(corners.X[since + 1 :] - X)
    away = np.flatnonzero(side)
    back = np.flatnonzero(side[away[0] :] != side[away[0]]) if away.size else away
    return (
        _reaches(corners, X, since + 1 + away[0] + back[0]) if back.size else math.inf
    )


def _turns(corners: Corners) -> list[int]:
    """Corners at which the slider begins to move the other way."""
    moves = np.flatnonzero(np.diff(corners.X))
    direction = np.sign(np.diff(corners.X)[moves])
    return [int(j) for j in moves[1:][direction[1:] != direction[:-1]]]


def _resumed(corners: Corners, t: float) -> list[float]:
    """Times when contacts born at t, whose stretch has fallen, begin to be stretched
    more than before."""
    after = np.flatnonzero(corners.t > t)
    here = np.interp(t, corners.t, corners.X)
    way = corners.X[after] - here
    x = np.append(0.0, np.abs(way))
    greatest = np.maximum.accumulate(x)
    resumed = np.flatnonzero((np.diff(greatest) > 0.0) & (x[:-1] < greatest[:-1]))
    X = here + np.copysign(greatest[:-1], way)
    return [_reaches(corners, X[j], after[j]) for j in resumed]


def sharp_instants(
    corners: Corners,
    levels: Levels,
    growth: Callable[[Array], Array] | None,
    delay: float,
    spread: bool,
    fresh: bool,
    by_time: bool,
) -> list[Sharp]:
    """Find the instants at which many contacts are born or break at once, after 0 and
    before the end: the most important ones, for `levels` of thresholds that grow by a
    factor `growth` of their age, or not at all, and a mean `delay`. Delays differ if
    `spread`; all contacts are born at 0 if `fresh`; the births per displacement depend
    on the velocity if `by_time`."""
    heap = [Sharp(-1.0, -1.0, 0.0)] if fresh else [Sharp(0.0, -0.5, 0.0)]
    turns = _turns(corners)
    for j in range(1, corners.t.size - 1) if by_time else turns:
        heap.append(Sharp(0.0, -0.5, float(corners.t[j])))
    for j in turns:
        heap.append(Sharp(0.0, -0.5, _again(corners, j)))
    heapq.heapify(heap)
    end = float(corners.t[-1])
    instants: list[Sharp] = []
    ascending = np.argsort(levels.xi)
    while heap and len(instants) < MOST_INSTANTS:
        birth = heapq.heappop(heap)
        known = any(abs(birth.t - other.t) < 1e-13 for other in instants)
        if known or not birth.t < end:
            continue
        instants.append(birth)
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
                instants.append(broken)
            if delay and spread:
                broken = broken._replace(order=broken.order + 1.0)
            elif delay:
                broken = broken._replace(t=broken.t + delay)
            heapq.heappush(heap, broken)
    return [instant for instant in instants if instant.t > 0.0]
