"""What contacts leave on the output grid: exact ramps of force in fixed point.

A life pinned from X0 to X1 adds kappa (X - X0) to the force between them, so it leaves
six numbers, which do not depend on X, at the first grid point j0 >= X0 and takes them
back at the first j1 >= X1; cumulative sums over the grid then give the exact force, its
variance over contacts, and the number of pinned contacts at every point. Where the
stiffness follows an aging threshold the force is no ramp, and is left at each point for
that point alone. Uniform stiffness makes several of the numbers equal; if there is no
delay either, a life begins where another ends, and what both leave is added at once.
All sums are of 64-bit integers (fixed point, one power of 2 per column, so small that
no sum can overflow): the result cannot depend on order, threads or blocks.
"""

import math
from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np

from eqsim.engine.contacts import Contacts
from eqsim.engine.lanes import LANES, Lives
from eqsim.engine.sample import typical_lives
from eqsim.engine.stationary import extremes
from eqsim.errors import InputError
from eqsim.laws.newborn import Stretched
from eqsim.numerics.compiled import routine
from eqsim.numerics.rows import add_rows, take_rows
from eqsim.numerics.tables import Array, search

# independent groups whose scatter is the error of averages over the second half
BATCHES = 64
_LEAST_UNITS = (
    2.0**10
)  # the typical force in units of the last bit, far below any statistical error
_LEAST_WORK = (
    2.0**5
)  # the mean work of a life in units of its own; laws so broad that it matters scatter far more
_BITS = 62  # of a sum; the sign and one more are left
_UNITS = 0x4330000000000000  # bits of 2^52
_SHIFTED = 0x4338000000000000  # bits of 1.5 2^52
_NARROW_FROM = 2 ** (
    _BITS - 51
)  # so many contacts leave numbers up to 2^51 each, where sums are up to 2^62

# What a contact leaves at a point of the grid, with Y = -X0 where the slider would have
# been pulled from: 1, kappa Y, (kappa Y)^2, kappa, kappa^2 and kappa^2 Y.
DEPOSIT = np.dtype(
    [
        (name, np.int64)
        for name in ("count", "force", "square", "slope", "slope2", "ramp2")
    ]
)
# What it leaves in a quarter of the second half: int F dX, displacement while pinned
# and in all, breaks, and stretch and travel at these.
WINDOW = np.dtype(
    [
        (name, np.int64)
        for name in ("area", "pinned", "elapsed", "breaks", "stretch", "travel")
    ]
)


class Deposit(NamedTuple):
    """A number for each field of `DEPOSIT`, or an array of them."""

    count: Any
    force: Any
    square: Any
    slope: Any
    slope2: Any
    ramp2: Any


class Window(NamedTuple):
    """A number for each field of `WINDOW`, or an array of them."""

    area: Any
    pinned: Any
    elapsed: Any
    breaks: Any
    stretch: Any
    travel: Any


class Run(NamedTuple):
    """A segment at constant velocity, of which a drive at constant velocity is one.

    Attributes
    ----------
    length : float
        Displacement of the slider, or in a hold time at the pace of another segment; in
        units of the threshold law's scale.
    points : int
        Instants at which contacts are recorded, from the beginning on.
    stationary : bool
        Whether contacts are found in a steady state at the beginning.
    averages : bool
        Whether averages over the second half are taken; then lives are followed to
        their ends.
    batch_by_life : bool
        Few contacts: whole lives, not contacts, are the independent samples of
        averages.
    moves : int
        1 if the slider moves, 0 in a hold.
    sign : float
        Direction of X in which the slider moves; stretches are positive in it.
    ratio : float
        Pace over that of the segment before.
    goes_on : bool
        Whether a stationary start goes on at its own velocity.
    last : bool
        Whether no segment follows.
    instants : ndarray, shape (points,)
        Of a hold, from its beginning on.
    """

    length: float
    points: int
    stationary: bool = False
    averages: bool = True
    batch_by_life: bool = False
    moves: int = 1
    sign: float = 1.0
    ratio: float = 1.0
    goes_on: bool = False
    last: bool = True
    instants: Array = np.empty(0)

    @property
    def distance(self) -> float:
        """Displacement of the slider."""
        return self.length * self.moves


