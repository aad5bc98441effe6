"""Force of an ensemble on a grid of slider displacements, event driven: cost O(lives) + O(points), memory O(points).

Contacts do not act on each other, so each is followed on its own from start to end (`ramps`), by any thread or any
worker of an executor.
"""

import math
import time
from collections.abc import Callable, Iterable
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ThreadPoolExecutor, wait
from contextlib import nullcontext
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from eqsim.engine.contacts import Contacts, contacts
from eqsim.engine.lanes import rough_stretch, typical_lives
from eqsim.engine.langevin import STEP_ERROR, step_error
from eqsim.engine.recorder import AREA, BATCHES, BREAKS, ELAPSED, PINNED, STRETCH, Recorder, Run, Scales, moments
from eqsim.engine.scatter import ENOUGH, Births, Scatter, births, known_variance, scatter
from eqsim.engine.simulate import simulate
from eqsim.engine.stationary import FRESH, Stationary, stationary
from eqsim.engine.steady import settled
from eqsim.errors import InputError, require_number
from eqsim.estimate import OBSERVABLES, Averages, Estimate, drifts, known, ratio
from eqsim.model.drive import Drive, check_output, require_drive
from eqsim.model.ensemble import Ensemble
from eqsim.model.reduced import drag_of
from eqsim.numerics.streams import TRAJECTORY, Key, key
from eqsim.numerics.tables import Array

Progress = Callable[[int], None]
_RARE = 1e-4  # probability of more than five standard errors of the force
_BLOCK = 128  # contacts, at least, unless there are fewer
_SHARES = 4  # for each worker of an executor: few enough that tables and sums travel seldom, and workers end together


@dataclass(frozen=True)
class Trajectory:
    """An ensemble's force against slider displacement.

    Attributes
    ----------
    X, t : ndarray, shape (points,)
        Displacement (length) and time.
    force, force_stderr : ndarray, shape (points,)
        <F>/(N k) (length), averaged over replicas, and its standard error.
    force_reliable : bool
        False where too few contacts make the force for five standard errors to mean what they say;
        `force_replica_std` then misses what the sample did.
    pinned, pinned_stderr : ndarray, shape (points,)
        <N_c>/N, averaged over replicas, and its standard error.
    force_replica_std : ndarray, shape (points,), or None
        Standard deviation of F/(N k) between replicas, if there are several.
    averages : Averages
        Over the second half of the distance; unreliable also where the law expects a transient in it, or too few of the
        lives that make their scatter (`engine.scatter`).
    lives : int
        Lives of contacts that were simulated.
    seed, engine_seconds, threads
        How it was computed.
    """

    X: Array
    t: Array
    force: Array
    force_stderr: Array
    force_reliable: bool
    pinned: Array
    pinned_stderr: Array
    force_replica_std: Array | None
    averages: Averages
    lives: int
    seed: int
    engine_seconds: float
    threads: int

    def columns(self) -> dict[str, Array]:
        """The arrays by name, `force_replica_std` only if there are replicas."""
        names = ("X", "t", "force", "pinned", "force_stderr", "pinned_stderr", "force_replica_std")
        return {name: column for name in names if (column := getattr(self, name)) is not None}


def predicted_lives(ensemble: Ensemble, drive: Drive, replicas: int = 1) -> float:
    """How many lives a run will take, within a few per cent or somewhat too many: by Wald's identity a contact that
    uses up min(life and delay, distance) each time fills the distance."""
    c = contacts(ensemble, drive.velocity, rough_stretch(ensemble, drive.velocity))
    distance = drive.over(ensemble) / ensemble.thresholds.scale
    _, stretch = typical_lives(c)
    mean = float(np.mean(np.minimum(stretch + c.delay.mean, distance)))
    return ensemble.count * replicas * (1.0 + distance / mean) if mean > 0 else math.inf


