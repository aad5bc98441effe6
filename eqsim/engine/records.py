"""Records of runs: force and pinned contacts along a drive, and quantities read off."""

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from eqsim.errors import InputError
from eqsim.estimate import Averages, Estimate, known
from eqsim.model.drive import Grid, Programme
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
        F/(N k) of every replica (length), if there are several, simulated by threads,
        and these are at most 2e7 numbers.
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
            raise InputError(
                "replicas: series are kept if threads simulate them, not an executor, "
                "and for at most 2e7 numbers"
            )
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
    distance; these are unreliable also where the law predicts a transient in it, or too
    few of the lives that make up their scatter (`engine.scatter`)."""

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
        Direct effect A and evolution effect B, the changes of force up to the peak and
        from there to the end of the segment over ln(new velocity/old velocity)
        (length). Their errors are as if the two forces were independent.
    memory : Estimate
        Displacement from the peak to where 1/e of the second change is left (length).
    """

    direct: Estimate
    evolution: Estimate
    memory: Estimate


@dataclass(frozen=True)
class SegmentRecord:
    """Forces read off a segment of a programme.

    Attributes
    ----------
    velocity, t, X : float
        Velocity (length/time), and time and displacement at its end.
    end : Estimate
        Force at its end, <F>/(N k) (length).
    peak : Estimate
        The force that differs most from that at its beginning, as the peak after a
        hold; of a velocity step the largest, or smallest if the slider becomes slower,
        in the direction of motion (length).
    at : Estimate
        Where the peak is: displacement since the beginning, in a hold time.
    step : VelocityStep or None
        If the segment before moved in the same direction at another velocity.
    """

    velocity: float
    t: float
    X: float
    end: Estimate
    peak: Estimate
    at: Estimate
    step: VelocityStep | None


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
    """A slip of a slider that a stage pulls: its spring relaxes faster than the stage
    loads it, by `model.slip` or more.

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
class SliderTrajectory(ProgrammeTrajectory):
    """A record of a slider that a stage pulls; X is found, not given.

    Forces and displacements are means over replicas, errors are from their scatter. Of
    a single ensemble `force_stderr` is what independent contacts at the same X would
    have, and `force_reliable` is False: it does not know how far this X(t) is from that
    of other ensembles. The errors of force, pinned share and X, and those of `period`
    and `drop`, include how far the finite step may be wrong: a third of what changes in
    steps four times as long.

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
        spring, slider and contacts store, less that at the beginning; what broken
        contacts, damping and viscosity have taken; and what is missing because steps
        are finite.
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

    stage: Array
    spring: Array
    X_stderr: Array
    X_replica_std: Array | None
    X_replicas: Array | None
    energy: Array
    slips: tuple[Slip, ...]
    coarser_slips: tuple[Slip, ...] | None
    avalanches: dict[str, Array] | None
    lifetimes: Array

    names: ClassVar[tuple[str, ...]] = (
        *ProgrammeTrajectory.names,
        *("X_stderr", "stage", "spring", "X_replica_std"),
    )

    def columns(self) -> dict[str, Array]:
        """The arrays by name; those between replicas only if there are several."""
        energies = "work", "stored", "dissipated", "missing"
        return super().columns() | dict(zip(energies, self.energy.T, strict=True))

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
        if self.coarser_slips is None or found.value is None:
            return found
        coarse = _mean_over(self.coarser_slips, of).value
        if coarse is None:
            return replace(found, reliable=False)
        if found.stderr is None:
            return found
        missed = (coarse - found.value) / 3.0
        return replace(found, stderr=math.hypot(found.stderr, missed))


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
        among them.
    avalanches : dict of ndarray
        Columns: time `t`, plate `D` (length), `block` where it began, `breaks`,
        `blocks` that broke, `drop` of F/(N k) (length), and the `replica`.
    blocks : dict of ndarray
        Columns, with a row for each record of each block: `t`, `D`, `block`, its
        displacement `X` and `force` = F_j/(n k) (lengths), `breaks` so far, and the
        `replica`.

    The error of the force comes from the scatter between replicas, of which 8 are
    enough; that of a single one is of independent contacts at the same displacements,
    and does not show how far its X is from that of others.
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
    values: list[float] = []
    for _, whole in itertools.groupby(slips, key=lambda slip: slip.replica):
        values += of([slip for slip in whole if slip.ended][1:])
    n = len(values)
    if n < 2:
        return Estimate(values[0] if values else None, None, n, reliable=False)
    stderr = float(np.std(values, ddof=1) / math.sqrt(n))
    return Estimate(float(np.mean(values)), stderr, n, n - 1, n >= _ENOUGH_SLIPS)


