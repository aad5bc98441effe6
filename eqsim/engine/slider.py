"""A slider that a stage pulls through a spring, in short steps at constant velocity.

In each step the force F of the contacts is first estimated as

    F + (A + rho) dX + r dt,

with A the stiffness of all pinned contacts, and rho and r the changes of F by breaks
per displacement and per time, which are known from the last breaks (derived, of second
order in the step). The equation of motion without a mass

    eta X' = kappa (Y - X) - F

has a closed solution for this estimate. With a mass, forces are balanced in the middle
of the step, or at its end where the slider's own vibration is faster than a step. Then
every contact is followed along the straight piece of X(t), so that F is exact for this
X(t). The next step makes up for the displacement and the velocity that the estimate has
missed (`Behind`). Without this the error would be of first order in the step, since rho
and r lag behind by the breaks that they are means of.

A step is so short that its estimate misses F by less than the tolerance, beyond the
scatter of the breaks themselves, and that its displacement is at most the root of the
tolerance. Slips take as many steps as they need. Where neither damping nor mass limits
the velocity, a slip takes no time. A force f(t) on the slider itself adds to that of
the spring, and a motor is one of its stall force with a damping (`model.reduced.Pull`).

Lengths are in units of the threshold law's scale; time is displacement at the pace of
`model.reduced.Pull`.
"""

import math
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from eqsim.engine.contacts import Contacts, contacts
from eqsim.engine.lanes import delay_after, delay_of_the_first, draw_birth
from eqsim.engine.recorder import Snapshot
from eqsim.engine.segments import begin_stationary
from eqsim.engine.stationary import stationary
from eqsim.errors import InputError
from eqsim.laws.aging import Unaged
from eqsim.laws.aging.base import Held, growth, spend, stiffness_varies
from eqsim.laws.barrier import Mechanical
from eqsim.laws.stiffness import kappa
from eqsim.model.drive import Programme
from eqsim.model.ensemble import Ensemble
from eqsim.model.reduced import drag_of, pull_of
from eqsim.model.slip import least_slip, width_of
from eqsim.numerics.compiled import kernel, routine
from eqsim.numerics.streams import TRAJECTORY, Key
from eqsim.numerics.streams import key as key_of
from eqsim.numerics.tables import Array
from eqsim.numerics.threads import ThreadPool

BLOCK = 512  # contacts summed first: sets the last bits, for any number of threads
_BLOCKS_PER_THREAD = 20  # at least: waking a thread takes as long as following them
_DRAWN_AT_ONCE = 1 << 16  # contacts of a stationary start, which bounds its memory
MEMORY = 30.0  # breaks over which rho and r are averaged
FIRST_STEP = 1e-6  # as a share of the first segment
_HALVINGS = 30  # of a step, until a slider without damping and mass slips at an instant
SHORTEST_STEP = 1e-200  # of a slider that damping or a mass limits
_SLIP_DURATION = 1e-40  # over its displacement, so short that no contact ages
_ENDLESS = 1e2, 1e3, 1e5  # mean thresholds of a slip without end: least, most, times N
NOISE = 2.0  # standard errors of breaks in a step, which no shorter step would reduce
_TOLERANCE = 1e-4  # of a slider without a stage, the default of a stage
_STANDING = 1e-200  # speed over the pace of a motor that is switched off
_AT_THRESHOLD = 1.0 - 1e-9  # share of a threshold from which on breaks are by motion

# The state of a contact between two steps: 56 bytes.
CONTACT = np.dtype(
    [
        ("time_to_pinning", np.float64),  # of a detached contact
        ("time_since_birth", np.float64),  # of a pinned contact, as all that follows
        ("threshold", np.float64),  # at birth
        ("stretch", np.float64),  # in the direction of X
        ("clock", np.float64),  # the rest of the exponential clock
        ("lives", np.int64),  # that have been drawn
        ("pinned", np.bool_),
        ("began_stationary", np.bool_),  # in the life that a start has found
    ],
    align=True,
)


