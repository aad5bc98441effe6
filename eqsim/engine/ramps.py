"""What contacts leave on the output grid: exact ramps of force in fixed point, one kernel for every run.

A life pinned from X0 to X1 adds kappa (X - X0) to the force between them, so it leaves six numbers, which do not depend
on X, at the first grid point j0 >= X0 and takes them back at the first j1 >= X1; cumulative sums over the grid then
give the exact force, its variance over contacts, and the number of pinned contacts at every point. Where the stiffness
follows an aging threshold the force is no ramp, and is left at each point for that point alone. Uniform stiffness makes
several of the numbers equal; if there is no delay either, a life begins where another ends, and what both leave is
added at once. All sums are of 64-bit integers (fixed point, one power of 2 per column, so small that no sum can
overflow): the result cannot depend on order, threads or blocks.
"""

import math
from typing import NamedTuple

import numpy as np

from eqsim.compiled import add_row, inlined, kernel, routine, take_row
from eqsim.engine.life import (
    LANES,
    ROUNDS,
    break_all,
    draw_rounds,
    langevin_all,
    spring_work,
    typical_lives,
)
from eqsim.engine.paths import STEP, PathLaw, langevin_life, walk
from eqsim.engine.standing import Standing, extremes, standing_contact
from eqsim.engine.streams import Key, fill_words, uniform, uniforms
from eqsim.ensemble import Contacts
from eqsim.errors import InputError
from eqsim.laws.aging import UNAGED, growth
from eqsim.laws.delay import delay_draw, residual_delay_draw
from eqsim.laws.octaves import Array
from eqsim.laws.stiffness import kappa
from eqsim.laws.thermal import MECHANICAL
from eqsim.laws.threshold import threshold_draw

BATCHES = 64  # independent groups whose scatter is the error of averages over the second half
_LEAST_UNITS = 2.0**10  # the typical force in units of the last bit, far below any statistical error
_LEAST_WORK = 2.0**5  # the mean work of a life in units of its own; laws so broad that it matters scatter far more
_BITS = 62  # of a sum; the sign and one more are left

# columns of the deposits; Y = -X0 is where the slider would have been pulled from. What stands in for the others where
# all contacts are equally stiff comes first
COUNT, FORCE, SQUARE, SLOPE, SLOPE2, RAMP2 = range(6)  # 1, kappa Y, (kappa Y)^2, kappa, kappa^2, kappa^2 Y
# columns of the batch sums, for each of the two quarters of the second half
AREA, PINNED, ELAPSED, BREAKS, STRETCH = range(5)


class Run(NamedTuple):
    """What a kernel needs to know of a run, lengths in units of the threshold law's scale."""

    distance: float
    points: int
    stationary: bool
    batch_by_life: bool  # few contacts: whole lives, not contacts, are the independent samples


class Scales(NamedTuple):
    """Powers of 2 that turn the deposits (6 columns), batch sums (5 columns) and replicas' forces into integers, and
    whether all contacts are equally stiff."""

    deposits: Array
    batches: Array
    replica: float
    replica_square: float
    even: bool

    @classmethod
    def of(cls, c: Contacts, run: Run, contacts: int, replicas: int, drag: float) -> "Scales":
        """The finest that no sum over all contacts can overflow, from the longest life there can be.

        Raises InputError if these are too coarse for the typical contact.
        """
        xi, x = extremes(c)
        x = x if run.stationary else min(x, run.distance)
        strong = kappa(c.kappa_slope, c.kappa_constant, xi)
        way = run.distance + x
        force = strong * x
        deposits = [1.0, strong * way, (strong * way) ** 2, strong, strong**2, strong**2 * way]
        batches = [force * way, way, way, 1.0, way]

        def power(bounds: list[float], terms: int) -> Array:
            return 2.0 ** np.floor(_BITS - np.log2(terms) - np.log2(bounds))

        work, stretch = typical_lives(c)
        typical = float(np.mean(work) / np.mean(stretch))
        by_column, by_batch = power(deposits, contacts), power(batches, contacts)
        if not (typical * by_column[FORCE] > _LEAST_UNITS and np.mean(work) * by_batch[AREA] > _LEAST_WORK):
            raise InputError(
                f"thresholds: the strongest of {contacts} contacts can carry {force / typical:.2g} times the typical "
                "force, too much to add up in 64 bits; take fewer contacts or a narrower law"
            )
        by_column[COUNT] = 1.0
        by_batch[BREAKS] = 1.0
        most = max(force, drag)
        by_replica = power([most, most**2], replicas)
        return cls(by_column, by_batch, float(by_replica[0]), float(by_replica[1]), c.kappa_slope == 0.0)


