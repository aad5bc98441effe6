"""Sizes of the avalanches of infinitely many contacts that are pulled infinitely slowly
at T = 0 (derived).

Contacts, born unstressed, share the spring's force with stiffness k_t each in the mean
over those that are pinned: a life is seen in proportion to its travel xi, so k_t =
E[k_i xi]/E[xi], which is k of uniform contacts and k xi_rms/<xi> of the sqrt law. A
break loses the force d = k_i xi_i and moves the slider by d/(K + N k_t), and then rho
d/<d> more contacts break in the mean, independently of each other, rho = N k_t/(N k_t +
K). With coupled blocks the same is true of the sum over blocks, whatever elastic
response shares that out. An avalanche is then the progeny of one break, or the
customers of a busy period of the queue M/G/1 with load rho and service d:

    P(s) = E[exp(-t) t^(s-1)]/s!,        t = rho (d_1 + ... + d_s)/<d>,        <s> = 1/(1 - rho) = 1 + N k_t/K.
"""

from typing import Any, NamedTuple

import numpy as np
from scipy import special

from eqsim.errors import require_integer, require_number
from eqsim.laws.stiffness import StiffnessLaw, relative_stiffness
from eqsim.laws.threshold import ThresholdLaw
from eqsim.numerics.quadrature import gauss_legendre
from eqsim.numerics.tables import Array

_OCTAVES = range(-54, 6)  # of -ln P(xi > .), beyond which nothing counts
_MOST = 20_000


def shared_stiffness(law: ThresholdLaw, stiffness: StiffnessLaw = "uniform") -> float:
    """k_t/k, the mean stiffness of a pinned contact at T = 0."""
    return law.rms / law.mean if stiffness == "sqrt" else 1.0


def load_of(
    law: ThresholdLaw, spring: float, stiffness: StiffnessLaw = "uniform"
) -> float:
    """rho of contacts behind a spring of the stiffness `spring` = K/(N k)."""
    k = shared_stiffness(law, stiffness)
    return k / (k + spring)


def size_law(
    law: ThresholdLaw, load: float, most: int, stiffness: StiffnessLaw = "uniform"
) -> Array:
    """P(1), ..., P(most), shape (most,), to 1e-10 (thresholds whose law has gaps:
    1e-4).

    Parameters
    ----------
    law : ThresholdLaw
    load : float
        rho, in (0, 1).
    most : int
        Largest size, up to 20000.
    stiffness : str
        "uniform", or "sqrt", under which strong contacts lose more force.

    Raises
    ------
    InputError
        For values out of range.
    """
    require_number("load", load, above=0.0, most=1.0)
    require_integer("most", most, 1, _MOST)
    points = 1 << (4 * most + 60).bit_length()
    # P(s) = P(s offspring of s - 1 in all)/s (Dwass, 1969), by the characteristic
    # function of the offspring
    offspring = np.fft.fft(
        _offspring(_services(law, load, stiffness), points // 2), points
    )
    angle = np.exp(2j * np.pi * np.arange(points) / points)
    found, power = np.empty(most), offspring.copy()
    for s in range(1, most + 1):
        found[s - 1] = power.mean().real / s
        power *= offspring
        power *= angle
    return np.maximum(found, 0.0)


class FewContacts(NamedTuple):
    """Corrections of n contacts to the numbers of infinitely many: mean size, and
    fraction of single breaks."""

    mean: float
    single: float


def missed_by_few(
    law: ThresholdLaw, load: float, contacts: int, stiffness: StiffnessLaw = "uniform"
) -> FewContacts:
    """Corrections that `contacts` on one spring make, to the first order in 1/n
    (derived); coupled blocks share it out, and change less.

    The contact that breaks is none of those that may follow, so that rho is (1 - 1/n)
    times as large. An avalanche begins with probability 1 - rho (1 - 1/n) per break
    (ballot theorem). It is single if no other contact breaks within a share t/n of a
    life, (1 - t/n)^(n-1), t = rho d/<d>; contacts that do not break then are the more
    likely to have broken before, which leaves the beginning of an avalanche 1 - rho
    t/(n (1 - rho)) times as likely.
    """
    t, weight = _services(law, load, stiffness)
    begins = 1.0 - load * (1.0 - 1.0 / contacts)
    change = t - 0.5 * t * t - load * t / (1.0 - load)
    single = float(np.sum(weight * np.exp(-t) * change)) / contacts
    return FewContacts(1.0 / begins - 1.0 / (1.0 - load), single)


class _Services(NamedTuple):
    """Breaks t that follow from one directly, in the mean, and their probabilities,
    arrays (nodes,)."""

    t: Array
    weight: Array


def _services(law: ThresholdLaw, load: float, stiffness: StiffnessLaw) -> _Services:
    """Nodes and weights of E[.] over the drop d of a break."""
    xi: Any
    weight: Any
    if law.steps.size:
        xi, weight = np.unique(law.steps, return_counts=True)
    else:
        octave = 2.0 ** np.array(_OCTAVES)
        e, weight = map(np.ravel, gauss_legendre(12).between(octave, 2.0 * octave))
        weight = weight * np.exp(-e)
        xi = law.inverse_survival(e)
    weight = weight / np.sum(weight)
    xi = np.asarray(xi) / law.scale
    drop = xi * relative_stiffness(stiffness, xi, law.rms / law.scale)
    return _Services(
        load * drop / np.sum(weight * drop), weight
    )  # the mean of the same nodes


def _offspring(services: _Services, most: int) -> Array:
    """P(0), ..., P(most - 1) of the number of breaks that follow from one directly,
    E[exp(-t) t^k/k!]."""
    t, weight = services
    found = np.zeros(most)
    for k in range(most):
        found[k] = np.sum(
            weight * np.exp(special.xlogy(k, t) - t - special.gammaln(k + 1.0))
        )
        if k > t.max() and found[k] < 1e-20:
            break
    return found
