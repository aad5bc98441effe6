"""A slider that nothing but a motor slows down, event by event: under a force, behind a
stage, or behind a motor.

Between two events, a break, a birth, or a change of the drive, X(t) is known in closed
form. Under a force and behind a stage the slider is always in balance, kappa (Y - X) +
f(t) = F: it moves at a constant velocity, and jumps at a break. A motor of stall force s
and unloaded velocity u drives the slider itself, or its end of the spring, at

    u - |u| F/s,    so that    (s/|u|)(1 + A/kappa) X' = +-s - F        (derived)

with A the stiffness of what is pinned (without a spring 1/kappa is 0): an exponential
relaxation. Behind a spring X jumps at a break, too.

Breaks by heat are exact random times, drawn by thinning (Lewis and Shedler, 1979): as
long as the slider stays within a window of X, the rate of a contact is below a bound.
Candidates for its breaks come at the rate of the bound, and the next one is a break
with the probability rate/bound. Candidates and births wait in a heap, and the window is
renewed when the slider leaves it, so that nothing but the time it takes depends on its
width. A contact whose stretch reaches its threshold breaks there.

Lengths are in units of the threshold law's scale; time is displacement at the pace of
`model.reduced.Pull`; forces and energies are per contact.
"""

import math
from collections.abc import Callable
from concurrent.futures import FIRST_COMPLETED, wait
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from eqsim.engine.avalanches import events_of, put_back
from eqsim.engine.contacts import Contacts, contacts
from eqsim.engine.lanes import draw_birth
from eqsim.engine.slider import CONTACT, delay_of, find_stationary, no_end_of_slip
from eqsim.errors import InputError
from eqsim.laws.barrier.base import height, prefactor, rate
from eqsim.laws.stiffness import kappa
from eqsim.model.drive import Programme
from eqsim.model.ensemble import Ensemble
from eqsim.model.reduced import Pull, pull_of
from eqsim.numerics.compiled import kernel, routine
from eqsim.numerics.streams import TRAJECTORY, Key, words
from eqsim.numerics.streams import key as key_of
from eqsim.numerics.tables import Array
from eqsim.numerics.threads import ThreadPool

_FIRST_WIDTH = 0.1  # of a window; later ones follow from how many candidates break
_MOST_REJECTED = 0.25  # candidates per contact, after which a window is too wide
_LARGEST_BOUND = 1e300  # of a rate; what breaks even faster breaks at once
_NO_ONE = -1  # in the place of a contact
_FOLLOWED_TOGETHER = 1 << 15  # contacts of replicas in one call, which bounds its time
MOST_CONTACTS = 20_000  # of a slider that is followed event by event
_TOLD_AFTER = 0.1  # seconds between calls of `progress`
_ENDLESS = 100_000, 20  # breaks of a slip without end, and more for each contact

# A slider at an instant, and what it has taken so far.
SLIDER = np.dtype(
    [
        ("time", np.float64),  # where the window begins
        ("X", np.float64),  # there
        ("waited", np.float64),  # since
        ("moved", np.float64),  # since
        ("spring", np.float64),  # its stretch
        ("force", np.float64),  # of the contacts where the window begins
        ("stiffness", np.float64),  # of the contacts
        ("width", np.float64),  # of a window
        ("reach", np.float64),  # of this one, infinite if nothing is pinned
        ("low", np.float64),  # displacement since the window began at which a
        ("high", np.float64),  # contact breaks by motion, backwards and forwards
        ("at_low", np.int64),  # which contact does, if it has not broken meanwhile
        ("at_high", np.int64),
        ("rejected", np.int64),  # candidates in this window
        ("pinned", np.int64),
        ("segment", np.int64),
        ("row", np.int64),  # of the record that is next
        ("breaks", np.int64),
        ("work", np.float64),
        ("slipped", np.float64),  # energy set free by slips
        ("lost", np.float64),  # energy taken by breaks
        ("lifetime", np.float64),  # until nothing holds the slider any more
        ("begun", np.bool_),
        ("done", np.bool_),
        ("unbounded", np.bool_),  # a rate was above its bound
        ("endless", np.bool_),  # a slip did not end
    ],
    align=True,
)