class Sums(NamedTuple):
    """Sums over contacts at the end of a piece, and over their breaks along it."""

    pinned: float  # number of pinned contacts
    stiffness: float
    force: float
    square: float  # of forces
    stored: float  # elastic energy
    by_motion: float  # force of breaks at thresholds, less that of births after them
    by_heat: float  # the same of breaks below thresholds
    scatter: float  # squares of the forces at breaking
    lost: float  # energy of broken contacts, less that of newborn ones
    breaks: float
    impulse: float  # force of breaks times what is left of the piece then, less births


# Powers in which stiffness and length enter the sums.
_OF_STIFFNESS = np.array(Sums(0, 1, 1, 2, 1, 1, 1, 2, 1, 0, 1))
_OF_LENGTH = np.array(Sums(0, 0, 1, 2, 2, 1, 1, 2, 2, 0, 2))
SUMS = np.dtype([(name, np.float64) for name in Sums._fields])


class Piece(NamedTuple):
    """A straight piece of X(t)."""

    duration: float
    speed: float  # over the pace
    direction: float  # 1 or -1


@kernel
def advance(
    laws: Contacts, piece: Piece, key: Key, first: int, population: Array, sums: Array
) -> None:
    """Follow contacts along a piece, and add up each block of them. `population` holds
    records of type `CONTACT`, of contacts from `first` on; `sums` holds a record of
    type `SUMS` for each block, which are 0 before."""
    for block in range(sums.size):
        begin = block * BLOCK
        here = Range(begin, min(begin + BLOCK, population.size))
        follow_range(laws, piece, key, first, population, here, sums[block])


class Range(NamedTuple):
    """Contacts from `begin` to `end` of a population."""

    begin: int
    end: int


@routine(inline=True)
def follow_range(
    laws: Contacts,
    piece: Piece,
    key: Key,
    first: int,
    population: Array,
    here: Range,
    sums: Any,
) -> None:
    """Follow contacts along a piece, of a population that begins with number `first`,
    and add them to `sums`."""
    for i in range(here.begin, here.end):
        contact = population[i]
        _follow_contact(laws, piece, key, first + i, contact, sums)
        _add(laws, contact, sums)


@routine(inline=True)
def _follow_contact(
    laws: Contacts, piece: Piece, key: Key, number: int, contact: Any, sums: Any
) -> None:
    """Follow contact `number` along a piece."""
    left = piece.duration
    by_motion = False
    while True:
        if not contact.pinned:
            if contact.time_to_pinning > left:
                contact.time_to_pinning -= left
                return
            left -= contact.time_to_pinning
            life = draw_birth(laws.newborn, laws, key, number, contact.lives)
            born = life.stretch
            contact.threshold = life.threshold
            contact.stretch = born
            contact.clock = life.clock
            contact.time_since_birth = 0.0
            contact.lives += 1
            contact.pinned = True
            contact.began_stationary = False
            if born != 0.0:
                force = kappa(laws.springs, life.threshold) * born
                if by_motion:
                    sums.by_motion -= force
                else:
                    sums.by_heat -= force
                sums.impulse -= force * left
                sums.lost -= 0.5 * force * born
        y = piece.direction * contact.stretch
        stiffness = kappa(laws.springs, contact.threshold)
        held = Held(contact.threshold, stiffness, y, contact.time_since_birth)
        broke, clock = spend(laws.aging, laws, held, piece.speed, left, contact.clock)
        if broke > left:
            break
        x = y + piece.speed * broke
        grown = growth(laws.aging, contact.time_since_birth + broke)
        if stiffness_varies(laws.aging, laws.springs):
            stiffness *= grown
        force = stiffness * x * piece.direction
        by_motion = abs(x) >= contact.threshold * grown * _AT_THRESHOLD
        if by_motion:
            sums.by_motion += force
        else:
            sums.by_heat += force
        sums.scatter += force * force
        sums.lost += 0.5 * force * x * piece.direction
        sums.breaks += 1.0
        contact.time_to_pinning = delay_of(laws, key, number, contact)
        contact.pinned = False
        left = max(left - broke, 0.0)
        sums.impulse += force * left
    contact.clock = clock
    contact.time_since_birth += left
    contact.stretch = piece.direction * (y + piece.speed * left)