def check_run(ensemble: Ensemble, drive: Drive, points: int, seed: int, replicas: int, max_lives: float) -> float:
    """The predicted lives of a run. Raises InputError if it cannot be done, or takes more than `max_lives` lives."""
    check_output(points, seed, replicas)
    require_number("distance / threshold", drive.over(ensemble) / ensemble.thresholds.scale, least=1e-100, most=1e100)
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
    threads: int | tuple[Executor, int] = 1,
    max_lives: float = 1e10,
    progress: Progress | None = None,
) -> Trajectory:
    """Simulate the force of an ensemble against slider displacement, contact by contact.

    Parameters
    ----------
    ensemble : Ensemble
    drive : Drive
        Constant velocity over a distance, from a fresh or a stationary start.
    points : int
        Equidistant X from 0 at which the force is recorded.
    seed : int
        Of the random numbers; the result depends on nothing else.
    replicas : int
        Independent ensembles; means and standard deviations are over all of them.
    threads : int or (Executor, int)
        Threads of this process; or an executor (a ProcessPoolExecutor, the `get_executor()` of a dask client), which
        the caller shuts down, and about how many workers it has. The same bits.
    max_lives : float
        Work that needs more lives of contacts is refused.
    progress : callable, optional
        `progress(lives)` is told now and then how many lives have been simulated.

    Returns
    -------
    Trajectory

    Raises
    ------
    InputError
        For arguments out of range, and if more than `max_lives` lives are predicted. What a lost worker makes an
        executor raise is passed on.
    """
    require_drive(drive)
    check_run(ensemble, drive, points, seed, replicas, max_lives)
    workers = threads[1] if isinstance(threads, tuple) else max(1, threads)
    mean_stretch = settled(ensemble, drive, seed, workers)
    c = contacts(ensemble, drive.velocity, mean_stretch)
    unit = ensemble.thresholds.scale
    count = ensemble.count * replicas
    run = Run(drive.over(ensemble) / unit, points, drive.start == "stationary", count < BATCHES)
    table = stationary(c) if run.stationary else FRESH
    drag = drag_of(ensemble, drive.velocity)
    scales = Scales.of(c, run, count, replicas, drag)
    job = (c, table, run, scales, key(seed, TRAJECTORY))
    nothing = Totals(2, 1)
    simulate(*arguments(job, nothing), 0, 0)  # compiles, so that seconds are those of the work
    begin = time.perf_counter()
    total = _simulate_all(job, ensemble.count, replicas, drag, threads, progress)

    force, pinned, variance = moments(total.deposits, scales, run, count, drag)
    grid = np.arange(points) * (drive.over(ensemble) / (points - 1))
    # A sample of N contacts does not tell what fewer than about two of them do (Agresti and Coull, 1998): without these
    # two an error bar would vanish wherever no contact happens to be pinned or detached.
    pinned_variance = pinned * (1 - pinned) / count + ((2.0 / count) ** 2 if c.delay.mean > 0 else 0.0)
    if not run.stationary:  # all contacts are pinned and unstretched at X = 0
        pinned_variance[0] = 0.0
    one = replace(ensemble, count=1)
    law, level, alike = _expected(one, drive.velocity, mean_stretch, None if run.stationary else run.distance)
    force_variance, rare = known_variance(law.at(grid / unit), level, variance, count)
    _, always_rare = known_variance(level, level, level.variance, count)
    # what steps of fluctuating thresholds cost, relative, where that is more than usual: the usual is below scatter
    bias = max(step_error(c.aging) - STEP_ERROR, 0.0) if c.aging.fluctuates else 0.0
    pinned_variance += (bias * pinned * (1.0 - pinned)) ** 2
    force_variance = force_variance + (bias * force) ** 2
    rounding = 1e-15 * run.distance  # of the cumulative sums
    std = None
    if replicas > 1:
        spread = total.replica_square / scales.replica_square - (total.replica_sum / scales.replica) ** 2 / replicas
        std = np.sqrt(np.maximum(spread, 0.0) / (replicas - 1)) * unit
    second_half = _second_half(total.batches / scales.batches, total.lives, count, drag)
    late = law.at(np.linspace(0.5 * run.distance, run.distance, 1025))
    friction, pinned_fraction = second_half[:2]
    gone = _is_over(friction, late.mean, level.mean[0]) and _is_over(pinned_fraction, late.pinned, level.pinned[0])
    units = [unit if shown.unit == "length" else 1.0 for shown in OBSERVABLES.values()]
    enough = [lives * 0.5 * run.distance * count >= ENOUGH for lives in alike]
    return Trajectory(
        X=grid,
        t=grid / drive.velocity,
        force=force * unit,
        force_stderr=np.sqrt(force_variance + rounding**2 * (grid > 0)) * unit,
        force_reliable=bool(min(np.mean(rare), always_rare[0]) < _RARE),
        pinned=pinned,
        pinned_stderr=np.sqrt(pinned_variance),
        force_replica_std=std,
        averages=Averages(
            *(
                _in(_widened(one, bias), size, gone and seen)
                for one, size, seen in zip(second_half, units, enough, strict=True)
            )
        ),
        lives=total.lives,
        seed=seed,
        engine_seconds=time.perf_counter() - begin,
        threads=workers,
    )


