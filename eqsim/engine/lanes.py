"""Lives of many contacts side by side: thresholds, clocks and births drawn, and how far each contact is carried."""

import functools
import math
from typing import Any, NamedTuple

import numpy as np
from scipy import optimize

from eqsim.engine import langevin
from eqsim.engine.contacts import Contacts, contacts
from eqsim.laws.aging import Langevin
from eqsim.laws.aging.base import break_lives
from eqsim.laws.aging.base import work as work_of
from eqsim.laws.barrier.base import thermal, travel
from eqsim.laws.delay import delay_draw
from eqsim.laws.newborn import Stretched, newborn_draw
from eqsim.laws.stiffness import Springs, kappa
from eqsim.laws.threshold import Thresholds, exponential_threshold, threshold_draw
from eqsim.model.ensemble import Ensemble
from eqsim.numerics.compiled import by_law, kernel, routine
from eqsim.numerics.streams import ROUGH, Key, bits, fill_words, fine_product, product, uniform, uniforms
from eqsim.numerics.streams import key as key_of
from eqsim.numerics.tables import Array, look_up_all
from eqsim.numerics.vector_math import log, third

LANES = 256  # contacts that advance together
ROUNDS = 2  # lives of a contact that are drawn together
_BIRTH = 4  # draw of births; 0 is that of thresholds and clocks, 1 of delays, 2 and 3 of fine thresholds


class Lanes(NamedTuple):
    """Which contacts advance together, and how many times ROUNDS lives old each is; arrays (LANES,). `number` and
    `words` (4, LANES) are scratch."""

    contact: Array
    age: Array
    number: Array
    words: Array


class Lives(NamedTuple):
    """The next lives of each, arrays (rounds, LANES). `stretch`: threshold at birth, then the travel from birth to
    breaking, which is the stretch there unless the contact was born stretched. `clock`: what the exponential clock
    shows at breaking; of fluctuating thresholds then the work over k, of others scratch. `stiffness`: k_i/k at birth.
    `birth`: stretch at birth. `root` (LANES,): scratch of laws."""

    stretch: Array
    clock: Array
    stiffness: Array
    birth: Array
    root: Array


@routine
def empty_lanes() -> Lanes:
    """Lanes for any contacts."""
    index = np.empty(LANES, np.int64)
    return Lanes(np.empty(LANES, np.int64), np.empty(LANES, np.int64), index, np.empty((4, LANES), np.uint64))


@routine
def empty_lives(c: Contacts, rounds: int) -> Lives:
    """Lives that clocks never end, of contacts as stiff as uniform ones."""
    shape = (rounds, LANES)
    lives = Lives(np.empty(shape), np.empty(shape), np.empty(shape), np.empty(shape), np.empty(LANES))
    for r in range(rounds):  # numba takes longer to compile each other way of making an array
        for i in range(LANES):
            lives.clock[r, i], lives.stiffness[r, i], lives.birth[r, i] = math.inf, c.springs.constant, 0.0
    return lives


@by_law
def draw_lives(law: Any, c: Contacts, key: Key, lanes: Lanes, lives: Lives, count: int) -> None:
    """Thresholds, births and, if heat breaks contacts, clocks of the next ROUNDS lives of the first `count` lanes."""
    draw_unstressed(c.thresholds, bool(thermal(c.barrier)), key, lanes, lives, count)


@draw_lives.register(Stretched)
def _draw_stretched(law: Stretched, c: Contacts, key: Key, lanes: Lanes, lives: Lives, count: int) -> None:
    for r in range(ROUNDS):
        for i in range(count):
            number = ROUNDS * lanes.age[i] + r
            lives.stretch[r, i], lives.birth[r, i], lives.clock[r, i] = _draw_born(c, key, lanes.contact[i], number)


@routine
def _draw_born(c: Contacts, key: Key, contact: int, number: int) -> tuple[float, float, float]:
    """Threshold, birth and clock of a life of a contact that is born stretched."""
    u, v = uniforms(key, contact, number, 0)
    xi, y = newborn_draw(c.newborn, c.thresholds, u, uniforms(key, contact, number, _BIRTH)[0])
    return xi, y, -math.log(v)