def moments(deposits: Array, scales: Scales, run: Run, contacts: int, drag: float) -> tuple[Array, Array, Array]:
    """Mean force, pinned fraction, and variance of the force over contacts, at every grid point."""
    X = np.linspace(0.0, run.distance, run.points, dtype=np.longdouble)  # squares cancel: 64 bits where there are
    total = np.cumsum(deposits, axis=0) / (scales.deposits * contacts).astype(np.longdouble)
    if scales.even:  # k_i/k = 1
        total[:, SLOPE] = total[:, SLOPE2] = total[:, COUNT]
        total[:, RAMP2] = total[:, FORCE]
    force = (total[:, SLOPE] * X + total[:, FORCE]).astype(float)
    square = ((total[:, SLOPE2] * X + 2.0 * total[:, RAMP2]) * X + total[:, SQUARE]).astype(float)
    pinned = total[:, COUNT].astype(float)
    detached = 1.0 - pinned
    force += drag * detached
    variance = np.maximum(square + drag**2 * detached - force**2, 0.0)
    # what rounding may hide of it, on ways so long that squares of X leave no room
    lost = 4.0 * np.finfo(np.longdouble).eps * total[:, SLOPE2] * X * X + (X > 0) / scales.deposits[SQUARE]
    return force, pinned, variance + lost.astype(float)


# ------------------------------------------------------------------------------------------------------- kernels


@inlined
def fixed(x: float, scale: float) -> int:
    """x in fixed point."""
    return int(np.rint(x * scale))


@inlined
def leave(deposits: Array, j: int, sign: int, stiffness: float, born: float, scales: Array) -> None:
    """Add (sign 1) or take back (sign -1) a life's ramp at a grid point."""
    ramp = stiffness * born
    deposits[j, COUNT] += sign
    deposits[j, SLOPE] += sign * fixed(stiffness, scales[SLOPE])
    deposits[j, FORCE] -= sign * fixed(ramp, scales[FORCE])
    deposits[j, SLOPE2] += sign * fixed(stiffness * stiffness, scales[SLOPE2])
    deposits[j, RAMP2] -= sign * fixed(stiffness * ramp, scales[RAMP2])
    deposits[j, SQUARE] += sign * fixed(ramp * ramp, scales[SQUARE])


@inlined
def deposit(deposits: Array, run: Run, stiffness: float, born: float, broke: float, scales: Array) -> None:
    """A life pinned at `born` <= X < `broke`."""
    per_step = (run.points - 1) / run.distance
    start = max(0, math.ceil(born * per_step))
    end = math.ceil(min(broke, 2.0 * run.distance) * per_step)
    if start < end:  # otherwise no grid point sees it
        if start < run.points:
            leave(deposits, start, 1, stiffness, born, scales)
        if end < run.points:
            leave(deposits, end, -1, stiffness, born, scales)