def slips_of(
    t: Array, X: Array, spring: Array, least: float, fastest: float, replica: int = 0
) -> list[Slip]:
    """The slips in a record, arrays (points,), forwards and backwards: the force of the
    spring falls by `least` or more before it rises by as much, or the mirror image of
    that, and the slider goes more than twice as fast as the stage at its `fastest`
    meanwhile. One that the record begins or ends in is marked."""
    slips = _falls(t, X, spring, least, fastest)
    for slip in _falls(t, -X, -spring, least, fastest):
        slips.append(replace(slip, X=-slip.X, distance=-slip.distance))
    slips.sort(key=lambda slip: slip.t)
    return [replace(slip, replica=replica) for slip in slips]


def _falls(
    t: Array, X: Array, spring: Array, least: float, fastest: float
) -> list[Slip]:
    """`slips_of` forwards."""
    found: list[Slip] = []
    # where the force is largest, and, once it has fallen, least
    high, low = 0, -1
    for i in range(t.size + 1):
        done = i == t.size
        if low < 0:
            if not done and spring[i] > spring[high]:
                high = i
            elif not done and spring[high] - spring[i] > least:
                low = i
        elif not done and spring[i] < spring[low]:
            low = i
        elif done or spring[i] - spring[low] > least:
            time, distance = float(t[low] - t[high]), float(X[low] - X[high])
            if distance > 2.0 * fastest * time:
                half = 0.5 * (spring[high] + spring[low])
                j = high + 1 + int(np.argmax(spring[high + 1 : low + 1] <= half))
                share = (spring[j - 1] - half) / (spring[j - 1] - spring[j])
                middle, x = (y[j - 1] + share * (y[j] - y[j - 1]) for y in (t, X))
                drop, ended = float(spring[high] - spring[low]), low < t.size - 1
                at = float(middle), float(x)
                found.append(Slip(*at, drop, time, distance, 0, high > 0, ended))
            high, low = min(i, t.size - 1), -1
    return found


def shown_by(
    programme: Programme,
    grid: Grid,
    force: Array,
    stderr: Array,
    reliable: bool = True,
    X_stderr: Array | None = None,
) -> tuple[SegmentRecord, ...]:
    """Summarise the segments of a programme from a force with errors, arrays (points,)
    at the instants of `grid`, whose displacements are those of the slider, with errors
    `X_stderr` if they are found behind a spring."""
    found, before = [], programme.velocity if programme.start == "stationary" else None
    for index, segment in enumerate(programme.segments):
        here = np.flatnonzero(grid.segment == index)
        here = here if index == 0 else np.append(here[0] - 1, here)
        along = grid.X[here] if segment.velocity else grid.t[here]
        along = np.abs(along - along[0])
        forces, errors = force[here], stderr[here]
        ratio = segment.velocity / before if before else 0.0
        stepped = ratio > 0 and ratio != 1
        rising = math.copysign(1.0, (ratio - 1) * segment.velocity) if stepped else 0
        peak, at = extreme(along, forces, errors, rising)
        if X_stderr is not None and segment.velocity and at.value is not None:
            near = here[int(np.argmin(np.abs(along - at.value)))]
            missed = math.hypot(at.stderr or 0.0, X_stderr[near], X_stderr[here[0]])
            at = replace(at, stderr=missed)
        end = Estimate(float(forces[-1]), float(errors[-1]), here.size)
        step = None
        if stepped:
            step = velocity_step(along, forces, errors, (peak, at), ratio)
        end, peak, at = (replace(e, reliable=reliable) for e in (end, peak, at))
        t, X = float(grid.t[here[-1]]), float(grid.X[here[-1]])
        found.append(SegmentRecord(segment.velocity, t, X, end, peak, at, step))
        before = segment.velocity
    return tuple(found)


