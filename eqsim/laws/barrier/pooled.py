"""Annealed contacts: every attempt draws a fresh threshold xi' and needs xi' > x;
contacts share one pooled rate

    h(x) = int_x^inf P_c(xi') r(x|xi') dxi',    G(x) = int_0^x h dy

(h is H v/omega of temper11 and temper12 of Braun and Peyrard, 2011, for any barrier; G
v/omega is Delta U, nt09).
"""

import functools
import math
from collections.abc import Callable
from typing import Any, ClassVar, NamedTuple

import numpy as np
from scipy import interpolate

from eqsim.errors import InputError
from eqsim.laws.aging.pooled import PooledThresholds
from eqsim.laws.barrier import base
from eqsim.laws.barrier.base import Barrier
from eqsim.laws.law import Law
from eqsim.laws.stiffness import StiffnessLaw, relative_stiffness
from eqsim.laws.threshold import (
    FAR_RANKS_ABOVE,
    NO_STEPS,
    RANKS_ABOVE,
    Gamma,
    Smooth,
    ThresholdLaw,
    panels_above,
)
from eqsim.numerics.compiled import routine
from eqsim.numerics.quadrature import Rule, gauss_legendre, normal_exponent
from eqsim.numerics.tables import Array, search


class PooledHazard(NamedTuple):
    """The pooled integrated hazard G(x) = int_0^x h dy and its inverse: nodes, shape
    (nodes,), and the slope d ln x/d ln G at the left and right end of each cell between
    them, shape (nodes - 1, 2). In logarithms the inverse is a straight line where G is
    a power of x, and nearly one where G rises exponentially towards a threshold.
    `greatest` bounds the rate h in each cell, shape (nodes - 1,)."""

    x: Array
    G: Array
    slopes: Array
    greatest: Array


NO_POOL = PooledHazard(np.empty(0), np.empty(0), np.empty((0, 2)), np.empty(0))
MOST_POOLED_STEPS = 4096


# Distance of the quantiles exp(-256) and exp(-512) over that of exp(-128) and exp(-256):
# 2 of an exponential tail, 1.4 of a normal one.
_EXPONENTIAL_TAIL = 1.9

# Stretches whose rate is found at once: by panels, to bound memory, and by the
# trapezoidal rule, whose tables then stay in the processor's cache.
_BY_PANELS = 1000
_BY_TRAPEZOID = 200

# The trapezoidal rule of gamma laws: the largest n, the step in u, and a finer one.
_LARGEST_N = 60.0
_TRAPEZOID_STEP = 0.085
_FINER_TRAPEZOID = 0.06
# The largest rise of ln h with the threshold, as exp(30^2) is more than a number holds.
_STEEPEST = 60.0
# The left end in u, where the gap between threshold and stretch is negligible.
_LEFT_END = -3.7

# Panels of other laws end where E has these values, approximated for xi' near y or far.
_EXPONENTS = np.array(
    [1e-3, 0.05, 0.5, 2.0, 5.0, 10.0, 18.0, 28.0, 45.0, 80.0, 140.0, 200.0, 280.0]
)
# Distances from the ends of the support where they end, too.
_NEAR_ENDS = 10.0 ** np.arange(-13.0, 0.0)
# -ln of the shares of weak contacts between which they end: densities may be steep.
_WEAK = math.log(10.0) * np.array(
    [8.0, 10.0, 12.0, 14.0, 17.0, 25.0, 37.0, 55.0, 80.0, 120.0, 180.0, 270.0]
)
# Nodes of a panel, of a finer rule, and in the engine's tables, which need 2e-7; gamma
# laws with n > 60 and pooled laws have only just that with fewer than 10.
_ORDER = 10
_FINER_ORDER = 14
_TABLE_ORDER = 8
# -ln J_c of nodes of a table, and the rise of ln h between nodes.
_NODE_RANKS = normal_exponent(np.arange(-37.0, 10.0, 0.05))
_RISE_OF_RATE = 0.25
# Rate at a point over its mean in a cell; only where G grows by less than 1e-9 of
# itself, that is by rounding, may the interpolant be steeper.
_MOST_OVER_MEAN = 64.0
# ln of the successful attempts per unit displacement that do not count.
_UNSEEN_ATTEMPTS = -45.0


