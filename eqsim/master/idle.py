"""How much sooner heat makes contacts break that break close to their thresholds
anyway: where that is next to nothing, exact means are solved for without heat.

Over a whole programme heat breaks hardly any contact (`MISSED` in the mean) that is
farther below its threshold xi than the gap g at which

    omega T exp(-E(g)) = MISSED,    g <= xi.

Follow each contact with and without heat, with the same thresholds and delays. At
constant velocity a life with heat begins and ends earlier than that without by the sum
of g over the lives so far; in the mean by no more than the shift (derived, with Wald's
equation and Lorden's inequality for the number of lives)

    G = E[g] (P/mu + E[xi^2]/mu^2 + 2),    mu = E[xi],

P the way of the slider, with one life more for a stationary start; behind a delay by as
much more as the velocity changes, since a shift in time is kept. The force of a contact
that is in the same life in both differs by G at most. The share in different lives is
that of the contacts that break within G, and as many may go another way altogether at
each change of the velocity: between one segment and the next those within G of breaking
break in one case only. With M the largest force of a contact and r the breaks per
contact and displacement, the mean force misses less than G (1 + 2 (segments + 1) r M).
"""

import math

import numpy as np

from eqsim.laws.aging import Unaged
from eqsim.master.quenched import kappa_of
from eqsim.model.reduced import Reduced
from eqsim.numerics.quadrature import normal_exponent
from eqsim.numerics.roots import bisected
from eqsim.numerics.tables import Array

# Share of contacts that heat breaks farther from their thresholds.
MISSED = 1e-12
# Shift, in mean thresholds, up to which heat is left out; about what solvers miss.
IDLE = 1e-6
# Normal deviates of thresholds over which gaps are averaged.
_DEVIATES = np.linspace(-8.2, 8.2, 401)


def shift_by_heat(contacts: Reduced, way: float) -> float:
    """G in units of the law's scale, for a slider that moves by `way` and whose
    barrier has the whole time for its unit of time; infinite where it is too large to
    leave heat out, or not bounded: for annealed contacts, which break at thresholds
    drawn afresh, for those that age, and where rates depend on the force alone."""
    barrier, law = contacts.barrier, contacts.law
    bounded = isinstance(contacts.aging, Unaged) and not contacts.annealed
    if not (barrier.thermal and bounded) or barrier.by_force:
        return math.inf
    xi = np.asarray(law.inverse_survival(normal_exponent(_DEVIATES))) / law.scale
    share = np.exp(-0.5 * _DEVIATES**2)
    a = barrier.b * kappa_of(contacts, xi)
    level = barrier.log_w - math.log(MISSED)

    def near(log_share: Array) -> Array:
        gap = xi * np.exp(log_share)
        return np.asarray(barrier.exponent(gap, 2.0 * xi - gap, xi, a) < level)

    ends = np.full(xi.size, -60.0), np.zeros(xi.size)
    gap = xi * np.exp(bisected(near, *ends, 30)[1])
    mu, rms = law.mean / law.scale, law.rms / law.scale
    shift = float(share @ gap / share.sum()) * (way / mu + (rms / mu) ** 2 + 2.0)
    return shift


def means_missed(
    contacts: Reduced, shift: float, segments: int, breaks: Array, ways: Array
) -> Array:
    """Bounds of what force, pinned share and mean square miss without heat, shape (3,
    1), with the breaks per contact in steps, and the displacements in them, arrays
    (steps,)."""
    ways = np.abs(ways)
    rate = float(np.max(breaks / np.maximum(ways, shift), initial=0.0))
    last = np.asarray(contacts.law.inverse_survival(36.0)) / contacts.law.scale
    reach = np.minimum(last, 2.0 * ways.sum() + last * MISSED)
    strongest = float(reach * kappa_of(contacts, last))
    apart = 2.0 * (segments + 1) * rate * shift + MISSED
    force = shift + apart * strongest
    return np.array([[force], [apart], [2.0 * strongest * force]])
