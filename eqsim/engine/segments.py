"""Follow contacts along a segment at constant velocity; record forces and averages.

A contact begins in the state that the start or the segment before gave it, with the
rest of its exponential clock. Lives that begin in the segment are drawn by
`engine.lanes`. If another segment follows, the state at the end is handed on in a
`Snapshot`. Stretches count in the direction of motion. In a hold they are constant,
and time is measured as displacement at the pace of another segment. Thresholds that
fluctuate are followed step by step, up to the end of the segment. Positions are
relative to the beginning of the segment, so that forces do not cancel over long
distances.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from eqsim.engine import langevin
from eqsim.engine.contacts import Contacts
from eqsim.engine.lanes import (
    ROUNDS,
    Lanes,
    Lives,
    admit,
    carry_life,
    delay_after,
    delay_of_the_first,
    draw_birth,
    move_lane,
    note_lives,
    padded,
)
from eqsim.engine.langevin import STEP, Path, Pinned
from eqsim.engine.recorder import (
    BATCHES,
    Ramp,
    Recorder,
    Run,
    Snapshot,
    average,
    edge_after,
    fixed,
    instant,
    join_ramps,
    leave,
    leave_force,
    leave_pinned,
    leave_ramp,
    leave_ramps,
    point_at,
)
from eqsim.engine.sample import spread, typical_uniforms
from eqsim.engine.stationary import Stationary, snapshot
from eqsim.laws.aging import Langevin
from eqsim.laws.aging.base import Held, growth, spend, spent, stiffness_varies
from eqsim.laws.aging.base import work as work_of
from eqsim.laws.barrier.base import thermal
from eqsim.laws.delay import residual_delay_draw
from eqsim.laws.newborn import newborn_draw
from eqsim.laws.stiffness import kappa
from eqsim.laws.threshold import threshold_draw
from eqsim.numerics.compiled import by_law, kernel, routine
from eqsim.numerics.streams import Key, uniforms
from eqsim.numerics.tables import Array

_RELAXED = 100.0  # relaxations at rest, after which the mean hazard is constant
_MOST_CYCLES = 32000  # tried for a snapshot; all fail for one contact in e^32


class Span(NamedTuple):
    """Part of a life within a segment."""

    stiffness: float  # at birth
    stretch: float  # at `begins`, in the direction of motion
    age: float  # at `begins`
    begins: float  # position in the segment
    travel: float  # from there on; in a hold, time


# ---- contacts at the beginning of a segment ----


@admit.register(Recorder)
def _admit(
    recorder: Recorder, c: Contacts, lanes: Lanes, lane: int, contact: int
) -> bool:
    run, averaging = recorder.run, recorder.averaging
    x, age = enter(recorder.start, recorder, lanes.key, contact)
    if x > run.length:
        return False
    lanes.contact[lane] = contact
    lanes.age[lane] = age
    lanes.position[lane] = x
    averaging.edge[lane] = edge_after(run, x)
    averaging.since[lane] = x
    averaging.lives[lane] = ROUNDS * age
    averaging.work[lane] = 0.0
    averaging.pinned[lane] = 0.0
    if recorder.joined:
        leave(recorder, point_at(run, x), 1, 1.0, x)
    return True


@move_lane.register(Recorder)
def _move_lane(recorder: Recorder, source: int, target: int) -> None:
    averaging = recorder.averaging
    averaging.edge[target] = averaging.edge[source]
    averaging.since[target] = averaging.since[source]
    averaging.lives[target] = averaging.lives[source]
    averaging.work[target] = averaging.work[source]
    averaging.pinned[target] = averaging.pinned[source]


@by_law
def enter(start: Any, recorder: Recorder, key: Key, contact: int) -> tuple[float, int]:
    """Record the life or delay that a contact begins the segment in, by the type of the
    start. Returns the position of its next birth, infinity if that is in a later
    segment, and how often lives were drawn for it."""
    return 0.0, 0


@enter.register(Snapshot)
def _enter_between(
    p: Snapshot, recorder: Recorder, key: Key, contact: int
) -> tuple[float, int]:
    run, i = recorder.run, contact - p.first
    lives, reborn = p.lives[i] // ROUNDS, p.wait[i] * run.ratio
    if p.pinned[i]:
        p.delay[i] *= run.ratio
        broke = go_on(recorder.laws.aging, recorder, key, i)
        if broke == math.inf:
            return math.inf, lives
        p.pinned[i] = False
        reborn = broke + p.delay[i]
    p.wait[i] = reborn - run.length
    return (reborn if reborn <= run.length else math.inf), lives


@enter.register(Stationary)
def _enter_stationary(
    start: Stationary, recorder: Recorder, key: Key, contact: int
) -> tuple[float, int]:
    return found_at_start(recorder.laws.aging, recorder, key, contact), 1


@by_law
def found_at_start(law: Any, recorder: Recorder, key: Key, contact: int) -> float:
    """Record the life or delay that a snapshot of the stationary state finds, by the
    law of aging. Returns the position of the next birth."""
    c, batch = recorder.laws, contact % BATCHES
    seen = snapshot(c.newborn, c, recorder.start, key, contact)
    if not seen.pinned:
        average(recorder, batch, Ramp(0.0, 0.0, 0.0, 0.0), seen.wait)
        return seen.wait
    stiffness = kappa(c.springs, seen.threshold)
    broke = seen.length - seen.age
    reborn = broke + delay_of_the_first(c, key, contact)
    span = Span(stiffness, seen.stretch, 0.0, -seen.age, seen.length)
    left = leave_span(recorder, batch, span)
    ramp = Ramp(left, -seen.age - seen.stretch, -seen.age, broke)
    average(recorder, batch, ramp, reborn)
    return reborn


@found_at_start.register(Langevin)
def _path_at_start(law: Any, recorder: Recorder, key: Key, contact: int) -> float:
    """Draw cycles of life and delay until one is under way at X = 0. Each begins at a
    uniform distance before X = 0, within the longest cycle, so that a cycle is accepted
    in proportion to its length (derived). An exponential delay is treated as a fixed
    one of the same mean, since the rest of it is exponential again."""
    c, batch = recorder.laws, contact % BATCHES
    delay = c.delay.mean
    longest = recorder.start.longest + delay
    born, broke, reborn = 0.0, 0.0, 0.0
    for attempt in range(_MOST_CYCLES):
        rank, tick = uniforms(key, contact, 0, 2 * attempt + 1)
        age = longest * uniforms(key, contact, 0, 2 * attempt + 2)[0]
        xi, number = threshold_draw(c.thresholds, rank), 2**32 - 1 - attempt
        path = Path(key, contact, number, np.int64(0), xi, 0.0, -math.log(tick))
        ends, _ = leave_path(langevin.pinned(c, 1.0), recorder, batch, path, -age)
        if ends + delay > 0.0:
            born, broke, reborn = -age, ends, ends + delay_of_the_first(c, key, contact)
            if ends <= 0.0:
                rest = residual_delay_draw(c.delay, uniforms(key, contact, 0, 0)[1])
                broke, reborn = 0.0, rest if c.delay.random > 0.0 else ends + delay
            break
    average(recorder, batch, Ramp(c.springs.constant, born, born, broke), reborn)
    return reborn


@by_law
def go_on(law: Any, recorder: Recorder, key: Key, i: int) -> float:
    """Follow pinned contact i of a snapshot through the segment, by the law of aging.
    Returns the position where it breaks, or infinity, and then stores its state at the
    end."""
    c, run, p = recorder.laws, recorder.run, recorder.start
    stiffness = kappa(c.springs, p.threshold[i])
    y, age = run.sign * p.stretch[i], p.age[i] * run.ratio
    contact = Held(p.threshold[i], stiffness, y, age)
    if run.goes_on:
        broke, left = p.still[i], 0.0
        if broke > run.length:
            left = max(p.clock[i] - spent(law, c, contact, run.moves, run.length), 0.0)
    else:
        broke, left = spend(law, c, contact, run.moves, run.length, p.clock[i])
    leave_span(recorder, 0, Span(stiffness, y, age, 0.0, broke))
    if broke <= run.length:
        return broke
    p.stretch[i] = run.sign * (y + run.moves * run.length)
    p.clock[i] = left
    p.age[i] = age + run.length
    return math.inf


@go_on.register(Langevin)
def _path_goes_on(law: Langevin, recorder: Recorder, key: Key, i: int) -> float:
    p, y = recorder.start, recorder.run.sign * recorder.start.stretch[i]
    contact, life, draw = p.first + i, p.life[i], p.draw[i]
    path = Path(key, contact, life, draw, p.threshold[i], y, p.clock[i])
    return leave_path_to_end(recorder, 0, path, 0.0)


@routine
def leave_path_to_end(
    recorder: Recorder, batch: int, path: Path, begins: float
) -> float:
    """`leave_path`, and store the path where it does not break in the segment. Returns
    where it breaks."""
    laws = langevin.pinned(recorder.laws, float(recorder.run.moves))
    broke, path = leave_path(laws, recorder, batch, path, begins)
    if broke == math.inf:
        keep_path(recorder.start, recorder.run, path)
    return broke


@by_law
def keep_path(start: Any, run: Run, path: Path) -> None:
    """Store a path at the end of a segment, if the start is a `Snapshot`."""


@keep_path.register(Snapshot)
def _keep_path(p: Snapshot, run: Run, path: Path) -> None:
    i = path.contact - p.first
    p.threshold[i] = path.xi
    p.stretch[i] = run.sign * path.x
    p.clock[i] = path.left
    p.life[i] = path.life
    p.draw[i] = path.draw


# ---- recording lives ----


@note_lives.register(Recorder)
def _note_lives(
    recorder: Recorder, c: Contacts, lanes: Lanes, lives: Lives, r: int, active: int
) -> bool:
    """Record the lives of all lanes at once. A contact's lives come in order of
    position, so their averages are summed in its lane, and added to a window when a
    life crosses its edge. Returns whether any contact has reached the end of the
    segment."""
    averaging, position, count = recorder.averaging, lanes.position, padded(active)
    broke, reborn, edge = averaging.broke, averaging.reborn, averaging.edge
    work, pinned = averaging.work, averaging.pinned
    travel, stiffness, delay = lives.travel, lives.stiffness, lives.delay
    for i in range(count):
        work[i] += 0.5 * stiffness[r, i] * travel[r, i] * travel[r, i]
        broke[i] = position[i] + travel[r, i]
    if recorder.joined:
        for i in range(count):
            reborn[i] = broke[i]
        join_ramps(recorder, position[:count], broke[:count])
    else:
        for i in range(count):
            pinned[i] += travel[r, i]
            reborn[i] = broke[i] + delay[r, i]
        uniform, born = c.springs.slope == 0.0, position[:count]
        leave_ramps(recorder, born, broke[:count], stiffness[r, :count], uniform)
    crossing = 0
    for i in range(active):
        crossing += reborn[i] > edge[i]
    ended = crossing > 0 and cross_edges(recorder, lanes, lives, r, active)
    for i in range(active):
        position[i] = reborn[i]
    return ended


@routine(inline=True)
def cross_edges(
    recorder: Recorder, lanes: Lanes, lives: Lives, r: int, active: int
) -> bool:
    """Add the sums of contacts whose lives cross the edge of a window to it, and these
    lives, too. Returns whether any contact has reached the end of the segment."""
    run, averaging, scales = recorder.run, recorder.averaging, recorder.window_scales
    edge, broke, reborn = averaging.edge, averaging.broke, averaging.reborn
    position, ended = lanes.position, False
    for i in range(active):
        if reborn[i] <= edge[i]:
            continue
        batch, number = lanes.contact[i] % BATCHES, ROUNDS * lanes.age[i] + r
        x, stiffness = lives.travel[r, i], lives.stiffness[r, i]
        if run.averages and edge[i] > 0.5 * run.length:
            window = recorder.windows[batch, 0 if edge[i] < run.length else 1]
            elapsed = position[i] - averaging.since[i]
            # Always pinned without delay: the same number, not a rounded sum.
            delayed = recorder.laws.delay.mean > 0.0
            pinned = averaging.pinned[i] - x if delayed else elapsed
            work = averaging.work[i] - 0.5 * stiffness * x * x
            window.area += fixed(work, scales.area)
            window.pinned += fixed(pinned, scales.pinned)
            window.elapsed += fixed(elapsed, scales.elapsed)
            window.breaks += number - averaging.lives[i]
            window.stretch += fixed(pinned, scales.stretch)
            window.travel += fixed(pinned, scales.travel)
        if run.averages:
            ramp = Ramp(stiffness, position[i], position[i], broke[i])
            average(recorder, batch, ramp, reborn[i])
        recorder.lives[0] += number + 1 - averaging.lives[i]
        if reborn[i] > run.length:
            xi, y, clock = lives.threshold[r, i], lives.birth[r, i], lives.clock[r, i]
            contact, delay = lanes.contact[i], lives.delay[r, i]
            life = Path(lanes.key, contact, number, np.int64(0), xi, y, clock)
            hand_on(recorder.start, recorder, life, position[i], broke[i], delay)
            reborn[i] = math.inf
            ended = True
        edge[i] = edge_after(run, reborn[i])
        averaging.since[i] = reborn[i]
        averaging.lives[i] = number + 1
        averaging.work[i] = 0.0
        averaging.pinned[i] = 0.0
    return ended


@kernel
def follow_alone(recorder: Recorder, key: Key, first: int, last: int) -> None:
    """Follow contacts first <= i < last to the end of the segment, one after the
    other, and record life by life."""
    run, c = recorder.run, recorder.laws
    for contact in range(first, last):
        born, drawn = enter(recorder.start, recorder, key, contact)
        number = ROUNDS * drawn
        while born <= run.length:
            if recorder.stop[0] != 0:
                return
            xi, y, clock = draw_birth(c.newborn, c, key, contact, number)
            life = Path(key, contact, number, np.int64(0), xi, y, clock)
            delay = delay_after(c, key, contact, number)
            stiffness, broke = leave_life(c.aging, recorder, life, born)
            reborn = broke + delay
            if run.averages and reborn > 0.5 * run.length:
                ramp = Ramp(stiffness, born - y, born, broke)
                average(recorder, batch_of(run, life), ramp, reborn)
            recorder.lives[0] += 1
            if reborn > run.length:
                hand_on(recorder.start, recorder, life, born, broke, delay)
            born = reborn
            number += 1


@routine(inline=True)
def batch_of(run: Run, life: Path) -> Any:
    """Batch of averages that a life belongs to."""
    return (life.contact + life.life * run.batch_by_life) % BATCHES


@by_law
def leave_life(
    law: Any, recorder: Recorder, life: Path, born: float
) -> tuple[float, float]:
    """Record a life that begins in the segment, by the law of aging. Returns the
    stiffness for `average`, 0 if its work is recorded already, and where the life
    ends."""
    run, c = recorder.run, recorder.laws
    stiffness = kappa(c.springs, life.xi)
    if run.moves == 0:
        contact, longest = Held(life.xi, stiffness, life.x, 0.0), run.length - born
        travel = spend(law, c, contact, 0, longest, life.left)[0]
    else:
        travel = carry_life(c.newborn, c, life.xi, stiffness, life.x, life.left)
    span = Span(stiffness, life.x, 0.0, born, travel)
    return leave_span(recorder, batch_of(run, life), span), born + travel


@leave_life.register(Langevin)
def _leave_drawn_path(
    law: Any, recorder: Recorder, life: Path, born: float
) -> tuple[float, float]:
    broke = leave_path_to_end(recorder, batch_of(recorder.run, life), life, born)
    return recorder.laws.springs.constant, broke


@routine
def leave_span(recorder: Recorder, batch: int, span: Span) -> float:
    """Record the force of a contact that is pinned for a span of a segment. Returns the
    stiffness for `average`, 0 if its work is recorded already."""
    c, run, begins, stiffness = recorder.laws, recorder.run, span.begins, span.stiffness
    ends = begins + span.travel
    if not stiffness_varies(c.aging, c.springs):
        origin = begins - span.stretch if run.moves != 0 else -span.stretch
        leave_ramp(recorder, Ramp(stiffness, origin, begins, ends))
        return stiffness
    for j in range(point_at(run, begins), min(point_at(run, ends), run.points)):
        elapsed = max(instant(run, j) - begins, 0.0)
        x = span.stretch + elapsed * run.moves
        leave_force(recorder, j, stiffness * growth(c.aging, span.age + elapsed) * x)
    leave_pinned(recorder, begins, ends)
    for quarter in range(2 if run.averages else 0):
        low = max(run.length * (0.5 + 0.25 * quarter) - begins, 0.0)
        high = min(run.length * (0.75 + 0.25 * quarter) - begins, span.travel)
        if high > low:
            until = work_of(c.aging, c.aging_table, c.springs, stiffness, high)
            before = work_of(c.aging, c.aging_table, c.springs, stiffness, low)
            work = fixed(until - before, recorder.window_scales.area)
            recorder.windows[batch, quarter].area += work
    return 0.0


@routine
def leave_path(
    laws: Pinned, recorder: Recorder, batch: int, path: Path, begins: float
) -> tuple[float, Path]:
    """Record the path of a contact whose threshold fluctuates, from `begins` on, where
    it may be stretched already. Returns where it breaks, infinity if that is in a later
    segment, and the path there."""
    run = recorder.run
    if laws.springs.slope == 0.0:
        origin = begins - path.x if run.moves != 0 else -path.x
        longest = math.inf if run.averages else run.length - begins
        broken, path, travel, _ = langevin.follow(laws, path, longest, STEP)
        ends = begins + travel if broken else math.inf
        if broken and not run.averages:
            ends = min(ends, run.length)
        leave_ramp(recorder, Ramp(laws.springs.constant, origin, begins, ends))
        return ends, path
    if run.moves == 0:
        return leave_path_at_rest(laws, recorder, path, begins)
    return leave_stiffening_path(laws, recorder, batch, path, begins)


@routine
def leave_path_at_rest(
    laws: Pinned, recorder: Recorder, path: Path, begins: float
) -> tuple[float, Path]:
    """Record a path in a hold, of a contact whose stiffness follows its threshold.
    Steps end at the instants that are recorded."""
    run, now = recorder.run, begins
    for j in range(point_at(run, begins), run.points):
        longest = run.instants[j] - now
        broken, path, elapsed, _ = langevin.follow(laws, path, longest, STEP)
        if broken:
            return min(now + elapsed, run.length), path
        now = run.instants[j]
        leave_force(recorder, j, kappa(laws.springs, path.xi) * path.x)
        recorder.deposits[j].count += 1
        recorder.deposits[j + 1].count -= 1
    return math.inf, path


@routine
def leave_stiffening_path(
    laws: Pinned, recorder: Recorder, batch: int, path: Path, begins: float
) -> tuple[float, Path]:
    """Record a path in motion, of a contact whose stiffness follows its threshold.
    Steps end at grid points and at edges of windows of averages. The path is not
    followed beyond the last of these."""
    run = recorder.run
    step, quarters, y = run.length / (run.points - 1), 0.25 * run.length, path.x
    s, broken = 0.0, False  # travel so far, which y + s may round away
    j = point_at(run, begins)
    window = max(2, math.floor(begins / quarters) + 1)  # ends at window * quarters
    while not broken:
        if j < run.points and j * step - begins <= s:
            leave_force(recorder, j, kappa(laws.springs, path.xi) * path.x)
            j += 1
            continue
        if window * quarters - begins <= s:
            window += 1
            continue
        if window > 4 and j >= run.points:
            break
        stop = window * quarters - begins
        if j < run.points:
            stop = min(stop, j * step - begins)
        broken, path, h, work = langevin.stride(laws, path, stop - s, STEP)
        if run.averages and 2 < window < 5:
            area = fixed(work, recorder.window_scales.area)
            recorder.windows[batch, window - 3].area += area
        reached = not broken and s + h >= stop * (1.0 - 1e-15)
        s = stop if reached else s + h
        x = y + s if reached else path.x
        path = langevin.moved(path, path.draw, path.xi, x, path.left)
    ends = begins + s if broken and begins + s <= run.length else math.inf
    leave_pinned(recorder, begins, ends)
    return ends, path


# ---- handing contacts on to the next segment ----


@by_law
def hand_on(
    start: Any, recorder: Recorder, life: Path, born: float, broke: float, delay: float
) -> None:
    """Store the state of a contact after its last birth in a segment for the next one,
    if the start is a `Snapshot`."""


@hand_on.register(Snapshot)
def _hand_on(
    p: Snapshot, recorder: Recorder, life: Path, born: float, broke: float, delay: float
) -> None:
    run = recorder.run
    if run.last:
        return
    i = life.contact - p.first
    p.lives[i] = ROUNDS * (life.life // ROUNDS + 1)
    p.delay[i] = delay
    p.pinned[i] = broke > run.length
    p.wait[i] = broke + delay - run.length
    if broke > run.length:
        keep_life(recorder.laws.aging, recorder, life, born)


@by_law
def keep_life(law: Any, recorder: Recorder, life: Path, born: float) -> None:
    """Store a pinned contact at the end of a segment, by the law of aging."""
    c, run, p = recorder.laws, recorder.run, recorder.start
    i, age = life.contact - p.first, run.length - born
    stiffness = kappa(c.springs, life.xi)
    contact = Held(life.xi, stiffness, life.x, 0.0)
    p.threshold[i] = life.xi
    p.stretch[i] = run.sign * (life.x + run.moves * age)
    p.clock[i] = max(life.left - spent(law, c, contact, run.moves, age), 0.0)
    p.age[i] = age


@keep_life.register(Langevin)
def _keep_no_life(law: Langevin, recorder: Recorder, life: Path, born: float) -> None:
    pass  # `keep_path` has stored it


# ---- stationary starts ----


@kernel
def begin_stationary(
    c: Contacts, stationary: Stationary, key: Key, p: Snapshot
) -> None:
    """Fill a population from a snapshot of the steady state of `c`."""
    for i in range(p.wait.size):
        contact = p.first + i
        seen = snapshot(c.newborn, c, stationary, key, contact)
        p.lives[i] = ROUNDS
        p.pinned[i] = seen.pinned
        p.wait[i] = seen.wait
        if seen.pinned:
            stiffness = kappa(c.springs, seen.threshold)
            born = Held(seen.threshold, stiffness, seen.stretch, 0.0)
            passed = spent(c.aging, c, born, 1, seen.age)
            p.threshold[i] = seen.threshold
            p.stretch[i] = seen.stretch + seen.age
            p.clock[i] = max(seen.clock - passed, 0.0)
            p.age[i] = seen.age
            p.still[i] = seen.length - seen.age
            p.delay[i] = delay_of_the_first(c, key, contact)


# ---- durations of lives at rest ----


def waits_at_rest(c: Contacts, most: float) -> Array:
    """Durations of lives at rest, cut off at `most`, for `typical_uniforms` of
    thresholds and clocks."""
    u, v = typical_uniforms(c)
    waits = np.empty(u.size)
    fill_waits(c, u, v, spread(u.size), most, waits)
    return np.minimum(waits, most)


@kernel
def fill_waits(
    c: Contacts, u: Array, v: Array, birth: Array, most: float, waits: Array
) -> None:
    """Fill the durations of `waits_at_rest`; those beyond `most` may be infinite."""
    for i in range(u.size):
        xi, y = newborn_draw(c.newborn, c.thresholds, u[i], birth[i])
        contact = Held(xi, kappa(c.springs, xi), y, 0.0)
        waits[i] = wait_at_rest(c.aging, c, contact, -math.log(v[i]), most, i)


@by_law
def wait_at_rest(
    law: Any, c: Contacts, contact: Held, clock: float, most: float, i: int
) -> float:
    """Duration of a life at rest, by the law of aging; path number `i` if thresholds
    fluctuate. Beyond `most` any longer time, or infinity."""
    return spend(law, c, contact, 0, most, clock)[0]


@wait_at_rest.register(Langevin)
def _path_at_rest(
    law: Langevin, c: Contacts, contact: Held, clock: float, most: float, i: int
) -> float:
    if not thermal(c.barrier):
        return math.inf
    laws = langevin.pinned(c, 0.0)
    key, first = Key(np.uint64(0), np.uint64(0)), np.int64(0)
    path = Path(key, i, first, first, contact.threshold, 0.0, clock)
    longest = min(_RELAXED / law.alpha, most)
    broke, path, elapsed, _ = langevin.follow(laws, path, longest, STEP)
    # From here on the hazard grows in proportion to time.
    return elapsed if broke else elapsed * (clock / (clock - path.left))
