"""A slider that a stage pulls through a spring: all contacts, exactly, along X(t) made of short straight pieces.

In a step F is taken for F + (A + rho) dX + r dt, with A the stiffness of all pinned contacts, and rho and r what breaks
add to it by motion, per dX, and by heat, per time, as in the last breaks (derived, of second order). Without a mass

    eta X' = kappa (Y - X) - F

has a closed form then; with one forces are balanced in the middle of the step, or, where the slider's own vibration is
faster than a step, at its end. Then every contact is followed along the piece, so F is exact for the X(t) that was
found. What the estimate missed of F has left the slider where it would not be otherwise, and at another velocity; the
next step makes up for both (`Behind`). Without that the slider would be of first order in the step, as rho and r lag
behind by as many breaks as they are means of.

Steps are so short that the estimate misses F by less than the tolerance, beyond the scatter of the breaks themselves,
and none is longer than the root of it; a slip takes as many steps as it needs. Where neither damping nor mass holds the
slider back it takes place at an instant. Every ensemble is followed a second time, in steps four times as long, and
what that changes tells how much the finite step may be wrong (`_missed_by_steps`).

Lengths are in units of the threshold law's scale, time is displacement at the pace of `model.reduced.Pull`.
"""

import functools
import itertools
import math
import time
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from scipy import ndimage

from eqsim.engine import avalanches
from eqsim.engine.blocks import Progress, Threads, workers_of
from eqsim.engine.contacts import Contacts, contacts
from eqsim.engine.lanes import delay_after, delay_of_the_first, draw_birth
from eqsim.engine.records import SliderTrajectory, Slip, shown_by, slips_of
from eqsim.engine.scatter import pinned_variance
from eqsim.engine.segments import Population, begin_stationary
from eqsim.engine.stationary import stationary
from eqsim.laws.aging import Unaged
from eqsim.laws.aging.base import Held, growth, spend, stiffness_varies
from eqsim.laws.barrier import Mechanical
from eqsim.laws.stiffness import kappa
from eqsim.model.drive import Grid, Programme
from eqsim.model.ensemble import Ensemble
from eqsim.model.reduced import drag_of, pull_of
from eqsim.model.slip import least_slip, width_of
from eqsim.numerics.compiled import kernel, routine
from eqsim.numerics.streams import TRAJECTORY, Key, key
from eqsim.numerics.tables import Array
from eqsim.numerics.threads import ThreadPool

_BLOCK = 512  # contacts whose sums are added up before those of others: the same bits whoever adds them
_SHARE = 20  # blocks that a thread must have: to wake it takes as long as they do
_TOGETHER = 1 << 16  # contacts that a stationary start draws at once
_BREAKS = 30.0  # that say at what rate contacts break
_FIRST = 1e-6  # first step, of the first segment
_HALVINGS = 30  # of a step, after which what nothing holds back slips at an instant
_SHORTEST = 1e-200  # the shortest step of what damping or mass hold back
_INSTANT = 1e-40  # time of a piece that takes none, over its displacement: heat and age do nothing in it at any pace
_FEW_REPLICAS = 8  # whose scatter tells the error of their mean
_NOISE = 2.0  # standard errors of what breaks in a step that no shorter step would make better
_COARSER = 4  # how many times as long the steps of the second run are, and how many of its instants it records one of

# sums over contacts at the end of a piece: pinned, stiffness, force, its square, stored energy; and of the breaks in
# it: force by motion and by heat, its square, energy, and how many
PINNED, STIFFNESS, FORCE, SQUARE, STORED, MOTION, HEAT, SCATTER, LOST, BREAKS = range(10)


class Followed(NamedTuple):
    """Contacts between two steps, arrays (contacts,), 40 bytes each. `time` is that until a contact is pinned, and of
    those that are minus that since (-0 at birth). Of these: threshold `xi` at birth, signed `stretch`, what the
    exponential `clock` has left. `lives` is how many were drawn, and below 0 in the life in which a stationary start
    finds a contact."""

    time: Array
    xi: Array
    stretch: Array
    clock: Array
    lives: Array

    @classmethod
    def fresh(cls, contacts: int) -> "Followed":
        """All of them about to be pinned for the first time."""
        time, xi, stretch, clock = np.zeros((4, contacts))
        return cls(time, xi, stretch, clock, np.zeros(contacts, np.int64))