@routine
def draw_unstressed(law: Thresholds, thermal: bool, key: Key, lanes: Lanes, lives: Lives, count: int) -> None:
    """Half of a Philox result serves one draw. Without a clock the two halves are the thresholds of two lives."""
    contact, age, index, words = lanes.contact, lanes.age, lanes.number, lanes.words
    threshold, clock = lives.stretch, lives.clock
    for r in range(ROUNDS):
        if thermal or r == 0:
            for i in range(count):
                index[i] = ROUNDS * age[i] + r if thermal else age[i]
            fill_words(key, contact, index, 0, words, count)
        half = 0 if thermal else r
        if law.exponentials == 2:
            rough = 0
            for i in range(count):
                p = product(words[2 * half, i], words[2 * half + 1, i])
                threshold[r, i] = p
                rough += p < ROUGH
            if rough > 0:
                for i in range(count):
                    if threshold[r, i] < ROUGH:
                        threshold[r, i] = fine_product(
                            key, contact[i], index[i], 2 + half, words[2 * half, i], words[2 * half + 1, i]
                        )
        else:
            for i in range(count):
                threshold[r, i] = uniform(words[2 * half, i], words[2 * half + 1, i])
        if law.exponentials > 0:
            for i in range(count):
                threshold[r, i] = exponential_threshold(threshold[r, i])
        else:
            draw_thresholds(law, r, threshold, index, count)
        if thermal:
            for i in range(count):
                clock[r, i] = -log(uniform(words[2, i], words[3, i]))


@routine
def draw_life(c: Contacts, key: Key, contact: int, number: int) -> tuple[float, float, float, float]:
    """Threshold, birth and clock of a contact's life, the same bits as by `draw_lives`, and the delay after it."""
    xi, y, clock = draw_one(c.newborn, c, key, contact, number)
    return xi, y, clock, delay_after(c, key, contact, number)


