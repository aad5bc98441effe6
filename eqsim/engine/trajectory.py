"""Force of an ensemble on a grid of slider displacements, event driven: cost O(lives) +
O(points), memory O(points).

Contacts do not act on each other, so each is followed on its own from start to end
(`engine.lanes`), by any thread or any worker of an executor.
"""

import math
from dataclasses import replace
from functools import lru_cache
from typing import Any, overload

import numpy as np

from eqsim import estimate
from eqsim.engine import programme, scatter
from eqsim.engine.blocks import Progress, Threads, require_lives, simulated, workers_of
from eqsim.engine.chain import chain_trajectory
from eqsim.engine.contacts import Contacts, contacts
from eqsim.engine.readings import Forces, shown_by
from eqsim.engine.recorder import BATCHES, Moments, Run, Scales, Window
from eqsim.engine.records import ProgrammeTrajectory, Trajectory
from eqsim.engine.sample import rough_stretch, square_of, typical_lives
from eqsim.engine.scatter import Births, Scatter
from eqsim.engine.slider_runs import pulled
from eqsim.engine.stationary import Fresh, stationary
from eqsim.engine.steady import settled
from eqsim.errors import InputError, require_number
from eqsim.estimate import Averages, Estimate
from eqsim.model.drive import Drive, Output, Programme, over_distance, require_drive
from eqsim.model.ensemble import Ensemble
from eqsim.model.load import Added, births_of, under_load
from eqsim.model.mixture import mixed_averages, summed
from eqsim.model.reduced import drag_of
from eqsim.numerics.streams import TRAJECTORY, seed_named
from eqsim.numerics.streams import key as key_of
from eqsim.numerics.tables import Array

_OF_LOAD = 1_000_000  # names streams of contacts that a load adds
# Pieces into which a ramp of the load is divided, each adds contacts: in a life, at
# least and at most.
_PIECES_PER_LIFE, _FEWEST_PIECES, _MOST_PIECES = 4, 16, 200
_MOST_FORCES = 50_000_000  # that are kept of all contacts ramps add, for memory
# Fewest contacts that are added at an instant and simulated, for their scatter.
_LEAST_ADDED = 32
_UNCOUNTED = 1000  # lives, so few that exceeding `max_lives` by them does not matter
# Square of a mean over its expectation: exceeded by chance once in 2e6 runs (one degree
# of freedom).
_CHANCE = 25.0
_ROUNDING = 1e-24  # relative rounding of a mean force, squared
# Relative rounding of the law's transient, per life: sums over some 10^4 lives round by
# some 100 times that of a number, and all births of the past enter.
_LATTICE_ROUNDING = 100.0 * np.finfo(float).eps


def predicted_lives(
    ensemble: Ensemble, drive: Drive | Programme, replicas: int = 1
) -> float:
    """Predict the number of lives of a run, within a few per cent or somewhat too many:
    by Wald's identity a contact that uses up min(life and delay, distance) each time
    fills the distance."""
    if ensemble.populations:
        way, kinds = over_distance(drive, ensemble), ensemble.kinds
        return sum(predicted_lives(kind.contacts, way, replicas) for kind in kinds)
    if isinstance(drive, Programme):
        # what a force lets go of lives once, and nobody knows before what it holds
        lives = 1.0 if drive.forced else sum(programme.cycles(ensemble, drive))
        if drive.loaded:
            born = _births(ensemble, drive, Output(2, replicas=replicas))[1]
            lives *= sum(_added(ensemble, births) for births in born) / ensemble.count
        if drive.stage:
            lives += abs(drive.stage.preload or 0.0) / ensemble.thresholds.mean
        return ensemble.count * replicas * lives
    c = contacts(ensemble, drive.velocity, rough_stretch(ensemble, drive.velocity))
    distance = drive.over(ensemble) / ensemble.thresholds.scale
    stretch = typical_lives(c).travel
    mean = float(np.mean(np.minimum(stretch + c.delay.mean, distance)))
    return ensemble.count * replicas * (1.0 + distance / mean) if mean > 0 else math.inf