class Piece(NamedTuple):
    """How long a piece takes, at how many times the pace the slider moves, and in which direction."""

    length: float
    moves: float
    sign: float


@kernel
def advance(
    c: Contacts, piece: Piece, stream: Key, first: int, p: Followed, blocks: tuple[int, int], sums: Array
) -> None:
    """Follow the contacts of some blocks along a piece; `sums` (all blocks, 10). The first of all is `first`."""
    for block in range(blocks[0], blocks[1]):
        total = sums[block]
        total[:] = 0.0
        own = slice(block * _BLOCK, (block + 1) * _BLOCK)  # whose places count from 0, which no index is below
        some = Followed(p.time[own], p.xi[own], p.stretch[own], p.clock[own], p.lives[own])
        for i in range(some.time.size):
            _follow(c, piece, stream, first + block * _BLOCK, some, i, total)
        _add(c, some, total)


@routine(inline=True)
def _follow(c: Contacts, piece: Piece, stream: Key, first: int, p: Followed, i: int, total: Array) -> None:
    """Follow contact i along a piece."""
    left, by_motion = piece.length, False
    while True:
        if math.copysign(1.0, p.time[i]) > 0.0:
            if p.time[i] > left:
                p.time[i] -= left
                return
            left -= p.time[i]
            lives = abs(p.lives[i])
            p.xi[i], born, p.clock[i] = draw_birth(c.newborn, c, stream, first + i, lives)
            p.stretch[i], p.time[i], p.lives[i] = born, -0.0, lives + 1
            if born != 0.0:  # it brings a force and energy
                brought = kappa(c.springs, p.xi[i]) * born
                total[MOTION if by_motion else HEAT] -= brought
                total[LOST] -= 0.5 * brought * born
        y, before, stiffness = piece.sign * p.stretch[i], -p.time[i], kappa(c.springs, p.xi[i])
        contact = Held(p.xi[i], stiffness, y, before)
        broke, clock = spend(c.aging, c, contact, piece.moves, left, p.clock[i])
        if broke > left:
            break
        x, age = y + piece.moves * broke, before + broke
        grown = growth(c.aging, age)
        force = stiffness * (grown if stiffness_varies(c.aging, c.springs) else 1.0) * x * piece.sign
        by_motion = abs(x) >= p.xi[i] * grown * (1.0 - 1e-9)
        total[MOTION if by_motion else HEAT] += force
        total[SCATTER] += force * force
        total[LOST] += 0.5 * force * x * piece.sign
        total[BREAKS] += 1.0
        p.time[i] = _delay(c, stream, first + i, p.lives[i])
        left = max(left - broke, 0.0)
    p.clock[i] = clock
    p.time[i] -= left
    p.stretch[i] = piece.sign * (y + piece.moves * left)


@routine
def _delay(c: Contacts, stream: Key, contact: int, lives: int) -> float:
    """After the life of which a contact knows how many were drawn."""
    if lives < 0 and c.delay.random > 0.0:
        return delay_of_the_first(c, stream, contact)
    return delay_after(c, stream, contact, abs(lives) - 1)


@routine(inline=True)
def _add(c: Contacts, p: Followed, total: Array) -> None:
    """Add up what contacts are at the end of a piece."""
    pinned, stiffness, force, square, stored = 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(p.time.size):
        held = 1.0 if math.copysign(1.0, p.time[i]) < 0.0 else 0.0
        own = held * kappa(c.springs, p.xi[i])
        if stiffness_varies(c.aging, c.springs):
            own *= growth(c.aging, max(-p.time[i], 0.0))
        pull = own * p.stretch[i]
        pinned, stiffness, force = pinned + held, stiffness + own, force + pull
        square, stored = square + pull * pull, stored + 0.5 * pull * p.stretch[i]
    total[PINNED], total[STIFFNESS], total[FORCE] = pinned, stiffness, force
    total[SQUARE], total[STORED] = square, stored