@lru_cache(maxsize=32)
def _expected(
    ensemble: Ensemble, velocity: float, mean_stretch: float | None, distance: float | None
) -> tuple[Scatter, Scatter, tuple[float, ...]]:
    """What the law says of the scatter of forces over a distance and in the stationary state, and of how many
    `independent` lives there are to a unit of displacement. Remembered: it takes 20 ms, and seeds share it."""
    c, drag = contacts(ensemble, velocity, mean_stretch), drag_of(ensemble, velocity)
    born = births(c)
    level = scatter(c, born, None, drag)
    law = level if distance is None else scatter(c, born, distance, drag)
    return law, level, independent(c, born, drag)


def independent(c: Contacts, born: Births, drag: float) -> tuple[float, ...]:
    """How many lives like those that make the scatter there are to a unit of displacement, for their averages:
    friction, pinned fraction and stretch at breaking. Of n lives with residuals r = work + drag T - friction (x_b + T)
    these are n (E r^2)^3/max(E r+^3, E r-^3)^2: their inverse square root bounds the skewness of the mean of r, and
    half of it how far Student's t is off in the mean (derived)."""
    waits = c.delay.law.sample()
    share, wait = np.repeat(born.share / waits.size, waits.size), np.tile(waits, born.share.size)
    stretch = np.repeat(born.stretch, waits.size)
    work = 0.5 * np.repeat(born.stiffness, waits.size) * stretch**2
    cycle = stretch + wait

    def alike(reward: Array, per: Array) -> float:
        with np.errstate(all="ignore"):
            residual = reward - np.sum(share * reward) / np.sum(share * per) * per
            residual *= np.abs(residual) > 1e-12 * np.abs(reward)  # rounding
            cubes = share * residual**3
            square, cube = np.sum(share * residual**2), max(np.sum(cubes[cubes > 0]), -np.sum(cubes[cubes < 0]))
            return float(1.0 / np.sum(share * cycle) * square**3 / cube**2) if cube > 0 else math.inf

    return alike(work + drag * wait, cycle), alike(stretch, cycle), alike(stretch, np.ones(stretch.size))


class Totals:
    """Integer sums of one thread or share of the contacts; those of several simply add up."""

    sums = ("deposits", "batches", "status", "replica_sum", "replica_square")

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

    def close_replica(self, scales: Scales, run: Run, contacts: int, drag: float) -> None:
        """Note the force of the ensemble just simulated and clear the sums for the next one."""
        if self.scratch is self.deposits:
            return
        force, _, _ = moments(self.scratch, scales, run, contacts, drag)
        self.replica_sum += np.rint(force * scales.replica).astype(np.int64)
        self.replica_square += np.rint(force**2 * scales.replica_square).astype(np.int64)
        self.deposits += self.scratch
        self.scratch[:] = 0

    def add(self, other: "Totals") -> None:
        for name in self.sums:
            getattr(self, name)[...] += getattr(other, name)

    def __getstate__(self) -> dict[str, Array]:
        """What comes back from a worker: the sums, without scratch."""
        return {name: getattr(self, name) for name in self.sums}


_Job = tuple[Contacts, Stationary, Run, Scales, Key]


def arguments(job: _Job, total: Totals) -> tuple[Any, ...]:
    """What `simulate` needs besides the range of contacts."""
    c, table, run, scales, stream = job
    sums = (total.scratch, total.batches, total.status)
    return c, table, Recorder(run, scales.deposits, scales.batches, *sums), stream


class _Blocks(NamedTuple):
    """How contacts are divided: blocks of `size`, whole ensembles of `contacts` if there are replicas."""

    size: int
    contacts: int
    replicas: int
    drag: float


