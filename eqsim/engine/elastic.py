"""Coupled blocks that a plate pulls infinitely slowly at T = 0, break by break.

Force and displacement of every block are linear between breaks (`model.elastic`):
X_j = q D + Y_j with q = K_d/(K_d + n k), and a break of stretch xi at block i adds
G_ji k xi to Y_j. So block j breaks next when the share q D of the plate's displacement,
the level, has risen to its threshold h_j: the position where its next contact breaks
less Y_j. The plate moves until the level is the lowest threshold; an avalanche goes on
while a threshold is below the level. The order of these breaks makes no difference: F_j
depends on the past through X_j alone, and breaks only ever move blocks forward (an
Abelian sandpile).

Positions are whole multiples of a `unit` of some 1e-15 of the distance, so that breaks
add up to the same bits of Y_j in any order. A run belongs to one thread; threads share
replicas.
"""

import json
import math
import time
from collections.abc import Callable
from concurrent.futures import CancelledError
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np

from eqsim.engine import block_events
from eqsim.engine.avalanches import events_of, put_back
from eqsim.engine.blocks import require_lives, require_records
from eqsim.engine.contacts import Contacts, contacts
from eqsim.engine.keeping import Keep, State
from eqsim.engine.lanes import draw_birth
from eqsim.engine.lattice import (
    LEAF,
    Response,
    lowest_block,
    no_levels,
    response_of,
    rounded,
    spread,
)
from eqsim.engine.records import ElasticTrajectory, by_replica
from eqsim.engine.scatter import births, scatter, unmet_force
from eqsim.engine.trajectory import guarded, predicted_lives
from eqsim.errors import InputError, require_number
from eqsim.estimate import Estimate, drifts, ratio
from eqsim.model.drive import Drive, Grid, Output, Programme, Segment
from eqsim.model.elastic import Elastic
from eqsim.model.ensemble import Ensemble
from eqsim.numerics.compiled import kernel
from eqsim.numerics.streams import TRAJECTORY, Key
from eqsim.numerics.streams import key as key_of
from eqsim.numerics.tables import Array
from eqsim.numerics.threads import ThreadPool, interruptibly

_MOST_BATCHES = 16  # of the second half of a run, whose scatter tells the error
_SHORTEST_BATCH = 1.5  # displacement of the plate, in mean thresholds
# The same, over a change of the force by the scatter of those of independent contacts
# (half a mean threshold each): weak springs change it so slowly that blocks remember it.
_CHANGES_OF_FORCE = 4.0
_FORGOTTEN = 5.0  # mean thresholds, after which warm contacts know no fresh start
_RELIABLE_FROM = 8  # batches or replicas whose scatter tells the error of their mean
# Avalanches of another size that a sample does not tell, as of those that are rare it
# may have met none (Agresti and Coull, 1998).
_UNMET = 2.0
_BETWEEN_PAUSES = 1e6  # breaks between moments at which a signal may stop a run
_MOST_AVALANCHES = 30_000_000  # of all replicas: some 2 GB of memory

# Columns of avalanches that are lengths, time as displacement among them.
_LENGTHS = {"t", "D", "drop", "before"}

# Why contacts and drives are refused.
_BACKWARDS = "a contact born with more stretch than the last would move its block back"
_CHANGES = "the response of blocks to a break would change with every break"
_NO_STEADY_STATE = "the stationary state of coupled blocks is not known"

# The run so far, and the avalanche that goes on.
_PROGRESS = np.dtype(
    [
        ("level", np.float64),  # q D
        ("block", np.int64),  # where the avalanche began
        ("size", np.int64),  # its breaks so far; 0 if none goes on
        ("blocks", np.int64),  # with at least one of its breaks
        ("released", np.float64),  # sum of its stretches at breaking
        ("avalanches", np.int64),  # so far, as all that follows
        ("singles", np.int64),  # avalanches of one break
        ("breaks", np.int64),
        ("work", np.float64),  # sum of xi^2/2
    ]
)

# An avalanche.
_BLOCK_AVALANCHE = np.dtype(
    [
        ("level", np.float64),
        ("block", np.int64),  # where it began
        ("breaks", np.int64),
        ("blocks", np.int64),  # with at least one of its breaks
        ("released", np.float64),  # sum of stretches at breaking
    ]
)

