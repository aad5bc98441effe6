"""Force of an ensemble along a programme of segments, event driven: exact in time, also
in holds and reversals."""

import math
from dataclasses import replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from eqsim.engine.blocks import Progress, Threads, Totals, simulated
from eqsim.engine.contacts import Contacts, contacts
from eqsim.engine.follow import follow
from eqsim.engine.lanes import idle_lanes
from eqsim.engine.langevin import STEP_ERROR, step_error
from eqsim.engine.recorder import (
    Extent,
    Moments,
    Run,
    Scales,
    moments,
    recorded_alone,
    recorder_for,
)
from eqsim.engine.records import ProgrammeTrajectory, shown_by
from eqsim.engine.sample import typical_lives
from eqsim.engine.scatter import (
    RARE,
    Scatter,
    births,
    known_variance,
    pinned_variance,
    scatter,
)
from eqsim.engine.segments import Population, begin_stationary, waits_at_rest
from eqsim.engine.stationary import Fresh, Stationary, stationary
from eqsim.errors import InputError, require_number, under
from eqsim.laws.aging.langevin import MOST_ALPHA
from eqsim.laws.newborn import Stretched
from eqsim.model import reduced
from eqsim.model.drive import Grid, Programme
from eqsim.model.ensemble import Ensemble
from eqsim.model.reduced import drag_of
from eqsim.numerics.streams import TRAJECTORY, Key, key
from eqsim.numerics.tables import Array

_TOGETHER = 8192  # contacts that go through all segments together: their population stays in the cache
# contacts with a stage, all of which are kept at once, 120 bytes each
_MOST_PULLED = 20_000_000
_LEVELS = 5  # velocities, at most, whose steady states say how forces scatter


def check_programme(ensemble: Ensemble, programme: Programme) -> None:
    """Raise InputError for contacts that do not follow a programme."""
    if ensemble.self_consistent:
        raise InputError(
            "drive.programme: annealed contacts cannot age along it: their clock, the mean pinned time C/v, is that of "
            'a steady state; take disorder = "quenched" or aging.rule = "none"'
        )
    births = ensemble.newborn
    if (
        ensemble.disorder == "annealed"
        and births.active
        and births.of == "length"
        and births.reduced(1.0).range[0] < 0
    ):
        raise InputError(
            f'newborn.law = "{births.law}": the published master equation knows no mechanical breaking of '
            'contacts stretched against the motion, which a programme may reverse; take disorder = "quenched"'
        )
    if programme.stage and ensemble.count > _MOST_PULLED:
        raise InputError(
            f"contacts.count = {ensemble.count}: must be <= {_MOST_PULLED:g} with drive.stage"
        )
    if ensemble.fluctuates and programme.stage:
        raise InputError(
            f'drive.stage: thresholds of rule "{ensemble.aging.rule}" are followed where the motion is given; take '
            'rule = "flow"'
        )
    if ensemble.fluctuates and programme.start == "stationary":
        raise InputError(
            f'drive.start = "stationary": thresholds of rule "{ensemble.aging.rule}" follow a programme from a fresh '
            "start only; begin with a segment that slides until it is steady"
        )
    for index, segment in enumerate(programme.segments if ensemble.fluctuates else ()):
        if segment.velocity == 0:
            relaxations = (
                4.0
                * ensemble.aging.rate
                * segment.duration
                / ensemble.aging.x_star_final**2
            )
            with under(f"drive.programme.{index}"):
                require_number(
                    "4 rate hold / x_star_final^2",
                    relaxations,
                    least=0,
                    most=MOST_ALPHA,
                )


class Step(NamedTuple):
    """A segment: its contacts, and where what they leave is recorded, from row `row` of
    all deposits on."""

    contacts: Contacts
    run: Run
    scales: Scales
    drag: float
    row: int