@inlined
def record(
    batches: Array, batch: int, run: Run, stiffness: float, born: float, broke: float, reborn: float, scales: Array
) -> None:
    """What a life and the delay after it leave in the two quarters of the second half."""
    for quarter in range(2):
        low = run.distance * (0.5 + 0.25 * quarter)
        high = low + 0.25 * run.distance
        start = max(born, low)
        end = min(broke, high)
        if end > start:
            batches[batch, quarter, AREA] += fixed(
                stiffness * (end - start) * (0.5 * (start + end) - born), scales[AREA]
            )
            batches[batch, quarter, PINNED] += fixed(end - start, scales[PINNED])
        end = min(reborn, high)
        if end > start:
            batches[batch, quarter, ELAPSED] += fixed(end - start, scales[ELAPSED])
        if low < broke <= high:
            batches[batch, quarter, BREAKS] += 1
            batches[batch, quarter, STRETCH] += fixed(broke - born, scales[STRETCH])


@inlined
def leave_force(deposits: Array, run: Run, j: int, force: float, scales: Array) -> None:
    """Add a force at one grid point."""
    deposits[j, FORCE] += fixed(force, scales[FORCE])
    deposits[j, SQUARE] += fixed(force * force, scales[SQUARE])
    if j + 1 < run.points:
        deposits[j + 1, FORCE] -= fixed(force, scales[FORCE])
        deposits[j + 1, SQUARE] -= fixed(force * force, scales[SQUARE])


@inlined
def leave_pinned(deposits: Array, run: Run, born: float, broke: float) -> None:
    """Count a life pinned at `born` <= X < `broke`."""
    per_step = (run.points - 1) / run.distance
    start, end = max(0, math.ceil(born * per_step)), math.ceil(min(broke, 2.0 * run.distance) * per_step)
    if start < end:
        if start < run.points:
            deposits[start, COUNT] += 1
        if end < run.points:
            deposits[end, COUNT] -= 1


@inlined
def point_after(x: float, run: Run, per_step: float) -> int:
    """The first grid point at or after x >= 0; `run.points` beyond the last one."""
    return math.ceil(min(x * per_step, float(run.points)))


@routine
def leave_ramps(
    r: int, born: Array, broke: Array, stiffness: Array, run: Run, deposits: Array, scales: Array,
    start: Array, end: Array, column: Array, lanes: int,
) -> None:  # fmt: skip
    """`deposit` for `lanes` contacts, born >= 0."""
    per_step = (run.points - 1) / run.distance
    for i in range(lanes):
        start[i], end[i] = point_after(born[i], run, per_step), point_after(broke[i], run, per_step)
    for i in range(lanes):
        kappa = stiffness[r, i]
        ramp = kappa * born[i]
        column[0, i] = fixed(ramp, -scales[FORCE])
        column[1, i] = fixed(ramp * ramp, scales[SQUARE])
        column[2, i] = fixed(kappa, scales[SLOPE])
        column[3, i] = fixed(kappa * kappa, scales[SLOPE2])
        column[4, i] = fixed(kappa * ramp, -scales[RAMP2])
    for i in range(lanes):
        if end[i] < run.points:
            row = (1, column[0, i], column[1, i], column[2, i], column[3, i], column[4, i])
            add_row(deposits, start[i], COUNT, row)
            take_row(deposits, end[i], COUNT, row)
        elif start[i] < run.points:
            leave(deposits, start[i], 1, stiffness[r, i], born[i], scales)


@routine
def leave_even_ramps(
    born: Array, broke: Array, run: Run, deposits: Array, scales: Array,
    start: Array, end: Array, column: Array, lanes: int,
) -> None:  # fmt: skip
    """`leave_ramps` of uniform stiffness, where COUNT and FORCE stand for the other columns."""
    per_step = (run.points - 1) / run.distance
    for i in range(lanes):
        start[i], end[i] = point_after(born[i], run, per_step), point_after(broke[i], run, per_step)
        column[0, i] = fixed(born[i], -scales[FORCE])
        column[1, i] = fixed(born[i] * born[i], scales[SQUARE])
    for i in range(lanes):
        if end[i] < run.points:
            row = (1, column[0, i], column[1, i], 0)  # four numbers at a time are moved at once
            add_row(deposits, start[i], COUNT, row)
            take_row(deposits, end[i], COUNT, row)
        elif start[i] < run.points:
            leave(deposits, start[i], 1, 1.0, born[i], scales)