def extreme(
    x: Array, force: Array, stderr: Array, direction: float = 0
) -> tuple[Estimate, Estimate]:
    """Estimate the force that differs most from the first one, in a `direction` (1 or
    -1) if given, and the `x` where it is; arrays (points,). The largest of many values
    with errors is biased. So the vertex of a parabola is fitted to all values within
    the error of the largest; the difference of the two is part of the error. If the
    vertex lies beyond these values, the largest value is returned."""
    change = direction * (force - force[0]) if direction else np.abs(force - force[0])
    top = int(np.argmax(change))
    near = np.abs(force - force[top]) <= 2.0 * stderr[top]
    left, right = top, top
    while left > 0 and near[left - 1]:
        left -= 1
    while right + 1 < force.size and near[right + 1]:
        right += 1
    n = force.size
    best, place = float(force[top]), float(x[top])
    # on a plateau the place may be anywhere
    cells = float(x[min(top + 1, n - 1)] - x[max(top - 1, 0)])
    spread = max(0.5 * float(np.ptp(x[near])), 0.5 * cells)
    if right - left >= 4 and 0 < top < n - 1:
        half, plateau = 0.5 * (x[right] - x[left]), slice(left, right + 1)
        a, b, c = np.polyfit((x[plateau] - place) / half, force[plateau], 2)
        vertex = -0.5 * b / a if a else np.inf
        within = x[left] <= place + vertex * half <= x[right]
        if a * (force[top] - force[0]) < 0 and within:
            best, place = float(c - 0.25 * b * b / a), place + float(vertex * half)
    error = float(np.hypot(stderr[top], force[top] - best))
    return Estimate(best, error, n), Estimate(place, spread, n)


def velocity_step(
    x: Array,
    force: Array,
    stderr: Array,
    extremum: tuple[Estimate, Estimate],
    ratio: float,
) -> VelocityStep:
    """Read off a step of velocity by a factor `ratio`: from the force with errors
    against displacement since, arrays (points,), and its `extreme`."""
    peak, at = extremum
    n, log_ratio, top = force.size, np.log(ratio), known(peak)

    def effect(level: int) -> Estimate:
        error = np.hypot(peak.stderr or 0.0, stderr[level])
        change = (top - force[level]) / log_ratio
        return Estimate(float(change), float(error / abs(log_ratio)), n)

    first = int(np.argmin(np.abs(x - known(at))))
    left = np.abs(force[first:] - force[-1]) - abs(top - force[-1]) / np.e
    below = int(np.argmax(left <= 0.0))
    memory = Estimate(None, None, n, reliable=False)
    j = first + below
    if below > 0 and x[j] > x[j - 1]:  # a motion that X resolves
        slope = (left[below - 1] - left[below]) / (x[j] - x[j - 1])
        place = x[j] + left[below] / slope
        # noise between neighbours makes any slope
        wide = max(first, j - max(1, below // 4))
        steep = abs(force[j] - force[wide]) / (x[j] - x[wide])
        error = np.hypot(stderr[j], np.hypot(peak.stderr or 0.0, stderr[-1]))
        error = error / steep if steep > 0 else np.inf
        memory = Estimate(float(place - x[first]), float(error), n)
    return VelocityStep(effect(0), effect(-1), memory)
