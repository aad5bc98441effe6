"""Thermally activated breaking of a pinned contact: rates, integrated hazards and their exact inverses.

With stretch x, threshold xi and a = k_i/(2 kT), per attempt (that is in units of omega):

    soft   r = exp(-a (xi^2 - x^2))                                                     (behind temper11)
    stiff  r = sqrt(1 - x/xi) exp(-a xi^2 (1 - x/xi)^(3/2))                             (behind temper12)

At velocity v the hazard per unit displacement is (omega/v) r, and its integral H(x) = int_0^x r dy is (derived)

    soft   H = exp(-a xi^2) sqrt(pi) / (2 sqrt(a)) erfi(sqrt(a) x)
    stiff  H = 2 / (3 a xi) (exp(-a xi^2 (1 - x/xi)^(3/2)) - exp(-a xi^2))

A contact whose exponential clock shows E breaks where (omega/v) H(x) = E, or at xi if that comes first. Exponents
reach 1e9, so everything is done in logarithms. Labels are those of Braun and Peyrard (2011).

Quenched contacts keep their own xi. In the annealed ensemble every attempt draws a fresh xi' and needs xi' > x, so
that contacts share one pooled rate h(x) = int_x^inf P_c(xi') r(x|xi') dxi' (H(x) v/omega of temper11, temper12).
"""

import functools
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import numpy as np
from scipy import interpolate, special

from eqsim.compiled import inlined
from eqsim.errors import NOT_NEGATIVE, InputError, require_choice, require_number
from eqsim.laws.elementary import bounded_exp, log_one_plus, two_thirds_power
from eqsim.laws.octaves import Array, look_up, octave_edges, octave_table
from eqsim.laws.stiffness import StiffnessLaw, relative_stiffness
from eqsim.laws.threshold import NO_STEPS, ThresholdLaw, panels_above

Barrier = Literal["soft", "stiff"]
MECHANICAL, SOFT, STIFF, POOLED = range(4)  # how a life ends, for the kernels


@dataclass(frozen=True)
class Thermal:
    """Temperature `kT` (energy), `attempt_frequency` omega (1/time) and the shape of the barrier.

    Raises InputError for negative or non-finite values and an unknown barrier.
    """

    kT: float = 0.0
    attempt_frequency: float = 1.0
    barrier: Barrier = "soft"

    def __post_init__(self) -> None:
        require_number("kT", self.kT, **NOT_NEGATIVE)
        require_number("attempt_frequency", self.attempt_frequency, **NOT_NEGATIVE)
        require_choice("barrier", self.barrier, ("soft", "stiff"))


# ---------------------------------------------------------------------------------------------- quenched, NumPy


def log_erfi(z: Any) -> Array:
    """ln erfi(z) for z > 0 of any size, through Dawson's function."""
    z = np.asarray(z, float)
    return z**2 + np.log(2.0 / math.sqrt(math.pi) * special.dawsn(z))


def log_rate(barrier: Barrier, x: Any, xi: Any, a: Any) -> Array:
    """ln r of a contact at stretch 0 <= x < xi; a = k_i/(2 kT)."""
    if barrier == "soft":
        return np.asarray(-a * (xi - x) * (xi + x))
    gap = (xi - x) / xi
    return np.asarray(0.5 * np.log(gap) - a * xi**2 * gap**1.5)


def log_hazard(barrier: Barrier, x: Any, xi: Any, a: Any) -> Array:
    """ln H(x) of a contact, 0 < x <= xi."""
    if barrier == "soft":
        root = np.sqrt(a)
        with np.errstate(divide="ignore"):  # x = 0
            return log_rate("soft", x, xi, a) + np.log(special.dawsn(root * x) / root)
    c = np.asarray(a * xi**2, float)
    # exp(-c gap^1.5) - exp(-c) = exp(-c gap^1.5) (1 - exp(-c (1 - gap^1.5)))
    with np.errstate(divide="ignore"):  # x = xi
        gap15 = -np.expm1(1.5 * np.log1p(-x / xi))  # 1 - (1 - x/xi)^1.5 without cancellation
        return math.log(2 / 3) - np.log(a * xi) - c * (1 - gap15) + np.log(-np.expm1(-c * gap15))