# A block at an instant.
BLOCK_STATE = np.dtype(
    [
        ("X", np.float64),
        ("force", np.float64),
        # of the force of a contact, if they were independent, times n_j/n
        ("variance", np.float64),
        ("breaks", np.int64),  # so far
    ]
)


class Blocks(NamedTuple):
    """Contacts and blocks: B blocks of n contacts."""

    position: Array  # (B, n), a heap for each block: where contacts break next
    contact: Array  # (B, n), which ones
    xi: Array  # (B n,), thresholds of contacts
    lives: Array  # (B n,), that have been drawn
    h: Array  # thresholds of blocks, with room to a multiple of `LEAF`
    births: Array  # (B,), sum over contacts of the positions of their births
    squares: Array  # (B,), of the squares of these
    breaks: Array  # (B,), so far
    last: Array  # (B,), avalanche that has broken contacts
    tree: Array  # lowest thresholds, a binary tree from node 1 on


@kernel(makes_arrays=True)
def pin_all(laws: Contacts, key: Key, first: int, unit: float, b: Blocks) -> None:
    """Pin all contacts, of which the first is number `first`, with all blocks at 0."""
    blocks, n = b.position.shape
    for j in range(blocks):
        for contact in range(j * n, (j + 1) * n):
            xi = draw_birth(laws.newborn, laws, key, first + contact, 0).threshold
            b.xi[contact] = rounded(xi, unit)
            b.lives[contact] = 1
        order = np.argsort(b.xi[j * n : (j + 1) * n])
        for i in range(n):
            b.contact[j, i] = j * n + order[i]
            b.position[j, i] = b.xi[b.contact[j, i]]
        b.h[j] = b.position[j, 0]
    leaves = b.tree.size // 2
    for segment in range(b.h.size // LEAF):
        begin = segment * LEAF
        b.tree[leaves + segment] = b.h[begin : begin + LEAF].min()
    for node in range(leaves - 1, 0, -1):
        b.tree[node] = min(b.tree[2 * node], b.tree[2 * node + 1])


@kernel
def raise_level(
    laws: Contacts,
    key: Key,
    first: int,
    b: Blocks,
    r: Response,
    state: Array,
    until: float,
    events: Array,
) -> tuple[int, bool]:
    """Raise the level to `until`, and note the avalanches that end. The first contact
    of all is number `first`; `state` (1,) is a `_PROGRESS`, and `events` has
    `_BLOCK_AVALANCHE`s. Returns the number of avalanches, and False if there are more
    than `events` has room for."""
    now = state[0]
    rows = 0
    n = b.position.shape[1]
    while True:
        lowest = b.tree[1]
        if lowest > now.level:
            if now.size > 0:
                if rows == events.size:
                    return rows, False
                event = events[rows]
                event.level = now.level
                event.block = now.block
                event.breaks = now.size
                event.blocks = now.blocks
                event.released = now.released
                rows += 1
                now.singles += now.size == 1
                now.size = 0
            if lowest > until:
                now.level = until
                return rows, True
            now.level = lowest
            now.block = lowest_block(b)
            now.blocks = 0
            now.released = 0.0
            now.avalanches += 1
        block = lowest_block(b)
        contact = b.contact[block, 0]
        position = b.position[block, 0]
        xi = b.xi[contact]
        b.births[block] += xi
        b.squares[block] += xi * (2.0 * position - xi)
        b.breaks[block] += 1
        if b.last[block] != now.avalanches:
            b.last[block] = now.avalanches
            now.blocks += 1
        now.size += 1
        now.breaks += 1
        now.released += xi
        now.work += 0.5 * xi * xi
        lives, number = b.lives[contact], first + contact
        born = draw_birth(laws.newborn, laws, key, number, lives)
        b.xi[contact] = rounded(born.threshold, r.unit)
        b.lives[contact] = lives + 1
        put_back(b.position[block], b.contact[block], position + b.xi[contact])
        b.h[block] += b.position[block, 0] - position
        spread(r, b, block, xi / n)


def check_elastic(
    ensemble: Ensemble, drive: Drive | Programme, output: Output, max_lives: float
) -> tuple[Elastic, float]:
    """Blocks of a run, and its predicted lives. Raises InputError if contacts are not
    those of the quasi-static model, or the run takes too many lives or too much
    memory."""
    points, replicas = output.points, output.replicas
    elastic = drive.elastic
    if elastic is None:
        raise InputError("drive.elastic: is required, the blocks that the plate pulls")
    elastic.contacts_of(ensemble.count)
    delay, eta = ensemble.delay.time, ensemble.eta
    drag = ensemble.viscosity.force
    aging, born, springs = ensemble.aging, ensemble.newborn, ensemble.stiffness_law
    fresh = drive.start == "fresh"
    refused = {
        "delay.time": (delay > 0, delay, 0, "a delay needs time"),
        "aging.rule": (aging.active, aging.rule, "none", "aging needs time"),
        "newborn.law": (born.active, born.law, "unstressed", _BACKWARDS),
        "viscosity.force": (drag > 0, drag, 0, "its blocks have no velocity"),
        "viscosity.eta": (eta > 0, eta, 0, "viscous force needs a velocity"),
        "contacts.stiffness_law": (springs != "uniform", springs, "uniform", _CHANGES),
        "drive.start": (not fresh, drive.start, "fresh", _NO_STEADY_STATE),
    }
    for name, (wrong, value, allowed, why) in refused.items():
        if wrong:
            raise InputError(
                f"{name} = {json.dumps(value)}: must be {json.dumps(allowed)} with "
                f"[elastic], whose blocks move quasi-statically: {why}"
            )
    if isinstance(drive, Programme):
        points = drive.grid(points).t.size
    programme = _programme_of(drive, ensemble)
    distance = sum(one.path for one in programme.segments) / ensemble.thresholds.mean
    require_number("distance / threshold", distance, least=1e-6, most=1e6)
    lives = expected_lives(ensemble, drive, replicas)
    require_lives(lives, max_lives)
    require_records(points, elastic.count * replicas)
    size = 1.0 if ensemble.thermal.active else elastic.mean_size
    if lives / size > _MOST_AVALANCHES:
        raise InputError(
            f"this run has about {lives / size:.3g} avalanches, more than "
            f"{_MOST_AVALANCHES:.0e}; fewer contacts.count or a shorter drive.distance "
            "has fewer"
        )
    return elastic, lives


def expected_lives(
    ensemble: Ensemble, drive: Drive | Programme, replicas: int = 1
) -> float:
    """Predict the number of lives of a run of coupled blocks."""
    programme, elastic = _programme_of(drive, ensemble), drive.elastic
    assert elastic
    warm = elastic.follows_events(ensemble.thermal.active)
    if isinstance(drive, Programme) or warm:
        return replicas * _expected(ensemble, programme, elastic)
    distance = programme.segments[0].path / ensemble.thresholds.mean
    return ensemble.count * replicas * (1.0 + distance)


class _Totals(NamedTuple):
    """Sums over blocks until the ends of batches, or in batches, (..., batches)."""

    area: Array  # int F dX
    X: Array
    breaks: Array
    avalanches: Array
    singles: Array
    moved: Array  # mean X of the blocks


class _Replica(NamedTuple):
    """Record of a replica."""

    records: Array  # `BLOCK_STATE`, shape (points, B)
    totals: _Totals
    avalanches: dict[str, Array]  # columns; `t` as displacement at the plate's pace
    breaks: int


class _Interface(NamedTuple):
    """Contacts and blocks for kernels; lengths in units of the threshold scale."""

    laws: Contacts
    key: Key
    contacts: int
    elastic: Elastic
    response: Response
    levels: Array  # of records
    edges: Array  # of batches, levels
    pauses: Array  # levels at which a signal may stop the run

    @classmethod
    def of(
        cls, ensemble: Ensemble, drive: Drive, elastic: Elastic, points: int, seed: int
    ) -> "_Interface":
        unit, mean = ensemble.thresholds.scale, ensemble.thresholds.mean
        distance, count = drive.over(ensemble), ensemble.count
        response = response_of(elastic, distance / unit)
        # Blocks follow a share of the plate's motion at once.
        levels = np.linspace(0.0, distance / unit * (1.0 - elastic.branching), points)
        batches = max(2, _batches(ensemble, drive, elastic))
        edges = np.linspace(0.5 * levels[-1], levels[-1], batches + 1)
        between = math.ceil(count * distance / mean / _BETWEEN_PAUSES)
        pauses = np.linspace(0.0, levels[-1], 1 + between)
        laws, key = contacts(ensemble, drive.velocity), key_of(seed, TRAJECTORY)
        return cls(laws, key, count, elastic, response, levels, edges, pauses)

    @property
    def net_drop(self) -> float:
        """Share of the force of a contact that is lost when it breaks."""
        return 1.0 - self.elastic.branching

    def begun(self) -> "_Interface":
        """The same at the beginning, with a contact for each block."""
        none, levels = np.empty(0), self.levels[:1]
        few = self.elastic.count
        return self._replace(contacts=few, levels=levels, edges=none, pauses=none)

    def simulate(
        self, replica: int, told: Callable[[int], None], keep: Keep | None = None
    ) -> _Replica:
        """Follow a replica. `told` gets the number of breaks since, now and then, `keep`
        its state."""
        laws, key, count, elastic, response, levels, edges, pauses = self
        n = count // elastic.count
        first = replica * count
        b = _blocks_of(elastic, n)
        pin_all(laws, key, first, response.unit, b)
        state = np.zeros(1, _PROGRESS)
        now = state[0]
        records: list[Array] = []
        totals: list[Array] = []
        events: list[Array] = []
        rows = {"records": records, "totals": totals}
        run = State({**b._asdict(), "state": state}, rows, {"events": events})
        done = run.restore(keep, replica)
        told(int(now["breaks"]))
        every = np.unique(np.concatenate((levels, edges, pauses)))
        for index, level in enumerate(every[done:], done):
            before = int(now["breaks"])
            loaded = laws, key, first, b, response, state, level
            events.append(events_of(_BLOCK_AVALANCHE, raise_level, *loaded))
            told(int(now["breaks"]) - before)
            X = b.position[:, 0] - b.h[: elastic.count] + level
            if level in levels:
                record = np.empty(X.size, BLOCK_STATE)
                record["X"] = X
                record["force"] = X - b.births / n
                record["variance"] = np.maximum(
                    b.squares / n - (b.births / n) ** 2, 0.0
                )
                record["breaks"] = b.breaks
                records.append(record)
            if level in edges:
                stored = 0.5 * (n * X**2 - 2.0 * X * b.births + b.squares)
                area = (now["work"] + stored.sum()) / n
                counts = (now[name] for name in ("breaks", "avalanches", "singles"))
                totals.append(np.array((area, X.sum(), *counts, X.mean()), float))
            run.save(keep, replica, index + 1)
        batches = _Totals(*np.reshape(totals, (-1, 6)).T)
        found, share = np.concatenate(events), 1.0 - elastic.branching
        # Force is lost by breaks and gained by the motion that they cause: what is left of
        # the loss is the share of the plate's motion that blocks follow at once.
        D = found["level"] / share
        columns = {
            "t": D,
            "D": D,
            **{name: found[name] for name in ("block", "breaks", "blocks")},
            "drop": found["released"] * (share / count),
        }
        return _Replica(np.array(records), batches, columns, int(now["breaks"]))


class _WarmInterface(NamedTuple):
    """The same of contacts that break by heat, or blocks that differ."""

    contacts: int
    blocks: block_events.Interface
    instants: block_events.Instants
    points: int

    @classmethod
    def of(
        cls,
        ensemble: Ensemble,
        drive: Drive | Programme,
        elastic: Elastic,
        points: int,
        seed: int,
    ) -> "_WarmInterface":
        programme = _programme_of(drive, ensemble)
        segments, grid = programme.segments, _grid_of(drive, ensemble, points)
        pace = max(segment.velocity for segment in segments)
        blocks = block_events.interface_of(ensemble, elastic, pace, seed)
        scale = pace / ensemble.thresholds.scale
        edges = 1 + max(2, _batches(ensemble, programme, elastic))
        lives = _expected(ensemble, programme, elastic)
        end = len(segments)
        instants = block_events.Instants(
            _passed(programme, grid),
            np.linspace(end - 0.5, end, edges),
            np.linspace(0.0, end, 1 + end * math.ceil(lives / _BETWEEN_PAUSES)),
            np.array([segment.duration for segment in segments]) * scale,
            np.array([segment.velocity / pace for segment in segments]),
        )
        return cls(ensemble.count, blocks, instants, grid.t.size)

    @property
    def net_drop(self) -> float:
        return float(self.blocks.net_drop.max())

    def begun(self) -> "_WarmInterface":
        zero = np.zeros(1)
        instants = block_events.Instants(zero, zero, zero, zero, zero)
        return self._replace(instants=instants, points=1)

    def simulate(
        self, replica: int, told: Callable[[int], None], keep: Keep | None = None
    ) -> _Replica:
        records = np.empty((self.points, self.blocks.share.size), BLOCK_STATE)
        totals, found = block_events.simulate(
            self.blocks, replica, self.instants, records, told, keep
        )
        impulse, *others = totals.T
        names = ("block", "breaks", "blocks", "by_heat")
        columns = {
            "t": found["time"],
            "D": found["level"] / self.blocks.speed,
            **{name: found[name] for name in names},
            "drop": found["drop"] / records.shape[1],
            "before": found["before"] / records.shape[1],
        }
        breaks = int(records["breaks"][-1].sum())
        return _Replica(records, _Totals(impulse, *others), columns, breaks)


def _blocks_of(elastic: Elastic, n: int) -> Blocks:
    """Make blocks of n contacts each, to be prepared."""
    B = elastic.count
    h, tree = no_levels(B)
    return Blocks(
        position=np.empty((B, n)),
        contact=np.empty((B, n), np.int64),
        xi=np.empty(B * n),
        lives=np.empty(B * n, np.int64),
        h=h,
        births=np.zeros(B),
        squares=np.zeros(B),
        breaks=np.zeros(B, np.int64),
        last=np.zeros(B, np.int64),
        tree=tree,
    )


def _programme_of(drive: Drive | Programme, ensemble: Ensemble) -> Programme:
    """A constant drive as a programme of one segment."""
    if isinstance(drive, Programme):
        return drive
    segment = Segment(drive.velocity, distance=drive.over(ensemble))
    return Programme((segment,), elastic=drive.elastic)


def _batches(ensemble: Ensemble, drive: Drive | Programme, elastic: Elastic) -> int:
    """Number of batches of the second half of the last segment that are so long that
    they are independent; 0 or 1 of a plate that stands, or hardly moves."""
    path = _programme_of(drive, ensemble).segments[-1].path
    force = 0.5 / math.sqrt(ensemble.count)
    way = _CHANGES_OF_FORCE * force / float(np.mean(elastic.springs))
    found = 0.5 * path / ensemble.thresholds.mean / (_SHORTEST_BATCH + way)
    return int(min(found, _MOST_BATCHES))


def _passed(programme: Programme, grid: Grid) -> Array:
    """Segments that have passed at each instant of a grid (`block_events.Instants`)."""
    found = np.zeros(grid.t.size)
    for index, segment in enumerate(programme.segments):
        here = np.flatnonzero(grid.segment == index)
        if index == 0:
            here = here[1:]
        before = here[0] - 1
        way, whole = (
            (grid.X, segment.path) if segment.velocity else (grid.t, segment.duration)
        )
        found[here] = index + np.minimum((way[here] - way[before]) / whole, 1.0)
        found[here[-1]] = index + 1.0
    return found


def _expected(ensemble: Ensemble, programme: Programme, elastic: Elastic) -> float:
    """Lives of a replica of blocks that move once their springs balance friction."""
    path = sum(one.path for one in programme.segments)
    spring = float(np.mean(elastic.springs))
    friction = 0.5 * ensemble.thresholds.mean
    share = max(spring / (1.0 + spring), 1.0 - friction / (spring * path))
    segments = [
        replace(one, distance=share * one.path, time=None) if one.velocity else one
        for one in programme.segments
    ]
    rigid = replace(programme, segments=tuple(segments), elastic=None)
    return predicted_lives(ensemble, rigid, 1)


def _grid_of(drive: Drive | Programme, ensemble: Ensemble, points: int) -> Grid:
    """When the blocks are recorded."""
    if isinstance(drive, Programme):
        return drive.grid(points)
    D = np.linspace(0.0, drive.over(ensemble), points)
    return Grid(D / drive.velocity, D, np.zeros(points, np.int64))


def elastic_trajectory(
    ensemble: Ensemble,
    drive: Drive | Programme,
    *,
    points: int = 2001,
    seed: int = 1,
    replicas: int = 1,
    threads: int = 1,
    max_lives: float = 1e10,
    progress: Callable[[int], None] | None = None,
) -> ElasticTrajectory:
    """Simulate coupled blocks quasi-statically, break by break.

    A plate pulls them from a fresh start: all contacts pinned and unstretched.

    Parameters
    ----------
    ensemble : Ensemble
        N contacts of uniform stiffness, without delay and aging.
    drive : Drive or Programme
        Drive of the plate over a distance (length), with the blocks that it pulls
        (`drive.elastic`); at T = 0 its velocity (length/time) only tells time. Or a
        programme of velocities >= 0 and holds.
    points : int
        Number of records, equidistant in the displacement D of the plate from 0 and at
        growing times of holds.
    seed : int
        Seed of the random numbers.
    replicas : int
        Number of independent ensembles.
    threads : int
        Threads that share the replicas; they change no number.
    max_lives : float
        Work that is predicted to need more lives of contacts is refused before it
        starts, and stopped where it takes more than twice as many.
    progress : callable, optional
        `progress(lives)` is called now and then with the lives simulated so far.

    Returns
    -------
    ElasticTrajectory
        Displacements and forces F/(N k) in the length unit of the thresholds, times in
        that of the velocity.

    Raises
    ------
    InputError
        For contacts that time changes, contacts that cannot be divided among the
        blocks, arguments out of range, and more lives than `max_lives` allows.

    Examples
    --------
    >>> ensemble = Ensemble(count=200, stiffness_law="uniform")
    >>> chain = Elastic(blocks=20, coupling=1.0, drive_stiffness=0.5)
    >>> drive = Drive(velocity=1.0, distance=5.0, elastic=chain)
    >>> found = elastic_trajectory(ensemble, drive, points=11)
    >>> found.D[-1], found.force.shape
    (np.float64(5.0), (11,))
    >>> int(found.avalanches["breaks"].sum()) + 200 == found.lives
    True
    """
    output = Output(points, seed, replicas)
    _, expected = check_elastic(ensemble, drive, output, max_lives)
    guard = guarded(progress, expected, max_lives)
    return simulate_blocks(ensemble, drive, output, threads, guard)


def simulate_blocks(
    ensemble: Ensemble,
    drive: Drive | Programme,
    output: Output,
    threads: int,
    progress: Callable[[int], None] | None,
    keep: Keep | None = None,
) -> ElasticTrajectory:
    """Simulate `elastic_trajectory` of what `check_elastic` has not refused; `keep` is
    where the states of its replicas are, if a run that was stopped is to go on."""
    elastic, points = drive.elastic, output.points
    seed, replicas = output.seed, output.replicas
    assert elastic
    unit, count = ensemble.thresholds.scale, ensemble.count
    heat = ensemble.thermal.active
    interface: _Interface | _WarmInterface
    if isinstance(drive, Programme) or elastic.follows_events(heat):
        interface = _WarmInterface.of(ensemble, drive, elastic, points, seed)
    else:
        interface = _Interface.of(ensemble, drive, elastic, points, seed)
    # Kernels are compiled here, so that seconds are those of the work.
    interruptibly(interface.begun().simulate, 0, lambda _: None)
    begin = time.perf_counter()
    lives = count * replicas

    def told(breaks: int) -> None:
        nonlocal lives
        lives += breaks
        if pool.stop[0]:
            raise CancelledError
        if progress:
            progress(lives)

    with ThreadPool(max(1, threads)) as pool:
        follow = partial(interface.simulate, told=told, keep=keep)
        runs = list(pool.map(follow, range(replicas)))
    seconds = time.perf_counter() - begin
    t, D, _ = _grid_of(drive, ensemble, points)
    records = np.array([run.records for run in runs])
    # over blocks
    X, force, variance = (records[name].mean(2) for name in ("X", "force", "variance"))
    X_std = force_std = None
    variance = variance.mean(axis=0) / count
    stderr = np.sqrt(variance) * unit
    if replicas > 1:
        X_std, force_std = (np.std(one, axis=0, ddof=1) * unit for one in (X, force))
        stderr = force_std / math.sqrt(replicas)
    X, force = X.mean(axis=0), force.mean(axis=0)
    unmet = interface.net_drop * unmet_force(variance, force, count) / replicas
    stderr = np.maximum(stderr, unmet * unit)
    estimates = _estimates(runs, unit, _batches(ensemble, drive, elastic) > 1)
    error = (estimates[0].stderr or 0.0) / unit
    second_half = float(np.mean([run.totals.moved[0] for run in runs])), float(X[-1])
    if isinstance(interface, _Interface):
        over = _transient_is_over(interface.laws, second_half, error)
    else:
        over = second_half[0] > _FORGOTTEN * ensemble.thresholds.mean / unit
    averages = [replace(one, reliable=one.reliable and over) for one in estimates]
    friction, size, single = averages
    pace = max(one.velocity for one in _programme_of(drive, ensemble).segments)
    for columns in (run.avalanches for run in runs):
        for name in _LENGTHS & columns.keys():
            columns[name] = columns[name] * unit
        columns["t"] = columns["t"] / pace
    blocks = by_replica([_of_blocks(run.records, t, D, unit) for run in runs])
    return ElasticTrajectory(
        D=D,
        t=t,
        X=X * unit,
        force=force * unit,
        force_stderr=stderr,
        force_reliable=replicas >= _RELIABLE_FROM,
        force_replica_std=force_std,
        X_replica_std=X_std,
        friction=friction,
        size=size,
        single=single,
        avalanches=by_replica([run.avalanches for run in runs]),
        blocks=blocks,
        lives=count * replicas + sum(run.breaks for run in runs),
        seed=seed,
        engine_seconds=seconds,
        threads=max(1, min(threads, replicas)),
    )


def _estimates(
    runs: list[_Replica], unit: float, apart: bool
) -> tuple[Estimate, Estimate, Estimate]:
    """Estimate friction (length), breaks per avalanche, fraction of single breaks.
    Batches of a replica are independent if they are `apart`."""
    batches = _Totals(*np.diff(np.stack([run.totals for run in runs], axis=1), axis=2))
    half = batches.X.shape[1] // 2
    breaks = int(batches.breaks.sum())

    def halves(column: Array) -> Array:
        return np.stack((column[:, :half].ravel(), column[:, -half:].ravel()), axis=1)

    def over(numerator: Array, denominator: Array) -> Estimate:
        parts = np.stack((numerator, denominator))
        if not apart and len(runs) > 1:
            parts = parts.sum(axis=2)
        above, below = parts.reshape(2, -1)
        estimate = ratio(above, below, breaks)
        reliable = estimate.reliable and above.size >= _RELIABLE_FROM
        reliable = reliable and not drifts(halves(numerator), halves(denominator), 4.0)
        return replace(estimate, reliable=reliable)

    def per_avalanche(numerator: Array) -> Estimate:
        estimate = over(numerator, batches.avalanches)
        if estimate.stderr is None:
            return estimate
        unmet = _UNMET / float(batches.avalanches.sum())
        return replace(estimate, stderr=math.hypot(estimate.stderr, unmet))

    return (
        over(batches.area * unit, batches.X),
        per_avalanche(batches.breaks),
        per_avalanche(batches.singles),
    )


def _transient_is_over(
    laws: Contacts, second_half: tuple[float, float], error: float
) -> bool:
    """True if the start moves friction from one X to another, those of the second half,
    by less than half its error. Taken from independent contacts, whose law is exact."""
    born = births(laws)
    level = scatter(laws, born, None, 0.0)
    late = scatter(laws, born, second_half[1], 0.0)
    moments = late.at(np.linspace(*second_half, 1025))
    change = abs(np.mean(moments.mean) - level.mean[0])
    return bool(change <= 0.5 * error + 1e-9 * level.mean[0])


def _of_blocks(records: Array, t: Array, D: Array, unit: float) -> dict[str, Array]:
    """Records of the blocks of a replica, (points, B), by column in the user's units."""
    points, blocks = records.shape
    return {
        "t": np.repeat(t, blocks),
        "D": np.repeat(D, blocks),
        "block": np.tile(np.arange(blocks), points),
        "X": records["X"].ravel() * unit,
        "force": records["force"].ravel() * unit,
        "breaks": records["breaks"].ravel(),
    }
