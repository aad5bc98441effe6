"""Tell how many contacts make a mean force or its variance, and so whether a sample is
large enough for a score.

A mean is normal, and its scatter tells its error, if as many as 400 contacts carry the
force; a mean of squares if 1600 do, by the ages of contacts where their exact law is
known, as a sample may lack just the few that matter, and if a pilot run finds it too
and that the error does not come from a few groups, as with heavy tails.
"""

import numpy as np

from eqsim.master.profile import Profile
from eqsim.master.steady import settled
from eqsim.master.transient import cells_of, from_birth, renewal_of
from eqsim.model.drive import Drive
from eqsim.model.ensemble import Ensemble
from eqsim.model.reduced import drag_of
from eqsim.numerics.tables import Array

# Contacts that carry the force (`carrying_share`) from which on a mean over them is
# taken to be normal, and a mean of squares.
ENOUGH_CONTACTS = 400
ENOUGH_SQUARES = 1600
# Share of the sum of squares of 64 normal numbers that the largest square exceeds once
# in fifty times.
_LARGEST_SHARE = 0.2
# Groups of contacts, whose scatter is the error of a variance.
GROUPS = 64


def many_contribute(pilot: Array) -> bool:
    """True if many contacts contribute to the mean of squares, by the `pilot` run of
    GROUPS groups: its relative error is as if ENOUGH_SQUARES did so equally, and does
    not come from one group (as with tails so heavy that there is no error)."""
    off = (pilot - pilot.mean()) ** 2
    return bool(
        pilot.mean() ** 2 * GROUPS >= ENOUGH_SQUARES * pilot.var(ddof=1) > 0
        and off.max() < _LARGEST_SHARE * off.sum()
    )


def drag_over_k(ensemble: Ensemble, v: float) -> float:
    """The drag of a detached contact over k, if there are any."""
    if not ensemble.delay.time:
        return 0.0
    return drag_of(ensemble, v) * ensemble.thresholds.scale


def carrying_share(level: float, variance: float, pinned: float, drag: float) -> float:
    """The share of contacts that carry the mean force `level`, as if equally:
    <f>^2/<f^2>, f the force above the `drag`, which all detached contacts carry alike;
    at most that of pinned contacts, and of detached ones with a drag, as fluctuations
    of the force come from the rarer state."""
    share = (level - drag) ** 2 / max((level - drag) ** 2 + variance, 1e-300)
    return min(share, pinned, 1.0 - pinned if drag else 1.0)


def squaring_share(ages: Array, level: float) -> float:
    """The share of contacts that make the mean square of forces about `level`, as if
    equally: <d^2>^2/<d^4>, d the deviation. `ages`, shape (3, n): of contacts of each
    age their share, and their part of the mean force and of its square. Few old ones
    that a sample lacks may make much of it."""
    share, force, square = ages[:, ages[0] > 0.0]
    square = square - 2.0 * level * force + level**2 * share
    return float(square.sum() ** 2 / max((square**2 / share).sum(), 1e-300))


def squaring_shares_at_first(
    ensemble: Ensemble, drive: Drive, levels: Array
) -> list[float]:
    """`squaring_share` at equal displacements of fresh contacts, whose mean forces are
    `levels`, by how many of the births at each age are left."""
    s, unit = settled(ensemble, drive.velocity), ensemble.thresholds.scale
    cells = cells_of(s, drive.over(ensemble) / unit, levels.size)
    profile, x = cells.profile, cells.x
    renewal = renewal_of(profile, x, s)
    left = _left(profile, x)
    fresh = np.array([from_birth(profile, s, x, power) for power in range(3)])
    waiting = s.drag ** np.arange(3)[:, None] * (1.0 - renewal.pinned)
    births, found = np.maximum(renewal.births, 0.0), []
    every = renewal.births.size // (levels.size - 1)
    for i, level in enumerate(levels):
        m = i * every
        others = np.array([fresh[:, m], waiting[:, m]]).T
        ages = np.concatenate((left[:, :m] * births[:m][::-1], others), axis=1)
        found.append(squaring_share(ages, level / unit))
    return found


def squaring_share_at_last(ensemble: Ensemble, v: float, level: float) -> float:
    """`squaring_share` of stationary contacts, whose mean force is `level`."""
    s, unit = settled(ensemble, v), ensemble.thresholds.scale
    profile = Profile(s)
    left = _left(profile, np.append(0.0, profile.x))
    cycle = left[0].sum() + s.delay.mean
    waiting = s.drag ** np.arange(3.0) * s.delay.mean
    return squaring_share(
        np.append(left, waiting[:, None], axis=1) / cycle, level / unit
    )


def _left(profile: Profile, x: Array) -> Array:
    """Number of contacts between ages `x`, of those born at a constant rate, one per unit
    of displacement, and their part of the force and of its square; shape (3, n)."""
    return np.array([np.diff(profile.integral(x, p)[p]) for p in range(3)])
