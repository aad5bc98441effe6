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

import math
import time
from collections.abc import Callable
from concurrent.futures import CancelledError
from dataclasses import dataclass, replace
from typing import ClassVar, NamedTuple

import numpy as np

from eqsim.engine.avalanches import events_of, put_back
from eqsim.engine.contacts import Contacts, contacts
from eqsim.engine.lanes import draw_birth
from eqsim.engine.scatter import births, scatter
from eqsim.errors import InputError, require_number
from eqsim.estimate import Estimate, drifts, ratio
from eqsim.model.drive import Drive, check_output
from eqsim.model.elastic import Elastic
from eqsim.model.ensemble import Ensemble
from eqsim.numerics.compiled import kernel, routine
from eqsim.numerics.streams import TRAJECTORY, Key, key
from eqsim.numerics.tables import Array
from eqsim.numerics.threads import ThreadPool, interruptibly
from eqsim.results import Drawn, Result

_SEGMENT = 32  # blocks whose lowest threshold is a leaf of the tree
_BATCHES = 16  # of the second half of a run, at most, whose scatter tells the error
_SHORTEST_BATCH = 1.5  # displacement of the plate, in mean thresholds
_ENOUGH = 8  # batches or replicas whose scatter tells the error of their mean
_BETWEEN_PAUSES = 1e6  # breaks between moments at which a signal may stop a run
_MOST_RECORDS = 20_000_000  # of all blocks and replicas: some 1 GB of memory
_MOST_AVALANCHES = 30_000_000  # of all replicas: some 2 GB of memory
_ROUNDING = 6755399441055744.0  # 1.5 * 2^52, beside which only whole numbers are left

# The run so far, and the avalanche that goes on.
STATE = np.dtype(
    [
        ("level", np.float64),  # q D
        ("block", np.int64),  # where the avalanche began
        ("size", np.int64),  # its breaks so far; 0 if none goes on
        ("blocks", np.int64),  # that it has broken contacts of
        ("released", np.float64),  # sum of its stretches at breaking
        ("avalanches", np.int64),  # so far, as all that follows
        ("singles", np.int64),  # avalanches of one break
        ("breaks", np.int64),
        ("work", np.float64),  # sum of xi^2/2
    ]
)

# An avalanche.
EVENT = np.dtype(
    [
        ("level", np.float64),
        ("block", np.int64),  # where it began
        ("breaks", np.int64),
        ("blocks", np.int64),  # with at least one of its breaks
        ("released", np.float64),  # sum of stretches at breaking
    ]
)

# A block at an instant.
RECORD = np.dtype(
    [
        ("X", np.float64),
        ("force", np.float64),
        ("variance", np.float64),  # of the force of a contact, if they were independent
        ("breaks", np.int64),  # so far
    ]
)


class Blocks(NamedTuple):
    """Contacts and blocks: B blocks of n contacts."""

    position: Array  # (B, n), a heap for each block: where contacts break next
    contact: Array  # (B, n), which ones
    xi: Array  # (B n,), thresholds of contacts
    lives: Array  # (B n,), that have been drawn
    h: Array  # thresholds of blocks, with room to a multiple of `_SEGMENT`
    births: Array  # (B,), sum over contacts of the positions of their births
    squares: Array  # (B,), of the squares of these
    breaks: Array  # (B,), so far
    last: Array  # (B,), avalanche that has broken contacts
    tree: Array  # lowest thresholds, a binary tree from node 1 on


class Response(NamedTuple):
    """The response of all blocks to a break, on their lattice."""

    G: Array  # `Elastic.response`
    reach: Array  # of each row of G
    nx: int  # columns
    ny: int  # rows
    periodic: bool
    unit: float  # that positions are multiples of, a power of 2


@routine(inline=True)
def _rounded(x: float, unit: float) -> float:
    """Nearest multiple of a power of 2."""
    big = unit * _ROUNDING
    return (x + big) - big


