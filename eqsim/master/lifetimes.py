"""Lifetime of a cluster of identical contacts that share a constant force equally: a
chain of births and deaths that is absorbed where no contact is pinned."""

import decimal
import math
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np
from scipy import special

from eqsim.errors import InputError, require_integer
from eqsim.estimate import Estimate
from eqsim.model.drive import Programme
from eqsim.model.ensemble import Ensemble
from eqsim.model.reduced import reduced
from eqsim.numerics.tables import Array
from eqsim.results import Drawn, Result

# Decimal numbers whose exponents do not overflow, as the time may that a cluster takes
# to shrink; 25 digits leave more than 15 after 1e5 steps.
_WIDE = decimal.Context(25, Emin=decimal.MIN_EMIN, Emax=decimal.MAX_EMAX)
# Relative error of a mean, from that of the logarithm of a rate.
_RELATIVE_ERROR = 1e-12
# ln of a time over t, beyond which it is infinite.
_LARGEST_LOG = 300.0
# Inversion of a Laplace transform (Abate, Whitt, ORSA J. Comput. 7, 36, 1995): its
# error is exp(-A). Terms of the alternating series, and of its Euler sum.
_EULER_A = 22.0
_EULER_TERMS = 30
_EULER_MEANS = 14
# Terms per t over the standard deviation: beyond these the transform is negligible.
_TERMS_PER_WIDTH = 2.5
_MOST_TERMS = 4000.0


class Chain(NamedTuple):
    """Rates with n = 1, ..., N pinned contacts, arrays (N,): ln of that of breaks, and
    that at which contacts are pinned again."""

    log_breaks: Array
    pinned_again: Array


@dataclass(frozen=True, repr=False)
class Lifetime(Result):
    """Lifetime of a cluster.

    Attributes
    ----------
    t : ndarray
        Times, shape (points,).
    survival : ndarray
        Probability that the cluster holds longer, to 1e-9.
    mean, std : Estimate
        Of the lifetime (time); infinite beyond 1e308.
    """

    drawn: ClassVar[Drawn] = Drawn("t", "survival", "", "time  t", "P(lifetime > t)")
    t: Array
    survival: Array
    mean: Estimate
    std: Estimate


def lifetime(ensemble: Ensemble, drive: Programme, *, points: int = 201) -> Lifetime:
    """Solve for the time until a cluster of N identical contacts, all pinned at first,
    has none left under a constant force F. Each of n pinned contacts has the force F/n
    at any time; the others are pinned again at the rate g = 1/tau, or not at all
    (Erdmann, Schwarz, Phys. Rev. Lett. 92, 108102, 2004):

        T = sum_n t_n,    t_n = (1 + g (N - n) t_{n+1})/(n k(F/n)).

    Parameters
    ----------
    ensemble : Ensemble
        Up to 100 000 contacts of one threshold that do not age, born unstretched and
        without viscosity, with an infinite or an exponential delay that does not depend
        on the velocity.
    drive : Programme
        One segment with a constant force, whose instants are those of the survival;
        with `rebinding` "shared" if contacts are pinned again.
    points : int
        How many.

    Returns
    -------
    Lifetime

    Raises
    ------
    InputError
        For other contacts or another drive.

    Examples
    --------
    >>> from eqsim import Delay, Delta, Ensemble, Programme, Segment, Thermal, lifetime
    >>> bonds = Ensemble(Delta(), Thermal(0.2), Delay(5.0, "exponential"), count=10)
    >>> creep = Programme([Segment(force=0.3, time=50.0)], rebinding="shared")
    >>> found = lifetime(bonds, creep, points=3)
    >>> print(f"{found.mean.value:.6f}")
    17.084805
    """
    chain = chain_of(ensemble, drive)
    t = drive.grid(points).t
    mean, std = moments(chain)
    known = (Estimate(x, x * _RELATIVE_ERROR, 0) for x in (mean, std))
    return Lifetime(t, survival_of_chain(chain, t, mean, std), *known)


