"""The exact means of a drive in segments, by the renewal equation in two times (derived).

Of the contacts born at time s a share S(t|s) is still pinned at t, with the mean force m(t|s) = (X(t) - X(s)) E[k_i/k;
pinned]. Births B and breaks Gamma per contact and unit time obey

    pinned(t) = S_0(t) + int_0^t B(s) S(t|s) ds,      friction = m_0(t) + int_0^t B(s) m(t|s) ds + (eta v/k)(1 - pinned)
    without delay pinned = 1;      fixed delay: B(t) = Gamma(t - tau);      exponential delay: B = (1 - pinned)/tau

A contact of threshold xi at birth, whose threshold has grown to xi g(age), breaks mechanically where |x| = xi g, so
that the law of thresholds itself says how many of a cohort have, given the greatest |x|/g so far; and thermally at the
rate of `laws.barrier` for |x| and its threshold, which is integrated over a step as if the barrier were linear in time. Cohorts are the births of a step, spread evenly over it, and thresholds are divided into strata. Where heat
breaks no contact, and of annealed contacts, all of a cohort share one hazard and the law of thresholds does the rest.

Lengths are in units of the law's scale, and time is the displacement at a pace of one unit in the whole programme. A
grid and one of twice as many steps and strata give the result, extrapolated as of second order, and its error.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from scipy import ndimage, special
from scipy.interpolate import Akima1DInterpolator

from eqsim.errors import InputError
from eqsim.laws.aging import Unaged
from eqsim.laws.aging.base import stiffness_varies
from eqsim.laws.barrier.base import height, prefactor
from eqsim.laws.delay import Fixed, Waits
from eqsim.laws.stiffness import Springs, kappa
from eqsim.laws.threshold import NO_STEPS, ThresholdLaw
from eqsim.master.annealed import hazard_rate
from eqsim.master.quenched import different_steps, kappa_of
from eqsim.model.drive import Grid, Programme
from eqsim.model.ensemble import Ensemble
from eqsim.model.reduced import Reduced, drag_of, legs, reduced
from eqsim.numerics.compiled import inlined, kernel, maker, routine
from eqsim.numerics.tables import Array
from eqsim.numerics.vector_math import exp, exp_less_one

# of the coarser grid: displacement in a step, in units of the width of the law or of a threshold; a step over the time
# since the velocity changed, and the first one over the shortest time of the contacts; strata and cells of tables
_PATH, _GROWTH, _FIRST, _STRATA, _CELLS = 0.05, 0.12, 0.06, 96, 1000
_MOST_STEPS = 200_000
_SIGMA = (-8.0, 8.2)  # the range of thresholds, in normal deviates
_KINKS = 6  # delays after a change of velocity that steps end at
_GROWN = 0.02  # share of a threshold that it has to grow by before it counts
_CHANGED = 0.5  # share by which the velocity changes where steps begin anew
_PARTS = 12  # of the births of a step where thresholds grow
_GONE, _UNSEEN = 1e-15, 40.0  # pinned shares and -ln of hazards in a step that do not count
_AGES, _DECADES = 20_000, 16  # of the table of growth
_CARRIED = 0.03  # least error, in units of the largest in a programme
_RESOLVED = 2e-6  # relative, what tables and rounding miss


class Strata(NamedTuple):
    """Classes of contacts by threshold at birth, arrays (strata,): the edges, the mean, the share of births, and the
    means of k_i/k and its square."""

    left: Array
    right: Array
    xi: Array
    share: Array
    stiff: Array
    square: Array


class Pool(NamedTuple):
    """At thresholds y, shape (knots,): E[(k_i/k)^p; xi > y] and its integral from 0, p = 0, 1, 2, shape (3, knots); and
    ln of the rate that all contacts share at stretch y."""

    y: Array
    above: Array
    total: Array
    log_rate: Array


class Growth(NamedTuple):
    """By what factor thresholds have grown, at ages in equal ratios from `first` on; `newborn` at age 0."""

    first: float
    per_ratio: float
    newborn: float
    values: Array
    varies: bool


class Contacts(NamedTuple):
    """What a cohort needs to know: either strata or a pool, and laws."""

    strata: Strata
    pool: Pool
    growth: Growth
    barrier: Any
    springs: Springs
    delay: Waits


class Path(NamedTuple):
    """Times and displacements of the edges of steps, arrays (edges,); how wide in X, and in time per age, cohorts may
    become; and how many were born before, at a `velocity`, or none of a fresh start."""

    t: Array
    X: Array
    width: float
    share: float
    cohorts: int
    velocity: float


# ----------------------------------------------------------------------------------------------------------- cohorts

# columns of a cohort: births at the two edges and in the mean, in X and t; the greatest |x|/g so far of the contacts
# born at both edges; and what is pinned, E[k_i/k; pinned], E[(k_i/k)^2; pinned]
_X0, _X1, _XM, _T0, _T1, _TM, _Y0, _Y1, _S, _K1, _K2 = range(11)


@inlined
def _growth(growth: Growth, age: float) -> float:
    if growth.values.size == 0:
        return 1.0
    if age <= growth.first:
        return growth.newborn + (growth.values[0] - growth.newborn) * max(age, 0.0) / growth.first
    at = min(math.log(age / growth.first) * growth.per_ratio, growth.values.size - 1.000001)
    i = int(at)
    return growth.values[i] + (at - i) * (growth.values[i + 1] - growth.values[i])


@inlined
def _below(left: float, right: float, y: float) -> float:
    """int_0^y of the share of a stratum above y."""
    if y <= left:
        return y
    if y >= right:
        return 0.5 * (left + right)
    return y - 0.5 * (y - left) ** 2 / (right - left)


@inlined
def _unbroken(left: float, right: float, low: float, high: float) -> float:
    """Share of a stratum above y, in the mean over low < y < high."""
    if high - low > 1e-9 * high:
        return (_below(left, right, high) - _below(left, right, low)) / (high - low)
    return 1.0 if high <= left and high < right else max(right - high, 0.0) / (right - left) if right > left else 0.0


@routine
def _pooled(pool: Pool, p: int, low: float, high: float) -> float:
    """E[(k_i/k)^p; xi > y] in the mean over low < y < high."""
    i = np.searchsorted(pool.y, high, "right") - 1
    if i >= pool.y.size - 1:
        above, top = 0.0, pool.total[p, pool.y.size - 1]
    else:
        u = high - pool.y[i]
        slope = (pool.above[p, i + 1] - pool.above[p, i]) / (pool.y[i + 1] - pool.y[i])
        above = pool.above[p, i] + slope * u
        top = pool.total[p, i] + u * (pool.above[p, i] + 0.5 * slope * u)
    if high - low <= 1e-9 * high:
        return above
    i = np.searchsorted(pool.y, low, "right") - 1
    if i >= pool.y.size - 1:
        return 0.0
    u = low - pool.y[i]
    slope = (pool.above[p, i + 1] - pool.above[p, i]) / (pool.y[i + 1] - pool.y[i])
    return (top - pool.total[p, i] - u * (pool.above[p, i] + 0.5 * slope * u)) / (high - low)


@inlined
def _mean_exponential(low: float, high: float) -> float:
    """Mean of e^-E while E goes evenly between two values."""
    d = max(abs(high - low), 1e-200)
    return exp(-min(low, high)) * exp_less_one(-min(d, 700.0)) / -d


@routine
def _log_pooled_rate(pool: Pool, x: float) -> float:
    i = min(int(np.searchsorted(pool.y, x, "right")), pool.y.size - 1) - 1  # y begins with 0
    width = pool.y[i + 1] - pool.y[i]
    part = min(max((x - pool.y[i]) / width, 0.0), 1.0) if width > 0.0 else 0.0
    return pool.log_rate[i] + part * (pool.log_rate[i + 1] - pool.log_rate[i])


class Move(NamedTuple):
    """A step of a cohort: duration, |stretch| and growth at its beginning and end, |stretch| in the middle, and the
    mean of the greatest |x|/g at its end."""

    dt: float
    x0: float
    x1: float
    middle: float
    g0: float
    g1: float
    y: float


@inlined
def _left(s: Strata, k: int, y: float) -> float:
    """The mean threshold at birth of what is left of stratum k when all below y are broken."""
    return max(s.xi[k], 0.5 * (y + s.right[k])) if y > s.left[k] else s.xi[k]


@inlined
def _barriers(c: Contacts, move: Move, k: int) -> tuple[float, float, float]:
    """E at the beginning and the end of a step, and p in its middle, of what is left of stratum k."""
    xi0 = xi1 = _left(c.strata, k, move.y)
    a0 = c.barrier.b * kappa(c.springs, xi0 * move.g0 if c.growth.varies else xi0)
    a1 = c.barrier.b * kappa(c.springs, xi1 * move.g1 if c.growth.varies else xi1)
    now0, now1 = max(xi0 * move.g0, move.x0), max(xi1 * move.g1, move.x1)
    p = prefactor(c.barrier, max(0.5 * (now0 + now1), move.middle), move.middle)
    return height(c.barrier, now0, move.x0, a0), height(c.barrier, now1, move.x1, a1), p


@routine
def _hazards(c: Contacts, move: Move, z: Array) -> int:
    """Integrated hazard of each stratum in a step; returns how many strata, the weakest, it is worth while for."""
    if c.pool.y.size:
        low, high = -_log_pooled_rate(c.pool, move.x0), -_log_pooled_rate(c.pool, move.x1)
        z[0] = move.dt * _mean_exponential(low, high) if min(low, high) < 700.0 else 0.0
        return 1
    seen, above = 0, z.size  # stronger contacts are safer
    limit = c.barrier.log_w + math.log(move.dt) + _UNSEEN
    while seen < above:
        k = (seen + above) // 2
        low, high, _ = _barriers(c, move, k)
        if min(low, high) < limit:
            seen = k + 1
        else:
            above = k
    for k in range(seen):
        low, high, p = _barriers(c, move, k)
        z[k] = move.dt * p * _mean_exponential(low - c.barrier.log_w, high - c.barrier.log_w)
    return seen


@routine
def _weigh(c: Contacts, cohort: Array, alive: Array, g: float) -> None:
    """What of a cohort is pinned."""
    low, high = min(cohort[_Y0], cohort[_Y1]), max(cohort[_Y0], cohort[_Y1])
    n, k1, k2 = 0.0, 0.0, 0.0
    if c.pool.y.size:
        n = alive[0] * _pooled(c.pool, 0, low, high)
        k1 = alive[0] * _pooled(c.pool, 1, low, high)
        k2 = alive[0] * _pooled(c.pool, 2, low, high)
    else:
        s = c.strata
        first = np.searchsorted(s.right, low, "right")
        for k in range(first, alive.size):
            part = alive[k]
            if s.left[k] < high or s.right[k] <= high:
                part *= _unbroken(s.left[k], s.right[k], low, high)
            n += part
            k1 += part * s.stiff[k]
            k2 += part * s.square[k]
    if c.growth.varies:
        k1, k2 = k1 * g, k2 * g * g
    cohort[_S], cohort[_K1], cohort[_K2] = n, k1, k2


@routine
def _advance(c: Contacts, cohort: Array, alive: Array, z: Array, step: tuple[float, float, float, float]) -> None:
    """A cohort over a step (t, X at its beginning, t, X at its end)."""
    t0, X0, t1, X1 = step
    g0, g1 = _growth(c.growth, t0 - cohort[_TM]), _growth(c.growth, t1 - cohort[_TM])
    before = 0.5 * (cohort[_Y0] + cohort[_Y1])
    cohort[_Y0] = max(cohort[_Y0], abs(X1 - cohort[_X0]) / _growth(c.growth, t1 - cohort[_T0]))
    cohort[_Y1] = max(cohort[_Y1], abs(X1 - cohort[_X1]) / _growth(c.growth, t1 - cohort[_T1]))
    x0, x1 = X0 - cohort[_XM], X1 - cohort[_XM]
    after = 0.5 * (cohort[_Y0] + cohort[_Y1])
    move = Move(t1 - t0, abs(x0), abs(x1), abs(0.5 * (x0 + x1)), g0, g1, after)
    s = c.strata
    if c.pool.y.size == 0 and after > before:  # of a stratum that breaks the stronger are left, which heat broke less
        for k in range(np.searchsorted(s.right, after, "right"), alive.size - 1):
            if s.left[k] >= after:
                break
            xi = _left(s, k, before)
            part = (_left(s, k, after) - xi) / (s.xi[k + 1] - xi)
            if part > 0.0 and alive[k] > 1e-280 and alive[k + 1] > 0.0:
                alive[k] *= (alive[k + 1] * s.share[k] / (alive[k] * s.share[k + 1])) ** min(part, 1.0)
    for k in range(_hazards(c, move, z)):
        alive[k] *= exp(-z[k])
    _weigh(c, cohort, alive, g1)


@maker
def _bear(c: Contacts, cohort: Array, alive: Array, z: Array, step: tuple[float, float, float, float]) -> None:
    """The births of a step, as if there were one, at its end. Where thresholds grow, in parts by age, each twice as
    long as the one before."""
    t0, X0, t1, X1 = step
    dt, x = t1 - t0, abs(X1 - X0)
    cohort[_X0], cohort[_X1], cohort[_XM] = X0, X1, 0.5 * (X0 + X1)
    cohort[_T0], cohort[_T1], cohort[_TM] = t0, t1, 0.5 * (t0 + t1)
    cohort[_Y0], cohort[_Y1] = x / _growth(c.growth, dt), 0.0
    parts = _PARTS if c.growth.values.size else 1
    u, n, u1, u2 = 0.0, 0.0, 0.0, 0.0  # age in units of the step; of those left, E[k_i/k], E[u k_i/k], E[u^2 k_i/k]
    left = c.strata.share.copy()
    alive[:] = 0.0
    for part in range(parts):
        after = 0.5 ** (parts - 1 - part)
        g0, g1, width = _growth(c.growth, u * dt), _growth(c.growth, after * dt), after - u
        seen = _hazards(c, Move(width * dt, u * x, after * x, 0.5 * (u + after) * x, g0, g1, 0.5 * after * x / g1), z)
        for k in range(left.size):
            y = min(z[k], 700.0) if k < seen else 0.0
            # mean survival, and where in the part those left are, u1 and u2 as above
            mean, rest = _mean_exponential(0.0, y), 1.0 / (exp(y) - 1.0) if y > 0.02 else 0.0
            v1 = 1.0 / y - rest if y > 0.02 else 0.5 - y / 12.0
            v2 = 2.0 / y**2 - (1.0 + 2.0 / y) * rest if y > 0.02 else 1.0 / 3.0 - y / 12.0
            here = left[k] * mean * width
            alive[k] += here
            n += here * c.strata.stiff[k]
            u1 += here * c.strata.stiff[k] * (u + width * v1)
            u2 += here * c.strata.stiff[k] * (u * u + 2.0 * u * width * v1 + width * width * v2)
            left[k] *= exp(-y)
        u = after
    _weigh(c, cohort, alive, _growth(c.growth, 0.5 * dt))
    if n > 0.0:  # as if all were at the middle, and spread evenly
        cohort[_K1] *= 2.0 * u1 / n
        cohort[_K2] *= 3.0 * u2 / n


@routine
def _joined(c: Contacts, path: Path, cohorts: Array, alive: Array, pair: tuple[int, int], now: float) -> bool:
    """Join a cohort to the one before if both are of the same direction and about as dense in X, and together not too
    wide in X, as thresholds have grown, in |x|/g and in time per age."""
    i, j = pair
    one, two = cohorts[i], cohorts[j]
    if (
        two[_T1] - one[_T0] > path.share * (now - two[_T1])
        or max(one[_Y0], two[_Y1]) - min(one[_Y0], two[_Y1]) > path.width
    ):
        return False
    if abs(two[_X1] - one[_X0]) > path.width * _growth(c.growth, now - two[_T1]):
        return False
    first, second = (one[_X1] - one[_X0]) * two[_S], (two[_X1] - two[_X0]) * one[_S]
    if first * second < 0.0 or abs(first) > 2.0 * abs(second) or abs(second) > 2.0 * abs(first):
        return False
    both = one[_S] + two[_S]
    for column in (_XM, _TM):
        one[column] = (one[_S] * one[column] + two[_S] * two[column]) / both
    one[_X1], one[_T1], one[_Y1] = two[_X1], two[_T1], two[_Y1]
    for column in (_S, _K1, _K2):
        one[column] += two[column]
    for k in range(alive.shape[1]):
        alive[i, k] += alive[j, k]
    return True


@inlined
def _broken_by(t: Array, broken: Array, last: int, at: float, before: float) -> float:
    """Breaks up to a time, not after t[last], from `before` per unit time before 0."""
    if at <= 0.0:
        return before * at
    i = min(int(np.searchsorted(t, at, "right")), last) - 1
    return broken[i] + (broken[i + 1] - broken[i]) * (at - t[i]) / (t[i + 1] - t[i])


@kernel
def march(c: Contacts, path: Path) -> Array:
    """Elastic force, pinned, mean square of the elastic force, and all breaks so far at the edges of the steps, shape
    (4, edges)."""
    t, X, tau = path.t, path.X, c.delay.mean
    found = np.zeros((4, t.size))
    size, width = 256 + path.cohorts, c.strata.share.size
    cohorts, alive, z = np.zeros((size, 11)), np.zeros((size, width)), np.zeros(width)
    order, free, count, unused = np.arange(size), np.arange(size), 0, size
    rate, dt, fresh = 0.0, 0.0, path.cohorts == 0
    if fresh:
        alive[0] = c.strata.share
        _weigh(c, cohorts[0], alive[0], _growth(c.growth, 0.0))
        count = 1
    else:  # a life in steps, all of which are there at the same time
        dt = path.width / path.velocity
        cycle = 0.0
        for i in range(path.cohorts):
            if i == 0:
                _bear(c, cohorts[0], alive[0], z, (-dt, -path.width, 0.0, 0.0))
            else:
                cohorts[i], alive[i] = cohorts[i - 1], alive[i - 1]
                for column in (_X0, _X1, _XM):
                    cohorts[i, column] -= path.width
                for column in (_T0, _T1, _TM):
                    cohorts[i, column] -= dt
                _advance(c, cohorts[i], alive[i], z, (-dt, -path.width, 0.0, 0.0))
            cycle += cohorts[i, _S] * dt
            count += 1
            if cohorts[i, _S] < _GONE:
                break
        rate = 1.0 / (cycle + tau)
        for i in range(count):
            alive[i] *= rate * dt
            for column in (_S, _K1, _K2):
                cohorts[i, column] *= rate * dt
    for i in range(count):
        order[i] = count - 1 - i  # from the oldest
    unused = size - count
    for i in range(unused):
        free[i] = size - 1 - i
    for m in range(t.size):
        if m > 0:
            step = t[m - 1], X[m - 1], t[m], X[m]
            dt = t[m] - t[m - 1]
            pinned = 0.0
            for i in range(count):
                _advance(c, cohorts[order[i]], alive[order[i]], z, step)
                pinned += cohorts[order[i], _S]
            if unused == 0:
                cohorts, alive = (
                    np.concatenate((cohorts, np.zeros_like(cohorts))),
                    np.concatenate((alive, np.zeros_like(alive))),
                )
                order = np.concatenate((order, order))
                free = np.concatenate((free, free))
                unused = size
                for i in range(size):
                    free[i] = 2 * size - 1 - i
                size *= 2
            unused -= 1
            new = free[unused]
            _bear(c, cohorts[new], alive[new], z, step)
            # births are certain + breaks per time * later
            detached = 1.0 - found[1, m - 1]
            if tau == 0.0:
                certain, later = 0.0, dt
            elif c.delay.random > 0.0:
                certain = -detached * math.expm1(-dt / tau)
                later = dt + tau * math.expm1(-dt / tau)
            else:
                later = max(dt - tau, 0.0)
                certain = (
                    _broken_by(t, found[3], m - 1, min(t[m] - tau, t[m - 1]), rate)
                    if m > 1
                    else rate * min(dt - tau, 0.0)
                )
                certain -= _broken_by(t, found[3], m - 1, t[m - 1] - tau, rate) if m > 1 else -rate * tau
            first = cohorts[new, _S]
            breaks = (1.0 - detached - pinned + certain * (1.0 - first)) / (dt - later * (1.0 - first))
            births = certain + breaks * later
            alive[new] *= births
            for column in (_S, _K1, _K2):
                cohorts[new, column] *= births
            found[3, m] = found[3, m - 1] + breaks * dt
            order[count] = new
            count += 1
            # drop cohorts that are gone, and join those that hardly differ
            kept = 0
            for i in range(count):
                j = order[i]
                if cohorts[j, _S] < _GONE or (
                    kept > 1 and _joined(c, path, cohorts, alive, (order[kept - 1], j), t[m])
                ):
                    free[unused] = j
                    unused += 1
                else:
                    order[kept] = j
                    kept += 1
            count = kept
        for i in range(count):
            cohort = cohorts[order[i]]
            x = X[m] - cohort[_XM]
            found[0, m] += x * cohort[_K1]
            found[1, m] += cohort[_S]
            found[2, m] += (x * x + (cohort[_X1] - cohort[_X0]) ** 2 / 12.0) * cohort[_K2]
    return found


# ------------------------------------------------------------------------------------------------------ preparations


def _cells(law: ThresholdLaw, cells: int) -> tuple[Array, Array, Array]:
    """Edges of cells of a law, shape (cells + 1,), nodes in them, shape (cells, nodes), and their shares of births."""
    nodes, weights = np.polynomial.legendre.leggauss(4)
    edge = np.linspace(*_SIGMA, cells + 1)
    half = 0.5 * np.diff(edge)[:, None]
    inner = edge[:-1, None] + half * (1.0 + nodes)
    share = half * weights * np.exp(-0.5 * inner**2)

    def threshold(z: Array) -> Array:
        low, high = -special.log_ndtr(-z), -np.log1p(-special.ndtr(np.minimum(z, 0.0)))
        return np.asarray(law.inverse_survival(np.where(z < 0, high, low))) / law.scale

    return threshold(edge), threshold(inner), share / share.sum()


def _strata(s: Reduced, strata: int) -> Strata:
    """Strata of quenched contacts; of a discrete law its thresholds, or groups of them where there are many."""
    if s.law.steps.size:
        xi, share, stiff = different_steps(s)
        first = np.unique(np.linspace(0, xi.size, min(strata, xi.size) + 1).astype(int))[:-1]
        total = np.add.reduceat(share, first)
        means = [np.add.reduceat(share * part, first) / total for part in (xi, stiff, stiff**2)]
        return Strata(xi[first], xi[np.append(first[1:], xi.size) - 1], means[0], total, *means[1:])
    edge, inner, share = _cells(s.law, strata)
    total = share.sum(axis=1)
    stiff = kappa_of(s, inner)
    means = [(share * part).sum(axis=1) / total for part in (inner, stiff, stiff**2)]
    return Strata(edge[:-1], edge[1:], means[0], total, *means[1:])


def _pool(s: Reduced, cells: int) -> Pool:
    """Of contacts that heat does not break, or all at the same rate."""
    powers = np.arange(3)[:, None]
    if s.law.steps.size:
        xi, share, stiff = different_steps(s)
        between = np.linspace(0.0, xi[-1], cells)
        y = np.sort(np.concatenate((between, xi, xi)))
        y = y[~np.isin(y, xi) | (np.diff(y, prepend=-1.0) == 0) | (np.diff(y, append=math.inf) == 0)]
        before = np.diff(y, append=math.inf) == 0  # just below a threshold
        index = np.searchsorted(xi, y, side="right") - before
        above = np.append(np.cumsum((share * stiff**powers)[:, ::-1], axis=1)[:, ::-1], np.zeros((3, 1)), axis=1)[
            :, index
        ]
        rate = np.zeros(y.size)
        for own, part, k in zip(xi, share, stiff, strict=True) if s.annealed else ():
            i = np.searchsorted(y, own) + 1
            rate[:i] += part * np.exp(s.barrier.log_w + s.barrier.log_rate(y[:i], own, s.barrier.b * k))
    else:
        edge, inner, share = _cells(s.law, cells)
        y = np.append(0.0, edge)
        part = (share * kappa_of(s, inner) ** powers[:, None]).sum(axis=2)
        above = np.append(part[:, ::-1].cumsum(axis=1)[:, ::-1], np.zeros((3, 1)), axis=1)
        above = np.concatenate((above[:, :1], above), axis=1)
        rate = hazard_rate(s, y) if s.annealed else np.zeros(y.size)
    total = np.cumsum(0.5 * (above[:, 1:] + above[:, :-1]) * np.diff(y), axis=1)
    with np.errstate(divide="ignore"):
        return Pool(y, above, np.append(np.zeros((3, 1)), total, axis=1), np.maximum(np.log(rate), -1e4))


_NO_POOL = Pool(NO_STEPS, np.zeros((3, 0)), np.zeros((3, 0)), NO_STEPS)
_ONE_STRATUM = Strata(*np.ones((6, 1)))


def _growth_of(s: Reduced, age: float) -> Growth:
    """Up to an age."""
    if isinstance(s.aging, Unaged):
        return Growth(1.0, 1.0, 1.0, NO_STEPS, False)
    ages = np.geomspace(age * 10.0**-_DECADES, age, _AGES)
    newborn, values = float(s.aging.growth_at(np.zeros(1))[0]), s.aging.growth_at(ages)
    per_ratio = (_AGES - 1) / (_DECADES * math.log(10.0))
    return Growth(float(ages[0]), per_ratio, newborn, values, bool(stiffness_varies(s.aging, s.springs)))


class Course(NamedTuple):
    """A programme in units of the law's scale and of its whole time: ends of segments, velocities, and the velocity of
    the stationary state before, 0 of a fresh start."""

    ends: Array
    velocity: Array
    before: float

    def at(self, t: Array) -> Array:
        """X at times t."""
        X = np.cumsum(np.diff(self.ends, prepend=0.0) * self.velocity)
        return np.interp(t, np.append(0.0, self.ends), np.append(0.0, X))


def _edges(course: Course, width: float, quickest: float, tau: float) -> tuple[Array, Array]:
    """Times of edges of steps of the coarsest grid, and of kinks: ends of segments, and whole delays after them."""
    marks: list[float] = []
    t, last, since, kinks = [0.0], course.before, 0.0, np.empty(0)
    for end, velocity in zip(course.ends, course.velocity, strict=True):
        if abs(velocity - last) > _CHANGED * max(abs(velocity), abs(last)) or t[-1] == 0.0:
            since, kinks = 0.0, np.union1d(kinks[kinks > t[-1]], t[-1] + tau * np.arange(1, _KINKS + 1))
        last = velocity
        longest = min(width / abs(velocity), 1.0) if velocity else 1.0
        for mark in np.append(kinks[(kinks > t[-1]) & (kinks < end)], end):
            begin, elapsed = t[-1], [0.0]
            since = 0.0 if begin in kinks else since
            while elapsed[-1] < (mark - begin) * (1.0 - 1e-9):
                step = min(max(_FIRST * quickest, _GROWTH * (since + elapsed[-1])), longest)
                elapsed.append(elapsed[-1] + step)
                if len(t) + len(elapsed) > _MOST_STEPS:
                    raise InputError(f"programme: takes more than {_MOST_STEPS} steps of the renewal equation")
            since += mark - begin
            t += (begin + np.array(elapsed[1:]) * ((mark - begin) / elapsed[-1])).tolist()
            t[-1] = float(mark)
            marks.append(t[-1])
    return np.array(t), np.array(marks)


def course_of(ensemble: Ensemble, programme: Programme) -> tuple[Reduced, Course]:
    """What the contacts are like, and what happens to them. Raises InputError."""
    if ensemble.self_consistent:
        raise InputError("aging: that of annealed contacts is defined at constant velocity only, not along a programme")
    if ensemble.fluctuates:
        raise InputError('rule = "langevin": has no reference along a programme')
    unit = ensemble.thresholds.scale
    time = sum(segment.duration for segment in programme.segments)
    velocity = np.array([segment.velocity for segment in programme.segments])
    before = programme.velocity if programme.start == "stationary" and programme.velocity else 0.0
    legs(ensemble, programme)  # refuses what is out of range
    ends = np.cumsum([segment.duration for segment in programme.segments]) / time
    return reduced(ensemble, unit / time), Course(ends, velocity * (time / unit), before * (time / unit))


def solve(s: Reduced, course: Course) -> tuple[Array, list[tuple[Array, Array]]]:
    """Times of kinks; and of edges, with what `march` finds there, on three grids, each with twice the steps of the one
    before."""
    low, high = np.asarray(s.law.inverse_survival(np.array([1.8, 0.17]))) / s.law.scale  # two standard deviations
    typical = s.law.mean / s.law.scale
    width = _PATH * (min(max(0.75 * (high - low), 0.02 * typical), typical) if high > low else typical)
    ages = np.geomspace(1e-15, 1.0, 1000)
    grown = np.abs(s.aging.growth_at(ages) / s.aging.growth_at(np.zeros(1)) - 1.0) > _GROWN
    quickest = [1.0, s.delay.mean or 1.0, float(ages[np.argmax(grown)]) if grown.any() else 1.0]
    quickest.append(math.exp(-s.barrier.log_w) if s.barrier.thermal else 1.0)
    t, kinks = _edges(course, width, min(quickest), s.delay.mean if isinstance(s.delay, Fixed) else 0.0)
    strongest = life = float(s.law.inverse_survival(36.0)) / s.law.scale
    for _ in range(50 if course.before else 0):  # towards the root of x = xi growth(x/v)
        life = strongest * max(1.0, float(s.aging.growth_at(np.array([life / course.before]))[0]))
    growth = _growth_of(s, 1.0 + (life / course.before if course.before else 0.0))
    stratified, waits = s.barrier.thermal and not s.annealed, s.delay.for_kernels()
    found = []
    for fine in (1, 2, 4):
        strata = _strata(s, fine * _STRATA) if stratified else _ONE_STRATUM
        pool = _NO_POOL if stratified else _pool(s, fine * _CELLS)
        edges = np.interp(np.arange(fine * (t.size - 1) + 1) / fine, np.arange(t.size), t)
        cohorts = math.ceil(life / width * fine) if course.before else 0
        path = Path(edges, course.at(edges), width / fine, _GROWTH / fine, cohorts, course.before)
        found.append((edges, march(Contacts(strata, pool, growth, s.barrier, s.springs, waits), path)))
    return kinks, found


class Means(NamedTuple):
    """Means at the instants of a programme's grid, and their errors, arrays (points,); lengths in the user's unit,
    breaks per contact and unit time."""

    force: Array
    pinned: Array
    breaks: Array
    force_error: Array
    pinned_error: Array
    variance: Array
    variance_error: Array


def means_of(ensemble: Ensemble, programme: Programme, grid: Grid) -> Means:
    """Solve the renewal equation along a programme (derived).

    Parameters
    ----------
    ensemble : Ensemble
    programme : Programme
    grid : Grid
        The instants asked for.

    Returns
    -------
    Means

    Raises
    ------
    InputError
        For what has no reference along a programme, and programmes that take too many steps.
    """
    s, course = course_of(ensemble, programme)
    unit, time = ensemble.thresholds.scale, grid.t[-1]
    kinks, solved = solve(s, course)
    at, (edges, found) = np.minimum(grid.t / time, 1.0), solved[-1]
    best, errors = _extrapolated([found[:3] for _, found in solved], s.law.steps.size > 0)
    values, breaks = np.zeros((3, at.size)), np.zeros(at.size)
    first, here = 0, 0
    for kink in kinks:  # smooth up to the next
        last, there = np.searchsorted(edges, kink), np.searchsorted(at, kink * (1.0 + 1e-12), side="right")
        if there > here:
            piece, inside = slice(first, last + 1), np.clip(at[here:there], edges[first], edges[last])
            values[:, here:there] = Akima1DInterpolator(edges[piece], best[:, piece], axis=1)(inside)
            rate = np.diff(found[3, piece]) / np.diff(edges[piece])
            breaks[here:there] = np.interp(inside, 0.5 * (edges[piece][1:] + edges[piece][:-1]), rate)
        first, here = last, there
    missed = np.array([np.interp(at, edges, error) for error in errors])
    force, pinned, square = values
    drag = np.array(
        [math.copysign(drag_of(ensemble, abs(part.velocity)), part.velocity) for part in programme.segments]
    )
    drag = drag[grid.segment]
    total, error = force + drag * (1.0 - pinned), missed[0] + np.abs(drag) * missed[1]
    variance = square + drag**2 * (1.0 - pinned) - total**2
    variance_error = missed[2] + drag**2 * missed[1] + 2.0 * np.abs(total) * error
    squares = variance * unit**2, variance_error * unit**2
    return Means(total * unit, pinned, breaks / time, error * unit, missed[1], *squares)


def _extrapolated(found: list[Array], jumps: bool) -> tuple[Array, Array]:
    """The values of no step at all at the edges of the finest of three grids, and their errors, shape (means, edges).

    The error is twice by how much an extrapolation from the two coarser grids is different, nearby too, as it may
    vanish by chance: were the scheme of first order, the finer one would miss half as much (derived).
    """
    rough, coarse, fine = found
    once, twice = (4 * coarse[:, ::2] - rough) / 3, (4 * fine[:, ::2] - coarse) / 3
    index = np.arange(fine.shape[1])
    missed = 2.0 * ndimage.maximum_filter1d(np.abs(twice[:, ::2] - once), 5 + rough.shape[1] // 20, axis=1)
    missed = np.maximum(missed, _CARRIED * missed.max(axis=1, keepdims=True))
    best, errors = np.zeros_like(fine), np.zeros_like(fine)
    for j in range(fine.shape[0]):
        best[j] = fine[j] + np.interp(index / 2, index[: twice.shape[1]], twice[j] - fine[j, ::2])
        errors[j] = np.interp(index / 4, index[: rough.shape[1]], missed[j]) + _RESOLVED * np.abs(best[j])
        if jumps:  # equal thresholds that break together within a step
            errors[j] += ndimage.maximum_filter1d(np.pad(np.abs(np.diff(best[j], 2)), 1, "edge"), 9)
    return best, errors