@routine(inline=True)
def delay_after(c: Contacts, key: Key, contact: int, number: int) -> float:
    """The delay after a contact's life."""
    if c.delay.random == 0.0:
        return c.delay.mean
    v, w = uniforms(key, contact, number // ROUNDS, 1)
    return delay_draw(c.delay, v if number % ROUNDS == 0 else w)


@by_law
def draw_one(law: Any, c: Contacts, key: Key, contact: int, number: int) -> tuple[float, float, float]:
    """`draw_life` but for the delay."""
    heat, turn, half = thermal(c.barrier), number // ROUNDS, number % ROUNDS
    row = number if heat else turn
    a, b, d, e = bits(key, contact, row, 0)
    low, high = (d, e) if half == 1 and not heat else (a, b)
    if c.thresholds.exponentials == 2:
        u = product(low, high)
        if u < ROUGH:
            u = fine_product(key, contact, row, 2 + (0 if heat else half), low, high)
    else:
        u = uniform(low, high)
    xi = exponential_threshold(u) if c.thresholds.exponentials > 0 else threshold_draw(c.thresholds, u)
    return xi, 0.0, -log(uniform(d, e)) if heat else math.inf


@draw_one.register(Stretched)
def _draw_one_stretched(law: Stretched, c: Contacts, key: Key, contact: int, number: int) -> tuple[float, float, float]:
    return _draw_born(c, key, contact, number)


@routine
def draw_thresholds(law: Thresholds, r: int, u: Array, row: Array, count: int) -> None:
    """Thresholds in the place of the uniforms u[r]; `row` is scratch."""
    if law.steps.size > 0:
        for i in range(count):
            u[r, i] = threshold_draw(law, u[r, i])
        return
    for i in range(count):
        u[r, i] = -log(u[r, i])
    look_up_all(law.table, r, u, row, count)


@routine
def break_unstressed(
    law: Any, barrier: Any, table: Array, springs: Springs, r: int, lives: Lives, row: Array, count: int
) -> None:
    """`break_lives` of contacts born unstressed."""
    break_lives(law, barrier, table, springs, r, lives, row, count)


@by_law
def complete(law: Any, c: Contacts, key: Key, lanes: Lanes, lives: Lives, count: int) -> None:
    """Travels in the place of thresholds, of the first `count` lanes."""
    for r in range(lives.stretch.shape[0]):
        carry(c.newborn, c, r, lives, lanes.number, count)


@by_law
def carry(law: Any, c: Contacts, r: int, lives: Lives, row: Array, count: int) -> None:
    """`complete` of round r; `row` is scratch."""
    break_unstressed(c.aging, c.barrier, c.barrier_table, c.springs, r, lives, row, count)


@carry.register(Stretched)
def _carry_stretched(law: Stretched, c: Contacts, r: int, lives: Lives, row: Array, count: int) -> None:
    stretch, stiffness = lives.stretch, lives.stiffness
    for i in range(count):
        stiffness[r, i] = kappa(c.springs, stretch[r, i])
        stretch[r, i] = travel(c, stretch[r, i], stiffness[r, i], lives.birth[r, i], lives.clock[r, i])


@complete.register(Langevin)
def _complete_paths(law: Langevin, c: Contacts, key: Key, lanes: Lanes, lives: Lives, count: int) -> None:
    age, index = lanes.age, lanes.number
    for r in range(lives.stretch.shape[0]):
        for i in range(count):
            index[i] = ROUNDS * age[i] + r
        x, spent = lives.stretch[r, :count], lives.clock[r, :count]
        langevin.lives(langevin.pinned(c), key, langevin.STEP, lanes.contact, index, x, spent)


@by_law
def note_work(law: Any, c: Contacts, lives: Lives, r: int, count: int) -> None:
    """int (k_i/k) x dx of complete lives, from birth to breaking, in the place of their clocks."""
    stretch, work, stiffness, birth = lives.stretch, lives.clock, lives.stiffness, lives.birth
    for i in range(count):
        work[r, i] = work_of(law, c.aging_table, c.springs, stiffness[r, i], stretch[r, i])
        work[r, i] += stiffness[r, i] * stretch[r, i] * birth[r, i]


@note_work.register(Langevin)
def _note_path_work(law: Langevin, c: Contacts, lives: Lives, r: int, count: int) -> None:
    pass  # they are there


@routine(inline=True)
def squared(stiffness: Any, travel: Any, y: Any) -> Any:
    """`Sample.square` of one life or of many."""
    return stiffness**2 * travel * (y * y + travel * (y + travel / 3.0))


class Sample(NamedTuple):
    """Lives, arrays (n,): work over k, int (k_i/k) x dx from birth to breaking, travel, k_i/k at birth and stretch at
    birth."""

    work: Array
    travel: Array
    stiffness: Array
    birth: Array

    @property
    def square(self) -> Array:
        """int (k_i x/k)^2 dx from birth to breaking, of contacts whose stiffness does not change."""
        with np.errstate(over="ignore"):  # of laws so broad that it is not finite
            return squared(self.stiffness, self.travel, self.birth)


def typical_lives(c: Contacts) -> Sample:
    """64 x 64 lives, at mid-points of equal shares of thresholds and of clocks, and births in between: a rough picture
    that costs nothing; of 16 x 16 where thresholds fluctuate and lives cost something."""
    shares = 16 if c.aging.fluctuates else 64
    share = (np.arange(shares) + 0.5) / shares
    u, v = (grid.ravel() for grid in np.meshgrid(share, share))
    return lives(c, key_of(0, 0), 0, u, v)


def spread(n: int) -> Array:
    """Numbers spread evenly over (0, 1), in an order of no pattern: a Kronecker sequence."""
    return (0.5 + 0.6180339887498949 * np.arange(n)) % 1.0


@functools.lru_cache(maxsize=32)
def rough_stretch(ensemble: Ensemble, velocity: float) -> float | None:
    """The mean stretch at breaking C (length) of annealed contacts that age, to a few per cent, from `typical_lives`
    whose births have aged accordingly; None for all others, whose births do not depend on it."""
    if not ensemble.self_consistent:
        return None

    def next_one(log_stretch: float) -> float:
        c = contacts(ensemble, velocity, math.exp(log_stretch))
        return math.log(float(typical_lives(c).travel.mean()) * ensemble.thresholds.scale)

    found = optimize.fixed_point(next_one, math.log(ensemble.thresholds.mean), xtol=1e-3, maxiter=100)
    return math.exp(float(found))


def lives(
    c: Contacts, key: Key, first: int, u: Array, v: Array, step: float = langevin.STEP, birth: Array | None = None
) -> Sample:
    """Lives from uniforms `u` (threshold), `v` (clock) and `birth` (`spread` evenly unless given), shape (n,). Paths of
    fluctuating thresholds are those of contacts `first`, `first` + 1, ... and take steps of accuracy `step`."""
    found = Sample(np.empty(u.size), np.empty(u.size), np.empty(u.size), np.zeros(u.size))
    if isinstance(c.newborn, Stretched):
        fill_stretched(c, u, v, spread(u.size) if birth is None else birth, found)
    else:
        fill_lives(c, key, first, step, u, v, found)
    return found


@kernel
def fill_stretched(c: Contacts, u: Array, v: Array, birth: Array, found: Sample) -> None:
    """The kernel of `lives` of contacts that are born stretched."""
    for i in range(u.size):
        xi, y = newborn_draw(c.newborn, c.thresholds, u[i], birth[i])
        k = kappa(c.springs, xi)
        s = travel(c, xi, k, y, -math.log(v[i]))
        found.work[i], found.travel[i], found.stiffness[i], found.birth[i] = k * s * (y + 0.5 * s), s, k, y


@kernel
def fill_lives(c: Contacts, key: Key, first: int, step: float, u: Array, v: Array, found: Sample) -> None:
    """The kernel of `lives` of others."""
    fill(c.aging, c, langevin.Source(key, first, step), u, v, found)


@by_law
def fill(law: Any, c: Contacts, source: langevin.Source, u: Array, v: Array, sample: Sample) -> None:
    """Lives LANES at a time."""
    r = np.int64(0)  # typed: a literal 0 would be compiled for itself
    found, row = empty_lives(c, 1), np.empty(LANES, np.int64)
    x, clock, stiffness = found.stretch, found.clock, found.stiffness
    for first in range(0, u.size, LANES):
        count = min(LANES, u.size - first)
        for i in range(count):
            x[r, i], clock[r, i] = u[first + i], -log(v[first + i])
        draw_thresholds(c.thresholds, r, x, row, count)
        break_unstressed(law, c.barrier, c.barrier_table, c.springs, r, found, row, count)
        for i in range(count):
            sample.travel[first + i], sample.stiffness[first + i] = x[r, i], stiffness[r, i]
            sample.work[first + i] = work_of(law, c.aging_table, c.springs, stiffness[r, i], x[r, i])


@fill.register(Langevin)
def _fill_paths(law: Langevin, c: Contacts, source: langevin.Source, u: Array, v: Array, sample: Sample) -> None:
    for i in range(u.size):
        sample.travel[i], sample.work[i] = threshold_draw(c.thresholds, u[i]), -log(v[i])
        sample.stiffness[i] = c.springs.constant
    contact, first_lives = np.arange(source.first, source.first + u.size), np.zeros(u.size, np.int64)
    langevin.lives(langevin.pinned(c), source.key, source.step, contact, first_lives, sample.travel, sample.work)


@kernel
def plain_sums(c: Contacts, key: Key, first: int, begin: int, end: int, stop: Array) -> tuple[Array, Array]:
    """Sums of work over k, travel, square of the force along it, stretch at birth and |work|, and the largest |work|
    and travel, of plainly drawn lives: those of the LANES contacts from `first` on from the age `begin` up to `end`,
    ROUNDS lives each time; fewer once the flag `stop` (1,) is set."""
    lanes, found = empty_lanes(), empty_lives(c, ROUNDS)
    age, stretch, part, stiffness, birth = lanes.age, found.stretch, found.clock, found.stiffness, found.birth
    lanes.contact[:], age[:] = np.arange(first, first + LANES), begin
    sums, most = np.zeros((5, LANES)), np.zeros((2, LANES))
    for at in range(begin, end):
        if stop[0] != 0:
            break
        draw_lives(c.newborn, c, key, lanes, found, LANES)
        complete(c.aging, c, key, lanes, found, LANES)
        for r in range(ROUNDS):
            note_work(c.aging, c, found, r, LANES)
        for i in range(LANES):  # sums of each lane: a single one would have to wait for every addition
            work, travel, square, births, size = sums[0, i], sums[1, i], sums[2, i], sums[3, i], sums[4, i]
            most_work, most_travel = most[0, i], most[1, i]
            for r in range(ROUNDS):
                s, y, k, w = stretch[r, i], birth[r, i], stiffness[r, i], abs(part[r, i])
                work += part[r, i]
                travel += s
                square += k * k * s * (y * y + s * (y + third(s)))
                births += y
                size += w
                most_work, most_travel = max(most_work, w), max(most_travel, s)
            sums[0, i], sums[1, i], sums[2, i], sums[3, i], sums[4, i] = work, travel, square, births, size
            most[0, i], most[1, i] = most_work, most_travel
        for i in range(LANES):
            age[i] = at + 1
    total, largest = np.empty(5), np.empty(2)
    for j in range(5):
        total[j] = sums[j].sum()
    for j in range(2):
        largest[j] = most[j].max()
    return total, largest