@routine
def join_even_ramps(
    born: Array, broke: Array, run: Run, deposits: Array, scales: Array, end: Array, column: Array, lanes: int
) -> None:
    """Without delay a life begins where another, from `born` to `broke`, ends: with uniform stiffness nothing changes
    there but the square and the place of birth."""
    per_step = (run.points - 1) / run.distance
    for i in range(lanes):
        way = broke[i] - born[i]
        end[i] = point_after(broke[i], run, per_step)
        column[0, i] = fixed(way, -scales[FORCE])
        column[1, i] = fixed(way * (born[i] + broke[i]), scales[SQUARE])
    for i in range(lanes):
        if end[i] < run.points:
            add_row(deposits, end[i], FORCE, (column[0, i], column[1, i]))


@routine
def flow_force(
    c: Contacts, run: Run, deposits: Array, batches: Array, batch: int, stiffness: float, born: float, stretch: float,
    scales: Array, batch_scales: Array,
) -> None:  # fmt: skip
    """What a contact leaves whose stiffness, `stiffness` at birth, follows its threshold along `flow`."""
    step, per_step = run.distance / (run.points - 1), (run.points - 1) / run.distance
    broke = min(born + stretch, 2.0 * run.distance)
    for j in range(max(0, math.ceil(born * per_step)), min(run.points, math.ceil(broke * per_step))):
        x = max(j * step - born, 0.0)
        leave_force(deposits, run, j, stiffness * growth(c.final2, c.alpha, x) * x, scales)
    leave_pinned(deposits, run, born, born + stretch)
    for quarter in range(2):
        low = max(run.distance * (0.5 + 0.25 * quarter) - born, 0.0)
        high = min(run.distance * (0.75 + 0.25 * quarter) - born, stretch)
        if high > low:
            area = spring_work(c, stiffness, high) - spring_work(c, stiffness, low)
            batches[batch, quarter, AREA] += fixed(area, batch_scales[AREA])


@routine
def langevin_force(
    paths: PathLaw, key: Key, contact: int, life: int, xi: float, clock: float, born: float,
    run: Run, deposits: Array, batches: Array, batch: int, scales: Array, batch_scales: Array,
) -> float:  # fmt: skip
    """Stretch at breaking of a `langevin` contact, and what it leaves. Where its stiffness follows its threshold, its
    steps end at grid points, and nobody follows it beyond the last one."""
    if paths.kappa_slope == 0.0:
        stretch, _ = langevin_life(paths, key, contact, life, xi, clock, STEP)
        deposit(deposits, run, 1.0, born, born + stretch, scales)
        return stretch
    step, per_step = run.distance / (run.points - 1), (run.points - 1) / run.distance
    quarters = 0.25 * run.distance
    x, draw, broke, j = 0.0, np.int64(0), False, max(0, math.ceil(born * per_step))
    window = max(2, math.floor(born / quarters) + 1)  # the next edge of a window is at window * quarters
    while not broke:
        if j < run.points and j * step - born <= x:
            leave_force(deposits, run, j, kappa(paths.kappa_slope, paths.kappa_constant, xi) * x, scales)
            j += 1
            continue
        if window * quarters - born <= x:
            window += 1
            continue
        if window > 4 and j >= run.points:
            x = 2.0 * run.distance - born
            break
        stop = window * quarters - born
        if j < run.points:
            stop = min(stop, j * step - born)
        broke, xi, at, clock, work, draw = walk(paths, key, contact, life, draw, xi, x, clock, stop - x, STEP)
        if 2 < window < 5:
            batches[batch, window - 3, AREA] += fixed(work, batch_scales[AREA])
        x = at if broke or at < stop * (1.0 - 1e-15) else stop
    leave_pinned(deposits, run, born, born + x)
    return x


