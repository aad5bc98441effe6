"""Force of an ensemble along a programme of segments, event driven: exact in time, also
in holds and reversals."""

import math
from dataclasses import replace
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from eqsim.engine import recorder, scatter
from eqsim.engine.blocks import Progress, Threads, Totals, simulated
from eqsim.engine.contacts import Contacts, contacts
from eqsim.engine.lanes import follow, idle_lanes
from eqsim.engine.langevin import STEP_ERROR, step_error
from eqsim.engine.readings import Forces, shown_by
from eqsim.engine.recorder import (
    Extent,
    Moments,
    Recorder,
    Run,
    Scales,
    Snapshot,
    recorded_alone,
)
from eqsim.engine.records import ProgrammeTrajectory
from eqsim.engine.sample import typical_lives
from eqsim.engine.scatter import Scatter
from eqsim.engine.segments import begin_stationary, follow_alone, waits_at_rest
from eqsim.engine.stationary import Fresh, Stationary, stationary
from eqsim.errors import InputError, require_number, under
from eqsim.laws.aging.langevin import MOST_ALPHA
from eqsim.laws.newborn import Stretched
from eqsim.model import reduced
from eqsim.model.drive import Grid, Output, Programme
from eqsim.model.ensemble import Ensemble
from eqsim.model.reduced import drag_of
from eqsim.numerics.streams import TRAJECTORY, Key
from eqsim.numerics.streams import key as key_of
from eqsim.numerics.tables import Array

# Contacts that go through all segments together: their population stays in the cache.
_HANDED_ON_TOGETHER = 8192
_MOST_PULLED = 20_000_000  # contacts with a stage: all are kept at once, 56 bytes each
# Parts of the contacts of one ensemble, whose scatter tells errors of differences of
# two forces: Student's law of 7 is 1.09 times as wide as the normal one in 68 %.
LEAST_PARTS, _MOST_PARTS = 8, 64
_MOST_PARTED = 2_000_000  # forces of all parts
# segments of all parts: each takes as long as those of a few thousand contacts
_MOST_PARTED_SEGMENTS = 2000
_MOST_LEVELS = 5  # velocities whose steady states say how forces scatter


def check_programme(ensemble: Ensemble, programme: Programme) -> None:
    """Raise InputError for contacts that do not follow a programme."""
    born, rule, pulled = ensemble.newborn, ensemble.aging.rule, programme.pulled
    puller = "elastic.damping" if programme.chain else "drive.stage"
    lengths = born.active and born.of == "length"
    refused = (
        (
            ensemble.self_consistent,
            "drive.programme: annealed contacts cannot age along it: their clock, the "
            "mean pinned time C/v, is that of a steady state; take "
            'disorder = "quenched" or aging.rule = "none"',
        ),
        (
            ensemble.disorder == "annealed"
            and lengths
            and born.reduced(1.0).range[0] < 0,
            f'newborn.law = "{born.law}": the published master equation knows no '
            "mechanical breaking of contacts stretched against the motion, which a "
            'programme may reverse; take disorder = "quenched"',
        ),
        (
            pulled and ensemble.count > _MOST_PULLED,
            f"contacts.count = {ensemble.count}: must be <= {_MOST_PULLED:g} with "
            "drive.stage, a force or a motor",
        ),
        (
            pulled and ensemble.fluctuates,
            f'{puller}: thresholds of rule "{rule}" are followed where the motion '
            'is given; take rule = "flow"',
        ),
        (
            programme.rebinding == "shared" and ensemble.delay.time == 0.0,
            'drive.rebinding = "shared": needs a delay.time > 0',
        ),
        (
            programme.start == "stationary" and ensemble.fluctuates,
            f'drive.start = "stationary": thresholds of rule "{rule}" follow a '
            "programme from a fresh start only; begin with a segment that slides until "
            "it is steady",
        ),
    )
    for wrong, said in refused:
        if wrong:
            raise InputError(said)
    for index, segment in enumerate(programme.segments if ensemble.fluctuates else ()):
        if segment.velocity == 0:
            relaxations = 4.0 * ensemble.aging.rate * segment.duration
            relaxations /= ensemble.aging.x_star_final**2
            name = "4 rate hold / x_star_final^2"
            with under(f"drive.programme.{index}"):
                require_number(name, relaxations, least=0, most=MOST_ALPHA)


