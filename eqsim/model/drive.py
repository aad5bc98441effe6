"""Drives of the slider, and the recording of a run."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np

from eqsim.errors import (
    POSITIVE,
    Checked,
    InputError,
    Limits,
    NotNegative,
    Positive,
    require_number,
    shown,
    under,
)
from eqsim.model.chain import Chain
from eqsim.model.elastic import Elastic
from eqsim.model.ensemble import Ensemble
from eqsim.numerics.tables import Array

Start = Literal["fresh", "stationary"]
Points = Annotated[int, Limits(1, 2 * 10**7)]
Load = Annotated[float, Limits(above=0.0, most=1e3)]
MOST_SERIES = 20_000_000  # forces of replicas that are kept one by one
_FIRST_LOOK = 1e-5  # at a hold, of its time; then at equal ratios
QUASISTATIC = (
    "coupled blocks are simulated by `elastic_trajectory` and `eqsim run` alone; "
    "this needs a rigid slider"
)


@dataclass(frozen=True)
class Drive(Checked):
    """Constant velocity of a rigid slider, or of a plate that pulls coupled blocks.

    The blocks are declared here; a stage in `Programme(stage=...)`.

    Raises InputError for a value out of range.

    Parameters
    ----------
    velocity : float
        v (length/time), > 0.
    distance : float, optional
        How far (length); by default 200 mean newborn thresholds.
    start : str
        "fresh": all contacts pinned and unstretched at X = 0. "stationary": the steady
        state.
    elastic : Elastic, optional
        The blocks that a plate pulls so far and so fast (`elastic_trajectory`); else
        the slider is rigid.

    Examples
    --------
    >>> Drive(velocity=0.1, distance=5.0, start="stationary").distance
    5.0
    """

    velocity: Positive
    distance: Positive | None = None
    start: Start = "fresh"
    elastic: Elastic | None = None

    def __post_init__(self) -> None:
        if isinstance(self.velocity, (np.ndarray, list, tuple)):
            many = "eqsim.curve(ensemble, velocities) is exact at many"
            said = f"must be one number; {many}, eqsim.sweep simulates them"
            raise InputError(f"velocity = {shown(self.velocity)}: {said}")
        super().__post_init__()
        require_blocks(self.elastic)

    def over(self, ensemble: Ensemble) -> float:
        """The distance, with its default filled in."""
        return default_distance(ensemble) if self.distance is None else self.distance


def default_distance(ensemble: Ensemble) -> float:
    """200 mean newborn thresholds, of populations the largest."""
    return 200.0 * max(kind.contacts.thresholds.mean for kind in ensemble.kinds)


def over_distance(drive: Any, ensemble: Ensemble) -> Any:
    """A drive or programme with its distance, the same for all kinds of contacts."""
    way = drive.over(ensemble) if isinstance(drive, Drive) else None
    return replace(drive, distance=way) if way else drive


@dataclass(frozen=True)
class Segment(Checked):
    """A piece of a programme at constant velocity, for a `distance` or a `time`; or
    under a force that is constant or changes in proportion to time, for a `time`.

    Raises InputError for a value out of range, unless either a distance or a time is
    given, and for a force with a velocity or a distance.

    Parameters
    ----------
    velocity : float
        v (length/time); 0 is a hold, a negative one a reversal.
    distance : float, optional
        Length of the path (length), > 0 whatever the direction; not of a hold.
    time : float, optional
        How long (time).
    points : int, optional
        At how many instants after its beginning the force is recorded, by default a
        fair share of all.
    force : float, optional
        Pull on the slider at the beginning, over N k as friction is (length); by
        default that at the end of the segment before, and 0 at first.
    force_rate : float, optional
        Change of the force (length/time), 0 by default.
    load : float, optional
        Normal load at the beginning, over that at the start of the programme, > 0; by
        default that at the end of the segment before, and 1 at first.
    load_rate : float, optional
        Change of the load (1/time), 0 by default.

    Examples
    --------
    >>> Segment(-0.5, distance=2.0).duration  # 2 back at velocity 0.5
    4.0
    >>> Segment(force=0.5, time=10.0).forced  # creep
    True
    """

    velocity: float = 0.0
    distance: Positive | None = None
    time: Positive | None = None
    points: Points | None = None
    force: float | None = None
    force_rate: float | None = None
    load: Load | None = None
    load_rate: float | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.forced and (self.velocity != 0 or self.distance is not None):
            name = "force_rate" if self.force is None else "force"
            said = "not with a velocity or distance; a segment under a force has a time"
            raise InputError(f"{name} = {getattr(self, name)!r}: {said}")
        if self.velocity != 0:
            require_number("|velocity|", abs(self.velocity), **POSITIVE)
        if (self.distance is None) == (self.time is None):
            raise InputError("distance: a segment has either a distance or a time")
        if self.distance is not None and self.velocity == 0:
            said = "must not be 0 with a distance; a hold has a time"
            raise InputError(f"velocity = 0.0: {said}")

    @property
    def forced(self) -> bool:
        """True if a force pulls the slider."""
        return self.force is not None or self.force_rate is not None

    @property
    def duration(self) -> float:
        """Duration (time)."""
        if self.distance is None:
            return self.time or 0.0
        return self.distance / abs(self.velocity)

    @property
    def path(self) -> float:
        """Length of the path (length), whatever the direction."""
        if self.distance is None:
            return abs(self.velocity) * (self.time or 0.0)
        return self.distance


@dataclass(frozen=True)
class Stage(Checked):
    """A stage that follows a programme and pulls the slider through a spring:

        m X'' + eta_s X' = kappa_s (Y - X) - F,

    all per N k, with Y the position of the stage and of the spring's end, and F =
    <F>/(N k) (derived).

    Raises InputError for a value out of range.

    Parameters
    ----------
    stiffness : float
        kappa_s = K/(N k), > 0.
    damping : float
        eta_s/(N k) (time).
    mass : float
        m/(N k) (time squared).
    preload : float, optional
        Stretch of the spring at t = 0 (length); by default none of a fresh start, and
        of a stationary one that which balances friction.
    tolerance : float
        By how much the force may miss its course between two steps (in units of the
        mean threshold).

    Examples
    --------
    >>> Programme([Segment(0.1, distance=5.0)], stage=Stage(0.1)).stage.stiffness
    0.1
    """

    stiffness: Positive
    damping: NotNegative = 0.0
    mass: NotNegative = 0.0
    preload: float | None = None
    tolerance: Annotated[float, Limits(1e-8, 1e-2)] = 1e-4


class Grid(NamedTuple):
    """Times and displacements at which the force is recorded, and the segment that ends
    there or is under way, arrays (points,); the instant 0 belongs to segment 0."""

    t: Array
    X: Array
    segment: Array


@dataclass(frozen=True)
class Programme(Checked):
    """A drive in segments, each at constant velocity: steps, holds, reversals. Or each
    under a force: creep, ramps.

    Raises InputError for an empty programme, a stationary start without a velocity,
    velocities beside forces, and forces with a stage, a motor or a stationary start.

    Parameters
    ----------
    segments : sequence of Segment
        One after the other, from X = 0.
    start : str
        "fresh": all contacts pinned and unstretched. "stationary": the steady state at
        `velocity`.
    velocity : float, optional
        Of that steady state (length/time), > 0.
    stage : Stage, optional
        The programme is that of a stage that pulls the slider through a spring; else of
        the slider itself.
    chain : Chain, optional
        The programme is that of what pulls a chain of blocks.
    elastic : Elastic, optional
        The programme is that of the plate that pulls coupled blocks quasi-statically,
        forwards (`elastic_trajectory`).
    stall_force : float
        Force s over N k (length), > 0, at which a motor stops that drives the slider,
        or the stage's end of the spring, where its load is F:

            Y' = u - abs(u) F/s,

        with u the velocity of the segment. By default it never stops.
    rebinding : str
        How a contact forms again under a force: "unstretched", as elsewhere, or
        "shared", with the displacement of the slider as its stretch, so that all
        contacts share the force equally, as in clusters of adhesion bonds (Erdmann and
        Schwarz, 2004).

    Examples
    --------
    >>> drive = Programme([Segment(0.1, distance=5.0), Segment(time=100.0)])  # and a hold
    >>> drive.grid(points=5).X.tolist()
    [0.0, 2.5, 5.0, 5.0, 5.0]
    """

    segments: Sequence[Segment]
    start: Start = "fresh"
    velocity: Positive | None = None
    stage: Stage | None = None
    stall_force: Positive = math.inf
    rebinding: Literal["unstretched", "shared"] = "unstretched"
    chain: Chain | None = None
    elastic: Elastic | None = None

    def __post_init__(self) -> None:
        if not isinstance(self.segments, Iterable):
            said = "must be a list of Segment(velocity, distance=... or time=...)"
            raise InputError(f"programme = {shown(self.segments)}: {said}")
        object.__setattr__(self, "segments", tuple(self.segments))
        if not self.segments:
            raise InputError("programme = []: must have at least one segment")
        for segment in self.segments:
            if not isinstance(segment, Segment):
                said = "must be Segment(velocity, distance=... or time=...)"
                raise InputError(f"programme: holds {shown(segment)}; {said}")
        super().__post_init__()
        if self.velocity is None and self.start == "stationary":
            raise InputError('velocity: is required with start = "stationary"')
        if any(segment.forced for segment in self.segments):
            self._require_forces()
        elif self.rebinding == "shared":
            raise InputError('rebinding = "shared": needs a force')
        self._require_loads()
        if self.chain is not None and (self.stage is not None or self.motor):
            said = "not with a stage or a motor; its programme is that of what pulls it"
            raise InputError(f"chain: {said}")
        if self.elastic is not None:
            require_blocks(self.elastic)
            self._require_forwards()
        with under("programme"):
            duration = sum(segment.duration for segment in self.segments)
            require_number("time", duration, **POSITIVE)

    def _require_forces(self) -> None:
        """Raise InputError unless every segment has a force, and nothing else pulls."""
        if not self.forced:
            said = "a segment has a force, not beside segments with a velocity or hold"
            raise InputError(f"programme: {said}; a programme has one kind")
        pulls = "with a force, which pulls the slider itself"
        others = {"stage": self.stage, "chain": self.chain, "stall_force": self.motor}
        for name in (name for name, other in others.items() if other):
            raise InputError(f"{name}: not allowed {pulls}")
        if self.start != "fresh":
            raise InputError(f'start: must be "fresh" {pulls}')

    def _require_forwards(self) -> None:
        """Raise InputError unless a plate alone pulls blocks, forwards."""
        if self.pulled_alone or self.loaded:
            said = "not with a stage, a chain, a motor, a force or a load that changes"
            raise InputError(f"elastic: {said}")
        for index, segment in enumerate(self.segments):
            if segment.velocity < 0:
                given = f"programme.{index}.velocity = {segment.velocity!r}"
                raise InputError(f"{given}: must be >= 0 with [elastic]")
        if not any(segment.velocity for segment in self.segments):
            raise InputError("programme: no segment moves; blocks begin unstretched")

    def _require_loads(self) -> None:
        """Raise InputError where a load cannot change, or falls to 0 or less."""
        load = 1.0
        for index, segment in enumerate(self.segments if self.loaded else ()):
            if self.pulled:
                said = "not with a stage, blocks, a force or a motor, which find X"
                raise InputError(f"programme.{index}.load: {said} with it")
            load = segment.load or load
            load += (segment.load_rate or 0.0) * segment.duration
            with under(f"programme.{index}"):
                require_number("load at the end", load, above=0.0, most=1e3)

    @property
    def loaded(self) -> bool:
        """True if the normal load changes."""
        loads = [(segment.load, segment.load_rate) for segment in self.segments]
        return any(load not in (None, 1.0) or rate for load, rate in loads)

    @property
    def velocity_before(self) -> float:
        """Velocity at which contacts slid before the programme (length/time); 0 from a
        fresh start."""
        return (self.start == "stationary" and self.velocity) or 0.0

    @property
    def forced(self) -> bool:
        """True if forces pull the slider."""
        return all(segment.forced for segment in self.segments)

    @property
    def motor(self) -> bool:
        """True if a motor with a finite stall force drives."""
        return self.stall_force < math.inf

    @property
    def pulled(self) -> bool:
        """True if X is found, not given: by a stage, blocks, a force or a motor."""
        return self.pulled_alone or self.elastic is not None

    @property
    def pulled_alone(self) -> bool:
        """The same without the blocks of `elastic`."""
        given = self.stage is None and self.chain is None
        return not given or self.forced or self.motor

    @property
    def corners(self) -> tuple[Array, Array]:
        """Times at the ends of the segments, from 0 on, and displacements there."""
        steps = [
            (one.duration, math.copysign(one.path, one.velocity))
            for one in self.segments
        ]
        t, X = np.cumsum([(0.0, 0.0), *steps], axis=0).T
        return t, X

    def position(self, t: Array) -> Array:
        """Displacement at times `t` of what is driven: the slider, or the stage."""
        return np.interp(t, *self.corners)

    def grid(self, points: int) -> Grid:
        """About `points` instants: equidistant along a segment that moves or whose
        force or load changes, at equal ratios from the 1e-5th part of a hold or creep
        on."""
        share = max(1, (points - 1) // len(self.segments))
        parts = [Grid(np.zeros(1), np.zeros(1), np.zeros(1, np.int64))]
        for index, segment in enumerate(self.segments):
            n, (t, X, _) = segment.points or share, parts[-1]
            along = np.arange(1, n + 1) * (segment.path / n)
            if segment.velocity != 0:
                elapsed = along / abs(segment.velocity)
            elif segment.force_rate or segment.load_rate is not None:
                elapsed = segment.duration * (np.arange(1, n + 1) / n)
            else:
                looks = np.flip(np.geomspace(1.0, _FIRST_LOOK, n))
                elapsed = segment.duration * looks
            there = X[-1] + math.copysign(1.0, segment.velocity) * along
            parts.append(Grid(t[-1] + elapsed, there, np.full(n, index)))
        return Grid(*map(np.concatenate, zip(*parts, strict=True)))


def require_blocks(elastic: Elastic | None) -> None:
    """Raise InputError for a chain in the place of blocks that are always in balance."""
    if isinstance(elastic, Chain):
        said = (
            "must be Elastic(...); blocks with mass or damping are Programme(chain=...)"
        )
        raise InputError(f"elastic = {shown(elastic)}: {said}")


def require_drive(drive: Drive | Programme) -> Drive:
    """A constant drive; InputError for what is none, such as a bare velocity or a
    programme."""
    if isinstance(drive, Programme):
        what = "drive.programme, drive.file or drive.time: has no steady state"
        if drive.pulled:
            what = "drive.stage: a slider that a spring pulls has no steady state"
        if drive.chain:
            what = "elastic.damping: a chain of blocks in time has no steady state"
        if drive.motor:
            what = "drive.stall_force: `reference` finds the velocity of a motor"
        if drive.forced:
            what = "drive.force: a slider under a force has no steady state"
        needs = "this needs a constant drive.velocity of the slider itself"
        raise InputError(f"{what}; {needs}")
    if not isinstance(drive, Drive):
        said = "must be a Drive, for example Drive(velocity=0.1)"
        raise InputError(f"drive = {shown(drive)}: {said}")
    if drive.elastic is not None:
        raise InputError(f"elastic: {QUASISTATIC}")
    return drive


@dataclass(frozen=True)
class Output(Checked):
    """The recording of a run: how many `points` in time, of independent ensembles, the
    `replicas`, over which the force is averaged. Raises InputError for a value out of
    range."""

    points: Annotated[int, Limits(2, 2 * 10**7)] = 2001
    seed: Annotated[int, Limits(0, 2**63 - 1)] = 1
    replicas: Annotated[int, Limits(1, 10**9)] = 1
    series: bool = False  # keep the force of every replica
    breaks: bool = False  # list every break

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.series and self.replicas == 1:
            said = "writes the force of every replica"
            raise InputError(f"series: {said}; needs output.replicas of 2 or more")
        forces = self.replicas * self.points
        if self.series and forces > MOST_SERIES:
            size = f"output.replicas x output.points = {forces:.3g}"
            raise InputError(
                f"series: {size}; at most {MOST_SERIES:.0e} forces are kept"
            )
