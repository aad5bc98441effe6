"""Records of runs: force and pinned contacts along a drive, and quantities read off."""

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, NamedTuple

import numpy as np

from eqsim.errors import InputError
from eqsim.estimate import Averages, Estimate, known, mean_of
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


# Observables of a segment of a programme, some of which are forces, and of a velocity
# step.
OF_SEGMENT = ("end", "peak", "at", "relaxation", "healing", "drop")
OF_STEP = ("direct", "evolution", "memory", "a_minus_b")


def observed(segment: SegmentRecord) -> dict[str, Estimate]:
    """The observables of a segment, and of a velocity step if it is one."""
    found = {name: getattr(segment, name) for name in OF_SEGMENT}
    found |= {name: getattr(segment.step, name, None) for name in OF_STEP}
    return {name: estimate for name, estimate in found.items() if estimate}


class Forces(NamedTuple):
    """Force along a grid, of which segments are summarised.

    Attributes
    ----------
    force, stderr : ndarray, shape (points,)
        <F>/(N k) and its standard error (length).
    parts : ndarray, shape (parts, points), or None
        The force of equal, independent parts of the contacts, if it is known.
    missed : ndarray, shape (points,), or None
        What the parts have in common of the error.
    """

    force: Array
    stderr: Array
    parts: Array | None = None
    missed: Array | None = None

    def within(self, here: Array) -> "Forces":
        """The force at some instants."""
        force, stderr, parts, missed = self
        parts = None if parts is None else parts[:, here]
        missed = None if missed is None else missed[here]
        return Forces(force[here], stderr[here], parts, missed)

    def change(self, *terms: tuple[int, float], more: float = 0.0) -> Estimate:
        """A sum of forces at instants times weights, with its standard error, `more` in
        quadrature."""
        points, weights = zip(*terms, strict=True)
        index, place = np.unique(points, return_inverse=True)
        weight = np.bincount(place, weights)
        value, n = float(self.force[index] @ weight), self.force.size
        if self.parts is None:
            error = float(np.linalg.norm(weight * self.stderr[index]))
            return Estimate(value, math.hypot(error, more), n)
        known = mean_of(self.parts[:, index] @ weight, n, len(self.parts) - 1)
        if self.missed is not None:
            more = math.hypot(more, *weight * self.missed[index])
        return replace(known, value=value, stderr=math.hypot(known.stderr or 0.0, more))

    def apart(self, point: int) -> Array:
        """Standard errors of the differences from the force at a point, (points,); its
        own error if that of differences is not known."""
        if self.parts is None:
            return np.full(self.force.size, self.stderr[point])
        scatter = np.std(self.parts - self.parts[:, [point]], axis=0, ddof=1)
        error = scatter / math.sqrt(len(self.parts))
        return error if self.missed is None else np.hypot(error, self.missed)


def shown_by(
    programme: Programme,
    grid: Grid,
    forces: Forces,
    reliable: bool = True,
    X_stderr: Array | None = None,
) -> tuple[SegmentRecord, ...]:
    """Summarise the segments of a programme from the force at the instants of `grid`,
    whose displacements are those of the slider, with errors `X_stderr` (points,) if they
    are found behind a spring."""
    found: list[SegmentRecord] = []
    before = programme.velocity if programme.start == "stationary" else None
    # of a hold: velocity before it, and the instant at which it begins
    paused: tuple[float, int] | None = None
    for index, segment in enumerate(programme.segments):
        here = np.flatnonzero(grid.segment == index)
        here = here if index == 0 else np.append(here[0] - 1, here)
        along = grid.X[here] if segment.velocity else grid.t[here]
        along = np.abs(along - along[0])
        part = forces.within(here)
        ratio = segment.velocity / before if before else 0.0
        stepped = ratio > 0 and ratio != 1
        rising = math.copysign(1.0, (ratio - 1) * segment.velocity) if stepped else 0
        resumed = paused is not None and paused[0] * segment.velocity > 0
        if resumed:
            rising = math.copysign(1.0, segment.velocity)
        peak, at = extreme(along, part, rising)
        top = int(np.argmin(np.abs(along - known(at))))
        if X_stderr is not None and segment.velocity:
            spread = X_stderr[here[top]], X_stderr[here[0]]
            at = replace(at, stderr=math.hypot(at.stderr or 0.0, *spread))
        last = here.size - 1
        shown = {
            "end": Estimate(float(part.force[-1]), float(part.stderr[-1]), here.size),
            "peak": peak,
            "at": at,
        }
        if not segment.velocity and before:
            paused = before, int(here[0])
            sign = math.copysign(1.0, before)
            shown["relaxation"] = part.change((0, sign), (last, -sign))
        elif resumed and paused:
            begun, off = paused[1], known(peak) - float(part.force[top])
            for name, other in (("healing", begun), ("drop", int(here[-1]))):
                high, low = (int(here[top]), rising), (other, -rising)
                change = forces.change(high, low, more=off)
                shown[name] = replace(change, value=known(change) + rising * off)
        step = velocity_step(along, part, (peak, at), ratio) if stepped else None
        # the largest of many noisy values on a plateau is too large
        vague = ("healing", "drop") if 4.0 * (at.stderr or 0.0) > along[-1] else ()
        shown = {
            name: replace(e, reliable=reliable and name not in vague)
            for name, e in shown.items()
        }
        t, X = float(grid.t[here[-1]]), float(grid.X[here[-1]])
        found.append(SegmentRecord(segment.velocity, t, X, step=step, **shown))
        before = segment.velocity
        paused = paused if not segment.velocity else None
    return tuple(found)


