"""Coupled blocks that a plate pulls infinitely slowly at T = 0: one break after another, each by a contact's own life.

Force and displacement of every block are linear between breaks (`model.elastic`), X_j = q D + Y_j with q = K_d/(K_d +
n k), and a break of stretch xi at block i adds G_ji k xi to Y_j. So block j breaks next when the plate's share q D, the
level, has risen to its threshold h_j = (where its next contact breaks) - Y_j: until the least of all the plate moves,
and as long as one is below the level an avalanche goes on. Which of those breaks first makes no difference: F_j
depends on the past through X_j alone, and breaks only ever move blocks forward (an Abelian sandpile).

Positions are whole multiples of a `unit` of some 1e-15 of the distance, so that what breaks add to Y_j adds up to the
same bits in any order. One run belongs to one thread; threads share replicas.
"""

import math
import time
from collections.abc import Callable
from concurrent.futures import CancelledError
from dataclasses import dataclass, replace
from typing import ClassVar, NamedTuple

import numpy as np

from eqsim.engine.avalanches import Queue, longer, put_back
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

_SEGMENT = 32  # blocks whose least threshold is kept
_BATCHES, _LONG = 16, 1.5  # of a run's second half, at most; and how long they are at least, in mean thresholds
_ENOUGH = 8  # batches whose scatter says something about their mean
_BETWEEN_PAUSES = 1e6  # breaks
_MOST_RECORDS, _MOST_AVALANCHES = 20_000_000, 30_000_000  # kept in memory


class Blocks(NamedTuple):
    """Where contacts break next, a heap for each block, and which contact that is, arrays (B, n); threshold and number
    of lives of contacts (B n,). Of blocks, with room to a multiple of `_SEGMENT`: threshold `h`; and (B,): sums over
    contacts of the positions of births and of their squares, breaks, and the last avalanche they were part of. `least`
    is a tree of the least h, whose leaves are segments of blocks."""

    at: Array
    contact: Array
    xi: Array
    lives: Array
    h: Array
    births: Array
    squares: Array
    breaks: Array
    seen: Array
    least: Array


class Response(NamedTuple):
    """`Elastic.response`, how far it reaches in each of its rows, columns and rows of the lattice, whether its edges
    are periodic, and the unit of positions."""

    G: Array
    reach: Array
    nx: int
    ny: int
    periodic: bool
    unit: float


# what is carried along: the level q D; of the avalanche that goes on the block where it began, breaks, blocks and the
# stretches that it has released; avalanches and breaks so far, avalanches of one break; and sum of xi^2/2
LEVEL, _BEGAN, _SIZE, _BLOCKS, _RELEASED, AVALANCHES, BREAKS, SINGLE, WORK = range(9)


@routine(inline=True)
def _rounded(x: float, unit: float) -> float:
    """The nearest multiple of a power of 2."""
    big = unit * 6755399441055744.0  # 1.5 * 2^52
    return (x + big) - big


