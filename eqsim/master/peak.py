"""The static peak: the first maximum of the force after a fresh start, while contacts
are still in step.

Runs, fits and the exact mean use this definition: of the maxima within four rms
thresholds that cannot be told from the highest one, the first; within half an rms
threshold of it the highest point. It is not the largest force of a run, which later
teeth of contacts in step may exceed by rounding, or by chance.
"""

from typing import NamedTuple

import numpy as np

from eqsim.errors import InputError
from eqsim.estimate import Estimate
from eqsim.master.transient import transient
from eqsim.model.drive import Drive
from eqsim.model.ensemble import Ensemble
from eqsim.numerics.tables import Array

# The peak is sought over so many rms thresholds.
PEAK_WINDOW = 4.0
# Points of the mean within the window, and up to a peak next to a kink of the law of
# thresholds.
_POINTS_OF_PEAK = 401
_POINTS_AT_KINK = 4001
# Points by which a fall of discrete thresholds is uncertain to its left, in
# `Transient.force_error`.
_BEFORE_FALL = 4
# Peaks whose relative difference is smaller are alike.
_ALIKE = 1e-3
# Curvature of a flank over that of the peak.
_STRAIGHT_FLANK = 1e-2


class Peak(NamedTuple):
    """The static peak: where it is, X, and the force <F>/(N k) there (lengths), each
    with its error; without values where there is none."""

    X: Estimate
    force: Estimate


def top_of(X: Array, force: Array, error: Array, period: float) -> int:
    """The index of the first maximum, arrays (points,): of those that are as high
    within errors, such as all teeth of contacts that stay in step, the highest within
    half a `period` of the first. The last index if it still rises."""
    highest = int(np.argmax(force))
    first = int(np.argmax(force + error >= force[highest] - error[highest]))
    top = int(np.argmax(np.where(X[first] + 0.5 * period >= X, force, -np.inf)))
    while top + 1 < force.size and force[top + 1] > force[top]:
        top += 1
    return top


def vertex(X: Array, force: Array, top: int) -> tuple[float, float]:
    """Place and height of the parabola through three neighbouring points, arrays
    (points,); the point itself where it is the tip of a straight flank, as of contacts
    that all break at once."""
    low, middle, high = force[top - 1 : top + 2]
    bends = np.abs(np.diff(force[max(top - 2, 0) : top + 3], 2))
    if bends.min() < _STRAIGHT_FLANK * bends.max():
        return float(X[top]), float(middle)
    bend = min(low - 2.0 * middle + high, -1e-300)
    shift = min(max(0.5 * (low - high) / bend, -1.0), 1.0)
    place = X[top] + shift * (X[1] - X[0])
    return float(place), float(middle - 0.25 * (low - high) * shift)


def tip(ensemble: Ensemble, X: Array, force: Array, top: int) -> tuple[float, float]:
    """How far a peak may be from a grid point, and its height from the force there,
    arrays (points,), where thresholds have steps: the force then has a kink at each,
    between two points. 0 of other laws, whose peaks are round."""
    if not ensemble.thresholds.steps.size:
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
        # a force that turns at a kink has no vertex: look closer
        near = Drive(velocity, float(X[top] + 2.0 * X[1]))
        exact = transient(ensemble, near, _POINTS_AT_KINK)
        X, force, top = exact.X, exact.force, int(np.argmax(exact.force))
        place, height, beside = float(X[top]), float(force[top]), float(X[1])
        missed = float(np.abs(np.diff(force[top - 1 : top + 2])).max())
    else:
        place, height = vertex(X, force, top)
        beside, missed = tip(ensemble, X, force, top)
    # next to a fall the mean is uncertain by all of it; before it the peak is as
    # certain as `missed` says
    before = exact.force_error[max(top - _BEFORE_FALL, 0) : top + 1]
    error = float(before.min()) + missed
    beside = max(beside, 0.1 * float(X[1]))
    return Peak(Estimate(place, beside, 0), Estimate(height, error, 0))
