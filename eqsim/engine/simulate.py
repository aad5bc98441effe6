"""One kernel for every run: contacts are followed over the whole distance, LANES at a time."""

import math
from typing import Any, NamedTuple

import numpy as np

from eqsim.engine import langevin
from eqsim.engine.contacts import Contacts
from eqsim.engine.lanes import LANES, ROUNDS, Lanes, Lives, complete, draw_lives, empty_lanes, empty_lives
from eqsim.engine.recorder import (
    AREA,
    BATCHES,
    BREAKS,
    ELAPSED,
    PINNED,
    STRETCH,
    TRAVEL,
    Columns,
    Recorder,
    deposit,
    edge_after,
    empty_columns,
    fixed,
    follow_growth,
    follow_path,
    join_uniform_ramps,
    joined,
    leave,
    leave_ramps,
    leave_uniform_ramps,
    record,
)
from eqsim.engine.stationary import Fresh, Stationary, snapshot
from eqsim.laws.aging import Flow, Langevin
from eqsim.laws.aging.base import stiffness_varies
from eqsim.laws.delay import Waits, delay_draw, residual_delay_draw
from eqsim.laws.newborn import born_stretched
from eqsim.laws.stiffness import kappa
from eqsim.laws.threshold import threshold_draw
from eqsim.numerics.compiled import by_law, kernel, routine
from eqsim.numerics.streams import Key, fill_words, uniform, uniforms
from eqsim.numerics.tables import Array


class Journey(NamedTuple):
    """Where the contacts in the lanes are, arrays (LANES,) of displacements: births of the next life, where it breaks
    and where the contact is pinned again; and since the last edge of an averaging window, which was at `since` when a
    contact was `mark` lives old, its work over k and displacement while pinned. `edge` is the next edge; idle lanes are
    at infinity. `delay` (ROUNDS, LANES) follows each of the next lives."""

    position: Array
    broke: Array
    reborn: Array
    edge: Array
    since: Array
    mark: Array
    work: Array
    distance: Array
    delay: Array