# -------------------------------------------------------------------------------------------- quenched, kernels

_SOFT = 2.0 / math.sqrt(math.pi)


@functools.cache
def erfi_inverse_table() -> Array:
    """z as a function of s = ln(1 + erfi(z)): linear at small s, sqrt(s) at large s, up to s = 2^60.

    The relative error is below 5e-10.
    """
    first, last = -30, 60
    s = octave_edges(first, last)
    target = np.where(s > 40, s, np.log(np.expm1(np.minimum(s, 40))))
    z = np.where(s < 1, s * math.sqrt(math.pi) / 2, np.sqrt(s + 1))
    for _ in range(60):  # Newton for ln erfi, whose derivative is 1/dawsn
        z = np.maximum(z - (log_erfi(z) - target) * special.dawsn(z), z / 4)
    return octave_table(first, z, special.dawsn(z) / -np.expm1(-s))


_FLAT = (
    400.0  # exponents are cut here, where ln(1 + y) is ln y to rounding, with room for any factor before y overflows
)

# Inverses in steps, each of which is a loop of its own where many contacts break: a look-up between the others would
# keep them from being vectorised, and in one long loop every result would wait for many before it. The hazard is as
# good as `odds` exp(max(barrier - _FLAT, 0)), which overflows for cold contacts, and so does not exp(-700) < omega/v.


@inlined
def soft_barrier(xi: float, root: float, log_w: float) -> float:
    """a xi^2 - ln(omega/v), root = sqrt(a)."""
    top = root * xi
    return top * top - log_w


@inlined
def soft_odds(xi: float, root: float, log_w: float, clock: float) -> float:
    """erfi(root x) of the x where exp(log_w) H(x) = clock, but for what of the barrier is beyond _FLAT."""
    return _SOFT * clock * root * bounded_exp(min(soft_barrier(xi, root, log_w), _FLAT))


@inlined
def soft_rank(xi: float, root: float, log_w: float, odds: float) -> float:
    """ln(1 + erfi(root x)) of the same x."""
    return log_one_plus(odds) + max(soft_barrier(xi, root, log_w) - _FLAT, 0.0)


@inlined
def soft_end(xi: float, per_root: float, z: float) -> float:
    """Where a soft contact breaks, z = root x; per_root = 1/root. Past the table it is xi, to double precision."""
    return min(xi, z * per_root + (math.inf if z > 1e9 else 0.0))


@inlined
def soft_stretch(erfi_inverse: Array, xi: float, a: float, log_w: float, clock: float) -> float:
    """Where a soft contact breaks: exp(log_w) H(x) = clock or x = xi; log_w = ln(omega/v)."""
    root = math.sqrt(a)
    rank = soft_rank(xi, root, log_w, soft_odds(xi, root, log_w, clock))
    return soft_end(xi, 1.0 / root, look_up(erfi_inverse, rank))


@inlined
def stiff_odds(xi: float, a: float, log_w: float, clock: float) -> float:
    """exp(a xi^2 (1 - (1 - x/xi)^(3/2))) - 1 of the x where exp(log_w) H(x) = clock, as in `soft_odds`."""
    return 1.5 * a * xi * clock * bounded_exp(min(a * xi * xi - log_w, _FLAT))


@inlined
def stiff_spent(xi: float, a: float, log_w: float, odds: float) -> float:
    """1 - (1 - x/xi)^(3/2) of the same x, or more than 1."""
    barrier = a * xi * xi
    return (log_one_plus(odds) + max(barrier - log_w - _FLAT, 0.0)) / barrier


@inlined
def stiff_end(xi: float, spent: float) -> float:
    """Where a stiff contact breaks."""
    q = two_thirds_power(max(1.0 - spent, 1e-17))
    x = xi * spent * (2.0 - spent) / (1.0 + q + q * q)  # 1 - q without cancellation
    return min(x, xi) if spent < 1.0 else xi


