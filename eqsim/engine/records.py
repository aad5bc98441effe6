"""Records of runs: force and pinned contacts along a drive, and what is known of
segments and slips."""

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from eqsim.errors import InputError
from eqsim.estimate import Averages, Estimate
from eqsim.numerics.tables import Array
from eqsim.results import Drawn, Result


@dataclass(frozen=True, repr=False)
class ForceRecord(Result):
    """Force of an interface while it is pulled.

    Attributes
    ----------
    X, t : ndarray, shape (points,)
        Displacement (length) and time.
    force, force_stderr : ndarray, shape (points,)
        <F>/(N k) (length), averaged over replicas, and its standard error.
    force_reliable : bool
        False where so few contacts or replicas make the force that it may well be off
        by more than five standard errors.
    force_replica_std : ndarray, shape (points,), or None
        Standard deviation of F/(N k) between replicas, if there are several.
    lives : int
        Lives of contacts that were simulated.
    seed, engine_seconds, threads
        Seed of the random numbers, seconds that it took, and threads.
    """

    X: Array
    t: Array
    force: Array
    force_stderr: Array
    force_reliable: bool
    force_replica_std: Array | None
    lives: int
    seed: int
    engine_seconds: float
    threads: int

    # in the order in which they are written
    names: ClassVar[tuple[str, ...]]

    def columns(self) -> dict[str, Array]:
        """The arrays by name; those between replicas only if there are several."""
        found = {name: getattr(self, name) for name in self.names}
        return {name: column for name, column in found.items() if column is not None}


@dataclass(frozen=True, repr=False)
class Record(ForceRecord):
    """An ensemble's force along a drive.

    Attributes are those of `ForceRecord`, and

    Attributes
    ----------
    pinned, pinned_stderr : ndarray, shape (points,)
        <N_c>/N, averaged over replicas, and its standard error.
    force_replicas : ndarray, shape (replicas, points), or None
        F/(N k) of every replica (length), if there are several, and these are at most
        2e7 numbers.
    """

    drawn: ClassVar[Drawn] = Drawn(
        "X", "force", "force_stderr", "displacement  X", "friction force  F/(N k)"
    )
    pinned: Array
    pinned_stderr: Array
    force_replicas: Array | None
    names: ClassVar[tuple[str, ...]] = (
        *("X", "t", "force", "pinned"),
        *("force_stderr", "pinned_stderr", "force_replica_std"),
    )

    def replicas(self) -> dict[str, Array]:
        """The series of every replica, one after the other, by column: `replica`, `t`,
        `X` and `force`, shape (replicas x points,). Raises InputError if there is one
        ensemble only, or if they were too many to be kept."""
        if self.force_replicas is None:
            if self.force_replica_std is None:
                raise InputError("replicas: there is one ensemble only")
            raise InputError("replicas: series are kept for at most 2e7 numbers")
        count, points = self.force_replicas.shape
        X = getattr(self, "X_replicas", None)
        return {
            "replica": np.repeat(np.arange(count), points),
            "t": np.tile(self.t, count),
            "X": np.tile(self.X, count) if X is None else X.ravel(),
            "force": self.force_replicas.ravel(),
        }


@dataclass(frozen=True, repr=False)
class Trajectory(Record):
    """A record at constant velocity, with `averages` over the second half of the
    distance; these are unreliable also where the law predicts a transient there, or too
    few of the lives that make up their scatter."""

    averages: Averages

    @property
    def friction(self) -> Estimate:
        """<F>/(N k) over the second half of the distance (length), one of `averages`."""
        return self.averages.friction


