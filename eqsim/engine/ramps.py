"""What contacts leave on the output grid: exact ramps of force in fixed point, one kernel for every run.

A life pinned from X0 to X1 adds kappa (X - X0) to the force between them, so it leaves six numbers at the first grid
point j0 >= X0 and takes them back at the first j1 >= X1; cumulative sums over the grid then give the exact force, its
variance over contacts, and the number of pinned contacts at every point. Where the stiffness follows an aging threshold
the force is no ramp, and is left at each point for that point alone. All sums are of 64-bit integers (fixed point,
one power of 2 per column, so small that no sum can overflow): the result cannot depend on order, threads or blocks.
"""

import math
from typing import NamedTuple

import numpy as np

from eqsim.compiled import inlined, kernel, routine
from eqsim.engine.life import draw_lives, spring_work, typical_lives
from eqsim.engine.paths import STEP, langevin_life, walk
from eqsim.engine.standing import Standing, extremes, standing_contact
from eqsim.engine.streams import Key, uniforms
from eqsim.ensemble import Contacts
from eqsim.errors import InputError
from eqsim.laws.aging import LANGEVIN, UNAGED, growth
from eqsim.laws.delay import delay_draw, residual_delay_draw
from eqsim.laws.octaves import Array
from eqsim.laws.stiffness import kappa
from eqsim.laws.threshold import threshold_draw

LANES = 128  # contacts that advance together
BATCHES = 64  # independent groups whose scatter is the error of averages over the second half
_LEAST_UNITS = 2.0**10  # the typical force in units of the last bit, far below any statistical error
_BITS = 62  # of a sum; the sign and one more are left

# columns of the deposits; d is the distance slid since the life began
COUNT, SLOPE, FORCE, SLOPE2, RAMP2, SQUARE = range(6)  # 1, kappa, kappa d, kappa^2, kappa^2 d, (kappa d)^2
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
    the typical force of a pinned contact."""

    deposits: Array
    batches: Array
    replica: float
    replica_square: float
    typical: float

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
        deposits = [1.0, strong, strong * way, strong**2, strong**2 * way, 2 * strong**2 * way * x]
        batches = [force * way, way, way, 1.0, way]

        def power(bounds: list[float], terms: int) -> Array:
            return 2.0 ** np.floor(_BITS - np.log2(terms) - np.log2(bounds))

        work, stretch = typical_lives(c)
        typical = float(np.mean(work) / np.mean(stretch))
        by_column = power(deposits, contacts)
        if not typical * by_column[FORCE] > _LEAST_UNITS:
            raise InputError(
                f"thresholds: the strongest of {contacts} contacts can carry {force / typical:.2g} times the typical "
                "force, too much to add up in 64 bits; take fewer contacts or a narrower law"
            )
        by_column[COUNT] = 1.0
        by_batch = power(batches, contacts)
        by_batch[BREAKS] = 1.0
        most = max(force, drag)
        by_replica = power([most, most**2], replicas)
        return cls(by_column, by_batch, float(by_replica[0]), float(by_replica[1]), typical)


def _before(x: Array) -> Array:
    """Sum of all earlier elements."""
    return np.cumsum(x) - x


def moments(deposits: Array, scales: Scales, run: Run, contacts: int, drag: float) -> tuple[Array, Array, Array]:
    """Mean force, pinned fraction, and variance of the force over contacts, at every grid point."""
    h = run.distance / (run.points - 1)
    total = np.cumsum(deposits, axis=0) / (scales.deposits * contacts)
    force = total[:, FORCE] + h * _before(total[:, SLOPE])
    ramp = total[:, RAMP2] + h * _before(total[:, SLOPE2])
    square = total[:, SQUARE] + _before(2 * h * ramp + h**2 * total[:, SLOPE2])
    detached = 1.0 - total[:, COUNT]
    force += drag * detached
    variance = np.maximum(square + drag**2 * detached - force**2, 0.0)
    return force, total[:, COUNT], variance


# ------------------------------------------------------------------------------------------------------- kernels


@inlined
def fixed(x: float, scale: float) -> int:
    """x in fixed point."""
    return int(np.rint(x * scale))


@inlined
def leave(deposits: Array, j: int, sign: int, stiffness: float, d: float, scales: Array) -> None:
    """Add (sign 1) or take back (sign -1) a life's ramp at a grid point where it has slid d."""
    square = stiffness * stiffness
    deposits[j, COUNT] += sign
    deposits[j, SLOPE] += sign * fixed(stiffness, scales[SLOPE])
    deposits[j, FORCE] += sign * fixed(stiffness * d, scales[FORCE])
    deposits[j, SLOPE2] += sign * fixed(square, scales[SLOPE2])
    deposits[j, RAMP2] += sign * fixed(square * d, scales[RAMP2])
    deposits[j, SQUARE] += sign * fixed(square * d * d, scales[SQUARE])


