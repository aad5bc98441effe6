"""Contacts born at one time after another along a drive in segments: the kernel of
`master.programme` for contacts that heat does not break, or all at the same rate
(annealed); `master.fronts` has the others.

A cohort is the births of a step, spread evenly over it in time and displacement. What
it has undergone is the greatest
|x|/g so far, of which the law of thresholds says how many it has broken mechanically, and a thermal survival.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from eqsim.laws.delay import Waits
from eqsim.numerics.compiled import by_law, kernel, routine
from eqsim.numerics.tables import Array, search
from eqsim.numerics.vector_math import exp, exp_less_one

# Cohorts with a smaller pinned share are dropped.
NEGLIGIBLE_SHARE = 1e-15


class Pool(NamedTuple):
    """At thresholds y, shape (knots,): E[(k_i/k)^p; xi > y] and its integral from 0, p
    = 0, 1, 2, shape (3, knots); and ln of the rate that all contacts share at stretch
    y."""

    y: Array
    above: Array
    total: Array
    log_rate: Array


class Growth(NamedTuple):
    """The factor by which thresholds have grown, at ages in equal ratios from `first`
    on; `newborn` at age 0."""

    first: float
    per_ratio: float
    newborn: float
    values: Array
    varies: bool


class Contacts(NamedTuple):
    """Contacts for kernels: thresholds, their growth, and delays."""

    pool: Pool
    growth: Growth
    delay: Waits


# What becomes of a cohort at the end of a step: it goes on, is dropped, or is joined to
# the one before.
KEPT = 0
DROPPED = 1
JOINED = 2


class Choices(NamedTuple):
    """Decisions of a solve, so that another one may repeat them, which makes it a
    smooth function of parameters.

    Attributes
    ----------
    first : ndarray, shape (edges + 1,)
        Where in `fates` those of the cohorts of a step begin.
    fates : ndarray
        KEPT, DROPPED or JOINED.
    trials : ndarray, shape (edges,)
        In how many trials the force was balanced.
    instant : ndarray, shape (edges,)
        Whether the slider moved in no time.
    halvings : ndarray, shape (edges,)
        How often the longest displacement was halved then.
    given : bool
        Whether these choices are to be repeated. Otherwise they are noted, if there is
        room.
    """

    first: Array
    fates: Array
    trials: Array
    instant: Array
    halvings: Array
    given: bool


def unmade_choices(edges: int, fates: int) -> Choices:
    """Room for the choices of a solve."""
    return Choices(
        first=np.zeros(edges + 1, np.int64),
        fates=np.zeros(fates, np.int8),
        trials=np.zeros(edges, np.int64),
        instant=np.zeros(edges, np.bool_),
        halvings=np.zeros(edges, np.int64),
        given=False,
    )


NO_CHOICES = unmade_choices(0, 0)


class Path(NamedTuple):
    """Times and displacements of the edges of steps, arrays (edges,); how wide in X,
    and in time per age, cohorts may become; how many were born before, at a `velocity`,
    or none of a fresh start; what is decided on the way; and a flag (1,) that ends the
    march early once it is set."""

    t: Array
    X: Array
    width: float
    share: float
    cohorts: int
    velocity: float
    choices: Choices
    stop: Array


class History(NamedTuple):
    """Means over all contacts: elastic force, pinned share, mean square of the elastic
    force, and breaks so far, per contact, at the edges of steps, arrays (edges,)."""

    force: Array
    pinned: Array
    square: Array
    breaks: Array


class Step(NamedTuple):
    """Time and displacement at the beginning and the end of a step."""

    t0: float
    X0: float
    t1: float
    X1: float


# -----------------------------------------------------------------------------------------------------------
# cohorts

# A row of a structured array, whose fields are attributes in kernels.
Row = Any

# A cohort. Its births are those of a step, of which `first` and `last` mean the first
# and the last one, and `mean` the mean over contacts that are pinned. `weakest` is the
# greatest |x|/g so far, below which no threshold at birth is left; `unbroken` are
# births less those that heat broke, whatever their threshold; `pinned` is the share of
# all contacts that is pinned and of this cohort, and `stiffness` and `stiffness2` are
# E[k_i/k; pinned] and E[(k_i/k)^2; pinned].
_BIRTHS = "X_first X_last X_mean t_first t_last t_mean"
_LEFT = "weakest_first weakest_last unbroken pinned stiffness stiffness2"
COHORT = np.dtype(
    [(field, np.float64) for field in f"{_BIRTHS} {_LEFT}".split()], align=True
)


class Population(NamedTuple):
    """All cohorts, an array (rows,) of COHORT, and the rows in use, from the oldest
    cohort on, and then the others."""

    cohorts: Array
    order: Array


@routine(inline=True)
def grown_by(growth: Growth, age: float) -> float:
    """The factor by which thresholds have grown at an age."""
    if growth.values.size == 0:
        return 1.0
    if age <= growth.first:
        return (
            growth.newborn
            + (growth.values[0] - growth.newborn) * max(age, 0.0) / growth.first
        )
    steps = min(
        math.log(age / growth.first) * growth.per_ratio, growth.values.size - 1.000001
    )
    i = int(steps)
    return growth.values[i] + (steps - i) * (growth.values[i + 1] - growth.values[i])


@routine
def _pooled(pool: Pool, power: int, low: float, high: float) -> float:
    """E[(k_i/k)^p; xi > y] in the mean over low < y < high."""
    i = search(pool.y, high, True) - 1
    if i >= pool.y.size - 1:
        above, top = 0.0, pool.total[power, pool.y.size - 1]
    else:
        u = high - pool.y[i]
        slope = (pool.above[power, i + 1] - pool.above[power, i]) / (
            pool.y[i + 1] - pool.y[i]
        )
        above = pool.above[power, i] + slope * u
        top = pool.total[power, i] + u * (pool.above[power, i] + 0.5 * slope * u)
    if high - low <= 1e-9 * high:
        return above
    i = search(pool.y, low, True) - 1
    if i >= pool.y.size - 1:
        return 0.0
    u = low - pool.y[i]
    slope = (pool.above[power, i + 1] - pool.above[power, i]) / (
        pool.y[i + 1] - pool.y[i]
    )
    return (
        top - pool.total[power, i] - u * (pool.above[power, i] + 0.5 * slope * u)
    ) / (high - low)


@routine(inline=True)
def mean_exponential(low: float, high: float) -> float:
    """Mean of e^-E while E goes evenly between two values."""
    d = max(abs(high - low), 1e-200)
    return exp(-min(low, high)) * exp_less_one(-min(d, 700.0)) / -d


@routine
def _log_pooled_rate(pool: Pool, x: float) -> float:
    i = min(search(pool.y, x, True), pool.y.size - 1) - 1  # y begins with 0
    width = pool.y[i + 1] - pool.y[i]
    u = min(max((x - pool.y[i]) / width, 0.0), 1.0) if width > 0.0 else 0.0
    return pool.log_rate[i] + u * (pool.log_rate[i + 1] - pool.log_rate[i])


@routine
def _hazard(contacts: Contacts, dt: float, x0: float, x1: float) -> float:
    """Integrated hazard in a step between two stretches."""
    low, high = (
        -_log_pooled_rate(contacts.pool, x0),
        -_log_pooled_rate(contacts.pool, x1),
    )
    return dt * mean_exponential(low, high) if min(low, high) < 700.0 else 0.0


@routine
def _weigh(contacts: Contacts, cohort: Row, age: float) -> None:
    """Find what of a cohort is pinned."""
    g = grown_by(contacts.growth, age) if contacts.growth.varies else 1.0
    low = min(cohort.weakest_first, cohort.weakest_last)
    high = max(cohort.weakest_first, cohort.weakest_last)
    cohort.pinned = cohort.unbroken * _pooled(contacts.pool, 0, low, high)
    cohort.stiffness = cohort.unbroken * _pooled(contacts.pool, 1, low, high) * g
    cohort.stiffness2 = cohort.unbroken * _pooled(contacts.pool, 2, low, high) * g * g


@routine(inline=True)
def _strained(growth: Growth, weakest: float, x: float, age: float) -> float:
    """The greatest |x|/g so far, once a contact of this age has stretch x."""
    return max(weakest, abs(x) / grown_by(growth, age))


@routine
def _advance(contacts: Contacts, cohort: Row, step: Step) -> None:
    """Carry a cohort over a step."""
    first, last = cohort.weakest_first, cohort.weakest_last
    cohort.weakest_first = _strained(
        contacts.growth, first, step.X1 - cohort.X_first, step.t1 - cohort.t_first
    )
    cohort.weakest_last = _strained(
        contacts.growth, last, step.X1 - cohort.X_last, step.t1 - cohort.t_last
    )
    before, after = abs(step.X0 - cohort.X_mean), abs(step.X1 - cohort.X_mean)
    cohort.unbroken *= exp(-_hazard(contacts, step.t1 - step.t0, before, after))
    _weigh(contacts, cohort, step.t1 - cohort.t_mean)


class Ages(NamedTuple):
    """Survivors, at the end of a step, of births spread evenly over it: their share,
    and their mean age and mean square age in units of the step."""

    share: float
    age: float
    age2: float


@routine(inline=True)
def ages_of_survivors(hazard: float) -> Ages:
    """Ages of those left where the integrated hazard grows evenly with age up to
    `hazard`."""
    rest = 1.0 / (exp(hazard) - 1.0) if hazard > 0.02 else 0.0
    age = 1.0 / hazard - rest if hazard > 0.02 else 0.5 - hazard / 12.0
    age2 = (
        2.0 / hazard**2 - (1.0 + 2.0 / hazard) * rest
        if hazard > 0.02
        else 1.0 / 3.0 - hazard / 12.0
    )
    return Ages(mean_exponential(0.0, hazard), age, age2)


@routine
def _bear(contacts: Contacts, cohort: Row, step: Step) -> None:
    """Treat the births of a step as one birth at its end."""
    dt, x = step.t1 - step.t0, abs(step.X1 - step.X0)
    cohort.X_first = step.X0
    cohort.X_last = step.X1
    cohort.X_mean = 0.5 * (step.X0 + step.X1)
    cohort.t_first = step.t0
    cohort.t_last = step.t1
    cohort.t_mean = 0.5 * (step.t0 + step.t1)
    cohort.weakest_first = x / grown_by(contacts.growth, dt)
    cohort.weakest_last = 0.0
    left = ages_of_survivors(min(_hazard(contacts, dt, 0.0, x), 700.0))
    cohort.unbroken = left.share
    _weigh(contacts, cohort, 0.5 * dt)
    cohort.stiffness *= (
        2.0 * left.age
    )  # as if all were at the middle, and spread evenly
    cohort.stiffness2 *= 3.0 * left.age2


@routine(inline=True)
def noted(choices: Choices, m: int, i: int, fate: int) -> None:
    """Keep the fate of cohort i in step m, if there is room."""
    if not choices.given and m + 1 < choices.first.size:
        index = choices.first[m] + i
        if index < choices.fates.size:
            choices.fates[index] = fate
        choices.first[m + 1] = index + 1


@routine(inline=True)
def densities_alike(first: float, second: float) -> bool:
    """Whether two numbers have the same sign, and differ by a factor 2 at most."""
    return not (
        first * second < 0.0
        or abs(first) > 2.0 * abs(second)
        or abs(second) > 2.0 * abs(first)
    )


@routine
def _alike(contacts: Contacts, path: Path, older: Row, newer: Row, now: float) -> bool:
    """Whether two cohorts may be joined: of the same direction and about as dense in X,
    and together not too wide in X, as thresholds have grown, in |x|/g and in time per
    age."""
    widest = max(older.weakest_first, newer.weakest_last) - min(
        older.weakest_first, newer.weakest_last
    )
    if (
        newer.t_last - older.t_first > path.share * (now - newer.t_last)
        or widest > path.width
    ):
        return False
    if abs(newer.X_last - older.X_first) > path.width * grown_by(
        contacts.growth, now - newer.t_last
    ):
        return False
    first = (older.X_last - older.X_first) * newer.pinned
    return densities_alike(first, (newer.X_last - newer.X_first) * older.pinned)


@routine
def _join(older: Row, newer: Row) -> None:
    """Join a cohort to the one before."""
    both = older.pinned + newer.pinned
    older.X_mean = (older.pinned * older.X_mean + newer.pinned * newer.X_mean) / both
    older.t_mean = (older.pinned * older.t_mean + newer.pinned * newer.t_mean) / both
    older.X_last = newer.X_last
    older.t_last = newer.t_last
    older.weakest_last = newer.weakest_last
    older.unbroken += newer.unbroken
    older.pinned += newer.pinned
    older.stiffness += newer.stiffness
    older.stiffness2 += newer.stiffness2


@routine(inline=True)
def _broken_by(path: Path, breaks: Array, last: int, t: float, rate: float) -> float:
    """Breaks up to a time, not after edge `last`, from `rate` per unit time before 0."""
    if t <= 0.0:
        return rate * t
    i = min(search(path.t, t, True), last) - 1
    return breaks[i] + (breaks[i + 1] - breaks[i]) * (t - path.t[i]) / (
        path.t[i + 1] - path.t[i]
    )


@routine(inline=True)
def _due_births(
    delay: Waits, path: Path, history: History, m: int, rate: float
) -> tuple[float, float]:
    """Births of step m: those of contacts that are detached already, and the breaks per
    unit time in the step times which those that break in it."""
    tau, t0, t1 = delay.mean, path.t[m - 1], path.t[m]
    dt, detached = t1 - t0, 1.0 - history.pinned[m - 1]
    if tau == 0.0:
        return 0.0, dt
    if delay.random > 0.0:
        return -detached * math.expm1(-dt / tau), dt + tau * math.expm1(-dt / tau)
    until = _broken_by(path, history.breaks, m - 1, min(t1 - tau, t0), rate)
    return until - _broken_by(path, history.breaks, m - 1, t0 - tau, rate), max(
        dt - tau, 0.0
    )


@routine(inline=True)
def births_in(
    delay: Waits,
    path: Path,
    history: History,
    m: int,
    rate: float,
    pinned: float,
    newborn: float,
) -> float:
    """Note the breaks of step m and return its births: `pinned` is left of those that
    were pinned before, and the share `newborn` of the births."""
    dt = path.t[m] - path.t[m - 1]
    due, later = _due_births(delay, path, history, m, rate)
    broken = 1.0 - newborn
    breaks = (history.pinned[m - 1] - pinned + due * broken) / (dt - later * broken)
    history.breaks[m] = history.breaks[m - 1] + breaks * dt
    return due + breaks * later


@routine(inline=True)
def _scale(cohort: Row, births: float) -> None:
    """Make a cohort of one contact one of `births`."""
    cohort.unbroken *= births
    cohort.pinned *= births
    cohort.stiffness *= births
    cohort.stiffness2 *= births


@routine
def numbered(rows: int) -> Array:
    """The numbers of all rows."""
    order = np.zeros(rows, np.int64)
    for i in range(rows):
        order[i] = i
    return order


# what kernels ask of contacts of any kind, which are the first argument, or of their
# population


@by_law(makes_arrays=True)
def empty(contacts: Any, rows: int) -> Any:
    """A population of none, with so many rows."""
    return Population(np.zeros(rows, COHORT), numbered(rows))


@by_law(makes_arrays=True)
def with_room(population: Any, rows: int) -> Any:
    """A copy that has so many rows."""
    cohorts, order = np.zeros(rows, COHORT), numbered(rows)
    for i in range(population.order.size):
        order[i] = population.order[i]
        cohorts[i] = population.cohorts[i]
    return Population(cohorts, order)


@by_law(makes_arrays=True)
def begin(contacts: Any, path: Path, population: Any) -> tuple[int, float]:
    """Fill a population with what there is at first: contacts all born now, or a steady
    state, that is one life in steps, each of which is there at the same time; returns
    how many cohorts, and births per unit time before."""
    if path.cohorts == 0:
        population.cohorts[0].unbroken = 1.0
        _weigh(contacts, population.cohorts[0], 0.0)
        return 1, 0.0
    dt, cycle, count = path.width / path.velocity, contacts.delay.mean, 0
    step = Step(-dt, -path.width, 0.0, 0.0)
    for i in range(path.cohorts):
        cohort = population.cohorts[i]
        if i == 0:
            _bear(contacts, cohort, step)
        else:
            population.cohorts[i] = population.cohorts[i - 1]
            cohort.X_first -= path.width
            cohort.X_last -= path.width
            cohort.X_mean -= path.width
            cohort.t_first -= dt
            cohort.t_last -= dt
            cohort.t_mean -= dt
            _advance(contacts, cohort, step)
        cycle += cohort.pinned * dt
        count += 1
        if cohort.pinned < NEGLIGIBLE_SHARE and not path.choices.given:
            break
    for i in range(count):
        _scale(population.cohorts[i], dt / cycle)
        population.order[i] = count - 1 - i
    return count, 1.0 / cycle


@by_law(makes_arrays=True)
def advance_all(
    contacts: Any,
    path: Path,
    population: Any,
    history: History,
    m: int,
    count: int,
    rate: float,
) -> int:
    """Carry all cohorts, `count` of them, over step m, and add its births, where `rate`
    is births per unit time before the path began; returns how many cohorts there are
    now."""
    step, pinned = Step(path.t[m - 1], path.X[m - 1], path.t[m], path.X[m]), 0.0
    for i in range(count):
        cohort = population.cohorts[population.order[i]]
        _advance(contacts, cohort, step)
        pinned += cohort.pinned
    new = population.cohorts[population.order[count]]
    _bear(contacts, new, step)
    _scale(new, births_in(contacts.delay, path, history, m, rate, pinned, new.pinned))
    kept = 0
    for i in range(
        count + 1
    ):  # drop cohorts that are gone, and join those that hardly differ
        j, fate = population.order[i], KEPT
        cohort, before = (
            population.cohorts[j],
            population.cohorts[population.order[max(kept - 1, 0)]],
        )
        if path.choices.given:
            fate = path.choices.fates[path.choices.first[m] + i]
        elif cohort.pinned < NEGLIGIBLE_SHARE:
            fate = DROPPED
        elif kept > 1 and _alike(contacts, path, before, cohort, path.t[m]):
            fate = JOINED
        noted(path.choices, m, i, fate)
        if fate == JOINED:
            _join(before, cohort)
        if fate == KEPT:
            population.order[i], population.order[kept] = population.order[kept], j
            kept += 1
    return kept


@by_law(makes_arrays=True)
def observe(population: Any, count: int, X: float, history: History, m: int) -> float:
    """Add up the force, the pinned share and the mean square of a population at edge m;
    returns the stiffness of all pinned contacts."""
    stiffness = 0.0
    for i in range(count):
        cohort = population.cohorts[population.order[i]]
        x, width = X - cohort.X_mean, cohort.X_last - cohort.X_first
        history.force[m] += x * cohort.stiffness
        history.pinned[m] += cohort.pinned
        stiffness += cohort.stiffness
        history.square[m] += (x * x + width**2 / 12.0) * cohort.stiffness2
    return stiffness


@kernel
def march(contacts: Any, path: Path) -> History:
    """Follow contacts along a path."""
    rows, population = np.zeros((4, path.t.size)), empty(contacts, 256 + path.cohorts)
    history = History(rows[0], rows[1], rows[2], rows[3])
    count, rate = begin(contacts, path, population)
    observe(population, count, path.X[0], history, 0)
    for m in range(1, path.t.size):
        if path.stop[0] != 0:
            break
        if count == population.order.size:
            population = with_room(population, 2 * count)
        count = advance_all(contacts, path, population, history, m, count, rate)
        observe(population, count, path.X[m], history, m)
    return history