# Breaks at one instant.
BURST = np.dtype(
    [
        ("replica", np.int64),
        ("t", np.float64),
        ("Y", np.float64),  # of the spring's end
        ("X", np.float64),  # of the slider before
        ("breaks", np.int64),
        ("drop", np.float64),  # of the force of the contacts
        ("distance", np.float64),  # by which the slider moves
    ]
)


class Bonds(NamedTuple):
    """Contacts of a replica, arrays (contacts,), and a heap of what happens next."""

    laws: Contacts
    key: Key  # of their random numbers
    state: Array  # `slider.CONTACT`, with stretches where the window begins
    bound: Array  # of the rate in the window
    tries: Array  # candidates of a life that have been drawn
    instant: Array  # of the next candidate or birth since the window began, a heap
    contact: Array  # which one
    first: int  # number of the first contact
    shared: bool  # those that form again have the stretch of the first ones


class Driving(NamedTuple):
    """Pull on the slider (`model.reduced.Pull`), with arrays (segments,), and the
    instants that are recorded, (points,)."""

    stiffness: float
    stall: float
    ends: Array
    speeds: Array
    forces: Array
    force_rates: Array
    instants: Array
    stop: Array  # a flag (1,): anything but 0 ends the kernel


class Course(NamedTuple):
    """Motion from an instant on: its velocity, which relaxes at a rate."""

    velocity: float
    relaxation: float


# ---- motion between events ----


@routine(inline=True)
def _applied(drive: Driving, now: Any) -> float:
    """Force that is applied to the slider itself."""
    i = now.segment
    begin = drive.ends[i - 1] if i > 0 else 0.0
    return drive.forces[i] + drive.force_rates[i] * (now.time - begin + now.waited)


@routine(inline=True)
def _held(now: Any) -> float:
    """Force of the contacts."""
    return now.force + now.stiffness * now.moved


@routine(inline=True)
def _course_from(drive: Driving, now: Any) -> Course:
    """Motion until the next event."""
    speed = drive.speeds[now.segment]
    if drive.stall == math.inf:
        gain = drive.stiffness * speed + drive.force_rates[now.segment]
        return Course(gain / (drive.stiffness + now.stiffness), 0.0)
    damping = drive.stall
    if drive.stiffness > 0.0:
        damping *= 1.0 + now.stiffness / drive.stiffness
    net = math.copysign(drive.stall, speed) - _held(now)
    return Course(abs(speed) * net / damping, abs(speed) * now.stiffness / damping)


@routine
def _leaves(course: Course, t: float, low: float, high: float) -> tuple[float, int]:
    """Time, up to t, at which the displacement leaves the range from low to high, and 1
    or -1 for the end where it does, 0 if it stays."""
    forwards = course.velocity > 0.0 or (course.velocity == 0.0 and high <= 0.0)
    side, level = (1, max(high, 0.0)) if forwards else (-1, min(low, 0.0))
    if level == 0.0:
        return 0.0, side
    at = level / course.velocity
    w = course.relaxation * at
    if at < 0.0 or w >= 1.0:
        return t, 0
    at *= -math.log1p(-w) / w if w > 0.0 else 1.0
    return (at, side) if at < t else (t, 0)


@routine
def _advance(drive: Driving, now: Any, course: Course, t: float) -> None:
    """Follow the motion for a time t without an event."""
    w = course.relaxation * t
    x = course.velocity * t * (-math.expm1(-w) / w if w > 0.0 else 1.0)
    held = _held(now) + 0.5 * now.stiffness * x
    way = drive.speeds[now.segment] * t
    spring = now.spring
    if drive.stall == math.inf:
        now.spring += way - x
        applied = _applied(drive, now) + 0.5 * drive.force_rates[now.segment] * t
        now.work += applied * x
        now.work += drive.stiffness * way * 0.5 * (spring + now.spring)
    else:
        if drive.stiffness > 0.0 and way != 0.0:
            now.spring += now.stiffness * x / drive.stiffness
        now.work += held * x
        now.work += 0.5 * drive.stiffness * (now.spring**2 - spring**2)
    now.moved += x
    now.waited += t


# ---- contacts ----


@routine(inline=True)
def _limit(bonds: Bonds, now: Any, i: int) -> None:
    """Take account of where a pinned contact breaks by motion."""
    contact = bonds.state[i]
    above = contact.threshold - contact.stretch
    below = -contact.threshold - contact.stretch
    if above < now.high:
        now.high = max(above, now.moved)
        now.at_high = i
    if below > now.low:
        now.low = min(below, now.moved)
        now.at_low = i


