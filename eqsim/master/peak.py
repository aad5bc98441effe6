"""The static peak: the first maximum of the force after a fresh start, while contacts
are still in step.

Runs, fits and the exact mean use this definition: the first of the maxima within four
rms thresholds that are as high as the highest one within errors; or the highest point
within half an rms threshold after it. Of contacts without thresholds the mean travel of
a life is in the place of the rms threshold. The peak is not the largest force of a run,
which may be a later maximum of contacts in step, by rounding or by chance.
"""

import math
from typing import NamedTuple

import numpy as np

from eqsim.errors import InputError
from eqsim.estimate import Estimate, known
from eqsim.laws.no_thresholds import NoThresholds
from eqsim.master.programme import Transient
from eqsim.master.steady import reference
from eqsim.master.transient import transient
from eqsim.model.drive import Drive
from eqsim.model.ensemble import Ensemble
from eqsim.numerics.tables import Array

# Rms thresholds, or travels of a life, over which the peak is sought.
PEAK_WINDOW = 4.0
# Points of the mean within the window.
_POINTS_OF_PEAK = 401
# Points of the mean up to a peak that these do not resolve.
_POINTS_IF_NARROW = 4001
# Points before a peak below which the solver's own cells may be too long for it.
_FEW_POINTS = 20
# Points before a fall of the force, where discrete thresholds break, at which
# `Transient.force_error` contains the height of the fall.
_BEFORE_FALL = 4
# Relative difference below which peaks count as equally high.
_ALIKE = 1e-3
# Unevenness of a peak up to which it is round.
_ROUND = 0.3
# Unevenness from which on it is a tip, also of laws without kinks. That of two straight
# flanks is 1 or more.
_TIP = 0.8
# Error of the place of a round peak, in cells: of its parabola a sixth of that ratio,
# at most 0.05 (derived), the rest for the solver.
_CELLS_BESIDE = 0.1
# Share of the largest jump by which heights of two peaks may be wrong beside each
# other: that of a jump blurred by cells differs by 0.083 on two grids.
_BLURRED = 0.1


class Peak(NamedTuple):
    """The static peak: where it is, X, and the force <F>/(N k) there (lengths), each
    with its error; without values where there is none."""

    X: Estimate
    force: Estimate


def period_of(ensemble: Ensemble, velocity: float) -> float:
    """Displacement in which contacts in step break: the rms threshold, the final one of
    contacts that age at once, or the mean travel of a life without thresholds. Raises
    InputError where `reference` does."""
    law, aging = ensemble.thresholds, ensemble.aging
    if not isinstance(law, NoThresholds):
        return law.rms * (aging.final(law.scale) if aging.rate == math.inf else 1.0)
    return known(reference(ensemble, Drive(velocity)).travel)


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


def unevenness(force: Array, top: int) -> float:
    """Largest third difference around a peak at point `top` of an array (points,) over
    its second difference: small where a parabola has the shape of the peak, 1 or more
    of straight flanks that meet in a tip."""
    around = force[max(top - 2, 0) : top + 3]
    bend = 2.0 * force[top] - force[top - 1] - force[top + 1]
    thirds = np.abs(np.diff(around, 3))
    return float(thirds.max() / bend) if thirds.size and bend > 0.0 else math.inf


def vertex(X: Array, force: Array, top: int) -> tuple[float, float]:
    """Place and height of the vertex of the parabola through point `top` and its
    neighbours, arrays (points,); the point itself where it is a tip, as of contacts that
    all break at once."""
    low, middle, high = force[top - 1 : top + 2]
    if unevenness(force, top) >= _TIP:
        return float(X[top]), float(middle)
    bend = low - 2.0 * middle + high
    shift = min(max(0.5 * (low - high) / bend, -1.0), 1.0)
    place = X[top] + shift * (X[1] - X[0])
    return float(place), float(middle - 0.25 * (low - high) * shift)


class Missed(NamedTuple):
    """Largest distances, in X and in force, of a peak from its `vertex`; of a round
    peak only that in force."""

    X: float
    force: float


