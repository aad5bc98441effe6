"""Record the forces of contacts on the output grid, as exact ramps in fixed point.

A life pinned from X0 to X1 adds kappa (X - X0) to the force between them, so six
numbers, which do not depend on X, are added at the first grid point j0 >= X0 and
subtracted at the first j1 >= X1; cumulative sums over the grid then give the exact
force, its variance over contacts, and the number of pinned contacts at every point.
Where the stiffness follows an aging threshold the force is no ramp, and is recorded at
each point separately. Uniform stiffness makes several of the numbers equal; if there is
no delay either, a life begins where another ends, and both are recorded at once. All
sums are of 64-bit integers (fixed point, one power of 2 per column, so small that no
sum can overflow): the result cannot depend on order, threads or blocks.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from eqsim.engine.contacts import Contacts
from eqsim.engine.lanes import LANES
from eqsim.engine.sample import typical_lives
from eqsim.engine.stationary import extremes
from eqsim.errors import InputError
from eqsim.laws.newborn import Stretched
from eqsim.numerics.compiled import routine
from eqsim.numerics.tables import Array, search

BATCHES = 64  # independent groups of contacts, whose scatter tells errors of averages
# Least typical force, in units of its last bit: rounding is far below noise.
_LEAST_FORCE = 2.0**10
# Least mean work, likewise. Broader laws scatter far more than they are rounded.
_LEAST_WORK = 2.0**5
_SUM_BITS = 62  # of a sum; the sign and one more are left
_BITS_OF_2_52 = 0x4330000000000000  # bits of 2^52
# Lives that are joined leave their rounding behind in the sums of squares: in units of
# the square, distance^2 lives^(1/2) 2^-63 or so, below 1e-6 up to 1e10 lives.
_LONGEST_JOINED = 1e4


class Deposit(NamedTuple):
    """Six numbers that a life adds at a grid point, or arrays of them. Y = -X0, with X0
    the displacement at which its spring would be slack."""

    count: Any  # 1
    force: Any  # kappa Y
    square: Any  # (kappa Y)^2
    slope: Any  # kappa
    slope2: Any  # kappa^2
    ramp2: Any  # kappa^2 Y


class Window(NamedTuple):
    """Sums over lives in a quarter of the second half, or arrays of them."""

    area: Any  # int F dX
    pinned: Any  # displacement while pinned
    elapsed: Any  # displacement
    breaks: Any
    stretch: Any  # sum over breaks
    travel: Any  # sum over breaks


DEPOSIT = np.dtype([(name, np.int64) for name in Deposit._fields])
WINDOW = np.dtype([(name, np.int64) for name in Window._fields])


class Run(NamedTuple):
    """Segment at constant velocity; a constant drive is a single one."""

    # Displacement of the slider, or time in a hold at the pace of another segment; in
    # units of the threshold law's scale.
    length: float
    points: int  # instants at which contacts are recorded, from the beginning on
    stationary: bool = False  # contacts are found in a steady state at the beginning
    averages: bool = True  # over the second half; lives are then followed to their ends
    batch_by_life: bool = False  # few contacts: whole lives are the independent samples
    moves: int = 1  # 0 in a hold
    sign: float = 1.0  # direction of motion, in which stretches are positive
    ratio: float = 1.0  # pace over that of the segment before
    goes_on: bool = False  # moves on at the velocity of its stationary start
    last: bool = True  # no segment follows
    instants: Array = np.empty(0)  # of a hold, (points,), from its beginning on

    @property
    def distance(self) -> float:
        """Displacement of the slider."""
        return self.length * self.moves


class Extent(NamedTuple):
    """Largest and typical values that contacts add to the sums."""

    stiffness: float  # the largest, over k, with a margin
    stretch: float  # the largest, with a margin
    birth: float  # the largest stretch at birth
    typical_work: float  # mean |work| of a life, over k
    typical_stretch: float  # mean travel of a life
    alike: bool  # all contacts are equally stiff

    @property
    def typical_force(self) -> float:
        """Mean |work| over mean travel, over k."""
        return self.typical_work / self.typical_stretch

    @classmethod
    def of(cls, c: Contacts) -> "Extent":
        xi, x = extremes(c)
        typical, birth, springs = typical_lives(c), c.newborn.reach(xi), c.springs
        work = float(np.mean(np.abs(typical.work)))
        travel = float(np.mean(typical.travel))
        stiffness = springs.constant + springs.slope * xi
        alike = springs.slope == 0.0
        return cls(stiffness, max(x, birth), birth, work, travel, alike)


class Scales(NamedTuple):
    """Powers of 2 that turn recorded numbers into integers."""

    deposits: Deposit
    windows: Window
    replica: float  # of the force of a replica
    replica_square: float  # of its square
    uniform: bool  # all contacts are equally stiff

    @classmethod
    def of(
        cls, c: Contacts, run: Run, contacts: int, replicas: int, drag: float
    ) -> "Scales":
        """Scales for contacts that a segment finds or begins with."""
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
        """Find the finest scales with which no sum over all contacts can overflow.
        Bounds are set by the longest life, or by the largest stretch `carried` over
        from an earlier segment; `usual` is the typical force of such contacts. Raises
        InputError if these scales are too coarse for the typical contact."""
        strong, x, distance = lives.stiffness, lives.stretch, run.distance
        x = max(x if run.stationary else min(x, distance + lives.birth), carried)
        reach = distance + x + lives.birth
        force = strong * x

        def power(bounds: list[float], terms: int) -> list[float]:
            powers = np.floor(_SUM_BITS - np.log2(terms) - np.log2(bounds))
            return (2.0**powers).tolist()

        ramp, square = strong * reach, (strong * reach) ** 2
        bounds = [1.0, ramp, square, strong, strong**2, strong**2 * reach]
        deposits = Deposit(*power(bounds, contacts))
        # Stretches at breaking are travels and those at birth, one for each life.
        stretched = reach * (1.0 + lives.birth / lives.typical_stretch)
        bounds = [force * reach, reach, reach, 1.0, stretched, reach]
        windows = Window(*power(bounds, contacts))
        typical = max(lives.typical_force, usual)
        # No areas are added up along a programme.
        rough = lives.typical_work * windows.area <= _LEAST_WORK and usual == 0.0
        if rough or not typical * deposits.force > _LEAST_FORCE:
            raise InputError(
                f"thresholds: the strongest of {contacts} contacts can carry "
                f"{force / typical:.2g} times the typical force, too much to add up in "
                "64 bits; take fewer contacts or a narrower law"
            )
        most = max(force, drag)
        replica, square = power([most, most**2], replicas)
        counted = deposits._replace(count=1.0), windows._replace(breaks=1.0)
        return cls(*counted, replica, square, lives.alike)


class Averaging(NamedTuple):
    """Sums over the lives of each lane since its contact crossed the last edge of a
    window, arrays (LANES,)."""

    edge: Array  # position of the next edge
    since: Array  # position of the first birth after the last edge
    lives: Array  # number of the life that began there
    work: Array  # over k, since then
    pinned: Array  # displacement while pinned, since then
    broke: Array  # where the current life ends
    reborn: Array  # where the delay after it ends

    @classmethod
    def empty(cls) -> "Averaging":
        """Averages of idle lanes."""
        real = np.zeros((6, LANES))
        return cls._make((*real[:2], np.zeros(LANES, np.int64), *real[2:]))


class Snapshot(NamedTuple):
    """Contacts between two segments, arrays (contacts,). Times are displacements at the
    pace of the segment before. All but `wait` and `lives` is of pinned contacts; where
    thresholds fluctuate, `threshold` is the current one."""

    pinned: Array
    wait: Array  # time until a detached contact is pinned
    threshold: Array  # at birth
    stretch: Array  # in the direction X
    clock: Array  # rest of the exponential clock
    age: Array  # time since birth
    still: Array  # travel left until a contact of a stationary start breaks
    delay: Array  # between its break and its next birth
    lives: Array  # number of lives drawn, a multiple of ROUNDS
    life: Array  # number of the life, of a fluctuating threshold
    draw: Array  # number of its next random draw
    first: int  # number of the first contact

    @classmethod
    def fresh(cls, first: int, contacts: int) -> "Snapshot":
        """All contacts about to be pinned for the first time."""
        real, whole = np.zeros((7, contacts)), np.zeros((3, contacts), np.int64)
        return cls._make((np.zeros(contacts, np.bool_), *real, *whole, first))


class Recorder(NamedTuple):
    """Recorder of `engine.lanes` that adds up forces and averages along a segment."""

    laws: Contacts
    run: Run
    start: Any  # `Fresh`, `Stationary` or `Snapshot`: how contacts come in
    scales: Deposit  # powers of 2 that turn deposits into integers
    window_scales: Window  # the same of averages
    deposits: Array  # `DEPOSIT`, (points + 1,); the last row takes what is beyond
    windows: Array  # `WINDOW`, (BATCHES, 2), sums over quarters of the second half
    lives: Array  # (1,), so far
    stop: Array  # (1,), anything but 0 ends the kernel
    # A life begins where another ends, and is as stiff; both are recorded at once.
    joined: bool
    averaging: Averaging
    points: Array  # scratch: of births and breaks side by side, (2, LANES)

    @staticmethod
    def of(
        c: Contacts, run: Run, scales: Scales, start: Any, total: Any, row: int = 0
    ) -> "Recorder":
        """Record contacts that come in from `start` in the sums of a `blocks.Totals`.
        Deposits are those from `row` on."""
        return Recorder(
            c,
            run,
            start,
            scales.deposits,
            scales.windows,
            total.scratch[row : row + run.points + 1],
            total.windows,
            total.lives,
            total.stop,
            joined=c.springs.slope == 0.0
            and c.delay.mean == 0.0
            and run.distance <= _LONGEST_JOINED,
            averaging=Averaging.empty(),
            points=np.zeros((2, LANES), np.int64),
        )


def recorded_alone(c: Contacts, run: Run) -> bool:
    """True if lives along a segment are recorded one by one, not side by side: of few
    contacts, of contacts born stretched or whose stiffness varies, in a hold, and where
    a path is recorded step by step or ends with the segment."""
    few = run.batch_by_life or run.moves == 0
    varies = c.aging.stiffens and c.springs.slope > 0.0
    on_the_way = c.aging.fluctuates and not run.last
    return few or varies or on_the_way or isinstance(c.newborn, Stretched)


class Moments(NamedTuple):
    """Averages over contacts at every instant."""

    force: Array
    pinned: Array
    variance: Array  # of the force
    lost: Array  # error of the variance by rounding


def moments(
    deposits: Array, scales: Scales, run: Run, contacts: int, drag: float
) -> Moments:
    """Add up deposits to averages at every grid point."""
    square, ramp2, slope2, count = (
        _added_up(deposits, scales, run, contacts, name)
        for name in ("square", "ramp2", "slope2", "count")
    )
    X, pinned = _grid(run), count.astype(float)
    force = mean_force(deposits, scales, run, contacts, drag)
    square = ((slope2 * X + 2.0 * ramp2) * X + square).astype(float)
    variance = np.maximum(square + drag**2 * (1.0 - pinned) - force**2, 0.0)
    # Over long distances large squares of X cancel.
    rounding = 4.0 * np.finfo(np.longdouble).eps * slope2 * X * X
    lost = rounding + (X > 0) / scales.deposits.square
    return Moments(force, pinned, variance, lost.astype(float))


def mean_force(
    deposits: Array, scales: Scales, run: Run, contacts: int, drag: float
) -> Array:
    """Add up deposits to the mean force at every grid point."""
    slope, force = (
        _added_up(deposits, scales, run, contacts, name) for name in ("slope", "force")
    )
    mean = (slope * _grid(run) + force).astype(float)
    if drag:
        pinned = _added_up(deposits, scales, run, contacts, "count").astype(float)
        mean += drag * (1.0 - pinned)
    return mean


def _grid(run: Run) -> Array:
    """Grid points, of 64 bits where the platform has them: squares cancel."""
    return np.linspace(0.0, run.distance, run.points, dtype=np.longdouble)


def _added_up(
    deposits: Array, scales: Scales, run: Run, contacts: int, name: str
) -> Array:
    """Mean of a field of `Deposit` at every grid point."""
    if scales.uniform:  # k_i/k = 1: some fields stand for others
        alike = {"slope": "count", "slope2": "count", "ramp2": "force"}
        name = alike.get(name, name)
    unit = np.longdouble(getattr(scales.deposits, name)) * contacts
    return np.cumsum(deposits[name][: run.points]) / unit


# ---- kernels ----


class Ramp(NamedTuple):
    """A life with the force stiffness (X - origin) at born <= X < broke. In a hold the
    force is -stiffness origin from one instant to another."""

    stiffness: float
    origin: float
    born: float
    broke: float


@routine(inline=True)
def fixed(x: float, scale: float) -> int:
    """x in fixed point."""
    return int(np.rint(x * scale))


@routine(inline=True)
def point_at(run: Run, x: float) -> int:
    """Find the first instant of a segment at or after `x`; `points` beyond the last."""
    if run.moves == 0:
        return search(run.instants, x, False)
    per_step = (run.points - 1) / run.length
    return max(0, math.ceil(min(x * per_step, float(run.points))))


@routine(inline=True)
def instant(run: Run, j: int) -> float:
    """Time of instant j of a hold, or displacement at it of another segment."""
    return j * (run.length / (run.points - 1)) if run.moves != 0 else run.instants[j]


@routine(inline=True)
def leave(recorder: Recorder, j: int, sign: int, stiffness: float, born: float) -> None:
    """Add (sign 1) or subtract (sign -1) a life's ramp at a grid point."""
    scales, ramp, here = recorder.scales, stiffness * born, recorder.deposits[j]
    here.count += sign
    here.slope += sign * fixed(stiffness, scales.slope)
    here.force -= sign * fixed(ramp, scales.force)
    here.slope2 += sign * fixed(stiffness * stiffness, scales.slope2)
    here.ramp2 -= sign * fixed(stiffness * ramp, scales.ramp2)
    here.square += sign * fixed(ramp * ramp, scales.square)