def pooled_rate(
    law: ThresholdLaw,
    stiffness: StiffnessLaw,
    barrier: Barrier,
    b: float,
    y: Array,
    log_w: float = math.inf,
    *,
    finer: bool = False,
    order: int | None = None,
) -> Array:
    """h(y) of a smooth law (temper11, temper12 without omega/v), lengths in units of
    `law.scale`, shape (n,).

    To about 1e-12 for gamma laws and 1e-10 for most others; a `finer` rule, or one of
    another `order` where there are panels, tells the error. Attempts that succeed less
    often than exp(-45) per unit displacement at ln(omega x_*/v) = `log_w` may be left
    out.
    """
    y = np.asarray(y, float)
    trapezoid = isinstance(law, Gamma) and law.n <= _LARGEST_N
    count = _BY_TRAPEZOID if trapezoid else _BY_PANELS
    parts = np.split(y, range(count, y.size, count))
    if isinstance(law, Gamma) and trapezoid:
        step = _FINER_TRAPEZOID if finer else _TRAPEZOID_STEP
        found = [_trapezoid(law, stiffness, barrier, b, part, step) for part in parts]
    else:
        if barrier.by_force and stiffness == "sqrt" and not has_thin_tail(law):
            raise InputError(
                f"thresholds = {law}: strong contacts are too many for annealed bonds "
                'of stiffness_law = "sqrt": off-rates have no mean; take "uniform"'
            )
        rule = gauss_legendre(order or (_FINER_ORDER if finer else _ORDER))
        weak = np.exp(-_WEAK[log_w > _WEAK + _UNSEEN_ATTEMPTS])
        ends = _ends_of_panels(law, weak)
        found = [
            _by_panels(law, stiffness, barrier, b, part, ends, rule, log_w)
            for part in parts
        ]
    return np.concatenate(found)


def _trapezoid(
    law: Gamma,
    stiffness: StiffnessLaw,
    barrier: Barrier,
    b: float,
    y: Array,
    step: float,
) -> Array:
    """h(y) of a gamma law by the trapezoidal rule in u, xi' - y = gap exp(u - exp(-u)),
    which converges exponentially: gap is the distance over which the rate of attempts
    or the law falls. Thirty times faster than panels."""
    n, rms = law.n, law.rms / law.scale
    wide = math.cbrt(rms / b) if stiffness == "sqrt" else 1.0 / math.sqrt(b)
    origin = np.maximum(y, 1e-3 * min(wide, 1.0))
    a = np.maximum(b * relative_stiffness(stiffness, origin, rms), 1e-300)
    gap = barrier.width(1.0, origin, a)
    if not barrier.by_force:
        gap = np.minimum(gap, wide)
    gap = (1.0 / (1.0 / gap + 2.0 * y + 1.0))[:, None]
    far, steep = 50.0 + 6.0 * n, 0.0
    if barrier.by_force and stiffness == "sqrt":  # exp(steep xi) times a normal tail
        steep = min(b * float(y.max()) / rms, _STEEPEST)
        far += (0.5 * steep + 10.0) / float(gap.min())
    step /= math.sqrt(1.0 + 0.25 * n + (0.1 * steep) ** 2)
    u = np.arange(_LEFT_END, math.log(far), step)
    beyond, y = gap * np.exp(u - np.exp(-u)), y[:, None]
    xi = y + beyond
    a = b * relative_stiffness(stiffness, xi, rms)
    log_terms = (1.0 + 2.0 * n) * np.log(xi) - xi**2
    log_terms += barrier.log_attempt(beyond, beyond + 2 * y, xi, a)
    terms = np.exp(log_terms) * beyond
    factor = 2.0 * math.exp(-math.lgamma(n + 1.0)) * (u[1] - u[0])
    return np.asarray(terms @ (1.0 + np.exp(-u))) * factor


def _ends_of_panels(law: ThresholdLaw, weak: Array) -> Array:
    """Thresholds next to the ends of the support, and those below which there are
    shares `weak` of the contacts: panels end there at any stretch."""
    least, greatest = law.support[0] / law.scale, law.support[1] / law.scale
    upper = greatest - _NEAR_ENDS if math.isfinite(greatest) else np.empty(0)
    weakest = np.asarray(law.inverse_survival(weak)) / law.scale
    return np.concatenate((least + _NEAR_ENDS, upper, weakest, _steep(law)))