@routine
def found_contact(
    c: Contacts, paths: PathLaw, standing: Standing, key: Key, contact: int, residual: float,
    run: Run, deposits: Array, batches: Array, batch: int, scales: Array, batch_scales: Array,
) -> tuple[float, float, float]:  # fmt: skip
    """Birth, breaking and re-attachment of what a snapshot of the stationary state finds at X = 0, under `langevin`.

    A cycle of life and delay is found in proportion to its length (derived), so fresh cycles are tried, each begun at a
    uniform time before X = 0 within the longest cycle, until one is still under way. An exponential delay counts as a
    fixed one of the same mean: what is left of it is exponential again.
    """
    for attempt in range(32000):
        u, v = uniforms(key, contact, 0, 2 * attempt + 1)
        age = (standing.longest + c.delay) * uniforms(key, contact, 0, 2 * attempt + 2)[0]
        xi, path = threshold_draw(c.threshold_table, c.steps, u), 2**32 - 1 - attempt
        stretch = langevin_force(
            paths, key, contact, path, xi, -math.log(v), -age, run, deposits, batches, batch, scales, batch_scales
        )
        if stretch > age:
            return -age, stretch - age, 0.0
        if stretch + c.delay > age:
            rest = residual_delay_draw(c.delay, True, residual) if c.exponential else stretch + c.delay - age
            return -age, min(stretch - age, 0.0), rest
    return 0.0, 0.0, 0.0


@routine
def draw_delays(c: Contacts, key: Key, contact: Array, turn: Array, words: Array, delay: Array, lanes: int) -> None:
    """Delays after the next ROUNDS lives, shape (ROUNDS, lanes), where they are not fixed."""
    fill_words(key, contact, turn, 1, words, lanes)
    for r in range(ROUNDS):
        for i in range(lanes):
            delay[r, i] = delay_draw(c.delay, True, uniform(words[2 * r, i], words[2 * r + 1, i]))


@routine
def found_at_start(
    c: Contacts, paths: PathLaw | None, standing: Standing, key: Key, contact: int,
    run: Run, deposits: Array, batches: Array, scales: Array, batch_scales: Array,
) -> float:  # fmt: skip
    """Where a contact of the stationary start is pinned for the first time after what the start finds, its life 0."""
    batch = contact % BATCHES
    u_state, u_residual = uniforms(key, contact, 0, 0)
    gap = delay_draw(c.delay, c.exponential, uniforms(key, contact, 0, 65535)[0])
    if paths is not None:
        born, broke, reborn = found_contact(
            c, paths, standing, key, contact, u_residual, run, deposits, batches, batch, scales, batch_scales
        )
        spring = c.kappa_constant
        if born < 0.0 < broke:
            reborn = broke + gap
    elif u_state < standing.pinned:
        spring, x, ends = standing_contact(c, standing, key, contact, u_residual)
        born, broke = -x, ends - x
        if c.aging == UNAGED or c.kappa_slope == 0.0:
            deposit(deposits, run, spring, born, broke, scales)
        else:
            flow_force(c, run, deposits, batches, batch, spring, born, ends, scales, batch_scales)
            spring = 0.0
        reborn = broke + gap
    else:
        spring, born, broke = 0.0, 0.0, 0.0
        reborn = residual_delay_draw(c.delay, c.exponential, u_residual)
    record(batches, batch, run, spring, born, broke, reborn, batch_scales)
    return reborn


