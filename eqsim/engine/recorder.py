"""What contacts leave on the output grid: exact ramps of force in fixed point.

A life pinned from X0 to X1 adds kappa (X - X0) to the force between them, so it leaves six numbers, which do not depend
on X, at the first grid point j0 >= X0 and takes them back at the first j1 >= X1; cumulative sums over the grid then
give the exact force, its variance over contacts, and the number of pinned contacts at every point. Where the stiffness
follows an aging threshold the force is no ramp, and is left at each point for that point alone. Uniform stiffness makes
several of the numbers equal; if there is no delay either, a life begins where another ends, and what both leave is
added at once. All sums are of 64-bit integers (fixed point, one power of 2 per column, so small that no sum can
overflow): the result cannot depend on order, threads or blocks.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from eqsim.engine import langevin
from eqsim.engine.contacts import Contacts
from eqsim.engine.lanes import LANES, Lives, typical_lives
from eqsim.engine.stationary import extremes
from eqsim.errors import InputError
from eqsim.laws.aging.base import growth
from eqsim.laws.aging.base import work as work_of
from eqsim.laws.newborn import born_stretched
from eqsim.laws.stiffness import kappa
from eqsim.numerics.compiled import add_row, move_rows, routine, take_row
from eqsim.numerics.tables import Array

BATCHES = 64  # independent groups whose scatter is the error of averages over the second half
_LEAST_UNITS = 2.0**10  # the typical force in units of the last bit, far below any statistical error
_LEAST_WORK = 2.0**5  # the mean work of a life in units of its own; laws so broad that it matters scatter far more
_BITS = 62  # of a sum; the sign and one more are left
_UNITS, _SHIFTED = 0x4330000000000000, 0x4338000000000000  # bits of 2^52 and of 1.5 2^52
_NARROW_FROM = 2 ** (_BITS - 51)  # so many contacts leave numbers up to 2^51 each, where sums are up to 2^62

# columns of the deposits; Y = -X0 is where the slider would have been pulled from. What stands in for the others where
# all contacts are equally stiff comes first
COUNT, FORCE, SQUARE, SLOPE, SLOPE2, RAMP2 = range(6)  # 1, kappa Y, (kappa Y)^2, kappa, kappa^2, kappa^2 Y
# columns of the batch sums, for each of the two quarters of the second half
AREA, PINNED, ELAPSED, BREAKS, STRETCH, TRAVEL = range(6)


class Run(NamedTuple):
    """What a kernel needs to know of a run, lengths in units of the threshold law's scale."""

    distance: float
    points: int
    stationary: bool
    batch_by_life: bool  # few contacts: whole lives, not contacts, are the independent samples


class Extent(NamedTuple):
    """How large what contacts leave may be: the largest stiffness over k, stretch and stretch at birth, with a margin,
    the mean |work| over k and travel of typical lives, and whether all are equally stiff."""

    stiffness: float
    stretch: float
    birth: float
    typical_work: float
    typical_stretch: float
    alike: bool

    @property
    def typical_force(self) -> float:
        """Over k."""
        return self.typical_work / self.typical_stretch

    @classmethod
    def of(cls, c: Contacts) -> "Extent":
        xi, x = extremes(c)
        typical, birth = typical_lives(c), c.newborn.reach(xi)
        stiffness, alike = c.springs.constant + c.springs.slope * xi, c.springs.slope == 0.0
        work, travel = float(np.mean(np.abs(typical.work))), float(np.mean(typical.travel))
        return cls(stiffness, max(x, birth), birth, work, travel, alike)