class State(NamedTuple):
    """Between two steps: time, displacement of slider and stage, velocity of the slider, sums over contacts (10,) per
    contact; and the work so far of the stage, against damping, what broken contacts have lost, and what estimates of F
    have missed."""

    s: float
    X: float
    Y: float
    V: float
    sums: Array
    stage: float = 0.0
    damped: float = 0.0
    lost: float = 0.0
    missed: float = 0.0


class Behind(NamedTuple):
    """How much farther and faster the slider would be had estimates not missed F so far; to be made up for within the
    time `over` (derived, to the first order in what was missed)."""

    distance: float = 0.0
    velocity: float = 0.0
    over: float = 0.0

    def within(self, dt: float) -> "Behind":
        """Return the share that a step of dt makes up for. What was missed in a longer step takes as long as that, so
        that the displacement of a step vanishes with dt."""
        share = min(1.0, dt / self.over) if self.over > 0.0 else 0.0
        return Behind(share * self.distance, share * self.velocity, self.over)


class _Breaks:
    """How fast breaks change F, by motion (rho) and by heat (r), as the last `_BREAKS` of them say, or those of the
    last step where there are more."""

    def __init__(self, least: float) -> None:
        self.least, self.sign = least, 1.0
        self.moved = self.waited = self.by_motion = self.by_heat = 0.0

    def add(self, dX: float, dt: float, sums: Array, contacts: int) -> None:
        kept, sign = math.exp(-sums[BREAKS] * contacts / _BREAKS), math.copysign(1.0, dX)
        if sign != self.sign:
            self.sign, self.moved, self.by_motion = sign, 0.0, 0.0
        self.moved, self.by_motion = kept * self.moved + abs(dX), kept * self.by_motion + sign * sums[MOTION]
        self.waited, self.by_heat = kept * self.waited + dt, kept * self.by_heat + sums[HEAT]

    @property
    def rho(self) -> float:
        return -self.by_motion / max(self.moved, self.least)

    @property
    def r(self) -> float:
        return -self.by_heat / self.waited if self.waited > 0.0 else 0.0


def _relaxed(forces: tuple[float, float, float], damping: float, dt: float) -> float:
    """Displacement after dt of what obeys damping X' = net + gain t - stiffness X, from X = 0; `forces` are these."""
    net, gain, stiffness = forces
    if damping == 0.0:
        return (net + gain * dt) / stiffness if stiffness > 0.0 else math.inf
    w = -stiffness * dt / damping
    if w > 700.0:
        return math.inf
    first = math.expm1(w) / w if abs(w) > 1e-5 else 1.0 + 0.5 * w
    second = (first - 1.0) / w if abs(w) > 1e-3 else 0.5 + w / 6.0 + w * w / 24.0
    return dt / damping * (net * first + gain * dt * second)