def _births(
    ensemble: Ensemble, drive: Programme, output: Output
) -> tuple[Array, list[Added]]:
    """Births under a load along a simulated record, several in a life, as far as memory
    and time allow."""
    most = _MOST_FORCES // (output.points * output.replicas)
    most = min(max(most, _FEWEST_PIECES), _MOST_PIECES)
    lives = programme.cycles(ensemble, drive)
    wanted = [max(_PIECES_PER_LIFE * each, _FEWEST_PIECES) for each in lives]
    return births_of(drive, output.points, [min(each, most) for each in wanted])


def _added(ensemble: Ensemble, births: Added) -> int:
    """Number of contacts that are simulated of those that are born together."""
    return max(_LEAST_ADDED, round(ensemble.count * float(births.weight.max())))


def check_run(
    ensemble: Ensemble, drive: Drive | Programme, output: Output, max_lives: float
) -> float:
    """The predicted lives of a run. Raises InputError if it cannot be done, or takes
    more than `max_lives` lives."""
    if isinstance(drive, Programme):
        for kind in ensemble.kinds:
            programme.check_programme(kind.contacts, drive)
    else:
        require_drive(drive)
        if drive.start == "stationary":
            ensemble.require_steady_state(drive.velocity)
        distance = drive.over(ensemble) / ensemble.thresholds.scale
        require_number("distance / threshold", distance, least=1e-100, most=1e100)
    expected = predicted_lives(ensemble, drive, output.replicas)
    require_lives(expected, max_lives)
    return expected


def guarded(progress: Progress | None, expected: float, max_lives: float) -> Progress:
    """Wrap `progress` of a run of which so many lives are `expected`, to stop it with
    InputError where it takes more than twice `max_lives`: predictions from typical
    lives may fail for a slider behind a spring."""

    def count(lives: int) -> None:
        if lives > 2.0 * max_lives + _UNCOUNTED:
            raise InputError(
                f"this run has taken {lives:.3g} lives, more than max_lives = "
                f"{max_lives:.3g}; {expected:.3g} were expected"
            )
        if progress:
            progress(lives)

    return count


