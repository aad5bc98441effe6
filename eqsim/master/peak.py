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
from eqsim.master.transient import Transient, transient
from eqsim.model.drive import Drive
from eqsim.model.ensemble import Ensemble
from eqsim.numerics.tables import Array

WINDOW = 4.0  # the peak is sought over so many rms thresholds
# Points of the mean within the window, and up to a peak next to a kink of the law of
# thresholds.
_POINTS = 401
_CLOSER = 4001
# Points by which a fall of discrete thresholds is uncertain to its left, in
# `Transient.force_error`.
_BEFORE_FALL = 4
# Peaks whose relative difference is smaller are alike.
_ALIKE = 1e-3
# Curvature of a flank over that of the peak.
_STRAIGHT = 1e-2


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
    if bends.min() < _STRAIGHT * bends.max():
        return float(X[top]), float(middle)
    bend = min(low - 2.0 * middle + high, -1e-300)
    shift = min(max(0.5 * (low - high) / bend, -1.0), 1.0)
    return float(X[top] + shift * (X[1] - X[0])), float(
        middle - 0.25 * (low - high) * shift
    )


def tip(ensemble: Ensemble, X: Array, force: Array, top: int) -> tuple[float, float]:
    """How far a peak may be from a grid point, and its height from the force there,
    arrays (points,), where thresholds have steps: the force then has a kink at each,
    between two points. 0 of other laws, whose peaks are round."""
    if not ensemble.thresholds.steps.size:
        return 0.0, 0.0
    return float(X[top] - X[top - 1]), float(max(force[top] - force[top - 1], 0.0))


def first_peak(ensemble: Ensemble, velocity: float) -> Peak:
    """The exact static peak at a constant velocity, from the renewal equation over four
    rms thresholds.

    Parameters
    ----------
    ensemble : Ensemble
    velocity : float

    Returns
    -------
    Peak
        With errors that bound those of the solver.

    Raises
    ------
    InputError
        Where `eqsim.transient` does, and where the force rises without a peak.
    """
    period = ensemble.thresholds.rms
    found = transient(ensemble, Drive(velocity, WINDOW * period), _POINTS)
    top = _sure_top(found, period)
    cell = float(found.X[1])
    kinks = ensemble.thresholds.kinks
    if not ensemble.thresholds.steps.size and np.any(
        np.abs(kinks - found.X[top]) < 2.0 * cell
    ):
        # a force that turns at a kink has no vertex: look closer
        found = transient(
            ensemble, Drive(velocity, float(found.X[top]) + 2.0 * cell), _CLOSER
        )
        top, cell = int(np.argmax(found.force)), float(found.X[1])
        place, height = float(found.X[top]), float(found.force[top])
        beside, missed = (
            cell,
            float(max(np.abs(np.diff(found.force[top - 1 : top + 2])).max(), 0.0)),
        )
    else:
        place, height = vertex(found.X, found.force, top)
        beside, missed = tip(ensemble, found.X, found.force, top)
    # next to a fall the mean is uncertain by all of it; before it the peak is as
    # certain as `missed` says
    error = (
        float(found.force_error[max(top - _BEFORE_FALL, 0) : top + 1].min()) + missed
    )
    return Peak(Estimate(place, max(beside, 0.1 * cell), 0), Estimate(height, error, 0))


def _sure_top(course: Transient, period: float) -> int:
    """The index of the first maximum. Raises InputError if the force does not fall
    after it."""
    error = np.minimum(course.force_error, _ALIKE * course.force.max())
    top = top_of(course.X, course.force, error, period)
    if (
        not 0 < top < course.X.size - 1
        or course.force[top] - course.force[top:].min() <= error[top]
    ):
        raise InputError("the force rises without a first peak")
    return top