@routine
def delay_of(laws: Contacts, key: Key, number: int, contact: Any) -> float:
    """Delay after the life of contact `number` that has just ended."""
    if contact.began_stationary:
        return delay_of_the_first(laws, key, number)
    return delay_after(laws, key, number, contact.lives - 1)


@routine(inline=True)
def _add(laws: Contacts, contact: Any, sums: Any) -> None:
    """Add a contact at the end of a piece."""
    if not contact.pinned:
        return
    stiffness = kappa(laws.springs, contact.threshold)
    if stiffness_varies(laws.aging, laws.springs):
        stiffness *= growth(laws.aging, contact.time_since_birth)
    force = stiffness * contact.stretch
    sums.pinned += 1.0
    sums.stiffness += stiffness
    sums.force += force
    sums.square += force * force
    sums.stored += 0.5 * force * contact.stretch


class State(NamedTuple):
    """Slider and stage between two steps; sums and energies are per contact."""

    time: float
    X: float  # of the slider
    Y: float  # of the stage
    V: float  # velocity of the slider
    sums: Sums
    work: float = 0.0  # of the stage so far
    damped: float = 0.0  # energy taken by damping so far
    lost: float = 0.0  # energy taken by breaks so far
    missed: float = 0.0  # energy missed so far, since F is taken for its estimate


class Behind(NamedTuple):
    """Lag of the slider in `distance` and `velocity`, because estimates missed F. It is
    made up for within the time `over` (derived, of first order in the missed F)."""

    distance: float = 0.0
    velocity: float = 0.0
    over: float = 0.0

    def within(self, dt: float) -> "Behind":
        """Share that a step of dt makes up for. What a longer step has missed takes as
        long as that step, so that the displacement vanishes with dt."""
        share = min(1.0, dt / self.over) if self.over > 0.0 else 0.0
        return Behind(share * self.distance, share * self.velocity, self.over)


class BreakRates:
    """Change of F by breaks, per displacement (rho) and per time (r). Means over the
    last `MEMORY` breaks, or over those of the last step where these are more; rho is
    never taken over less than `shortest`."""

    def __init__(self, shortest: float) -> None:
        self.shortest = shortest
        self.direction = 1.0
        self.moved = 0.0
        self.waited = 0.0
        self.by_motion = 0.0
        self.by_heat = 0.0

    def add(self, dX: float, dt: float, sums: Sums, count: int) -> None:
        """Take account of a step of `count` contacts."""
        kept = math.exp(-sums.breaks * count / MEMORY)
        direction = math.copysign(1.0, dX)
        if direction != self.direction:
            self.direction = direction
            self.moved = 0.0
            self.by_motion = 0.0
        self.moved = kept * self.moved + abs(dX)
        self.by_motion = kept * self.by_motion + direction * sums.by_motion
        self.waited = kept * self.waited + dt
        self.by_heat = kept * self.by_heat + sums.by_heat

    @property
    def rho(self) -> float:
        return -self.by_motion / max(self.moved, self.shortest)

    @property
    def r(self) -> float:
        return -self.by_heat / self.waited if self.waited > 0.0 else 0.0


@routine
def relaxed(
    net: float, gain: float, stiffness: float, damping: float, dt: float
) -> float:
    """Displacement X(dt) from damping X' = net + gain t - stiffness X and X(0) = 0."""
    if damping == 0.0:
        return (net + gain * dt) / stiffness if stiffness > 0.0 else math.inf
    w = -stiffness * dt / damping
    if w > 700.0:
        return math.inf
    first = math.expm1(w) / w if abs(w) > 1e-5 else 1.0 + 0.5 * w
    second = (first - 1.0) / w if abs(w) > 1e-3 else 0.5 + w / 6.0 + w * w / 24.0
    return dt / damping * (net * first + gain * dt * second)