@overload
def trajectory(
    ensemble: Ensemble, drive: Drive, *, points: int = ..., seed: int = ...,
    replicas: int = ..., threads: Threads = ..., max_lives: float = ...,
    progress: Progress | None = ...,
) -> Trajectory: ...  # fmt: skip
@overload
def trajectory(
    ensemble: Ensemble, drive: Programme, *, points: int = ..., seed: int = ...,
    replicas: int = ..., threads: Threads = ..., max_lives: float = ...,
    progress: Progress | None = ...,
) -> ProgrammeTrajectory: ...  # fmt: skip
def trajectory(
    ensemble: Ensemble,
    drive: Drive | Programme,
    *,
    points: int = 2001,
    seed: int = 1,
    replicas: int = 1,
    threads: Threads = 1,
    max_lives: float = 1e10,
    progress: Progress | None = None,
) -> Trajectory | ProgrammeTrajectory:
    """Simulate the force of an ensemble along a drive, contact by contact.

    The force recorded is <F>/(N k), a length, for N contacts of stiffness k: multiply
    it by N k for newtons. All lengths and times are in the units of the arguments.

    Parameters
    ----------
    ensemble : Ensemble
    drive : Drive or Programme
        Constant velocity (length/time) over a distance, or one segment after another,
        from a fresh or a stationary start. A `stage` makes the drive that of a stage
        which pulls the slider through a spring: X is found, not given. Coupled blocks
        are pulled by `elastic_trajectory`.
    points : int
        Equidistant X from 0 at which the force is recorded; of a programme about so
        many instants (`Programme.grid`).
    seed : int
        Seed of the random numbers; threads and workers change nothing.
    replicas : int
        Independent ensembles; means and standard deviations are over all of them.
    threads : int or (Executor, int)
        Threads of this process; or an executor (a ProcessPoolExecutor, the
        `get_executor()` of a dask client), which the caller shuts down, and about how
        many workers it has. The same bits.
    max_lives : float
        Work that needs more lives of contacts is refused, and stopped where it takes
        twice as many.
    progress : callable, optional
        `progress(lives)` is called now and then with the lives simulated so far.

    Returns
    -------
    Trajectory, or ProgrammeTrajectory (with a stage: SliderTrajectory)

    Raises
    ------
    InputError
        For arguments out of range, for contacts that follow no programme, and if more
        than `max_lives` lives are predicted, or twice as many are taken. What a lost
        worker makes an executor raise is passed on.

    Examples
    --------
    >>> from eqsim import Drive, Ensemble, trajectory
    >>> run = trajectory(Ensemble(count=1000), Drive(0.1, distance=10.0), points=11)
    >>> print(run.X[-1], run.force[0])  # lengths
    10.0 0.0
    >>> print(f"{run.friction.value:.1f}")  # over the second half
    0.9
    """
    output = Output(points, seed, replicas)
    expected = check_run(ensemble, drive, output, max_lives)
    progress = guarded(progress, expected, max_lives)
    if isinstance(drive, Programme) and drive.chain:
        return chain_trajectory(ensemble, drive, output, threads, progress)
    if isinstance(drive, Programme) and drive.pulled:
        return pulled(ensemble, drive, output, threads, progress)
    loaded = isinstance(drive, Programme) and drive.loaded
    if ensemble.populations or loaded:
        return _one_by_one(ensemble, drive, output, threads, progress)
    if isinstance(drive, Programme):
        return programme.along(ensemble, drive, output, threads, progress)
    workers = workers_of(threads)
    mean_stretch = settled(ensemble, drive, seed, workers)
    c = contacts(ensemble, drive.velocity, mean_stretch)
    unit, drag = ensemble.thresholds.scale, drag_of(ensemble, drive.velocity)
    count, distance = ensemble.count * replicas, drive.over(ensemble)
    from_steady, few = drive.start == "stationary", count < BATCHES
    run = Run(distance / unit, points, from_steady, batch_by_life=few)
    start = stationary(c) if run.stationary else Fresh()
    scales = Scales.of(c, run, count, replicas, drag)
    key = key_of(seed, TRAJECTORY)
    job = programme.constant_drive(c, start, run, scales, key, drag)
    done = simulated(job, ensemble.count, replicas, threads, progress)

    force, pinned, variance, lost = done.moments
    grid = np.arange(points) * (distance / (points - 1))
    of_pinned = scatter.pinned_variance(pinned, count, c.delay.mean > 0)
    if not run.stationary:  # all contacts are pinned and unstretched at X = 0
        of_pinned[0] = 0.0
    single, way = replace(ensemble, count=1), None if run.stationary else run.distance
    law, level, (alike, noise) = _expected(single, drive.velocity, mean_stretch, way)
    here = law.at(grid / unit)
    of_force, rare = scatter.known_variance(here, level, variance + lost, count)
    _, always_rare = scatter.known_variance(level, level, level.variance, count)
    bias = programme.step_bias(job.steps)
    of_pinned += (bias * pinned * (1.0 - pinned)) ** 2
    of_force = of_force + (bias * force) ** 2
    rounding = 1e-15 * run.distance  # of the cumulative sums
    sums = zip(Window._fields, scales.windows, strict=True)
    windows = Window(*(done.total.windows[name] / scale for name, scale in sums))
    second_half = _second_half(windows, done.lives, count, drag)
    late = law.at(np.linspace(0.5 * run.distance, run.distance, 1025))
    spread = estimate.infinite(count)
    if c.delay.mean == math.inf:  # no stationary state gives it an error
        spread = Estimate(None, None, count)
    elif not ensemble.divergence:
        friction = second_half[0].value
        spread = _force_variance(done.moments, friction, level, run, count, noise)
    off = _LATTICE_ROUNDING * done.lives / count
    gone = _is_over(second_half[0], late.mean, level.mean[0], off)
    gone = gone and _is_over(second_half[1], late.pinned, level.pinned[0], off)
    seen = [gone and n * 0.5 * run.distance * count >= scatter.ENOUGH for n in alike]
    square = late.variance + (late.mean - level.mean[0]) ** 2
    seen[-1] = seen[-1] and _is_over(spread, square, level.variance[0], off)
    units = [shown.size(unit) for shown in estimate.OBSERVABLES.values()]
    parts = zip((*second_half, spread), units, seen, strict=True)
    return Trajectory(
        X=grid,
        t=grid / drive.velocity,
        force_stderr=np.sqrt(of_force + rounding**2 * (grid > 0)) * unit,
        force_reliable=bool(min(np.mean(rare), always_rare[0]) < scatter.RARE),
        pinned_stderr=np.sqrt(of_pinned),
        averages=Averages(*(_shown(*part, bias) for part in parts)),
        seed=seed,
        **done.columns(unit),
    )