class Step(NamedTuple):
    """A segment of a programme, for kernels."""

    contacts: Contacts
    run: Run
    scales: Scales
    drag: float
    row: int  # number of the first deposit of this segment


class Steps(NamedTuple):
    """A `blocks.Job` along one segment after another; a constant drive is one."""

    steps: tuple[Step, ...]
    start: Fresh | Stationary
    key: Key  # of random numbers
    before: Contacts | None = None  # of a stationary start of a programme

    @property
    def replica_scales(self) -> tuple[float, float]:
        scales = [step.scales for step in self.steps]
        return min(s.replica for s in scales), min(s.replica_square for s in scales)

    def totals(self, replicas: int) -> Totals:
        last = self.steps[-1]
        rows = last.row + last.run.points + 1
        return Totals(rows, rows - 2 * len(self.steps) + 1, replicas)

    def simulate(self, total: Totals, first: int, last: int) -> None:
        single, held = len(self.steps) == 1, self.steps[0].run.moves == 0
        handed_on = not single or self.before is not None or held
        together = _HANDED_ON_TOGETHER if handed_on else max(last - first, 1)
        # At least once: a call without contacts compiles the kernels.
        for begin in range(first, max(last, first + 1), together):
            end = min(begin + together, last)
            start: Any = self.start
            if handed_on:
                start = Snapshot.fresh(begin, end - begin)
            if self.before is not None:
                begin_stationary(self.before, self.start, self.key, start)
            for c, run, scales, _, row in self.steps:
                record = Recorder.of(c, run, scales, start, total, row)
                alone = recorded_alone(c, run)
                kernel = follow_alone if alone else follow
                arguments: tuple[Any, ...] = record, self.key, begin, end
                if not alone:
                    arguments = c, record, begin, end, *idle_lanes(c, self.key)
                if row not in total.code:
                    total.code[row] = kernel.compiled_for(*arguments)
                total.code[row](*arguments)
                if total.stop[0]:
                    return

    def moments(self, deposits: Array, contacts: int) -> Moments:
        parts = []
        for _, run, scales, drag, row in self.steps:
            found = recorder.moments(deposits[row:], scales, run, contacts, drag)
            # A segment begins where another has ended.
            force, *others = (x[1 if row else 0 :] for x in found)
            parts.append((run.sign * force, *others))
        return Moments(*map(np.concatenate, zip(*parts, strict=True)))

    def force(self, deposits: Array, contacts: int) -> Array:
        parts = []
        for _, run, scales, drag, row in self.steps:
            force = recorder.mean_force(deposits[row:], scales, run, contacts, drag)
            parts.append(run.sign * force[1 if row else 0 :])
        return np.concatenate(parts)


def constant_drive(
    c: Contacts,
    start: Fresh | Stationary,
    run: Run,
    scales: Scales,
    key: Key,
    drag: float,
) -> Steps:
    """Make the job of a drive at constant velocity: a programme of one segment."""
    return Steps((Step(c, run, scales, drag, 0),), start, key)


