"""Creep of chains of blocks below their threshold (derived): contacts that forget, the
life of a few contacts that are not replaced, and the two limits of steady creep.

Stiffnesses are over n k, thresholds are 1 and all equal, and rates of a contact of
stretch x are omega exp(-b (1 - x^2)).
"""

import functools
import math

import numpy as np
from scipy import linalg, optimize, special

from eqsim.errors import require_integer, require_number
from eqsim.numerics.quadrature import gauss_legendre
from eqsim.numerics.tables import Array

# Panels and nodes of a mean over modes, or over a life.
_PANELS = 64
_ORDER = 16
# Panels shrink by this ratio towards mode 0, whose time is the longest.
_RATIO = 0.6
# Most contacts of a chain that is not replaced: its sets of pinned ones are 2^20.
_MOST_CONTACTS = 20


def relaxing_edge(coupling: float, time: Array) -> Array:
    """Displacement of the edge of a half infinite chain over the force F/(n k) on it,
    array (times,), whose contacts forget their stretch at a rate r: `time` is r t. As a
    sum over modes of stiffness kappa = K (2 - 2 cos q),

        X_0/F = (2/pi) int_0^pi cos^2(q/2) [(1 - e)/kappa + e/(1 + kappa)] dq,
        e = exp(-kappa r t/(1 + kappa)).

    Raises InputError for a coupling out of range."""
    require_number("coupling", coupling, least=1e-6, most=1e9)
    edges = math.pi * np.append(0.0, _RATIO ** np.arange(_PANELS - 1.0, -1.0, -1.0))
    q, weights = gauss_legendre(_ORDER).between(edges[:-1], edges[1:])
    q, weights = q.ravel(), weights.ravel() * 2.0 / math.pi
    kappa = 4.0 * coupling * np.sin(0.5 * q) ** 2
    slow = np.asarray(time, float)[..., None] / (1.0 + kappa)
    relaxed = -np.expm1(-kappa * slow) / kappa
    elastic = np.exp(-kappa * slow) / (1.0 + kappa)
    return np.asarray((relaxed + elastic) @ (weights * np.cos(0.5 * q) ** 2))


def mean_life(blocks: int, coupling: float, force: float, b: float) -> float:
    """Mean time, over 1/omega, until the last contact of a chain breaks that bears a
    constant force on each block, one contact in each, which is not replaced. The mean T
    of a set of pinned contacts follows from those of its subsets,

        T(S) = [1 + sum_i r_i T(S without i)]/sum_i r_i,

    with T = 0 and r from the balance of forces; what is stretched beyond its threshold
    breaks at once. Raises InputError for numbers out of range."""
    require_integer("blocks", blocks, 1, _MOST_CONTACTS)
    require_number("coupling", coupling, least=1e-6, most=1e9)
    require_number("force", force, least=0.0, most=1e9)
    require_number("b", b, least=0.0, most=1e3)
    springs = coupling * (
        2.0 * np.eye(blocks) - np.eye(blocks, k=1) - np.eye(blocks, k=-1)
    )
    springs[[0, -1], [0, -1]] -= coupling

    @functools.cache
    def life(pinned: frozenset[int]) -> float:
        if not pinned:
            return 0.0
        held, each = springs.copy(), sorted(pinned)
        held[each, each] += 1.0
        x = linalg.solve(held, np.full(blocks, force), assume_a="pos")[each]
        over = frozenset(
            i for i, stretch in zip(each, x, strict=True) if stretch >= 1.0
        )
        if over:  # loads of the others only rise
            return life(pinned - over)
        rates = np.exp(-b * (1.0 - x**2))
        later = sum(
            r * life(pinned - {i}) for i, r in zip(each, rates.tolist(), strict=True)
        )
        return float((1.0 + later) / rates.sum())

    return life(frozenset(range(blocks)))


def creep_velocity(stretch: float, b: float, *, coupled: bool) -> float:
    """Velocity over omega x_s of steady creep under a constant force x_0 (over n k x_s)
    on each block, whose contacts take hold again at once. Blocks of one contact that
    are not coupled move by x_0 at each break,

        V = x_0 exp(-b (1 - x_0^2)),

    and rigidly coupled ones at the velocity whose steady friction is x_0,

        x_0 = int_0^1 x S dx/int_0^1 S dx,
        S = exp[-exp(b (x^2 - 1)) D(sqrt(b) x)/(V sqrt(b))],

    D being Dawson's integral. Chains of any coupling lie between them. Raises
    InputError for numbers out of range; a rigid slider bears no more than 1/2."""
    require_number("b", b, above=0.0, most=500.0)
    require_number("stretch", stretch, above=0.0, most=0.499 if coupled else 1.0)
    alone = stretch * math.exp(-b * (1.0 - stretch**2))
    if not coupled:
        return alone
    edges = np.linspace(0.0, 1.0, _PANELS + 1)
    x, weights = (
        a.ravel() for a in gauss_legendre(_ORDER).between(edges[:-1], edges[1:])
    )
    hazard = np.exp(b * (x**2 - 1.0)) * special.dawsn(math.sqrt(b) * x) / math.sqrt(b)

    def excess(log_V: float) -> float:
        S = weights * np.exp(-hazard * math.exp(-log_V))
        return float(x @ S / S.sum()) - stretch

    low = math.log(alone)
    return math.exp(optimize.brentq(excess, low - 5.0, low + b + 20.0, xtol=1e-14))