def _one_by_one(
    ensemble: Ensemble,
    drive: Drive | Programme,
    output: Output,
    threads: Threads,
    progress: Progress,
) -> Trajectory | ProgrammeTrajectory:
    """Simulate one kind of contacts after the other, or those that are added with the
    load, and sum over them."""
    runs = list[Any]()

    def simulate(contacts: Ensemble, way: Drive | Programme, seed: int) -> None:
        before = sum(run.lives for run in runs)
        run = trajectory(
            contacts,
            way,
            points=output.points,
            seed=seed,
            replicas=output.replicas,
            threads=threads,
            max_lives=math.inf,
            progress=lambda done: progress(before + done),
        )
        runs.append(run)

    if ensemble.populations:
        way, kinds = over_distance(drive, ensemble), ensemble.kinds
        for kind in kinds:
            simulate(kind.contacts, way, kind.seed(output.seed))
        total = summed(kinds, runs, seed=output.seed)
        if isinstance(drive, Drive):
            averages = [run.averages for run in runs]
            mixed = mixed_averages(kinds, averages, drive.velocity)
            return replace(total, averages=Averages(**mixed))
    else:
        assert isinstance(drive, Programme)
        load, born = _births(ensemble, drive, output)
        simulate(ensemble, born[0].programme, output.seed)
        for number, births in enumerate(born[1:]):
            count = _added(ensemble, births)
            seed = seed_named(output.seed, _OF_LOAD, number)
            simulate(replace(ensemble, count=count), births.programme, seed)
        total = under_load(load, born, runs)
    each = total.force_replicas
    parts = each if each is not None and len(each) >= programme.LEAST_PARTS else None
    grid, count = drive.grid(output.points), ensemble.count * output.replicas
    force = total.force, total.force_stderr
    unmet = programme.unmet_forces(ensemble, drive, grid, force, count)
    forces = Forces(*force, parts, unmet=unmet)
    segments = shown_by(drive, grid, forces, total.force_reliable)
    return replace(total, segments=segments)


@lru_cache(maxsize=32)
def _expected(
    ensemble: Ensemble,
    velocity: float,
    mean_stretch: float | None,
    distance: float | None,
) -> tuple[Scatter, Scatter, tuple[tuple[float, ...], float]]:
    """Scatter of forces from the law, over a distance and in the stationary state, and
    the numbers of `independent` lives. Cached: it takes 20 ms, and seeds share it."""
    c, drag = contacts(ensemble, velocity, mean_stretch), drag_of(ensemble, velocity)
    born = scatter.births(c)
    level = scatter.scatter(c, born, None, drag)
    law = level if distance is None else scatter.scatter(c, born, distance, drag)
    return law, level, independent(c, born, drag)


def independent(
    c: Contacts, born: Births, drag: float
) -> tuple[tuple[float, ...], float]:
    """Effective number of lives per unit of displacement, of those that make up the
    scatter of each of `OBSERVABLES`; and the variance, per unit of displacement, of (f
    - F)^2 added up along it, f the force of a contact. Of n lives with residuals r =
    work + drag T - friction (l + T) these are n (E r^2)^3/max(E r+^3, E r-^3)^2: their
    inverse square root bounds the skewness of the mean of r, and half of it how far
    Student's t is off in the mean (derived)."""
    waits = np.minimum(c.delay.law.sample(), scatter.ENDLESS)
    share = np.repeat(born.share / waits.size, waits.size)
    wait = np.tile(waits, born.share.size)
    stiffness, travel, birth = (np.repeat(part, waits.size) for part in born[1:])
    work, cycle = stiffness * travel * (birth + 0.5 * travel), travel + wait
    square, length = square_of(stiffness, travel, birth), np.sum(share * cycle)
    force = np.sum(share * (work + drag * wait)) / length
    deviation = square - 2.0 * force * work + force**2 * travel
    deviation += (drag - force) ** 2 * wait
    residual = deviation - np.sum(share * deviation) / length * cycle
    noise = float(np.sum(share * residual**2) / length)

    def alike(reward: Array, per: Array) -> float:
        with np.errstate(all="ignore"):
            residual = reward - np.sum(share * reward) / np.sum(share * per) * per
            residual *= np.abs(residual) > 1e-12 * np.abs(reward)  # rounding
            cubes = share * residual**3
            rises, falls = np.sum(cubes[cubes > 0]), -np.sum(cubes[cubes < 0])
            square, cube = np.sum(share * residual**2), max(rises, falls)
            return float(1.0 / length * square**3 / cube**2) if cube > 0 else math.inf

    once = np.ones(travel.size)
    ends = (alike(stretch, once) for stretch in (birth + travel, travel, birth))
    force_and_pinned = alike(work + drag * wait, cycle), alike(travel, cycle)
    return (*force_and_pinned, *ends, alike(deviation, cycle)), noise


