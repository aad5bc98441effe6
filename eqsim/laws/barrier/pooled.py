"""Annealed contacts: every attempt draws a fresh threshold xi' and needs xi' > x; contacts share one pooled rate

    h(x) = int_x^inf P_c(xi') r(x|xi') dxi',    G(x) = int_0^x h dy

(h is H v/omega of temper11 and temper12 of Braun and Peyrard, 2011, for any barrier; G v/omega is Delta U, nt09).
"""

import functools
import math
from collections.abc import Callable
from typing import Any, ClassVar, NamedTuple

import numpy as np
from scipy import interpolate, special

from eqsim.errors import InputError
from eqsim.laws.barrier.base import Barrier, back, hazard, onward, rate, stretch, stretches
from eqsim.laws.stiffness import StiffnessLaw, relative_stiffness
from eqsim.laws.threshold import NO_STEPS, ThresholdLaw, panels_above
from eqsim.numerics.compiled import inlined, routine
from eqsim.numerics.tables import Array


class PooledHazard(NamedTuple):
    """The pooled integrated hazard G(x) = int_0^x h dy and its inverse: nodes, shape (nodes,), and the slope
    d ln x/d ln G at the left and right end of each cell between them, shape (nodes - 1, 2). In logarithms the inverse
    is a straight line where G is a power of x, and nearly one where G rises exponentially towards a threshold."""

    x: Array
    G: Array
    slopes: Array


NO_POOL = PooledHazard(np.empty(0), np.empty(0), np.empty((0, 2)))
MOST_POOLED_STEPS = 4096


def pooled_rate(law: ThresholdLaw, stiffness: StiffnessLaw, barrier: type[Barrier], b: float, y: Array) -> Array:
    """h(y) of a smooth law (temper11, temper12 without omega/v), y and 1/h in units of `law.scale`, to 1e-8 relative.

    Gauss-Legendre panels over xi' > y follow the law and the layer next to y, of width 1/(2 b y) for large b, in which
    attempts succeed.
    """
    rms, y = law.rms / law.scale, np.asarray(y, float)
    weak = np.append(law.inverse_survival(_WEAK) / law.scale, _steep(law))  # attempts may succeed on these
    layer = y[:, None] + _layer(stiffness, barrier, b, rms, y)
    edges = panels_above(law, y, np.concatenate((layer, np.broadcast_to(weak, (y.size, weak.size))), axis=1))
    half = 0.5 * np.diff(edges, axis=1)[:, :, None]
    beyond = edges[:, :-1, None] - y[:, None, None] + half * (1.0 + _NODES)  # xi' - y without cancellation
    y = y[:, None, None]
    xi = y + beyond
    a = b * relative_stiffness(stiffness, xi, rms)
    with np.errstate(divide="ignore", invalid="ignore"):
        log_r = barrier.log_attempt(beyond, beyond + 2 * y, xi, a)
        terms = law.pdf(xi * law.scale) * law.scale * np.exp(log_r) * half * _WEIGHTS
    return np.asarray(np.where((half > 0) & np.isfinite(terms), terms, 0.0).sum(axis=(1, 2)))


_NODES, _WEIGHTS = special.roots_legendre(8)
_WEAK = 10.0 ** -np.array([7.0, 9.0, 12.0, 17.0, 25.0, 37.0, 55.0, 80.0, 120.0, 180.0, 270.0])  # ranks e
_EXPONENTS = np.array([1e-9, 1e-6, 1e-4, 3e-3, 0.03, 0.2, 0.7, 1.5, 3.0, 5.0, 8.0, 12.0, 18.0, 26.0, 40.0])


def _steep(law: ThresholdLaw) -> Array:
    """Thresholds, in factors of 4 of their distance from the least one, of a law with so many weak contacts that its
    density may be infinite there; none of other laws."""
    low = law.support[0] / law.scale
    least = max(float(law.inverse_survival(1e-10)) / law.scale - low, 1e-15 * low, 1e-100)
    return low + 4.0 ** np.arange(math.log(least, 4.0), 0.0) if least < 1e-6 else NO_STEPS


def _layer(stiffness: StiffnessLaw, barrier: type[Barrier], b: float, rms: float, y: Array) -> Array:
    """Distances xi' - y at which the exponent of the rate is about each of `_EXPONENTS`, were xi' near y, or were it
    far from it, shape (n, 2 exponents): only panels depend on it."""
    a, y = np.maximum(b * relative_stiffness(stiffness, y, rms), 1e-300)[:, None], y[:, None]
    near = barrier.width(_EXPONENTS, y, a)
    far = np.cbrt(_EXPONENTS * rms / b) if stiffness == "sqrt" else np.sqrt(_EXPONENTS / b)
    return np.concatenate((near, np.broadcast_to(far[4:], (y.size, far.size - 4))), axis=1)


def pooled_hazard(law: ThresholdLaw, stiffness: StiffnessLaw, barrier: type[Barrier], b: float) -> PooledHazard:
    """G and its inverse for the annealed ensemble, lengths in units of `law.scale`; Delta U = (omega/v) G (nt09).

    Relative error of the inverse: below 2e-7 for smooth laws, 1e-4 where the support of the law has an edge; for
    discrete laws, in the mean over clocks, below 1e-2 of the distance between neighbours (1e-4 up to 64 thresholds).
    Raises InputError for a discrete law of more than 4096 thresholds.
    """
    if law.steps.size:
        return _pooled_steps(law, stiffness, barrier, b)
    low, high = (edge / law.scale for edge in law.support)
    top = min(float(law.inverse_survival(60.0)) / law.scale, high)
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
        y = np.unique(np.append(y, np.asarray(law.inverse_survival(_RANKS)) / law.scale))
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