@routine
def _look_ahead(bonds: Bonds, now: Any) -> None:
    """Find where contacts break by motion."""
    now.low, now.high = -math.inf, math.inf
    for i in range(bonds.bound.size):
        if bonds.state[i].pinned:
            _limit(bonds, now, i)


@routine
def _enter(bonds: Bonds, now: Any, i: int) -> float:
    """Take account of a pinned contact, and bound its rate in the window. Returns when
    the next candidate for its break comes."""
    laws, contact = bonds.laws, bonds.state[i]
    xi = contact.threshold
    _limit(bonds, now, i)
    before = contact.clock
    waited = now.waited
    bonds.bound[i] = 0.0
    if now.reach < math.inf:
        middle = abs(contact.stretch)
        far = min(middle + now.reach, xi)
        near = min(max(middle - now.reach, 0.0), xi)
        barrier, a = laws.barrier, laws.barrier.b * kappa(laws.springs, xi)
        least = min(height(barrier, xi, near, a), height(barrier, xi, far, a))
        most = max(prefactor(barrier, xi, near), prefactor(barrier, xi, far))
        bonds.bound[i] = min(math.exp(barrier.log_w - least) * most, _LARGEST_BOUND)
    contact.clock = before + bonds.bound[i] * waited
    return contact.clock / bonds.bound[i] if bonds.bound[i] > 0.0 else math.inf


