"""The static peak: the first maximum of the force after a fresh start, while contacts
are still in step.

Runs, fits and the exact mean use this definition: the first of the maxima within four
rms thresholds that are as high as the highest one within errors; or the highest point
within half an rms threshold after it. It is not the largest force of a run, which may
be a later maximum of contacts in step, by rounding or by chance.
"""

import math
from typing import NamedTuple

import numpy as np

from eqsim.errors import InputError
from eqsim.estimate import Estimate
from eqsim.laws.no_thresholds import has_jumps
from eqsim.master.transient import transient
from eqsim.model.drive import Drive
from eqsim.model.ensemble import Ensemble
from eqsim.numerics.tables import Array

# Rms thresholds over which the peak is sought.
PEAK_WINDOW = 4.0
# Points of the mean within the window.
_POINTS_OF_PEAK = 401
# Points of the mean up to a peak next to a kink of the law of thresholds.
_POINTS_AT_KINK = 4001
# Points before a fall of the force, where discrete thresholds break, at which
# `Transient.force_error` contains the height of the fall.
_BEFORE_FALL = 4
# Relative difference below which peaks count as equally high.
_ALIKE = 1e-3
# Curvature of a flank over that of the peak, below which the flank is straight.
_STRAIGHT_FLANK = 1e-2


class Peak(NamedTuple):
    """The static peak: where it is, X, and the force <F>/(N k) there (lengths), each
    with its error; without values where there is none."""

    X: Estimate
    force: Estimate


def top_of(X: Array, force: Array, error: Array, period: float) -> int:
    """Index of the static peak in arrays (points,): the highest point within half a
    `period` after the first that is as high as the maximum within errors, as all maxima
    of contacts in step may be. The last index if the force still rises there."""
    highest = int(np.argmax(force))
    first = int(np.argmax(force + error >= force[highest] - error[highest]))
    top = int(np.argmax(np.where(X[first] + 0.5 * period >= X, force, -np.inf)))
    while top + 1 < force.size and force[top + 1] > force[top]:
        top += 1
    return top


def vertex(X: Array, force: Array, top: int) -> tuple[float, float]:
    """Place and height of the vertex of the parabola through point `top` and its
    neighbours, arrays (points,); the point itself where it is the tip of a straight
    flank, as of contacts that all break at once."""
    low, middle, high = force[top - 1 : top + 2]
    bends = np.abs(np.diff(force[max(top - 2, 0) : top + 3], 2))
    if bends.min() < _STRAIGHT_FLANK * bends.max():
        return float(X[top]), float(middle)
    bend = min(low - 2.0 * middle + high, -1e-300)
    shift = min(max(0.5 * (low - high) / bend, -1.0), 1.0)
    place = X[top] + shift * (X[1] - X[0])
    return float(place), float(middle - 0.25 * (low - high) * shift)


def tip(ensemble: Ensemble, X: Array, force: Array, top: int) -> tuple[float, float]:
    """Distances of a peak in X and in force from a grid point, at most, arrays
    (points,). With discrete thresholds the force has a kink at each, between two
    points. 0 for other laws, whose peaks are round."""
    if not has_jumps(ensemble.thresholds):
        return 0.0, 0.0
    return float(X[top] - X[top - 1]), float(max(force[top] - force[top - 1], 0.0))


def first_peak(ensemble: Ensemble, velocity: float) -> Peak:
    """The exact static peak at a constant velocity, from the renewal equation over four
    rms thresholds, with errors that bound those of the solver. Raises InputError where
    `eqsim.transient` does, and where the force rises without a peak."""
    law, period = ensemble.thresholds, ensemble.thresholds.rms
    exact = transient(ensemble, Drive(velocity, PEAK_WINDOW * period), _POINTS_OF_PEAK)
    X, force = exact.X, exact.force
    alike = np.minimum(exact.force_error, _ALIKE * force.max())
    top = top_of(X, force, alike, period)
    if not 0 < top < X.size - 1 or force[top] - force[top:].min() <= alike[top]:
        raise InputError("the force rises without a first peak")
    if not law.steps.size and np.any(np.abs(law.kinks - X[top]) < 2.0 * X[1]):
        # a force that turns at a kink has no vertex: use a finer grid
        near = Drive(velocity, float(X[top] + 2.0 * X[1]))
        exact = transient(ensemble, near, _POINTS_AT_KINK)
        X, force, top = exact.X, exact.force, int(np.argmax(exact.force))
        place, height, beside = float(X[top]), float(force[top]), float(X[1])
        missed = float(np.abs(np.diff(force[top - 1 : top + 2])).max())
    else:
        place, height = vertex(X, force, top)
        beside, missed = tip(ensemble, X, force, top)
        if not law.steps.size:  # error of a parabola (of interpolation; textbook)
            bent = np.abs(np.diff(force[max(top - 2, 0) : top + 3], 3)).max()
            missed = float(bent) / (9.0 * math.sqrt(3.0))
    # next to a fall the error of the mean is all of its height; that of the peak is the
    # error before the fall, and `missed`
    before = exact.force_error[max(top - _BEFORE_FALL, 0) : top + 1]
    error = float(before.min()) + missed
    beside = max(beside, 0.1 * float(X[1]))
    return Peak(Estimate(place, beside, 0), Estimate(height, error, 0))