class Extent(NamedTuple):
    """How large what contacts leave may be: the largest stiffness over k, stretch and
    stretch at birth, with a margin, the mean |work| over k and travel of typical lives,
    and whether all are equally stiff."""

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
        stiffness, alike = (
            c.springs.constant + c.springs.slope * xi,
            c.springs.slope == 0.0,
        )
        work, travel = (
            float(np.mean(np.abs(typical.work))),
            float(np.mean(typical.travel)),
        )
        return cls(stiffness, max(x, birth), birth, work, travel, alike)


class Scales(NamedTuple):
    """Powers of 2 that turn what contacts leave, and replicas' forces, into integers;
    whether all contacts are equally stiff, and whether they are so many that no deposit
    of one exceeds 51 bits."""

    deposits: Deposit
    windows: Window
    replica: float
    replica_square: float
    uniform: bool
    narrow: bool

    @classmethod
    def of(
        cls, c: Contacts, run: Run, contacts: int, replicas: int, drag: float
    ) -> "Scales":
        """Scales `within` the extent of such contacts."""
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
        """The finest that no sum over all contacts can overflow, from the longest life
        there can be, or the longest stretch that contacts are `carried` to the
        beginning with; `usual` is a typical force of these.

        Raises InputError if these are too coarse for the typical contact.
        """
        strong, x, distance = lives.stiffness, lives.stretch, run.distance
        x = max(x if run.stationary else min(x, distance + lives.birth), carried)
        reach = distance + x + lives.birth
        force = strong * x

        def power(bounds: list[float], terms: int) -> list[float]:
            return (2.0 ** np.floor(_BITS - np.log2(terms) - np.log2(bounds))).tolist()

        square = (strong * reach) ** 2
        deposits = Deposit(
            *power(
                [1.0, strong * reach, square, strong, strong**2, strong**2 * reach],
                contacts,
            )
        )
        windows = Window(
            *power([force * reach, reach, reach, 1.0, reach, reach], contacts)
        )
        typical = max(lives.typical_force, usual)
        rough = (
            lives.typical_work * windows.area <= _LEAST_WORK and usual == 0.0
        )  # no areas along a programme
        if rough or not typical * deposits.force > _LEAST_UNITS:
            raise InputError(
                f"thresholds: the strongest of {contacts} contacts can carry {force / typical:.2g} times the typical "
                "force, too much to add up in 64 bits; take fewer contacts or a narrower law"
            )
        most = max(force, drag)
        replica, replica_square = power([most, most**2], replicas)
        counted = deposits._replace(count=1.0), windows._replace(breaks=1.0)
        return cls(
            *counted, replica, replica_square, lives.alike, contacts >= _NARROW_FROM
        )


class Averaging(NamedTuple):
    """What contacts have left since the last edge of a window of averages, arrays
    (LANES,): the next `edge`; where they were pinned at the last one, `since`, and how
    many lives old they were, `lives`; their work over k and displacement while pinned
    since. `broke` and `reborn` are where the life at hand and the delay after it end.
    """

    edge: Array
    since: Array
    lives: Array
    work: Array
    pinned: Array
    broke: Array
    reborn: Array

    @classmethod
    def empty(cls) -> "Averaging":
        """Averages of idle lanes."""
        edge, since, work, pinned, broke, reborn = np.zeros((6, LANES))
        return cls(edge, since, np.zeros(LANES, np.int64), work, pinned, broke, reborn)


class Columns(NamedTuple):
    """Scratch for what the contacts in the lanes leave, arrays (LANES,) of integers:
    what `Deposit` says at the point `begins`, and back again at `ends`. `once` is 1 and
    `never` 0 for all."""

    begins: Array
    ends: Array
    force: Array
    square: Array
    slope: Array
    slope2: Array
    ramp2: Array
    once: Array
    never: Array

    @classmethod
    def empty(cls) -> "Columns":
        """Scratch for LANES contacts."""
        begins, ends, force, square, slope, slope2, ramp2 = np.zeros(
            (7, LANES), np.int64
        )
        once, never = np.ones(LANES, np.int64), np.zeros(LANES, np.int64)
        return cls(begins, ends, force, square, slope, slope2, ramp2, once, never)