class Scales(NamedTuple):
    """Powers of 2 that turn the deposits (6 columns), batch sums (6 columns) and replicas' forces into integers,
    whether all contacts are equally stiff, and whether they are so many that no deposit of one exceeds 51 bits."""

    deposits: Array
    batches: Array
    replica: float
    replica_square: float
    uniform: bool
    narrow: bool = False

    @classmethod
    def of(cls, c: Contacts, run: Run, contacts: int, replicas: int, drag: float) -> "Scales":
        """`within` the extent of such contacts."""
        return cls.within(Extent.of(c), run, contacts, replicas, drag)

    @classmethod
    def within(
        cls,
        lives: Extent,
        run: Run,
        contacts: int,
        replicas: int,
        drag: float,
        carried: float = 0.0,
        usual: float = 0.0,
    ) -> "Scales":
        """The finest that no sum over all contacts can overflow, from the longest life there can be, or the longest
        stretch that contacts are `carried` to the beginning with; `usual` is a typical force of these.

        Raises InputError if these are too coarse for the typical contact.
        """
        strong, x = lives.stiffness, lives.stretch
        x = max(x if run.stationary else min(x, run.distance + lives.birth), carried)
        reach = run.distance + x + lives.birth
        force = strong * x
        deposits = [1.0, strong * reach, (strong * reach) ** 2, strong, strong**2, strong**2 * reach]
        batches = [force * reach, reach, reach, 1.0, reach, reach]

        def power(bounds: list[float], terms: int) -> Array:
            return 2.0 ** np.floor(_BITS - np.log2(terms) - np.log2(bounds))

        typical = max(lives.typical_force, usual)
        by_column, by_batch = power(deposits, contacts), power(batches, contacts)
        rough = lives.typical_work * by_batch[AREA] <= _LEAST_WORK and usual == 0.0  # no areas along a programme
        if rough or not typical * by_column[FORCE] > _LEAST_UNITS:
            raise InputError(
                f"thresholds: the strongest of {contacts} contacts can carry {force / typical:.2g} times the typical "
                "force, too much to add up in 64 bits; take fewer contacts or a narrower law"
            )
        by_column[COUNT] = 1.0
        by_batch[BREAKS] = 1.0
        most = max(force, drag)
        by_replica = power([most, most**2], replicas)
        narrow = contacts >= _NARROW_FROM
        return cls(by_column, by_batch, float(by_replica[0]), float(by_replica[1]), lives.alike, narrow)


class Recorder(NamedTuple):
    """Where kernels add up what contacts leave: powers of 2 of the columns, sums over the grid (points + 1, 6), whose
    last row takes what is beyond the grid, and over batches and quarters (BATCHES, 2, 6), and `status`: lives so far,
    and anything but 0 stops the kernel. `narrow` as in `Scales`."""

    run: Run
    scales: Array
    batch_scales: Array
    deposits: Array
    batches: Array
    status: Array
    narrow: bool = False


class Moments(NamedTuple):
    """Mean force, pinned fraction, and variance of the force over contacts, at every instant."""

    force: Array
    pinned: Array
    variance: Array


def moments(deposits: Array, scales: Scales, run: Run, contacts: int, drag: float) -> Moments:
    """What deposits say, at every grid point."""
    X = np.linspace(0.0, run.distance, run.points, dtype=np.longdouble)  # squares cancel: 64 bits where there are
    total = np.cumsum(deposits[: run.points], axis=0) / (scales.deposits * contacts).astype(np.longdouble)
    if scales.uniform:  # k_i/k = 1
        total[:, SLOPE] = total[:, SLOPE2] = total[:, COUNT]
        total[:, RAMP2] = total[:, FORCE]
    force = (total[:, SLOPE] * X + total[:, FORCE]).astype(float)
    square = ((total[:, SLOPE2] * X + 2.0 * total[:, RAMP2]) * X + total[:, SQUARE]).astype(float)
    pinned = total[:, COUNT].astype(float)
    detached = 1.0 - pinned
    force += drag * detached
    variance = np.maximum(square + drag**2 * detached - force**2, 0.0)
    # what rounding may hide of it, over distances so long that squares of X drown it
    lost = 4.0 * np.finfo(np.longdouble).eps * total[:, SLOPE2] * X * X + (X > 0) / scales.deposits[SQUARE]
    return Moments(force, pinned, variance + lost.astype(float))


# ------------------------------------------------------------------------------------------------------- kernels


@routine(inline=True)
def fixed(x: float, scale: float) -> int:
    """x in fixed point."""
    return int(np.rint(x * scale))