@routine
def leave_ramp(recorder: Recorder, ramp: Ramp) -> None:
    """Record the force of a life."""
    start, end = point_at(recorder.run, ramp.born), point_at(recorder.run, ramp.broke)
    if start < end:  # otherwise no grid point sees it
        leave(recorder, start, 1, ramp.stiffness, ramp.origin)
        leave(recorder, end, -1, ramp.stiffness, ramp.origin)


@routine(inline=True)
def leave_force(recorder: Recorder, j: int, force: float) -> None:
    """Record a force at one grid point."""
    here, after = recorder.deposits[j], recorder.deposits[j + 1]
    scales = recorder.scales
    here.force += fixed(force, scales.force)
    here.square += fixed(force * force, scales.square)
    after.force -= fixed(force, scales.force)
    after.square -= fixed(force * force, scales.square)


@routine(inline=True)
def leave_pinned(recorder: Recorder, born: float, broke: float) -> None:
    """Count a life pinned at `born` <= X < `broke`."""
    start, end = point_at(recorder.run, born), point_at(recorder.run, broke)
    if start < end:
        recorder.deposits[start].count += 1
        recorder.deposits[end].count -= 1


@routine(inline=True)
def edge_after(run: Run, x: float) -> float:
    """End of the half or quarter that x lies in; infinite beyond the segment. Without
    averages the segment has one part."""
    if run.averages and x <= 0.75 * run.length:
        return (0.5 if x <= 0.5 * run.length else 0.75) * run.length
    return run.length if x <= run.length else math.inf


