"""Lives of many contacts side by side: thresholds and clocks drawn, stretches at breaking and the work done on each."""

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
from eqsim.laws.barrier.base import thermal
from eqsim.laws.delay import delay_draw
from eqsim.laws.threshold import Thresholds, exponential_threshold, threshold_draw
from eqsim.model.ensemble import Ensemble
from eqsim.numerics.compiled import by_law, kernel, maker, routine
from eqsim.numerics.streams import ROUGH, Key, bits, fill_words, fine_product, product, uniform, uniforms
from eqsim.numerics.streams import key as key_of
from eqsim.numerics.tables import Array, look_up_all
from eqsim.numerics.vector_math import log

LANES = 256  # contacts that advance together
ROUNDS = 2  # lives of a contact that are drawn together


class Lanes(NamedTuple):
    """Which contacts advance together, and how many times ROUNDS lives old each is; arrays (LANES,). `number` and
    `words` (4, LANES) are scratch."""

    contact: Array
    age: Array
    number: Array
    words: Array


class Lives(NamedTuple):
    """The next lives of each, arrays (rounds, LANES). `stretch`: threshold at birth, then stretch at breaking. `clock`:
    what the exponential clock shows at breaking; of fluctuating thresholds then the work over k, of others scratch.
    `stiffness`: k_i/k at birth."""

    stretch: Array
    clock: Array
    stiffness: Array


@maker
def empty_lanes() -> Lanes:
    """Lanes for any contacts."""
    index = np.empty(LANES, np.int64)
    return Lanes(np.empty(LANES, np.int64), np.empty(LANES, np.int64), index, np.empty((4, LANES), np.uint64))


@maker
def empty_lives(c: Contacts, rounds: int) -> Lives:
    """Lives that clocks never end, of contacts as stiff as uniform ones."""
    shape = (rounds, LANES)
    return Lives(np.empty(shape), np.full(shape, math.inf), np.full(shape, c.springs.constant))


@routine
def draw_lives(law: Thresholds, thermal: bool, key: Key, lanes: Lanes, lives: Lives, count: int) -> None:
    """Thresholds and, if `thermal`, clocks of the next ROUNDS lives of the first `count` lanes.

    Half of a Philox result serves one draw. Where no clock is needed, the two halves are the thresholds of two lives.
    """
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
def draw_life(c: Contacts, key: Key, contact: int, number: int) -> tuple[float, float, float]:
    """Threshold and clock of a contact's life, the same bits as by `draw_lives`, and the delay after it."""
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
    clock, delay = -log(uniform(d, e)) if heat else math.inf, c.delay.mean
    if c.delay.random > 0.0:
        v, w = uniforms(key, contact, turn, 1)
        delay = delay_draw(c.delay, v if half == 0 else w)
    return xi, clock, delay


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


@by_law
def complete(law: Any, c: Contacts, key: Key, lanes: Lanes, lives: Lives, count: int) -> None:
    """Stretches at breaking in the place of thresholds, of the first `count` lanes."""
    for r in range(lives.stretch.shape[0]):
        break_lives(law, c.barrier, c.barrier_table, c.springs, r, lives, lanes.number, count)


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
    """int_0^{x_b} (k_i/k) x dx of complete lives in the place of their clocks."""
    stretch, work, stiffness = lives
    for i in range(count):
        work[r, i] = work_of(law, c.aging_table, c.springs, stiffness[r, i], stretch[r, i])


@note_work.register(Langevin)
def _note_path_work(law: Langevin, c: Contacts, lives: Lives, r: int, count: int) -> None:
    pass  # they are there


def typical_lives(c: Contacts) -> tuple[Array, Array]:
    """Work over k and stretch at breaking of 64 x 64 lives, at mid-points of equal shares of thresholds and of clocks:
    a rough picture of births that costs nothing; of 16 x 16 where thresholds fluctuate and lives cost something."""
    shares = 16 if c.aging.fluctuates else 64
    share = (np.arange(shares) + 0.5) / shares
    u, v = (grid.ravel() for grid in np.meshgrid(share, share))
    return lives(c, key_of(0, 0), 0, u, v)