def _second_half(
    sums: Window, lives: int, contacts: int, drag: float
) -> tuple[Estimate, ...]:
    """Averages over the second half of the distance; unreliable if its two quarters
    differ by more than 4 sigma, or fewer contacts broke in it than there are batches.
    """
    area, pinned, elapsed, breaks, stretch, travel = sums
    seen = breaks.sum()
    enough = seen >= BATCHES and (contacts >= BATCHES or seen >= 4 * BATCHES)

    def over(numerator: Array, denominator: Array) -> Estimate:
        found = estimate.ratio(numerator.sum(1), denominator.sum(1), lives)
        exact = numerator is pinned and found.stderr == 0
        if found.stderr is not None and seen and not exact:
            # nor does a sample of lives tell what fewer than about two of them do
            unseen = 2.0 / seen * abs(estimate.known(found))
            found = replace(found, stderr=math.hypot(found.stderr, unseen))
        drifts = estimate.drifts(numerator, denominator, sigmas=4.0)
        return replace(found, reliable=found.reliable and not drifts and bool(enough))

    of_lives = (over(part, breaks) for part in (stretch, travel, stretch - travel))
    friction = over(area + drag * (elapsed - pinned), elapsed)
    return friction, over(pinned, elapsed), *of_lives


def _force_variance(
    moments: Moments,
    friction: float | None,
    level: Scatter,
    run: Run,
    contacts: int,
    noise: float,
) -> Estimate:
    """Mean over the second half of (f - friction)^2, f the force of a contact: the
    variance over contacts plus the square of what their mean is off. The variance alone
    lacks the covariance of contacts, which break together for many lives where
    thresholds are alike. The friction is off by far less than one force scatters.

    The error is from the law: `noise` gives that of the time average, and the fourth
    moment what instants that far apart may miss. Contacts in step are as few as the
    variance in time of their mean tells. Where instants find all contacts at the same
    few phases again and again, their mean is not the friction: unreliable. The square
    then misses about the same share as that of the mean, and has an error of about 1
    in `instants`^(1/2)."""
    if friction is None:
        return Estimate(None, None, contacts)
    force, _, late, lost = (part[run.points // 2 :] for part in moments)
    off, variance = force - friction, float(level.variance[0])
    square = float(np.mean(off**2))
    over_time = noise / (0.5 * run.distance)
    at_once = max(float(level.fourth[0] - variance**2), 0.0) / late.size
    apart = float(contacts)
    if square * contacts > variance > 0.0:
        apart = variance / square
    stderr = math.hypot(math.sqrt((over_time + at_once) / apart), np.mean(lost))
    seldom = max(_CHANCE / late.size, late.size**-0.5) * square
    reliable = bool(np.mean(off) ** 2 <= seldom + _ROUNDING * friction**2)
    value = float(np.mean(late)) + square
    return Estimate(value, stderr, contacts * late.size, reliable=reliable)


def _is_over(average: Estimate, expected: Array, level: float, off: float) -> bool:
    """True if the transient that the law predicts moves an average by less than half
    its error, or by the relative rounding `off`."""
    least = 0.5 * (average.stderr or 0.0) + (1e-9 + off) * abs(level)
    return bool(abs(np.mean(expected) - level) <= least)


def _shown(average: Estimate, unit: float, trusted: bool, bias: float) -> Estimate:
    """Convert an average to the user's unit, with a relative error `bias` more, and
    unreliable unless `trusted`."""
    value, stderr = average.value, average.stderr
    if bias and value is not None and stderr is not None:
        stderr = math.hypot(stderr, bias * value)
    value = None if value is None else value * unit
    stderr = None if stderr is None else stderr * unit
    reliable = average.reliable and trusted
    return replace(average, value=value, stderr=stderr, reliable=reliable)