@kernel
def prepare(c: Contacts, stream: Key, first: int, unit: float, b: Blocks) -> None:
    """All contacts pinned, all blocks at 0. The first contact of all is `first`."""
    n = b.at.shape[1]
    for j in range(b.at.shape[0]):
        for i in range(n):
            contact = j * n + i
            xi, _, _ = draw_birth(c.newborn, c, stream, first + contact, 0)
            b.xi[contact], b.lives[contact] = _rounded(xi, unit), 1
        order = np.argsort(b.xi[j * n : (j + 1) * n])
        for i in range(n):
            b.at[j, i], b.contact[j, i] = b.xi[j * n + order[i]], j * n + order[i]
        b.h[j] = b.at[j, 0]
    leaves = b.least.size // 2
    for s in range(b.h.size // _SEGMENT):
        b.least[leaves + s] = b.h[s * _SEGMENT : (s + 1) * _SEGMENT].min()
    for node in range(leaves - 1, 0, -1):
        b.least[node] = min(b.least[2 * node], b.least[2 * node + 1])


@routine(inline=True)
def _push(b: Blocks, r: Response, row: int, begin: int, end: int, offset: int, force: float, first: int) -> None:
    """Move the blocks first + begin, ... of a row of the lattice by what row `row` of the response says from `offset`
    on, and mend the tree. Loops over unsigned numbers vectorise: these do not count from the end."""
    big = r.unit * 6755399441055744.0
    start, shift = np.uint64(first + begin), np.uint64(offset + begin)
    for k in range(np.uint64(end - begin)):
        b.h[start + k] -= (r.G[row, shift + k] * force + big) - big
    leaves = b.least.size // 2
    low, high = (first + begin) // _SEGMENT, (first + end - 1) // _SEGMENT
    for s in range(low, high + 1):
        at = np.uint64(s * _SEGMENT)
        m0, m1, m2, m3 = b.h[at], b.h[at + np.uint64(1)], b.h[at + np.uint64(2)], b.h[at + np.uint64(3)]
        for k in range(np.uint64(1), np.uint64(_SEGMENT // 4)):
            j = at + np.uint64(4) * k
            h0, h1, h2, h3 = b.h[j], b.h[j + np.uint64(1)], b.h[j + np.uint64(2)], b.h[j + np.uint64(3)]
            m0, m1 = h0 if h0 < m0 else m0, h1 if h1 < m1 else m1
            m2, m3 = h2 if h2 < m2 else m2, h3 if h3 < m3 else m3
        m0, m2 = m1 if m1 < m0 else m0, m3 if m3 < m2 else m2
        b.least[leaves + s] = m2 if m2 < m0 else m0
    low, high, changed = (leaves + low) // 2, (leaves + high) // 2, True
    while changed and low > 0:
        changed = False
        for node in range(low, high + 1):
            one, other = b.least[2 * node], b.least[2 * node + 1]
            least = other if other < one else one
            changed |= least != b.least[node]
            b.least[node] = least
        low, high = low // 2, high // 2


@routine(inline=True)
def _spread(b: Blocks, r: Response, block: int, force: float) -> None:
    """Move all blocks by what a drop of the force at `block` makes, over n k."""
    nx, ny = r.nx, r.ny
    x, y = block % nx, block // nx
    middle, around_x, around_y = r.G.shape[1] // 2, nx if r.periodic else 2 * nx, ny if r.periodic else 2 * ny
    far = r.G.shape[0] // 2
    for dy in range(-min(far, (around_y - 1) // 2), min(far, around_y // 2) + 1):
        row, line = far + dy, y + dy
        if line < 0:
            line = line + ny if r.periodic else -1 - line
        elif line >= ny:
            line = line - ny if r.periodic else 2 * ny - 1 - line
        first, reach = line * nx, r.reach[row]
        left, right = min(reach, (around_x - 1) // 2), min(reach, around_x // 2)
        _push(b, r, row, max(0, x - left), min(nx, x + right + 1), middle - x, force, first)
        if x < left:  # around the ring, or the mirror image at the edge
            if r.periodic:
                _push(b, r, row, nx + x - left, nx, middle - x - nx, force, first)
            else:
                _push(b, r, row, 0, left - x, middle + x + 1, force, first)
        if x + right >= nx:
            if r.periodic:
                _push(b, r, row, 0, x + right + 1 - nx, middle - x + nx, force, first)
            else:
                _push(b, r, row, 2 * nx - 1 - x - right, nx, middle + x + 1 - 2 * nx, force, first)


@routine(inline=True)
def _lowest(b: Blocks) -> int:
    """The block that breaks next."""
    leaves = b.least.size // 2
    node, least = 1, b.least[1]
    while node < leaves:
        node = 2 * node if b.least[2 * node] == least else 2 * node + 1
    j = (node - leaves) * _SEGMENT
    while b.h[j] != least:
        j += 1
    return j


@kernel
def load(c: Contacts, stream: Key, first: int, b: Blocks, r: Response, now: Array, until: float) -> Array:
    """Raise the level to `until`, and `now` (9,) with it. Returns the avalanches on the way, of each the level, the
    block where it began, breaks, blocks and the sum of stretches at breaking, shape (avalanches, 5)."""
    rows, events, n = 0, np.empty((64, 5)), b.at.shape[1]
    while True:
        least = b.least[1]
        if least > now[LEVEL]:
            if now[_SIZE] > 0.0:
                if rows == events.shape[0]:
                    events = longer(events)
                for k in range(5):
                    events[rows, k] = now[LEVEL + k]
                rows += 1
                now[SINGLE] += now[_SIZE] == 1.0
                now[_SIZE] = 0.0
            if least > until:
                now[LEVEL] = until
                return events[:rows]
            now[LEVEL], now[_BEGAN], now[_BLOCKS], now[_RELEASED] = least, _lowest(b), 0.0, 0.0
            now[AVALANCHES] += 1.0
        block = _lowest(b)
        contact, at = b.contact[block, 0], b.at[block, 0]
        xi = b.xi[contact]
        b.births[block] += xi
        b.squares[block] += xi * (2.0 * at - xi)
        b.breaks[block] += 1
        if b.seen[block] != now[AVALANCHES]:
            b.seen[block] = now[AVALANCHES]
            now[_BLOCKS] += 1.0
        now[_SIZE] += 1.0
        now[BREAKS] += 1.0
        now[_RELEASED] += xi
        now[WORK] += 0.5 * xi * xi
        drawn, _, _ = draw_birth(c.newborn, c, stream, first + contact, b.lives[contact])
        b.xi[contact] = _rounded(drawn, r.unit)
        b.lives[contact] += 1
        put_back(Queue(b.at[block], b.contact[block]), at + b.xi[contact])
        b.h[block] += b.at[block, 0] - at
        _spread(b, r, block, xi / n)


@dataclass(frozen=True, repr=False)
class ElasticTrajectory(Result):
    """What coupled blocks do while the plate moves. Forces and displacements are means over blocks and replicas.

    Attributes
    ----------
    D, t : ndarray, shape (points,)
        Displacement of the plate (length) and time.
    X, force : ndarray, shape (points,)
        Mean displacement of the blocks, and F/(N k) (length).
    force_stderr : ndarray, shape (points,)
        Of `force`: from the scatter between replicas; of a single ensemble, what independent contacts at the same
        displacements would have.
    force_reliable : bool
        Whether there are replicas enough (8): contacts at the same X do not know how far that is from those of others.
    force_replica_std, X_replica_std : ndarray, shape (points,), or None
        Standard deviations between replicas, if there are several.
    friction, size, single : Estimate
        Over the second half of the plate's way, from batches of it: int F dX/Delta X of all blocks (length), breaks per
        avalanche, and the fraction of avalanches that are a single break.
    avalanches : dict of ndarray
        By column: time `t`, plate `D` (length), `block` where it began, `breaks`, `blocks` that broke, `drop` of
        F/(N k) (length), and the `replica`.
    blocks : dict of ndarray
        A row for each record of each block: `t`, `D`, `block`, its displacement `X`, its force `force` = F_j/(n k)
        (lengths), `breaks` so far, and the `replica`.
    lives : int
        Lives of contacts that were simulated.
    seed, engine_seconds, threads
        How it was computed.
    """

    drawn: ClassVar[Drawn] = Drawn(
        "D", "force", "force_stderr", "displacement of the plate  D", "friction force  F/(N k)"
    )
    D: Array
    t: Array
    X: Array
    force: Array
    force_stderr: Array
    force_reliable: bool
    force_replica_std: Array | None
    X_replica_std: Array | None
    friction: Estimate
    size: Estimate
    single: Estimate
    avalanches: dict[str, Array]
    blocks: dict[str, Array]
    lives: int
    seed: int
    engine_seconds: float
    threads: int

    def columns(self) -> dict[str, Array]:
        """The arrays by name, standard deviations only if there are replicas."""
        names = ("t", "D", "X", "force", "force_stderr", "force_replica_std", "X_replica_std")
        return {name: column for name in names if (column := getattr(self, name)) is not None}


def check_elastic(
    ensemble: Ensemble, drive: Drive, output: tuple[int, int, int], max_lives: float
) -> tuple[Elastic, float]:
    """The blocks of a run and its predicted lives; `output` holds points, seed and replicas. Raises InputError if
    contacts are not those of the quasi-static model, or if it takes more than `max_lives` lives or too much memory."""
    points, _, replicas = output
    check_output(*output)
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
            raise InputError(f"{said} with [elastic], whose blocks move quasi-statically at T = 0: {why}")
    distance = drive.over(ensemble) / ensemble.thresholds.mean
    require_number("distance / threshold", distance, least=1e-6, most=1e6)
    lives = ensemble.count * replicas * (1.0 + distance)
    if not lives <= max_lives:
        raise InputError(f"this run needs about {lives:.3g} lives, more than max_lives = {max_lives:.3g}")
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


class _Replica(NamedTuple):
    """What an ensemble leaves: X, force, variance of the mean force at records (3, points); X_j, F_j and breaks of
    blocks (3, points, B); sums at the ends of batches (batches + 1, 5) of int F dX, X, breaks, avalanches and single
    breaks; avalanches as `load` has them; breaks."""

    means: Array
    blocks: Array
    sums: Array
    avalanches: Array
    breaks: int


class _Interface(NamedTuple):
    """Contacts and blocks as kernels see them; lengths in units of the threshold law's scale."""

    c: Contacts
    stream: Key
    contacts: int
    elastic: Elastic
    response: Response
    levels: Array  # of records
    edges: Array  # of batches, levels
    pauses: Array  # levels at which a signal may stop the run


def _blocks_of(elastic: Elastic, n: int) -> Blocks:
    """Room for the blocks."""
    B = elastic.count
    segments = -(-B // _SEGMENT)
    leaves = 1 << (segments - 1).bit_length()
    return Blocks(
        at=np.empty((B, n)), contact=np.empty((B, n), np.int64), xi=np.empty(B * n), lives=np.empty(B * n, np.int64),
        h=np.full(segments * _SEGMENT, math.inf), births=np.zeros(B), squares=np.zeros(B),
        breaks=np.zeros(B, np.int64), seen=np.zeros(B), least=np.full(2 * leaves, math.inf),
    )  # fmt: skip


def _response_of(elastic: Elastic, distance: float) -> Response:
    """For a plate that moves so far; 51 bits hold every position."""
    G = elastic.response()
    middle = G.shape[1] // 2
    reach = np.array([np.max(np.abs(np.flatnonzero(row) - middle), initial=0) for row in G])
    unit = 2.0 ** (math.ceil(math.log2(distance + 16.0)) - 51)
    return Response(G, reach, *elastic.shape, elastic.edges == "periodic", unit)


def _simulate(interface: _Interface, replica: int, told: Callable[[int], None]) -> _Replica:
    """Follow one ensemble, and tell now and then how many breaks there were since."""
    c, stream, count, elastic, response, levels, edges, pauses = interface
    n, first = count // elastic.count, replica * count
    b, now = _blocks_of(elastic, n), np.zeros(9)
    prepare(c, stream, first, response.unit, b)
    means, blocks, sums, events = [], [], [], []
    for level in np.unique(np.concatenate((levels, edges, pauses))):
        before = now[BREAKS]
        events.append(load(c, stream, first, b, response, now, level))
        told(int(now[BREAKS] - before))
        X = b.at[:, 0] - b.h[: elastic.count] + level
        force = X - b.births / n
        if level in levels:
            scatter_of = np.maximum(b.squares / n - (b.births / n) ** 2, 0.0)
            means.append((X.mean(), force.mean(), scatter_of.mean() / count))
            blocks.append((X, force, b.breaks.copy()))
        if level in edges:
            stored = 0.5 * (n * X**2 - 2.0 * X * b.births + b.squares)
            area = (now[WORK] + stored.sum()) / n
            sums.append((area, X.sum(), now[BREAKS], now[AVALANCHES], now[SINGLE]))
    return _Replica(
        np.array(means).T, np.array(blocks).swapaxes(0, 1), np.array(sums), np.concatenate(events), int(now[BREAKS])
    )


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
    """Simulate coupled blocks quasi-statically at T = 0 from a fresh start, every avalanche break by break.

    Parameters
    ----------
    ensemble : Ensemble
        N contacts of uniform stiffness at T = 0, without delay and aging.
    drive : Drive
        Of the plate, with the blocks that it pulls; its velocity only tells time.
    points : int
        Records, equidistant in D from 0.
    seed : int
        Of the random numbers; the result depends on nothing else.
    replicas : int
        Independent ensembles.
    threads : int
        That share the replicas; they change no number.
    max_lives : float
        Work that needs more lives of contacts is refused.
    progress : callable, optional
        `progress(lives)` is told now and then how many lives have been simulated.

    Returns
    -------
    ElasticTrajectory

    Raises
    ------
    InputError
        For contacts that heat or time breaks, contacts that cannot be divided among the blocks, arguments out of range,
        and if more than `max_lives` lives are predicted.
    """
    elastic, _ = check_elastic(ensemble, drive, (points, seed, replicas), max_lives)
    unit, mean = ensemble.thresholds.scale, ensemble.thresholds.mean
    distance, share = drive.over(ensemble), 1.0 - elastic.load  # of the plate's motion that blocks follow at once
    levels = np.linspace(0.0, distance / unit * share, points)
    batches = int(np.clip(0.5 * distance / mean / _LONG, 2, _BATCHES))
    edges = np.linspace(0.5 * levels[-1], levels[-1], batches + 1)
    c, count = contacts(ensemble, drive.velocity), ensemble.count
    pauses = np.linspace(0.0, levels[-1], 1 + math.ceil(count * distance / mean / _BETWEEN_PAUSES))
    response = _response_of(elastic, distance / unit)
    interface = _Interface(c, key(seed, TRAJECTORY), count, elastic, response, levels, edges, pauses)
    nothing = interface._replace(contacts=elastic.count, levels=levels[:1], edges=edges[:0], pauses=pauses[:0])
    interruptibly(_simulate, nothing, 0, lambda _: None)  # compiles, so that seconds are those of the work
    begin = time.perf_counter()
    found = _all(interface, replicas, threads, progress)
    seconds = time.perf_counter() - begin
    t = np.linspace(0.0, distance / drive.velocity, points)
    D = np.linspace(0.0, distance, points)
    means = np.mean([one.means for one in found], axis=0)
    spread = np.std([one.means for one in found], axis=0, ddof=1) * unit if replicas > 1 else None
    stderr = np.sqrt(means[2]) * unit if spread is None else spread[1] / math.sqrt(replicas)
    estimates = _estimates(found, unit)
    over = _transient_is_over(c, means[0], (estimates[0].stderr or 0.0) / unit)
    friction, size, single = (replace(one, reliable=one.reliable and over) for one in estimates)
    return ElasticTrajectory(
        D=D,
        t=t,
        X=means[0] * unit,
        force=means[1] * unit,
        force_stderr=stderr,
        force_reliable=replicas >= _ENOUGH,
        force_replica_std=None if spread is None else spread[1],
        X_replica_std=None if spread is None else spread[0],
        friction=friction,
        size=size,
        single=single,
        avalanches=_avalanches([one.avalanches for one in found], unit, share, (count, drive.velocity)),
        blocks=_of_blocks([one.blocks for one in found], t, D, unit),
        lives=count * replicas + sum(one.breaks for one in found),
        seed=seed,
        engine_seconds=seconds,
        threads=max(1, min(threads, replicas)),
    )


def _all(interface: _Interface, replicas: int, threads: int, progress: Callable[[int], None] | None) -> list[_Replica]:
    """Hand replicas to threads as they become free."""
    done = [interface.contacts * replicas]

    def told(breaks: int) -> None:
        done[0] += breaks
        if pool.stop[0]:
            raise CancelledError
        if progress:
            progress(done[0])

    with ThreadPool(max(1, threads)) as pool:
        return list(pool.map(lambda replica: _simulate(interface, replica, told), range(replicas)))


def _estimates(found: list[_Replica], unit: float) -> tuple[Estimate, Estimate, Estimate]:
    """Friction over displacement (in the user's unit of length), breaks per avalanche and the fraction of single
    breaks, from batches."""
    parts = np.stack([np.diff(one.sums, axis=0) for one in found])  # (replicas, batches, 5)
    half = parts.shape[1] // 2
    area, X, breaks, events, single = np.moveaxis(parts, 2, 0)

    def over(numerator: Array, denominator: Array) -> Estimate:
        estimate = ratio(numerator.ravel(), denominator.ravel(), int(breaks.sum()))
        top, bottom = (
            np.stack((one[:, :half].ravel(), one[:, -half:].ravel()), axis=1) for one in (numerator, denominator)
        )
        enough = numerator.size >= _ENOUGH
        return replace(estimate, reliable=estimate.reliable and enough and not drifts(top, bottom, 4.0))

    return over(area * unit, X), over(breaks, events), over(single, events)


def _transient_is_over(c: Contacts, X: Array, error: float) -> bool:
    """Whether the fresh start, as the law expects it, moves the friction of the second half by less than half of its
    `error`."""
    born = births(c)
    level, law = scatter(c, born, None, 0.0), scatter(c, born, float(X[-1]), 0.0)
    late = law.at(np.linspace(X[X.size // 2], X[-1], 1025))
    return bool(abs(np.mean(late.mean) - level.mean[0]) <= 0.5 * error + 1e-9 * level.mean[0])


def _avalanches(found: list[Array], unit: float, share: float, run: tuple[int, float]) -> dict[str, Array]:
    """Those of all replicas by column, in the user's units; `run` holds contacts and velocity. Force is lost by breaks,
    and gained by the motion that they cause: a fraction `share` of the loss is left."""
    count, velocity = run
    level, block, breaks, blocks, released = np.concatenate(found).T
    D = level * (unit / share)
    return {
        "t": D / velocity, "D": D, "block": block.astype(np.int64), "breaks": breaks.astype(np.int64),
        "blocks": blocks.astype(np.int64), "drop": released * (unit * share / count),
        "replica": np.repeat(np.arange(len(found)), [len(one) for one in found]),
    }  # fmt: skip


def _of_blocks(found: list[Array], t: Array, D: Array, unit: float) -> dict[str, Array]:
    """Records of all blocks by column, in the user's units."""
    _, points, blocks = found[0].shape
    X, force, breaks = (np.concatenate([one[k].ravel() for one in found]) for k in range(3))
    each = points * blocks
    return {
        "t": np.tile(np.repeat(t, blocks), len(found)), "D": np.tile(np.repeat(D, blocks), len(found)),
        "block": np.tile(np.arange(blocks), points * len(found)), "X": X * unit, "force": force * unit,
        "breaks": breaks.astype(np.int64), "replica": np.repeat(np.arange(len(found)), each),
    }  # fmt: skip
