"""Force of an ensemble on a grid of slider displacements, event driven: cost O(lives) + O(points), memory O(points).

Every contact is followed on its own. A life pinned from X0 to X1 adds kappa (X - X0) to the force between them, so it
leaves six numbers at the first grid point j0 >= X0 and takes them back at the first j1 >= X1; cumulative sums over the
grid then give the exact force at every point. All sums are of 64-bit integers (fixed point, one power of 2 per
column, chosen so that no sum can overflow), so the result does not depend on order, threads, or blocks.
"""

import itertools
import math
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor, wait
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from eqsim.compiled import inlined, kernel
from eqsim.engine.life import draw_lives, lives
from eqsim.engine.standing import Standing, standing, standing_contact, stretches, thresholds
from eqsim.engine.streams import TRAJECTORY, key, uniforms
from eqsim.ensemble import Contacts, Drive, Ensemble, lower
from eqsim.errors import InputError, require_integer
from eqsim.estimate import Estimate, drifts, ratio
from eqsim.laws.delay import delay_draw, residual_delay_draw
from eqsim.laws.octaves import Array
from eqsim.laws.threshold import NO_STEPS, NO_TABLE

LANES = 128  # contacts that advance together
BATCHES = 64  # independent groups whose scatter is the error of averages over the second half
_EXTREME_RANK, _EXTREME_CLOCK = 45.0, 110.0  # -ln of no 63-bit uniform, no clock of a standing contact, exceeds these
_BITS = 62  # of a sum; the sign and one more are left

# columns of the deposits; d is the distance slid since the life began
COUNT, SLOPE, FORCE, SLOPE2, RAMP2, SQUARE = range(6)  # 1, kappa, kappa d, kappa^2, kappa^2 d, (kappa d)^2
# columns of the batch sums, for each of the two quarters of the second half
AREA, PINNED, ELAPSED, BREAKS, STRETCH = range(5)

Progress = Callable[[int], None]


class Run(NamedTuple):
    """What a kernel needs to know of a run, lengths in units of the threshold law's scale."""

    distance: float
    points: int
    stationary: bool
    batch_by_life: bool  # few contacts: whole lives, not contacts, are the independent samples


_FRESH = Standing(1.0, 1.0, NO_TABLE, NO_TABLE, NO_STEPS, NO_STEPS)


@dataclass(frozen=True)
class Trajectory:
    """An ensemble's force against slider displacement.

    Arrays of shape (points,): `X` (length), `t` (time), `force` = <F>/(N k) (length) and its standard error, `pinned`
    = <N_c>/N and its standard error, all averaged over replicas; `force_replica_std`, the standard deviation of
    F/(N k) between replicas, if there are several. The three estimates average over the second half of the distance.
    """

    X: Array
    t: Array
    force: Array
    force_stderr: Array
    pinned: Array
    pinned_stderr: Array
    force_replica_std: Array | None
    friction: Estimate
    pinned_fraction: Estimate
    break_stretch: Estimate
    lives: int
    seed: int
    engine_seconds: float
    threads: int


def predicted_lives(ensemble: Ensemble, drive: Drive, replicas: int = 1) -> float:
    """How many lives a run will take, within a few per cent or somewhat too many: by Wald's identity a contact that
    uses up min(life and delay, distance) each time fills the distance."""
    c = lower(ensemble, drive.velocity)
    distance = drive.over(ensemble) / ensemble.thresholds.scale
    # mid-points of equal shares of thresholds and of clocks
    share = (np.arange(64) + 0.5) / 64
    u, v = (grid.ravel() for grid in np.meshgrid(share, share))
    stiffness, stretch = np.empty(u.size), np.empty(u.size)
    lives(c, u, v, stiffness, stretch)
    mean = float(np.mean(np.minimum(stretch + c.delay, distance)))
    return ensemble.count * replicas * (1.0 + distance / mean) if mean > 0 else math.inf


def check_run(
    ensemble: Ensemble, drive: Drive, points: int, seed: int, replicas: int, max_lives: float
) -> float:
    """The predicted lives of a run. Raises InputError if it cannot be done, or takes more than `max_lives` lives."""
    require_integer("points", points, 2, 10**8)
    require_integer("replicas", replicas, 1, 10**9)
    require_integer("seed", seed, 0, 2**63 - 1)
    expected = predicted_lives(ensemble, drive, replicas)
    if not expected <= max_lives:
        raise InputError(f"this run needs about {expected:.3g} lives, more than max_lives = {max_lives:.3g}")
    return expected