@routine(inline=True)
def average(recorder: Recorder, batch: int, life: Ramp, reborn: float) -> None:
    """Record a life and the delay after it in both quarters of the second half."""
    length, scales = recorder.run.length, recorder.window_scales
    for quarter in range(2):
        low = length * (0.5 + 0.25 * quarter)
        high = low + 0.25 * length
        window = recorder.windows[batch, quarter]
        start = max(life.born, low)
        end = min(life.broke, high)
        if end > start:
            area = life.stiffness * (end - start) * (0.5 * (start + end) - life.origin)
            window.area += fixed(area, scales.area)
            window.pinned += fixed(end - start, scales.pinned)
        end = min(reborn, high)
        if end > start:
            window.elapsed += fixed(end - start, scales.elapsed)
        if low < life.broke <= high:
            window.breaks += 1
            window.stretch += fixed(life.broke - life.origin, scales.stretch)
            window.travel += fixed(life.broke - life.born, scales.travel)


# ---- ramps of all lanes together ----


@routine(inline=True)
def find_points(run: Run, x: Array, points: Array) -> None:
    """Find the grid points at or after each x >= 0; `run.points` beyond the last. A loop
    that fills a single array vectorises."""
    per_step = (run.points - 1) / run.length
    for i in range(x.size):
        at = np.ceil(min(x[i] * per_step, float(run.points))) + 2.0**52
        points[i] = np.float64(at).view(np.int64) - _BITS_OF_2_52