@routine
def _renew(bonds: Bonds, now: Any) -> None:
    """Begin a window here and now."""
    elapsed, moved = now.waited, now.moved
    each = 1.0 / bonds.bound.size
    now.time += elapsed
    now.X += moved
    now.waited = now.moved = now.force = now.stiffness = 0.0
    now.pinned = now.rejected = 0
    now.low, now.high = -math.inf, math.inf
    now.reach = now.width
    for i in range(bonds.bound.size):
        contact = bonds.state[i]
        bonds.contact[i] = i
        if contact.pinned:
            contact.stretch += moved
            contact.clock = max(contact.clock - bonds.bound[i] * elapsed, 0.0)
            stiffness = kappa(bonds.laws.springs, contact.threshold) * each
            now.pinned += 1
            now.stiffness += stiffness
            now.force += stiffness * contact.stretch
            bonds.instant[i] = _enter(bonds, now, i)
        else:
            contact.time_to_pinning = max(contact.time_to_pinning - elapsed, 0.0)
            bonds.instant[i] = contact.time_to_pinning
    if now.pinned == 0:
        now.reach = math.inf
    for i in range(bonds.bound.size // 2 - 1, -1, -1):
        put_back(bonds.instant, bonds.contact, bonds.instant[i], i)


@routine
def _pin(bonds: Bonds, now: Any, i: int) -> float:
    """Pin a contact. Returns when the first candidate for its break comes."""
    laws, contact, number = bonds.laws, bonds.state[i], bonds.first + i
    xi, y, clock = draw_birth(laws.newborn, laws, bonds.key, number, contact.lives)
    if bonds.shared:
        y = now.X + now.moved
    contact.threshold = xi
    contact.stretch = y - now.moved
    contact.clock = clock
    contact.lives += 1
    contact.pinned = True
    contact.began_stationary = False
    bonds.tries[i] = 0
    stiffness = kappa(laws.springs, xi) / bonds.bound.size
    now.pinned += 1
    now.stiffness += stiffness
    now.force += stiffness * contact.stretch
    now.lost -= 0.5 * stiffness * y * y
    return _enter(bonds, now, i)


@routine
def _break(bonds: Bonds, now: Any, i: int) -> float:
    """Break a contact. Returns when it is pinned again, or breaks again if it is pinned
    at once."""
    laws, contact = bonds.laws, bonds.state[i]
    stiffness = kappa(laws.springs, contact.threshold) / bonds.bound.size
    x = contact.stretch + now.moved
    now.breaks += 1
    now.pinned -= 1
    now.stiffness -= stiffness
    now.force -= stiffness * contact.stretch
    if now.pinned == 0:  # else rounding is left
        now.stiffness = now.force = 0.0
    now.lost += 0.5 * stiffness * x * x
    now.at_low = _NO_ONE if now.at_low == i else now.at_low
    now.at_high = _NO_ONE if now.at_high == i else now.at_high
    delay = delay_of(laws, bonds.key, bonds.first + i, contact)
    contact.pinned = False
    if delay == 0.0:
        return _pin(bonds, now, i)
    contact.time_to_pinning = now.waited + delay
    return contact.time_to_pinning


@routine
def _breaks_now(bonds: Bonds, now: Any, i: int) -> bool:
    """Decide on a candidate for the break of a contact, and draw the next one unless it
    breaks."""
    laws, contact = bonds.laws, bonds.state[i]
    bonds.tries[i] += 1
    draws = words(bonds.key, bonds.first + i, contact.lives, bonds.tries[i])
    xi = contact.threshold
    x = min(abs(contact.stretch + now.moved), xi)
    bound = bonds.bound[i]
    actual = rate(laws.barrier, xi, kappa(laws.springs, xi), x)
    if actual > bound * (1.0 + 1e-9) and bound < _LARGEST_BOUND:
        now.unbounded = True
    unit = 2.0**-32
    if (draws[0] + (draws[1] + 0.5) * unit) * unit * bound < actual:
        return True
    now.rejected += 1
    more = -math.log((draws[2] + (draws[3] + 0.5) * unit) * unit)
    contact.clock = bound * now.waited + more
    put_back(bonds.instant, bonds.contact, contact.clock / bound, 0)
    return False


# ---- events ----


@routine
def _settle(drive: Driving, bonds: Bonds, now: Any, changed: bool) -> None:
    """Move a slider that nothing slows down into balance, and break what breaks on the
    way. The window is renewed if contacts have `changed` that are not next."""
    jumps = drive.stall == math.inf or drive.stiffness > 0.0
    most = now.breaks + _ENDLESS[0] + _ENDLESS[1] * bonds.bound.size
    while jumps and drive.stop[0] == 0:
        elastic = drive.stiffness + now.stiffness
        now.endless = now.breaks > most and drive.stiffness == 0.0
        if elastic == 0.0 or now.endless:
            now.lifetime = now.time + now.waited
            return
        net = drive.stiffness * now.spring + _applied(drive, now) - _held(now)
        target = now.moved + net / elastic
        balanced = now.low < target < now.high
        i = _NO_ONE
        if target >= now.high:
            target, i = now.high, now.at_high
        elif target <= now.low:
            target, i = now.low, now.at_low
        x = target - now.moved
        now.slipped += (net - 0.5 * elastic * x) * x
        now.work += _applied(drive, now) * x
        now.moved = target
        now.spring -= x
        if balanced:
            break
        if i != _NO_ONE:
            _break(bonds, now, i)
            changed = True
        _look_ahead(bonds, now)
    if changed or abs(now.moved) > now.reach:
        _renew(bonds, now)


@routine
def _burst(drive: Driving, bonds: Bonds, now: Any, i: int, event: Any) -> int:
    """Break contact i, if it is one, and what breaks at once because of this. Returns 1
    if there is an event, 0 if nothing breaks."""
    breaks, force, changed = now.breaks, _held(now), False
    event.t = now.time + now.waited
    event.X = now.X + now.moved
    event.Y = event.X + now.spring
    if i != _NO_ONE:
        instant = _break(bonds, now, i)
        changed = bonds.contact[0] != i
        if not changed:
            put_back(bonds.instant, bonds.contact, instant, 0)
    _settle(drive, bonds, now, changed)
    event.breaks = now.breaks - breaks
    event.drop = force - _held(now)
    event.distance = now.X + now.moved - event.X
    return 1 if event.breaks > 0 else 0


@routine
def _note(drive: Driving, bonds: Bonds, now: Any, row: Any) -> None:
    """Record the slider at an instant, a `slider_runs` record."""
    square = stored = 0.0
    for contact in bonds.state:
        if contact.pinned:
            x = contact.stretch + now.moved
            stiffness = kappa(bonds.laws.springs, contact.threshold)
            square += (stiffness * x) ** 2
            stored += 0.5 * stiffness * x * x
    each = 1.0 / bonds.bound.size
    held = _held(now)
    row.X = now.X + now.moved
    row.stage = row.X + now.spring
    row.friction = held
    row.pinned = now.pinned / bonds.bound.size
    row.variance = max(square * each - held * held, 0.0) * each
    row.work = now.work
    row.stored = 0.5 * drive.stiffness * now.spring**2 + stored * each
    row.dissipated = now.lost + now.slipped
    if now.lifetime < math.inf:
        row.X = row.stage = math.nan


@routine
def _begin(bonds: Bonds, now: Any) -> None:
    """Pin the contacts that are not pinned yet, without a delay."""
    now.reach = math.inf
    for i in range(bonds.bound.size):
        bonds.bound[i] = 0.0
        bonds.tries[i] = 0
        contact = bonds.state[i]
        if not contact.pinned and contact.time_to_pinning <= 0.0:
            _pin(bonds, now, i)
    now.lost = 0.0
    now.begun = True
    _renew(bonds, now)


@routine
def _next_event(drive: Driving, bonds: Bonds, now: Any, event: Any) -> int:
    """Follow a slider to its next event. Returns 1 if contacts break there, and 2 if
    it is to be recorded."""
    if now.reach == math.inf and now.pinned > 0:
        _renew(bonds, now)
    course = _course_from(drive, now)
    last = now.segment + 1 == drive.ends.size
    segment = math.inf if last else drive.ends[now.segment] - now.time
    instant = min(bonds.instant[0], segment) - now.waited
    recorded = drive.instants[now.row] - now.time - now.waited
    t = max(min(instant, recorded), 0.0)
    high, low = min(now.high, now.reach), max(now.low, -now.reach)
    t, side = _leaves(course, t, low - now.moved, high - now.moved)
    _advance(drive, now, course, t)
    if side != 0:
        now.moved = high if side > 0 else low
        by_motion = now.high <= now.reach if side > 0 else -now.low <= now.reach
        i = now.at_high if side > 0 else now.at_low
        if by_motion and i != _NO_ONE:
            return _burst(drive, bonds, now, i, event)
        if not by_motion and 4.0 * now.rejected < _MOST_REJECTED * bonds.bound.size:
            now.width *= 2.0
        _renew(bonds, now)
        return 0
    if recorded <= instant:
        return 2
    if bonds.instant[0] > segment:
        now.segment += 1
        return _burst(drive, bonds, now, _NO_ONE, event)
    i = bonds.contact[0]
    if not bonds.state[i].pinned:
        put_back(bonds.instant, bonds.contact, _pin(bonds, now, i), 0)
        return _burst(drive, bonds, now, _NO_ONE, event)
    if _breaks_now(bonds, now, i):
        return _burst(drive, bonds, now, i, event)
    if now.rejected > _MOST_REJECTED * bonds.bound.size + 4.0:
        now.width *= 0.5
        _renew(bonds, now)
    return 0


@kernel
def follow_replicas(
    drive: Driving, bonds: Bonds, sliders: Array, courses: Array, events: Array
) -> tuple[int, bool]:
    """Follow replicas one after the other. `bonds.state` has the shape (replicas,
    contacts), `sliders` (replicas,) holds records of type `SLIDER`, and `courses`
    (replicas, points) those of `slider_runs`. Returns the number of bursts, and False
    if there are more than `events` has room for."""
    rows = 0
    contacts = bonds.bound.size
    for r in range(sliders.size):
        now = sliders[r]
        first = bonds.first + r * contacts
        laws, key, _, bound, tries, instant, contact, _, shared = bonds
        heap = bound, tries, instant, contact
        mine = Bonds(laws, key, bonds.state[r], *heap, first, shared)
        while not now.done and drive.stop[0] == 0:
            if rows == events.size:
                return rows, False
            event = events[rows]
            event.replica = r
            found = 2
            if not now.begun:
                _begin(mine, now)
                _note(drive, mine, now, courses[r, 0])
                now.row = 1
                found = _burst(drive, mine, now, _NO_ONE, event)
            elif now.lifetime == math.inf:
                found = _next_event(drive, mine, now, event)
            if found == 1:
                rows += 1
            elif found == 2:
                _note(drive, mine, now, courses[r, now.row])
                now.row += 1
                now.done = now.row == drive.instants.size
    return rows, True


def by_events(ensemble: Ensemble, programme: Programme, pull: Pull) -> bool:
    """True if a slider is followed event by event: without mass and damping, on
    contacts of one kind whose rates of breaking do not change with their age, which
    wait for heat or to be pinned. Contacts that only a rising force breaks, once, are
    for `engine.avalanches`. Raises InputError for drives that steps do not follow."""
    laws = contacts(ensemble.kinds[0].contacts, pull.pace)
    heat, delay = laws.barrier.thermal, laws.delay.mean
    waits = heat or delay > 0.0
    if pull.forced:
        waits = heat or delay < math.inf or not pull.slow
    eventful = bool(
        (waits or pull.motor)
        and not ensemble.populations
        and pull.mass == pull.damping == ensemble.eta == 0.0
        and (ensemble.disorder == "quenched" or not heat)
        and not ensemble.aging.active
        and ensemble.count <= MOST_CONTACTS
    )
    asked = {
        "drive.stall_force: with drive.stage": pull.motor and pull.stiffness > 0.0,
        'drive.rebinding = "shared"': programme.rebinding == "shared",
    }
    for name in (name for name, given in asked.items() if given and not eventful):
        raise InputError(
            f"{name}: needs contacts.count <= {MOST_CONTACTS} of one kind that do not "
            "age, quenched, and neither viscosity, drive.stage.damping nor mass"
        )
    return eventful


def follow_events(
    ensemble: Ensemble,
    programme: Programme,
    seed: int,
    instants: Array,
    courses: Array,
    threads: int,
    told: Callable[[int], None],
) -> tuple[Array, Array]:
    """Follow all replicas, and fill their `courses` (replicas, points), records of
    `slider_runs` at these instants; `told` gets the lives so far. Returns sliders in
    the end, `SLIDER` (replicas,), and all bursts, `BURST`. Raises InputError for a rate that is
    greatest between two stretches instead of at one of them."""
    unit, count = ensemble.thresholds.scale, ensemble.count
    pull, key = pull_of(ensemble, programme), key_of(seed, TRAJECTORY)
    laws = contacts(ensemble, pull.pace)
    replicas = len(courses)
    sliders = np.zeros(replicas, SLIDER)
    sliders["width"] = _FIRST_WIDTH
    sliders["lifetime"] = math.inf
    stage, shared = programme.stage, programme.rebinding == "shared"
    speed = programme.velocity_before

    def block(first: int, last: int) -> Array:
        state = np.zeros((last - first, count), CONTACT)
        begun = sliders[first:last]
        begun["spring"] = (stage.preload or 0.0) / unit if stage else 0.0
        if speed:
            before = contacts(ensemble, speed)
            find_stationary(
                before, key, first * count, state.ravel(), speed / pull.pace
            )
            if stage and stage.preload is None:
                stretch = state["stretch"] * state["pinned"]
                force = kappa(laws.springs, state["threshold"]) * stretch
                begun["spring"] = force.mean(axis=1) / pull.stiffness
        bound, instant = np.zeros((2, count))
        tries, contact = np.zeros((2, count), np.int64)
        heap = bound, tries, instant, contact
        bonds = Bonds(laws, key, state, *heap, first * count, shared)
        drive = Driving(
            pull.stiffness,
            pull.stall,
            np.array(pull.ends),
            np.array(pull.speeds),
            np.array(pull.forces),
            np.array(pull.force_rates),
            instants,
            pool.stop,
        )
        followed = drive, bonds, begun, courses[first:last]
        found = events_of(BURST, follow_replicas, *followed)
        found["replica"] += first
        return found

    together = max(1, _FOLLOWED_TOGETHER // count)
    edges = [*range(0, replicas, together), replicas]
    with ThreadPool(threads) as pool:
        pending = [pool.submit(block, *edge) for edge in pairwise(edges)]
        left = set(pending)
        while left:
            left = wait(left, timeout=_TOLD_AFTER, return_when=FIRST_COMPLETED)[1]
            told(int(sliders["breaks"].sum()) + replicas * count)
        bursts = np.concatenate([each.result() for each in pending])
    if sliders["endless"].any():
        raise no_end_of_slip()
    if sliders["unbounded"].any():
        said = "its rate has to be greatest at an end of any range of stretches"
        raise InputError(f'thermal.barrier = "{ensemble.thermal.barrier}": {said}')
    return sliders, bursts
