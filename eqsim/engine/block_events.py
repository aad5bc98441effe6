"""Coupled blocks event by event: with heat, an edge that is pulled, or loads that vary
(derived).

Between two events all contacts stay pinned, and X_j = q_j D + Y_j with q_j =
sum_i G_ji K_i (`model.elastic`). A break of stretch x at block i adds G_ji k x to Y_j.
So block j gets to a position p when the level, D, is at h_j = D + (p - X_j)/q_j. Of a
lattice whose blocks are alike the level is q D, and q_j = 1. The level rises with the
plate; breaks that follow below the level are an avalanche, and take no time.

Breaks by heat are exact random times, drawn by thinning (Lewis and Shedler, 1979): up
to a position ahead, the wall, the rate of a contact is below its rate here, at the wall
or at its threshold, and that of an annealed contact below the greatest of its table.
Candidates come at the rate of the sum of these bounds, and one is a break with the
probability rate/bound. At its wall a block's bounds are renewed, so that nothing but
the time it takes depends on how far ahead walls are: twice as far as the last one if no
candidate was in vain on the way there, and half as far where too many are.

Lengths are in units of the threshold law's scale, time is displacement at the pace of
the plate. A run belongs to one thread.
"""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from scipy.sparse.linalg import splu

from eqsim.engine.avalanches import events_of
from eqsim.engine.contacts import Contacts
from eqsim.engine.contacts import contacts as laws_of
from eqsim.engine.keeping import Keep, State
from eqsim.engine.lanes import draw_birth
from eqsim.engine.lattice import (
    LEAF,
    Banded,
    Response,
    balance_of,
    lowest_block,
    no_levels,
    response_of,
    spread,
)
from eqsim.errors import InputError
from eqsim.laws.barrier.base import height, prefactor, rate, thermal
from eqsim.laws.barrier.pooled import Pooled, greatest_between
from eqsim.laws.stiffness import kappa
from eqsim.model.elastic import Elastic
from eqsim.model.ensemble import Ensemble
from eqsim.model.reduced import reduced
from eqsim.numerics.compiled import by_law, kernel, routine
from eqsim.numerics.streams import CANDIDATES, TRAJECTORY, Key, uniforms
from eqsim.numerics.streams import key as key_of
from eqsim.numerics.tables import Array

_NEGLIGIBLE = 1e-12  # share of a block's response to its own breaks
_COLUMNS = 256  # of a response that are solved for together
_LEAST_SHARE = 1e-290  # q_j of a block that the plate does not move
_MOST_NUMBERS = 1e8  # of a response: 1 GB of memory
_BEYOND = 1.0 + 1e-9  # factor on bounds, for their rounding
_CONSTANT = ("start", "share", "net_drop")  # of blocks
# e-folds of the rate of a contact between a block and its first wall
_FIRST_AHEAD = 0.5
_WIDEST = 1.0  # way of a block to a wall, in scales of the threshold law
# Candidates of a block that do not break on its way to a wall, after which the wall is
# too far away.
_MOST_REJECTED = 4
_ULP = 1.0 + np.finfo(float).eps  # factor to the next number, at least

# The run so far, and the avalanche that goes on.
STATE = np.dtype(
    [
        ("time", np.float64),  # since the last of the instants at which a run pauses
        ("level", np.float64),
        ("clock", np.float64),  # what is left until the next candidate
        ("candidates", np.int64),  # so far
        ("force", np.float64),  # sum of all stretches, over the contacts of a block
        ("impulse", np.float64),  # its integral over time
        ("block", np.int64),  # where the avalanche began
        ("size", np.int64),  # its breaks so far; 0 if none goes on
        ("blocks", np.int64),  # with at least one of its breaks
        ("by_heat", np.bool_),  # its first break
        ("before", np.float64),  # force before it
        ("avalanches", np.int64),  # so far, as all that follows
        ("singles", np.int64),  # avalanches of one break
        ("breaks", np.int64),
        ("unbounded", np.bool_),  # a rate was above its bound
    ],
    align=True,
)

# An avalanche.
AVALANCHE = np.dtype(
    [
        ("time", np.float64),
        ("level", np.float64),
        ("block", np.int64),  # where it began
        ("breaks", np.int64),
        ("blocks", np.int64),  # with at least one of its breaks
        ("by_heat", np.bool_),  # its first break
        ("before", np.float64),  # force before it
        ("drop", np.float64),
    ],
    align=True,
)


