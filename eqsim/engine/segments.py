"""One kernel for every segment of a programme: contacts come in as the last segment left them, and are handed on.

Along a segment at constant velocity a contact that comes in goes on with what its exponential clock has left, and the
lives that begin there are those of a constant drive at that speed (`engine.simulate`), in a mirror where the slider
moves back. In a hold stretches stay what they are, and time is displacement at the pace of another segment.

Stretches of a `Population` count in the direction X. Each segment has a recorder of its own, whose origin is where the
segment begins, so that forces do not cancel over long distances.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from eqsim.engine.contacts import Contacts
from eqsim.engine.lanes import LANES, ROUNDS, Lives, complete, draw_lives, empty_lanes, empty_lives
from eqsim.engine.recorder import (
    Columns,
    Recorder,
    empty_columns,
    join_uniform_ramps,
    joined,
    leave,
    leave_force,
    leave_ramps,
    leave_uniform_ramps,
)
from eqsim.engine.simulate import draw_delays
from eqsim.engine.stationary import Stationary, found_pinned
from eqsim.laws.aging.base import growth, spend, spent, stiffness_varies
from eqsim.laws.barrier.base import thermal
from eqsim.laws.delay import delay_draw, residual_delay_draw
from eqsim.laws.stiffness import kappa
from eqsim.laws.threshold import threshold_draw
from eqsim.numerics.compiled import inlined, kernel, routine
from eqsim.numerics.streams import Key, uniforms
from eqsim.numerics.tables import Array


class Population(NamedTuple):
    """Contacts between two segments, arrays (contacts,). Times are displacements at the pace of the segment before.

    `rest` is the time until a contact is pinned, -1 of those that are. Of these: threshold `xi` and `stiffness` k_i/k
    at birth, signed `stretch`, what the exponential `clock` has left, the stretch at breaking `ends` if the motion goes
    on as before, for how long they have been pinned (`age`) and the `delay` after the break. `lives` is ROUNDS times
    how often lives were drawn."""

    rest: Array
    xi: Array
    stiffness: Array
    stretch: Array
    clock: Array
    ends: Array
    age: Array
    delay: Array
    lives: Array

    @classmethod
    def fresh(cls, contacts: int) -> "Population":
        """All of them about to be pinned for the first time."""
        rest, xi, stiffness, stretch, clock, ends, age, delay = np.zeros((8, contacts))
        return cls(rest, xi, stiffness, stretch, clock, ends, age, delay, np.zeros(contacts, np.int64))


class Leg(NamedTuple):
    """What a kernel needs to know of a segment: 1 if the slider moves and 0 in a hold; the direction of X in which
    stretches are positive; length (time at its pace) and pace over that of the segment before; whether the contacts
    move as before; and instants of a hold (points + 1,) from its beginning on."""

    moves: int
    sign: float
    length: float
    ratio: float
    same: bool
    times: Array


@kernel
def begin_stationary(c: Contacts, stationary: Stationary, key: Key, first: int, p: Population) -> None:
    """Fill a population with contacts from `first` on, as a snapshot of the steady state of `c` finds them."""
    for i in range(p.rest.size):
        contact = first + i
        u_state, u_residual = uniforms(key, contact, 0, 0)
        p.lives[i] = ROUNDS
        if u_state >= stationary.pinned:
            p.rest[i] = residual_delay_draw(c.delay, u_residual)
            continue
        xi, x, ends, clock = found_pinned(c, stationary, key, contact, u_residual)
        stiffness = kappa(c.springs, xi)
        left = max(clock - spent(c.aging, c, (xi, stiffness, 0.0, 0.0), 1, x), 0.0)
        p.rest[i], p.xi[i], p.stiffness[i], p.stretch[i], p.ends[i], p.age[i] = -1.0, xi, stiffness, x, ends, x
        p.clock[i] = left
        p.delay[i] = delay_draw(c.delay, uniforms(key, contact, 0, 65535)[0])


@kernel
def follow(c: Contacts, leg: Leg, recorder: Recorder, key: Key, first: int, p: Population) -> None:
    """Follow contacts from `first` on through a segment at whose pace they are `c`, and add up what they leave."""
    position = np.empty(p.rest.size)
    for i in range(p.rest.size):
        position[i] = _go_on(c, leg, recorder, p, i)
    lanes, lives, columns = empty_lanes(), empty_lives(c, ROUNDS), empty_columns()
    xi, clock = np.empty((ROUNDS, LANES)), np.empty((ROUNDS, LANES))
    at, broke, delay = np.full(LANES, math.inf), np.empty(LANES), np.full((ROUNDS, LANES), c.delay.mean)
    which = np.empty(LANES, np.int64)
    alone = leg.moves == 0 or stiffness_varies(c.aging, c.springs)
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
        draw_lives(c.thresholds, bool(thermal(c.barrier)), key, lanes, lives, full)
        if c.delay.random > 0.0:
            draw_delays(c.delay, key, lanes, delay, full)
        for r in range(ROUNDS):
            for i in range(full):
                xi[r, i], clock[r, i] = lives.stretch[r, i], lives.clock[r, i]
        if leg.moves != 0:
            complete(c.aging, c, key, lanes, lives, full)
        for r in range(ROUNDS):
            if alone:
                for i in range(active):
                    if at[i] <= leg.length:
                        broke[i] = _live(c, leg, recorder, lives.stretch[r, i], xi[r, i], clock[r, i], at[i])
            else:
                _record(c, recorder, at, broke, lives, r, columns, full)
            for i in range(active):
                if at[i] <= leg.length:
                    recorder.status[0] += 1
                    if broke[i] + delay[r, i] > leg.length:
                        _hand_on(c, leg, p, which[i], (xi[r, i], clock[r, i], delay[r, i]), at[i], broke[i])
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
        return int(np.searchsorted(leg.times, s))
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


@routine
def _go_on(c: Contacts, leg: Leg, recorder: Recorder, p: Population, i: int) -> float:
    """Take a contact through the segment up to the end of what it came in with; where its next life begins, or infinity
    if that is in a later segment."""
    if p.rest[i] >= 0.0:
        rest = p.rest[i] * leg.ratio
        p.rest[i] = rest - leg.length
        return rest if rest <= leg.length else math.inf
    y, age, delay = leg.sign * p.stretch[i], p.age[i] * leg.ratio, p.delay[i] * leg.ratio
    contact = p.xi[i], p.stiffness[i], y, age
    if leg.same:
        broke, left = p.ends[i] - y, 0.0
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
def _live(c: Contacts, leg: Leg, recorder: Recorder, stretch: float, xi: float, clock: float, born: float) -> float:
    """Record a life that begins at `born` on its own, and ends at that `stretch` unless in a hold; where it ends."""
    stiffness = kappa(c.springs, xi)
    if leg.moves != 0:
        broke = born + stretch
    else:
        spent, _ = spend(c.aging, c, (xi, stiffness, 0.0, 0.0), 0, leg.length - born, clock)
        broke = born + spent
    _leave_life(c, leg, recorder, stiffness, 0.0, 0.0, (born, broke))
    return broke


@inlined
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


@routine
def _hand_on(
    c: Contacts, leg: Leg, p: Population, i: int, drawn: tuple[float, float, float], born: float, broke: float
) -> None:
    """Note where a contact is at the end of the segment, whose last life was `drawn` as threshold, clock and delay."""
    xi, clock, delay = drawn
    if broke <= leg.length:
        p.rest[i] = broke + delay - leg.length
        return
    stiffness, age = kappa(c.springs, xi), leg.length - born
    left = max(clock - spent(c.aging, c, (xi, stiffness, 0.0, 0.0), leg.moves, age), 0.0)
    p.rest[i], p.xi[i], p.stiffness[i], p.clock[i], p.age[i], p.delay[i] = -1.0, xi, stiffness, left, age, delay
    p.stretch[i], p.ends[i] = leg.sign * leg.moves * age, broke - born


def waits_at_rest(c: Contacts) -> Array:
    """How long lives last at rest, at 64 x 64 mid-points of equal shares of thresholds and of clocks."""
    share = (np.arange(64) + 0.5) / 64
    u, v = (grid.ravel() for grid in np.meshgrid(share, share))
    found = np.empty(u.size)
    fill_waits(c, u, v, found)
    return found


@kernel
def fill_waits(c: Contacts, u: Array, v: Array, found: Array) -> None:
    """The kernel of `waits_at_rest`."""
    for i in range(u.size):
        xi = threshold_draw(c.thresholds, u[i])
        found[i], _ = spend(c.aging, c, (xi, kappa(c.springs, xi), 0.0, 0.0), 0, math.inf, -math.log(v[i]))
