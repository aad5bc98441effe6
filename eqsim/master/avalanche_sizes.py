"""Sizes of the avalanches of infinitely many contacts that are pulled infinitely slowly
at T = 0 (derived).

Contacts are born unstressed. The mean stiffness of a pinned one is k_t = E[k_i
xi]/E[xi], as a life is pinned in proportion to its travel xi: k for uniform contacts,
and k xi_rms/<xi> for the sqrt law. A break loses the force d = k_i xi_i and moves the
slider by d/(K + N k_t), and then rho d/<d> more contacts break in the mean,
independently of each other, rho = N k_t/(N k_t + K). With coupled blocks the same is
true of the sum over blocks, whatever their elastic response. An avalanche is then the
progeny of one break, or the customers of a busy period of the queue M/G/1 with load rho
and service d:

    P(s) = E[exp(-t) t^(s-1)]/s!,    t = rho (d_1 + ... + d_s)/<d>,
    <s> = 1/(1 - rho) = 1 + N k_t/K.
"""

from typing import NamedTuple

import numpy as np
from scipy import special

from eqsim.errors import require_integer, require_number
from eqsim.estimate import Estimate
from eqsim.laws.stiffness import StiffnessLaw, relative_stiffness
from eqsim.laws.threshold import ThresholdLaw
from eqsim.model.elastic import Elastic
from eqsim.numerics.quadrature import gauss_legendre
from eqsim.numerics.tables import Array

# -ln P(xi > .) at the ends of panels; nothing counts beyond these.
_OCTAVES = 2.0 ** np.arange(-54.0, 7.0)
# Largest size up to which the law is solved for, to bound time and memory.
_LARGEST_SIZE = 20_000


def load_of(
    law: ThresholdLaw, spring: float, stiffness: StiffnessLaw = "uniform"
) -> float:
    """Load rho of contacts behind a spring of the stiffness `spring` = K/(N k); k is the
    mean stiffness k_t/k of a pinned contact at T = 0."""
    k = law.rms / law.mean if stiffness == "sqrt" else 1.0
    return k / (k + spring)


def size_law(
    law: ThresholdLaw, load: float, most: int, stiffness: StiffnessLaw = "uniform"
) -> Array:
    """P(1), ..., P(most), shape (most,), to 1e-10, at the `load` rho, in (0, 1]; `most`
    up to 20000. Raises InputError for values out of range."""
    require_number("load", load, above=0.0, most=1.0)
    require_integer("most", most, 1, _LARGEST_SIZE)
    points = 1 << (4 * most + 60).bit_length()
    # P(s) = P(s offspring of s - 1 in all)/s (Dwass, 1969), by the characteristic
    # function of the offspring
    t, weight = _services(law, load, stiffness)
    offspring = np.fft.fft(_offspring(t, weight, points // 2), points)
    turned = offspring * np.exp(2j * np.pi * np.arange(points) / points)
    sizes, power = np.empty(most), offspring
    for s in range(1, most + 1):
        sizes[s - 1] = power.mean().real / s
        power = power * turned
    return np.maximum(sizes, 0.0)


class FewContacts(NamedTuple):
    """Corrections of n contacts to the numbers of infinitely many: mean size, and
    fraction of single breaks."""

    mean: float
    single: float


def missed_by_few(
    law: ThresholdLaw, load: float, contacts: int, stiffness: StiffnessLaw = "uniform"
) -> FewContacts:
    """Corrections for n = `contacts` on one spring instead of infinitely many, to first
    order in 1/n (derived). With coupled blocks they are smaller.

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


def averages_of_blocks(
    law: ThresholdLaw, blocks: Elastic, count: int
) -> dict[str, Estimate]:
    """Breaks per avalanche of coupled blocks, "size", and the fraction of "single"
    breaks, of infinitely many contacts of uniform stiffness; the error is the change for
    those of one block alone, of `count` in all. None of a discrete law, whose equal
    thresholds break together from a fresh start on."""
    if law.steps.size:
        return {}
    few = missed_by_few(law, blocks.branching, blocks.contacts_per_block(count))
    alone = float(size_law(law, blocks.branching, 1)[0])
    return {
        "size": Estimate(blocks.mean_size, abs(few.mean), 0),
        "single": Estimate(alone, abs(few.single), 0),
    }


def nodes_of(law: ThresholdLaw, each: int) -> tuple[Array, Array]:
    """Thresholds in units of the law's scale, and weights, arrays (nodes,), for means
    over a law: all of a discrete one, or `each` Gauss-Legendre nodes in an octave of
    -ln P(xi > .), and between kinks of the law."""
    if law.steps.size:
        xi, weight = np.unique(law.steps, return_counts=True)
    else:
        kinks = -np.log(np.clip(law.sf(law.kinks), np.exp(-_OCTAVES[-1]), 1.0))
        edges = np.union1d(_OCTAVES, np.maximum(kinks, _OCTAVES[0]))
        e, weight = map(np.ravel, gauss_legendre(each).between(edges[:-1], edges[1:]))
        xi, weight = np.asarray(law.inverse_survival(e)), weight * np.exp(-e)
    return xi / law.scale, weight / np.sum(weight)


def _services(
    law: ThresholdLaw, load: float, stiffness: StiffnessLaw
) -> tuple[Array, Array]:
    """Mean number t of breaks that follow directly from a break, and its probability,
    arrays (nodes,): nodes and weights of E[.] over the force d that a break loses."""
    xi, share = nodes_of(law, 12)
    drop = xi * relative_stiffness(stiffness, xi, law.rms / law.scale)
    # <d> by the same nodes, so that the mean of t is the load
    return load * drop / np.sum(share * drop), share


def _offspring(t: Array, weight: Array, most: int) -> Array:
    """P(0), ..., P(most - 1) of the number of breaks that follow directly from one,
    E[exp(-t) t^k/k!]."""
    chance = np.zeros(most)
    for k in range(most):
        log_chance = special.xlogy(k, t) - t - special.gammaln(k + 1.0)
        chance[k] = np.sum(weight * np.exp(log_chance))
        if k > t.max() and chance[k] < 1e-20:
            break
    return chance