def _by_panels(
    law: ThresholdLaw,
    stiffness: StiffnessLaw,
    barrier: Barrier,
    b: float,
    y: Array,
    ends: Array,
    rule: Rule,
    log_w: float,
) -> Array:
    """h(y) by Gauss-Legendre panels in sqrt(xi' - y), so that the rate of stiff
    contacts is smooth at their thresholds; panels end at exponents of the barrier."""
    rms, y = law.rms / law.scale, y[:, None]

    def contact(x: Array, root: Array) -> tuple[Array, Array, Array, Array]:
        """Arguments of the barrier at stretch x and threshold x + root^2."""
        xi, beyond = x + root**2, root**2
        return beyond, beyond + 2.0 * x, xi, b * relative_stiffness(stiffness, xi, rms)

    origin = np.maximum(y, law.support[0] / law.scale)
    a = np.maximum(b * relative_stiffness(stiffness, origin, rms), 1e-300)
    sqrt_law = stiffness == "sqrt"
    far = np.cbrt(_EXPONENTS * rms / b) if sqrt_law else np.sqrt(_EXPONENTS / b)
    with np.errstate(divide="ignore", over="ignore"):
        near = barrier.width(_EXPONENTS, origin, a)
    fixed = np.broadcast_to(ends, (y.size, ends.size))
    layer = np.concatenate((origin + np.minimum(near, far), fixed), axis=1)
    ranks = FAR_RANKS_ABOVE if barrier.by_force and sqrt_law else RANKS_ABOVE
    above = panels_above(law, y[:, 0], layer, ranks)
    edges = np.sqrt(np.maximum(above - y, 0.0))
    with np.errstate(invalid="ignore"):  # at y = 0 the first edge is xi = 0
        E = barrier.exponent(*contact(y, edges[:, :-1]))
        unseen = log_w - E <= _UNSEEN_ATTEMPTS
    row, column = np.nonzero((np.diff(edges, axis=1) > 0) & ~unseen)
    half = 0.5 * (edges[row, column + 1] - edges[row, column])[:, None]
    root = edges[row, column, None] + half * (1.0 + rule.nodes)
    at = contact(y[row], root)
    terms = half * rule.weights * 2.0 * root * np.exp(barrier.log_attempt(*at))
    with np.errstate(invalid="ignore"):
        terms *= law.pdf(at[2] * law.scale) * law.scale
    terms[~np.isfinite(terms)] = 0.0  # the density may diverge at an end of the support
    return np.bincount(row, terms.sum(axis=1), y.size)


def has_thin_tail(law: ThresholdLaw) -> bool:
    """True unless rates that grow exponentially with the threshold have no mean, as
    thresholds have an exponential tail or a heavier one."""
    mixed_gammas = isinstance(law, PooledThresholds)  # their tail is a normal one
    if mixed_gammas or math.isfinite(law.support[1]):
        return True
    near, middle, far = law.inverse_survival(np.array([128.0, 256.0, 512.0]))
    return bool(far - middle <= _EXPONENTIAL_TAIL * (middle - near))


def _steep(law: ThresholdLaw) -> Array:
    """Thresholds, in factors of 4 of their distance from the least one, of a law with
    so many weak contacts that its density may be infinite there; none of other laws."""
    low = law.support[0] / law.scale
    weakest = float(law.inverse_survival(1e-10)) / law.scale
    least = max(weakest - low, 1e-15 * low, 1e-100)
    towards = low + 4.0 ** np.arange(math.log(least, 4.0), 0.0)
    return towards if least < 1e-6 else NO_STEPS


