"""Lives of many contacts side by side: thresholds, births, clocks and delays drawn, and
how far each is carried."""

import math
from typing import Any, NamedTuple

import numpy as np

from eqsim.engine import langevin
from eqsim.engine.contacts import Contacts
from eqsim.laws.aging import Langevin
from eqsim.laws.aging.base import break_lives
from eqsim.laws.aging.base import work as work_of
from eqsim.laws.barrier.base import thermal, travel
from eqsim.laws.delay import delay_draw
from eqsim.laws.newborn import Stretched, newborn_draw
from eqsim.laws.stiffness import kappa
from eqsim.laws.threshold import Thresholds, exponential_threshold, threshold_draw
from eqsim.numerics.compiled import by_law, routine
from eqsim.numerics.streams import (
    ROUGH,
    Key,
    bits,
    fill_words,
    fine_product,
    product,
    uniform,
    uniforms,
)
from eqsim.numerics.tables import Array, look_up_all
from eqsim.numerics.vector_math import log

LANES = 256  # contacts that advance together: their lives stay in the processor's first cache
ROUNDS = 2  # lives of a contact that are drawn together: half of a Philox result serves one draw

# Numbers of the draws of a life: each has random numbers of its own.
_THRESHOLD = 0  # and clock
_DELAY = 1
_FINE_THRESHOLD = 2  # and 3, of the second half
_BIRTH = 4
# after the life in which a stationary start finds a contact
_DELAY_OF_THE_FIRST = 65535


class Lanes(NamedTuple):
    """Contacts that advance together, arrays (LANES,).

    Attributes
    ----------
    contact : ndarray of int
    age : ndarray of int
        How many times ROUNDS lives of it were drawn.
    position : ndarray
        Displacement at which its next life begins; infinite in idle lanes.
    number : ndarray of int
        Scratch: numbers of lives.
    words : ndarray of uint64, shape (4, LANES)
        Scratch: random bits.
    """

    contact: Array
    age: Array
    position: Array
    number: Array
    words: Array

    @classmethod
    def empty(cls) -> "Lanes":
        """All lanes idle."""
        contact, age, number = np.zeros((3, LANES), np.int64)
        return cls(
            contact,
            age,
            np.full(LANES, math.inf),
            number,
            np.zeros((4, LANES), np.uint64),
        )


class Followed(NamedTuple):
    """Random numbers and scratch of the paths of the lives in the lanes."""

    lanes: Lanes
    key: Key
    walkers: langevin.Walkers


class Lives(NamedTuple):
    """The next lives of the contacts in the lanes, arrays (rounds, LANES).

    Attributes
    ----------
    threshold, birth, clock : ndarray
        Threshold and stretch at birth, and what the exponential clock shows at
        breaking: infinite without heat.
    delay : ndarray
        Between the break and the next birth.
    stiffness : ndarray
        k_i/k at birth.
    travel : ndarray
        From birth to breaking.
    work : ndarray
        Of fluctuating thresholds: int (k_i/k) x dx from birth to breaking.
    root, per_root, rank : ndarray, shape (LANES,)
        Scratch of laws.
    row : ndarray of int, shape (LANES,)
        Scratch of tables.
    followed : Followed, or () where no threshold fluctuates
    """

    threshold: Array
    birth: Array
    clock: Array
    delay: Array
    stiffness: Array
    travel: Array
    work: Array
    root: Array
    per_root: Array
    rank: Array
    row: Array
    followed: Any

    @classmethod
    def empty(cls, c: Contacts, followed: Any = (), rounds: int = ROUNDS) -> "Lives":
        """Lives that clocks never end, of contacts born unstressed, as stiff as uniform
        ones, with the mean delay."""
        threshold, birth, clock, delay, stiffness, travel, work = np.zeros(
            (7, rounds, LANES)
        )
        clock[:] = math.inf
        delay[:] = c.delay.mean
        stiffness[:] = c.springs.constant
        root, per_root, rank = np.zeros((3, LANES))
        drawn = threshold, birth, clock, delay
        return cls(
            *drawn,
            stiffness,
            travel,
            work,
            root,
            per_root,
            rank,
            np.zeros(LANES, np.int64),
            followed,
        )