@routine
def live(
    c: Contacts, paths: PathLaw | None, key: Key, contact: int, life: int, stiffness: float, stretch: float,
    clock: float, gap: float, born: float, run: Run, deposits: Array, batches: Array, scales: Array,
    batch_scales: Array,
) -> float:  # fmt: skip
    """One life on its own and the delay `gap` after it, and where they end. `stretch` at breaking, or under `langevin`
    the threshold at birth."""
    batch = (contact + life * run.batch_by_life) % BATCHES
    if paths is not None:
        stiffness = c.kappa_constant
        stretch = langevin_force(
            paths, key, contact, life, stretch, clock, born, run, deposits, batches, batch, scales, batch_scales
        )
    elif c.aging != UNAGED and c.kappa_slope > 0.0:
        flow_force(c, run, deposits, batches, batch, stiffness, born, stretch, scales, batch_scales)
        stiffness = 0.0
    else:
        deposit(deposits, run, stiffness, born, born + stretch, scales)
    broke = born + stretch
    if broke + gap > 0.5 * run.distance:
        record(batches, batch, run, stiffness, born, broke, broke + gap, batch_scales)
    return broke + gap


@inlined
def edge_after(run: Run, x: float) -> float:
    """The end of the half or quarter that x lies in; infinite beyond the last."""
    if x <= 0.5 * run.distance:
        return 0.5 * run.distance
    if x <= 0.75 * run.distance:
        return 0.75 * run.distance
    return run.distance if x <= run.distance else math.inf


@routine
def cross(
    batches: Array, batch: int, run: Run, edge: float, work: float, way: float, elapsed: float, lives: int,
    stiffness: float, born: float, broke: float, reborn: float, scales: Array,
) -> None:  # fmt: skip
    """What a contact's lives and delays leave in the quarter that ends at `edge`, and a last life that crosses it."""
    if edge > 0.5 * run.distance:
        quarter = 0 if edge < run.distance else 1
        batches[batch, quarter, AREA] += fixed(work, scales[AREA])
        batches[batch, quarter, PINNED] += fixed(way, scales[PINNED])
        batches[batch, quarter, ELAPSED] += fixed(elapsed, scales[ELAPSED])
        batches[batch, quarter, BREAKS] += lives
        batches[batch, quarter, STRETCH] += fixed(way, scales[STRETCH])
    record(batches, batch, run, stiffness, born, broke, reborn, scales)


