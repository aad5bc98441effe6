"""Profile likelihood: chi-square over one parameter with all others at their best, and
the intervals it gives."""

import math
from bisect import insort
from typing import NamedTuple

import numpy as np

from eqsim.fitting.estimate import (
    Minimum,
    covariance,
    minimise,
    refine,
    searched,
)
from eqsim.fitting.model import Problem
from eqsim.numerics.tables import Array

# Chi-square over its least value at the ends of intervals (chi-square law, one degree
# of freedom).
LEVELS = {"68": 0.9889, "95": 3.8415}
# Half-width of a 68 % interval of a logarithm, a factor 3, beyond which a key is not
# determined.
WIDE = 1.1
# Status of a key that the data do not determine.
UNSURE = ("one-sided", "degenerate")
# Most that chi-square may rise in a step.
_LARGEST_RISE = 6.0
# Share of the root of a level by which a step goes beyond it, and a step over the last
# one.
_BEYOND = 0.02
_LONGER = (0.3, 4.0)
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
    chi-square, all parameters, and derivatives of residuals with respect to those that
    are searched."""

    distance: float
    rise: float
    u: Array
    slopes: Array


class _Profile:
    """Points of a profile, ordered by distance, and how to solve for more."""

    def __init__(
        self, problem: Problem, best: Minimum, index: int, sign: int, jacobian: Array
    ) -> None:
        self.problem, self.best, self.index, self.sign = problem, best, index, sign
        self.bound = problem.high[index] if sign > 0 else problem.low[index]
        self.length = abs(self.bound - best.u[index])
        slopes = -problem.unitless(jacobian)  # of residuals
        columns = slopes[:, searched(problem, index)]
        linear = problem.linear & (np.arange(best.u.size) != index)
        if linear.any():  # these follow the others
            base = slopes[:, linear]
            columns = columns - base @ np.linalg.lstsq(base, columns, rcond=None)[0]
        self.points = [_Point(0.0, 0.0, best.u, columns)]

    def solve(self, distance: float) -> _Point:
        """Minimise at a distance, from a guess along the line through the two nearest
        points; where that leads astray also from the nearest one."""
        near, *others = sorted(self.points, key=lambda p: abs(p.distance - distance))
        guess = near.u
        if others and abs(near.distance - others[0].distance) > 1e-12 * self.length:
            other = others[0]
            t = (distance - near.distance) / (other.distance - near.distance)
            guess = near.u + (other.u - near.u) * min(max(t, -2.0), 2.0)
        there = self._moved(guess, distance)
        reached, slopes = refine(self.problem, there, self.index, near.slopes)
        astray = reached.chi2 - self.best.chi2 > near.rise + _LARGEST_RISE
        if others and (astray or not reached.converged):
            there = self._moved(near.u, distance)
            plain = minimise(self.problem, there, self.index)
            reached = min(reached, plain, key=lambda one: one.chi2)
        rise = reached.chi2 - self.best.chi2
        return _Point(distance, rise, reached.u, slopes)

    def _moved(self, guess: Array, distance: float) -> Array:
        """A guess with the parameter at a distance from its best value."""
        u = np.clip(guess, self.problem.low, self.problem.high)
        inside = self.best.u[self.index] + self.sign * distance
        u[self.index] = inside if distance < self.length else self.bound
        return u

    def follow(self, step: float) -> None:
        """Add points, each a little beyond the next level as the last two tell, until
        chi-square has risen above all levels, the bound is reached or a better fit is
        found."""
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
            last, gone = math.sqrt(max(new.rise, 0.0)), new.distance - here.distance
            slope = (last - math.sqrt(max(here.rise, 0.0))) / gone
            levels = (1.0 + _BEYOND) * np.sqrt(list(LEVELS.values()))
            ahead = float(min(levels[levels > last])) - last
            least, most = (factor * gone for factor in _LONGER)
            step = min(max(ahead / slope, least), most) if slope > 0.0 else most

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


def side(
    problem: Problem, best: Minimum, index: int, sign: int, jacobian: Array
) -> Side:
    """Follow the profile of a parameter up (`sign` 1) or down (-1), to the bound or until
    chi-square has risen enough. The first step is about the standard deviation that
    the `jacobian` at the best fit gives."""
    profile = _Profile(problem, best, index, sign, jacobian)
    length, sd = profile.length, math.sqrt(covariance(jacobian)[index, index])
    if length > 0:
        step = max(sd if math.isfinite(sd) else length, 1e-6 * length)
        profile.follow(min(step, 0.25 * length))
    ends = {name: profile.end(level) for name, level in LEVELS.items()}
    rise = np.array([point.rise for point in profile.points])
    points = np.array([point.u for point in profile.points])
    return Side(points, rise, ends, bool(np.any(rise < -_CLOSE_RISE)))


def status(sides: list[Side], transform: str) -> str:
    """Status of a key by the two sides of its profile: "determined" if the 95 % interval
    is closed, and that of 68 % of a logarithm spans a factor 9 at most; "one-sided" if
    only one end of the 95 % interval is known; else "degenerate"."""
    closed = [side.ends["95"] is not None for side in sides]
    if not all(closed):
        return "one-sided" if any(closed) else "degenerate"
    low, high = (side.ends["68"] or 0.0 for side in sides)
    width = abs(high - low)
    wide = transform != "linear" and width > 2.0 * WIDE
    return "degenerate" if wide else "determined"