def trajectory(
    ensemble: Ensemble,
    drive: Drive,
    *,
    points: int = 2001,
    seed: int = 1,
    replicas: int = 1,
    threads: int = 1,
    max_lives: float = 1e10,
    progress: Progress | None = None,
) -> Trajectory:
    """Simulate `replicas` independent ensembles over the drive's distance, recorded at `points` equidistant X from 0.

    The result depends on `seed`, never on `threads`; `progress(lives)` is told how many lives have been simulated.
    Raises InputError for arguments out of range, and if more than `max_lives` lives are predicted.
    """
    check_run(ensemble, drive, points, seed, replicas, max_lives)
    begin = time.perf_counter()
    c = lower(ensemble, drive.velocity)
    unit = ensemble.thresholds.scale
    contacts = ensemble.count * replicas
    run = Run(drive.over(ensemble) / unit, points, drive.start == "stationary", contacts < BATCHES)
    table = standing(c) if run.stationary else _FRESH
    scales = Scales.of(c, run, contacts, replicas)
    drag = ensemble.eta * drive.velocity / ensemble.stiffness / unit
    job = (c, table, run, scales, key(seed, TRAJECTORY))
    total = _simulate_all(job, ensemble.count, replicas, drag, max(1, threads), progress)

    force, pinned, variance = _moments(total.deposits, scales, run, contacts, drag)
    one = 1.0 / contacts  # no sample of N contacts tells what less than one of them does
    pinned_variance = pinned * (1 - pinned) + one if c.delay > 0 else np.zeros(points)
    if not run.stationary:
        pinned_variance[0] = 0.0  # all contacts are pinned at X = 0
    std = None
    if replicas > 1:
        spread = total.replica_square / scales.replica_square - (total.replica_sum / scales.replica) ** 2 / replicas
        std = np.sqrt(np.maximum(spread, 0.0) / (replicas - 1)) * unit
    friction, pinned_fraction, stretch = _second_half(total.batches / scales.batches, total.lives, contacts, drag)
    grid = np.arange(points) * (drive.over(ensemble) / (points - 1))
    return Trajectory(
        X=grid,
        t=grid / drive.velocity,
        force=force * unit,
        force_stderr=np.sqrt(variance * one + (force * one) ** 2) * unit,
        pinned=pinned,
        pinned_stderr=np.sqrt(pinned_variance * one),
        force_replica_std=std,
        friction=_in(friction, unit),
        pinned_fraction=pinned_fraction,
        break_stretch=_in(stretch, unit),
        lives=total.lives,
        seed=seed,
        engine_seconds=time.perf_counter() - begin,
        threads=threads,
    )


class Scales(NamedTuple):
    """Powers of 2 that turn the deposits (6 columns), batch sums (5 columns) and replicas' forces into integers."""

    deposits: Array
    batches: Array
    replica: float
    replica_square: float

    @classmethod
    def of(cls, c: Contacts, run: "Run", contacts: int, replicas: int) -> "Scales":
        """The finest that no sum over all contacts can overflow, from the longest life there can be."""
        ranks = np.linspace(0.01, _EXTREME_RANK, 2000)
        xi, stretch = np.empty(ranks.size), np.empty(ranks.size)
        thresholds(c, np.exp(-ranks), xi)
        stretches(c, xi, np.full(ranks.size, _EXTREME_CLOCK), stretch)
        x = 1.1 * float(stretch.max())
        x = x if run.stationary else min(x, run.distance)
        kappa = c.kappa_constant + c.kappa_slope * 1.1 * float(xi.max())
        way = run.distance + x
        force = kappa * x
        deposits = [1.0, kappa, kappa * way, kappa**2, kappa**2 * way, 2 * kappa**2 * way * x]
        batches = [force * way, way, way, 1.0, way]

        def power(bounds: list[float], terms: int) -> Array:
            return 2.0 ** np.floor(_BITS - np.log2(terms) - np.log2(bounds))

        by_column = power(deposits, contacts)
        by_column[COUNT] = 1.0
        by_batch = power(batches, contacts)
        by_batch[BREAKS] = 1.0
        return cls(by_column, by_batch, float(power([force], replicas)[0]), float(power([force**2], replicas)[0]))