def chain_of(ensemble: Ensemble, drive: Programme) -> Chain:
    """Rates per time. Raises InputError as `lifetime` does."""
    law, delay, N = ensemble.thresholds, ensemble.delay, ensemble.count
    require_integer("contacts.count", N, 1, 100_000)
    contacts = reduced(ensemble, law.scale)  # whose time is the user's
    tau, segment = contacts.delay.mean, None
    if isinstance(drive, Programme) and drive.forced and len(drive.segments) == 1:
        segment = drive.segments[0]
    force = segment.force or 0.0 if segment else -1.0
    if segment is None or segment.force_rate or force < 0.0:
        raise InputError("drive.force: must be given, constant and >= 0")
    again, random = tau < math.inf, delay.law == "exponential" and tau > 0.0
    exponent = ensemble.delay.velocity_exponent
    drags = ensemble.eta or ensemble.viscosity.force
    for said, wrong in {
        "thresholds: must all be equal": law.steps.size != 1,
        f'delay.time = {tau:g}: must be inf, or with law = "exponential" > 0': (
            again and not random
        ),
        f"delay.velocity_exponent = {exponent:g}: must be 0 under a force": (
            exponent != 0.0
        ),
        'drive.rebinding: must be "shared", for forces to be equal': (
            again and drive.rebinding != "shared"
        ),
        "aging, newborn, viscosity: not in a cluster whose contacts share the force": (
            ensemble.aging.active or ensemble.newborn.active or drags
        ),
    }.items():
        if wrong:
            raise InputError(said)
    barrier, n = contacts.barrier, np.arange(1.0, N + 1.0)
    xi = np.full(N, law.steps[0] / law.scale)
    stretch = force / law.scale * (N / n)
    log_rate: Array = np.full(N, -math.inf)
    if barrier.thermal:
        x = np.minimum(stretch, xi)
        log_rate = barrier.log_w + barrier.log_rate(x, xi, barrier.b)
    log_rate = np.log(n) + np.where(stretch < xi, log_rate, math.inf)
    return Chain(log_rate, (N - n) / tau if again else 0.0 * n)


def moments(chain: Chain) -> tuple[float, float]:
    """Mean and standard deviation of the lifetime, from those of the time that each
    contact takes, whose mean square obeys (derived)

        m_n = (2 t_n + u m_{n+1} + 2 u t_n t_{n+1})/d."""
    with decimal.localcontext(_WIDE):
        mean, variance, t, m = (decimal.Decimal(0) for _ in range(4))
        for log_breaks, u in zip(*map(np.flip, chain), strict=True):
            if log_breaks == math.inf:
                break  # fewer contacts break at once
            if log_breaks == -math.inf:
                return math.inf, math.inf
            stay, gain = (-decimal.Decimal(log_breaks)).exp(), decimal.Decimal(u)
            longer, t = t, stay * (1 + gain * t)
            m = stay * (2 * t + gain * (m + 2 * longer * t))
            mean += t
            variance += m - t * t
        return float(mean), float(variance.sqrt())


def survival_of_chain(chain: Chain, t: Array, mean: float, std: float) -> Array:
    """P(lifetime > t), shape (times,), of a chain whose lifetime has this mean and
    standard deviation. With S its Laplace transform is (1 - S)/p, and with psi_n = 1 -
    E[exp(-p t_n)]

        psi_n = z/(1 + z),    z = (p + u psi_{n+1})/d,    S = prod (1 - psi_n)."""
    if math.isinf(mean):
        return np.ones(t.size)
    found, choose = np.where(t > 0.0, 0.0, 1.0), np.arange(_EULER_MEANS + 1)
    share = special.binom(_EULER_MEANS, choose) / 2.0**_EULER_MEANS
    for i in np.flatnonzero(t > 0.0) if std > 0.0 else ():
        more = min(_TERMS_PER_WIDTH * t[i] / std, _MOST_TERMS)
        terms = _EULER_TERMS + math.ceil(more)
        k = np.arange(terms + choose.size)
        p = (0.5 * _EULER_A + 1j * math.pi * k) / t[i]
        psi, log_S = 0.0 * p, 0.0 * p
        for log_breaks, u in zip(*map(np.flip, chain), strict=True):
            z = (p + u * psi) * math.exp(min(-log_breaks, _LARGEST_LOG))
            psi, log_S = z / (1.0 + z), log_S - np.log1p(z)
        series = (-1.0) ** k * (-np.expm1(log_S) / p).real
        series[0] *= 0.5
        sums = np.cumsum(series)[terms - 1 : terms + _EULER_MEANS]
        found[i] = math.exp(0.5 * _EULER_A) / t[i] * (sums @ share)
    return np.clip(found, 0.0, 1.0)