def steps_of(
    ensemble: Ensemble, programme: Programme, grid: Grid, replicas: int, seed: int
) -> Steps:
    """Make the job of a programme that is recorded at the instants of `grid`."""
    unit, count = ensemble.thresholds.scale, ensemble.count * replicas
    legs = reduced.legs(ensemble, programme)
    before, pace = None, legs[0].pace
    carried = usual = elapsed = 0.0
    if programme.start == "stationary" and programme.velocity:
        pace = programme.velocity
        before = contacts(ensemble, pace)
        known = Extent.of(before)
        carried, usual = known.stretch, known.typical_force
        elapsed = carried / pace  # the longest that contacts may have been pinned
    extents: dict[float, Extent] = {}  # by pace: recorded drives have many segments
    steps: list[Step] = []
    row = 0
    for index, leg in enumerate(legs):
        c = contacts(ensemble, leg.pace)
        here = np.flatnonzero(grid.segment == index)
        begin = grid.t[here[0] - 1] if index else 0.0
        here = here[0 if index else 1 :]
        hold = np.append(0.0, (grid.t[here] - begin) * (leg.pace / unit))
        # From a fresh start no stretch is beyond what has been slid.
        first = before is None and index == 0 and leg.sign != 0
        goes_on = bool(before) and index == 0 and (leg.pace, leg.sign) == (pace, 1)
        run = Run(
            leg.length,
            here.size + 1,
            stationary=not first,
            averages=False,
            moves=abs(leg.sign),
            sign=float(leg.sign or 1),
            ratio=leg.pace / pace,
            goes_on=goes_on,
            last=index + 1 == len(legs),
            instants=hold if leg.sign == 0 else np.empty(0),
        )
        if isinstance(c.newborn, Stretched):
            c = c._replace(newborn=c.newborn._replace(sign=run.sign))
        drag = drag_of(ensemble, leg.pace) * abs(leg.sign)
        elapsed += leg.length / leg.pace
        grown = float(c.aging.growth_at(np.array(elapsed * leg.pace))) if index else 1.0
        if leg.pace not in extents:
            extents[leg.pace] = Extent.of(c)
        extent = extents[leg.pace]
        if leg.sign and index:
            carried = max(carried, extent.stretch * max(grown, 1.0))
        # In a slow segment newborn contacts may carry next to nothing.
        usual = max(usual, extent.typical_force)
        scales = Scales.within(extent, run, count, replicas, drag, carried, usual)
        if leg.sign and not index:
            reach = min(extent.stretch, run.distance) if first else extent.stretch
            carried = max(carried, reach)
        steps.append(Step(c, run, scales, drag, row))
        row += run.points + 1  # the last of which is beyond the grid
        pace = leg.pace
    start = stationary(before) if before else Fresh()
    return Steps(tuple(steps), start, key_of(seed, TRAJECTORY), before)


# It takes as long as the run of a few contacts, whose next seed asks for it again.
@lru_cache(maxsize=32)
def cycles(ensemble: Ensemble, programme: Programme) -> tuple[float, ...]:
    """Predict about how many lives of a contact begin in each segment."""
    found = []
    for leg in reduced.legs(ensemble, programme):
        c = contacts(ensemble, leg.pace)
        stretch = typical_lives(c).travel if leg.sign else waits_at_rest(c, leg.length)
        mean = float(np.mean(np.minimum(stretch + c.delay.mean, leg.length)))
        found.append(1.0 + leg.length / mean if mean > 0 else math.inf)
    return tuple(found)