@routine(inline=True)
def fixed_narrow(x: float, scale: float, narrow: bool) -> Any:
    """`fixed`, of numbers up to 2^51 if they are `narrow`: added to 1.5 2^52, they are the last bits of the sum. Few
    processors convert more than one number at a time."""
    if narrow:
        return np.float64(x * scale + 1.5 * 2.0**52).view(np.int64) - _SHIFTED
    return int(np.rint(x * scale))


@routine(inline=True)
def leave(recorder: Recorder, j: int, sign: int, stiffness: float, born: float) -> None:
    """Add (sign 1) or take back (sign -1) a life's ramp at a grid point."""
    deposits, scales, ramp = recorder.deposits, recorder.scales, stiffness * born
    deposits[j, COUNT] += sign
    deposits[j, SLOPE] += sign * fixed(stiffness, scales[SLOPE])
    deposits[j, FORCE] -= sign * fixed(ramp, scales[FORCE])
    deposits[j, SLOPE2] += sign * fixed(stiffness * stiffness, scales[SLOPE2])
    deposits[j, RAMP2] -= sign * fixed(stiffness * ramp, scales[RAMP2])
    deposits[j, SQUARE] += sign * fixed(ramp * ramp, scales[SQUARE])


@routine(inline=True)
def seen(run: Run, born: float, broke: float) -> tuple[int, int]:
    """The grid points start <= j < end at which `born` <= X < `broke`; beyond the grid if it ends there."""
    per_step = (run.points - 1) / run.distance
    return max(0, math.ceil(born * per_step)), math.ceil(min(broke, 2.0 * run.distance) * per_step)


@routine(inline=True)
def deposit(recorder: Recorder, stiffness: float, origin: float, born: float, broke: float) -> None:
    """A life pinned at `born` <= X < `broke` whose stretch is X - `origin`."""
    start, end = seen(recorder.run, born, broke)
    if start < end:  # otherwise no grid point sees it
        if start < recorder.run.points:
            leave(recorder, start, 1, stiffness, origin)
        if end < recorder.run.points:
            leave(recorder, end, -1, stiffness, origin)


@routine(inline=True)
def record(
    recorder: Recorder, batch: int, stiffness: float, origin: float, born: float, broke: float, reborn: float
) -> None:
    """What a life whose stretch is X - `origin` and the delay after it leave in the two quarters of the second half."""
    run, batches, scales = recorder.run, recorder.batches, recorder.batch_scales
    for quarter in range(2):
        low = run.distance * (0.5 + 0.25 * quarter)
        high = low + 0.25 * run.distance
        start = max(born, low)
        end = min(broke, high)
        if end > start:
            batches[batch, quarter, AREA] += fixed(
                stiffness * (end - start) * (0.5 * (start + end) - origin), scales[AREA]
            )
            batches[batch, quarter, PINNED] += fixed(end - start, scales[PINNED])
        end = min(reborn, high)
        if end > start:
            batches[batch, quarter, ELAPSED] += fixed(end - start, scales[ELAPSED])
        if low < broke <= high:
            batches[batch, quarter, BREAKS] += 1
            batches[batch, quarter, STRETCH] += fixed(broke - origin, scales[STRETCH])
            batches[batch, quarter, TRAVEL] += fixed(broke - born, scales[TRAVEL])


@routine(inline=True)
def leave_force(recorder: Recorder, j: int, force: float) -> None:
    """Add a force at one grid point."""
    deposits, scales = recorder.deposits, recorder.scales
    deposits[j, FORCE] += fixed(force, scales[FORCE])
    deposits[j, SQUARE] += fixed(force * force, scales[SQUARE])
    if j + 1 < recorder.run.points:
        deposits[j + 1, FORCE] -= fixed(force, scales[FORCE])
        deposits[j + 1, SQUARE] -= fixed(force * force, scales[SQUARE])


@routine(inline=True)
def leave_pinned(recorder: Recorder, born: float, broke: float) -> None:
    """Count a life pinned at `born` <= X < `broke`."""
    start, end = seen(recorder.run, born, broke)
    if start < end:
        if start < recorder.run.points:
            recorder.deposits[start, COUNT] += 1
        if end < recorder.run.points:
            recorder.deposits[end, COUNT] -= 1