class Blocks(NamedTuple):
    """Contacts and blocks: B blocks of N contacts, block j those from `start[j]` on."""

    birth: Array  # (N,), positions of the blocks at births of contacts
    xi: Array  # (N,), thresholds
    bound: Array  # (N,), of rates, up to the wall
    lives: Array  # (N,), that have been drawn
    start: Array  # (B + 1,)
    wall: Array  # (B,), position up to which bounds hold
    width: Array  # (B,), from a block to its new wall; infinite without heat
    rejected: Array  # (B,), candidates since the last wall that did not break
    at: Array  # (B,), the next position: a break or the wall
    h: Array  # level there, with room to a multiple of `LEAF`
    tree: Array  # lowest of these, as in `lattice`
    rates: Array  # sums of bounds over blocks, a binary tree from node 1 on
    share: Array  # q_j (B,)
    net_drop: Array  # (B,), of the force by a break of unit stretch
    last: Array  # (B,), avalanche that has broken contacts
    breaks: Array  # (B,), so far


class Place(NamedTuple):
    """A contact and its block."""

    block: int
    contact: int


class Way(NamedTuple):
    """Motion of the plate, and where random numbers of candidates come from."""

    begin: float  # time at which `STATE` has 0
    until: float  # time since then
    speed: float  # change of the level over time
    gain: float  # change of the force over that of the level
    most_rejected: int  # candidates on the way to a wall
    size: float  # n, mean number of contacts of a block
    key: Key
    replica: int
    first: int  # number of the first contact


@routine(inline=True)
def _position(b: Blocks, level: float, block: int) -> float:
    """X of a block."""
    return b.at[block] - (b.h[block] - level) * b.share[block]


@routine(inline=True)
def _rate(laws: Contacts, b: Blocks, contact: int, X: float) -> float:
    """Rate of a contact with its block at X."""
    xi = b.xi[contact]
    x = min(X - b.birth[contact], xi)
    return rate(laws.barrier, xi, kappa(laws.springs, xi), x)


@by_law
def greatest_rate(
    law: Any, xi: float, stiffness: float, low: float, high: float
) -> float:
    """Bound on the rate of a contact between two stretches, of a barrier whose height
    and prefactor are greatest and least at the ends."""
    a = law.b * stiffness
    least = min(height(law, xi, low, a), height(law, xi, high, a))
    most = max(prefactor(law, xi, low), prefactor(law, xi, high))
    return math.exp(law.log_w - least) * most


@greatest_rate.register(Pooled)
def _greatest_pooled_rate(
    law: Pooled, xi: float, stiffness: float, low: float, high: float
) -> float:
    return greatest_between(law, low, high)


@routine(inline=True)
def _bound(laws: Contacts, b: Blocks, block: int, contact: int, X: float) -> float:
    """Bound on the rate of a contact from X to the wall of its block."""
    xi, birth = b.xi[contact], b.birth[contact]
    high = min(b.wall[block] - birth, xi)
    low = min(X - birth, high)
    stiffness = kappa(laws.springs, xi)
    return greatest_rate(laws.barrier, xi, stiffness, low, high) * _BEYOND


@routine(inline=True)
def _note_rate(b: Blocks, block: int) -> None:
    """Add up the bounds of a block, all anew: the bound of a contact that breaks may be
    so large that a difference rounds those of all others away."""
    total = 0.0
    for i in range(b.start[block], b.start[block + 1]):
        total += b.bound[i]
    node = b.rates.size // 2 + block
    b.rates[node] = total
    node //= 2
    while node > 0:
        b.rates[node] = b.rates[2 * node] + b.rates[2 * node + 1]
        node //= 2


@routine(inline=True)
def _aim(b: Blocks, block: int) -> None:
    """Find the next position of a block, and the level there."""
    at = b.wall[block]
    for i in range(b.start[block], b.start[block + 1]):
        at = min(at, b.birth[i] + b.xi[i])
    b.h[block] += (at - b.at[block]) / b.share[block]
    b.at[block] = at


@routine
def _renew(laws: Contacts, b: Blocks, block: int, X: float) -> None:
    """Move the wall of a block at X, and bound the rates of its contacts."""
    b.wall[block] = max(X + b.width[block], X * _ULP)
    b.rejected[block] = 0
    if thermal(laws.barrier):
        for i in range(b.start[block], b.start[block + 1]):
            b.bound[i] = _bound(laws, b, block, i, X)
        _note_rate(b, block)


