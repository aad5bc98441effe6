"""Profile likelihood: chi-square over one parameter with all others at their best, and
the intervals it gives."""

import math
from typing import NamedTuple

import numpy as np

from eqsim.fitting.estimate import Minimum, minimise
from eqsim.fitting.model import Problem
from eqsim.numerics.tables import Array

LEVELS = {
    "68": 0.9889,
    "95": 3.8415,
}  # of chi-square over its least value (chi-square law, one degree of freedom)
WIDE = 1.1  # half-width of a 68 % interval of a logarithm, a factor 3, from which on nothing is determined
# rise of chi-square aimed at, and allowed, in a step; steps; how close to a level it is
# known, and tries
_RISE, _LARGEST, _MOST, _CLOSE, _SOUGHT = 1.5, 6.0, 40, 0.02, 8


class Side(NamedTuple):
    """A profile on one side of the best fit, the best fit first: all parameters, shape
    (points, parameters), and rise of chi-square, (points,); ends of the intervals by
    level in the variable, None where it reaches the bound first."""

    points: Array
    rise: Array
    ends: dict[str, float | None]
    better: bool


def side(problem: Problem, best: Minimum, index: int, sign: int, sd: float) -> Side:
    """Follow a profile away from the best fit, to the bound or where chi-square has
    risen enough.

    Parameters
    ----------
    problem : Problem
    best : Minimum
    index : int
        Of the parameter.
    sign : int
        +1 or -1: to which side.
    sd : float
        About its standard deviation, for the first step.
    """
    bound = problem.high[index] if sign > 0 else problem.low[index]
    way = abs(bound - best.u[index])
    found: list[tuple[float, float, Array]] = [(0.0, 0.0, best.u)]

    def solve(distance: float) -> tuple[float, float, Array]:
        near = min(found, key=lambda one: abs(one[0] - distance))
        guess = near[2].copy()
        if len(found) > 1:  # along the line through the last two
            (a, _, first), (b, _, second) = sorted(
                found, key=lambda one: abs(one[0] - distance)
            )[:2]
            if abs(a - b) > 1e-12:
                guess = first + (second - first) * min(
                    max((distance - a) / (b - a), -2.0), 2.0
                )
        guess = np.clip(guess, problem.low, problem.high)
        guess[index] = best.u[index] + sign * distance if distance < way else bound
        reached = minimise(problem, guess, index)
        if len(found) > 1:
            plain = near[2].copy()
            plain[index] = guess[index]
            if reached.chi2 - best.chi2 > near[1] + _LARGEST or not reached.converged:
                other = minimise(problem, plain, index)
                reached = min(reached, other, key=lambda one: one.chi2)
        return distance, reached.chi2 - best.chi2, reached.u

    top = max(LEVELS.values())
    step = (
        min(max(sd if math.isfinite(sd) else way, 1e-6 * max(way, 1e-12)), 0.25 * way)
        if way > 0
        else 0.0
    )
    better = False
    while way > 0 and len(found) < _MOST:
        here = found[-1]
        distance = min(here[0] + step, way)
        new = solve(distance)
        for _ in range(6):
            if new[1] - here[1] <= _LARGEST or distance - here[0] < 1e-6 * way:
                break
            distance = here[0] + 0.4 * (distance - here[0])
            new = solve(distance)
        found.append(new)
        better |= new[1] < -_CLOSE
        if new[1] > top or distance >= way or better:
            break
        gained = max(new[1] - here[1], 1e-3)
        step = (distance - here[0]) * min(max(math.sqrt(_RISE / gained), 0.5), 2.5)
    ends: dict[str, float | None] = {}
    for name, level in LEVELS.items():
        for _ in range(_SOUGHT):
            crossing = _crossing(found, level)
            if crossing is None or crossing.known or crossing.width < 1e-6 * way:
                break
            found.append(solve(crossing.distance))
        crossing = _crossing(found, level)
        ends[name] = (
            None
            if crossing is None
            else float(best.u[index] + sign * crossing.distance)
        )
    ordered = sorted(found, key=lambda one: one[0])
    better |= any(one[1] < -_CLOSE for one in ordered)
    return Side(
        np.array([one[2] for one in ordered]),
        np.array([one[1] for one in ordered]),
        ends,
        better,
    )


class _Crossing(NamedTuple):
    """Where a profile first passes a level, by a straight line of its root, whether a
    point is close enough to it, and how far its neighbours are apart."""

    distance: float
    known: bool
    width: float


def _crossing(
    found: list[tuple[float, float, Array]], level: float
) -> _Crossing | None:
    """Of points (distance, rise, parameters) in any order; None if none is above."""
    ordered = sorted(found, key=lambda one: one[0])
    above = next((k for k, one in enumerate(ordered) if one[1] >= level), 0)
    if above == 0:
        return None
    low, high = ordered[above - 1], ordered[above]
    roots = [math.sqrt(max(one[1], 0.0)) for one in (low, high)]
    t = (math.sqrt(level) - roots[0]) / (roots[1] - roots[0])
    known = min(abs(low[1] - level), abs(high[1] - level)) < _CLOSE
    return _Crossing(low[0] + t * (high[0] - low[0]), known, high[0] - low[0])


def status(low: Side, high: Side, transform: str) -> str:
    """ "determined" if the 95 % interval is closed, and of a logarithm the 68 % one
    spans a factor 9 at most; "one-sided" if only one of its ends is known; else
    "degenerate"."""
    closed = [one.ends["95"] is not None for one in (low, high)]
    if not all(closed):
        return "one-sided" if any(closed) else "degenerate"
    width = abs((high.ends["68"] or 0.0) - (low.ends["68"] or 0.0))
    return (
        "degenerate" if transform != "linear" and width > 2.0 * WIDE else "determined"
    )