def pooled_hazard(
    law: ThresholdLaw, stiffness: StiffnessLaw, barrier: Barrier, b: float
) -> PooledHazard:
    """G and its inverse for the annealed ensemble, lengths in units of `law.scale`;
    Delta U = (omega/v) G (nt09).

    Relative error of the inverse: below 2e-7 for smooth laws, 1e-4 where the support of
    the law has an edge; for discrete laws, in the mean over clocks, below 1e-2 of the
    distance between neighbours (1e-4 up to 64 thresholds). Raises InputError for a
    discrete law of more than 4096 thresholds.
    """
    if law.steps.size:
        return _pooled_steps(law, stiffness, barrier, b)

    def rate(y: Array) -> Array:
        order = _TABLE_ORDER if isinstance(law, Smooth) else None
        return pooled_rate(law, stiffness, barrier, b, y, order=order)

    low, high = (edge / law.scale for edge in law.support)
    top = min(float(law.inverse_survival(60.0)) / law.scale, high)
    # the ends of the support are approached from both sides
    toward = 2.0 ** -np.arange(0.0, 46.0, 0.125)
    linear = 1e-2 * min(1.0, 1.0 / b)  # G is nearly proportional to y up to here
    steep = min([1e-14, *_steep(law)[:1]]) if low == 0 else 1e-14
    first = min(steep, 0.1 * linear)
    nodes = [np.geomspace(first, linear, 200), np.linspace(0.0, top, 1500)]
    # further nodes where the rate is not constant near 0
    nodes.append(4.0 ** np.arange(math.log(steep, 4.0), math.log(1e-14, 4.0), 0.125))
    nodes.append(np.geomspace(linear, top, math.ceil(math.log(top / linear) / 0.01)))
    if low > 0:
        # below the support the rate falls off as exp(-b (low^2 - y^2)): resolve its
        # exponent
        halvings = min(46.0, 14.0 + math.log2(1.0 + b))
        nodes.append(low - low * 2.0 ** -np.arange(0.0, halvings, 1 / 32))
        nodes.append(low + (top - low) * toward)
    if math.isfinite(high):
        nodes.append(top - (top - low) * toward)
    y = np.unique(np.concatenate(nodes))
    y = y[y >= first]
    if low == 0 and math.isinf(high) and not law.breakpoints.size:  # h is smooth
        more = np.asarray(law.inverse_survival(_NODE_RANKS)) / law.scale
        y = np.unique(np.append(y, more))
        y = y[(y >= first) & (y <= top)]
        h = rate(y)
        y, h = y[h > 1e-300], h[h > 1e-300]
        if y.size < 2:
            return NO_POOL
        log_y, log_h = np.log(y), np.log(h)
        # the rate may rise by factors of 1e8 between neighbours
        log_rate = interpolate.CubicSpline(log_y, log_h)
        parts = np.maximum(np.ceil(np.abs(np.diff(log_h)) / _RISE_OF_RATE), 1.0)
        ends = np.append(0.0, np.cumsum(parts))
        at = np.interp(np.arange(parts.sum() + 1), ends, log_y)
        return _pooled_cells(at, lambda x: np.exp(log_rate(x)))
    return _pooled_cells(np.log(y), lambda x: rate(np.exp(x)))


def _pooled_cells(log_y: Array, rate: Callable[[Array], Array]) -> PooledHazard:
    """G at nodes ln y, from three points of the rate, a function of ln y, in between."""
    inner, weights = gauss_legendre(3).between(log_y[:-1], log_y[1:])
    cells = weights * np.exp(inner) * rate(inner.ravel()).reshape(inner.shape)
    y, h = np.exp(log_y), rate(log_y)
    G = y[0] * h[0] + np.append(0.0, np.cumsum(cells.sum(axis=1)))
    return _monotone(y, G, h, h)


def _pooled_steps(
    law: ThresholdLaw, stiffness: StiffnessLaw, barrier: Barrier, b: float
) -> PooledHazard:
    """G of equally likely thresholds: a mean of closed forms, at nodes that crowd
    towards each threshold from below, where the rate of attempts on it rises to 1, and
    if the next one is far away also from above, where it is gone."""
    xi = np.unique(law.steps) / law.scale
    if xi.size > MOST_POOLED_STEPS:
        raise InputError(
            f"thresholds: {xi.size} different values; annealed disorder at kT > 0 takes "
            f"at most {MOST_POOLED_STEPS}"
        )
    weight = np.unique(law.steps, return_counts=True)[1] / law.steps.size
    a = b * relative_stiffness(stiffness, xi, law.rms / law.scale)
    # nodes per halving of the distance to a threshold
    fine = 8 if xi.size <= 64 else 4 if xi.size <= 512 else 1
    nodes = [xi[0] * 2.0 ** -np.arange(0.0, 50.0, 0.25)]  # from the linear beginning
    for low, high, scale in zip(np.append(0.0, xi[:-1]), xi, 2 * a * xi, strict=True):
        gap = high - low
        # down to a fraction of the layer
        depth = 12 + math.ceil(math.log2(max(scale * gap, 1.0)))
        halved = 2.0 ** (-np.arange(1, depth * fine) / fine)
        nodes.append(high - gap * np.append(halved, 0.0))
        if low and gap > low / 16:  # G grows by a constant rate: no power of x
            last = math.log2(16 * (high / low - 1.0)) + 1.0
            nodes.append(low + gap * 2.0 ** -np.arange(0.125, last, 0.125))
    y = np.unique(np.concatenate(nodes))
    G = mean_hazard(barrier, y, xi, weight, a)
    left, right = np.zeros(y.size), np.zeros(y.size)
    for j in range(xi.size):
        k = np.searchsorted(y, xi[j])
        rate = weight[j] * np.exp(barrier.log_rate(y[: k + 1], xi[j], a[j]))
        left[: k + 1] += rate  # the rate drops at each threshold
        right[:k] += rate[:-1]
    return _monotone(y, G, left, right)