class Recorder(NamedTuple):
    """Where kernels add up what contacts leave along a segment, some lives together,
    others one by one.

    Attributes
    ----------
    run : Run
    start : Fresh, Stationary or Population
        How contacts come into it.
    scales : Deposit
        Powers of 2 that turn deposits into integers.
    window_scales : Window
        Likewise of averages.
    deposits : ndarray of DEPOSIT, shape (points + 1,)
        Sums over contacts; the last row takes what is beyond the grid.
    windows : ndarray of WINDOW, shape (BATCHES, 2)
        Sums over batches and quarters of the second half.
    lives, stop : ndarray of int, shape (1,)
        Lives so far; anything but 0 in `stop` ends the kernel.
    joined : bool
        Whether a life begins where another ends, and nothing changes there but the
        place of birth.
    alone : bool
        Whether lives are recorded one by one.
    carries : bool
        Whether where lives break is found for all lanes together, before they are
        recorded.
    averaging : Averaging
    columns : Columns
    narrow : bool
        As in `Scales`.
    """

    run: Run
    start: Any
    scales: Deposit
    window_scales: Window
    deposits: Array
    windows: Array
    lives: Array
    stop: Array
    joined: bool
    alone: bool
    carries: bool
    averaging: Averaging
    columns: Columns
    narrow: bool

    @classmethod
    def of(
        cls, c: Contacts, run: Run, scales: Scales, start: Any, total: Any, row: int = 0
    ) -> "Recorder":
        """A recorder of contacts that come in from `start`, into the sums of a
        `blocks.Totals`, from a row of its deposits on."""
        alone = recorded_alone(c, run)
        joined = not alone and c.springs.slope == 0.0 and c.delay.mean == 0.0
        here = (
            total.scratch[row : row + run.points + 1],
            total.windows,
            total.lives,
            total.stop,
        )
        carries, scratch = (
            run.moves != 0 and not (alone and _follows_paths(c, run)),
            Columns.empty(),
        )
        return cls(
            run,
            start,
            scales.deposits,
            scales.windows,
            *here,
            joined,
            alone,
            carries,
            Averaging.empty(),
            scratch,
            scales.narrow,
        )


class Together(Recorder):
    """A recorder of the lives of all lanes at once; a type, so that kernels leave out
    the rest."""

    __slots__ = ()


class OneByOne(Recorder):
    """A recorder of lives one by one: of few contacts, of those born stretched or whose
    stiffness varies, of paths that end with the segment, and in a hold."""

    __slots__ = ()


def recorder_for(alone: Iterable[bool]) -> type[Recorder]:
    """The recorder for segments in which lives are recorded `alone`, or not."""
    kinds = set(alone)
    return Recorder if len(kinds) > 1 else OneByOne if True in kinds else Together


def recorded_alone(c: Contacts, run: Run) -> bool:
    """Whether lives along a segment are recorded one by one."""
    varies = c.aging.stiffens and c.springs.slope > 0.0
    stretched = isinstance(c.newborn, Stretched)
    return (
        run.batch_by_life
        or varies
        or stretched
        or run.moves == 0
        or _follows_paths(c, run)
    )


def _follows_paths(c: Contacts, run: Run) -> bool:
    """Whether lives are paths that are recorded on their way, or end with the segment."""
    return c.aging.fluctuates and (
        c.springs.slope > 0.0 or run.batch_by_life or not run.last
    )


class Moments(NamedTuple):
    """Mean force, pinned fraction, and variance of the force over contacts, at every
    instant."""

    force: Array
    pinned: Array
    variance: Array


def moments(
    deposits: Array, scales: Scales, run: Run, contacts: int, drag: float
) -> Moments:
    """What deposits say, at every grid point."""
    X = np.linspace(
        0.0, run.distance, run.points, dtype=np.longdouble
    )  # squares cancel: 64 bits where there are
    total = Deposit(
        *(
            np.cumsum(deposits[name][: run.points]) / (np.longdouble(scale) * contacts)
            for name, scale in scales.deposits._asdict().items()
        )
    )
    if scales.uniform:  # k_i/k = 1: some fields stand for others
        total = total._replace(slope=total.count, slope2=total.count, ramp2=total.force)
    force = (total.slope * X + total.force).astype(float)
    square = ((total.slope2 * X + 2.0 * total.ramp2) * X + total.square).astype(float)
    pinned = total.count.astype(float)
    detached = 1.0 - pinned
    force += drag * detached
    variance = np.maximum(square + drag**2 * detached - force**2, 0.0)
    # what rounding may hide of it, over distances so long that squares of X drown it
    lost = (
        4.0 * np.finfo(np.longdouble).eps * total.slope2 * X * X
        + (X > 0) / scales.deposits.square
    )
    return Moments(force, pinned, variance + lost.astype(float))