class Totals:
    """Integer sums of one thread; those of several threads simply add up."""

    def __init__(self, points: int, replicas: int) -> None:
        self.deposits = np.zeros((points, 6), np.int64)
        self.batches = np.zeros((BATCHES, 2, 5), np.int64)
        self.status = np.zeros(2, np.int64)  # lives so far; anything but 0 stops the kernel
        self.scratch = np.zeros_like(self.deposits) if replicas > 1 else self.deposits
        self.replica_sum = np.zeros(points if replicas > 1 else 0, np.int64)
        self.replica_square = np.zeros_like(self.replica_sum)

    @property
    def lives(self) -> int:
        return int(self.status[0])

    def close_replica(self, scales: Scales, run: "Run", contacts: int, drag: float) -> None:
        """Note the force of the ensemble just simulated and make room for the next one."""
        if self.scratch is self.deposits:
            return
        force, _, _ = _moments(self.scratch, scales, run, contacts, drag)
        self.replica_sum += np.rint(force * scales.replica).astype(np.int64)
        self.replica_square += np.rint(force**2 * scales.replica_square).astype(np.int64)
        self.deposits += self.scratch
        self.scratch[:] = 0

    def add(self, other: "Totals") -> None:
        for name in ("deposits", "batches", "status", "replica_sum", "replica_square"):
            getattr(self, name)[...] += getattr(other, name)