def missed_by(
    ensemble: Ensemble,
    period: float,
    X: Array,
    force: Array,
    top: int,
    unsure: float = 0.0,
) -> Missed:
    """Bound what `vertex` misses of the peak at point `top` of arrays (points,).

    Of a round peak it is the error of interpolation (textbook). Two flanks that meet
    between points do so above the higher one by less than the slope of either times a
    cell, and by less than half a third difference (derived; all of it is quoted). In the
    cell where they meet points differ by less than that, hence the cell beyond it
    counts, too. The peak may be any other maximum, up to half a `period` later, that is
    as high within this and an error `unsure` of the difference of two maxima.
    """
    thirds = np.abs(np.diff(force[max(top - 2, 0) : top + 3], 3)).max(initial=0.0)
    law, delay = ensemble.thresholds, ensemble.delay
    is_smooth = not law.kinks.size and (delay.law != "fixed" or not delay.time)
    if unevenness(force, top) < (_TIP if is_smooth else _ROUND):
        return Missed(0.0, float(thirds) / (9.0 * math.sqrt(3.0)))
    rises = np.diff(force, prepend=force[0], append=force[-1])
    unknown = float(np.ptp(force))
    before = np.maximum(rises[:-1], np.append(unknown, rises[:-2]))
    beyond = np.maximum(-rises[1:], np.append(-rises[2:], unknown))
    missed = np.minimum(before, beyond)
    is_rival = (rises[:-1] >= 0.0) & (rises[1:] <= 0.0)
    is_rival &= force + missed >= force[top] - unsure
    is_rival &= X[top] + 0.5 * period >= X
    apart = np.abs(X - X[top])[is_rival].max(initial=0.0)
    missed[top] = min(missed[top], thirds)
    return Missed(float(X[1] - X[0] + apart), float(missed[top]))


def first_peak(ensemble: Ensemble, velocity: float) -> Peak:
    """The exact static peak at a constant velocity, from the renewal equation over four
    rms thresholds, and again on finer cells up to a peak that these do not resolve,
    with errors that bound those of the solver. Raises InputError where
    `eqsim.transient` does, and where the force rises without a peak."""
    period = period_of(ensemble, velocity)
    exact = transient(ensemble, Drive(velocity, PEAK_WINDOW * period), _POINTS_OF_PEAK)
    X, force = exact.X, exact.force
    alike = np.minimum(exact.force_error, _ALIKE * force.max())
    top = top_of(X, force, alike, period)
    falls = 0 < top < X.size - 1 and force[top] - force[top:].min() > alike[top]
    beside = _CELLS_BESIDE * float(X[1])
    if falls and (top < _FEW_POINTS or unevenness(force, top) > _ROUND):
        distance = float(X[top] + 2.0 * X[1]) + _missed(ensemble, period, exact, top).X
        exact = transient(ensemble, Drive(velocity, distance), _POINTS_IF_NARROW)
        X, force = exact.X, exact.force
        top = int(np.argmax(force))
        falls = 0 < top < X.size - 1
        beside = float(X[1])  # as births are spread over cells
    if not falls:
        raise InputError("the force rises without a first peak")
    place, height = vertex(X, force, top)
    missed = _missed(ensemble, period, exact, top)
    error = _error_before(exact, top) + missed.force
    return Peak(Estimate(place, beside + missed.X, 0), Estimate(height, error, 0))


def _missed(ensemble: Ensemble, period: float, exact: Transient, top: int) -> Missed:
    """`missed_by` of exact means. Heights of two maxima are unsure by both their
    errors, or by what blurs the largest jump."""
    blurred = _BLURRED * float(np.abs(np.diff(exact.force)).max())
    unsure = min(2.0 * _error_before(exact, top), blurred)
    return missed_by(ensemble, period, exact.X, exact.force, top, unsure)


def _error_before(exact: Transient, top: int) -> float:
    """Error of the force at a peak, without what is missed between points. Next to a
    fall the error of the mean is all of its height; that of the peak is the error
    before it."""
    return float(exact.force_error[max(top - _BEFORE_FALL, 0) : top + 1].min())