# -------------------------------------------------------------------------------------------------------
# kernels


@routine(inline=True)
def fixed(x: float, scale: float) -> int:
    """x in fixed point."""
    return int(np.rint(x * scale))


@routine(inline=True)
def fixed_narrow(x: float, scale: float, narrow: bool) -> Any:
    """`fixed`, of numbers up to 2^51 if they are `narrow`: added to 1.5 2^52, they are
    the last bits of the sum. Few processors convert more than one number at a time."""
    if narrow:
        return np.float64(x * scale + 1.5 * 2.0**52).view(np.int64) - _SHIFTED
    return int(np.rint(x * scale))


@routine(inline=True)
def point_at(run: Run, x: float) -> int:
    """The first instant of a segment at or after `x`; `points` beyond the last one."""
    if run.moves == 0:
        return search(run.instants, x, False)
    per_step = (run.points - 1) / run.length
    return max(0, math.ceil(min(x * per_step, float(run.points))))


@routine(inline=True)
def instant(run: Run, j: int) -> float:
    """When, or where, instant j of a segment is."""
    return j * (run.length / (run.points - 1)) if run.moves != 0 else run.instants[j]


@routine(inline=True)
def leave(recorder: Recorder, j: int, sign: int, stiffness: float, born: float) -> None:
    """Add (sign 1) or take back (sign -1) a life's ramp at a grid point."""
    scales, ramp, here = recorder.scales, stiffness * born, recorder.deposits[j]
    here.count += sign
    here.slope += sign * fixed(stiffness, scales.slope)
    here.force -= sign * fixed(ramp, scales.force)
    here.slope2 += sign * fixed(stiffness * stiffness, scales.slope2)
    here.ramp2 -= sign * fixed(stiffness * ramp, scales.ramp2)
    here.square += sign * fixed(ramp * ramp, scales.square)


@routine
def leave_ramp(
    recorder: Recorder, stiffness: float, origin: float, born: float, broke: float
) -> None:
    """Record a life pinned at `born` <= X < `broke` whose stretch is X - `origin`; in a
    hold, from one instant to another with stretch -`origin`."""
    start, end = point_at(recorder.run, born), point_at(recorder.run, broke)
    if start < end:  # otherwise no grid point sees it
        leave(recorder, start, 1, stiffness, origin)
        leave(recorder, end, -1, stiffness, origin)


@routine(inline=True)
def leave_force(recorder: Recorder, j: int, force: float) -> None:
    """Record a force at one grid point."""
    scales, here, after = (
        recorder.scales,
        recorder.deposits[j],
        recorder.deposits[j + 1],
    )
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
    """The end of the half or quarter that x lies in, or of the segment if no averages
    are taken; infinite beyond the last."""
    if run.averages and x <= 0.75 * run.length:
        return (0.5 if x <= 0.5 * run.length else 0.75) * run.length
    return run.length if x <= run.length else math.inf


@routine(inline=True)
def average(
    recorder: Recorder,
    batch: int,
    stiffness: float,
    origin: float,
    born: float,
    broke: float,
    reborn: float,
) -> None:
    """Record in the two quarters of the second half a life whose stretch is X -
    `origin`, and the delay after it."""
    length, scales = recorder.run.length, recorder.window_scales
    for quarter in range(2):
        low = length * (0.5 + 0.25 * quarter)
        high = low + 0.25 * length
        window = recorder.windows[batch, quarter]
        start = max(born, low)
        end = min(broke, high)
        if end > start:
            window.area += fixed(
                stiffness * (end - start) * (0.5 * (start + end) - origin), scales.area
            )
            window.pinned += fixed(end - start, scales.pinned)
        end = min(reborn, high)
        if end > start:
            window.elapsed += fixed(end - start, scales.elapsed)
        if low < broke <= high:
            window.breaks += 1
            window.stretch += fixed(broke - origin, scales.stretch)
            window.travel += fixed(broke - born, scales.travel)


