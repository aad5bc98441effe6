"""Contacts born at one time after another, along a drive in segments: the kernel of `master.programme`.

A cohort is the births of a step, spread evenly over it in time and displacement; its contacts are divided into strata
by threshold, or share one hazard. What it has undergone is the greatest |x|/g so far, of which the law of thresholds
says how many it has broken mechanically, and a thermal survival of each stratum.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from eqsim.laws.barrier.base import height, prefactor
from eqsim.laws.delay import Waits
from eqsim.laws.stiffness import Springs, kappa
from eqsim.numerics.compiled import inlined, kernel, maker, routine
from eqsim.numerics.tables import Array
from eqsim.numerics.vector_math import exp, exp_less_one

_PARTS = 12  # of the births of a step where thresholds grow
_GONE, _UNSEEN = 1e-15, 40.0  # pinned shares and -ln of hazards in a step that do not count


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


class Population(NamedTuple):
    """All cohorts, shape (rows, columns above), what is alive of them, shape (rows, strata), the rows in use, from the
    oldest cohort on, and then the others; and scratch, shape (2, strata)."""

    cohorts: Array
    alive: Array
    order: Array
    scratch: Array


@inlined
def _up_to(values: Array, x: float) -> int:
    """How many of ascending values are at most x."""
    low, high = 0, values.size
    while low < high:
        middle = (low + high) // 2
        if values[middle] <= x:
            low = middle + 1
        else:
            high = middle
    return low


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
    i = _up_to(pool.y, high) - 1
    if i >= pool.y.size - 1:
        above, top = 0.0, pool.total[p, pool.y.size - 1]
    else:
        u = high - pool.y[i]
        slope = (pool.above[p, i + 1] - pool.above[p, i]) / (pool.y[i + 1] - pool.y[i])
        above = pool.above[p, i] + slope * u
        top = pool.total[p, i] + u * (pool.above[p, i] + 0.5 * slope * u)
    if high - low <= 1e-9 * high:
        return above
    i = _up_to(pool.y, low) - 1
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
    i = min(_up_to(pool.y, x), pool.y.size - 1) - 1  # y begins with 0
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
def _hazards(c: Contacts, move: Move, first: int, z: Array) -> int:
    """Integrated hazard in a step of each stratum from `first` on; returns up to which it is worth while."""
    if c.pool.y.size:
        low, high = -_log_pooled_rate(c.pool, move.x0), -_log_pooled_rate(c.pool, move.x1)
        z[0] = move.dt * _mean_exponential(low, high) if min(low, high) < 700.0 else 0.0
        return 1
    seen, above = first, z.size  # stronger contacts are safer
    limit = c.barrier.log_w + math.log(move.dt) + _UNSEEN
    while seen < above:
        k = (seen + above) // 2
        low, high, _ = _barriers(c, move, k)
        if min(low, high) < limit:
            seen = k + 1
        else:
            above = k
    for k in range(first, seen):
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
        whole = _up_to(s.right, low)
        while whole < alive.size and (s.left[whole] < high or s.right[whole] <= high):
            part = alive[whole] * _unbroken(s.left[whole], s.right[whole], low, high)
            n, k1, k2 = n + part, k1 + part * s.stiff[whole], k2 + part * s.square[whole]
            whole += 1
        for k in range(whole, alive.size):
            n, k1, k2 = n + alive[k], k1 + alive[k] * s.stiff[k], k2 + alive[k] * s.square[k]
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
        for k in range(_up_to(s.right, after), alive.size - 1):
            if s.left[k] >= after:
                break
            xi = _left(s, k, before)
            part = (_left(s, k, after) - xi) / (s.xi[k + 1] - xi)
            if part > 0.0 and alive[k] > 1e-280 and alive[k + 1] > 0.0:
                alive[k] *= (alive[k + 1] * s.share[k] / (alive[k] * s.share[k + 1])) ** min(part, 1.0)
    # strata below have broken
    first = 0 if c.pool.y.size else _up_to(s.right, min(cohort[_Y0], cohort[_Y1]))
    for k in range(first, _hazards(c, move, first, z)):
        alive[k] *= exp(-z[k])
    _weigh(c, cohort, alive, g1)


@routine
def _bear(c: Contacts, cohort: Array, alive: Array, scratch: Array, step: tuple[float, float, float, float]) -> None:
    """The births of a step, as if there were one, at its end. Where thresholds grow, in parts by age, each twice as
    long as the one before."""
    t0, X0, t1, X1 = step
    dt, x = t1 - t0, abs(X1 - X0)
    cohort[_X0], cohort[_X1], cohort[_XM] = X0, X1, 0.5 * (X0 + X1)
    cohort[_T0], cohort[_T1], cohort[_TM] = t0, t1, 0.5 * (t0 + t1)
    cohort[_Y0], cohort[_Y1] = x / _growth(c.growth, dt), 0.0
    parts = _PARTS if c.growth.values.size else 1
    u, n, u1, u2 = 0.0, 0.0, 0.0, 0.0  # age in units of the step; of those left, E[k_i/k], E[u k_i/k], E[u^2 k_i/k]
    left, z = scratch[0], scratch[1]
    for k in range(left.size):
        left[k], alive[k] = c.strata.share[k], 0.0
    for part in range(parts):
        after = 0.5 ** (parts - 1 - part)
        g0, g1, width = _growth(c.growth, u * dt), _growth(c.growth, after * dt), after - u
        move = Move(width * dt, u * x, after * x, 0.5 * (u + after) * x, g0, g1, 0.5 * after * x / g1)
        seen = _hazards(c, move, 0, z)
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
def _joined(c: Contacts, path: Path, p: Population, pair: tuple[int, int], now: float) -> bool:
    """Join a cohort to the one before if both are of the same direction and about as dense in X, and together not too
    wide in X, as thresholds have grown, in |x|/g and in time per age."""
    one, two = p.cohorts[pair[0]], p.cohorts[pair[1]]
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
    for k in range(p.alive.shape[1]):
        p.alive[pair[0], k] += p.alive[pair[1], k]
    return True


@inlined
def _broken_by(t: Array, broken: Array, last: int, at: float, before: float) -> float:
    """Breaks up to a time, not after t[last], from `before` per unit time before 0."""
    if at <= 0.0:
        return before * at
    i = min(_up_to(t, at), last) - 1
    return broken[i] + (broken[i + 1] - broken[i]) * (at - t[i]) / (t[i + 1] - t[i])


@inlined
def _due(delay: Waits, t: Array, found: Array, m: int, before: float) -> tuple[float, float]:
    """Births of step m: those of contacts that are detached already, and the breaks per unit time in the step times
    which those that break in it."""
    tau, dt, detached = delay.mean, t[m] - t[m - 1], 1.0 - found[1, m - 1]
    if tau == 0.0:
        return 0.0, dt
    if delay.random > 0.0:
        return -detached * math.expm1(-dt / tau), dt + tau * math.expm1(-dt / tau)
    until = _broken_by(t, found[3], m - 1, min(t[m] - tau, t[m - 1]), before)
    return until - _broken_by(t, found[3], m - 1, t[m - 1] - tau, before), max(dt - tau, 0.0)


@inlined
def _scale(cohort: Array, alive: Array, births: float) -> None:
    """Make a cohort of one contact one of `births`."""
    for k in range(alive.size):
        alive[k] *= births
    for column in (_S, _K1, _K2):
        cohort[column] *= births


@routine
def begin(c: Contacts, path: Path, p: Population) -> tuple[int, float]:
    """What there is at first: contacts all born now, or a steady state, that is one life in steps, each of which is
    there at the same time; returns how many cohorts, and births per unit time before."""
    if path.cohorts == 0:
        for k in range(p.alive.shape[1]):
            p.alive[0, k] = c.strata.share[k]
        _weigh(c, p.cohorts[0], p.alive[0], _growth(c.growth, 0.0))
        return 1, 0.0
    dt, cycle, count = path.width / path.velocity, c.delay.mean, 0
    step = -dt, -path.width, 0.0, 0.0
    for i in range(path.cohorts):
        if i == 0:
            _bear(c, p.cohorts[0], p.alive[0], p.scratch, step)
        else:
            for column in range(p.cohorts.shape[1]):
                p.cohorts[i, column] = p.cohorts[i - 1, column]
            for k in range(p.alive.shape[1]):
                p.alive[i, k] = p.alive[i - 1, k]
            for column in (_X0, _X1, _XM):
                p.cohorts[i, column] -= path.width
            for column in (_T0, _T1, _TM):
                p.cohorts[i, column] -= dt
            _advance(c, p.cohorts[i], p.alive[i], p.scratch[1], step)
        cycle += p.cohorts[i, _S] * dt
        count += 1
        if p.cohorts[i, _S] < _GONE:
            break
    for i in range(count):
        _scale(p.cohorts[i], p.alive[i], dt / cycle)
        p.order[i] = count - 1 - i
    return count, 1.0 / cycle


@routine
def advance_all(c: Contacts, path: Path, p: Population, found: Array, m: int, before: tuple[int, float]) -> int:
    """All cohorts over step m, and its births, after how many cohorts and births per unit time before; returns how many
    cohorts there are now."""
    (count, rate), pinned = before, 0.0
    step, dt = (path.t[m - 1], path.X[m - 1], path.t[m], path.X[m]), path.t[m] - path.t[m - 1]
    for i in range(count):
        j = p.order[i]
        _advance(c, p.cohorts[j], p.alive[j], p.scratch[1], step)
        pinned += p.cohorts[j, _S]
    new = p.order[count]
    _bear(c, p.cohorts[new], p.alive[new], p.scratch, step)
    due, later = _due(c.delay, path.t, found, m, rate)
    broken = 1.0 - p.cohorts[new, _S]
    breaks = (found[1, m - 1] - pinned + due * broken) / (dt - later * broken)
    _scale(p.cohorts[new], p.alive[new], due + breaks * later)
    found[3, m] = found[3, m - 1] + breaks * dt
    kept = 0
    for i in range(count + 1):  # drop cohorts that are gone, and join those that hardly differ
        j = p.order[i]
        if p.cohorts[j, _S] < _GONE or (kept > 1 and _joined(c, path, p, (p.order[kept - 1], j), path.t[m])):
            continue
        p.order[i], p.order[kept] = p.order[kept], j
        kept += 1
    return kept


@routine
def observe(p: Population, count: int, X: float, found: Array, m: int) -> float:
    """Add up what `march` finds, into column m; returns the stiffness of all pinned contacts."""
    stiffness = 0.0
    """What is found at edge m, but for the breaks."""
    for i in range(count):
        cohort = p.cohorts[p.order[i]]
        x = X - cohort[_XM]
        found[0, m] += x * cohort[_K1]
        found[1, m] += cohort[_S]
        stiffness += cohort[_K1]
        found[2, m] += (x * x + (cohort[_X1] - cohort[_X0]) ** 2 / 12.0) * cohort[_K2]
    return stiffness


@maker
def with_room(p: Population, rows: int) -> Population:
    """A copy that has so many rows."""
    cohorts, alive = np.zeros((rows, p.cohorts.shape[1])), np.zeros((rows, p.alive.shape[1]))
    order = np.zeros(rows, np.int64)
    for i in range(rows):
        order[i] = i
    for i in range(p.order.size):
        order[i] = p.order[i]
        for column in range(cohorts.shape[1]):
            cohorts[i, column] = p.cohorts[i, column]
        for k in range(alive.shape[1]):
            alive[i, k] = p.alive[i, k]
    return Population(cohorts, alive, order, p.scratch)


# numba compiles a routine anew for callers of another kind (kernel, maker, routine): here none has callers of two.
@kernel
def march(c: Contacts, path: Path) -> Array:
    """Elastic force, pinned, mean square of the elastic force, and all breaks so far at the edges of the steps, shape
    (4, edges)."""
    found, strata = np.zeros((4, path.t.size)), c.strata.share.size
    none = Population(np.zeros((0, 11)), np.zeros((0, strata)), np.zeros(0, np.int64), np.zeros((2, strata)))
    p = with_room(none, 256 + path.cohorts)
    count, rate = begin(c, path, p)
    observe(p, count, path.X[0], found, 0)
    for m in range(1, path.t.size):
        if count == p.order.size:
            p = with_room(p, 2 * count)
        count = advance_all(c, path, p, found, m, (count, rate))
        observe(p, count, path.X[m], found, m)
    return found