@dataclass(frozen=True)
class VelocityStep:
    """Response to a step between two velocities of the same sign, in the terms of
    rate-and-state friction.

    Attributes
    ----------
    direct, evolution : Estimate
        Direct effect a and evolution effect b, the changes of force up to the peak and
        from there to the end of the segment over ln(new velocity/old velocity)
        (length).
    memory : Estimate
        Displacement from the peak to where 1/e of the second change is left (length).
    a_minus_b : Estimate
        Change of force from before the step to the end of the segment over the same
        (length).
    """

    direct: Estimate
    evolution: Estimate
    memory: Estimate
    a_minus_b: Estimate


@dataclass(frozen=True)
class SegmentRecord:
    """Forces read off a segment of a programme.

    Errors of differences of two forces are from the scatter of the difference between
    independent parts of the contacts, or between 8 replicas or more. Where neither is
    known they are as if the two forces were independent.

    Attributes
    ----------
    velocity, t, X : float
        Velocity (length/time), and time and displacement at its end.
    end : Estimate
        Force at its end, <F>/(N k) (length).
    peak : Estimate
        The force that differs most from that at its beginning; after a hold the largest
        in the direction of motion, and so of a velocity step, or the smallest if the
        slider becomes slower (length).
    at : Estimate
        Where the peak is: displacement since the beginning, in a hold time.
    step : VelocityStep or None
        If the segment before moved in the same direction at another velocity.
    relaxation : Estimate or None
        In a hold after a motion: by how much the force falls until its end (length).
    healing, drop : Estimate or None
        In a motion on in the same direction after a hold: the peak less the force
        before the hold, and less that at the end (length). Unreliable if the force
        cannot be told from its peak over half of the motion.
    """

    velocity: float
    t: float
    X: float
    end: Estimate
    peak: Estimate
    at: Estimate
    step: VelocityStep | None
    relaxation: Estimate | None = None
    healing: Estimate | None = None
    drop: Estimate | None = None


@dataclass(frozen=True, repr=False)
class ProgrammeTrajectory(Record):
    """A record along a programme.

    Attributes
    ----------
    segment : ndarray of int, shape (points,)
        The segment of the programme that each instant belongs to.
    segments : tuple of SegmentRecord
        Forces read off each of them.
    """

    drawn: ClassVar[Drawn] = Record.drawn._replace(x="t", x_label="time  t")
    segment: Array
    segments: tuple[SegmentRecord, ...]
    names: ClassVar[tuple[str, ...]] = ("segment", *Record.names)


@dataclass(frozen=True)
class Slip:
    """A slip of a slider that a stage pulls: the spring shortens by at least a quarter
    of the width of the threshold law before it lengthens by as much, while the slider
    moves more than twice as fast as the stage at its fastest.

    Attributes
    ----------
    t, X : float
        Time when half of the drop is done, and displacement of the slider then
        (length).
    drop : float
        Fall of the force of the spring, over N k, from its largest to its least value,
        or for a slip backwards its rise from least to largest (length).
    duration, distance : float
        Time that the drop takes, and displacement of the slider meanwhile (length;
        negative backwards).
    replica : int
        Number of the independent ensemble.
    begun, ended : bool
        True if the record shows its beginning, or its end. Otherwise it was under way
        at that end of the record, and `drop`, `duration` and `distance` are less than
        the whole, `t` and `X` those of the half that was seen.
    """

    t: float
    X: float
    drop: float
    duration: float
    distance: float
    replica: int = 0
    begun: bool = True
    ended: bool = True