@inlined
def stiff_stretch(xi: float, a: float, log_w: float, clock: float) -> float:
    """Where a stiff contact breaks: exp(log_w) H(x) = clock or x = xi."""
    return stiff_end(xi, stiff_spent(xi, a, log_w, stiff_odds(xi, a, log_w, clock)))


# ----------------------------------------------------------------------------------------------------- annealed


class PooledHazard(NamedTuple):
    """The pooled integrated hazard G(x) = int_0^x h dy and its inverse: nodes, shape (nodes,), and the slope
    d ln x/d ln G at the left and right end of each cell between them, shape (nodes - 1, 2). In logarithms the inverse
    is a straight line where G is a power of x, and nearly one where G rises exponentially towards a threshold."""

    x: Array
    G: Array
    slopes: Array


NO_POOL = PooledHazard(np.empty(0), np.empty(0), np.empty((0, 2)))
MOST_POOLED_STEPS = 4096


def pooled_rate(law: ThresholdLaw, stiffness: StiffnessLaw, barrier: Barrier, b: float, y: Array) -> Array:
    """h(y) of a smooth law (temper11, temper12 without omega/v), y and 1/h in units of `law.scale`, to 1e-8 relative.

    Gauss-Legendre panels over xi' > y follow the law and the layer next to y, of width 1/(2 b y) for large b, in which
    attempts succeed.
    """
    rms, y = law.rms / law.scale, np.asarray(y, float)
    weak = np.append(law.exceeded_by(_WEAK) / law.scale, _steep(law))  # attempts may succeed on these
    layer = y[:, None] + _layer(stiffness, barrier, b, rms, y)
    edges = panels_above(law, y, np.concatenate((layer, np.broadcast_to(weak, (y.size, weak.size))), axis=1))
    half = 0.5 * np.diff(edges, axis=1)[:, :, None]
    beyond = edges[:, :-1, None] - y[:, None, None] + half * (1.0 + _NODES)  # xi' - y without cancellation
    y = y[:, None, None]
    xi = y + beyond
    a = b * relative_stiffness(stiffness, xi, rms)
    with np.errstate(divide="ignore", invalid="ignore"):
        if barrier == "soft":
            log_r = -a * beyond * (beyond + 2 * y)
        else:
            log_r = 0.5 * np.log(beyond / xi) - a * xi**2 * (beyond / xi) ** 1.5
        terms = law.pdf(xi * law.scale) * law.scale * np.exp(log_r) * half * _WEIGHTS
    return np.asarray(np.where((half > 0) & np.isfinite(terms), terms, 0.0).sum(axis=(1, 2)))


_NODES, _WEIGHTS = special.roots_legendre(8)
_WEAK = 10.0 ** -np.array([7.0, 9.0, 12.0, 17.0, 25.0, 37.0, 55.0, 80.0, 120.0, 180.0, 270.0])  # ranks e
_EXPONENTS = np.array([1e-9, 1e-6, 1e-4, 3e-3, 0.03, 0.2, 0.7, 1.5, 3.0, 5.0, 8.0, 12.0, 18.0, 26.0, 40.0])


def _steep(law: ThresholdLaw) -> Array:
    """Thresholds, in factors of 4 of their distance from the least one, of a law with so many weak contacts that its
    density may be infinite there; none of other laws."""
    low = law.support[0] / law.scale
    least = max(float(law.exceeded_by(1e-10)) / law.scale - low, 1e-15 * low, 1e-100)
    return low + 4.0 ** np.arange(math.log(least, 4.0), 0.0) if least < 1e-6 else NO_STEPS


def _layer(stiffness: StiffnessLaw, barrier: Barrier, b: float, rms: float, y: Array) -> Array:
    """Distances xi' - y at which the exponent of the rate is about each of `_EXPONENTS`, were xi' near y, or were it
    far from it, shape (n, 2 exponents): only panels depend on it."""
    a, y = np.maximum(b * relative_stiffness(stiffness, y, rms), 1e-300)[:, None], y[:, None]
    if barrier == "soft":
        near = (_EXPONENTS / a) / (y + np.sqrt(y**2 + _EXPONENTS / a))
    else:
        near = y * np.minimum((_EXPONENTS / (a * y**2)) ** (2.0 / 3.0), 1e6)
    far = np.cbrt(_EXPONENTS * rms / b) if stiffness == "sqrt" else np.sqrt(_EXPONENTS / b)
    return np.concatenate((near, np.broadcast_to(far[4:], (y.size, far.size - 4))), axis=1)


