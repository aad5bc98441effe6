"""Contacts born at one time after another along a drive in segments: the kernel of `master.programme` for contacts that
heat does not break, or all at the same rate (annealed); `master.fronts` has the others.

A cohort is the births of a step, spread evenly over it in time and displacement. What it has undergone is the greatest
|x|/g so far, of which the law of thresholds says how many it has broken mechanically, and a thermal survival.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from eqsim.laws.delay import Waits
from eqsim.numerics.compiled import by_law, kernel, routine
from eqsim.numerics.tables import Array, search
from eqsim.numerics.vector_math import exp, exp_less_one

_GONE = 1e-15  # pinned shares that do not count


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
    """What a cohort needs to know."""

    pool: Pool
    growth: Growth
    delay: Waits


KEPT, DROPPED, JOINED = range(3)  # what becomes of a cohort at the end of a step


class Choices(NamedTuple):
    """What a solve decided: where in `fates` those of the cohorts of a step begin, array (edges + 1,), the fates, and
    in how many trials the force was balanced, array (edges,): -1 - n where the slider moved in no time, by the longest
    displacement halved n times at most. If they are `given`, another solve repeats them, which makes it a smooth
    function of parameters. Without arrays nothing is noted."""

    first: Array
    fates: Array
    trials: Array
    given: bool


NO_CHOICES = Choices(np.zeros(0, np.int64), np.zeros(0, np.int8), np.zeros(0, np.int64), False)


class Path(NamedTuple):
    """Times and displacements of the edges of steps, arrays (edges,); how wide in X, and in time per age, cohorts may
    become; how many were born before, at a `velocity`, or none of a fresh start; what is decided on the way; and a
    flag (1,) that ends the march early once it is set."""

    t: Array
    X: Array
    width: float
    share: float
    cohorts: int
    velocity: float
    choices: Choices
    stop: Array


# ----------------------------------------------------------------------------------------------------------- cohorts

# columns of a cohort: births at the two edges and in the mean, in X and t; the greatest |x|/g so far of the contacts
# born at both edges; births times thermal survival; and what is pinned, E[k_i/k; pinned], E[(k_i/k)^2; pinned]
_X0, _X1, _XM, _T0, _T1, _TM, _Y0, _Y1, _A, _S, _K1, _K2 = range(12)


class Population(NamedTuple):
    """All cohorts, shape (rows, columns above), and the rows in use, from the oldest cohort on, and then the others."""

    cohorts: Array
    order: Array


@routine(inline=True)
def grown_by(growth: Growth, age: float) -> float:
    """By what factor thresholds have grown at an age."""
    if growth.values.size == 0:
        return 1.0
    if age <= growth.first:
        return growth.newborn + (growth.values[0] - growth.newborn) * max(age, 0.0) / growth.first
    at = min(math.log(age / growth.first) * growth.per_ratio, growth.values.size - 1.000001)
    i = int(at)
    return growth.values[i] + (at - i) * (growth.values[i + 1] - growth.values[i])


@routine
def _pooled(pool: Pool, p: int, low: float, high: float) -> float:
    """E[(k_i/k)^p; xi > y] in the mean over low < y < high."""
    i = search(pool.y, high, True) - 1
    if i >= pool.y.size - 1:
        above, top = 0.0, pool.total[p, pool.y.size - 1]
    else:
        u = high - pool.y[i]
        slope = (pool.above[p, i + 1] - pool.above[p, i]) / (pool.y[i + 1] - pool.y[i])
        above = pool.above[p, i] + slope * u
        top = pool.total[p, i] + u * (pool.above[p, i] + 0.5 * slope * u)
    if high - low <= 1e-9 * high:
        return above
    i = search(pool.y, low, True) - 1
    if i >= pool.y.size - 1:
        return 0.0
    u = low - pool.y[i]
    slope = (pool.above[p, i + 1] - pool.above[p, i]) / (pool.y[i + 1] - pool.y[i])
    return (top - pool.total[p, i] - u * (pool.above[p, i] + 0.5 * slope * u)) / (high - low)


@routine(inline=True)
def mean_exponential(low: float, high: float) -> float:
    """Mean of e^-E while E goes evenly between two values."""
    d = max(abs(high - low), 1e-200)
    return exp(-min(low, high)) * exp_less_one(-min(d, 700.0)) / -d


@routine
def _log_pooled_rate(pool: Pool, x: float) -> float:
    i = min(search(pool.y, x, True), pool.y.size - 1) - 1  # y begins with 0
    width = pool.y[i + 1] - pool.y[i]
    part = min(max((x - pool.y[i]) / width, 0.0), 1.0) if width > 0.0 else 0.0
    return pool.log_rate[i] + part * (pool.log_rate[i + 1] - pool.log_rate[i])


@routine
def _hazard(c: Contacts, dt: float, x0: float, x1: float) -> float:
    """Integrated hazard in a step between two stretches."""
    low, high = -_log_pooled_rate(c.pool, x0), -_log_pooled_rate(c.pool, x1)
    return dt * mean_exponential(low, high) if min(low, high) < 700.0 else 0.0


@routine
def _weigh(c: Contacts, cohort: Array, age: float) -> None:
    """What of a cohort is pinned."""
    g = grown_by(c.growth, age) if c.growth.varies else 1.0
    low, high = min(cohort[_Y0], cohort[_Y1]), max(cohort[_Y0], cohort[_Y1])
    cohort[_S] = cohort[_A] * _pooled(c.pool, 0, low, high)
    cohort[_K1] = cohort[_A] * _pooled(c.pool, 1, low, high) * g
    cohort[_K2] = cohort[_A] * _pooled(c.pool, 2, low, high) * g * g


@routine
def _advance(c: Contacts, cohort: Array, step: tuple[float, float, float, float]) -> None:
    """A cohort over a step (t, X at its beginning, t, X at its end)."""
    t0, X0, t1, X1 = step
    cohort[_Y0] = max(cohort[_Y0], abs(X1 - cohort[_X0]) / grown_by(c.growth, t1 - cohort[_T0]))
    cohort[_Y1] = max(cohort[_Y1], abs(X1 - cohort[_X1]) / grown_by(c.growth, t1 - cohort[_T1]))
    cohort[_A] *= exp(-_hazard(c, t1 - t0, abs(X0 - cohort[_XM]), abs(X1 - cohort[_XM])))
    _weigh(c, cohort, t1 - cohort[_TM])


@routine
def _bear(c: Contacts, cohort: Array, step: tuple[float, float, float, float]) -> None:
    """The births of a step, as if there were one, at its end."""
    t0, X0, t1, X1 = step
    x = abs(X1 - X0)
    cohort[_X0], cohort[_X1], cohort[_XM] = X0, X1, 0.5 * (X0 + X1)
    cohort[_T0], cohort[_T1], cohort[_TM] = t0, t1, 0.5 * (t0 + t1)
    cohort[_Y0], cohort[_Y1] = x / grown_by(c.growth, t1 - t0), 0.0
    y = min(_hazard(c, t1 - t0, 0.0, x), 700.0)
    # mean survival, and age in units of the step of those left, in the mean and in the mean square
    cohort[_A], rest = mean_exponential(0.0, y), 1.0 / (exp(y) - 1.0) if y > 0.02 else 0.0
    u1 = 1.0 / y - rest if y > 0.02 else 0.5 - y / 12.0
    u2 = 2.0 / y**2 - (1.0 + 2.0 / y) * rest if y > 0.02 else 1.0 / 3.0 - y / 12.0
    _weigh(c, cohort, 0.5 * (t1 - t0))
    cohort[_K1] *= 2.0 * u1  # as if all were at the middle, and spread evenly
    cohort[_K2] *= 3.0 * u2


@routine(inline=True)
def noted(choices: Choices, m: int, i: int, fate: int) -> None:
    """Keep the fate of cohort i in step m, if there is room."""
    if not choices.given and m + 1 < choices.first.size:
        at = choices.first[m] + i
        if at < choices.fates.size:
            choices.fates[at] = fate
        choices.first[m + 1] = at + 1


@routine
def _alike(c: Contacts, path: Path, one: Array, two: Array, now: float) -> bool:
    """Whether two cohorts may be joined: of the same direction and about as dense in X, and together not too wide in X,
    as thresholds have grown, in |x|/g and in time per age."""
    if (
        two[_T1] - one[_T0] > path.share * (now - two[_T1])
        or max(one[_Y0], two[_Y1]) - min(one[_Y0], two[_Y1]) > path.width
    ):
        return False
    if abs(two[_X1] - one[_X0]) > path.width * grown_by(c.growth, now - two[_T1]):
        return False
    first, second = (one[_X1] - one[_X0]) * two[_S], (two[_X1] - two[_X0]) * one[_S]
    return not (first * second < 0.0 or abs(first) > 2.0 * abs(second) or abs(second) > 2.0 * abs(first))


@routine
def _join(one: Array, two: Array) -> None:
    """Join a cohort to the one before."""
    both = one[_S] + two[_S]
    for column in (_XM, _TM):
        one[column] = (one[_S] * one[column] + two[_S] * two[column]) / both
    one[_X1], one[_T1], one[_Y1] = two[_X1], two[_T1], two[_Y1]
    for column in (_A, _S, _K1, _K2):
        one[column] += two[column]


@routine(inline=True)
def _broken_by(t: Array, broken: Array, last: int, at: float, before: float) -> float:
    """Breaks up to a time, not after t[last], from `before` per unit time before 0."""
    if at <= 0.0:
        return before * at
    i = min(search(t, at, True), last) - 1
    return broken[i] + (broken[i + 1] - broken[i]) * (at - t[i]) / (t[i + 1] - t[i])


@routine(inline=True)
def due_births(delay: Waits, t: Array, found: Array, m: int, before: float) -> tuple[float, float]:
    """Births of step m: those of contacts that are detached already, and the breaks per unit time in the step times
    which those that break in it."""
    tau, dt, detached = delay.mean, t[m] - t[m - 1], 1.0 - found[1, m - 1]
    if tau == 0.0:
        return 0.0, dt
    if delay.random > 0.0:
        return -detached * math.expm1(-dt / tau), dt + tau * math.expm1(-dt / tau)
    until = _broken_by(t, found[3], m - 1, min(t[m] - tau, t[m - 1]), before)
    return until - _broken_by(t, found[3], m - 1, t[m - 1] - tau, before), max(dt - tau, 0.0)


@routine(inline=True)
def _scale(cohort: Array, births: float) -> None:
    """Make a cohort of one contact one of `births`."""
    for column in (_A, _S, _K1, _K2):
        cohort[column] *= births


# what kernels ask of contacts of any kind, which are the first argument, or of their population


@by_law
def empty(c: Any, rows: int) -> Any:
    """A population of none, with so many rows."""
    return _rows(Population(np.zeros((0, 12)), np.zeros(0, np.int64)), rows)


@by_law
def with_room(p: Any, rows: int) -> Any:
    """A copy that has so many rows."""
    return _rows(p, rows)


@by_law
def begin(c: Any, path: Path, p: Any) -> tuple[int, float]:
    """What there is at first: contacts all born now, or a steady state, that is one life in steps, each of which is
    there at the same time; returns how many cohorts, and births per unit time before."""
    return _begun(c, path, p)


@by_law
def advance_all(c: Any, path: Path, p: Any, found: Array, m: int, before: tuple[int, float]) -> int:
    """All cohorts over step m, and its births, after how many cohorts and births per unit time before; returns how many
    cohorts there are now."""
    return _advanced(c, path, p, found, m, before)


@by_law
def observe(p: Any, count: int, X: float, found: Array, m: int) -> float:
    """Add up what `march` finds, but for the breaks, into column m; returns the stiffness of all pinned contacts."""
    return _observed(p, count, X, found, m)


@routine
def _rows(p: Population, rows: int) -> Population:
    cohorts, order = np.zeros((rows, p.cohorts.shape[1])), np.zeros(rows, np.int64)
    for i in range(rows):
        order[i] = i
    for i in range(p.order.size):
        order[i] = p.order[i]
        for column in range(cohorts.shape[1]):
            cohorts[i, column] = p.cohorts[i, column]
    return Population(cohorts, order)


@routine
def _begun(c: Contacts, path: Path, p: Population) -> tuple[int, float]:
    if path.cohorts == 0:
        p.cohorts[0, _A] = 1.0
        _weigh(c, p.cohorts[0], 0.0)
        return 1, 0.0
    dt, cycle, count = path.width / path.velocity, c.delay.mean, 0
    step = -dt, -path.width, 0.0, 0.0
    for i in range(path.cohorts):
        if i == 0:
            _bear(c, p.cohorts[0], step)
        else:
            for column in range(p.cohorts.shape[1]):
                p.cohorts[i, column] = p.cohorts[i - 1, column]
            for column in (_X0, _X1, _XM):
                p.cohorts[i, column] -= path.width
            for column in (_T0, _T1, _TM):
                p.cohorts[i, column] -= dt
            _advance(c, p.cohorts[i], step)
        cycle += p.cohorts[i, _S] * dt
        count += 1
        if p.cohorts[i, _S] < _GONE and not path.choices.given:
            break
    for i in range(count):
        _scale(p.cohorts[i], dt / cycle)
        p.order[i] = count - 1 - i
    return count, 1.0 / cycle


@routine
def _advanced(c: Contacts, path: Path, p: Population, found: Array, m: int, start: tuple[int, float]) -> int:
    (count, rate), pinned = start, 0.0
    step, dt = (path.t[m - 1], path.X[m - 1], path.t[m], path.X[m]), path.t[m] - path.t[m - 1]
    for i in range(count):
        j = p.order[i]
        _advance(c, p.cohorts[j], step)
        pinned += p.cohorts[j, _S]
    new = p.order[count]
    _bear(c, p.cohorts[new], step)
    due, later = due_births(c.delay, path.t, found, m, rate)
    broken = 1.0 - p.cohorts[new, _S]
    breaks = (found[1, m - 1] - pinned + due * broken) / (dt - later * broken)
    _scale(p.cohorts[new], due + breaks * later)
    found[3, m] = found[3, m - 1] + breaks * dt
    kept = 0
    for i in range(count + 1):  # drop cohorts that are gone, and join those that hardly differ
        j, fate = p.order[i], KEPT
        one, before = p.cohorts[j], p.cohorts[p.order[max(kept - 1, 0)]]
        if path.choices.given:
            fate = path.choices.fates[path.choices.first[m] + i]
        elif one[_S] < _GONE:
            fate = DROPPED
        elif kept > 1 and _alike(c, path, before, one, path.t[m]):
            fate = JOINED
        noted(path.choices, m, i, fate)
        if fate == JOINED:
            _join(before, one)
        if fate == KEPT:
            p.order[i], p.order[kept] = p.order[kept], j
            kept += 1
    return kept


@routine
def _observed(p: Population, count: int, X: float, found: Array, m: int) -> float:
    stiffness = 0.0
    for i in range(count):
        cohort = p.cohorts[p.order[i]]
        x = X - cohort[_XM]
        found[0, m] += x * cohort[_K1]
        found[1, m] += cohort[_S]
        stiffness += cohort[_K1]
        found[2, m] += (x * x + (cohort[_X1] - cohort[_X0]) ** 2 / 12.0) * cohort[_K2]
    return stiffness


@kernel
def march(c: Any, path: Path) -> Array:
    """Elastic force, pinned, mean square of the elastic force, and all breaks so far at the edges of the steps, shape
    (4, edges)."""
    found = np.zeros((4, path.t.size))
    p = empty(c, 256 + path.cohorts)
    count, rate = begin(c, path, p)
    observe(p, count, path.X[0], found, 0)
    for m in range(1, path.t.size):
        if path.stop[0] != 0:
            break
        if count == p.order.size:
            p = with_room(p, 2 * count)
        count = advance_all(c, path, p, found, m, (count, rate))
        observe(p, count, path.X[m], found, m)
    return found