@kernel
def simulate(c: Contacts, start: Fresh | Stationary, recorder: Recorder, key: Key, first: int, last: int) -> None:
    """Follow contacts first <= i < last over the whole distance and add up what they leave.

    A contact's lives come in order of position, so what they leave in the batch sums is added up on the way and noted
    when a life crosses the end of a quarter; only that life has to be divided. Contacts start together, so that they
    all write in one stretch of the grid, and new ones fill the lanes only when half of them have come to the end.
    """
    lanes, lives, journey, columns = empty_lanes(), empty_lives(c, ROUNDS), empty_journey(c), empty_columns()
    # contacts that are recorded one by one
    alone = recorder.run.batch_by_life or stiffness_varies(c.aging, c.springs) or born_stretched(c.newborn)
    age, position = lanes.age, journey.position  # out of loops: numba counts references where it takes from a tuple
    active, upcoming = np.int64(0), np.int64(first)  # typed: a literal 0 would be compiled for itself
    while True:
        if 2 * active <= LANES:
            active, upcoming = fill_lanes(c, start, recorder, key, lanes, journey, (active, upcoming, np.int64(last)))
        if active == 0 or recorder.status[1] != 0:
            return
        full = min(LANES, (active + 31) // 32 * 32)  # no loop has a tail of single lanes; what is left over is idle
        draw_lives(c.newborn, c, key, lanes, lives, full)
        if c.delay.random > 0.0:
            draw_delays(c.delay, key, lanes, journey.delay, full)
        advance(c.aging, c, key, lanes, lives, alone, (active, full))
        ended = False
        for r in range(ROUNDS):
            if alone:
                for i in range(active):
                    if position[i] <= recorder.run.distance:
                        position[i] = live(c, recorder, key, lanes, lives, journey, (r, i))
                        recorder.status[0] += 1
                ended = True
            elif record_round(c, recorder, lanes, lives, journey, columns, (r, active, full)):
                ended = True
        for i in range(active):
            age[i] += 1
        if ended:
            active = _retire(recorder.run.distance, lanes, journey, active)


@routine
def empty_journey(c: Contacts) -> Journey:
    position, edge, since = np.empty(LANES), np.empty(LANES), np.empty(LANES)
    mark, work, distance = np.empty(LANES, np.int64), np.empty(LANES), np.empty(LANES)
    delay = np.empty((ROUNDS, LANES))
    for i in range(LANES):
        position[i] = math.inf
        for r in range(ROUNDS):
            delay[r, i] = c.delay.mean
    return Journey(position, np.empty(LANES), np.empty(LANES), edge, since, mark, work, distance, delay)


@routine
def fill_lanes(
    c: Contacts, start: Fresh | Stationary, recorder: Recorder, key: Key, lanes: Lanes, journey: Journey,
    queue: tuple[int, int, int],
) -> tuple[int, int]:  # fmt: skip
    """Fill the lanes from `active` on with the contacts from `upcoming` up to `last`, which are the `queue`; what it is
    then."""
    active, upcoming, last = queue
    run, position = recorder.run, journey.position
    per_step = (run.points - 1) / run.distance
    oldest = 1 if run.stationary else 0
    while active < LANES and upcoming < last:
        lanes.contact[active], lanes.age[active] = upcoming, oldest
        position[active] = found_at_start(start, c, recorder, key, upcoming)
        upcoming += 1
        x = position[active]
        if x > run.distance:
            position[active] = math.inf
            continue
        if joined(c, recorder) and x * per_step <= run.points - 1:
            leave(recorder, math.ceil(x * per_step), 1, 1.0, x)
        journey.edge[active], journey.since[active], journey.mark[active] = edge_after(run, x), x, ROUNDS * oldest
        journey.work[active], journey.distance[active] = 0.0, 0.0
        active += 1
    return active, upcoming


@routine
def _retire(distance: float, lanes: Lanes, journey: Journey, active: int) -> int:
    """Give the lanes of contacts that have come to the end to the last ones; how many are left."""
    j = journey
    for i in range(active - 1, -1, -1):
        if j.position[i] > distance:
            active -= 1
            lanes.contact[i], lanes.age[i], j.mark[i] = lanes.contact[active], lanes.age[active], j.mark[active]
            j.position[i], j.edge[i], j.since[i] = j.position[active], j.edge[active], j.since[active]
            j.work[i], j.distance[i] = j.work[active], j.distance[active]
            j.position[active] = math.inf
    return active


# ------------------------------------------------------------------------------------------------- drawing lives


@routine
def draw_delays(law: Waits, key: Key, lanes: Lanes, delay: Array, count: int) -> None:
    """Delays after the next ROUNDS lives, shape (ROUNDS, lanes), where they are random."""
    words = lanes.words
    fill_words(key, lanes.contact, lanes.age, 1, words, count)
    for r in range(ROUNDS):
        for i in range(count):
            delay[r, i] = delay_draw(law, uniform(words[2 * r, i], words[2 * r + 1, i]))


@by_law
def advance(law: Any, c: Contacts, key: Key, lanes: Lanes, lives: Lives, alone: bool, counts: tuple[int, int]) -> None:
    """Travels in the place of thresholds of the lanes, `counts` of which are active and in full use."""
    complete(law, c, key, lanes, lives, counts[1])


@advance.register(Langevin)
def _advance_paths(
    law: Langevin, c: Contacts, key: Key, lanes: Lanes, lives: Lives, alone: bool, counts: tuple[int, int]
) -> None:
    if not alone:  # else each is followed while it is recorded
        complete(law, c, key, lanes, lives, counts[0])


# --------------------------------------------------------------------------------------------- recording together


@routine(inline=True)
def record_round(
    c: Contacts, recorder: Recorder, lanes: Lanes, lives: Lives, journey: Journey, columns: Columns,
    counts: tuple[int, int, int],
) -> bool:  # fmt: skip
    """What the lives of round r leave, `counts` = r, active and full; whether a contact has come to the end."""
    r, active, full = counts
    position, broke, reborn, edge = journey.position, journey.broke, journey.reborn, journey.edge
    work, distance, delay = journey.work, journey.distance, journey.delay
    stretch, stiffness = lives.stretch, lives.stiffness
    for i in range(full):
        x = stretch[r, i]
        work[i] += 0.5 * stiffness[r, i] * x * x
        broke[i] = position[i] + x
        reborn[i] = broke[i]
    if joined(c, recorder):
        join_uniform_ramps(recorder, position, broke, columns, full)
    else:
        for i in range(full):
            distance[i] += stretch[r, i]
            reborn[i] = broke[i] + delay[r, i]
        if c.springs.slope == 0.0:
            leave_uniform_ramps(recorder, position, broke, columns, full)
        else:
            leave_ramps(recorder, position, broke, lives, r, columns, full)
    crossing, ended = 0, False
    for i in range(active):
        crossing += reborn[i] > edge[i]
    for i in range(active if crossing > 0 else 0):
        if reborn[i] > edge[i]:
            ended = _cross(c, recorder, lanes, lives, journey, (r, i)) or ended
    for i in range(active):
        position[i] = reborn[i]
    return ended


@routine
def _cross(
    c: Contacts, recorder: Recorder, lanes: Lanes, lives: Lives, journey: Journey, which: tuple[int, int]
) -> bool:
    """What a contact's lives and delays leave in the window that ends at its edge, and a last life that crosses it;
    whether it has come to the end."""
    r, i = which
    run, batches, scales, batch = recorder.run, recorder.batches, recorder.batch_scales, lanes.contact[i] % BATCHES
    x, spring, life = lives.stretch[r, i], lives.stiffness[r, i], ROUNDS * lanes.age[i] + r
    if journey.edge[i] > 0.5 * run.distance:
        quarter = 0 if journey.edge[i] < run.distance else 1
        elapsed = journey.position[i] - journey.since[i]
        pinned = elapsed if c.delay.mean == 0.0 else journey.distance[i] - x  # to the last bit
        batches[batch, quarter, AREA] += fixed(journey.work[i] - 0.5 * spring * x * x, scales[AREA])
        batches[batch, quarter, PINNED] += fixed(pinned, scales[PINNED])
        batches[batch, quarter, ELAPSED] += fixed(elapsed, scales[ELAPSED])
        batches[batch, quarter, BREAKS] += life - journey.mark[i]
        batches[batch, quarter, STRETCH] += fixed(pinned, scales[STRETCH])
        batches[batch, quarter, TRAVEL] += fixed(pinned, scales[TRAVEL])
    reborn = journey.reborn[i]
    record(recorder, batch, spring, journey.position[i], journey.position[i], journey.broke[i], reborn)
    journey.edge[i], journey.since[i], journey.mark[i] = edge_after(run, reborn), reborn, life + 1
    journey.work[i], journey.distance[i] = 0.0, 0.0
    if reborn > run.distance:
        recorder.status[0] += life + 1 - (ROUNDS if run.stationary else 0)
        return True
    return False


# ------------------------------------------------------------------------------------------- recording one by one


@routine
def live(
    c: Contacts, recorder: Recorder, key: Key, lanes: Lanes, lives: Lives, journey: Journey, which: tuple[int, int]
) -> float:
    """One life on its own and the delay after it, and where they end."""
    r, i = which
    life, born, run = ROUNDS * lanes.age[i] + r, journey.position[i], recorder.run
    batch = (lanes.contact[i] + life * run.batch_by_life) % BATCHES
    path = langevin.Path(
        key, lanes.contact[i], life, np.int64(0), lives.stretch[r, i], lives.birth[r, i], lives.clock[r, i]
    )  # fmt: skip
    stretch, stiffness = leave_life(c.aging, c, recorder, batch, path, lives.stiffness[r, i], born)
    broke = born + stretch
    reborn = broke + journey.delay[r, i]
    if reborn > 0.5 * run.distance:
        record(recorder, batch, stiffness, born - lives.birth[r, i], born, broke, reborn)
    return reborn


@by_law
def leave_life(
    law: Any, c: Contacts, recorder: Recorder, batch: int, life: langevin.Path, stiffness: float, born: float
) -> tuple[float, float]:
    """What one life leaves that begins at `born`: its travel, and the stiffness of which `record` has yet to note the
    work. `life.x` is the stretch at birth, and `life.xi` the travel, or the threshold at birth if that fluctuates."""
    deposit(recorder, stiffness, born - life.x, born, born + life.xi)
    return life.xi, stiffness


@leave_life.register(Flow)
def _leave_flow(
    law: Flow, c: Contacts, recorder: Recorder, batch: int, life: langevin.Path, stiffness: float, born: float
) -> tuple[float, float]:
    if c.springs.slope > 0.0:
        follow_growth(c, recorder, batch, stiffness, born, life.xi)
        return life.xi, 0.0
    deposit(recorder, stiffness, born, born, born + life.xi)
    return life.xi, stiffness


@leave_life.register(Langevin)
def _leave_path(
    law: Langevin, c: Contacts, recorder: Recorder, batch: int, life: langevin.Path, stiffness: float, born: float
) -> tuple[float, float]:
    stretch, _ = follow_path(langevin.pinned(c), recorder, batch, life, born)
    return stretch, c.springs.constant


# ------------------------------------------------------------------------------------------------ stationary start


@by_law
def found_at_start(start: Any, c: Contacts, recorder: Recorder, key: Key, contact: int) -> float:
    """Where a contact is pinned for the first time: at once, or after what a stationary start finds, its life 0."""
    return 0.0


@found_at_start.register(Stationary)
def _after_snapshot(start: Stationary, c: Contacts, recorder: Recorder, key: Key, contact: int) -> float:
    batch = contact % BATCHES
    u_state, u_residual = uniforms(key, contact, 0, 0)
    delay = delay_draw(c.delay, uniforms(key, contact, 0, 65535)[0])
    return found(c.aging, c, start, recorder, key, (contact, batch), (u_state, u_residual, delay))


@by_law
def found(
    law: Any, c: Contacts, stationary: Stationary, recorder: Recorder, key: Key, which: tuple[int, int],
    draws: tuple[float, float, float],
) -> float:  # fmt: skip
    """What a snapshot of the stationary state finds at X = 0, and where that contact is pinned again. `which`: the
    contact and its batch; `draws`: uniforms for its state and its remaining delay, and its next delay."""
    (contact, batch), (u_state, u_residual, delay) = which, draws
    rest, xi, y, age, length, _ = snapshot(c.newborn, c, stationary, key, contact, (u_state, u_residual))
    if rest >= 0.0:
        record(recorder, batch, 0.0, 0.0, 0.0, 0.0, rest)
        return rest
    broke = length - age
    life = langevin.Path(key, contact, np.int64(0), np.int64(0), length, y, 0.0)
    _, stiffness = leave_life(law, c, recorder, batch, life, kappa(c.springs, xi), -age)
    record(recorder, batch, stiffness, -age - y, -age, broke, broke + delay)
    return broke + delay


@found.register(Langevin)
def _found_path(
    law: Langevin, c: Contacts, stationary: Stationary, recorder: Recorder, key: Key, which: tuple[int, int],
    draws: tuple[float, float, float],
) -> float:  # fmt: skip
    """A cycle of life and delay is found in proportion to its length (derived), so fresh cycles are tried, each begun
    at a uniform time before X = 0 within the longest cycle, until one is still under way. An exponential delay counts
    as a fixed one of the same mean: what is left of it is exponential again."""
    (contact, batch), (_, u_residual, delay) = which, draws
    born, broke, reborn = 0.0, 0.0, 0.0
    for attempt in range(32000):
        u, v = uniforms(key, contact, 0, 2 * attempt + 1)
        age = (stationary.longest + c.delay.mean) * uniforms(key, contact, 0, 2 * attempt + 2)[0]
        xi, number = threshold_draw(c.thresholds, u), 2**32 - 1 - attempt
        path = langevin.Path(key, contact, number, np.int64(0), xi, 0.0, -math.log(v))
        stretch, _ = follow_path(langevin.pinned(c), recorder, batch, path, -age)
        if stretch > age:
            born, broke, reborn = -age, stretch - age, stretch - age + delay
            break
        if stretch + c.delay.mean > age:
            rest = residual_delay_draw(c.delay, u_residual) if c.delay.random > 0.0 else stretch + c.delay.mean - age
            born, broke, reborn = -age, min(stretch - age, 0.0), rest
            break
    record(recorder, batch, c.springs.constant, born, born, broke, reborn)
    return reborn