class Steps(NamedTuple):
    """A `blocks.Job` along one segment after another, a drive at constant velocity
    being one of them.

    Attributes
    ----------
    steps : tuple of Step
    start : Fresh or Stationary
    stream : Key
        Of random numbers.
    before : Contacts or None
        Those of a stationary start of a programme.
    """

    steps: tuple[Step, ...]
    start: Fresh | Stationary
    stream: Key
    before: Contacts | None = None

    @property
    def replica_scales(self) -> tuple[float, float]:
        return (
            min(step.scales.replica for step in self.steps),
            min(step.scales.replica_square for step in self.steps),
        )

    def totals(self, replicas: int) -> Totals:
        last = self.steps[-1]
        rows = last.row + last.run.points + 1
        return Totals(rows, rows - 2 * len(self.steps) + 1, replicas)

    def simulate(self, total: Totals, first: int, last: int) -> None:
        handed_on = (
            len(self.steps) > 1
            or self.before is not None
            or self.steps[0].run.moves == 0
        )
        kind = recorder_for(
            recorded_alone(step.contacts, step.run) for step in self.steps
        )
        together = _TOGETHER if handed_on else max(last - first, 1)
        for begin in range(
            first, max(last, first + 1), together
        ):  # none at all compile kernels
            end, start = (
                min(begin + together, last),
                self._start(begin, min(together, last - begin), handed_on),
            )
            for step in self.steps:
                recorder = kind.of(
                    step.contacts, step.run, step.scales, start, total, step.row
                )
                follow(
                    step.contacts,
                    recorder,
                    self.stream,
                    begin,
                    end,
                    *idle_lanes(step.contacts, self.stream),
                )
                if total.stop[0]:
                    return

    def _start(
        self, first: int, contacts: int, handed_on: bool
    ) -> Fresh | Stationary | Population:
        """How contacts come in, if they are `handed_on` from one segment to another or
        not."""
        if not handed_on:
            return self.start
        population = Population.fresh(first, contacts)
        if self.before is not None:
            begin_stationary(self.before, self.start, self.stream, population)
        return population

    def moments(self, deposits: Array, contacts: int) -> Moments:
        parts = []
        for step in self.steps:
            found = moments(
                deposits[step.row :], step.scales, step.run, contacts, step.drag
            )
            later = slice(
                1 if step.row else 0, None
            )  # a segment begins where another has ended
            parts.append(
                Moments(
                    step.run.sign * found.force[later],
                    found.pinned[later],
                    found.variance[later],
                )
            )
        return Moments(*(np.concatenate(part) for part in zip(*parts, strict=True)))


def constant_drive(
    c: Contacts,
    start: Fresh | Stationary,
    run: Run,
    scales: Scales,
    stream: Key,
    drag: float,
) -> Steps:
    """The job of a drive at constant velocity: a programme of one segment."""
    return Steps((Step(c, run, scales, drag, 0),), start, stream)


def steps_of(
    ensemble: Ensemble, programme: Programme, grid: Grid, replicas: int, seed: int
) -> Steps:
    """The job of a programme whose forces are recorded at the instants of `grid`."""
    unit, count = ensemble.thresholds.scale, ensemble.count * replicas
    legs = reduced.legs(ensemble, programme)
    before = (
        contacts(ensemble, programme.velocity)
        if programme.start == "stationary" and programme.velocity
        else None
    )
    pace = programme.velocity if before and programme.velocity else legs[0].pace
    known = Extent.of(before) if before else None
    carried, usual = (known.stretch, known.typical_force) if known else (0.0, 0.0)
    elapsed = (
        carried / pace if before else 0.0
    )  # the longest that contacts may have been pinned
    extents: dict[
        float, Extent
    ] = {}  # by pace: recorded drives have thousands of segments
    steps: list[Step] = []
    row = 0
    for index, leg in enumerate(legs):
        c = contacts(ensemble, leg.pace)
        here = np.flatnonzero(grid.segment == index)
        begin = grid.t[here[0] - 1] if index else 0.0
        here = here[0 if index else 1 :]
        times = (
            np.append(0.0, (grid.t[here] - begin) * (leg.pace / unit))
            if leg.sign == 0
            else np.empty(0)
        )
        first = (
            before is None and index == 0 and leg.sign != 0
        )  # no stretch is beyond what has been slid
        goes_on = (
            before is not None and index == 0 and (leg.pace, leg.sign) == (pace, 1)
        )
        run = Run(
            leg.length, here.size + 1, not first, averages=False, moves=abs(leg.sign), sign=float(leg.sign or 1),
            ratio=leg.pace / pace, goes_on=goes_on, last=index + 1 == len(legs), instants=times,
        )  # fmt: skip
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
        usual = max(
            usual, extent.typical_force
        )  # in a slow segment newborn contacts may carry next to nothing
        scales = Scales.within(extent, run, count, replicas, drag, carried, usual)
        if leg.sign and not index:
            carried = max(
                carried, min(extent.stretch, run.distance) if first else extent.stretch
            )
        steps.append(Step(c, run, scales, drag, row))
        row += run.points + 1  # the last of which is beyond the grid
        pace = leg.pace
    return Steps(
        tuple(steps),
        stationary(before) if before else Fresh(),
        key(seed, TRAJECTORY),
        before,
    )