# ---------------------------------------------------------------------------------
# ramps of all lanes together


@routine(inline=True)
def point_after(x: float, run: Run, per_step: float) -> Any:
    """The first grid point at or after x >= 0; `run.points` beyond the last one."""
    at = np.ceil(min(x * per_step, float(run.points))) + 2.0**52
    return np.float64(at).view(np.int64) - _UNITS


@routine(inline=True)
def find_points(run: Run, x: Array, points: Array, count: int) -> None:
    """Find the grid points at or after the first `count` of x. A loop fills one array:
    with more, whether any of them overlap would take too long to find out for the
    compiler to use vectors."""
    per_step = (run.points - 1) / run.length
    for i in range(count):
        points[i] = point_after(x[i], run, per_step)


@routine(inline=True)
def leave_ramps(
    recorder: Recorder, born: Array, broke: Array, lives: Lives, r: int, count: int
) -> None:
    """Record the lives of round r of the first `count` lanes, pinned at 0 <= `born` <=
    X < `broke`; `count` is a multiple of four."""
    scales, columns, stiffness = recorder.scales, recorder.columns, lives.stiffness
    force, square, slope, slope2, ramp2 = (
        columns.force,
        columns.square,
        columns.slope,
        columns.slope2,
        columns.ramp2,
    )
    find_points(recorder.run, born, columns.begins, count)
    find_points(recorder.run, broke, columns.ends, count)
    for i in range(count):
        force[i] = fixed_narrow(
            stiffness[r, i] * born[i], -scales.force, recorder.narrow
        )
    for i in range(count):
        ramp = stiffness[r, i] * born[i]
        square[i] = fixed_narrow(ramp * ramp, scales.square, recorder.narrow)
    for i in range(count):
        slope[i] = fixed_narrow(stiffness[r, i], scales.slope, recorder.narrow)
    for i in range(count):
        slope2[i] = fixed_narrow(
            stiffness[r, i] * stiffness[r, i], scales.slope2, recorder.narrow
        )
    for i in range(count):
        kappa = stiffness[r, i]
        ramp2[i] = fixed_narrow(
            kappa * (kappa * born[i]), -scales.ramp2, recorder.narrow
        )
    numbers = columns.once, force, square, slope, slope2, ramp2
    for i in range(0, count, 4):
        add_rows(recorder.deposits, columns.begins, numbers, i)
        take_rows(recorder.deposits, columns.ends, numbers, i)


@routine(inline=True)
def leave_uniform_ramps(
    recorder: Recorder, born: Array, broke: Array, count: int
) -> None:
    """`leave_ramps` of contacts that are equally stiff: count and force stand for the
    other fields."""
    scales, columns = recorder.scales, recorder.columns
    find_points(recorder.run, born, columns.begins, count)
    find_points(recorder.run, broke, columns.ends, count)
    for i in range(count):
        columns.force[i] = fixed_narrow(born[i], -scales.force, recorder.narrow)
    for i in range(count):
        columns.square[i] = fixed_narrow(
            born[i] * born[i], scales.square, recorder.narrow
        )
    numbers = columns.once, columns.force, columns.square, columns.never
    for i in range(0, count, 4):
        add_rows(recorder.deposits, columns.begins, numbers, i)
        take_rows(recorder.deposits, columns.ends, numbers, i)


@routine(inline=True)
def join_uniform_ramps(
    recorder: Recorder, born: Array, broke: Array, count: int
) -> None:
    """`leave_uniform_ramps` without delay: a life begins where another ends, and only
    the square and the place of birth change there."""
    scales, columns = recorder.scales, recorder.columns
    find_points(recorder.run, broke, columns.ends, count)
    for i in range(count):
        columns.force[i] = fixed_narrow(
            broke[i] - born[i], -scales.force, recorder.narrow
        )
    for i in range(count):
        difference = (broke[i] - born[i]) * (born[i] + broke[i])
        columns.square[i] = fixed_narrow(difference, scales.square, recorder.narrow)
    numbers = columns.never, columns.force, columns.square, columns.never
    for i in range(0, count, 4):
        add_rows(recorder.deposits, columns.ends, numbers, i)