def find_stationary(
    before: Contacts, key: Key, first: int, population: Array, speed: float
) -> None:
    """Put contacts (`CONTACT`) from number `first` on into the steady state of a speed,
    at which their laws are `before`."""
    law = stationary(before)
    for begin in range(0, population.size, _DRAWN_AT_ONCE):
        drawn = population[begin : begin + _DRAWN_AT_ONCE]
        snapshot = Snapshot.fresh(first + begin, drawn.size)
        begin_stationary(before, law, key, snapshot)
        drawn["began_stationary"] = snapshot.pinned
        drawn["time_to_pinning"] = snapshot.wait / speed
        drawn["time_since_birth"] = snapshot.age / speed
        for name in ("pinned", "threshold", "stretch", "clock", "lives"):
            drawn[name] = getattr(snapshot, name)


def no_end_of_slip() -> InputError:
    """Error of a slider that a force moves on for ever, at an instant."""
    return InputError(
        "drive.force: contacts that form again at once do not hold it, and nothing "
        "limits the velocity; take a smaller force, or a delay.time"
    )


class Followed(NamedTuple):
    """The contacts of one kind. Stretches and time are in units of their own law."""

    laws: Contacts
    key: Key
    first: int  # number of the first contact
    population: Array  # records of type `CONTACT`
    unit: float  # of length, over that of the ensemble