def mean_hazard(barrier: Barrier, y: Array, xi: Array, share: Array, a: Array) -> Array:
    """G at ascending stretches y of a discrete law, a mean of closed forms: thresholds
    xi with their shares and a, lengths in units of the law's scale."""
    G = np.zeros(y.size)
    for threshold, part, steepness in zip(xi, share, a, strict=True):
        k = np.searchsorted(y, threshold)
        G[:k] += part * np.exp(barrier.log_hazard(y[:k], threshold, steepness))
        G[k:] += part * np.exp(barrier.log_hazard(threshold, threshold, steepness))
    return G


def _monotone(x: Array, G: Array, left: Array, right: Array) -> PooledHazard:
    """Interpolate G from h just left and right of each node: drop nodes that cannot be
    told apart, and keep the interpolant monotone (Fritsch and Carlson)."""
    keep = np.append(True, np.diff(G) > 0) & (G > 1e-290)
    x, G = x[keep], G[keep]
    # the logarithms of neighbours may be the same
    with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
        limit = 3.0 * np.diff(np.log(x)) / np.diff(np.log(G))
        left, right = G / (x * left[keep]), G / (x * right[keep])
    slopes = np.fmin(np.stack((right[:-1], left[1:]), axis=1), limit[:, None])
    return PooledHazard(x, G, slopes, _greatest_rates(x, G, slopes))


def _greatest_rates(x: Array, G: Array, slopes: Array) -> Array:
    """Bound h = (G/x) d ln G/d ln x in each cell: G at its end, x at its beginning, and
    the least slope d ln x/d ln G of the cubic, at an end or where its curvature is 0."""
    with np.errstate(all="ignore"):
        width, rise = np.log(G[1:] / G[:-1]), np.log(x[1:] / x[:-1])
        left, right = slopes.T * width
        curve, third = 3.0 * rise - 2.0 * left - right, left + right - 2.0 * rise
        t = np.clip(-curve / (3.0 * third), 0.0, 1.0)
        inside = left + t * (2.0 * curve + 3.0 * t * third)
        least = np.fmin(np.minimum(left, right), inside)
        bound = G[1:] / x[:-1] * (width / np.maximum(least, 0.0))
        return np.fmin(bound, _MOST_OVER_MEAN * (np.diff(G) / np.diff(x)))


# It takes 0.1 to 0.3 s, and a sweep over velocity asks for it at every point; 32 tables
# are some 3 MB.
@functools.lru_cache(maxsize=32)
def pooled_hazard_of(
    law: ThresholdLaw, stiffness: StiffnessLaw, barrier: Barrier, b: float
) -> PooledHazard:
    """Cached `pooled_hazard`, which does not depend on velocity."""
    return pooled_hazard(law, stiffness, barrier, b)


class _PooledNumbers(NamedTuple):
    log_w: float
    x: Array
    G: Array
    slopes: Array
    greatest: Array


class Pooled(_PooledNumbers, Law):
    """Annealed contacts for kernels: ln(omega x_*/v) and the pooled hazard."""

    __slots__ = ()
    thermal: ClassVar[bool] = True

    def whole_hazard(self, xi: Array, stiffness: Array) -> Array:
        """Delta U(xi), whatever the stiffness."""
        return np.asarray(np.exp(self.log_w) * np.interp(xi, self.x, self.G))


# ---- kernels ----


_POINT = 1e-250  # length over stretch in which the rate does not vary


@base.stretch.register(Pooled)
def _pooled_stretch(
    law: Pooled, table: Array, xi: float, stiffness: float, clock: float
) -> float:
    return min(xi, _inverse(law, clock * math.exp(-law.log_w)))