def pooled_hazard(law: ThresholdLaw, stiffness: StiffnessLaw, barrier: Barrier, b: float) -> PooledHazard:
    """G and its inverse for the annealed ensemble, lengths in units of `law.scale`; Delta U = (omega/v) G (nt09).

    Relative error of the inverse: below 2e-7 for smooth laws, 1e-4 where the support of the law has an edge; for
    discrete laws, in the mean over clocks, below 1e-2 of the distance between neighbours (1e-4 up to 64 thresholds).
    Raises InputError for a discrete law of more than 4096 thresholds.
    """
    if law.steps.size:
        return _pooled_steps(law, stiffness, barrier, b)
    low, high = (edge / law.scale for edge in law.support)
    top = min(float(law.exceeded_by(60.0)) / law.scale, high)
    toward = 2.0 ** -np.arange(0.0, 46.0, 0.125)  # the ends of the support are approached from both sides
    linear = 1e-2 * min(1.0, 1.0 / b)  # G is nearly proportional to y up to here
    first = min([1e-14, *_steep(law)[:1]]) if low == 0 else 1e-14
    nodes = [np.geomspace(first, linear, 200), np.linspace(0.0, top, 1500)]
    nodes.append(4.0 ** np.arange(math.log(first, 4.0), math.log(1e-14, 4.0), 0.125))  # of rates that are not constant
    nodes.append(np.geomspace(linear, top, math.ceil(math.log(top / linear) / 0.01)))
    if low > 0:  # below the support the rate falls off as exp(-b (low^2 - y^2)): resolve its exponent
        nodes.append(low - low * 2.0 ** -np.arange(0.0, min(46.0, 14.0 + math.log2(1.0 + b)), 1 / 32))
        nodes.append(low + (top - low) * toward)
    if math.isfinite(high):
        nodes.append(top - (top - low) * toward)
    y = np.unique(np.concatenate(nodes))
    y = y[y >= first]
    if low == 0 and math.isinf(high) and not law.breakpoints.size:  # h is smooth
        y = np.unique(np.append(y, np.asarray(law.exceeded_by(_RANKS)) / law.scale))
        y = y[(y >= first) & (y <= top)]
        h = pooled_rate(law, stiffness, barrier, b, y)
        y, h = y[h > 1e-300], h[h > 1e-300]
        if y.size < 2:
            return NO_POOL
        log_y, log_h = np.log(y), np.log(h)
        rate = interpolate.CubicSpline(log_y, log_h)  # the rate may rise by factors of 1e8 between neighbours
        parts = np.maximum(np.ceil(np.abs(np.diff(log_h)) / _RISE), 1.0)
        at = np.interp(np.arange(parts.sum() + 1), np.append(0.0, np.cumsum(parts)), log_y)
        return _pooled_cells(at, lambda x: np.exp(rate(x)))
    return _pooled_cells(np.log(y), lambda x: pooled_rate(law, stiffness, barrier, b, np.exp(x)))


def _pooled_cells(log_y: Array, rate: Callable[[Array], Array]) -> PooledHazard:
    """G at nodes ln y, between which 3 points of the rate, a function of ln y, will do."""
    half = 0.5 * np.diff(log_y)[:, None]
    inner = log_y[:-1, None] + half * (1.0 + _FEW_NODES)
    cells = half * _FEW_WEIGHTS * np.exp(inner) * rate(inner.ravel()).reshape(inner.shape)
    y, h = np.exp(log_y), rate(log_y)
    return _pool(y, y[0] * h[0] + np.append(0.0, np.cumsum(cells.sum(axis=1))), h, h)


_FEW_NODES, _FEW_WEIGHTS = special.roots_legendre(3)
_RISE = 0.25  # of ln h between nodes
_Z = np.arange(-37.0, 10.0, 0.05)
_RANKS = np.where(_Z < 0, -np.log1p(-np.minimum(special.ndtr(_Z), 0.5)), -special.log_ndtr(-_Z))  # e of nodes