@routine(inline=True)
def leave_ramps(
    recorder: Recorder, born: Array, broke: Array, stiffness: Array, uniform: bool
) -> None:
    """Record lives side by side, pinned at 0 <= `born` <= X < `broke`. Of equally stiff
    contacts (`uniform`) count and force stand for other fields."""
    scales, points = recorder.scales, recorder.points
    find_points(recorder.run, born, points[0])
    find_points(recorder.run, broke, points[1])
    for i in range(born.size):
        begin = recorder.deposits[np.uint64(points[0, i])]
        end = recorder.deposits[np.uint64(points[1, i])]
        kappa = stiffness[i]
        ramp = kappa * born[i]
        force = fixed(ramp, -scales.force)
        square = fixed(ramp * ramp, scales.square)
        if not uniform:
            slope = fixed(kappa, scales.slope)
            slope2 = fixed(kappa * kappa, scales.slope2)
            ramp2 = fixed(kappa * ramp, -scales.ramp2)
            begin.slope += slope
            begin.slope2 += slope2
            begin.ramp2 += ramp2
            end.slope -= slope
            end.slope2 -= slope2
            end.ramp2 -= ramp2
        begin.count += 1
        begin.force += force
        begin.square += square
        end.count -= 1
        end.force -= force
        end.square -= square


@routine(inline=True)
def join_ramps(recorder: Recorder, born: Array, broke: Array) -> None:
    """Record lives of equally stiff contacts as `leave_ramps` does, where a life begins
    as another ends: only the square and the place of birth change there."""
    scales, points = recorder.scales, recorder.points
    find_points(recorder.run, broke, points[1])
    for i in range(born.size):
        end = recorder.deposits[np.uint64(points[1, i])]
        travel = broke[i] - born[i]
        square = travel * (born[i] + broke[i])
        end.force += fixed(travel, -scales.force)
        end.square += fixed(square, scales.square)