@base.hazard.register(Pooled)
def _pooled_hazard(
    law: Pooled, table: Array, xi: float, stiffness: float, x: float
) -> float:
    return math.exp(law.log_w) * _hermite(law, x)[0]


@base.rate.register(Pooled)
def _pooled_rate(law: Pooled, xi: float, stiffness: float, x: float) -> float:
    return math.exp(law.log_w) * _hermite(law, x)[1]


@base.mean_rate.register(Pooled)
def _pooled_mean_rate(
    law: Pooled, table: Array, xi: float, stiffness: float, x: float, length: float
) -> float:
    if length < _POINT * x or length == 0.0:
        return base.rate(law, xi, stiffness, x)
    return math.exp(law.log_w) * (_rise(law, x, length) / length)


class _Cubic(NamedTuple):
    """ln x as a function of t = ln G between two nodes, over `width`, about some t: ln
    x changes by d (slope + d (curve + d third)) in a step d."""

    width: float
    slope: float
    curve: float
    third: float


@routine(inline=True)
def _cell_at(law: Pooled, low: int) -> _Cubic:
    """The cell that begins at a node, about its beginning, t = 0; it ends at t = 1."""
    width = math.log(law.G[low + 1] / law.G[low])
    rise = math.log(law.x[low + 1] / law.x[low])
    left, right = law.slopes[low, 0] * width, law.slopes[low, 1] * width
    curve = 3.0 * rise - 2.0 * left - right
    return _Cubic(width, left, curve, left + right - 2.0 * rise)


@routine(inline=True)
def _cell_about(cell: _Cubic, t: float) -> _Cubic:
    """A cell about another t."""
    slope = cell.slope + t * (2.0 * cell.curve + 3.0 * t * cell.third)
    return _Cubic(cell.width, slope, cell.curve + 3.0 * t * cell.third, cell.third)


@routine(inline=True)
def _change_in(cell: _Cubic, step: float) -> float:
    """Change of ln x in a step of t."""
    return step * (cell.slope + step * (cell.curve + step * cell.third))


@routine
def _step_of_t(cell: _Cubic, change: float, most: float) -> float:
    """The step of t, at most `most`, in which ln x grows by `change` >= 0, to rounding
    however short: Newton in a bracket."""
    if change == 0.0:
        return 0.0
    below, above = 0.0, most
    step = min(change / cell.slope, most) if cell.slope > 0.0 else 0.5 * most
    for _ in range(60):
        excess = _change_in(cell, step) - change
        if excess > 0.0:
            above = step
        else:
            below = step
        slope = cell.slope + step * (2.0 * cell.curve + 3.0 * step * cell.third)
        better = step - excess / slope if slope > 0.0 else 0.5 * (below + above)
        if not below <= better <= above:
            better = 0.5 * (below + above)
        if abs(better - step) <= 1e-15 * step:
            break
        step = better
    return step


@routine(inline=True)
def _node_below(law: Pooled, stretch: float) -> int:
    """The last node at or below a stretch."""
    return search(law.x, stretch, True) - 1


@routine(inline=True)
def _locate(law: Pooled, low: int, stretch: float) -> tuple[_Cubic, float, float]:
    """The cell that begins at a node, and t and G at a stretch in it."""
    cell = _cell_at(law, low)
    t = _step_of_t(cell, math.log(stretch / law.x[low]), 1.0)
    return cell, t, law.G[low] * math.exp(t * cell.width)


@routine
def _hermite(law: Pooled, stretch: float) -> tuple[float, float]:
    """G and dG/dx at a stretch: the function of which `_inverse` is the inverse."""
    x, G, last = law.x, law.G, law.G.size - 1
    if last < 0 or stretch <= x[0]:
        return (stretch * G[0] / x[0], G[0] / x[0]) if last >= 0 else (0.0, 0.0)
    if stretch >= x[last]:
        return G[last], 0.0
    low = _node_below(law, stretch)
    cell, t, value = _locate(law, low, stretch)
    rate = value * cell.width / max(_cell_about(cell, t).slope, 1e-300) / stretch
    most = _MOST_OVER_MEAN * ((G[low + 1] - G[low]) / (x[low + 1] - x[low]))
    return value, rate if rate < most else most


