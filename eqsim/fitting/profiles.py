"""Profile likelihood: chi-square over one parameter with all others at their best, and
the intervals it gives."""

import math
from bisect import insort
from typing import NamedTuple

import numpy as np

from eqsim.fitting.estimate import Minimum, minimise
from eqsim.fitting.model import Problem
from eqsim.numerics.tables import Array

# Chi-square over its least value at the ends of intervals (chi-square law, one degree
# of freedom).
LEVELS = {"68": 0.9889, "95": 3.8415}
# Half-width of a 68 % interval of a logarithm, a factor 3, beyond which a key is not
# determined.
WIDE = 1.1
# Rise of chi-square that a step aims at, and the most it may be.
_RISE_AIMED_AT = 1.5
_LARGEST_RISE = 6.0
# Points of a profile before its ends are sought.
_MOST_POINTS = 40
# Distance of a point from a level that is close enough, and how many are tried for it.
_CLOSE_RISE = 0.02
_TRIES_FOR_END = 8


class Side(NamedTuple):
    """A profile on one side of the best fit, the best fit first: all parameters, shape
    (points, parameters), and rise of chi-square, (points,); ends of the intervals by
    level in the variable, None where it reaches the bound first; and whether a point
    fits better than the best fit."""

    points: Array
    rise: Array
    ends: dict[str, float | None]
    better: bool


class _Point(NamedTuple):
    """A point of a profile: distance of the parameter from its best value, rise of
    chi-square, and all parameters."""

    distance: float
    rise: float
    u: Array


class _Profile:
    """Points of a profile, ordered by distance, and how to solve for more."""

    def __init__(self, problem: Problem, best: Minimum, index: int, sign: int) -> None:
        self.problem, self.best, self.index, self.sign = problem, best, index, sign
        self.bound = problem.high[index] if sign > 0 else problem.low[index]
        self.length = abs(self.bound - best.u[index])
        self.points = [_Point(0.0, 0.0, best.u)]

    def solve(self, distance: float) -> _Point:
        """Minimise at a distance, from a guess along the line through the two nearest
        points; where that leads astray also from the nearest one."""
        near, *others = sorted(self.points, key=lambda p: abs(p.distance - distance))
        guess = near.u
        if others and abs(near.distance - others[0].distance) > 1e-12:
            other = others[0]
            t = (distance - near.distance) / (other.distance - near.distance)
            guess = near.u + (other.u - near.u) * min(max(t, -2.0), 2.0)
        reached = self._minimum(guess, distance)
        astray = reached.chi2 - self.best.chi2 > near.rise + _LARGEST_RISE
        if others and (astray or not reached.converged):
            plain = self._minimum(near.u, distance)
            reached = min(reached, plain, key=lambda one: one.chi2)
        return _Point(distance, reached.chi2 - self.best.chi2, reached.u)

    def _minimum(self, guess: Array, distance: float) -> Minimum:
        u = np.clip(guess, self.problem.low, self.problem.high)
        inside = self.best.u[self.index] + self.sign * distance
        u[self.index] = inside if distance < self.length else self.bound
        return minimise(self.problem, u, self.index)

    def follow(self, step: float) -> None:
        """Add points until chi-square has risen above all levels, the bound is reached
        or a better fit is found."""
        while len(self.points) < _MOST_POINTS:
            here = self.points[-1]
            new = self.solve(min(here.distance + step, self.length))
            for _ in range(6):
                gone = new.distance - here.distance
                if new.rise - here.rise <= _LARGEST_RISE or gone < 1e-6 * self.length:
                    break
                new = self.solve(here.distance + 0.4 * gone)
            self.points.append(new)
            if new.rise > max(LEVELS.values()) or new.rise < -_CLOSE_RISE:
                break
            if new.distance >= self.length:
                break
            gained = max(new.rise - here.rise, 1e-3)
            factor = min(max(math.sqrt(_RISE_AIMED_AT / gained), 0.5), 2.5)
            step = (new.distance - here.distance) * factor

    def end(self, level: float) -> float | None:
        """The variable where the profile first passes a level, by a straight line of
        its root between points close to it; None if no point is above."""
        for tries in range(_TRIES_FOR_END + 1):
            rises = [point.rise for point in self.points]
            above = next((k for k, rise in enumerate(rises) if rise >= level), 0)
            if above == 0:
                return None
            low, high = self.points[above - 1 : above + 1]
            roots = [math.sqrt(max(point.rise, 0.0)) for point in (low, high)]
            t = (math.sqrt(level) - roots[0]) / (roots[1] - roots[0])
            width = high.distance - low.distance
            distance = low.distance + t * width
            close = min(abs(low.rise - level), abs(high.rise - level)) < _CLOSE_RISE
            if tries == _TRIES_FOR_END or close or width < 1e-6 * self.length:
                break
            insort(self.points, self.solve(distance), key=lambda p: p.distance)
        return float(self.best.u[self.index] + self.sign * distance)


def side(problem: Problem, best: Minimum, index: int, sign: int, sd: float) -> Side:
    """Follow the profile of a parameter up (`sign` 1) or down (-1), to the bound or until
    chi-square has risen enough. The first step is about the standard deviation `sd`."""
    profile = _Profile(problem, best, index, sign)
    length = profile.length
    if length > 0:
        step = max(sd if math.isfinite(sd) else length, 1e-6 * max(length, 1e-12))
        profile.follow(min(step, 0.25 * length))
    ends = {name: profile.end(level) for name, level in LEVELS.items()}
    rise = np.array([point.rise for point in profile.points])
    points = np.array([point.u for point in profile.points])
    return Side(points, rise, ends, bool(np.any(rise < -_CLOSE_RISE)))


def status(low: Side, high: Side, transform: str) -> str:
    """Status of a key: "determined" if the 95 % interval is closed, and that of 68 % of
    a logarithm spans a factor 9 at most; "one-sided" if only one end of the 95 %
    interval is known; else "degenerate"."""
    closed = [one.ends["95"] is not None for one in (low, high)]
    if not all(closed):
        return "one-sided" if any(closed) else "degenerate"
    width = abs((high.ends["68"] or 0.0) - (low.ends["68"] or 0.0))
    wide = transform != "linear" and width > 2.0 * WIDE
    return "degenerate" if wide else "determined"
