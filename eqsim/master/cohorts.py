"""Cohorts of contacts along a programme: the kernels of `master.programme` and
`master.slider`.

A cohort is the births of a step, spread evenly over it in time and displacement, or
several of these joined. This module follows `PooledContacts`, which heat does not
break, or breaks all at the same rate (annealed): the law of thresholds and the greatest
|x|/g so far, g the growth of thresholds, give the share of a cohort that has broken
mechanically, beside a thermal survival. `master.fronts` follows the others. Starts,
births, the joining of cohorts and sums are the same for both, and here.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from eqsim.laws.aging.base import growth
from eqsim.laws.delay import DrawnWaits, begun_at
from eqsim.numerics.compiled import by_law, kernel, routine
from eqsim.numerics.tables import Array, search
from eqsim.numerics.vector_math import exp, exp_less_one

# Cohorts with a smaller pinned share are dropped.
NEGLIGIBLE_SHARE = 1e-15
# Share of the whole time within which births count as simultaneous.
_SAME_TIME = 1e-11


class LawTables(NamedTuple):
    """Tables at y, shape (knots,): E[(k_i/k)^p; xi > y] and its integral from 0, for
    p = 0, 1, 2, shape (3, knots); and ln of the thermal rate of all contacts at stretch
    y."""

    y: Array
    above: Array
    total: Array
    log_rate: Array


class Growth(NamedTuple):
    """Growth of thresholds with age: the law of aging, whether they grow at all, and
    whether the stiffness follows them."""

    law: Any
    ages: bool
    stiffens: bool


class PooledContacts(NamedTuple):
    """Contacts for kernels that all have the same hazard. `nodes`, thresholds whose
    hazards are followed one by one, is empty."""

    tables: LawTables
    growth: Growth
    delay: Any  # `Waits` or `DrawnWaits`
    nodes: Array


# Fates of a cohort at the end of a step; one that is joined becomes part of the cohort
# before.
KEPT = 0
DROPPED = 1
JOINED = 2

# Decisions of a step: when it ends, where in `Choices.fates` those of its cohorts
# begin, in how many trials the force was balanced, how often the largest displacement
# was halved if the slider moved in no time, and whether it did.
DECISION = np.dtype("f8, i8, i8, i8, ?", align=True)
DECISION.names = ("t", "first", "trials", "halvings", "instant")


class Choices(NamedTuple):
    """Decisions of a solve: of each step, an array (edges + 1,) of DECISION, and the
    fates of cohorts. If `given`, a solve repeats them, which makes it a smooth function
    of parameters; else it notes them, as far as there is room."""

    steps: Array
    fates: Array
    given: bool


def unmade_choices(edges: int, fates: int) -> Choices:
    """Room for the choices of a solve."""
    return Choices(np.zeros(edges + 1, DECISION), np.zeros(fates, np.int8), False)


NO_CHOICES = unmade_choices(0, 0)


class CohortPath(NamedTuple):
    """Times and displacements of the edges of steps, arrays (edges,); the largest width
    of a cohort in X, and the largest share of its age that it may span in time; the
    most cohorts of a stationary start and their width in X, after a `velocity`, 0 for a
    fresh start; decisions; and a flag (1,) that ends the march early once it is set."""

    t: Array
    X: Array
    width: float
    share: float
    cohorts: int
    first_width: float
    velocity: float
    choices: Choices
    stop: Array


class History(NamedTuple):
    """Means over all contacts at the edges of steps, arrays (edges,): elastic force,
    pinned share, square of the elastic force, and breaks so far, per contact."""

    force: Array
    pinned: Array
    square: Array
    breaks: Array


class PathStep(NamedTuple):
    """Time and displacement at the beginning and the end of a step."""

    t0: float
    X0: float
    t1: float
    X1: float


# A row of an array of COHORT, whose fields are attributes in kernels. `first`, `last`
# and `mean`: of the first birth, the last birth, and the mean over its contacts.
# `weakest`: the greatest |x|/g so far; all thresholds at birth below it have broken.
# `births`: births of the cohort; if pooled, less the share that heat has broken.
# `pinned`: share of all contacts that are in the cohort and pinned; `stiffness` and
# `stiffness2`: E[k_i/k; pinned] and E[(k_i/k)^2; pinned] of these.
Cohort = Any
_FIELDS = """X_first X_last X_mean t_first t_last t_mean weakest_first weakest_last
    births pinned stiffness stiffness2"""
COHORT = np.dtype([(field, np.float64) for field in _FIELDS.split()], align=True)


class Scratch(NamedTuple):
    """Work arrays (nodes,): ln z at the older and the newer edge of a cohort; and for
    the births of a step, E[1], E[u] and E[u^2] of survivors, u the age over the step,
    and z before a substep."""

    older: Array
    newer: Array
    share: Array
    age: Array
    age2: Array
    before: Array


class Cohorts(NamedTuple):
    """All cohorts, an array (rows,) of COHORT; the integrated hazard z of each node for
    their first births, shape (rows, nodes); and `order`, the rows in use from the
    oldest cohort on, then the free ones."""

    rows: Array
    z: Array
    order: Array
    scratch: Scratch


@routine
def empty(nodes: int, rows: int) -> Cohorts:
    """Room for `rows` cohorts."""
    order, lines = np.zeros(rows, np.int64), np.zeros((6, nodes))
    for i in range(rows):
        order[i] = i
    scratch = Scratch(lines[0], lines[1], lines[2], lines[3], lines[4], lines[5])
    return Cohorts(np.zeros(rows, COHORT), np.zeros((rows, nodes)), order, scratch)


@routine
def with_room(cohorts: Cohorts, count: int, rows: int) -> Cohorts:
    """A copy of the `count` cohorts in use with room for `rows`."""
    larger = empty(cohorts.z.shape[1], rows)
    for i in range(cohorts.order.size):
        larger.order[i] = cohorts.order[i]
    for j in cohorts.order[:count]:
        larger.rows[j] = cohorts.rows[j]
        copy(cohorts.z[j], larger.z[j])
    return larger


@routine(inline=True)
def copy(values: Array, to: Array) -> None:
    """Copy an array; `to[:] = values` takes long to compile."""
    for k in range(values.size):
        to[k] = values[k]


@routine(inline=True)
def _integral_to(tables: LawTables, power: int, y: float) -> tuple[float, float]:
    """E[(k_i/k)^p; xi > y], and its integral from 0 to y."""
    i = search(tables.y, y, True) - 1
    if i >= tables.y.size - 1:
        return 0.0, tables.total[power, tables.y.size - 1]
    u, left = y - tables.y[i], tables.above[power, i]
    slope = (tables.above[power, i + 1] - left) / (tables.y[i + 1] - tables.y[i])
    return left + slope * u, tables.total[power, i] + u * (left + 0.5 * slope * u)


@routine
def _mean_above(tables: LawTables, power: int, low: float, high: float) -> float:
    """E[(k_i/k)^p; xi > y] in the mean over low < y < high."""
    above, total = _integral_to(tables, power, high)
    if high - low <= 1e-9 * high:
        return above
    return (total - _integral_to(tables, power, low)[1]) / (high - low)


@routine(inline=True)
def mean_exponential(low: float, high: float) -> float:
    """Mean of e^-E, E spread evenly between two values."""
    d = max(abs(high - low), 1e-200)
    return exp(-min(low, high)) * exp_less_one(-min(d, 700.0)) / -d


@routine
def _log_pooled_rate(tables: LawTables, x: float) -> float:
    i = min(search(tables.y, x, True), tables.y.size - 1) - 1  # y begins with 0
    width = tables.y[i + 1] - tables.y[i]
    u = min(max((x - tables.y[i]) / width, 0.0), 1.0) if width > 0.0 else 0.0
    return tables.log_rate[i] + u * (tables.log_rate[i + 1] - tables.log_rate[i])


@routine
def _hazard_in_step(tables: LawTables, dt: float, x0: float, x1: float) -> float:
    """Integrated hazard in a step between two stretches."""
    low, high = -_log_pooled_rate(tables, x0), -_log_pooled_rate(tables, x1)
    return dt * mean_exponential(low, high) if min(low, high) < 700.0 else 0.0


@routine
def _find_pinned(contacts: PooledContacts, cohort: Cohort, age: float) -> None:
    """Find the pinned share and the stiffness of a cohort."""
    g = growth(contacts.growth.law, age) if contacts.growth.stiffens else 1.0
    low = min(cohort.weakest_first, cohort.weakest_last)
    high = max(cohort.weakest_first, cohort.weakest_last)
    births, tables = cohort.births, contacts.tables
    cohort.pinned = births * _mean_above(tables, 0, low, high)
    cohort.stiffness = births * _mean_above(tables, 1, low, high) * g
    cohort.stiffness2 = births * _mean_above(tables, 2, low, high) * g * g


class Ages(NamedTuple):
    """Survivors, at the end of a step, of births spread evenly over it: their share,
    and their mean age and mean square age in units of the step."""

    share: float
    age: float
    age2: float


@routine(inline=True)
def ages_of_survivors(hazard: float) -> Ages:
    """Ages of survivors if the integrated hazard grows evenly with age up to
    `hazard`."""
    age, age2 = 0.5 - hazard / 12.0, 1.0 / 3.0 - hazard / 12.0
    if hazard > 0.02:
        rest = 1.0 / (exp(min(hazard, 700.0)) - 1.0)
        age = 1.0 / hazard - rest
        age2 = 2.0 / hazard**2 - (1.0 + 2.0 / hazard) * rest
    return Ages(mean_exponential(0.0, hazard), age, age2)


# Functions with one version per kind of contacts, the first argument; here of pooled
# ones.


@by_law(makes_arrays=True)
def bear(contacts: Any, cohorts: Cohorts, row: int, step: PathStep) -> None:
    """Find what is pinned at the end of a step of one birth spread over it; `_born` has
    begun the cohort."""
    cohort, dt = cohorts.rows[row], step.t1 - step.t0
    hazard = _hazard_in_step(contacts.tables, dt, 0.0, abs(step.X1 - step.X0))
    left = ages_of_survivors(hazard)
    cohort.births = left.share
    _find_pinned(contacts, cohort, 0.5 * dt)
    # `observe` takes them at the middle and spread evenly; survivors are younger
    cohort.stiffness *= 2.0 * left.age
    cohort.stiffness2 *= 3.0 * left.age2


@by_law(makes_arrays=True)
def carry(contacts: Any, cohorts: Cohorts, row: int, step: PathStep) -> None:
    """Find what of a cohort is pinned after a step; younger cohorts come before it."""
    cohort, dt = cohorts.rows[row], step.t1 - step.t0
    before, after = abs(step.X0 - cohort.X_mean), abs(step.X1 - cohort.X_mean)
    cohort.births *= exp(-_hazard_in_step(contacts.tables, dt, before, after))
    _find_pinned(contacts, cohort, step.t1 - cohort.t_mean)


# Bookkeeping of both kinds.


@routine(inline=True)
def _strain(contacts: Any, step: PathStep, X: float, t: float) -> float:
    """|x|/g at the end of a step of contacts born at X and t."""
    return abs(step.X1 - X) / growth(contacts.growth.law, step.t1 - t)


@routine
def _born(contacts: Any, cohorts: Cohorts, row: int, step: PathStep) -> Cohort:
    """Begin a cohort with one birth, spread evenly over a step."""
    cohort = cohorts.rows[row]
    cohort.X_first = step.X0
    cohort.X_last = step.X1
    cohort.X_mean = 0.5 * (step.X0 + step.X1)
    cohort.t_first = step.t0
    cohort.t_last = step.t1
    cohort.t_mean = 0.5 * (step.t0 + step.t1)
    cohort.weakest_first = _strain(contacts, step, step.X0, step.t0)
    cohort.weakest_last = 0.0
    cohort.births = 1.0
    bear(contacts, cohorts, row, step)
    return cohort


@routine
def _carry_over(contacts: Any, cohorts: Cohorts, row: int, step: PathStep) -> Cohort:
    """Carry a cohort over a step, after all younger ones."""
    cohort = cohorts.rows[row]
    first = _strain(contacts, step, cohort.X_first, cohort.t_first)
    last = _strain(contacts, step, cohort.X_last, cohort.t_last)
    cohort.weakest_first = max(cohort.weakest_first, first)
    cohort.weakest_last = max(cohort.weakest_last, last)
    carry(contacts, cohorts, row, step)
    return cohort


@routine(inline=True)
def _scale(cohort: Cohort, births: float) -> None:
    """Turn a cohort of one birth into one of `births`."""
    cohort.births *= births
    cohort.pinned *= births
    cohort.stiffness *= births
    cohort.stiffness2 *= births


@routine
def begin(contacts: Any, path: CohortPath, cohorts: Cohorts) -> tuple[int, float]:
    """Fill in the first cohorts: all contacts born now, or a steady state, in which all
    stages of the life of one cohort exist at once; returns their number, and the births
    per unit time before."""
    if path.cohorts == 0:
        _born(contacts, cohorts, 0, PathStep(0.0, 0.0, 0.0, 0.0))
        return 1, 0.0
    width, count = path.first_width, 0
    dt, cycle = width / path.velocity, contacts.delay.mean
    step = PathStep(-dt, -width, 0.0, 0.0)
    for i in range(path.cohorts):
        if i == 0:
            cohort = _born(contacts, cohorts, 0, step)
        else:
            cohorts.rows[i] = cohorts.rows[i - 1]
            copy(cohorts.z[i - 1], cohorts.z[i])
            cohort = cohorts.rows[i]
            cohort.X_first -= width
            cohort.X_last -= width
            cohort.X_mean -= width
            cohort.t_first -= dt
            cohort.t_last -= dt
            cohort.t_mean -= dt
            _carry_over(contacts, cohorts, i, step)
        cycle += cohort.pinned * dt
        count += 1
        if cohort.pinned < NEGLIGIBLE_SHARE and not path.choices.given:
            break
    for i in range(count):
        _scale(cohorts.rows[i], dt / cycle)
        cohorts.order[i] = count - 1 - i
    return count, 1.0 / cycle


@routine(inline=True)
def _broken_by(
    path: CohortPath, breaks: Array, last: int, t: float, rate: float
) -> float:
    """Breaks up to time t, no later than edge `last`; `rate` is that before time 0."""
    if t <= 0.0:
        return rate * t
    i = min(search(path.t, t, True), last) - 1
    share = (t - path.t[i]) / (path.t[i + 1] - path.t[i])
    return breaks[i] + (breaks[i + 1] - breaks[i]) * share


@by_law
def _due(
    delay: Any, path: CohortPath, history: History, m: int, rate: float
) -> tuple[float, float]:
    """Births in step m of contacts detached before it, by the law of delays; and the
    time which, times the breaks per unit time, gives those of contacts that break in
    it."""
    tau, t0, t1, breaks = delay.mean, path.t[m - 1], path.t[m], history.breaks
    dt, due, later = t1 - t0, 0.0, t1 - t0
    if delay.random > 0.0:
        ending = math.expm1(-dt / tau)
        due, later = -(1.0 - history.pinned[m - 1]) * ending, dt + tau * ending
    elif tau == math.inf:
        later = 0.0
    elif tau > 0.0:
        due = _broken_by(path, breaks, m - 1, min(t1 - tau, t0), rate)
        due -= _broken_by(path, breaks, m - 1, t0 - tau, rate)
        later = max(dt - tau, 0.0)
    return due, later


@_due.register(DrawnWaits)
def _due_by_law(
    delay: DrawnWaits, path: CohortPath, history: History, m: int, rate: float
) -> tuple[float, float]:
    # births by t, of breaks at a constant rate g from a to b, increase at the rate g
    # (P(t - a) - P(t - b)), with the integral tau I of P = 1 - `above` (derived)
    tau, t, breaks = delay.mean, path.t, history.breaks
    newer, i = begun_at(delay, (t[m] - t[m - 1]) / tau, 0)
    later, due, k = t[m] - t[m - 1] - tau * newer, 0.0, 0
    for j in range(m - 1, 0, -1):
        older, i = begun_at(delay, (t[m] - t[j - 1]) / tau, i)
        past, k = begun_at(delay, (t[m - 1] - t[j - 1]) / tau, k)
        older -= past
        due += (breaks[j] - breaks[j - 1]) / (t[j] - t[j - 1]) * (newer - older)
        newer = older
    return tau * (due + rate * newer), later


@routine
def _births_in(
    delay: Any,
    path: CohortPath,
    history: History,
    m: int,
    rate: float,
    pinned: float,
    newborn: float,
) -> float:
    """Note the breaks of step m and return its births. At its end, `pinned` of the
    contacts pinned before are still so, and the share `newborn` of the births is."""
    dt, breaks = path.t[m] - path.t[m - 1], history.breaks
    due, later = _due(delay, path, history, m, rate)
    lost = history.pinned[m - 1] - pinned + due * (1.0 - newborn)
    # newborn contacts may be broken but for 1e-20 of them
    per_time = lost / (dt - later + later * newborn)
    breaks[m] = breaks[m - 1] + per_time * dt
    return due + per_time * later


@routine(inline=True)
def _weight(contacts: Any, cohort: Cohort) -> float:
    """Weight of a cohort in joint means: its pinned share, or its births if neighbours
    share edges, as a cohort in their midst stays when nothing of it is pinned."""
    return cohort.births if contacts.nodes.size else cohort.pinned


@routine
def _alike(
    contacts: Any, path: CohortPath, older: Cohort, newer: Cohort, now: float
) -> bool:
    """True if two cohorts may be joined: born in the same direction and about as dense
    in X, and together not too wide in X over the growth of thresholds, in |x|/g and in
    time over age."""
    age = now - newer.t_last
    if newer.t_last - older.t_first > path.share * age + _SAME_TIME:
        return False
    if abs(older.weakest_first - newer.weakest_last) > path.width:
        return False
    if abs(newer.X_last - older.X_first) > path.width * growth(
        contacts.growth.law, age
    ):
        return False
    first = (older.X_last - older.X_first) * _weight(contacts, newer)
    second = (newer.X_last - newer.X_first) * _weight(contacts, older)
    factor = abs(first) <= 2.0 * abs(second) and abs(second) <= 2.0 * abs(first)
    return first * second >= 0.0 and factor


@routine
def _join(contacts: Any, older: Cohort, newer: Cohort) -> None:
    """Join a cohort to the older one before it."""
    first, second = _weight(contacts, older), _weight(contacts, newer)
    share = second / (first + second) if first + second > 0.0 else 0.5
    older.X_mean += share * (newer.X_mean - older.X_mean)
    older.t_mean += share * (newer.t_mean - older.t_mean)
    older.X_last = newer.X_last
    older.t_last = newer.t_last
    older.weakest_last = newer.weakest_last
    older.births += newer.births
    older.pinned += newer.pinned
    older.stiffness += newer.stiffness
    older.stiffness2 += newer.stiffness2


@routine
def advance_all(
    contacts: Any,
    path: CohortPath,
    cohorts: Cohorts,
    history: History,
    m: int,
    count: int,
    rate: float,
) -> int:
    """Carry all `count` cohorts over step m, and add its births; returns the number of
    cohorts then. `rate` is the births per unit time before the path began."""
    step, pinned = PathStep(path.t[m - 1], path.X[m - 1], path.t[m], path.X[m]), 0.0
    rows, order, choices = cohorts.rows, cohorts.order, path.choices
    new = _born(contacts, cohorts, order[count], step)
    for i in range(count - 1, -1, -1):
        pinned += _carry_over(contacts, cohorts, order[i], step).pinned
    _scale(new, _births_in(contacts.delay, path, history, m, rate, pinned, new.pinned))
    noted = not choices.given and m + 1 < choices.steps.size
    kept, first = 0, choices.steps[m].first if choices.given or noted else 0
    # drop cohorts of which nothing is pinned, and join those that hardly differ
    for i in range(count + 1):
        j, fate = order[i], KEPT
        cohort, before = rows[j], rows[order[max(kept - 1, 0)]]
        # of neighbours that share edges only the first may go
        droppable = contacts.nodes.size == 0 or (kept == 0 and i < count)
        if choices.given:
            fate = choices.fates[first + i]
        elif cohort.pinned < NEGLIGIBLE_SHARE and droppable:
            fate = DROPPED
        elif kept > 0 and _alike(contacts, path, before, cohort, path.t[m]):
            fate = JOINED
        if noted and first + i < choices.fates.size:
            choices.fates[first + i] = fate
        if fate == JOINED:
            _join(contacts, before, cohort)
        if fate == KEPT:
            order[i], order[kept] = order[kept], j
            kept += 1
    if noted:
        choices.steps[m + 1].first = first + count + 1
    return kept


@routine
def observe(cohorts: Cohorts, count: int, X: float, history: History, m: int) -> float:
    """Add up the force, the pinned share and the mean square of all cohorts at edge m;
    returns the stiffness of all pinned contacts."""
    force, pinned, square, stiffness = 0.0, 0.0, 0.0, 0.0
    for i in range(count):
        cohort = cohorts.rows[cohorts.order[i]]
        x, width = X - cohort.X_mean, cohort.X_last - cohort.X_first
        force += x * cohort.stiffness
        pinned += cohort.pinned
        stiffness += cohort.stiffness
        square += (x * x + width**2 / 12.0) * cohort.stiffness2
    history.force[m], history.pinned[m], history.square[m] = force, pinned, square
    return stiffness


@kernel(makes_arrays=True)
def march(contacts: Any, path: CohortPath) -> History:
    """Follow contacts along a path."""
    means = np.zeros((4, path.t.size))
    history = History(means[0], means[1], means[2], means[3])
    cohorts = empty(contacts.nodes.size, 256 + path.cohorts)
    count, rate = begin(contacts, path, cohorts)
    observe(cohorts, count, path.X[0], history, 0)
    for m in range(1, path.t.size):
        if path.stop[0] != 0:
            break
        if count == cohorts.order.size:
            cohorts = with_room(cohorts, count, 2 * count)
        count = advance_all(contacts, path, cohorts, history, m, count, rate)
        observe(cohorts, count, path.X[m], history, m)
    return history


class BlockState(NamedTuple):
    """Contacts of a block of a chain at an edge: cohorts, their number, births per unit time
    before the path began, and the stiffness of those pinned."""

    cohorts: Cohorts
    kept: int
    rate: float
    stiffness: float


@routine
def begun(contacts: Any, path: CohortPath, history: History) -> BlockState:
    """Contacts at the beginning of a path."""
    cohorts = empty(contacts.nodes.size, 256 + path.cohorts)
    count, rate = begin(contacts, path, cohorts)
    stiffness = observe(cohorts, count, path.X[0], history, 0)
    return BlockState(cohorts, count, rate, stiffness)


@routine
def advanced(
    contacts: Any, path: CohortPath, block: BlockState, history: History, m: int
) -> BlockState:
    """Contacts after step m, whose end `path` has already; a copy, as the step may be
    tried again."""
    count, rows = block.kept, block.cohorts.order.size
    after = with_room(block.cohorts, count, 2 * count if count == rows else rows)
    kept = advance_all(contacts, path, after, history, m, count, block.rate)
    stiffness = observe(after, kept, path.X[m], history, m)
    return BlockState(after, kept, block.rate, stiffness)


class Kinds(NamedTuple):
    """Contacts of a kind behind one slider, their path and means in units of their law;
    that unit over the slider's, and their shares of the number and of the stiffness of
    all contacts. `others`: the other kinds, `Kinds` again; None after the last."""

    contacts: Any
    path: CohortPath
    history: History
    unit: float
    share: float
    weight: float
    others: Any


class KindStates(NamedTuple):
    """State of the contacts of a kind, and of the others."""

    state: BlockState
    others: Any


class Total(NamedTuple):
    """Force, pinned share and stiffness of all kinds at the edges of steps, arrays
    (edges,), in units of the slider."""

    force: Array
    pinned: Array
    stiffness: Array


@routine
def _add(kinds: Kinds, state: BlockState, total: Total, m: int) -> None:
    """Add a kind to the totals at edge m."""
    total.force[m] += kinds.weight * kinds.unit * kinds.history.force[m]
    total.pinned[m] += kinds.share * kinds.history.pinned[m]
    total.stiffness[m] += kinds.weight * state.stiffness


# Each calls itself for the other kinds, whose types may differ, and so one by one.


@by_law(makes_arrays=True)
def begin_kinds(kinds: Any, total: Total) -> Any:
    """States of all kinds at the beginning of their paths."""
    return None


@begin_kinds.register(Kinds)
def _begin_kinds(kinds: Kinds, total: Total) -> KindStates:
    state = begun(kinds.contacts, kinds.path, kinds.history)
    others = begin_kinds(kinds.others, total)
    _add(kinds, state, total, 0)
    return KindStates(state, others)


@by_law(makes_arrays=True)
def advance_kinds(kinds: Any, before: Any, total: Total, m: int, X: float) -> Any:
    """States of all kinds after step m, at whose end the slider is at X; copies."""
    total.force[m], total.pinned[m], total.stiffness[m] = 0.0, 0.0, 0.0
    return None


@advance_kinds.register(Kinds)
def _advance_kinds(
    kinds: Kinds, before: KindStates, total: Total, m: int, X: float
) -> KindStates:
    kinds.path.X[m] = X / kinds.unit
    others = advance_kinds(kinds.others, before.others, total, m, X)
    state = advanced(kinds.contacts, kinds.path, before.state, kinds.history, m)
    _add(kinds, state, total, m)
    return KindStates(state, others)