@kernel
def simulate(
    c: Contacts,
    paths: PathLaw | None,
    standing: Standing,
    run: Run,
    scales: Array,
    batch_scales: Array,
    key: Key,
    deposits: Array,
    batches: Array,
    status: Array,
    first: int,
    last: int,
) -> None:
    """Follow contacts first <= i < last over the whole distance, LANES at a time, and add up what they leave.

    A contact's lives come in order of position, so what they leave in the batch sums is added up on the way and noted
    when a life crosses the end of a quarter; only that life has to be divided. Contacts start together, so that they
    all write in one stretch of the grid, and new ones fill the lanes only when half of them have come to the end.
    """
    contact, turn, mark = np.empty(LANES, np.int64), np.empty(LANES, np.int64), np.empty(LANES, np.int64)
    position, edge, since = np.full(LANES, math.inf), np.empty(LANES), np.empty(LANES)  # idle lanes are at infinity
    work, way = np.empty(LANES), np.empty(LANES)  # since the displacement `since`, where a contact was `mark` lives old
    stiffness, stretch = np.full((ROUNDS, LANES), c.kappa_constant), np.empty((ROUNDS, LANES))
    clock, delay = np.full((ROUNDS, LANES), math.inf), np.full((ROUNDS, LANES), c.delay)
    broke, reborn = np.empty(LANES), np.empty(LANES)
    index, start, end = np.empty(LANES, np.int64), np.empty(LANES, np.int64), np.empty(LANES, np.int64)
    words, column = np.empty((4, LANES), np.uint64), np.empty((5, LANES), np.int64)
    per_step = (run.points - 1) / run.distance
    even = c.kappa_slope == 0.0
    one_by_one = run.batch_by_life or (c.aging != UNAGED and not even)
    joined = even and c.delay == 0.0 and not one_by_one
    oldest = 1 if run.stationary else 0
    table, steps = c.threshold_table, c.steps
    active, upcoming = 0, first
    while True:
        if 2 * active <= LANES:
            while active < LANES and upcoming < last:
                contact[active], turn[active], position[active] = upcoming, oldest, 0.0
                if run.stationary:
                    position[active] = found_at_start(
                        c, paths, standing, key, upcoming, run, deposits, batches, scales, batch_scales
                    )
                upcoming += 1
                x = position[active]
                if x > run.distance:
                    position[active] = math.inf
                    continue
                if joined and x * per_step <= run.points - 1:
                    leave(deposits, math.ceil(x * per_step), 1, 1.0, x, scales)
                edge[active], since[active], mark[active] = edge_after(run, x), x, ROUNDS * oldest
                work[active], way[active] = 0.0, 0.0
                active += 1
        if active == 0 or status[1] != 0:
            return

        full = min(LANES, (active + 31) // 32 * 32)  # no loop has a tail of single lanes; what is left over is idle
        draw_rounds(
            table, steps, c.exponentials, c.breaking == MECHANICAL, key, contact, turn,
            index, words, stretch, clock, full,
        )  # fmt: skip
        if c.exponential:
            draw_delays(c, key, contact, turn, words, delay, full)
        if paths is None:
            break_all(c, stretch, clock, stiffness, index, full)
        elif not one_by_one:
            langevin_all(paths, key, contact, turn, stretch, clock, index, active)
        ended = False
        for r in range(ROUNDS):
            if one_by_one:
                for i in range(active):
                    if position[i] <= run.distance:
                        position[i] = live(
                            c, paths, key, contact[i], ROUNDS * turn[i] + r, stiffness[r, i], stretch[r, i],
                            clock[r, i], delay[r, i], position[i], run, deposits, batches, scales, batch_scales,
                        )  # fmt: skip
                        status[0] += 1
                ended = True
                continue

            for i in range(full):
                x = stretch[r, i]
                work[i] += 0.5 * stiffness[r, i] * x * x
                broke[i] = position[i] + x
                reborn[i] = broke[i]
            if joined:
                join_even_ramps(position, broke, run, deposits, scales, end, column, full)
            else:
                for i in range(full):
                    way[i] += stretch[r, i]
                    reborn[i] = broke[i] + delay[r, i]
                if even:
                    leave_even_ramps(position, broke, run, deposits, scales, start, end, column, full)
                else:
                    leave_ramps(r, position, broke, stiffness, run, deposits, scales, start, end, column, full)
            crossing = 0
            for i in range(active):
                crossing += reborn[i] > edge[i]
            for i in range(active if crossing > 0 else 0):
                if reborn[i] > edge[i]:
                    x, spring, life = stretch[r, i], stiffness[r, i], ROUNDS * turn[i] + r
                    elapsed = position[i] - since[i]
                    cross(
                        batches, contact[i] % BATCHES, run, edge[i], work[i] - 0.5 * spring * x * x,
                        elapsed if c.delay == 0.0 else way[i] - x, elapsed, life - mark[i],  # to the last bit
                        spring, position[i], broke[i], reborn[i], batch_scales,
                    )  # fmt: skip
                    edge[i], since[i], mark[i] = edge_after(run, reborn[i]), reborn[i], life + 1
                    work[i], way[i] = 0.0, 0.0
                    if reborn[i] > run.distance:
                        status[0] += life + 1 - ROUNDS * oldest
                        ended = True
            for i in range(active):
                position[i] = reborn[i]
        for i in range(active):
            turn[i] += 1
        if ended:
            for i in range(active - 1, -1, -1):
                if position[i] > run.distance:
                    active -= 1
                    contact[i], turn[i], mark[i] = contact[active], turn[active], mark[active]
                    position[i], edge[i], since[i] = position[active], edge[active], since[active]
                    work[i], way[i] = work[active], way[active]
                    position[active] = math.inf