def _follow(job: _Job, blocks: _Blocks, firsts: Iterable[int], total: Totals | None = None) -> Totals:
    """Simulate the blocks that begin at the contacts `firsts`, in a thread or in a worker of an executor."""
    _, _, run, scales, _ = job
    total = total or Totals(run.points, blocks.replicas)
    for first in firsts:
        if total.status[1]:
            break
        simulate(*arguments(job, total), first, min(first + blocks.size, blocks.contacts * blocks.replicas))
        total.close_replica(scales, run, blocks.contacts, blocks.drag)
    return total


def _simulate_all(
    job: _Job,
    count: int,
    replicas: int,
    drag: float,
    threads: int | tuple[Executor, int],
    progress: Progress | None,
) -> Totals:
    """Hand blocks of contacts (whole ensembles if there are replicas) to threads as they become free, or a few shares
    of them for each worker to an executor."""
    _, _, run, _, _ = job
    executor, threads = threads if isinstance(threads, tuple) else (None, max(1, threads))
    contacts = count * replicas
    least = _BLOCK if executor else min(_BLOCK, -(-contacts // threads))
    size = count if replicas > 1 else max(least, min(-(-contacts // (16 * threads)), 2**20))
    blocks, firsts = _Blocks(size, count, replicas, drag), range(0, contacts, size)
    totals = [Totals(run.points, replicas) for _ in range(1 if executor else threads)]
    running: set[Future[Totals]] = set()
    pool = None if executor else ThreadPoolExecutor(threads)
    with pool or nullcontext():
        try:
            if pool:
                shared = iter(firsts)  # next() is atomic
                running = {pool.submit(_follow, job, blocks, shared, total) for total in totals}
            elif executor:
                shares = min(_SHARES * threads, len(firsts))
                running = {executor.submit(_follow, job, blocks, firsts[i::shares]) for i in range(shares)}
            while running:
                done, running = wait(running, timeout=0.1, return_when=FIRST_COMPLETED)
                for future in done:
                    part = future.result()
                    if executor:
                        totals[0].add(part)
                if progress:
                    progress(sum(total.lives for total in totals))
        except BaseException:
            for total in totals:
                total.status[1] = 1
            for future in running:
                future.cancel()
            raise
    for other in totals[1:]:
        totals[0].add(other)
    return totals[0]


def _second_half(batches: Array, lives: int, contacts: int, drag: float) -> tuple[Estimate, ...]:
    """Averages over the second half of the distance; unreliable if its two quarters differ by more than 4 sigma, or
    fewer contacts broke in it than there are batches."""
    columns = (AREA, PINNED, ELAPSED, BREAKS, STRETCH)
    area, pinned, elapsed, breaks, stretch = (batches[:, :, column] for column in columns)
    seen = breaks.sum()
    enough = seen >= BATCHES and (contacts >= BATCHES or seen >= 4 * BATCHES)

    def over(numerator: Array, denominator: Array) -> Estimate:
        found = ratio(numerator.sum(1), denominator.sum(1), lives)
        if found.stderr is not None and seen and not (numerator is pinned and found.stderr == 0):
            # nor does a sample of lives tell what fewer than about two of them do
            found = replace(found, stderr=math.hypot(found.stderr, 2.0 / seen * abs(known(found))))
        steady = found.reliable and not drifts(numerator, denominator, sigmas=4.0)
        return replace(found, reliable=bool(steady and enough))

    return over(area + drag * (elapsed - pinned), elapsed), over(pinned, elapsed), over(stretch, breaks)


def _is_over(estimate: Estimate, expected: Array, level: float) -> bool:
    """Whether the transient, as the law expects it, moves an average by less than half its error, or by rounding."""
    return bool(abs(np.mean(expected) - level) <= 0.5 * (estimate.stderr or 0.0) + 1e-9 * level)


def _widened(estimate: Estimate, relative: float) -> Estimate:
    """With a relative error more."""
    if not relative or estimate.value is None or estimate.stderr is None:
        return estimate
    return replace(estimate, stderr=math.hypot(estimate.stderr, relative * estimate.value))


def _in(estimate: Estimate, unit: float, trusted: bool) -> Estimate:
    """In the user's unit, and unreliable unless `trusted`."""
    value = None if estimate.value is None else estimate.value * unit
    stderr = None if estimate.stderr is None else estimate.stderr * unit
    return replace(estimate, value=value, stderr=stderr, reliable=estimate.reliable and trusted)