@dataclass(frozen=True, repr=False)
class PulledRecord(ProgrammeTrajectory):
    """A record of what a stage pulls; X is found, not given.

    Forces and displacements are means over replicas, errors are from their scatter. Of
    a single ensemble `force_stderr` is what independent contacts at the same X would
    have, and `force_reliable` is False: it does not know how far this X(t) is from that
    of other ensembles. The errors of force, pinned share and X include how far the
    finite step may be wrong: a third of what changes in steps four times as long.

    Attributes
    ----------
    X_stderr : ndarray, shape (points,)
        Standard error of X; of a single ensemble only what the finite step makes of it
        (length).
    stage, spring : ndarray, shape (points,)
        Displacement of the stage's end of the spring, and the force of the spring,
        kappa_s (stage - X) (length).
    X_replica_std : ndarray, shape (points,), or None
        Standard deviation of X between replicas, if there are several (length).
    X_replicas : ndarray, shape (replicas, points), or None
        X of every replica (length), if there are several.
    energy : ndarray, shape (points, 4)
        Over N k (length squared), means over replicas: work of the stage so far; what
        springs, masses and contacts store, less that at the beginning; what broken
        contacts, damping and viscosity have taken; and what is missing because steps
        are finite.
    """

    stage: Array
    spring: Array
    X_stderr: Array
    X_replica_std: Array | None
    X_replicas: Array | None
    energy: Array

    names: ClassVar[tuple[str, ...]] = (
        *ProgrammeTrajectory.names,
        *("X_stderr", "stage", "spring", "X_replica_std"),
    )

    def columns(self) -> dict[str, Array]:
        """The arrays by name; those between replicas only if there are several."""
        energies = "work", "stored", "dissipated", "missing"
        return super().columns() | dict(zip(energies, self.energy.T, strict=True))


@dataclass(frozen=True, repr=False)
class SliderTrajectory(PulledRecord):
    """A record of a slider that a stage pulls. The errors of `period` and `drop` include
    that of the finite step, too.

    Attributes are those of `PulledRecord`, and

    Attributes
    ----------
    slips : tuple of Slip
    coarser_slips : tuple of Slip, or None
        Those of the same contacts in steps four times as long; None if nothing is
        approximate.
    avalanches : dict of ndarray, or None
        Breaks at one instant, where they are followed one by one, by column: time `t`
        and displacement `X` (length) of the first break, how many `breaks` follow from
        it at once, `drop` of the force and `distance` that the slider moves until the
        last (length), and the `replica`.
    lifetimes : ndarray, shape (replicas,)
        When the last contact has broken under a force that nothing else holds (time);
        infinite where the record ends before. Then the slider has let go: X is nan, and
        mean X are those of the replicas that still hold.
    """

    slips: tuple[Slip, ...]
    coarser_slips: tuple[Slip, ...] | None
    avalanches: dict[str, Array] | None
    lifetimes: Array

    @property
    def period(self) -> Estimate:
        """Mean time from one slip to the next, but for the first."""
        return self._mean_over_slips(
            lambda slips: [b.t - a.t for a, b in itertools.pairwise(slips)]
        )

    @property
    def drop(self) -> Estimate:
        """Mean drop of the spring's force in a slip, but for the first (length)."""
        return self._mean_over_slips(lambda slips: [slip.drop for slip in slips])

    def _mean_over_slips(self, of: Callable[[list[Slip]], list[float]]) -> Estimate:
        """Mean of the values `of` each replica's whole slips, with the error of finite
        steps."""
        found = _mean_over(self.slips, of)
        if self.coarser_slips is None:
            return found
        return with_steps(found, _mean_over(self.coarser_slips, of))