@routine
def _mend(b: Blocks, block: int) -> None:
    """Mend the tree of lowest levels above a block."""
    leaf = block // LEAF
    lowest = math.inf
    for j in range(leaf * LEAF, (leaf + 1) * LEAF):
        lowest = min(lowest, b.h[j])
    node = b.tree.size // 2 + leaf
    b.tree[node] = lowest
    node //= 2
    while node > 0:
        b.tree[node] = min(b.tree[2 * node], b.tree[2 * node + 1])
        node //= 2


@routine(inline=True)
def _chosen_block(b: Blocks, u: float) -> int:
    """Block of a candidate, from a uniform `u`."""
    node, leaves, left = 1, b.rates.size // 2, u * b.rates[1]
    while node < leaves:
        node *= 2
        if left >= b.rates[node] and b.rates[node + 1] > 0.0:
            left -= b.rates[node]
            node += 1
    return node - leaves


@routine(inline=True)
def _chosen_contact(b: Blocks, block: int, u: float) -> int:
    """Contact of a candidate in a block, from a uniform `u`."""
    left = u * b.rates[b.rates.size // 2 + block]
    last = b.start[block + 1] - 1
    for i in range(b.start[block], last):
        left -= b.bound[i]
        if left < 0.0:
            return i
    return last


@kernel
def pin_all(laws: Contacts, key: Key, way: Way, b: Blocks, state: Array) -> None:
    """Pin all contacts, with all blocks at 0."""
    for block in range(b.wall.size):
        for i in range(b.start[block], b.start[block + 1]):
            b.xi[i] = draw_birth(laws.newborn, laws, key, way.first + i, 0).threshold
            b.birth[i] = 0.0
            b.lives[i] = 1
        b.at[block] = 0.0
        b.h[block] = 0.0
        _renew(laws, b, block, 0.0)
        _aim(b, block)
        _mend(b, block)
    u, _ = uniforms(way.key, way.replica, 0, 0)
    state[0].clock = -math.log(u)


@routine
def _break(
    laws: Contacts, key: Key, way: Way, b: Blocks, now: Any, at: Place, X: float
) -> float:
    """Break a contact of a block at X, which forms again at once. Returns its stretch
    over the number of contacts of a block."""
    block, i = at
    x = (X - b.birth[i]) / way.size
    b.birth[i] = X
    number = way.first + i
    b.xi[i] = draw_birth(laws.newborn, laws, key, number, b.lives[i]).threshold
    b.lives[i] += 1
    if thermal(laws.barrier):
        b.bound[i] = _bound(laws, b, block, i, X)
        _note_rate(b, block)
    _aim(b, block)
    if b.last[block] != now.avalanches:
        b.last[block] = now.avalanches
        now.blocks += 1
    now.size += 1
    now.breaks += 1
    b.breaks[block] += 1
    now.force -= x * b.net_drop[block]
    return x


@routine(inline=True)
def _begin_avalanche(now: Any, block: int, by_heat: bool) -> None:
    now.block = block
    now.blocks = 0
    now.by_heat = by_heat
    now.before = now.force
    now.avalanches += 1


@routine(inline=True)
def _wait(now: Any, way: Way, time: float) -> None:
    """Let time pass."""
    rise = way.speed * (time - now.time)
    gained = way.gain * rise
    now.impulse += (now.force + 0.5 * gained) * (time - now.time)
    now.force += gained
    now.level += rise
    now.time = time


@kernel
def follow(
    laws: Contacts,
    key: Key,
    b: Blocks,
    response: Any,
    way: Way,
    state: Array,
    events: Array,
) -> tuple[int, bool]:
    """Follow blocks until `way.until`, and note the avalanches that end; `state` (1,)
    is a `STATE`, `events` has `AVALANCHE`s. Returns the number of avalanches, and False
    if there are more than `events` has room for."""
    now = state[0]
    rows = 0
    while True:
        lowest, total = b.tree[1], b.rates[1]
        block = -1
        contact = -1
        X = 0.0
        if lowest > now.level:
            if now.size > 0:
                if rows == events.size:
                    return rows, False
                event = events[rows]
                event.time, event.level = way.begin + now.time, now.level
                event.block, event.breaks = now.block, now.size
                event.blocks, event.by_heat = now.blocks, now.by_heat
                event.before, event.drop = now.before, now.before - now.force
                rows += 1
                now.singles += now.size == 1
                now.size = 0
            time = math.inf
            if way.speed > 0.0:
                time = now.time + (lowest - now.level) / way.speed
            end = min(time, way.until)
            if now.clock < total * (end - now.time):
                _wait(now, way, now.time + now.clock / total)
                now.candidates += 1
                n = now.candidates
                u, v = uniforms(way.key, way.replica, n, 1)
                block = _chosen_block(b, u)
                contact = _chosen_contact(b, block, v)
                u, v = uniforms(way.key, way.replica, n, 0)
                now.clock = -math.log(u)
                X = _position(b, now.level, block)
                actual = _rate(laws, b, contact, X)
                now.unbounded |= actual > b.bound[contact]
                if v * b.bound[contact] >= actual:
                    b.rejected[block] += 1
                    if b.rejected[block] > way.most_rejected:
                        b.width[block] *= 0.5
                        _renew(laws, b, block, X)
                        _aim(b, block)
                        _mend(b, block)
                    continue
                _begin_avalanche(now, block, True)
            else:
                now.clock -= total * (end - now.time)
                _wait(now, way, end)
                if time > way.until:
                    return rows, True
                now.level = lowest
        if contact < 0:
            block = lowest_block(b)
            X = b.at[block]
            if b.wall[block] <= X:
                if b.rejected[block] == 0:
                    b.width[block] = min(2.0 * b.width[block], _WIDEST)
                _renew(laws, b, block, X)
                _aim(b, block)
                _mend(b, block)
                continue
            if now.size == 0:
                _begin_avalanche(now, block, False)
            contact = b.start[block]
            for i in range(contact, b.start[block + 1]):
                if b.birth[i] + b.xi[i] == X:
                    contact = i
                    break
        x = _break(laws, key, way, b, now, Place(block, contact), X)
        spread(response, b, block, x)


class Interface(NamedTuple):
    """Contacts and blocks of a run; lengths in units of the threshold scale."""

    laws: Contacts
    key: Key  # of lives
    candidates: Key
    contacts: Array  # numbers, of each block (B,)
    response: Response | Banded
    share: Array  # q_j (B,)
    net_drop: Array  # (B,), of the force by a break of unit stretch
    speed: float  # change of the level over the displacement of the plate
    ahead: float  # from a block to its first wall; infinite without heat


def interface_of(
    ensemble: Ensemble, elastic: Elastic, pace: float, seed: int
) -> Interface:
    """Contacts and blocks for kernels. Raises InputError where a response takes too much
    memory."""
    contacts = elastic.contacts_of(ensemble.count)
    laws, barrier = laws_of(ensemble, pace), reduced(ensemble, pace).barrier
    ahead = _FIRST_AHEAD / max(barrier.b, 1.0) if barrier.thermal else math.inf
    begun = laws, key_of(seed, TRAJECTORY), key_of(seed, CANDIDATES), contacts
    if not elastic.differ:
        ones, passed = np.ones(elastic.count), elastic.branching
        response = response_of(elastic, 1.0)._replace(unit=0.0)
        net_drop = (1.0 - passed) * ones
        return Interface(*begun, response, ones, net_drop, 1.0 - passed, ahead)
    weights = contacts / contacts.mean()
    balance = splu(balance_of(elastic.springs + weights, elastic.coupling))
    share = balance.solve(elastic.springs)
    decay = math.acosh(1.0 + weights.min() / (2.0 * max(elastic.coupling, 1e-300)))
    B = elastic.count
    width = min(2 * math.ceil(-math.log(_NEGLIGIBLE) / decay) + 1, B)
    if B * width > _MOST_NUMBERS:
        said = f"{B} blocks that differ and feel {width} of each other take too much memory"
        raise InputError(f"coupling = {elastic.coupling}: {said}")
    first = np.clip(np.arange(B) - width // 2, 0, B - width)
    G, net_drop = np.empty((B, width)), np.empty(B)
    for begin in range(0, B, _COLUMNS):
        breaks = np.arange(begin, min(begin + _COLUMNS, B))
        unit = np.zeros((B, breaks.size))
        unit[breaks, breaks - begin] = 1.0
        moved = balance.solve(unit)
        net_drop[breaks] = 1.0 - weights @ moved
        near = first[breaks, None] + np.arange(width)
        G[breaks] = moved[near, (breaks - begin)[:, None]]
    share = np.maximum(share, _LEAST_SHARE)
    G /= share[first[:, None] + np.arange(width)]
    return Interface(*begun, Banded(G, first, 0.0), share, net_drop, 1.0, ahead)


class Instants(NamedTuple):
    """Instants of records, of the edges of batches, and at which a signal may stop a
    run, in segments of the programme: 1.25 is a quarter into the second one. How long
    segments take, and the velocity of the plate along them, over the pace. So a hold,
    however long, leaves what comes after it its resolution."""

    records: Array
    edges: Array
    pauses: Array
    durations: Array
    speeds: Array


def simulate(
    interface: Interface,
    replica: int,
    instants: Instants,
    records: Array,
    told: Callable[[int], None],
    keep: Keep | None = None,
) -> tuple[Array, Array]:
    """Follow a replica, and fill its `records`, `BLOCK_STATE`s of shape (times, B).
    `told` gets the number of breaks since, now and then; `keep` the state, from which
    a replica that was stopped goes on. Returns the integral of the force of a contact
    over time, time, breaks, avalanches, single breaks and the mean X at the edges of
    batches, shape (edges, 6), and avalanches, `AVALANCHE`s. Raises InputError for a rate
    that is greatest between two stretches."""
    laws, key, contacts = interface.laws, interface.key, interface.contacts
    n, count = contacts.mean(), int(contacts.sum())
    b = _blocks_of(interface)
    way = Way(
        0.0, 0.0, interface.speed, float(contacts @ interface.share) / n, _MOST_REJECTED, n,
        interface.candidates, replica, replica * count,
    )  # fmt: skip
    state = np.zeros(1, STATE)
    now = state[0]
    pin_all(laws, key, way, b, state)
    totals: list[Array] = []
    events: list[Array] = []
    of = b.start[:-1]
    changing = {
        name: array for name, array in b._asdict().items() if name not in _CONSTANT
    }
    run = State(
        {**changing, "state": state, "records": records},
        {"totals": totals},
        {"events": events},
    )
    done = run.restore(keep, replica)
    told(int(now["breaks"]))
    durations = instants.durations
    ends = np.arange(durations.size + 1.0)
    every = np.unique(np.concatenate((*instants[:3], ends)))
    elapsed = np.interp(every, ends, np.append(0.0, np.cumsum(durations)))
    for index, instant in enumerate(every):
        if index < done:
            continue
        before = int(now["breaks"])
        last = max(index - 1, 0)
        segment = min(int(every[last]), durations.size - 1)
        way = way._replace(
            begin=float(elapsed[last]),
            until=float(instant - every[last]) * float(durations[segment]),
            speed=interface.speed * float(instants.speeds[segment]),
        )
        now["time"] = 0.0
        followed = laws, key, b, interface.response, way, state
        events.append(events_of(AVALANCHE, follow, *followed))
        told(int(now["breaks"]) - before)
        if now["unbounded"]:
            said = "its rate has to be greatest at an end of any range of stretches"
            raise InputError(f"thermal.barrier: {said}, with [elastic]")
        X = b.at - (b.h[: of.size] - now["level"]) * b.share
        births = np.add.reduceat(b.birth, of)
        squares = np.add.reduceat(b.birth**2, of) / contacts
        now["force"] = np.sum(contacts * X - births) / n
        rows = instants.records == instant
        if rows.any():
            records["X"][rows] = X
            records["force"][rows] = (contacts * X - births) / n
            mean = births / contacts
            spread = np.maximum(squares - mean**2, 0.0)
            records["variance"][rows] = spread * contacts / n
            records["breaks"][rows] = b.breaks
        if instant == instants.edges[0]:
            now["impulse"] = 0.0
        if instant in instants.edges:
            passed = (instant - instants.edges[0]) * durations[-1]
            names = "impulse", "breaks", "avalanches", "singles"
            impulse, *counts = (float(now[name]) for name in names)
            totals.append(np.array([impulse, passed, *counts, X.mean()]))
        run.save(keep, replica, index + 1)
    sums = np.array(totals)
    sums[:, 0] /= contacts.size
    return sums, np.concatenate(events)


def _blocks_of(interface: Interface) -> Blocks:
    """Make blocks, to be prepared."""
    B, N = interface.contacts.size, int(interface.contacts.sum())
    h, tree = no_levels(B)
    return Blocks(
        birth=np.zeros(N),
        xi=np.zeros(N),
        bound=np.zeros(N),
        lives=np.zeros(N, np.int64),
        start=np.append(0, np.cumsum(interface.contacts)),
        wall=np.zeros(B),
        width=np.full(B, interface.ahead),
        rejected=np.zeros(B, np.int64),
        at=np.zeros(B),
        h=h,
        tree=tree,
        rates=np.zeros(2 << (B - 1).bit_length()),
        share=interface.share,
        net_drop=interface.net_drop,
        last=np.zeros(B, np.int64),
        breaks=np.zeros(B, np.int64),
    )
