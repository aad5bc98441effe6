"""The static peak of a simulated run; `eqsim.master.peak` has that of the exact mean."""

import math

import numpy as np

from eqsim.engine.readings import Forces, extreme
from eqsim.engine.records import Trajectory
from eqsim.estimate import Estimate, known
from eqsim.laws.no_thresholds import has_jumps
from eqsim.master.peak import (
    PEAK_WINDOW,
    Missed,
    Peak,
    missed_by,
    period_of,
    top_of,
    vertex,
)
from eqsim.model.drive import Drive
from eqsim.model.ensemble import Ensemble

_PLATEAU = 0.25  # share of the window over which a reliable maximum may extend
_KINK = 0.05  # share of its height by which a reliable maximum may be missed


def static_peak(ensemble: Ensemble, drive: Drive, run: Trajectory) -> Peak | None:
    """The first maximum of the force of a run after a fresh start, within four rms
    thresholds, with standard errors; without values where none is seen on the grid, and
    None for a stationary start, which has no peak, and several kinds of contacts."""
    if drive.start == "stationary" or ensemble.populations:
        return None
    period = period_of(ensemble, drive.velocity)
    size = int(np.searchsorted(run.X, PEAK_WINDOW * period, side="right"))
    X, force, stderr = (
        column[:size] for column in (run.X, run.force, run.force_stderr)
    )
    top = top_of(X, force, 2.0 * stderr, period)
    if not 0 < top < size - 1:
        none = Estimate(None, None, run.lives, reliable=False)
        return Peak(none, none)
    error = float(stderr[top])
    fallen = np.flatnonzero(force < force[top] - 4.0 * error)
    first = max(fallen[fallen < top], default=-1) + 1
    last = min(fallen[fallen > top], default=size)
    peak, place = extreme(X[:last], Forces(force[:last], stderr[:last]), 1.0)
    where, height = known(place), known(peak)
    missed = Missed(0.0, 0.0)
    if height == force[top]:  # no neighbours that are as high within errors
        where, height = vertex(X, force, top)
        missed = missed_by(ensemble, period, X, force, top)
        noise = 2.0 * math.sqrt(2.0) * error  # of a difference
        if missed.force < noise and not has_jumps(ensemble.thresholds):
            missed = Missed(0.0, 0.0)
        error = math.hypot(error, height - force[top], missed.force)
    else:
        error = peak.stderr or error
    # on a plateau the maximum may be anywhere
    high = force[first:last] >= force[top] - 2.0 * stderr[top]
    extent = float(np.ptp(X[first:last][high]))
    spread = max(place.stderr or 0.0, 0.5 * extent, missed.X)
    # on a longer plateau the largest of many noisy values is too large
    reliable = run.force_reliable and extent < _PLATEAU * PEAK_WINDOW * period
    # else a later one may be higher between points
    reliable &= missed.force < _KINK * height
    lives = run.lives
    return Peak(
        Estimate(where, spread, lives, None, reliable),
        Estimate(height, error, lives, None, reliable),
    )