@routine(inline=True)
def scales_of(recorder: Recorder) -> tuple[float, float, float, float, float, float]:
    """The powers of 2, out of loops: what these write might else be taken for them."""
    scales = recorder.scales
    return scales[COUNT], scales[FORCE], scales[SQUARE], scales[SLOPE], scales[SLOPE2], scales[RAMP2]


@routine(inline=True)
def point_after(x: float, run: Run, per_step: float) -> Any:
    """The first grid point at or after x >= 0; `run.points` beyond the last one."""
    at = np.ceil(min(x * per_step, float(run.points))) + 2.0**52
    return np.float64(at).view(np.int64) - _UNITS


class Columns(NamedTuple):
    """Scratch for what many contacts leave: first and last grid point (LANES,), numbers in fixed point (5, LANES)."""

    start: Array
    end: Array
    number: Array


@routine
def empty_columns() -> Columns:
    """Scratch for LANES contacts."""
    start, end = np.empty(LANES, np.int64), np.empty(LANES, np.int64)
    return Columns(start, end, np.empty((5, LANES), np.int64))


@routine(inline=True)
def joined(c: Contacts, recorder: Recorder) -> bool:
    """Whether a life begins where another ends and nothing changes there but the place of birth."""
    alone = recorder.run.batch_by_life or born_stretched(c.newborn)
    return c.springs.slope == 0.0 and c.delay.mean == 0.0 and not alone


@routine
def leave_ramps(
    recorder: Recorder, born: Array, broke: Array, lives: Lives, r: int, columns: Columns, count: int
) -> None:
    """`deposit` for `count` contacts, a multiple of four, born >= 0."""
    run, deposits, narrow, stiffness = recorder.run, recorder.deposits, recorder.narrow, lives.stiffness
    _, to_force, to_square, to_slope, to_slope2, to_ramp2 = scales_of(recorder)
    start, end, column = columns
    per_step = (run.points - 1) / run.distance
    for i in range(count):
        start[i], end[i] = point_after(born[i], run, per_step), point_after(broke[i], run, per_step)
    for i in range(count):
        kappa = stiffness[r, i]
        ramp = kappa * born[i]
        column[0, i] = fixed_narrow(ramp, -to_force, narrow)
        column[1, i] = fixed_narrow(ramp * ramp, to_square, narrow)
        column[2, i] = fixed_narrow(kappa, to_slope, narrow)
        column[3, i] = fixed_narrow(kappa * kappa, to_slope2, narrow)
        column[4, i] = fixed_narrow(kappa * ramp, -to_ramp2, narrow)
    for i in range(0, count, 4):
        move_rows(deposits, start, end, column, i)


@routine
def leave_uniform_ramps(recorder: Recorder, born: Array, broke: Array, columns: Columns, count: int) -> None:
    """`leave_ramps` of uniform stiffness, where COUNT and FORCE stand for the other columns."""
    run, deposits, narrow = recorder.run, recorder.deposits, recorder.narrow
    _, to_force, to_square, _, _, _ = scales_of(recorder)
    start, end, column = columns
    per_step = (run.points - 1) / run.distance
    for i in range(count):
        start[i], end[i] = point_after(born[i], run, per_step), point_after(broke[i], run, per_step)
    for i in range(count):
        column[0, i] = fixed_narrow(born[i], -to_force, narrow)
        column[1, i] = fixed_narrow(born[i] * born[i], to_square, narrow)
    for i in range(count):
        row = (1, column[0, i], column[1, i], 0)  # four numbers at a time are moved at once
        add_row(deposits, start[i], COUNT, row)
        take_row(deposits, end[i], COUNT, row)