def _pooled_steps(law: ThresholdLaw, stiffness: StiffnessLaw, barrier: type[Barrier], b: float) -> PooledHazard:
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
        G[:k] += weight[j] * np.exp(barrier.log_hazard(y[:k], xi[j], a[j]))
        G[k:] += weight[j] * np.exp(barrier.log_hazard(xi[j], xi[j], a[j]))
        with np.errstate(divide="ignore"):  # a stiff contact's rate ends at 0
            rate = weight[j] * np.exp(barrier.log_rate(y[: k + 1], xi[j], a[j]))
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


@functools.lru_cache(maxsize=32)
def pooled_hazard_of(law: ThresholdLaw, stiffness: StiffnessLaw, barrier: type[Barrier], b: float) -> PooledHazard:
    """`pooled_hazard`, remembered: it does not depend on velocity."""
    return pooled_hazard(law, stiffness, barrier, b)


class _Numbers(NamedTuple):
    log_w: float
    x: Array
    G: Array
    slopes: Array


class Pooled(_Numbers):
    """What a kernel needs of annealed contacts: ln(omega x_*/v) and the pooled hazard."""

    __slots__ = ()
    thermal: ClassVar[bool] = True

    def whole_hazard(self, xi: Array, stiffness: Array) -> Array:
        """Delta U(xi), whatever the stiffness."""
        return np.asarray(np.exp(self.log_w) * np.interp(xi, self.x, self.G))


@stretch.register(Pooled)
def _stretch(law: Pooled, table: Array, xi: float, stiffness: float, clock: float) -> float:
    return min(xi, _inverse(law.x, law.G, law.slopes, clock * math.exp(-law.log_w)))


@stretches.register(Pooled)
def _stretches(law: Pooled, table: Array, springs: Any, r: int, lives: Any, row: Array, count: int) -> None:
    stretch, clock, x, G, slopes = lives.stretch, lives.clock, law.x, law.G, law.slopes
    per_attempt = math.exp(-law.log_w)
    for i in range(count):
        stretch[r, i] = min(stretch[r, i], _inverse(x, G, slopes, clock[r, i] * per_attempt))


@hazard.register(Pooled)
def _hazard(law: Pooled, table: Array, xi: float, stiffness: float, x: float) -> float:
    return math.exp(law.log_w) * _hermite(law.x, law.G, law.slopes, x)[0]


@rate.register(Pooled)
def _rate(law: Pooled, xi: float, stiffness: float, x: float) -> float:
    return math.exp(law.log_w) * _hermite(law.x, law.G, law.slopes, x)[1]


@routine
def _hermite(x: Array, G: Array, slopes: Array, stretch: float) -> tuple[float, float]:
    """G and dG/dx at a stretch: the function of which `_inverse` is the inverse."""
    last = G.size - 1
    if last < 0 or stretch <= x[0]:
        return (stretch * G[0] / x[0], G[0] / x[0]) if last >= 0 else (0.0, 0.0)
    if stretch >= x[last]:
        return G[last], 0.0
    low = np.searchsorted(x, stretch, side="right") - 1
    width, rise = math.log(G[low + 1] / G[low]), math.log(x[low + 1] / x[low])
    left, right = slopes[low, 0] * width, slopes[low, 1] * width
    second, third = 3.0 * rise - 2.0 * left - right, left + right - 2.0 * rise
    target = math.log(stretch / x[low])
    below, above, t = 0.0, 1.0, target / rise
    for _ in range(60):  # Newton in a bracket
        excess = t * (left + t * (second + t * third)) - target
        if excess > 0.0:
            above = t
        else:
            below = t
        slope = left + t * (2.0 * second + 3.0 * t * third)
        step = t - excess / slope if slope > 0.0 else 0.5 * (below + above)
        if not below <= step <= above:
            step = 0.5 * (below + above)
        if abs(step - t) <= 1e-15:
            break
        t = step
    value = G[low] * math.exp(t * width)
    slope = left + t * (2.0 * second + 3.0 * t * third)
    return value, value * width / max(slope, 1e-300) / stretch


@inlined
def _inverse(x: Array, G: Array, slopes: Array, target: float) -> float:
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


_SHORT = 1e-3  # travel over stretch below which their difference would be lost in the table


@onward.register(Pooled)
def _onward(law: Pooled, c: Any, xi: float, stiffness: float, y: float, clock: float) -> float:
    ticks = clock * math.exp(-law.log_w)
    G, h = _hermite(law.x, law.G, law.slopes, y)
    s = _inverse(law.x, law.G, law.slopes, G + ticks) - y
    return min(_corrected(law, y, h, ticks, 1.0) if s < _SHORT * y and h > 0.0 else s, xi - y)


@back.register(Pooled)
def _back(law: Pooled, c: Any, xi: float, stiffness: float, y: float, clock: float) -> tuple[float, float]:
    ticks = clock * math.exp(-law.log_w)
    G, h = _hermite(law.x, law.G, law.slopes, y)
    if ticks >= G:
        return y, clock * (1.0 - G / ticks)
    s = y - min(_inverse(law.x, law.G, law.slopes, G - ticks), law.x[law.x.size - 1])  # no attempt succeeds beyond
    return (_corrected(law, y, h, ticks, -1.0) if s < _SHORT * y and h > 0.0 else min(s, y)), -1.0


@routine
def _corrected(law: Pooled, y: float, h: float, ticks: float, sign: float) -> float:
    """The short travel from y in which the rate, h at y, adds up to `ticks`."""
    if ticks <= 0.0:
        return 0.0
    s = ticks / h
    for _ in range(3):
        s = 2.0 * ticks / (h + _hermite(law.x, law.G, law.slopes, y + sign * min(s, 2.0 * _SHORT * y))[1])
    return s