def _pooled_steps(law: ThresholdLaw, stiffness: StiffnessLaw, barrier: Barrier, b: float) -> PooledHazard:
    """G of equally likely thresholds: a mean of closed forms, at nodes that crowd towards each threshold from below,
    where the rate of attempts on it rises to 1, and if the next one is far away also from above, where it is gone."""
    xi = np.unique(law.steps) / law.scale
    if xi.size > MOST_POOLED_STEPS:
        raise InputError(
            f"thresholds: {xi.size} different values; annealed disorder at kT > 0 takes at most {MOST_POOLED_STEPS}"
        )
    weight = np.unique(law.steps, return_counts=True)[1] / law.steps.size
    a = b * relative_stiffness(stiffness, xi, law.rms / law.scale)
    fine = 8 if xi.size <= 64 else 4 if xi.size <= 512 else 1  # nodes per halving of the distance to a threshold
    nodes = [xi[0] * 2.0 ** -np.arange(0.0, 50.0, 0.25)]  # from the linear beginning
    for low, high, scale in zip(np.append(0.0, xi[:-1]), xi, 2 * a * xi, strict=True):
        depth = 12 + math.ceil(math.log2(max(scale * (high - low), 1.0)))  # down to a fraction of the layer
        nodes.append(high - (high - low) * np.append(2.0 ** (-np.arange(1, depth * fine) / fine), 0.0))
        if low and high - low > low / 16:  # G grows by a constant rate: no power of x
            nodes.append(low + (high - low) * 2.0 ** -np.arange(0.125, math.log2(16 * (high / low - 1.0)) + 1.0, 0.125))
    y = np.unique(np.concatenate(nodes))
    G, left, right = np.zeros(y.size), np.zeros(y.size), np.zeros(y.size)
    for j in range(xi.size):
        k = np.searchsorted(y, xi[j])
        G[:k] += weight[j] * np.exp(log_hazard(barrier, y[:k], xi[j], a[j]))
        G[k:] += weight[j] * np.exp(log_hazard(barrier, xi[j], xi[j], a[j]))
        with np.errstate(divide="ignore"):  # a stiff contact's rate ends at 0
            rate = weight[j] * np.exp(log_rate(barrier, y[: k + 1], xi[j], a[j]))
        left[: k + 1] += rate  # the rate drops at each threshold
        right[:k] += rate[:-1]
    return _pool(y, G, left, right)


def _pool(x: Array, G: Array, left: Array, right: Array) -> PooledHazard:
    """From h just left and right of each node: drop nodes that cannot be told apart, and keep the interpolant monotone
    (Fritsch and Carlson)."""
    keep = np.append(True, np.diff(G) > 0) & (G > 1e-290)
    x, G = x[keep], G[keep]
    with np.errstate(divide="ignore", over="ignore", invalid="ignore"):  # neighbours whose logarithms are the same
        limit = 3.0 * np.diff(np.log(x)) / np.diff(np.log(G))
        left, right = G / (x * left[keep]), G / (x * right[keep])
    return PooledHazard(x, G, np.fmin(np.stack((right[:-1], left[1:]), axis=1), limit[:, None]))


@inlined
def pooled_stretch(x: Array, G: Array, slopes: Array, target: float) -> float:
    """Where G = target; infinite if G never gets there."""
    last = G.size - 1
    if target >= G[last]:
        return math.inf
    if target <= G[0]:
        return x[0] * (target / G[0])
    low, high = 0, last
    while high - low > 1:
        middle = (low + high) >> 1
        if G[middle] <= target:
            low = middle
        else:
            high = middle
    width, rise = math.log(G[high] / G[low]), math.log(x[high] / x[low])
    t = math.log(target / G[low]) / width
    left, right = slopes[low, 0] * width, slopes[low, 1] * width
    return x[low] * math.exp(t * (left + t * (3.0 * rise - 2.0 * left - right + t * (left + right - 2.0 * rise))))