def idle_lanes(c: Contacts, key: Key) -> tuple[Lanes, Lives]:
    """Lanes for contacts, and their lives."""
    lanes = Lanes.empty()
    return lanes, Lives.empty(
        c, Followed(lanes, key, langevin.Walkers.empty()) if c.aging.fluctuates else ()
    )


class Birth(NamedTuple):
    """A life as it is drawn: threshold and stretch at birth, clock at breaking."""

    threshold: float
    stretch: float
    clock: float


# --------------------------------------------------------------------------------------------------
# drawing lives


@by_law
def draw_lives(
    law: Any, c: Contacts, key: Key, lanes: Lanes, lives: Lives, count: int
) -> None:
    """Draw the next ROUNDS lives of the first `count` lanes, by the law of births."""
    draw_unstressed(c.thresholds, bool(thermal(c.barrier)), key, lanes, lives, count)
    if c.delay.random > 0.0:
        draw_delays(c, key, lanes, lives, count)


@draw_lives.register(Stretched)
def _draw_stretched(
    law: Stretched, c: Contacts, key: Key, lanes: Lanes, lives: Lives, count: int
) -> None:
    threshold, birth, clock = lives.threshold, lives.birth, lives.clock
    for r in range(ROUNDS):
        for i in range(count):
            drawn = draw_birth(law, c, key, lanes.contact[i], ROUNDS * lanes.age[i] + r)
            threshold[r, i], birth[r, i], clock[r, i] = drawn
    if c.delay.random > 0.0:
        draw_delays(c, key, lanes, lives, count)


@routine(inline=True)
def draw_unstressed(
    law: Thresholds, heat: bool, key: Key, lanes: Lanes, lives: Lives, count: int
) -> None:
    """Draw thresholds and, if heat breaks contacts, clocks. Half of a Philox result
    serves one draw; without a clock the two halves are the thresholds of two lives."""
    contact, age, number, words = lanes.contact, lanes.age, lanes.number, lanes.words
    threshold, clock, rank = lives.threshold, lives.clock, lives.rank
    for r in range(ROUNDS):
        if heat or r == 0:
            for i in range(count):
                number[i] = ROUNDS * age[i] + r if heat else age[i]
            fill_words(key, contact, number, _THRESHOLD, words, count)
        half = 0 if heat else r
        if law.exponentials == 2:
            rough = 0
            for i in range(count):
                u = product(words[2 * half, i], words[2 * half + 1, i])
                rank[i] = u
                rough += u < ROUGH
            if rough > 0:
                for i in range(count):
                    if rank[i] < ROUGH:
                        low, high = words[2 * half, i], words[2 * half + 1, i]
                        rank[i] = fine_product(
                            key,
                            contact[i],
                            number[i],
                            _FINE_THRESHOLD + half,
                            low,
                            high,
                        )
        else:
            for i in range(count):
                rank[i] = uniform(words[2 * half, i], words[2 * half + 1, i])
        if law.exponentials > 0:
            for i in range(count):
                threshold[r, i] = exponential_threshold(rank[i])
        else:
            draw_thresholds(law, rank, lives, r, count)
        if heat:
            for i in range(count):
                clock[r, i] = -log(uniform(words[2, i], words[3, i]))


@routine
def draw_thresholds(
    law: Thresholds, u: Array, lives: Lives, r: int, count: int
) -> None:
    """Fill the first `count` thresholds of round r from uniforms `u`, which are
    overwritten."""
    threshold = lives.threshold
    if law.steps.size > 0:
        for i in range(count):
            threshold[r, i] = threshold_draw(law, u[i])
    else:
        for i in range(count):
            u[i] = -log(u[i])
        look_up_all(law.table, u, lives.row, count)
        for i in range(count):
            threshold[r, i] = u[i]


@routine(inline=True)
def draw_delays(c: Contacts, key: Key, lanes: Lanes, lives: Lives, count: int) -> None:
    """Draw the delays after the next ROUNDS lives, where they are random."""
    words, delay, law = lanes.words, lives.delay, c.delay
    fill_words(key, lanes.contact, lanes.age, _DELAY, words, count)
    for r in range(ROUNDS):
        for i in range(count):
            delay[r, i] = delay_draw(law, uniform(words[2 * r, i], words[2 * r + 1, i]))