def cycles(ensemble: Ensemble, programme: Programme) -> list[float]:
    """About how many lives of a contact begin in each segment."""
    found = []
    for leg in reduced.legs(ensemble, programme):
        c = contacts(ensemble, leg.pace)
        stretch = typical_lives(c).travel if leg.sign else waits_at_rest(c, leg.length)
        mean = float(np.mean(np.minimum(stretch + c.delay.mean, leg.length)))
        found.append(1.0 + leg.length / mean if mean > 0 else math.inf)
    return found


def along(
    ensemble: Ensemble,
    programme: Programme,
    points: int,
    seed: int,
    replicas: int,
    threads: Threads,
    progress: Progress | None,
) -> ProgrammeTrajectory:
    """`trajectory.trajectory` of a programme."""
    grid, unit, count = (
        programme.grid(points),
        ensemble.thresholds.scale,
        ensemble.count * replicas,
    )
    job = steps_of(ensemble, programme, grid, replicas, seed)
    done = simulated(job, ensemble.count, replicas, threads, progress)
    found = done.moments
    variance, reliable = _variance(ensemble, programme, grid, found, count)
    bias = step_bias(job.steps)
    variance = variance + (bias * found.force) ** 2
    of_pinned = pinned_variance(found.pinned, count, ensemble.delay.time > 0)
    of_pinned += (bias * found.pinned * (1.0 - found.pinned)) ** 2
    rounding = 1e-15 * max(step.run.distance for step in job.steps)
    force, stderr = found.force * unit, np.sqrt(variance + rounding**2) * unit
    pinned_stderr = np.sqrt(of_pinned)
    if programme.start == "fresh":  # all contacts are pinned, and alike
        pinned_stderr[0] = 0.0
        stderr[0] *= ensemble.newborn.active
    return ProgrammeTrajectory(
        X=grid.X,
        t=grid.t,
        force_stderr=stderr,
        force_reliable=reliable,
        pinned_stderr=pinned_stderr,
        seed=seed,
        segment=grid.segment,
        segments=shown_by(programme, grid, force, stderr, reliable),
        **done.columns(unit),
    )


def step_bias(steps: tuple[Step, ...]) -> float:
    """What steps of fluctuating thresholds cost, relative, where that is more than
    usual, as at constant velocity."""
    if not steps[0].contacts.aging.fluctuates:
        return 0.0
    times = (
        (step.contacts.aging, 1.0 if step.run.moves else step.run.length)
        for step in steps
    )
    return max(step_error(law, time=time) for law, time in times) - STEP_ERROR


def _variance(
    ensemble: Ensemble, programme: Programme, grid: Grid, found: Moments, count: int
) -> tuple[Array, bool]:
    """Variance of the mean force in units of the thresholds' scale, and whether five
    standard errors mean what they say: that of the sample, whose scatter is taken to
    have the shape (kurtosis, ...) that the law has in steady sliding at the velocity
    where it is worst, of some from the slowest to the fastest."""
    paces = {leg.pace for leg in reduced.legs(ensemble, programme) if leg.sign}
    every = sorted(paces | {programme.velocity or 0.0} - {0.0})
    if not every:  # nothing moves, and nothing has
        return found.variance / count, True
    some = {every[round(i * (len(every) - 1) / (_LEVELS - 1))] for i in range(_LEVELS)}
    levels = [_level(replace(ensemble, count=1), pace) for pace in sorted(some)]
    unit = ensemble.thresholds.scale
    reach = (
        math.inf
        if programme.start == "stationary"
        else np.maximum.accumulate(np.abs(grid.X)) / unit
    )
    variance, rare = np.zeros_like(found.force), 0.0
    own = found.variance * count / (count - 1) if count > 1 else found.variance
    for level in levels:
        with np.errstate(all="ignore"):
            fourth, sixth = (
                level.fourth / level.variance**2,
                level.sixth / level.variance**3,
            )
            law = level._replace(
                X=grid.X, mean=found.force, pinned=found.pinned, variance=own, fourth=fourth * own**2,
                sixth=sixth * own**3, most=reach**2 * np.ones_like(own), lives=float(count),
            )  # fmt: skip
        here, unlikely = known_variance(law, level, found.variance, count)
        _, always = known_variance(level, level, level.variance, count)
        variance, rare = (
            np.maximum(variance, here),
            max(rare, min(float(np.mean(unlikely)), float(always[0]))),
        )
    return variance, bool(rare < RARE)


@lru_cache(maxsize=64)
def _level(ensemble: Ensemble, pace: float) -> Scatter:
    """What the law says of the steady state at a velocity. Remembered: it takes 20 ms,
    and seeds share it."""
    c = contacts(ensemble, pace)
    return scatter(c, births(c), None, drag_of(ensemble, pace))