@functools.lru_cache(maxsize=32)
def rough_stretch(ensemble: Ensemble, velocity: float) -> float | None:
    """The mean stretch at breaking C (length) of annealed contacts that age, to a few per cent, from `typical_lives`
    whose births have aged accordingly; None for all others, whose births do not depend on it."""
    if not ensemble.self_consistent:
        return None

    def next_one(log_stretch: float) -> float:
        c = contacts(ensemble, velocity, math.exp(log_stretch))
        return math.log(float(typical_lives(c)[1].mean()) * ensemble.thresholds.scale)

    found = optimize.fixed_point(next_one, math.log(ensemble.thresholds.mean), xtol=1e-3, maxiter=100)
    return math.exp(float(found))


def lives(c: Contacts, key: Key, first: int, u: Array, v: Array, step: float = langevin.STEP) -> tuple[Array, Array]:
    """Work over k and stretch at breaking of lives from uniforms `u` (threshold) and `v` (clock), shape (n,). Paths of
    fluctuating thresholds are those of contacts `first`, `first` + 1, ... and take steps of accuracy `step`."""
    work, stretch = np.empty(u.size), np.empty(u.size)
    fill_lives(c, key, first, step, u, v, work, stretch)
    return work, stretch


@kernel
def fill_lives(c: Contacts, key: Key, first: int, step: float, u: Array, v: Array, work: Array, stretch: Array) -> None:
    """The kernel of `lives`."""
    fill(c.aging, c, langevin.Source(key, first, step), u, v, work, stretch)


@functools.partial(by_law, makes_arrays=True)
def fill(law: Any, c: Contacts, source: langevin.Source, u: Array, v: Array, work: Array, stretch: Array) -> None:
    """Lives LANES at a time."""
    r = np.int64(0)  # typed: a literal 0 would be compiled for itself
    found, row = empty_lives(c, 1), np.empty(LANES, np.int64)
    x, clock, stiffness = found
    for first in range(0, u.size, LANES):
        count = min(LANES, u.size - first)
        for i in range(count):
            x[r, i], clock[r, i] = u[first + i], -log(v[first + i])
        draw_thresholds(c.thresholds, r, x, row, count)
        break_lives(law, c.barrier, c.barrier_table, c.springs, r, found, row, count)
        for i in range(count):
            stretch[first + i] = x[r, i]
            work[first + i] = work_of(law, c.aging_table, c.springs, stiffness[r, i], x[r, i])


@fill.register(Langevin)
def _fill_paths(
    law: Langevin, c: Contacts, source: langevin.Source, u: Array, v: Array, work: Array, stretch: Array
) -> None:
    for i in range(u.size):
        stretch[i], work[i] = threshold_draw(c.thresholds, u[i]), -log(v[i])
    contact, first_lives = np.arange(source.first, source.first + u.size), np.zeros(u.size, np.int64)
    langevin.lives(langevin.pinned(c), source.key, source.step, contact, first_lives, stretch, work)


@kernel
def plain_sums(c: Contacts, key: Key, first: int, begin: int, end: int) -> tuple[float, float, float, float]:
    """Sums, and largest terms, of work over k and of stretch at breaking over plainly drawn lives: those of the LANES
    contacts from `first` on from the age `begin` up to `end`, ROUNDS lives each time."""
    lanes, found = empty_lanes(), empty_lives(c, ROUNDS)
    age, stretch, part = lanes.age, found.stretch, found.clock
    lanes.contact[:], age[:] = np.arange(first, first + LANES), begin
    work, total, most_work, most = np.zeros(LANES), np.zeros(LANES), np.zeros(LANES), np.zeros(LANES)
    for at in range(begin, end):
        draw_lives(c.thresholds, bool(thermal(c.barrier)), key, lanes, found, LANES)
        complete(c.aging, c, key, lanes, found, LANES)
        for r in range(ROUNDS):
            note_work(c.aging, c, found, r, LANES)
            for i in range(LANES):  # sums of each lane: a single one would have to wait for every addition
                work[i] += part[r, i]
                total[i] += stretch[r, i]
                most_work[i] = max(most_work[i], part[r, i])
                most[i] = max(most[i], stretch[r, i])
        for i in range(LANES):
            age[i] = at + 1
    return work.sum(), total.sum(), most_work.max(), most.max()