@by_law
def draw_birth(law: Any, c: Contacts, key: Key, contact: int, number: int) -> Birth:
    """Draw life `number` of a contact, the same bits as by `draw_lives`, by the law of
    births."""
    heat, turn, half = thermal(c.barrier), number // ROUNDS, number % ROUNDS
    row = number if heat else turn
    a, b, d, e = bits(key, contact, row, _THRESHOLD)
    low, high = (d, e) if half == 1 and not heat else (a, b)
    if c.thresholds.exponentials == 2:
        u = product(low, high)
        if u < ROUGH:
            u = fine_product(
                key, contact, row, _FINE_THRESHOLD + (0 if heat else half), low, high
            )
    else:
        u = uniform(low, high)
    xi = (
        exponential_threshold(u)
        if c.thresholds.exponentials > 0
        else threshold_draw(c.thresholds, u)
    )
    return Birth(xi, 0.0, -log(uniform(d, e)) if heat else math.inf)


@draw_birth.register(Stretched)
@routine
def _draw_stretched_birth(
    law: Stretched, c: Contacts, key: Key, contact: int, number: int
) -> Birth:
    u, v = uniforms(key, contact, number, _THRESHOLD)
    xi, y = newborn_draw(
        law, c.thresholds, u, uniforms(key, contact, number, _BIRTH)[0]
    )
    return Birth(xi, law.sign * y, -math.log(v))


@routine(inline=True)
def delay_after(c: Contacts, key: Key, contact: int, number: int) -> float:
    """Draw the delay after life `number` of a contact, the same bits as by
    `draw_delays`."""
    if c.delay.random == 0.0:
        return c.delay.mean
    v, w = uniforms(key, contact, number // ROUNDS, _DELAY)
    return delay_draw(c.delay, v if number % ROUNDS == 0 else w)


@routine(inline=True)
def delay_of_the_first(c: Contacts, key: Key, contact: int) -> float:
    """Draw the delay after the life in which a stationary start finds a contact."""
    return delay_draw(c.delay, uniforms(key, contact, 0, _DELAY_OF_THE_FIRST)[0])


# -------------------------------------------------------------------------------------------
# where contacts break


@by_law
def carry_lives(law: Any, c: Contacts, lives: Lives, count: int) -> None:
    """Fill travel and stiffness of the first `count` lives of every round, by the law
    of births."""
    for r in range(lives.threshold.shape[0]):
        break_lives(c.aging, c, lives, r, count)


@carry_lives.register(Stretched)
def _carry_stretched(law: Stretched, c: Contacts, lives: Lives, count: int) -> None:
    threshold, stiffness = lives.threshold, lives.stiffness
    birth, clock, carried = lives.birth, lives.clock, lives.travel
    for r in range(ROUNDS):
        for i in range(count):
            stiffness[r, i] = kappa(c.springs, threshold[r, i])
            carried[r, i] = travel(
                c, threshold[r, i], stiffness[r, i], birth[r, i], clock[r, i]
            )


@break_lives.register(Langevin)
def _walk_lives(law: Langevin, c: Contacts, lives: Lives, r: int, count: int) -> None:
    lanes, number = lives.followed.lanes, lives.followed.lanes.number
    for i in range(count):
        number[i] = ROUNDS * lanes.age[i] + r
    paths = langevin.Paths(
        lanes.contact,
        number,
        lives.threshold[r, :count],
        lives.clock[r],
        lives.travel[r],
        lives.work[r],
    )
    langevin.walk_all(
        langevin.pinned(c),
        lives.followed.key,
        langevin.STEP,
        paths,
        lives.followed.walkers,
    )


@by_law
def life_work(law: Any, c: Contacts, lives: Lives, r: int, i: int) -> float:
    """int (k_i/k) x dx of a life from birth to breaking, by the law of aging."""
    stiffness, carried = lives.stiffness[r, i], lives.travel[r, i]
    alone = work_of(law, c.aging_table, c.springs, stiffness, carried)
    return alone + stiffness * carried * lives.birth[r, i]


@life_work.register(Langevin)
def _path_work(law: Langevin, c: Contacts, lives: Lives, r: int, i: int) -> float:
    return lives.work[r, i]