@kernel
def prepare(laws: Contacts, stream: Key, first: int, unit: float, b: Blocks) -> None:
    """Pin all contacts, of which the first is number `first`, with all blocks at 0."""
    blocks, n = b.position.shape
    for j in range(blocks):
        for contact in range(j * n, (j + 1) * n):
            xi = draw_birth(laws.newborn, laws, stream, first + contact, 0).threshold
            b.xi[contact] = _rounded(xi, unit)
            b.lives[contact] = 1
        order = np.argsort(b.xi[j * n : (j + 1) * n])
        for i in range(n):
            b.contact[j, i] = j * n + order[i]
            b.position[j, i] = b.xi[b.contact[j, i]]
        b.h[j] = b.position[j, 0]
    leaves = b.tree.size // 2
    for segment in range(b.h.size // _SEGMENT):
        begin = segment * _SEGMENT
        b.tree[leaves + segment] = b.h[begin : begin + _SEGMENT].min()
    for node in range(leaves - 1, 0, -1):
        b.tree[node] = min(b.tree[2 * node], b.tree[2 * node + 1])


@routine(inline=True)
def _push(
    b: Blocks,
    r: Response,
    row: int,
    begin: int,
    end: int,
    offset: int,
    force: float,
    first: int,
) -> None:
    """Move blocks first + begin to first + end of a row of the lattice, and mend the
    tree.

    The response of block first + k is `r.G[row, offset + k]`. Indices are unsigned, so
    that numba does not look for ones that count from the end, and loops vectorise. Four
    chains of minima do not wait for each other.
    """
    big = r.unit * _ROUNDING
    start = np.uint64(first + begin)
    shift = np.uint64(offset + begin)
    for k in range(np.uint64(end - begin)):
        b.h[start + k] -= (r.G[row, shift + k] * force + big) - big
    leaves = b.tree.size // 2
    low = (first + begin) // _SEGMENT
    high = (first + end - 1) // _SEGMENT
    for segment in range(low, high + 1):
        j = np.uint64(segment * _SEGMENT)
        m0 = b.h[j]
        m1 = b.h[j + np.uint64(1)]
        m2 = b.h[j + np.uint64(2)]
        m3 = b.h[j + np.uint64(3)]
        for _ in range(np.uint64(1), np.uint64(_SEGMENT // 4)):
            j += np.uint64(4)
            m0 = min(b.h[j], m0)
            m1 = min(b.h[j + np.uint64(1)], m1)
            m2 = min(b.h[j + np.uint64(2)], m2)
            m3 = min(b.h[j + np.uint64(3)], m3)
        b.tree[leaves + segment] = min(min(m0, m1), min(m2, m3))
    low = (leaves + low) // 2
    high = (leaves + high) // 2
    changed = True
    while changed and low > 0:
        changed = False
        for node in range(low, high + 1):
            lowest = min(b.tree[2 * node], b.tree[2 * node + 1])
            changed |= lowest != b.tree[node]
            b.tree[node] = lowest
        low //= 2
        high //= 2


@routine(inline=True)
def _spread(b: Blocks, r: Response, block: int, force: float) -> None:
    """Move all blocks after a drop of the force at `block`, which is divided by n k."""
    nx, ny = r.nx, r.ny
    x = block % nx
    y = block // nx
    middle = r.G.shape[1] // 2
    far = r.G.shape[0] // 2
    around_x = nx if r.periodic else 2 * nx
    around_y = ny if r.periodic else 2 * ny
    for dy in range(-min(far, (around_y - 1) // 2), min(far, around_y // 2) + 1):
        row = far + dy
        line = y + dy
        if line < 0:
            line = line + ny if r.periodic else -1 - line
        elif line >= ny:
            line = line - ny if r.periodic else 2 * ny - 1 - line
        left = min(r.reach[row], (around_x - 1) // 2)
        right = min(r.reach[row], around_x // 2)
        for image in range(-1, 2):  # around the ring, or mirrored at the edges
            if image == 0 or r.periodic:
                offset = middle - x + image * nx
                begin = max(0, middle - left - offset)
                end = min(nx, middle + right + 1 - offset)
            else:
                offset = middle + x + 1 - (image + 1) * nx
                begin = max(0, middle - right - offset)
                end = min(nx, middle + left + 1 - offset)
            if begin < end:
                _push(b, r, row, begin, end, offset, force, line * nx)


@routine(inline=True)
def _lowest(b: Blocks) -> int:
    """The block with the lowest threshold."""
    leaves = b.tree.size // 2
    lowest = b.tree[1]
    node = 1
    while node < leaves:
        node = 2 * node if b.tree[2 * node] == lowest else 2 * node + 1
    j = (node - leaves) * _SEGMENT
    while b.h[j] != lowest:
        j += 1
    return j


@kernel
def load(
    laws: Contacts,
    stream: Key,
    first: int,
    b: Blocks,
    r: Response,
    state: Array,
    until: float,
    events: Array,
) -> tuple[int, bool]:
    """Raise the level to `until`, and note the avalanches that end (`EVENT`).

    The first contact of all is number `first`; `state` (1,) is a `STATE`. Returns the
    number of avalanches, and False if there are more than `events` has room for.
    """
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
            now.block = _lowest(b)
            now.blocks = 0
            now.released = 0.0
            now.avalanches += 1
        block = _lowest(b)
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
        drawn = draw_birth(
            laws.newborn, laws, stream, first + contact, b.lives[contact]
        ).threshold
        b.xi[contact] = _rounded(drawn, r.unit)
        b.lives[contact] += 1
        put_back(b.position[block], b.contact[block], position + b.xi[contact])
        b.h[block] += b.position[block, 0] - position
        _spread(b, r, block, xi / n)


@dataclass(frozen=True, repr=False)
class ElasticTrajectory(Result):
    """Motion of coupled blocks while the plate moves, in the mean over blocks and
    replicas.

    Attributes
    ----------
    D, t : ndarray, shape (points,)
        Displacement of the plate (length) and time.
    X, force : ndarray, shape (points,)
        Mean displacement of the blocks, and F/(N k) (length).
    force_stderr : ndarray, shape (points,)
        Standard error of `force` from the scatter between replicas; of a single
        replica, that of independent contacts at the same displacements.
    force_reliable : bool
        Whether replicas are enough (8). One replica does not show how far its X is from
        that of others.
    force_replica_std, X_replica_std : ndarray, shape (points,), or None
        Standard deviations between replicas, if there are several.
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
    lives : int
        Number of lives of contacts that were simulated.
    seed, engine_seconds, threads
        Seed of the random numbers, seconds that kernels took, and threads.
    """

    drawn: ClassVar[Drawn] = Drawn(
        x="D",
        y="force",
        error="force_stderr",
        x_label="displacement of the plate  D",
        y_label="friction force  F/(N k)",
    )
    t: Array
    D: Array
    X: Array
    force: Array
    force_stderr: Array
    force_replica_std: Array | None
    X_replica_std: Array | None
    force_reliable: bool
    friction: Estimate
    size: Estimate
    single: Estimate
    avalanches: dict[str, Array]
    blocks: dict[str, Array]
    lives: int
    seed: int
    engine_seconds: float
    threads: int


def check_elastic(
    ensemble: Ensemble,
    drive: Drive,
    points: int,
    seed: int,
    replicas: int,
    max_lives: float,
) -> tuple[Elastic, float]:
    """Blocks of a run, and its predicted lives.

    Raises InputError if contacts are not those of the quasi-static model, or if the run
    takes more than `max_lives` lives or too much memory.
    """
    check_output(points, seed, replicas)
    elastic = drive.elastic
    if elastic is None:
        raise InputError("drive.elastic: is required, the blocks that the plate pulls")
    elastic.contacts_per_block(ensemble.count)
    thermal, aging = ensemble.thermal, ensemble.aging
    refused = (
        (thermal.kT * thermal.attempt_frequency > 0, f"thermal.kT = {thermal.kT!r}: must be 0", "heat needs time"),
        (ensemble.delay.time > 0, f"delay.time = {ensemble.delay.time!r}: must be 0", "a delay needs time"),
        (aging.active, f'aging.rule = "{aging.rule}": must be "none"', "aging needs time"),
        (ensemble.newborn.active, f'newborn.law = "{ensemble.newborn.law}": must be "unstressed"',
         "a contact born with more stretch than the last one broke with would move its block back"),
        (ensemble.eta > 0, f"viscosity.eta = {ensemble.eta!r}: must be 0", "viscous force needs a velocity"),
        (ensemble.stiffness_law != "uniform", f'contacts.stiffness_law = "{ensemble.stiffness_law}": must be "uniform"',
         "the response of blocks to a break would change with every break"),
        (drive.start != "fresh", f'drive.start = "{drive.start}": must be "fresh"',
         "the stationary state of coupled blocks is not known"),
    )  # fmt: skip
    for wrong, said, why in refused:
        if wrong:
            raise InputError(
                f"{said} with [elastic], whose blocks move quasi-statically at T = 0: {why}"
            )
    distance = drive.over(ensemble) / ensemble.thresholds.mean
    require_number("distance / threshold", distance, least=1e-6, most=1e6)
    lives = ensemble.count * replicas * (1.0 + distance)
    if not lives <= max_lives:
        raise InputError(
            f"this run needs about {lives:.3g} lives, more than max_lives = {max_lives:.3g}"
        )
    if points * elastic.count * replicas > _MOST_RECORDS:
        raise InputError(
            f"output.points = {points}: records of all blocks and replicas must be <= {_MOST_RECORDS:.0e} in number"
        )
    if lives / elastic.mean_size > _MOST_AVALANCHES:
        raise InputError(
            f"this run has about {lives / elastic.mean_size:.3g} avalanches, more than {_MOST_AVALANCHES:.0e}; "
            "fewer contacts.count or a shorter drive.distance has fewer"
        )
    return elastic, lives


class _Totals(NamedTuple):
    """Sums over blocks until the ends of batches, or in batches: arrays (..., batches)."""

    area: Array  # int F dX
    X: Array
    breaks: Array
    avalanches: Array
    singles: Array


class _Run(NamedTuple):
    """Record of a replica."""

    records: Array  # `RECORD`, shape (points, B)
    totals: _Totals
    avalanches: Array  # `EVENT`
    breaks: int


class _Interface(NamedTuple):
    """Contacts and blocks for kernels; lengths in units of the threshold law's scale."""

    laws: Contacts
    stream: Key
    contacts: int
    elastic: Elastic
    response: Response
    levels: Array  # of records
    edges: Array  # of batches, levels
    pauses: Array  # levels at which a signal may stop the run


def _blocks_of(elastic: Elastic, n: int) -> Blocks:
    """Blocks of n contacts each, to be prepared."""
    B = elastic.count
    segments = -(-B // _SEGMENT)
    leaves = 1 << (segments - 1).bit_length()
    return Blocks(
        position=np.empty((B, n)),
        contact=np.empty((B, n), np.int64),
        xi=np.empty(B * n),
        lives=np.empty(B * n, np.int64),
        h=np.full(segments * _SEGMENT, math.inf),
        births=np.zeros(B),
        squares=np.zeros(B),
        breaks=np.zeros(B, np.int64),
        last=np.zeros(B, np.int64),
        tree=np.full(2 * leaves, math.inf),
    )


def _response_of(elastic: Elastic, distance: float) -> Response:
    """Response for a plate that moves by `distance`; 51 bits hold every position."""
    G = elastic.response()
    middle = G.shape[1] // 2
    reach = np.array(
        [np.max(np.abs(np.flatnonzero(row) - middle), initial=0) for row in G]
    )
    unit = 2.0 ** (math.ceil(math.log2(distance + 16.0)) - 51)
    return Response(G, reach, *elastic.shape, elastic.edges == "periodic", unit)


def _simulate(interface: _Interface, replica: int, told: Callable[[int], None]) -> _Run:
    """Follow a replica. `told` is called now and then with the number of breaks since."""
    laws, stream, count, elastic, response, levels, edges, pauses = interface
    n = count // elastic.count
    first = replica * count
    b = _blocks_of(elastic, n)
    prepare(laws, stream, first, response.unit, b)
    state = np.zeros(1, STATE)
    now = state[0]
    records, totals, events = [], [], []
    for level in np.unique(np.concatenate((levels, edges, pauses))):
        before = int(now["breaks"])
        events.append(
            events_of(EVENT, load, laws, stream, first, b, response, state, level)
        )
        told(int(now["breaks"]) - before)
        X = b.position[:, 0] - b.h[: elastic.count] + level
        force = X - b.births / n
        if level in levels:
            record = np.empty(X.size, RECORD)
            record["X"] = X
            record["force"] = force
            record["variance"] = np.maximum(b.squares / n - (b.births / n) ** 2, 0.0)
            record["breaks"] = b.breaks
            records.append(record)
        if level in edges:
            stored = 0.5 * (n * X**2 - 2.0 * X * b.births + b.squares)
            area = (now["work"] + stored.sum()) / n
            counts = (now[name] for name in ("breaks", "avalanches", "singles"))
            totals.append((area, X.sum(), *counts))
    batches = _Totals(*np.reshape(totals, (-1, 5)).T)
    return _Run(np.array(records), batches, np.concatenate(events), int(now["breaks"]))


def elastic_trajectory(
    ensemble: Ensemble,
    drive: Drive,
    *,
    points: int = 2001,
    seed: int = 1,
    replicas: int = 1,
    threads: int = 1,
    max_lives: float = 1e10,
    progress: Callable[[int], None] | None = None,
) -> ElasticTrajectory:
    """Simulate coupled blocks quasi-statically at T = 0 from a fresh start, break by
    break.

    Parameters
    ----------
    ensemble : Ensemble
        N contacts of uniform stiffness at T = 0, without delay and aging.
    drive : Drive
        Drive of the plate, with the blocks that it pulls; its velocity only tells time.
    points : int
        Records, equidistant in D from 0.
    seed : int
        Seed of the random numbers.
    replicas : int
        Number of independent ensembles.
    threads : int
        Threads that share the replicas; they change no number.
    max_lives : float
        Most lives of contacts that may be simulated.
    progress : callable, optional
        `progress(lives)` is called now and then with the lives simulated so far.

    Returns
    -------
    ElasticTrajectory

    Raises
    ------
    InputError
        For contacts that heat or time breaks, contacts that cannot be divided among the
        blocks, arguments out of range, and more than `max_lives` predicted lives.
    """
    elastic, _ = check_elastic(ensemble, drive, points, seed, replicas, max_lives)
    unit, mean = ensemble.thresholds.scale, ensemble.thresholds.mean
    distance = drive.over(ensemble)
    share = 1.0 - elastic.load  # of the plate's motion that blocks follow at once
    levels = np.linspace(0.0, distance / unit * share, points)
    batches = int(np.clip(0.5 * distance / mean / _SHORTEST_BATCH, 2, _BATCHES))
    edges = np.linspace(0.5 * levels[-1], levels[-1], batches + 1)
    laws, count = contacts(ensemble, drive.velocity), ensemble.count
    pauses = np.linspace(
        0.0, levels[-1], 1 + math.ceil(count * distance / mean / _BETWEEN_PAUSES)
    )
    response = _response_of(elastic, distance / unit)
    interface = _Interface(
        laws, key(seed, TRAJECTORY), count, elastic, response, levels, edges, pauses
    )
    nothing = interface._replace(
        contacts=elastic.count, levels=levels[:1], edges=edges[:0], pauses=pauses[:0]
    )
    # Kernels are compiled here, so that seconds are those of the work.
    interruptibly(_simulate, nothing, 0, lambda _: None)
    begin = time.perf_counter()
    runs = _all(interface, replicas, threads, progress)
    seconds = time.perf_counter() - begin
    t = np.linspace(0.0, distance / drive.velocity, points)
    D = np.linspace(0.0, distance, points)
    records = np.array([run.records for run in runs])
    X, force = (records[name].mean(axis=2) for name in ("X", "force"))  # over blocks
    X_std = force_std = None
    stderr = np.sqrt(np.mean(records["variance"].mean(axis=2) / count, axis=0)) * unit
    if replicas > 1:
        X_std, force_std = (np.std(one, axis=0, ddof=1) * unit for one in (X, force))
        stderr = force_std / math.sqrt(replicas)
    X, force = X.mean(axis=0), force.mean(axis=0)
    estimates = _estimates(runs, unit)
    over = _transient_is_over(laws, X, (estimates[0].stderr or 0.0) / unit)
    friction, size, single = (
        replace(one, reliable=one.reliable and over) for one in estimates
    )
    return ElasticTrajectory(
        D=D,
        t=t,
        X=X * unit,
        force=force * unit,
        force_stderr=stderr,
        force_reliable=replicas >= _ENOUGH,
        force_replica_std=force_std,
        X_replica_std=X_std,
        friction=friction,
        size=size,
        single=single,
        avalanches=_avalanches(runs, unit, share, count, drive.velocity),
        blocks=_of_blocks(records, t, D, unit),
        lives=count * replicas + sum(run.breaks for run in runs),
        seed=seed,
        engine_seconds=seconds,
        threads=max(1, min(threads, replicas)),
    )


def _all(
    interface: _Interface,
    replicas: int,
    threads: int,
    progress: Callable[[int], None] | None,
) -> list[_Run]:
    """Hand replicas to threads as these become free."""
    lives = interface.contacts * replicas

    def told(breaks: int) -> None:
        nonlocal lives
        lives += breaks
        if pool.stop[0]:
            raise CancelledError
        if progress:
            progress(lives)

    with ThreadPool(max(1, threads)) as pool:
        return list(
            pool.map(
                lambda replica: _simulate(interface, replica, told), range(replicas)
            )
        )


def _estimates(runs: list[_Run], unit: float) -> tuple[Estimate, Estimate, Estimate]:
    """Estimate friction (length), breaks per avalanche and fraction of single breaks."""
    batches = _Totals(*np.diff(np.stack([run.totals for run in runs], axis=1), axis=2))
    half = batches.X.shape[1] // 2
    breaks = int(batches.breaks.sum())

    def halves(column: Array) -> Array:
        return np.stack((column[:, :half].ravel(), column[:, -half:].ravel()), axis=1)

    def over(numerator: Array, denominator: Array) -> Estimate:
        estimate = ratio(numerator.ravel(), denominator.ravel(), breaks)
        reliable = estimate.reliable and numerator.size >= _ENOUGH
        reliable = reliable and not drifts(halves(numerator), halves(denominator), 4.0)
        return replace(estimate, reliable=reliable)

    return (
        over(batches.area * unit, batches.X),
        over(batches.breaks, batches.avalanches),
        over(batches.singles, batches.avalanches),
    )


def _transient_is_over(laws: Contacts, X: Array, error: float) -> bool:
    """Whether the start moves the friction of the second half by less than half its
    error.

    The answer is that for independent contacts, whose law is exact.
    """
    born = births(laws)
    level = scatter(laws, born, None, 0.0)
    late = scatter(laws, born, float(X[-1]), 0.0)
    moments = late.at(np.linspace(X[X.size // 2], X[-1], 1025))
    change = abs(np.mean(moments.mean) - level.mean[0])
    return bool(change <= 0.5 * error + 1e-9 * level.mean[0])


def _avalanches(
    runs: list[_Run], unit: float, share: float, count: int, velocity: float
) -> dict[str, Array]:
    """Avalanches of all replicas by column, in the user's units.

    Force is lost by breaks and gained by the motion that they cause: a fraction `share`
    of the loss is left.
    """
    events = np.concatenate([run.avalanches for run in runs])
    sizes = [run.avalanches.size for run in runs]
    D = events["level"] * (unit / share)
    return {
        "t": D / velocity,
        "D": D,
        "block": events["block"],
        "breaks": events["breaks"],
        "blocks": events["blocks"],
        "drop": events["released"] * (unit * share / count),
        "replica": np.repeat(np.arange(len(runs)), sizes),
    }


def _of_blocks(records: Array, t: Array, D: Array, unit: float) -> dict[str, Array]:
    """Records of all blocks, (replicas, points, B), by column in the user's units."""
    replicas, points, blocks = records.shape
    return {
        "t": np.tile(np.repeat(t, blocks), replicas),
        "D": np.tile(np.repeat(D, blocks), replicas),
        "block": np.tile(np.arange(blocks), points * replicas),
        "X": records["X"].ravel() * unit,
        "force": records["force"].ravel() * unit,
        "breaks": records["breaks"].ravel(),
        "replica": np.repeat(np.arange(replicas), points * blocks),
    }
