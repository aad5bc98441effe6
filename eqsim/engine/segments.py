"""One kernel for every segment of a programme: contacts come in as the last segment left them, and are handed on.

Along a segment at constant velocity a contact that comes in goes on with what its exponential clock has left, and the
lives that begin there are those of a constant drive at that speed (`engine.simulate`), in a mirror where the slider
moves back. In a hold stretches stay what they are, and time is displacement at the pace of another segment.
Thresholds that fluctuate are followed step by step, with one step that ends where the segment does.

Stretches of a `Population` count in the direction X. Each segment has a recorder of its own, whose origin is where the
segment begins, so that forces do not cancel over long distances.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from eqsim.engine import langevin
from eqsim.engine.contacts import Contacts
from eqsim.engine.lanes import LANES, ROUNDS, Lives, draw_lives, empty_lanes, empty_lives, spread
from eqsim.engine.recorder import (
    Columns,
    Recorder,
    empty_columns,
    follow_path,
    join_uniform_ramps,
    joined,
    leave,
    leave_force,
    leave_ramps,
    leave_uniform_ramps,
)
from eqsim.engine.simulate import advance, draw_delays
from eqsim.engine.stationary import Stationary, snapshot
from eqsim.laws.aging import Langevin
from eqsim.laws.aging.base import growth, spend, spent, stiffness_varies
from eqsim.laws.barrier.base import thermal
from eqsim.laws.delay import delay_draw
from eqsim.laws.newborn import born_stretched, newborn_draw
from eqsim.laws.stiffness import kappa
from eqsim.numerics.compiled import by_law, kernel, routine
from eqsim.numerics.streams import Key, uniforms
from eqsim.numerics.tables import Array, search

_SEEN = 100.0  # relaxations after which a threshold at rest has seen all there is


class Population(NamedTuple):
    """Contacts between two segments, arrays (contacts,). Times are displacements at the pace of the segment before.

    `rest` is the time until a contact is pinned, -1 of those that are. Of these: threshold `xi` and `stiffness` k_i/k
    at birth, signed `stretch`, what the exponential `clock` has left, for how long they have been pinned (`age`) and
    the `delay` after the break; and how long a contact of a stationary start is still pinned if the motion goes on
    (`pinned`). `lives` is ROUNDS times how often lives were drawn. Where thresholds fluctuate `xi` is the one now,
    `life` says which life this is and `draw` which of its random numbers comes next; stiffness, `pinned` and `age` do
    not count."""

    rest: Array
    xi: Array
    stiffness: Array
    stretch: Array
    clock: Array
    pinned: Array
    age: Array
    delay: Array
    lives: Array
    life: Array
    draw: Array

    @classmethod
    def fresh(cls, contacts: int) -> "Population":
        """All of them about to be pinned for the first time."""
        rest, xi, stiffness, stretch, clock, pinned, age, delay = np.zeros((8, contacts))
        return cls(rest, xi, stiffness, stretch, clock, pinned, age, delay, *np.zeros((3, contacts), np.int64))


class Leg(NamedTuple):
    """What a kernel needs to know of a segment: 1 if the slider moves and 0 in a hold; the direction of X in which
    stretches are positive; length (time at its pace) and pace over that of the segment before; whether a stationary
    start goes on in it; whether it is the last one; and instants of a hold (points + 1,) from its beginning on."""

    moves: int
    sign: float
    length: float
    ratio: float
    goes_on: bool
    last: bool
    times: Array


@kernel
def begin_stationary(c: Contacts, stationary: Stationary, key: Key, first: int, p: Population) -> None:
    """Fill a population with contacts from `first` on, as a snapshot of the steady state of `c` finds them."""
    for i in range(p.rest.size):
        contact = first + i
        p.lives[i] = ROUNDS
        rest, xi, y, age, length, clock = snapshot(c.newborn, c, stationary, key, contact, uniforms(key, contact, 0, 0))
        if rest >= 0.0:
            p.rest[i] = rest
            continue
        stiffness = kappa(c.springs, xi)
        left = max(clock - spent(c.aging, c, (xi, stiffness, y, 0.0), 1, age), 0.0)
        p.rest[i], p.xi[i], p.stiffness[i], p.stretch[i] = -1.0, xi, stiffness, y + age
        p.clock[i], p.age[i], p.pinned[i] = left, age, length - age
        p.delay[i] = delay_of_the_first(c, key, contact)


@routine(inline=True)
def delay_of_the_first(c: Contacts, key: Key, contact: int) -> float:
    """After the life in which a stationary start finds a contact."""
    return delay_draw(c.delay, uniforms(key, contact, 0, 65535)[0])


@kernel
def follow(c: Contacts, leg: Leg, recorder: Recorder, key: Key, first: int, p: Population) -> None:
    """Follow contacts from `first` on through a segment at whose pace they are `c`, and add up what they leave."""
    position, source = np.empty(p.rest.size), langevin.Source(key, first, langevin.STEP)
    for i in range(p.rest.size):
        position[i] = go_on(c.aging, c, leg, recorder, source, p, i)
    lanes, lives, columns = empty_lanes(), empty_lives(c, ROUNDS), empty_columns()
    xi, clock = np.empty((ROUNDS, LANES)), np.empty((ROUNDS, LANES))
    at, broke, delay = np.full(LANES, math.inf), np.empty(LANES), np.full((ROUNDS, LANES), c.delay.mean)
    which = np.empty(LANES, np.int64)
    alone = leg.moves == 0 or stiffness_varies(c.aging, c.springs) or cut_short(c.aging, leg)
    alone = alone or born_stretched(c.newborn)
    contact, age = lanes.contact, lanes.age
    active: Any = np.int64(0)  # typed: a literal 0 would be compiled for itself
    upcoming: Any = np.int64(0)
    while True:
        if 2 * active <= LANES:
            while active < LANES and upcoming < position.size:
                if position[upcoming] <= leg.length:
                    which[active], contact[active], age[active] = (
                        upcoming,
                        first + upcoming,
                        p.lives[upcoming] // ROUNDS,
                    )
                    at[active] = position[upcoming]
                    if not alone and joined(c, recorder):
                        leave(recorder, index_of(leg, recorder, at[active]), 1, 1.0, at[active])
                    active += 1
                upcoming += 1
        if active == 0 or recorder.status[1] != 0:
            return
        full = min(LANES, (active + 31) // 32 * 32)
        draw_lives(c.newborn, c, key, lanes, lives, full)
        if c.delay.random > 0.0:
            draw_delays(c.delay, key, lanes, delay, full)
        for r in range(ROUNDS):
            for i in range(full):
                xi[r, i], clock[r, i] = lives.stretch[r, i], lives.clock[r, i]
            if born_stretched(c.newborn):
                for i in range(full):
                    lives.birth[r, i] *= leg.sign  # from here on in the direction of motion
        if leg.moves != 0:
            advance(c.aging, c, key, lanes, lives, alone, (active, full))
        for r in range(ROUNDS):
            if alone:
                for i in range(active):
                    if at[i] <= leg.length:
                        drawn = xi[r, i], clock[r, i], lives.stretch[r, i], lives.birth[r, i]
                        place = which[i], ROUNDS * age[i] + r, at[i]
                        broke[i] = live(c.aging, c, leg, recorder, source, p, drawn, place)
            else:
                _record(c, recorder, at, broke, lives, r, columns, full)
            for i in range(active):
                if at[i] <= leg.length:
                    recorder.status[0] += 1
                    if broke[i] + delay[r, i] > leg.length:
                        parts = xi[r, i], clock[r, i], delay[r, i], lives.birth[r, i]
                        hand_on(c.aging, c, leg, p, which[i], parts, at[i], broke[i])
                        p.lives[which[i]] = ROUNDS * (age[i] + 1)
                    at[i] = broke[i] + delay[r, i]
        for i in range(active):
            age[i] += 1
        for i in range(active - 1, -1, -1):
            if at[i] > leg.length:
                active -= 1
                which[i], contact[i], age[i], at[i] = which[active], contact[active], age[active], at[active]
                at[active] = math.inf


@routine
def index_of(leg: Leg, recorder: Recorder, s: float) -> int:
    """The first instant of a segment at or after `s`; beyond the last one if there is none."""
    run = recorder.run
    if leg.moves == 0:
        return search(leg.times, s, False)
    return math.ceil(min(s * ((run.points - 1) / run.distance), float(run.points)))


@routine
def _leave_life(
    c: Contacts, leg: Leg, recorder: Recorder, stiffness: float, y: float, age: float, span: tuple[float, float]
) -> None:
    """What a contact leaves that is pinned for a `span` of a segment, with stretch `y` and `age` at its beginning."""
    run = recorder.run
    start, end = index_of(leg, recorder, span[0]), index_of(leg, recorder, span[1])
    if not stiffness_varies(c.aging, c.springs):
        if start < end and start < run.points:
            born = span[0] - y if leg.moves != 0 else -y
            leave(recorder, start, 1, stiffness, born)
            if end < run.points:
                leave(recorder, end, -1, stiffness, born)
        return
    step = run.distance / (run.points - 1)
    for j in range(start, min(end, run.points)):
        s = j * step if leg.moves != 0 else leg.times[j]
        elapsed = max(s - span[0], 0.0)
        leave_force(recorder, j, stiffness * growth(c.aging, age + elapsed) * (y + elapsed * leg.moves))
        recorder.deposits[j, 0] += 1
        if j + 1 < run.points:
            recorder.deposits[j + 1, 0] -= 1


@by_law
def cut_short(law: Any, leg: Leg) -> bool:
    """Whether lives that begin along a segment are followed to its end only, not to where they would break."""
    return False


@by_law
def go_on(law: Any, c: Contacts, leg: Leg, recorder: Recorder, source: langevin.Source, p: Population, i: int) -> float:
    """Take a contact through the segment up to the end of what it came in with; where its next life begins, or infinity
    if that is in a later segment."""
    if p.rest[i] >= 0.0:
        return _wait(leg, p, i)
    y, age, delay = leg.sign * p.stretch[i], p.age[i] * leg.ratio, p.delay[i] * leg.ratio
    contact = p.xi[i], p.stiffness[i], y, age
    if leg.goes_on:
        broke, left = p.pinned[i], 0.0
        if broke > leg.length:
            left = max(p.clock[i] - spent(c.aging, c, contact, leg.moves, leg.length), 0.0)
    else:
        broke, left = spend(c.aging, c, contact, leg.moves, leg.length, p.clock[i])
    _leave_life(c, leg, recorder, p.stiffness[i], y, age, (0.0, broke))
    if broke > leg.length:
        p.stretch[i] = leg.sign * (y + leg.moves * leg.length)
        p.clock[i], p.age[i], p.delay[i] = left, age + leg.length, delay
        return math.inf
    p.rest[i] = broke + delay - leg.length
    return broke + delay if broke + delay <= leg.length else math.inf


@routine
def _wait(leg: Leg, p: Population, i: int) -> float:
    """`go_on` of a detached contact."""
    rest = p.rest[i] * leg.ratio
    p.rest[i] = rest - leg.length
    return rest if rest <= leg.length else math.inf


@by_law
def live(
    law: Any, c: Contacts, leg: Leg, recorder: Recorder, source: langevin.Source, p: Population,
    drawn: tuple[float, float, float, float], place: tuple[int, int, float],
) -> float:  # fmt: skip
    """Record a life on its own, `drawn` as threshold, clock, travel unless in a hold, and stretch at birth in the
    direction of motion, in its `place`: whose it is, which of its lives, and where that begins. Where it ends."""
    (xi, clock, stretch, y), (_, _, born) = drawn, place
    stiffness = kappa(c.springs, xi)
    if leg.moves != 0:
        broke = born + stretch
    else:
        spent, _ = spend(c.aging, c, (xi, stiffness, y, 0.0), 0, leg.length - born, clock)
        broke = born + spent
    _leave_life(c, leg, recorder, stiffness, y, 0.0, (born, broke))
    return broke


@routine(inline=True)
def _record(
    c: Contacts, recorder: Recorder, born: Array, broke: Array, lives: Lives, r: int, columns: Columns, count: int
) -> None:
    """Record round r of the lives of all lanes; where they end."""
    stretch = lives.stretch
    for i in range(count):
        broke[i] = born[i] + stretch[r, i]
    if joined(c, recorder):
        join_uniform_ramps(recorder, born, broke, columns, count)
    elif c.springs.slope == 0.0:
        leave_uniform_ramps(recorder, born, broke, columns, count)
    else:
        leave_ramps(recorder, born, broke, lives, r, columns, count)


@by_law
def hand_on(
    law: Any, c: Contacts, leg: Leg, p: Population, i: int, drawn: tuple[float, float, float, float], born: float,
    broke: float,
) -> None:  # fmt: skip
    """Note where a contact is at the end of the segment, whose last life was `drawn` as threshold, clock, delay and
    stretch at birth in the direction of motion."""
    xi, clock, delay, y = drawn
    if broke <= leg.length:
        p.rest[i] = broke + delay - leg.length
        return
    stiffness, age = kappa(c.springs, xi), leg.length - born
    left = max(clock - spent(c.aging, c, (xi, stiffness, y, 0.0), leg.moves, age), 0.0)
    p.rest[i], p.xi[i], p.stiffness[i], p.clock[i], p.age[i], p.delay[i] = -1.0, xi, stiffness, left, age, delay
    p.stretch[i] = leg.sign * (y + leg.moves * age)


# ------------------------------------------------------------------------------------- thresholds that fluctuate


@cut_short.register(Langevin)
def _cut_short(law: Langevin, leg: Leg) -> bool:
    return not leg.last


@go_on.register(Langevin)
def _go_on_path(
    law: Langevin, c: Contacts, leg: Leg, recorder: Recorder, source: langevin.Source, p: Population, i: int
) -> float:
    if p.rest[i] >= 0.0:
        return _wait(leg, p, i)
    p.delay[i] *= leg.ratio
    path = langevin.Path(
        source.key, source.first + i, p.life[i], p.draw[i], p.xi[i], leg.sign * p.stretch[i], p.clock[i]
    )
    broke = _along(c, leg, recorder, p, path, (i, 0.0))
    if broke == math.inf:
        return math.inf
    p.rest[i] = broke + p.delay[i] - leg.length
    return broke + p.delay[i] if p.rest[i] <= 0.0 else math.inf


@live.register(Langevin)
def _live_path(
    law: Langevin, c: Contacts, leg: Leg, recorder: Recorder, source: langevin.Source, p: Population,
    drawn: tuple[float, float, float, float], place: tuple[int, int, float],
) -> float:  # fmt: skip
    (xi, clock, _, _), (i, life, born) = drawn, place
    path = langevin.Path(source.key, source.first + i, life, np.int64(0), xi, 0.0, clock)
    return _along(c, leg, recorder, p, path, (i, born))


@hand_on.register(Langevin)
def _hand_on_path(
    law: Langevin, c: Contacts, leg: Leg, p: Population, i: int, drawn: tuple[float, float, float, float], born: float,
    broke: float,
) -> None:  # fmt: skip
    p.delay[i] = drawn[2]  # the rest is noted where its path ends
    p.rest[i] = broke + drawn[2] - leg.length if broke <= leg.length else -1.0


@routine
def _along(
    c: Contacts, leg: Leg, recorder: Recorder, p: Population, path: langevin.Path, place: tuple[int, float]
) -> float:
    """Follow and record a path; `place`: whose it is, and from where on. Where it breaks; infinity if it comes to the
    end of the segment, and its state there is noted."""
    (i, begin), y = place, path.x
    laws = langevin.Pinned(c.barrier, c.springs, c.aging, float(leg.moves))
    broken = False
    if c.springs.slope == 0.0:
        broken, path, elapsed = langevin.follow(laws, path, leg.length - begin, langevin.STEP)
        broke = min(begin + elapsed, leg.length) if broken else math.inf
        _leave_life(c, leg, recorder, c.springs.constant, y, 0.0, (begin, broke))
    elif leg.moves == 0:
        broke, path = _hold(laws, leg, recorder, path, begin)
    else:
        elapsed, path = follow_path(laws, recorder, 0, path, begin)
        broke = begin + elapsed if begin + elapsed <= leg.length else math.inf
    if broke == math.inf:
        p.rest[i], p.xi[i], p.stretch[i], p.clock[i] = -1.0, path.xi, leg.sign * path.x, path.left
        p.life[i], p.draw[i] = path.life, path.draw
    return broke


@routine
def _hold(
    c: langevin.Pinned, leg: Leg, recorder: Recorder, path: langevin.Path, begin: float
) -> tuple[float, langevin.Path]:
    """Follow and record a path in a hold whose stiffness follows its threshold: when it breaks, or infinity, and the
    path there. Steps end at the instants that are recorded."""
    at = begin
    for j in range(index_of(leg, recorder, begin), recorder.run.points):
        broke, path, elapsed = langevin.follow(c, path, leg.times[j] - at, langevin.STEP)
        if broke:
            return min(at + elapsed, leg.length), path
        at = leg.times[j]
        leave_force(recorder, j, kappa(c.springs, path.xi) * path.x)
        recorder.deposits[j, 0] += 1
        if j + 1 < recorder.run.points:
            recorder.deposits[j + 1, 0] -= 1
    return math.inf, path


# ---------------------------------------------------------------------------------------------- how long lives last


def waits_at_rest(c: Contacts, most: float) -> Array:
    """How long lives last at rest, up to `most`, at 64 x 64 mid-points of equal shares of thresholds and of clocks;
    where thresholds fluctuate roughly, and at 16 x 16."""
    shares = 16 if c.aging.fluctuates else 64
    share = (np.arange(shares) + 0.5) / shares
    u, v = (grid.ravel() for grid in np.meshgrid(share, share))
    found = np.empty(u.size)
    fill_waits(c, u, v, spread(u.size), most, found)
    return np.minimum(found, most)


@kernel
def fill_waits(c: Contacts, u: Array, v: Array, birth: Array, most: float, found: Array) -> None:
    """The kernel of `waits_at_rest`; longer lives may be infinite."""
    for i in range(u.size):
        born = newborn_draw(c.newborn, c.thresholds, u[i], birth[i])
        found[i] = wait_at_rest(c.aging, c, born, -math.log(v[i]), most, i)


@by_law
def wait_at_rest(law: Any, c: Contacts, born: tuple[float, float], clock: float, most: float, i: int) -> float:
    """How long a life lasts at rest of a contact `born` with threshold and stretch; path i where those fluctuate.
    Infinite, or anything longer, if it is more than `most`."""
    return spend(law, c, (born[0], kappa(c.springs, born[0]), born[1], 0.0), 0, most, clock)[0]


@wait_at_rest.register(Langevin)
def _path_at_rest(law: Langevin, c: Contacts, born: tuple[float, float], clock: float, most: float, i: int) -> float:
    if not thermal(c.barrier):
        return math.inf
    laws = langevin.Pinned(c.barrier, c.springs, c.aging, 0.0)
    key = (np.uint64(0), np.uint64(0))
    path = langevin.Path(key, i, np.int64(0), np.int64(0), born[0], 0.0, clock)
    broke, path, elapsed = langevin.follow(laws, path, min(_SEEN / law.alpha, most), langevin.STEP)
    return elapsed if broke else elapsed * (clock / (clock - path.left))  # by then the hazard grows in proportion