def _simulate_all(
    job: tuple[Contacts, Standing, "Run", Scales, tuple[int, int]],
    count: int,
    replicas: int,
    drag: float,
    threads: int,
    progress: Progress | None,
) -> Totals:
    """Hand blocks of contacts (whole ensembles if there are replicas) to threads as they become free."""
    c, table, run, scales, stream = job
    contacts = count * replicas
    lanes = min(LANES, -(-contacts // threads))
    block = count if replicas > 1 else max(lanes, min(-(-contacts // (16 * threads)), 2**20))
    blocks = itertools.count()  # next() is atomic
    totals = [Totals(run.points, replicas) for _ in range(threads)]

    def work(total: Totals) -> None:
        for index in blocks:
            first = index * block
            if first >= contacts or total.status[1]:
                return
            last = min(first + block, contacts)
            simulate(
                c, table, run, scales.deposits, scales.batches, stream, first, last,
                total.scratch, total.batches, total.status,
            )  # fmt: skip
            total.close_replica(scales, run, count, drag)

    with ThreadPoolExecutor(threads) as pool:
        running = {pool.submit(work, total) for total in totals}
        try:
            while running:
                done, running = wait(running, timeout=0.1)
                for future in done:
                    future.result()
                if progress:
                    progress(sum(total.lives for total in totals))
        except BaseException:
            for total in totals:
                total.status[1] = 1
            raise
    for other in totals[1:]:
        totals[0].add(other)
    return totals[0]


def _before(x: Array) -> Array:
    """Sum of all earlier elements."""
    return np.cumsum(x) - x


def _moments(deposits: Array, scales: Scales, run: "Run", contacts: int, drag: float) -> tuple[Array, Array, Array]:
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


def _second_half(batches: Array, lives: int, contacts: int, drag: float) -> tuple[Estimate, Estimate, Estimate]:
    """Averages over the second half of the distance, unreliable if its two quarters differ by more than 4 sigma."""
    area, pinned, elapsed, breaks, stretch = np.moveaxis(batches, 2, 0)  # each (batches, quarters)
    enough = contacts >= BATCHES or breaks.sum() >= 4 * BATCHES

    def over(numerator: Array, denominator: Array) -> Estimate:
        found = ratio(numerator.sum(1), denominator.sum(1), lives)
        steady = found.reliable and not drifts(numerator, denominator, sigmas=4.0)
        return replace(found, reliable=bool(steady and enough))

    slope = over(stretch, breaks)
    return (
        over(area + drag * (elapsed - pinned), elapsed),
        over(pinned, elapsed),
        replace(slope, reliable=slope.reliable and bool(breaks.sum() >= BATCHES)),
    )


def _in(estimate: Estimate, unit: float) -> Estimate:
    if estimate.value is None:
        return estimate
    stderr = None if estimate.stderr is None else estimate.stderr * unit
    return replace(estimate, value=estimate.value * unit, stderr=stderr)


# ------------------------------------------------------------------------------------------------------- kernels


@inlined
def fixed(x: float, scale: float) -> int:
    """x in fixed point."""
    return np.int64(np.rint(x * scale))


@inlined
def leave(row: Array, sign: int, stiffness: float, d: float, scales: Array) -> None:
    """Add (sign 1) or take back (sign -1) a life's ramp at a grid point where it has slid d."""
    square = stiffness * stiffness
    row[COUNT] += sign
    row[SLOPE] += sign * fixed(stiffness, scales[SLOPE])
    row[FORCE] += sign * fixed(stiffness * d, scales[FORCE])
    row[SLOPE2] += sign * fixed(square, scales[SLOPE2])
    row[RAMP2] += sign * fixed(square * d, scales[RAMP2])
    row[SQUARE] += sign * fixed(square * d * d, scales[SQUARE])


@inlined
def deposit(deposits: Array, run: Run, stiffness: float, born: float, broke: float, scales: Array) -> None:
    """A life pinned at `born` <= X < `broke`."""
    per_step = (run.points - 1) / run.distance
    step = run.distance / (run.points - 1)
    start = max(0, np.int64(math.ceil(born * per_step)))
    end = np.int64(math.ceil(min(broke, 2.0 * run.distance) * per_step))
    if start < end:  # otherwise no grid point sees it
        if start < run.points:
            leave(deposits[start], 1, stiffness, start * step - born, scales)
        if end < run.points:
            leave(deposits[end], -1, stiffness, end * step - born, scales)


@inlined
def record(
    batch: Array, run: Run, stiffness: float, born: float, broke: float, reborn: float, scales: Array
) -> None:
    """What a life and the delay after it leave in the two quarters of the second half."""
    for quarter in range(2):
        low = run.distance * (0.5 + 0.25 * quarter)
        high = low + 0.25 * run.distance
        row = batch[quarter]
        start = max(born, low)
        end = min(broke, high)
        if end > start:
            row[AREA] += fixed(stiffness * (end - start) * (0.5 * (start + end) - born), scales[AREA])
            row[PINNED] += fixed(end - start, scales[PINNED])
        end = min(reborn, high)
        if end > start:
            row[ELAPSED] += fixed(end - start, scales[ELAPSED])
        if low < broke <= high:
            row[BREAKS] += 1
            row[STRETCH] += fixed(broke - born, scales[STRETCH])


@kernel
def simulate(
    c: Contacts,
    standing: Standing,
    run: Run,
    scales: Array,
    batch_scales: Array,
    key: tuple[int, int],
    first: int,
    last: int,
    deposits: Array,
    batches: Array,
    status: Array,
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
                batch = batches[upcoming % BATCHES]
                u_state, u_residual = uniforms(key, upcoming, 0, 0)
                if u_state < standing.pinned:
                    kappa, x, ends = standing_contact(c, standing, key, upcoming, u_residual)
                    gap = delay_draw(c.delay, c.exponential, uniforms(key, upcoming, 0, 65535)[0])
                    broke = ends - x
                    deposit(deposits, run, kappa, -x, broke, scales)
                    position[active] = broke + gap
                    record(batch, run, kappa, -x, broke, position[active], batch_scales)
                else:
                    position[active] = residual_delay_draw(c.delay, c.exponential, u_residual)
                    record(batch, run, 0.0, 0.0, 0.0, position[active], batch_scales)
            upcoming += 1
            active += position[active] <= run.distance
        if active == 0 or status[1] != 0:
            return
        for i in range(active):
            u[i], v[i] = uniforms(key, contact[i], life[i], 0)
        draw_lives(c, u, v, stiffness, stretch, active)
        status[0] += active
        for i in range(active - 1, -1, -1):
            broke = position[i] + stretch[i]
            reborn = broke + c.delay
            if c.exponential:
                reborn = broke + delay_draw(c.delay, True, uniforms(key, contact[i], life[i], 1)[0])
            deposit(deposits, run, stiffness[i], position[i], broke, scales)
            if reborn > 0.5 * run.distance:
                batch = batches[(contact[i] + life[i] * run.batch_by_life) % BATCHES]
                record(batch, run, stiffness[i], position[i], broke, reborn, batch_scales)
            position[i] = reborn
            life[i] += 1
            if reborn > run.distance:
                active -= 1
                contact[i], life[i], position[i] = contact[active], life[active], position[active]