@dataclass(frozen=True, repr=False)
class ElasticTrajectory(ForceRecord):
    """Motion of coupled blocks while the plate moves, in the mean over blocks and
    replicas.

    Attributes are those of `ForceRecord`, X being the mean over blocks, and

    Attributes
    ----------
    D : ndarray, shape (points,)
        Displacement of the plate (length).
    X_replica_std : ndarray, shape (points,), or None
        Standard deviation of X between replicas, if there are several.
    friction, size, single : Estimate
        Averages over the second half of the plate's way, from batches: int F dX/Delta X
        of all blocks (length), breaks per avalanche, and fraction of single breaks
        among them. With heat, an edge, loads or a programme those over the second half
        of the last segment, friction over time.
    avalanches : dict of ndarray
        Columns: time `t`, plate `D` (length), `block` where it began, `breaks`,
        `blocks` that broke, `drop` of F/(N k) (length), and the `replica`; with heat,
        an edge or loads also `by_heat`, 1 if heat broke the first contact, and
        `before`, the friction at which it began.
    blocks : dict of ndarray
        Columns, with a row for each record of each block: `t`, `D`, `block`, its
        displacement `X` and `force` = F_j/(n k) (lengths), `breaks` so far, and the
        `replica`.

    The error of the force comes from the scatter between replicas, of which 8 are
    enough; that of a single one is of independent contacts at the same displacements,
    and does not show how far its X is from that of others. It is at least what the
    break of one contact changes, which none of the replicas may have met.
    """

    drawn: ClassVar[Drawn] = Record.drawn._replace(
        x="D", x_label="displacement of the plate  D"
    )
    D: Array
    X_replica_std: Array | None
    friction: Estimate
    size: Estimate
    single: Estimate
    avalanches: dict[str, Array]
    blocks: dict[str, Array]
    names: ClassVar[tuple[str, ...]] = (
        *("t", "D", "X", "force"),
        *("force_stderr", "force_replica_std", "X_replica_std"),
    )


def by_replica(tables: Sequence[dict[str, Array]]) -> dict[str, Array]:
    """Tables of several replicas, by column, as one with the `replica` of each row."""
    columns = {name: np.concatenate([t[name] for t in tables]) for name in tables[0]}
    sizes = [next(iter(table.values())).size for table in tables]
    return columns | {"replica": np.repeat(np.arange(len(tables)), sizes)}


# slips from which on the scatter of a sample says something about its mean
_ENOUGH_SLIPS = 5


def _mean_over(
    slips: Sequence[Slip], of: Callable[[list[Slip]], list[float]]
) -> Estimate:
    """Mean of the values `of` the slips of each replica, without its first slip, which
    depends on the start, and one that the record ends in."""
    by_record = itertools.groupby(slips, key=lambda slip: slip.replica)
    return mean_in_records(
        [of([slip for slip in whole if slip.ended][1:]) for _, whole in by_record]
    )


def mean_in_records(values: Sequence[Sequence[float] | Array]) -> Estimate:
    """Mean of the values read off several records. Of m whole intervals that fit into a
    record the mean is shorter by its variance over m times the mean (derived, renewal
    theory), which is part of the error."""
    each = np.array([value for record in values for value in record], float)
    n = each.size
    if n < 2:
        return Estimate(float(each[0]) if n else None, None, n, reliable=False)
    mean, variance = float(np.mean(each)), float(np.var(each, ddof=1))
    records = sum(len(record) > 0 for record in values)
    short = variance * records / (n * abs(mean)) if mean else 0.0
    stderr = math.hypot(math.sqrt(variance / n), short)
    return Estimate(mean, stderr, n, n - 1, n >= _ENOUGH_SLIPS)


def with_steps(found: Estimate, coarse: Estimate) -> Estimate:
    """An estimate whose error includes that of finite steps: a third of what changes in
    steps four times as long, which gave `coarse`. Unreliable if they gave none."""
    if found.value is None:
        return found
    if coarse.value is None:
        return replace(found, reliable=False)
    if found.stderr is None:
        return found
    missed = (coarse.value - found.value) / 3.0
    return replace(found, stderr=math.hypot(found.stderr, missed))


# Observables of a segment of a programme, some of which are forces, and of a velocity
# step.
OF_SEGMENT = ("end", "peak", "at", "relaxation", "healing", "drop")
OF_STEP = ("direct", "evolution", "memory", "a_minus_b")


def observed(segment: SegmentRecord) -> dict[str, Estimate]:
    """The observables of a segment, and of a velocity step if it is one."""
    found = {name: getattr(segment, name) for name in OF_SEGMENT}
    found |= {name: getattr(segment.step, name, None) for name in OF_STEP}
    return {name: estimate for name, estimate in found.items() if estimate}