def extreme(
    x: Array, forces: Forces, direction: float = 0
) -> tuple[Estimate, Estimate]:
    """Estimate the force that differs most from the first one, in a `direction` (1 or
    -1) if given, and the `x` where it is; arrays (points,). The largest of many values
    with errors is biased. So the vertex of a parabola is fitted to all values within
    the error of the largest; the difference of the two is part of the error. If the
    vertex lies beyond these values, the largest value is returned. The error of the
    place is half the range in which the force cannot be told from the largest value."""
    force, stderr = forces.force, forces.stderr
    change = direction * (force - force[0]) if direction else np.abs(force - force[0])
    top = int(np.argmax(change))
    below = np.abs(force - force[top])
    same = x[below <= 2.0 * forces.apart(top)]
    near = (below <= 2.0 * stderr[top]) & (x >= same.min()) & (x <= same.max())
    left, right = top, top
    while left > 0 and near[left - 1]:
        left -= 1
    while right + 1 < force.size and near[right + 1]:
        right += 1
    n = force.size
    best, place = float(force[top]), float(x[top])
    # on a plateau the place may be anywhere
    cells = float(x[min(top + 1, n - 1)] - x[max(top - 1, 0)])
    spread = max(0.5 * float(np.ptp(same)), 0.5 * cells)
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
    x: Array, forces: Forces, extremum: tuple[Estimate, Estimate], ratio: float
) -> VelocityStep:
    """Read off a step of velocity by a factor `ratio`: from the force against
    displacement since, arrays (points,), and its `extreme`."""
    peak, at = extremum
    force, n, log_ratio = forces.force, forces.force.size, np.log(ratio)
    last, top = n - 1, known(peak)
    first = int(np.argmin(np.abs(x - known(at))))
    off = top - float(force[first])

    def effect(begin: int, end: int, *, of_peak: float) -> Estimate:
        """Force at `end` less that at `begin`, one of which is the peak."""
        change = forces.change((end, 1.0), (begin, -1.0), more=of_peak * off)
        value = (known(change) + of_peak * off) / log_ratio
        error = (change.stderr or 0.0) / abs(log_ratio)
        return replace(change, value=float(value), stderr=float(error))

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
        level = (first, -1.0 / np.e), (last, 1.0 / np.e - 1.0)
        missed = forces.change((j, 1.0), *level, more=off / np.e)
        error = (missed.stderr or 0.0) / steep if steep > 0 else np.inf
        # a range of two errors to either side is told of the place of the peak
        error = math.hypot(error, 0.5 * (at.stderr or 0.0))
        memory = Estimate(float(place - x[first]), float(error), n, missed.dof)
    return VelocityStep(
        direct=effect(0, first, of_peak=1.0),
        evolution=effect(last, first, of_peak=1.0),
        memory=memory,
        a_minus_b=effect(0, last, of_peak=0.0),
    )