def along(
    ensemble: Ensemble,
    programme: Programme,
    output: Output,
    threads: Threads,
    progress: Progress | None,
) -> ProgrammeTrajectory:
    """Simulate `trajectory.trajectory` of a programme."""
    grid, unit = programme.grid(output.points), ensemble.thresholds.scale
    count, delayed = ensemble.count * output.replicas, ensemble.delay.time > 0
    segments = len(programme.segments)
    parts = _parts_of(count, grid.t.size, segments) if output.replicas == 1 else 1
    part, ensembles = replace(ensemble, count=count // parts), output.replicas * parts
    if parts == 1:
        part = ensemble
    job = steps_of(part, programme, grid, ensembles, output.seed)
    done = simulated(job, part.count, ensembles, threads, progress)
    found, columns = done.moments, done.columns(unit)
    each = columns["force_replicas"]
    if parts > 1:
        columns |= {"force_replicas": None, "force_replica_std": None}
    variance, reliable = _variance(ensemble, programme, grid, found, count)
    bias = step_bias(job.steps)
    variance = variance + (bias * found.force) ** 2
    of_pinned = scatter.pinned_variance(found.pinned, count, delayed)
    of_pinned += (bias * found.pinned * (1.0 - found.pinned)) ** 2
    rounding = 1e-15 * max(step.run.distance for step in job.steps)
    force, stderr = found.force * unit, np.sqrt(variance + rounding**2) * unit
    pinned_stderr = np.sqrt(of_pinned)
    if programme.start == "fresh":  # all contacts are pinned, and alike
        pinned_stderr[0] = 0.0
        stderr[0] *= ensemble.newborn.active
    told = each if each is not None and len(each) >= LEAST_PARTS else None
    unmet = unmet_forces(ensemble, programme, grid, (force, stderr), count)
    forces = Forces(force, stderr, told, np.abs(bias * force), unmet)
    return ProgrammeTrajectory(
        X=grid.X,
        t=grid.t,
        force_stderr=stderr,
        force_reliable=reliable,
        pinned_stderr=pinned_stderr,
        seed=output.seed,
        segment=grid.segment,
        segments=shown_by(programme, grid, forces, reliable),
        **columns,
    )


def _parts_of(count: int, points: int, segments: int) -> int:
    """Number of equal parts into which contacts are divided; 1 if there is none that
    tells a scatter, or their forces were too many."""
    quick = max(LEAST_PARTS, _MOST_PARTED_SEGMENTS // segments)
    fit = range(LEAST_PARTS, min(_MOST_PARTS, _MOST_PARTED // points, quick) + 1)
    return max((parts for parts in fit if count % parts == 0), default=1)


def unmet_forces(
    ensemble: Ensemble,
    programme: Programme,
    grid: Grid,
    force: tuple[Array, Array],
    count: int,
) -> Array:
    """How much one more break changes the mean `force` of `count` contacts at each
    instant of a grid, given with its standard error; 0 in holds in which none breaks."""
    mean, stderr = force
    moves = [s.velocity != 0 or ensemble.changes_at_rest for s in programme.segments]
    return scatter.unmet_force(stderr**2, mean, count) * np.array(moves)[grid.segment]


def step_bias(steps: tuple[Step, ...]) -> float:
    """Relative error of steps of fluctuating thresholds where it exceeds the usual."""
    if not steps[0].contacts.aging.fluctuates:
        return 0.0
    pieces = ((step.contacts.aging, step.run) for step in steps)
    times = ((law, None if run.moves else run.length) for law, run in pieces)
    error = max(step_error(law, time=time) for law, time in times)
    return error if error > STEP_ERROR else 0.0


def _variance(
    ensemble: Ensemble, programme: Programme, grid: Grid, found: Moments, count: int
) -> tuple[Array, bool]:
    """Variance of the mean force, in units of the thresholds' scale, from that of the
    sample. The shape of its scatter (kurtosis, ...) is taken from the law in steady
    sliding, at the worst of a few velocities from the slowest to the fastest. Also
    returns whether five standard errors are unlikely to be exceeded."""
    paces = {leg.pace for leg in reduced.legs(ensemble, programme) if leg.sign}
    every = sorted(paces | {programme.velocity or 0.0} - {0.0})
    seen = found.variance + found.lost
    if not every:  # nothing moves, and nothing has
        return seen / count, True
    steps = (len(every) - 1) / (_MOST_LEVELS - 1)
    chosen = {every[round(i * steps)] for i in range(_MOST_LEVELS)}
    single, unit = replace(ensemble, count=1), ensemble.thresholds.scale
    reach = np.maximum.accumulate(np.abs(grid.X)) / unit
    if programme.start == "stationary":
        reach[:] = math.inf
    sample = seen * count / (count - 1) if count > 1 else seen
    variance, rare = np.zeros_like(found.force), 0.0
    for level in (_steady_scatter(single, pace) for pace in sorted(chosen)):
        with np.errstate(all="ignore"):
            law = level._replace(
                X=grid.X,
                mean=found.force,
                pinned=found.pinned,
                variance=sample,
                fourth=level.fourth / level.variance**2 * sample**2,
                sixth=level.sixth / level.variance**3 * sample**3,
                most=reach**2,
                lives=float(count),
            )
        here, unlikely = scatter.known_variance(law, level, seen, count)
        _, always = scatter.known_variance(level, level, level.variance, count)
        variance = np.maximum(variance, here)
        rare = max(rare, min(float(np.mean(unlikely)), float(always[0])))
    return variance, bool(rare < scatter.RARE)


@lru_cache(maxsize=64)
def _steady_scatter(ensemble: Ensemble, pace: float) -> Scatter:
    """Scatter of forces in steady sliding. Cached: takes 20 ms, and seeds share it."""
    c = contacts(ensemble, pace)
    return scatter.scatter(c, scatter.births(c), None, drag_of(ensemble, pace))