@inlined
def deposit(deposits: Array, run: Run, stiffness: float, born: float, broke: float, scales: Array) -> None:
    """A life pinned at `born` <= X < `broke`."""
    per_step = (run.points - 1) / run.distance
    step = run.distance / (run.points - 1)
    start = max(0, math.ceil(born * per_step))
    end = math.ceil(min(broke, 2.0 * run.distance) * per_step)
    if start < end:  # otherwise no grid point sees it
        if start < run.points:
            leave(deposits, start, 1, stiffness, start * step - born, scales)
        if end < run.points:
            leave(deposits, end, -1, stiffness, end * step - born, scales)


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
    c: Contacts, key: Key, contact: int, life: int, xi: float, clock: float, born: float,
    run: Run, deposits: Array, batches: Array, batch: int, scales: Array, batch_scales: Array,
) -> float:  # fmt: skip
    """Stretch at breaking of a `langevin` contact, and what it leaves. Where its stiffness follows its threshold, its
    steps end at grid points, and nobody follows it beyond the last one."""
    if c.kappa_slope == 0.0:
        stretch, _ = langevin_life(c, key, contact, life, xi, clock, STEP)
        deposit(deposits, run, 1.0, born, born + stretch, scales)
        return stretch
    step, per_step = run.distance / (run.points - 1), (run.points - 1) / run.distance
    quarters = 0.25 * run.distance
    x, draw, broke, j = 0.0, 0, False, max(0, math.ceil(born * per_step))
    window = max(2, math.floor(born / quarters) + 1)  # the next edge of a window is at window * quarters
    while not broke:
        if j < run.points and j * step - born <= x:
            leave_force(deposits, run, j, kappa(c.kappa_slope, c.kappa_constant, xi) * x, scales)
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
        broke, xi, at, clock, work, draw = walk(c, key, contact, life, draw, xi, x, clock, stop - x, STEP)
        if 2 < window < 5:
            batches[batch, window - 3, AREA] += fixed(work, batch_scales[AREA])
        x = at if broke or at < stop * (1.0 - 1e-15) else stop
    leave_pinned(deposits, run, born, born + x)
    return x


@routine
def found_contact(
    c: Contacts, standing: Standing, key: Key, contact: int, residual: float,
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
            c, key, contact, path, xi, -math.log(v), -age, run, deposits, batches, batch, scales, batch_scales
        )
        if stretch > age:
            return -age, stretch - age, 0.0
        if stretch + c.delay > age:
            rest = residual_delay_draw(c.delay, True, residual) if c.exponential else stretch + c.delay - age
            return -age, min(stretch - age, 0.0), rest
    return 0.0, 0.0, 0.0


@kernel
def simulate(
    c: Contacts,
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
    """Follow contacts first <= i < last over the whole distance, LANES at a time, and add up what they leave."""
    contact, life = np.empty(LANES, np.int64), np.empty(LANES, np.int64)
    position, stiffness, stretch = np.empty(LANES), np.empty(LANES), np.empty(LANES)
    u, v = np.empty(LANES), np.empty(LANES)
    active, upcoming = 0, first
    while True:
        while active < LANES and upcoming < last:  # lanes whose contact has reached the end take the next one
            contact[active], life[active], position[active] = upcoming, 0, 0.0
            if run.stationary:
                life[active] = 1  # what the start finds is life 0
                batch = upcoming % BATCHES
                u_state, u_residual = uniforms(key, upcoming, 0, 0)
                gap = delay_draw(c.delay, c.exponential, uniforms(key, upcoming, 0, 65535)[0])
                if c.aging == LANGEVIN:
                    born, broke, position[active] = found_contact(
                        c, standing, key, upcoming, u_residual, run, deposits, batches, batch, scales, batch_scales
                    )
                    spring = c.kappa_constant
                    if born < 0.0 < broke:
                        position[active] = broke + gap
                elif u_state < standing.pinned:
                    spring, x, ends = standing_contact(c, standing, key, upcoming, u_residual)
                    born, broke = -x, ends - x
                    if c.aging == UNAGED or c.kappa_slope == 0.0:
                        deposit(deposits, run, spring, born, broke, scales)
                    else:
                        flow_force(c, run, deposits, batches, batch, spring, born, ends, scales, batch_scales)
                        spring = 0.0
                    position[active] = broke + gap
                else:
                    spring, born, broke = 0.0, 0.0, 0.0
                    position[active] = residual_delay_draw(c.delay, c.exponential, u_residual)
                record(batches, batch, run, spring, born, broke, position[active], batch_scales)
            upcoming += 1
            active += position[active] <= run.distance
        if active == 0 or status[1] != 0:
            return
        for i in range(active):
            u[i], v[i] = uniforms(key, contact[i], life[i], 0)
        if c.aging != LANGEVIN:
            draw_lives(c, u, v, stiffness, stretch, active)
        status[0] += active
        for i in range(active - 1, -1, -1):
            batch = (contact[i] + life[i] * run.batch_by_life) % BATCHES
            if c.aging == LANGEVIN:
                xi, stiffness[i] = threshold_draw(c.threshold_table, c.steps, u[i]), c.kappa_constant
                stretch[i] = langevin_force(
                    c, key, contact[i], life[i], xi, -math.log(v[i]), position[i],
                    run, deposits, batches, batch, scales, batch_scales,
                )  # fmt: skip
            elif c.aging != UNAGED and c.kappa_slope > 0.0:
                flow_force(
                    c, run, deposits, batches, batch, stiffness[i], position[i], stretch[i], scales, batch_scales
                )
                stiffness[i] = 0.0
            else:
                deposit(deposits, run, stiffness[i], position[i], position[i] + stretch[i], scales)
            broke = position[i] + stretch[i]
            reborn = broke + c.delay
            if c.exponential:
                reborn = broke + delay_draw(c.delay, True, uniforms(key, contact[i], life[i], 1)[0])
            if reborn > 0.5 * run.distance:
                record(batches, batch, run, stiffness[i], position[i], broke, reborn, batch_scales)
            position[i] = reborn
            life[i] += 1
            if reborn > run.distance:
                active -= 1
                contact[i], life[i], position[i] = contact[active], life[active], position[active]