class Slider:
    """The contacts of an ensemble from `first` on and the slider they hold, pulled by the stage of `programme`."""

    def __init__(
        self, ensemble: Ensemble, programme: Programme, seed: int, first: int, threads: int, longer: int = 1
    ) -> None:
        """`longer` is how many times as long as usual steps are."""
        assert programme.stage is not None
        self.pull, unit, law = pull_of(ensemble, programme), ensemble.thresholds.scale, ensemble.thresholds
        self.c, self.drag = contacts(ensemble, self.pull.pace), drag_of(ensemble, self.pull.pace)
        self.stream, self.first, self.count = key(seed, TRAJECTORY), first, ensemble.count
        self.population = Followed.fresh(ensemble.count)
        blocks = -(-ensemble.count // _BLOCK)
        threads = max(1, min(threads, blocks // _SHARE))
        self.shares = [(i * blocks // threads, (i + 1) * blocks // threads) for i in range(threads)]
        self.pool = ThreadPool(threads - 1) if threads > 1 else None
        self.found = np.zeros((blocks, 10))
        self.least_slip = least_slip(law) / unit
        self.longest = longer * math.sqrt(programme.stage.tolerance) * width_of(law) / unit
        self.tolerance = longer**2 * programme.stage.tolerance * law.mean / unit
        self.waits = not (isinstance(self.c.barrier, Mechanical) and isinstance(self.c.aging, Unaged))
        self.acceleration, self.behind = 0.0, Behind()
        self.breaks, self.dt = _Breaks(0.1 * self.longest), _FIRST * self.pull.ends[0]
        stretch, speed = (programme.stage.preload or 0.0) / unit, 0.0
        if programme.start == "stationary" and programme.velocity:
            before, speed = contacts(ensemble, programme.velocity), programme.velocity / self.pull.pace
            self._begin(before, speed)
        sums = self._follow(Piece(0.0, 0.0, 1.0))
        if speed and programme.stage.preload is None:
            stretch = (sums[FORCE] + self._damping(sums) * speed) / self.pull.stiffness
        self.state = State(0.0, 0.0, stretch, speed, sums)
        durations = np.diff(self.pull.ends, prepend=0.0)
        self.loaded = durations * self.pull.speeds  # by how far the stage moves in each segment
        self.quasi_static = bool(
            isinstance(self.c.barrier, Mechanical) and isinstance(self.c.aging, Unaged) and self.c.delay.mean == 0.0
            and self.pull.damping == self.pull.mass == 0.0 and min(self.pull.speeds) >= 0.0
            and self.pull.stiffness * stretch >= sums[FORCE] * (1.0 - 1e-12)
        )  # fmt: skip

    def _begin(self, before: Contacts, speed: float) -> None:
        """The contacts as a snapshot of the steady state at a speed finds them."""
        found, p = stationary(before), self.population
        for first in range(0, self.count, _TOGETHER):
            some = slice(first, min(first + _TOGETHER, self.count))
            part = Population.fresh(self.first + first, some.stop - first)
            begin_stationary(before, found, self.stream, part)
            p.time[some] = np.where(part.pinned, -part.age, part.wait) / speed
            p.xi[some], p.stretch[some], p.clock[some] = part.threshold, part.stretch, part.clock
            p.lives[some] = np.where(part.pinned, -part.lives, part.lives)

    def __enter__(self) -> "Slider":
        return self

    def __exit__(self, *error: Any) -> None:
        if self.pool:
            self.pool.__exit__(*error)

    def _damping(self, sums: Array) -> float:
        """Of the slider and of all detached contacts."""
        return self.pull.damping + self.drag * (1.0 - float(sums[PINNED]))

    def _follow(self, piece: Piece) -> Array:
        """Sums per contact after a piece."""

        def follow(share: tuple[int, int]) -> None:
            advance(self.c, piece, self.stream, self.first, self.population, share, self.found)

        others = [self.pool.submit(follow, share) for share in self.shares[1:]] if self.pool else []
        follow(self.shares[0])
        for other in others:
            other.result()
        return np.asarray(self.found.sum(axis=0) / self.count)

    def _held(self, dt: float) -> tuple[float, float, float]:
        """Stiffness of spring, contacts and breaks against a displacement in a step of dt; with a mass what holds the
        slider, force per displacement, and the share of the step after which forces are balanced."""
        pull, sums = self.pull, self.state.sums
        elastic = pull.stiffness + float(sums[STIFFNESS])
        if pull.mass == 0.0:
            return elastic + self.breaks.rho, math.nan, math.nan
        theta = 0.5 if dt * dt * elastic < pull.mass else 1.0
        elastic += self.breaks.rho
        return elastic, pull.mass / (theta * dt * dt) + self._damping(sums) / dt + 0.5 * elastic, theta

    def _estimate(self, dt: float, speed: float) -> tuple[float, float]:
        """Displacement in a step, infinite where the slider is unstable and nothing holds it, and velocity then."""
        now, pull, damping, behind = self.state, self.pull, self._damping(self.state.sums), self.behind.within(dt)
        elastic, held, theta = self._held(dt)
        net = pull.stiffness * (now.Y - now.X) - float(now.sums[FORCE]) - elastic * behind.distance
        gain = pull.stiffness * speed - self.breaks.r
        if pull.mass == 0.0:
            dX = behind.distance + _relaxed((net, gain, elastic), damping, dt)
            return dX, dX / dt
        V = now.V + behind.velocity
        moved = (net + 0.5 * gain * dt + pull.mass / (theta * dt) * V) / held if held > 0.0 else math.inf
        return behind.distance + moved, V + (moved / dt - V) / theta

    def _fall_behind(self, dt: float, missed: float) -> Behind:
        """Return what is left to make up for after a step of dt whose estimate missed F by `missed` at the end and, in
        the mean, in proportion to the time before."""
        elastic, held, theta = self._held(dt)
        if self.pull.mass == 0.0:
            distance, velocity = _relaxed((0.0, -missed / dt, elastic), self._damping(self.state.sums), dt), 0.0
        else:
            distance = -0.5 * missed / held
            velocity = distance / (theta * dt)
        if not math.isfinite(distance):
            return Behind()
        before, made_up = self.behind, self.behind.within(dt)
        return Behind(
            before.distance - made_up.distance + distance, before.velocity - made_up.velocity + velocity,
            max(dt, before.over - dt),
        )  # fmt: skip

    def step(self, until: float, speed: float) -> State:
        """One step, not beyond a time, while the stage moves at `speed`."""
        now, left = self.state, until - self.state.s
        dt = left if 1.2 * self.dt >= left else self.dt
        dX, V = self._estimate(dt, speed)
        least = _SHORTEST if self.pull.damping or self.pull.mass else 0.5**_HALVINGS * dt
        while abs(dX) > 1.5 * self.longest and dt > least:
            dt *= 0.5
            dX, V = self._estimate(dt, speed)
        if abs(dX) > 1.5 * self.longest:
            return self._slip()
        sums = self._follow(Piece(dt, abs(dX) / dt, math.copysign(1.0, dX)))
        change = float(now.sums[STIFFNESS] + self.breaks.rho) * dX + self.breaks.r * dt
        missed = float(sums[FORCE] - now.sums[FORCE] - change)
        made_up, behind = self.behind.within(dt), self._fall_behind(dt, missed)
        given = (self._damping(now.sums) * made_up.distance + self.pull.mass * made_up.velocity) / dt
        self._account(dt, dX, speed * dt, V, sums, float(now.sums[FORCE]) + 0.5 * change - given)
        self.behind = behind
        off = max(abs(missed) - _NOISE * math.sqrt(sums[SCATTER] / self.count), 0.0)
        if self.pull.mass:  # what forces miss as the acceleration changes
            acceleration, elastic = (V - now.V) / dt, self.pull.stiffness + float(sums[STIFFNESS])
            off = max(off, 4.0 * dt * dt * abs(acceleration - self.acceleration) * elastic)
            self.acceleration = acceleration
        grown = dt * min(max(0.9 * math.sqrt(self.tolerance / off), 0.3), 2.0) if off > 0.0 else 2.0 * dt
        self.dt = max(grown, self.dt) if dt == left and off < self.tolerance else grown
        self.breaks.add(dX, dt, sums, self.count)
        self.dt = min(self.dt, self._until_a_break())
        if dt == left:
            self.state = self.state._replace(s=until)
        return self.state

    def _until_a_break(self) -> float:
        """The longest step that heat allows. A time without a break says no more than that the rate of breaks is about
        one in that time; as many may move the slider by as much as a step may."""
        sums = self.state.sums
        if not self.waits or sums[SQUARE] <= 0.0:
            return math.inf
        force = math.sqrt(sums[SQUARE] / sums[PINNED]) / self.count  # of a contact, as a share of F
        elastic = self.pull.stiffness + float(sums[STIFFNESS])
        return 1.5 * self.longest * elastic * self.breaks.waited / force

    def _slip(self) -> State:
        """A piece that takes no time, towards balance."""
        now, pull = self.state, self.pull
        net = pull.stiffness * (now.Y - now.X) - float(now.sums[FORCE])
        held = pull.stiffness + float(now.sums[STIFFNESS]) + self.breaks.rho
        size = min(self.longest, max(abs(net) / held, 1e-6 * self.longest)) if held > 0.0 else self.longest
        dX, dt = math.copysign(size, net), _INSTANT * size
        sums = self._follow(Piece(dt, 1.0 / _INSTANT, math.copysign(1.0, net)))
        work = float(sums[STORED] - now.sums[STORED] + sums[LOST])
        self._account(dt, dX, 0.0, 0.0, sums, work / dX)
        self.behind = Behind()
        self.breaks.add(dX, dt, sums, self.count)
        return self.state

    def _account(self, dt: float, dX: float, dY: float, V: float, sums: Array, force: float) -> None:
        """Take a step in which F is taken for `force` in the mean, and note where its energy goes: to damping what is
        left of the work of the spring."""
        now, pull = self.state, self.pull
        mean = pull.stiffness * (now.Y + 0.5 * dY - now.X - 0.5 * dX)
        damped = (mean - force) * dX - 0.5 * pull.mass * (V * V - now.V * now.V)
        lost = float(sums[LOST])
        missed = force * dX - float(sums[STORED] - now.sums[STORED]) - lost
        self.state = State(
            now.s + dt, now.X + dX, now.Y + dY, V, sums, now.stage + mean * dY, now.damped + damped, now.lost + lost,
            now.missed + missed,
        )  # fmt: skip


class _Replica(NamedTuple):
    """What an ensemble leaves at the instants of a grid, shape (points, 10), and how it slips."""

    values: Array
    slips: list[Slip]
    lives: int
    avalanches: Array | None


# columns of `_Replica.values`; `_BEHIND` is by how much X is wrong at an instant as the last steps missed F
_X, _STAGE, _FRICTION, _BOUND, _VARIANCE, _WORK, _KEPT, _TAKEN, _MISSING, _BEHIND = range(10)


def _row(slider: Slider, now: State, before: float) -> tuple[float, ...]:
    """Of a state; `before` is what was stored at the beginning."""
    pull, sums, stretch = slider.pull, now.sums, now.Y - now.X
    stored = 0.5 * pull.stiffness * stretch**2 + 0.5 * pull.mass * now.V**2 + float(sums[STORED])
    force, pinned = float(sums[FORCE]), float(sums[PINNED])
    friction = force + slider.drag * (1.0 - pinned) * now.V
    variance = max(float(sums[SQUARE]) - force**2, 0.0) / slider.count
    taken, behind = now.lost + now.damped, slider.behind.distance
    return now.X, now.Y, friction, pinned, variance, now.stage, stored - before, taken, now.missed, behind


def _simulate(slider: Slider, instants: Array, replica: int, before: int, progress: Progress | None) -> _Replica:
    """Pull a slider through its programme; `instants` (points,) are recorded. Lives `before` are others'."""
    stored = _row(slider, slider.state, 0.0)[_KEPT]
    rows, course, lives = [_row(slider, slider.state, stored)], [slider.state[:3]], float(slider.count)
    at = 1
    for end, speed in zip(slider.pull.ends, slider.pull.speeds, strict=True):
        while at < instants.size and instants[at] <= end * (1.0 + 1e-12):
            until = min(float(instants[at]), end)
            while slider.state.s < until:
                now = slider.step(until, speed)
                course.append(now[:3])
                lives += now.sums[BREAKS] * slider.count
                if progress and (len(course) % 64 == 0 or now.sums[BREAKS] > 1000.0):
                    progress(before + int(lives))
            rows.append(_row(slider, slider.state, stored))
            at += 1
    values = np.array(rows)
    return _Replica(values, _slips(slider, values, np.array(course), replica), round(lives), None)


def _slips(slider: Slider, values: Array, course: Array, replica: int) -> list[Slip]:
    """Of a course, shape (steps, 3) of time, X and Y: larger ones than contacts make at any X by chance."""
    (s, X, Y), pull = course.T, slider.pull
    noise = 6.0 * math.sqrt(values[:, _VARIANCE].max())
    least = max(slider.least_slip * pull.stiffness, noise)
    return slips_of(s, X, pull.stiffness * (Y - X), least, max(map(abs, pull.speeds)), replica)


def _quasi_static(slider: Slider, instants: Array, replica: int, before: int, progress: Progress | None) -> _Replica:
    """`_simulate` by `engine.avalanches`."""
    p, pull, start = slider.population, slider.pull, slider.state
    stages = start.Y + np.interp(instants, [0.0, *pull.ends], np.cumsum([0.0, *slider.loaded]))
    queue, now = avalanches.queue_of(p.xi, p.stretch), np.zeros(11)
    now[[avalanches.FORCE, avalanches.STIFFNESS, avalanches.Y]] = start.sums[FORCE], start.sums[STIFFNESS], start.Y
    rows, events, stored = [], [], 0.0
    with ThreadPool(1) as thread:
        for j, stage in enumerate(stages):
            way = avalanches.Way(pull.stiffness, float(stage), thread.stop)
            of = slider.c, slider.stream, slider.first
            events.append(thread.submit(avalanches.load, *of, p, queue, now, way).result())
            x, force = now[avalanches.X], now[avalanches.FORCE]
            xi = p.xi[queue.contact]
            stiffness, stretch = kappa(slider.c.springs, xi), x - queue.at + xi
            variance = max(float(np.mean((stiffness * stretch) ** 2)) - force**2, 0.0) / slider.count
            kept = 0.5 * pull.stiffness * (stage - x) ** 2 + 0.5 * float(np.mean(stiffness * stretch**2))
            work, taken = now[avalanches.WORK], now[avalanches.LOST] + now[avalanches.SLIPPED]
            stored = kept if j == 0 else stored
            rows.append(
                (x, stage, force, 1.0, variance, work, kept - stored, taken, work - (kept - stored) - taken, 0.0)
            )
            if progress:
                progress(before + int(now[avalanches.BREAKS]))
    values, found = np.array(rows), np.concatenate(events)
    ends = np.interp(found[:, 0], stages, instants)  # of avalanches, and the moments before
    course = np.stack((ends, found[:, 1], found[:, 0])), np.stack((ends, found[:, 1] + found[:, 4], found[:, 0]))
    steps = np.stack(course, axis=2).reshape(3, -1).T
    found[:, 0] = ends
    lives = slider.count + round(now[avalanches.BREAKS])
    return _Replica(values, _slips(slider, values, steps, replica) if len(steps) else [], lives, found)


def _seldom(segment: Array) -> Array:
    """Which instants of a grid, whose segments are `segment` (points,), the second run records: one in `_COARSER`,
    counted from the end of each segment."""
    ends = np.flatnonzero(np.append(np.diff(segment) != 0, True))
    from_end = ends[segment] - np.arange(segment.size)
    recorded = from_end % _COARSER == 0
    recorded[0] = True
    return np.flatnonzero(recorded)


def _missed_by_steps(fine: Array, coarse: Array, recorded: Array) -> Array:
    """Bound the error of finite steps in the mean over replicas: (points, values) from what they left, shape
    (replicas, points, values), and left in steps four times as long at the instants `recorded`.

    An error of the first order in the step is four times as large there, and a third of the difference; one of a higher
    order is less than that. The difference has a scatter, and may vanish by chance, at an instant too: its standard
    error is added, and of neighbouring instants the largest counts.
    """
    changed = coarse - fine[:, recorded]
    missed, replicas = np.mean(changed, axis=0), len(changed)
    if replicas > 1:
        missed = np.hypot(missed, np.std(changed, axis=0, ddof=1) / math.sqrt(replicas))
    missed = ndimage.maximum_filter1d(np.abs(missed) / (_COARSER - 1), 3, axis=0)
    after = np.searchsorted(recorded, np.arange(fine.shape[1]))
    found = np.maximum(missed[np.maximum(after - 1, 0)], missed[after])
    found[0] = 0.0
    return np.asarray(found)


def _joined(found: list[Array | None], per_time: float, unit: float) -> dict[str, Array] | None:
    """The avalanches of all replicas by column, in the user's units."""
    parts = [np.column_stack((one, np.full(len(one), index))) for index, one in enumerate(found) if one is not None]
    if not parts:
        return None
    t, X, breaks, drop, distance, replica = np.concatenate(parts).T
    return {
        "t": t / per_time, "X": X * unit, "breaks": breaks.astype(np.int64), "drop": drop * unit,
        "distance": distance * unit, "replica": replica.astype(np.int64),
    }  # fmt: skip


def _still(progress: Progress, lives: int, _: int) -> None:
    """Progress of a second run, whose lives do not count."""
    progress(lives)


def pulled(
    ensemble: Ensemble,
    programme: Programme,
    recorded: tuple[int, int, int],
    threads: Threads,
    progress: Progress | None,
) -> SliderTrajectory:
    """`trajectory.trajectory` of a slider that a stage pulls; `recorded` holds points, seed and replicas."""
    points, seed, replicas = recorded
    grid, unit, pull = programme.grid(points), ensemble.thresholds.scale, pull_of(ensemble, programme)
    instants, per_time = grid.t * (pull.pace / unit), pull.pace / unit
    begin, found, coarse, lives = 0.0, [], [], 0
    workers, recorded_again = 1 if isinstance(threads, tuple) else workers_of(threads), _seldom(grid.segment)
    for replica in range(replicas):
        first = replica * ensemble.count
        with Slider(ensemble, programme, seed, first, workers) as slider:
            begin = begin or time.perf_counter()  # when kernels are compiled
            follow = _quasi_static if slider.quasi_static else _simulate
            found.append(follow(slider, instants, replica, lives, progress))
        lives += found[-1].lives
        if follow is _simulate:
            still = None if progress is None else functools.partial(_still, progress, lives)
            with Slider(ensemble, programme, seed, first, workers, _COARSER) as slider:
                coarse.append(_simulate(slider, instants[recorded_again], replica, 0, still))
    every = np.array([one.values for one in found])
    values = np.mean(every, axis=0)
    spread = np.std(every, axis=0, ddof=1) if replicas > 1 else None
    missed = np.zeros((grid.t.size, 3))
    if coarse:
        shown = [_X, _FRICTION, _BOUND]
        missed = _missed_by_steps(
            every[:, :, shown], np.array([one.values[:, shown] for one in coarse]), recorded_again
        )
        missed[:, 0] += np.abs(values[:, _BEHIND])
        missed[:, 1] += np.abs(values[:, _BEHIND])  # contacts are no stiffer than 1 each in the mean
    stderr = np.sqrt(values[:, _VARIANCE] if spread is None else spread[:, _FRICTION] ** 2 / replicas)
    stderr_X = np.zeros(grid.t.size) if spread is None else spread[:, _X] / math.sqrt(replicas)
    of_pinned = pinned_variance(values[:, _BOUND], ensemble.count, ensemble.delay.time > 0)
    stderr_pinned = np.sqrt(of_pinned) if spread is None else spread[:, _BOUND] / math.sqrt(replicas)
    stderr_X, stderr, stderr_pinned = np.hypot(np.stack((stderr_X, stderr, stderr_pinned)), missed.T)
    X, force = values[:, _X] * unit, values[:, _FRICTION] * unit

    def in_units(replicas: list[_Replica]) -> tuple[Slip, ...]:
        return tuple(
            replace(
                s, t=s.t / per_time, X=s.X * unit, drop=s.drop * unit, duration=s.duration / per_time,
                distance=s.distance * unit,
            )
            for s in itertools.chain.from_iterable(one.slips for one in replicas)
        )  # fmt: skip

    reliable = replicas >= _FEW_REPLICAS
    segments = shown_by(
        programme, Grid(grid.t, X, grid.segment), force, stderr * unit, reliable, X_stderr=stderr_X * unit
    )
    return SliderTrajectory(
        X=X,
        t=grid.t,
        force=force,
        force_stderr=stderr * unit,
        force_reliable=reliable,
        pinned=values[:, _BOUND],
        pinned_stderr=stderr_pinned,
        force_replica_std=None if spread is None else spread[:, _FRICTION] * unit,
        force_replicas=None if spread is None else every[:, :, _FRICTION] * unit,
        lives=lives,
        seed=seed,
        engine_seconds=time.perf_counter() - begin,
        threads=workers,
        segment=grid.segment,
        segments=segments,
        stage=values[:, _STAGE] * unit,
        spring=pull.stiffness * (values[:, _STAGE] - values[:, _X]) * unit,
        X_stderr=stderr_X * unit,
        X_replica_std=None if spread is None else spread[:, _X] * unit,
        X_replicas=None if spread is None else every[:, :, _X] * unit,
        energy=values[:, [_WORK, _KEPT, _TAKEN, _MISSING]] * unit**2,
        slips=in_units(found),
        coarser_slips=in_units(coarse) if coarse else None,
        avalanches=_joined([one.avalanches for one in found], per_time, unit),
    )