class Slider:
    """A slider on the contacts of an ensemble, pulled by the stage of a programme.
    Contacts are those of a `replica`. Steps are `longer` times as long as the tolerance
    of the stage asks for."""

    def __init__(
        self,
        ensemble: Ensemble,
        programme: Programme,
        seed: int,
        replica: int,
        threads: int,
        longer: int = 1,
    ) -> None:
        stage = programme.stage
        tolerance = stage.tolerance if stage else _TOLERANCE
        preload = stage.preload if stage else None
        unit = ensemble.thresholds.scale
        self.pull = pull_of(ensemble, programme)
        pace = self.pull.pace
        self.drag = drag_of(ensemble, pace)
        self.count = ensemble.count
        self.groups: list[Followed] = []
        factors = []  # that turn sums over each block into the ensemble's units
        blocks = []
        for kind in ensemble.kinds:
            alone, key = kind.contacts, key_of(kind.seed(seed), TRAJECTORY)
            population = np.zeros(alone.count, CONTACT)
            size = alone.thresholds.scale / unit
            first = replica * alone.count
            group = Followed(contacts(alone, pace), key, first, population, size)
            k = alone.stiffness / ensemble.mean_stiffness
            blocks.append(-(-alone.count // BLOCK))
            factors += blocks[-1] * [k**_OF_STIFFNESS * size**_OF_LENGTH]
            self.groups.append(group)
        self.factors = np.array(factors)
        self.block_sums = np.zeros_like(self.factors)
        records = self.block_sums.view(SUMS)[:, 0]
        threads = max(1, min(threads, records.size // _BLOCKS_PER_THREAD))
        self.pool = ThreadPool(threads - 1) if threads > 1 else None
        # A group, and machine code and arguments of `advance` for a thread.
        self.shares: list[tuple[Any, ...]] = []
        of_groups = np.split(records, np.cumsum(blocks)[:-1])
        for group, sums_of in zip(self.groups, of_groups, strict=True):
            ends = (np.arange(threads + 1) * sums_of.size // threads).tolist()
            for begin, end in pairwise(ends):
                part = group.population[begin * BLOCK : end * BLOCK]
                first = group.first + begin * BLOCK
                mine = first, part, sums_of[begin:end]
                still = Piece(0.0, 0.0, 1.0)
                code = advance.compiled_for(group.laws, still, group.key, *mine)
                self.shares.append((group, code, *mine))
        laws = [kind.contacts.thresholds for kind in ensemble.kinds]
        self.least_slip = min(map(least_slip, laws)) / unit
        width = min(map(width_of, laws))
        self.longest = longer * math.sqrt(tolerance) * width / unit
        mean = min(law.mean for law in laws)
        self.tolerance = longer**2 * tolerance * mean / unit
        barriers = [isinstance(x.laws.barrier, Mechanical) for x in self.groups]
        unaged = [isinstance(x.laws.aging, Unaged) for x in self.groups]
        self.waits = not all(barriers + unaged)
        self.endless = all(x.laws.delay.mean == math.inf for x in self.groups)
        least, most, breaks = _ENDLESS
        self.endless_slip = max(least, min(most, breaks / self.count)) * mean / unit
        self.slipped = 0.0  # so far, in a slip that goes on
        self.segment = 0
        self.acceleration = 0.0
        self.behind = Behind()
        self.breaks = BreakRates(0.1 * self.longest)
        self.dt = FIRST_STEP * self.pull.ends[0]
        speed = 0.0
        if programme.start == "stationary" and programme.velocity:
            speed = programme.velocity / pace
            for kind, group in zip(ensemble.kinds, self.groups, strict=True):
                before = contacts(kind.contacts, programme.velocity)
                find_stationary(before, group.key, group.first, group.population, speed)
        sums = self._follow(Piece(0.0, 0.0, 1.0))
        stretch = (preload or 0.0) / unit
        if speed and stage and preload is None:
            stretch = (sums.force + self._damping(sums) * speed) / self.pull.stiffness
        self.state = State(0.0, 0.0, stretch, speed, sums)
        # True if the slider is always in balance or slips at an instant, and only moves
        # forwards, so that one break after the other can be followed. Under a force a
        # contact that forms again at once might make a slip without an end.
        delay = self.groups[0].laws.delay.mean
        self.quasi_static = (
            not self.waits
            and len(self.groups) == 1
            and (delay == math.inf or (delay == 0.0 and not self.pull.forced))
            and self.pull.damping == self.pull.mass == 0.0
            and not self.pull.motor
            and (self.drag == 0.0 or delay == 0.0)
            and min(self.pull.speeds) >= 0.0
            and self.pull.slow
            and self.pull.stiffness * stretch >= sums.force * (1.0 - 1e-12)
        )

    def __enter__(self) -> "Slider":
        return self

    def __exit__(self, *error: Any) -> None:
        if self.pool:
            self.pool.__exit__(*error)

    @property
    def let_go(self) -> bool:
        """True if nothing is left that balances a force, or slows the slider down."""
        sums = self.state.sums
        held = self.pull.stiffness or self.pull.mass or self._damping(sums)
        return sums.pinned == 0.0 and not held

    def _damping(self, sums: Sums) -> float:
        """Damping of the slider, of all detached contacts, and by a motor."""
        damping = self.pull.damping + self.drag * (1.0 - sums.pinned)
        if self.pull.motor:
            speed = abs(self.pull.speeds[self.segment])
            damping += self.pull.stall / max(speed, _STANDING)
        return damping

    def _applied(self, time: float) -> float:
        """Force on the slider besides that of a spring."""
        pull, i = self.pull, self.segment
        if pull.motor:
            return math.copysign(pull.stall, pull.speeds[i])
        begin = pull.ends[i - 1] if i else 0.0
        return pull.forces[i] + pull.force_rates[i] * (time - begin)

    def _follow(self, piece: Piece) -> Sums:
        """Follow all contacts along a piece. Returns sums divided by their number."""
        self.block_sums.fill(0.0)
        mine, *others = [
            (code, x.laws, piece._replace(duration=piece.duration / x.unit), x.key, *of)
            for x, code, *of in self.shares
        ]
        pool = self.pool
        waiting = [pool.submit(code, *other) for code, *other in others if pool]
        for code, *share in (mine,) if pool else (mine, *others):
            code(*share)
        for waited in waiting:
            waited.result()
        total = (self.block_sums * self.factors).sum(axis=0)
        return Sums(*(total / self.count).tolist())

    @property
    def _elastic(self) -> float:
        """Stiffness of spring, contacts and breaks against a displacement."""
        return self.pull.stiffness + self.state.sums.stiffness + self.breaks.rho

    def _implicit(self, dt: float) -> tuple[float, float]:
        """Share theta of a step of dt after which forces on the mass are balanced, and
        the force per displacement in the step that inertia, damping and springs ask
        for."""
        elastic = self.pull.stiffness + self.state.sums.stiffness
        theta = 0.5 if dt * dt * elastic < self.pull.mass else 1.0
        inertia = self.pull.mass / (theta * dt * dt)
        damping = self._damping(self.state.sums) / dt
        return theta, inertia + damping + 0.5 * self._elastic

    def _estimate(self, dt: float, speed: float) -> tuple[float, float]:
        """Displacement in a step of dt, and the velocity at its end. The displacement
        is infinite where the slider is unstable and nothing limits it."""
        now, pull, behind = self.state, self.pull, self.behind.within(dt)
        elastic = self._elastic
        net = pull.stiffness * (now.Y - now.X) - now.sums.force
        net += self._applied(now.time) - elastic * behind.distance
        gain = pull.stiffness * speed + pull.force_rates[self.segment] - self.breaks.r
        if pull.mass == 0.0:
            damping = self._damping(now.sums)
            dX = behind.distance + relaxed(net, gain, elastic, damping, dt)
            return dX, dX / dt
        theta, held = self._implicit(dt)
        V = now.V + behind.velocity
        impulse = net + 0.5 * gain * dt + pull.mass / (theta * dt) * V
        moved = impulse / held if held > 0.0 else math.inf
        return behind.distance + moved, V + (moved / dt - V) / theta

    def _fall_behind(self, dt: float, missed: float) -> Behind:
        """Find what is left to make up for after a step of dt. Its estimate `missed` F
        so far at its end, and before in proportion to time."""
        if self.pull.mass == 0.0:
            damping = self._damping(self.state.sums)
            distance = relaxed(0.0, -missed / dt, self._elastic, damping, dt)
            velocity = 0.0
        else:
            theta, held = self._implicit(dt)
            distance = -0.5 * missed / held
            velocity = distance / (theta * dt)
        if not math.isfinite(distance):
            return Behind()
        before, made_up = self.behind, self.behind.within(dt)
        return Behind(
            before.distance - made_up.distance + distance,
            before.velocity - made_up.velocity + velocity,
            max(dt, before.over - dt),
        )

    def step(self, until: float, speed: float) -> State:
        """Make one step, not beyond time `until`, while the stage moves at `speed`."""
        now = self.state
        detached = now.sums.pinned == 0.0
        if detached:  # nothing breaks
            self.breaks = BreakRates(self.breaks.shortest)
        left = until - now.time
        dt = left if 1.2 * self.dt >= left else self.dt
        dX, V = self._estimate(dt, speed)
        limited = self.pull.damping or self.pull.mass
        shortest = SHORTEST_STEP if limited else 0.5**_HALVINGS * dt
        longest = 1.5 * self.longest
        if (
            detached and self.endless and not self.pull.mass
        ):  # nothing breaks, and the estimate is exact
            self.behind = Behind()
            dt, longest = left, math.inf
            dX, V = self._estimate(dt, speed)
        while abs(dX) > longest and dt > shortest:
            dt *= 0.5
            dX, V = self._estimate(dt, speed)
        if abs(dX) > longest:
            return self._slip()
        self.slipped = 0.0
        sums = self._follow(Piece(dt, abs(dX) / dt, math.copysign(1.0, dX)))
        change = (now.sums.stiffness + self.breaks.rho) * dX + self.breaks.r * dt
        missed = sums.force - now.sums.force - change
        made_up = self.behind.within(dt)
        behind = self._fall_behind(dt, missed)
        momentum = self._damping(now.sums) * made_up.distance
        momentum += self.pull.mass * made_up.velocity
        force = now.sums.force + 0.5 * change - momentum / dt
        self._account(dt, dX, speed * dt, V, sums, force)
        self.behind = behind
        self.breaks.add(dX, dt, sums, self.count)
        allowed = self._next_step(dt, dt == left, missed, now)
        self.dt = min(allowed, self._until_a_break())
        if dt == left:
            self.state = self.state._replace(time=until)
        return self.state

    def _next_step(self, dt: float, cut: bool, missed: float, before: State) -> float:
        """Length of the next step that the tolerance allows after one of dt. `missed`
        is the error of the estimate of F; `before` the state before the step, which is
        `cut` if it was not as long as it might have been."""
        sums = self.state.sums
        noise = NOISE * math.sqrt(sums.scatter / self.count)
        error = max(abs(missed) - noise, 0.0)
        if self.pull.mass:  # a change of the acceleration makes forces miss the balance
            acceleration = (self.state.V - before.V) / dt
            elastic = self.pull.stiffness + sums.stiffness
            jump = abs(acceleration - self.acceleration)
            error = max(error, 4.0 * dt * dt * jump * elastic)
            self.acceleration = acceleration
        factor = 2.0
        if error > 0.0:
            factor = min(max(0.9 * math.sqrt(self.tolerance / error), 0.3), 2.0)
        if cut and error < self.tolerance:
            return max(dt * factor, self.dt)
        return dt * factor

    def _until_a_break(self) -> float:
        """Longest step in which so few contacts break by heat that their estimate
        holds. A time without a break tells no more than that the rate of breaks is
        about one in that time. A step may have as many as move the slider by the
        longest displacement."""
        sums = self.state.sums
        if not self.waits or sums.square <= 0.0:
            return math.inf
        force = math.sqrt(sums.square / sums.pinned) / self.count  # of a contact
        elastic = self.pull.stiffness + sums.stiffness
        return 1.5 * self.longest * elastic * self.breaks.waited / force

    def _slip(self) -> State:
        """Move towards balance in a piece that takes no time."""
        if self.slipped > self.endless_slip and not self.pull.stiffness:
            raise no_end_of_slip()
        now = self.state
        net = self.pull.stiffness * (now.Y - now.X) - now.sums.force
        net += self._applied(now.time)
        elastic = self._elastic
        size = self.longest
        if now.sums.pinned == 0.0 and self.pull.stiffness:
            size = abs(net) / self.pull.stiffness  # none is pinned in no time
        elif elastic > 0.0:
            size = min(size, max(abs(net) / elastic, 1e-6 * size))
        dX = math.copysign(size, net)
        dt = _SLIP_DURATION * size
        sums = self._follow(Piece(dt, 1.0 / _SLIP_DURATION, math.copysign(1.0, net)))
        work = sums.stored - now.sums.stored + sums.lost
        self._account(dt, dX, 0.0, 0.0, sums, work / dX)
        self.behind = Behind()
        self.slipped += abs(dX)
        self.breaks.add(dX, dt, sums, self.count)
        return self.state

    def _account(
        self, dt: float, dX: float, dY: float, V: float, sums: Sums, force: float
    ) -> None:
        """Take a step in which F is taken for `force` in the mean. Damping takes what
        is left of the work of the spring."""
        now, pull = self.state, self.pull
        spring = pull.stiffness * (now.Y + 0.5 * dY - now.X - 0.5 * dX)
        if not pull.stiffness:
            spring, dY = self._applied(now.time + 0.5 * dt), dX
        damped = (spring - force) * dX - 0.5 * pull.mass * (V * V - now.V * now.V)
        taken = 0.0  # by the motor itself
        if pull.motor:
            drag = self.drag * (1.0 - sums.pinned)
            taken = damped * (1.0 - drag / self._damping(sums))
        missed = force * dX - (sums.stored - now.sums.stored) - sums.lost
        self.state = State(
            now.time + dt,
            now.X + dX,
            now.Y + dY,
            V,
            sums,
            now.work + spring * dY - taken,
            now.damped + damped - taken,
            now.lost + sums.lost,
            now.missed + missed,
        )
