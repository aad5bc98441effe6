"""Bursts of infinitely many contacts that share a force which is raised infinitely
slowly, at T = 0 and without re-attachment (Hemmer, Hansen, J. Appl. Mech. 59, 909,
1992).

At a stretch x the break of a contact leaves its force to those that are left, of which

    a = x q/(1 - Q),    Q(x) = E[k_i; xi < x]/E[k_i],    q = dQ/dx,

more break in the mean. Contacts of uniform stiffness have Q = P; with the sqrt law k_i
is in proportion to xi (derived: all that break at x have the same stiffness, so that
nothing else is different). A burst begins at a break with the probability 1 - a, and
has s breaks by Borel's law. Where a = 1 the force k x (1 - Q) has its maximum, and all
that are left break at once.
"""

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike
from scipy import special

from eqsim.errors import InputError
from eqsim.master.quenched import kappa_of, stiffness_of_survivors
from eqsim.model.ensemble import Ensemble
from eqsim.model.reduced import Reduced, reduced
from eqsim.numerics.quadrature import gauss_legendre
from eqsim.numerics.roots import bisected
from eqsim.numerics.tables import Array
from eqsim.results import Drawn, Result

# Octaves of e = -ln P(xi > x), and of its distance to the last one: what is beyond them
# is below rounding.
_OCTAVES = 2.0 ** np.arange(-52.0, 0.0)
# Largest e at which a bundle may still hold.
_LARGEST_E = 300.0
# Share of contacts beyond a kink that plays no part.
_RAREST = 1e-300
# s from which Stirling's series misses ln s! by less than 1e-16.
_SERIES_FROM = 100.0
# Largest number of sizes, to bound memory.
_MOST_SIZES = 100_000


@dataclass(frozen=True, repr=False)
class Bursts(Result):
    """Bursts of a bundle.

    Attributes
    ----------
    size : ndarray
        Numbers s of breaks, shape (sizes,).
    number : ndarray
        D(s)/N, bursts of that size over the number of contacts, to 1e-10.
    stretch : float
        x_c (length), at which the bundle lets go.
    strength : float
        Largest force F/(N k) (length).
    last : float
        Share of all contacts that the last burst breaks.
    """

    drawn: ClassVar[Drawn] = Drawn(
        "size", "number", "", "breaks of a burst  s", "bursts over contacts  D/N", True
    )
    size: Array
    number: Array
    stretch: float
    strength: float
    last: float


def bursts(ensemble: Ensemble, sizes: ArrayLike) -> Bursts:
    """Solve for the numbers of bursts of a bundle whose force is raised infinitely
    slowly, by quadrature. All contacts are pinned and unstretched at first, break at
    their thresholds (T = 0) and are not pinned again; those left share the force by
    their stiffness. Hemmer and Hansen (1992) found for infinitely many contacts

        D(s)/N = s^{s-1}/s! int_0^{x_c} a^{s-1} e^{-s a} (1 - a) p dx,

    a = x p/(1 - P) for uniform stiffness, a(x_c) = 1; with the sqrt law thresholds are
    weighted by the stiffness in a (derived).

    Parameters
    ----------
    ensemble : Ensemble
        Contacts of one kind; their delay plays no part.
    sizes : array_like, shape (sizes,)
        Whole numbers >= 1; by default 1 to 1000 of a run file.

    Returns
    -------
    Bursts

    Raises
    ------
    InputError
        For a temperature above 0, contacts that age or are born stretched, a law of
        finitely many thresholds (its bursts are of the order of N), and sizes that are
        no whole numbers >= 1.

    Examples
    --------
    >>> from eqsim import Ensemble, Weibull, bursts
    >>> found = bursts(Ensemble(Weibull(2.0, 1.0), stiffness_law="uniform"), [1, 2, 10])
    >>> [f"{number:.9f}" for number in found.number]
    ['0.160695591', '0.027820240', '0.000449469']
    """
    if ensemble.aging.active or ensemble.newborn.active:
        said = "bursts are those of contacts that do not age and are born unstretched"
        raise InputError(f"aging, newborn: {said}")
    law, contacts = ensemble.thresholds, reduced(ensemble, ensemble.thresholds.scale)
    s = np.asarray(sizes, float)
    if s.ndim != 1 or not 0 < s.size <= _MOST_SIZES or np.any((s < 1) | (s % 1 != 0)):
        raise InputError(f"sizes: must be 1 to {_MOST_SIZES} whole numbers >= 1")
    if contacts.barrier.thermal:
        raise InputError(
            "thermal: must be off (kT = 0); heat has no infinite time here"
        )
    if law.steps.size:
        said = "must have a density: as many as have one threshold break at once"
        raise InputError(f"thresholds = {law!r}: {said}")
    end = _end_of(contacts)
    edges = np.concatenate(([0.0], _OCTAVES, 1.0 - _OCTAVES[-2::-1], [1.0])) * end
    kinks = -np.log(np.maximum(law.sf(law.kinks), _RAREST))
    edges = np.union1d(edges, kinks[(kinks > 0.0) & (kinks < end)])
    e, weight = map(np.ravel, gauss_legendre(16).between(edges[:-1], edges[1:]))
    a = _followers(contacts, e)
    begun = weight * np.exp(-e) * (1.0 - a)
    number = [np.sum(begun * _borel(size, a)) for size in s]
    stretch = float(law.inverse_survival(end))
    held, _ = stiffness_of_survivors(contacts, np.array([stretch / law.scale]))
    left = math.exp(-end)
    return Bursts(s, np.array(number), stretch, stretch * float(held[0]) * left, left)


def _borel(s: float, a: Array) -> Array:
    """s times Borel's law of mean number of followers `a`, s^{s-1}/s! a^{s-1} e^{-s a}
    (shape of `a`); Stirling's series has the rest of s! to rounding."""
    rest = 1.0 / s / 12.0 - 1.0 / s**3 / 360.0 + 1.0 / s**5 / 1260.0
    if s < _SERIES_FROM:
        rest = special.gammaln(s + 1.0) - s * math.log(s / math.e)
        rest -= 0.5 * math.log(2.0 * math.pi * s)
    power = special.xlogy(s - 1.0, a) - s * (a - 1.0)
    return np.asarray(np.exp(power - rest) / (s * math.sqrt(2.0 * math.pi * s)))


def _followers(contacts: Reduced, e: Array) -> Array:
    """Mean number a of breaks that follow from one at e = -ln P(xi > x), shape (n,)."""
    law = contacts.law
    x = np.asarray(law.inverse_survival(e))
    a = x * law.pdf(x) * np.exp(e)
    ahead, _ = stiffness_of_survivors(contacts, x / law.scale)
    return np.asarray(a * kappa_of(contacts, x / law.scale) / ahead)


def _end_of(contacts: Reduced) -> float:
    """e = -ln P(xi > x_c), where a = 1; 0 if the first break is the last burst. Raises
    InputError where a falls again to less than 1."""
    e = np.geomspace(_OCTAVES[0], _LARGEST_E, 600)
    above = _followers(contacts, e) > 1.0
    if np.any(np.diff(above.astype(int)) < 0) or not above[-1]:
        said = "must have a load of all contacts, x P(xi > x), with one maximum"
        raise InputError(f"thresholds = {contacts.law!r}: {said}")
    first = int(np.argmax(above))
    if first == 0:
        return 0.0

    def below(middle: Array) -> Array:
        return _followers(contacts, middle) <= 1.0

    return float(bisected(below, e[first - 1 : first], e[first : first + 1], 60)[0][0])