@routine
def greatest_between(law: Pooled, low: float, high: float) -> float:
    """Bound on the rate between two stretches: the greatest in the cells they are in
    and between these."""
    x, last = law.x, law.x.size - 1
    if last < 0 or low >= x[last]:
        return 0.0
    most, first = 0.0, 0
    if low < x[0]:
        most = law.G[0] / x[0]
    else:
        first = _node_below(law, low)
    for cell in range(first, last):
        if x[cell] > high:
            break
        most = max(most, law.greatest[cell])
    return math.exp(law.log_w) * most


@routine
def _rise(law: Pooled, stretch: float, length: float) -> float:
    """Growth of G from a stretch on, to rounding however short the length is."""
    x, G, last, end = law.x, law.G, law.G.size - 1, stretch + length
    if last < 0 or stretch >= x[last]:
        return 0.0
    if end <= x[0]:
        return length * (G[0] / x[0])
    total = 0.0
    if stretch < x[0]:
        total, length, stretch = (x[0] - stretch) * (G[0] / x[0]), end - x[0], x[0]
    low = _node_below(law, stretch)
    if end <= x[low + 1]:
        return total + _rise_in(law, low, stretch, length)
    total += _rise_in(law, low, stretch, x[low + 1] - stretch)
    high = _node_below(law, end)
    total += G[high] - G[low + 1]
    return total + _rise_in(law, high, x[high], end - x[high]) if high < last else total


@routine
def _rise_in(law: Pooled, low: int, stretch: float, length: float) -> float:
    """`_rise` within a cell."""
    cell, t, now = _locate(law, low, stretch)
    rest = max(1.0 - t, 0.0)
    step = _step_of_t(_cell_about(cell, t), math.log1p(length / stretch), rest)
    return now * math.expm1(step * cell.width)


@routine(inline=True)
def _inverse(law: Pooled, target: float) -> float:
    """The stretch where G = target; infinite if G never gets there."""
    x, G = law.x, law.G
    if target >= G[G.size - 1]:
        return math.inf
    if target <= G[0]:
        return x[0] * (target / G[0])
    low = search(G, target, True) - 1
    cell = _cell_at(law, low)
    return x[low] * math.exp(_change_in(cell, math.log(target / G[low]) / cell.width))


@base.onward.register(Pooled)
def _pooled_onward(
    law: Pooled, c: Any, xi: float, stiffness: float, y: float, clock: float
) -> float:
    return min(_travel_ahead(law, y, clock * math.exp(-law.log_w)), xi - y)


@routine
def _travel_ahead(law: Pooled, y: float, ticks: float) -> float:
    """The travel from y in which G grows by `ticks`, to rounding however short;
    infinite if it never does."""
    x, G, last, passed = law.x, law.G, law.G.size - 1, 0.0
    if last < 0 or y >= x[last]:
        return math.inf
    if y < x[0]:
        ahead = (x[0] - y) * (G[0] / x[0])
        if ticks <= ahead:
            return ticks * (x[0] / G[0])
        y, ticks, passed = x[0], ticks - ahead, x[0] - y
    low = _node_below(law, y)
    cell, t, now = _locate(law, low, y)
    step = math.log1p(ticks / now) / cell.width
    if step <= 1.0 - t:
        return passed + y * math.expm1(_change_in(_cell_about(cell, t), step))
    return passed + max(_inverse(law, now + ticks) - y, x[low + 1] - y)


@base.back.register(Pooled)
def _pooled_back(
    law: Pooled, c: Any, xi: float, stiffness: float, y: float, clock: float
) -> tuple[float, float]:
    ticks = clock * math.exp(-law.log_w)
    G = _hermite(law, y)[0]
    if ticks >= G:
        return y, clock * (1.0 - G / ticks)
    return min(_behind(law, y, ticks), y), -1.0


@routine
def _behind(law: Pooled, y: float, ticks: float) -> float:
    """The travel back from y in which G falls by `ticks`, less than it is there, to
    rounding however short."""
    x, last, passed = law.x, law.x.size - 1, 0.0
    if y <= x[0]:
        return ticks * (x[0] / law.G[0])
    if y >= x[last]:  # no attempt succeeds beyond
        y, passed = x[last], y - x[last]
    low = min(_node_below(law, y), last - 1)
    cell, t, now = _locate(law, low, y)
    step = -math.log1p(-min(ticks / now, 1.0)) / cell.width
    if step <= t:
        return passed - y * math.expm1(_change_in(_cell_about(cell, t), -step))
    return passed + max(y - _inverse(law, max(now - ticks, 0.0)), y - x[low])
