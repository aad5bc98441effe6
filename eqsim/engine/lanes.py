"""Follow contacts along a segment at constant velocity, LANES side by side: draw their
lives, find where each breaks, and hand them to a recorder.

A recorder is a NamedTuple by whose type kernels are compiled: `recorder` adds up forces
on a grid, `breaks` lists breaks, `randomise` sums plain lives. It has a field `stop`, a
flag (1,) of which anything but 0 ends the kernel, and bodies of `note_lives`, of
`admit` unless its contacts begin alike, and of `move_lane` if it keeps something for
each lane.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from eqsim.engine import langevin
from eqsim.engine.contacts import Contacts
from eqsim.laws.aging import Langevin
from eqsim.laws.aging.base import break_lives, life
from eqsim.laws.aging.base import work as work_of
from eqsim.laws.barrier.base import thermal, travel
from eqsim.laws.delay import delay_draw
from eqsim.laws.newborn import Stretched, newborn_draw
from eqsim.laws.stiffness import kappa
from eqsim.laws.threshold import Thresholds, exponential_threshold, threshold_draw
from eqsim.numerics import streams
from eqsim.numerics.compiled import by_law, kernel, routine
from eqsim.numerics.streams import Key, fine_product, uniform, uniforms
from eqsim.numerics.tables import Array, look_up_all
from eqsim.numerics.vector_math import log

# Contacts that advance together: their lives stay in the processor's first cache.
LANES = 256
# Lives of a contact drawn together: half of a Philox result serves one draw.
ROUNDS = 2
# Lanes are used in groups of so many, so that vectorised loops leave no remainder.
_GROUP = 32

# Numbers of the draws of a life: each has random numbers of its own.
_THRESHOLD = 0  # and clock
_DELAY = 1
_FINE_THRESHOLD = 2  # and 3, of the second half
_BIRTH = 4
_DELAY_OF_THE_FIRST = 65535  # of the life in which a stationary start finds a contact


class Lanes(NamedTuple):
    """Contacts that advance together, arrays (LANES,)."""

    contact: Array  # their numbers
    age: Array  # how often ROUNDS lives were drawn for each
    position: Array  # displacement at the next birth; infinite in idle lanes
    number: Array  # scratch: numbers of lives
    words: Array  # scratch: random bits, (4, LANES)
    key: Key  # of their random numbers


class Followed(NamedTuple):
    """Contacts whose thresholds fluctuate, and scratch for their paths."""

    lanes: Lanes
    walkers: langevin.Walkers


class Lives(NamedTuple):
    """The next lives of the contacts in the lanes, arrays (rounds, LANES)."""

    threshold: Array  # at birth
    birth: Array  # stretch at birth
    clock: Array  # hazard at which heat breaks the contact, infinite without heat
    delay: Array  # between the break and the next birth
    stiffness: Array  # k_i/k at birth
    travel: Array  # from birth to breaking
    work: Array  # int (k_i/k) x dx from birth to breaking, of fluctuating thresholds
    root: Array  # scratch of laws, (LANES,)
    per_root: Array  # scratch of laws, (LANES,)
    rank: Array  # scratch of laws, (LANES,)
    row: Array  # scratch of tables, (LANES,)
    followed: Any  # `Followed`, or () where no threshold fluctuates

    @classmethod
    def empty(cls, c: Contacts, followed: Any = (), rounds: int = ROUNDS) -> "Lives":
        """Lives before any is drawn: without heat, born unstressed, with the stiffness
        of the uniform law and the mean delay."""
        lives = np.zeros((7, rounds, LANES))
        lives[2] = math.inf
        lives[3] = c.delay.mean
        lives[4] = c.springs.constant
        scratch = *np.zeros((3, LANES)), np.zeros(LANES, np.int64)
        return cls._make((*lives, *scratch, followed))


def idle_lanes(c: Contacts, key: Key) -> tuple[Lanes, Lives]:
    """Make lanes for contacts, all idle, and their lives."""
    contact, age, number = np.zeros((3, LANES), np.int64)
    position, words = np.full(LANES, math.inf), np.zeros((4, LANES), np.uint64)
    lanes = Lanes(contact, age, position, number, words, key)
    paths = Followed(lanes, langevin.Walkers.empty()) if c.aging.fluctuates else ()
    return lanes, Lives.empty(c, paths)


@routine(inline=True)
def padded(active: int) -> int:
    """Round a number of active lanes up to whole groups."""
    return min(LANES, (active + _GROUP - 1) // _GROUP * _GROUP)


class Birth(NamedTuple):
    """Threshold, stretch at birth and exponential clock of a life."""

    threshold: float
    stretch: float
    clock: float


# ---- drawing lives ----


@by_law
def draw_lives(law: Any, c: Contacts, lanes: Lanes, lives: Lives, count: int) -> None:
    """Draw the next ROUNDS lives of the first `count` lanes, by the law of births."""
    draw_unstressed(c.thresholds, bool(thermal(c.barrier)), lanes, lives, count)
    if c.delay.random > 0.0:
        draw_delays(c, lanes, lives, count)


@draw_lives.register(Stretched)
def _draw_stretched(
    law: Stretched, c: Contacts, lanes: Lanes, lives: Lives, count: int
) -> None:
    threshold, birth, clock = lives.threshold, lives.birth, lives.clock
    for r in range(ROUNDS):
        for i in range(count):
            number = ROUNDS * lanes.age[i] + r
            drawn = draw_birth(law, c, lanes.key, lanes.contact[i], number)
            threshold[r, i], birth[r, i], clock[r, i] = drawn
    if c.delay.random > 0.0:
        draw_delays(c, lanes, lives, count)


@routine(inline=True)
def draw_unstressed(
    law: Thresholds, heat: bool, lanes: Lanes, lives: Lives, count: int
) -> None:
    """Draw thresholds and, if heat breaks contacts, clocks. Half of a Philox result
    serves one draw. Without a clock the two halves are the thresholds of two lives."""
    key, contact, age = lanes.key, lanes.contact, lanes.age
    number, words = lanes.number, lanes.words
    threshold, clock, rank = lives.threshold, lives.clock, lives.rank
    for r in range(ROUNDS):
        if heat or r == 0:
            for i in range(count):
                number[i] = ROUNDS * age[i] + r if heat else age[i]
            streams.fill_words(key, contact, number, _THRESHOLD, words, count)
        half = 0 if heat else r
        if law.exponentials == 2:
            rough = 0
            for i in range(count):
                u = streams.product(words[2 * half, i], words[2 * half + 1, i])
                rank[i] = u
                rough += u < streams.ROUGH
            if rough > 0:
                for i in range(count):
                    if rank[i] < streams.ROUGH:
                        draw, who = _FINE_THRESHOLD + half, contact[i]
                        low, high = words[2 * half, i], words[2 * half + 1, i]
                        life = number[i]
                        rank[i] = fine_product(key, who, life, draw, low, high)
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
    """Fill the first `count` thresholds of round r from uniforms, overwriting these."""
    threshold = lives.threshold
    if law.steps.size > 0 or law.ranks.size > 0:
        for i in range(count):
            threshold[r, i] = threshold_draw(law, u[i])
    else:
        for i in range(count):
            u[i] = -log(u[i])
        look_up_all(law.table, u, lives.row, count)
        for i in range(count):
            threshold[r, i] = u[i]


@routine(inline=True)
def draw_delays(c: Contacts, lanes: Lanes, lives: Lives, count: int) -> None:
    """Draw the delays after the next ROUNDS lives, where they are random."""
    words, delay, law = lanes.words, lives.delay, c.delay
    streams.fill_words(lanes.key, lanes.contact, lanes.age, _DELAY, words, count)
    for r in range(ROUNDS):
        for i in range(count):
            delay[r, i] = delay_draw(law, uniform(words[2 * r, i], words[2 * r + 1, i]))


@by_law
def draw_birth(law: Any, c: Contacts, key: Key, contact: int, number: int) -> Birth:
    """Draw life `number` of a contact as `draw_lives` does, by the law of births."""
    heat, turn, half = thermal(c.barrier), number // ROUNDS, number % ROUNDS
    row = number if heat else turn
    a, b, d, e = streams.bits(key, contact, row, _THRESHOLD)
    low, high = (d, e) if half == 1 and not heat else (a, b)
    if c.thresholds.exponentials == 2:
        u = streams.product(low, high)
        if u < streams.ROUGH:
            draw = _FINE_THRESHOLD + (0 if heat else half)
            u = fine_product(key, contact, row, draw, low, high)
    else:
        u = uniform(low, high)
    direct = c.thresholds.exponentials > 0
    xi = exponential_threshold(u) if direct else threshold_draw(c.thresholds, u)
    return Birth(xi, 0.0, -log(uniform(d, e)) if heat else math.inf)


@draw_birth.register(Stretched)
def _draw_stretched_birth(
    law: Stretched, c: Contacts, key: Key, contact: int, number: int
) -> Birth:
    u, v = uniforms(key, contact, number, _THRESHOLD)
    rank = uniforms(key, contact, number, _BIRTH)[0]
    xi, y = newborn_draw(law, c.thresholds, u, rank)
    return Birth(xi, law.sign * y, -math.log(v))


@routine(inline=True)
def delay_after(c: Contacts, key: Key, contact: int, number: int) -> float:
    """Draw the delay after life `number` of a contact as `draw_delays` does."""
    if c.delay.random == 0.0:
        return c.delay.mean
    v, w = uniforms(key, contact, number // ROUNDS, _DELAY)
    return delay_draw(c.delay, v if number % ROUNDS == 0 else w)


@routine(inline=True)
def delay_of_the_first(c: Contacts, key: Key, contact: int) -> float:
    """Draw the delay after the life in which a stationary start finds a contact."""
    return delay_draw(c.delay, uniforms(key, contact, 0, _DELAY_OF_THE_FIRST)[0])


# ---- where contacts break ----


@by_law
def carry_life(
    law: Any, c: Contacts, xi: float, k: float, y: float, clock: float
) -> float:
    """Travel of a life from birth to breaking, by the law of births."""
    return life(c.aging, c, xi, clock)


@carry_life.register(Stretched)
def _travel(
    law: Stretched, c: Contacts, xi: float, k: float, y: float, clock: float
) -> float:
    return travel(c, xi, k, y, clock)


@by_law
def carry_lives(law: Any, c: Contacts, lives: Lives, count: int) -> None:
    """Fill travel and stiffness of the first `count` lanes, by the law of births."""
    for r in range(lives.threshold.shape[0]):
        break_lives(c.aging, c, lives, r, count)


@carry_lives.register(Stretched)
def _carry_stretched(law: Stretched, c: Contacts, lives: Lives, count: int) -> None:
    birth, clock = lives.birth, lives.clock
    for r in range(ROUNDS):
        for i in range(count):
            xi = lives.threshold[r, i]
            stiffness = kappa(c.springs, xi)
            lives.stiffness[r, i] = stiffness
            lives.travel[r, i] = travel(c, xi, stiffness, birth[r, i], clock[r, i])


@break_lives.register(Langevin)
def _walk_lives(law: Langevin, c: Contacts, lives: Lives, r: int, count: int) -> None:
    lanes, number = lives.followed.lanes, lives.followed.lanes.number
    for i in range(count):
        number[i] = ROUNDS * lanes.age[i] + r
    threshold = lives.threshold[r, :count]
    carried, work = lives.travel[r], lives.work[r]
    begun = lanes.contact, number, threshold, lives.clock[r]
    paths, walkers = langevin.Paths(*begun, carried, work), lives.followed.walkers
    langevin.walk_all(langevin.pinned(c, 1.0), lanes.key, langevin.STEP, paths, walkers)


@by_law
def life_work(law: Any, c: Contacts, lives: Lives, r: int, i: int) -> float:
    """Integral of (k_i/k) x dx from birth to breaking, by the law of aging."""
    stiffness, carried = lives.stiffness[r, i], lives.travel[r, i]
    alone = work_of(law, c.aging_table, c.springs, stiffness, carried)
    return alone + stiffness * carried * lives.birth[r, i]


@life_work.register(Langevin)
def _path_work(law: Langevin, c: Contacts, lives: Lives, r: int, i: int) -> float:
    return lives.work[r, i]


# ---- recorders ----


@by_law
def admit(recorder: Any, c: Contacts, lanes: Lanes, lane: int, contact: int) -> bool:
    """Put a contact into an idle lane; False if it has no birth before its end. Fills
    its number, how often lives were drawn for it, and the position of its next birth:
    by default `recorder.begin` and 0."""
    lanes.contact[lane] = contact
    lanes.age[lane] = recorder.begin
    lanes.position[lane] = 0.0
    return True


@by_law
def note_lives(
    recorder: Any, c: Contacts, lanes: Lanes, lives: Lives, r: int, active: int
) -> bool:
    """Record the lives of round r of the `active` lanes, and move these contacts to
    their next births, at infinity if that is beyond their end. Lanes from `active` to
    `padded(active)` are idle, and may be overwritten. Returns whether any contact has
    come to its end."""
    raise TypeError("no recorder")


@by_law
def move_lane(recorder: Any, source: int, target: int) -> None:
    """Move what a recorder keeps for a lane to another lane."""


@kernel
def follow(
    c: Contacts, recorder: Any, first: int, last: int, lanes: Lanes, lives: Lives
) -> None:
    """Follow contacts first <= i < last to their ends. `lanes` are idle, and `lives`
    empty. Contacts begin together, so that they all write in one stretch of a grid, and
    new ones fill the lanes only when half of them have come to their ends."""
    contact, age, position = lanes.contact, lanes.age, lanes.position
    active = np.int64(0)  # typed: a literal 0 would be compiled for itself
    upcoming = np.int64(first)
    while True:
        if 2 * active <= LANES:
            while active < LANES and upcoming < last:
                if admit(recorder, c, lanes, active, upcoming):
                    active += 1
                upcoming += 1
        if active == 0 or recorder.stop[0] != 0:
            return
        count = padded(active)
        draw_lives(c.newborn, c, lanes, lives, count)
        carry_lives(c.newborn, c, lives, count)
        ended = False
        for r in range(ROUNDS):
            if note_lives(recorder, c, lanes, lives, r, active):
                ended = True
        for i in range(active):
            age[i] += 1
        for i in range(active - 1 if ended else -1, -1, -1):
            if position[i] == np.inf:
                active -= 1
                contact[i] = contact[active]
                age[i] = age[active]
                position[i] = position[active]
                position[active] = np.inf
                move_lane(recorder, active, i)