@routine
def join_uniform_ramps(recorder: Recorder, born: Array, broke: Array, columns: Columns, count: int) -> None:
    """Without delay a life begins where another, from `born` to `broke`, ends: with uniform stiffness nothing changes
    there but the square and the place of birth."""
    run, deposits, narrow = recorder.run, recorder.deposits, recorder.narrow
    _, to_force, to_square, _, _, _ = scales_of(recorder)
    _, end, column = columns
    per_step = (run.points - 1) / run.distance
    for i in range(count):
        distance = broke[i] - born[i]
        end[i] = point_after(broke[i], run, per_step)
        column[0, i] = fixed_narrow(distance, -to_force, narrow)
        column[1, i] = fixed_narrow(distance * (born[i] + broke[i]), to_square, narrow)
    for i in range(count):
        add_row(deposits, end[i], FORCE, (column[0, i], column[1, i]))


@routine
def follow_growth(c: Contacts, recorder: Recorder, batch: int, stiffness: float, born: float, stretch: float) -> None:
    """What a contact leaves whose stiffness, `stiffness` at birth, follows its threshold along `flow`."""
    run = recorder.run
    step, per_step = run.distance / (run.points - 1), (run.points - 1) / run.distance
    broke = min(born + stretch, 2.0 * run.distance)
    for j in range(max(0, math.ceil(born * per_step)), min(run.points, math.ceil(broke * per_step))):
        x = max(j * step - born, 0.0)
        leave_force(recorder, j, stiffness * growth(c.aging, x) * x)
    leave_pinned(recorder, born, born + stretch)
    for quarter in range(2):
        low = max(run.distance * (0.5 + 0.25 * quarter) - born, 0.0)
        high = min(run.distance * (0.75 + 0.25 * quarter) - born, stretch)
        if high > low:
            until = work_of(c.aging, c.aging_table, c.springs, stiffness, high)
            before = work_of(c.aging, c.aging_table, c.springs, stiffness, low)
            recorder.batches[batch, quarter, AREA] += fixed(until - before, recorder.batch_scales[AREA])


@routine
def follow_path(
    c: langevin.Pinned, recorder: Recorder, batch: int, path: langevin.Path, begin: float
) -> tuple[float, langevin.Path]:
    """Travel of a contact whose threshold fluctuates from `begin`, where its path is `path`, to breaking, and what it
    leaves there. Where its stiffness follows its threshold, its steps end at grid points, and it is not followed beyond
    the last one, where its path is returned; it may be on its way, stretched at the beginning."""
    run = recorder.run
    if c.springs.slope == 0.0:
        stretch, _ = langevin.life(c, path, langevin.STEP)
        deposit(recorder, 1.0, begin, begin, begin + stretch)
        return stretch, path
    step, per_step = run.distance / (run.points - 1), (run.points - 1) / run.distance
    quarters, y = 0.25 * run.distance, path.x
    s, broke, j = 0.0, False, max(0, math.ceil(begin * per_step))  # travel so far, which the stretch may not resolve
    window = max(2, math.floor(begin / quarters) + 1)  # the next edge of a window is at window * quarters
    while not broke:
        if j < run.points and j * step - begin <= s:
            leave_force(recorder, j, kappa(c.springs, path.xi) * path.x)
            j += 1
            continue
        if window * quarters - begin <= s:
            window += 1
            continue
        if window > 4 and j >= run.points:
            s = 2.0 * run.distance - begin
            break
        stop = window * quarters - begin
        if j < run.points:
            stop = min(stop, j * step - begin)
        broke, path, h, work = langevin.stride(c, path, stop - s, langevin.STEP)
        if 2 < window < 5:
            recorder.batches[batch, window - 3, AREA] += fixed(work, recorder.batch_scales[AREA])
        reached = not broke and s + h >= stop * (1.0 - 1e-15)
        s = stop if reached else s + h
        path = langevin.moved(path, path.draw, path.xi, y + s if reached else path.x, path.left)
    leave_pinned(recorder, begin, begin + s)
    return s, path


@routine(inline=True)
def edge_after(run: Run, x: float) -> float:
    """The end of the half or quarter that x lies in; infinite beyond the last."""
    if x <= 0.5 * run.distance:
        return 0.5 * run.distance
    if x <= 0.75 * run.distance:
        return 0.75 * run.distance
    return run.distance if x <= run.distance else math.inf
