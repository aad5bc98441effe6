"""Steps of a chain of blocks in time, as kernels.

A step is that of a slider behind a stage (`engine.slider`) in every block: the force of
each block is estimated as F + (A + rho) dX + r dt, the displacements of all follow
together from a tridiagonal system, contacts are followed along the straight piece of
their block, and the next step gives back what the estimate has missed. With a mass
forces are balanced as for a slider. Without one the system

    E X' = net + gain t - S X,   X(0) = 0,

with dampers E and stiffness S is solved by TR-BDF2 (L-stable, of second order; Bank et
al., 1985), or in closed form where no block feels another. All blocks share the step:
the one that misses its force most, beyond the scatter of its breaks, sets its length.

Forces are per n k, lengths in units of the threshold law's scale; time is displacement
at the pace of `model.reduced.Pull`.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from eqsim.engine.contacts import Contacts
from eqsim.engine.slider import (
    BLOCK,
    MEMORY,
    NOISE,
    SHORTEST_STEP,
    Piece,
    Range,
    follow_range,
    relaxed,
)
from eqsim.numerics.compiled import kernel, routine
from eqsim.numerics.streams import Key
from eqsim.numerics.tables import Array

_GAMMA = 2.0 - math.sqrt(2.0)  # share of a step of TR-BDF2 that its trapezoid takes
_IMPLICIT = 0.5 * _GAMMA  # share of S dt in both of its matrices
_SECOND = 1.0 / (_GAMMA * (2.0 - _GAMMA))  # weight of its first result in the second


class Links(NamedTuple):
    """Springs, dampers and limits of a chain, which do not change while it moves."""

    coupling: float  # K
    bulk: float  # alpha
    damping: float  # eta
    drag: float  # of a block whose contacts are all detached
    mass: float  # M
    periodic: bool
    free: bool  # no block feels another
    springs: Array  # (B,), K_j
    neighbours: Array  # (B,)
    ends: Array  # (B + 1,), where the contacts of blocks begin and end
    mean_count: float  # n
    longest: float  # displacement of a step
    tolerance: float  # of the force of a block
    waits: bool  # contacts break by heat, or age
    fast: float  # velocity of a block above which an event goes on


class Blocks(NamedTuple):
    """Blocks between two steps, and in the next one, arrays (B,)."""

    X: Array
    V: Array
    behind: Array  # displacement that estimates have missed so far (`slider.Behind`)
    behind_V: Array  # the same of the velocity
    over: Array  # time within which what was missed is given back
    acceleration: Array  # in the last step
    direction: Array  # that of the means rho and r (`slider.BreakRates`), as these four
    moved: Array
    waited: Array
    by_motion: Array
    by_heat: Array
    counted: Array  # breaks that these means are of
    rho: Array  # change of the force by breaks per displacement
    r: Array  # and per time
    damping: Array  # of a block and of its detached contacts
    theta: Array  # share of a step after which forces on the mass are balanced
    breaks: Array  # so far
    dX: Array  # in the step, as all that follows
    next_V: Array
    made_up: Array
    made_up_V: Array
    net: Array
    gain: Array
    missed: Array  # of the force
    lag: Array  # displacement that follows from it
    jump: Array  # change of the acceleration
    pivot: Array  # of the tridiagonal matrix
    lower: Array  # elements beside the diagonal over the pivots
    corner: Array  # response to the corners of that of a ring
    broken: Array  # 1 if half of the contacts have broken in the event
    breaks_before: Array  # so far, at the beginning of the event


# The chain between two steps; energies are means over blocks.
COURSE = np.dtype(
    [
        ("time", float),
        ("Y", float),
        ("dt", float),  # of the next step
        ("work", float),
        ("damped", float),
        ("lost", float),
        ("missed", float),
        ("steps", np.int64),
        ("event", np.int64),  # number of the last event that has begun
        ("going_on", np.bool_),  # that event
        ("begin", float),  # of the event
        ("dissipated", float),  # at its beginning
        ("force", float),  # of the springs at its beginning
        ("direction", float),  # in which blocks moved then, 1 or -1
        ("peak", float),  # largest force of the springs since the event before
        ("least", float),  # and the least
        ("rows", np.int64),  # of the log of breaks
        ("events", np.int64),  # in the list of events
    ]
)

# A block that has broken in an event.
BROKE = np.dtype([("event", np.int64), ("block", np.int64), ("t", float), ("X", float)])

# An event in which a block has broken; that under way at the end has not `ended`.
EVENT = np.dtype(
    [
        ("event", np.int64),
        ("t", float),  # when it began
        ("duration", float),
        ("blocks", np.int64),  # that broke
        ("peak", float),  # largest force of the springs from the event before on
        ("drop", float),  # of the force of the springs
        ("energy", float),  # taken by breaks and dampers, mean over blocks
        ("ended", np.bool_),
    ]
)


class Chained(NamedTuple):
    """A chain and all its contacts, for kernels."""

    laws: Contacts
    key: Key
    first: int  # number of the first contact
    links: Links
    blocks: Blocks
    population: Array  # `slider.CONTACT`, of all contacts
    now: Array  # `slider.SUMS` of each block, between two steps
    then: Array  # at the end of the step
    part: Array  # of `BLOCK` contacts of a block at most
    totals: Array  # the numbers of `then`, a row for each block
    part_row: Array  # those of `part`
    course: Array  # `COURSE`, (1,)
    broke: Array  # `BROKE`, with room for all blocks of the next step at least
    events: Array  # `EVENT`, the same


@routine(inline=True)
def _differences(links: Links, x: Array, j: int) -> float:
    """(L x)_j, the sum over neighbours i of x_j - x_i."""
    last = x.size - 1
    total = 0.0
    if j > 0:
        total += x[j] - x[j - 1]
    elif links.periodic:
        total += x[j] - x[last]
    if j < last:
        total += x[j] - x[j + 1]
    elif links.periodic:
        total += x[j] - x[0]
    return total


@routine(inline=True)
def _know_blocks(c: Chained) -> None:
    """Fill what follows from the sums and the breaks of blocks between two steps. In a
    coupled chain no step is expected to lose more force than there is: a front leaves
    hardly any."""
    links, b = c.links, c.blocks
    for j in range(b.X.size):
        sums = c.now[j]
        rho = -b.by_motion[j] / max(b.moved[j], 0.1 * links.longest)
        if not links.free:
            rho = max(rho, -abs(sums.force) / links.longest)
        b.rho[j] = rho
        b.r[j] = -b.by_heat[j] / b.waited[j] if b.waited[j] > 0.0 else 0.0
        weight = (links.ends[j + 1] - links.ends[j]) / links.mean_count
        b.damping[j] = links.damping + links.drag * (weight - sums.pinned)


@routine(inline=True)
def _factor(links: Links, c: Chained, dt: float) -> float:
    """Fill the pivots of the tridiagonal matrix of a step. Returns the element beside
    its diagonal, and 1 if the matrix is not positive definite: then nothing holds the
    chain back within this step."""
    b = c.blocks
    last = b.X.size - 1
    diagonal = b.pivot
    for j in range(last + 1):
        elastic = links.springs[j] + c.now[j].stiffness + b.rho[j]
        elastic += links.coupling * links.neighbours[j]
        damping = b.damping[j]
        damping += links.bulk * links.neighbours[j]
        if links.mass > 0.0:
            # the end of a step, where vibrations of the block are faster
            stiffest = links.springs[j] + c.now[j].stiffness
            stiffest += 2.0 * links.coupling * links.neighbours[j]
            b.theta[j] = 0.5 if dt * dt * stiffest < links.mass else 1.0
            inertia = links.mass / (b.theta[j] * dt * dt)
            diagonal[j] = inertia + damping / dt + 0.5 * elastic
        else:
            diagonal[j] = damping + _IMPLICIT * dt * elastic
    off = -links.bulk - _IMPLICIT * dt * links.coupling
    if links.mass > 0.0:
        off = -links.bulk / dt - 0.5 * links.coupling
    if links.periodic:  # Sherman and Morrison: corners are a product of two vectors
        head = -diagonal[0]
        diagonal[0] -= head
        diagonal[last] -= off * off / head
    for j in range(last + 1):
        if j > 0:
            b.lower[j] = off / diagonal[j - 1]
            diagonal[j] -= off * b.lower[j]
        if not diagonal[j] > 0.0:
            return 1.0
    if links.periodic:
        b.corner.fill(0.0)
        b.corner[0] = head
        b.corner[last] = off
        _eliminate(b, off, b.corner)
        share = 1.0 + b.corner[0] + off / head * b.corner[last]
        if not share > 0.0:
            return 1.0
        for j in range(last + 1):
            b.corner[j] /= share
    return off


@routine(inline=True)
def _eliminate(b: Blocks, off: float, x: Array) -> None:
    """Solve a tridiagonal system of known pivots; `x` is its right-hand side first."""
    last = x.size - 1
    for j in range(1, last + 1):
        x[j] -= b.lower[j] * x[j - 1]
    x[last] /= b.pivot[last]
    for j in range(last - 1, -1, -1):
        x[j] = (x[j] - off * x[j + 1]) / b.pivot[j]


@routine(inline=True)
def _solve(links: Links, b: Blocks, off: float, x: Array) -> None:
    """Solve the system of a step; `x` is its right-hand side first."""
    _eliminate(b, off, x)
    if links.periodic:
        last = x.size - 1
        head = -0.5 * b.pivot[0]
        both = x[0] + off / head * x[last]
        for j in range(last + 1):
            x[j] -= both * b.corner[j]


@routine(inline=True)
def _relax(links: Links, c: Chained, off: float, dt: float, x: Array) -> None:
    """Fill `x` with displacements after dt of a chain without mass from `net` and
    `gain`."""
    b = c.blocks
    size = x.size
    for j in range(size):
        if links.free:
            elastic = links.springs[j] + c.now[j].stiffness + b.rho[j]
            damping = b.damping[j]
            x[j] = relaxed(b.net[j], b.gain[j], elastic, damping, dt)
        else:
            x[j] = _IMPLICIT * dt * (2.0 * b.net[j] + b.gain[j] * _GAMMA * dt)
    if links.free:
        return
    _solve(links, b, off, x)
    for j in range(size):
        damped = b.damping[j] * x[j]
        damped += links.bulk * _differences(links, x, j)
        driven = _IMPLICIT * dt * (b.net[j] + b.gain[j] * dt)
        b.net[j] = _SECOND * damped + driven
    for j in range(size):
        x[j] = b.net[j]
    _solve(links, b, off, x)


@routine(inline=True)
def _estimate(c: Chained, dt: float, speed: float) -> tuple[float, float]:
    """Fill displacements in a step of dt and the velocities at its end. Returns the
    largest displacement, which is infinite where nothing holds the chain back, and the
    element beside the diagonal."""
    links, b, s = c.links, c.blocks, c.course[0]
    mass, size = links.mass, b.X.size
    off = 0.0
    if mass > 0.0 or not links.free:
        off = _factor(links, c, dt)
        if off > 0.0:
            return math.inf, off
    for j in range(size):
        share = min(1.0, dt / b.over[j]) if b.over[j] > 0.0 else 0.0
        b.made_up[j] = share * b.behind[j]
        b.made_up_V[j] = share * b.behind_V[j]
    for j in range(size):
        spring = links.springs[j]
        elastic = spring + c.now[j].stiffness + b.rho[j]
        net = spring * (s.Y - b.X[j]) - c.now[j].force
        net += -elastic * b.made_up[j]
        if links.coupling > 0.0:
            apart = _differences(links, b.X, j) + _differences(links, b.made_up, j)
            net -= links.coupling * apart
        gain = spring * speed - b.r[j]
        if mass > 0.0:
            V = b.V[j] + b.made_up_V[j]
            theta = b.theta[j]
            b.dX[j] = net + 0.5 * gain * dt + mass / (theta * dt) * V
        b.net[j] = net
        b.gain[j] = gain
    if mass > 0.0:
        _solve(links, b, off, b.dX)
    else:
        _relax(links, c, off, dt, b.dX)
    largest = 0.0
    for j in range(size):
        moved = b.dX[j]
        b.dX[j] = b.made_up[j] + moved
        if mass > 0.0:
            V = b.V[j] + b.made_up_V[j]
            b.next_V[j] = V + (moved / dt - V) / b.theta[j]
        else:
            b.next_V[j] = (b.dX[j] if links.free else moved) / dt
        largest = max(largest, abs(b.dX[j] if links.free else moved))
    return largest, off


@routine(inline=True)
def _begin_step(c: Chained, until: float, speed: float) -> tuple[float, float]:
    """Find the length of the next step and its displacements. Returns the length and
    the element beside the diagonal."""
    s = c.course[0]
    left = until - s.time
    dt = left if 1.2 * s.dt >= left else s.dt
    longest = 1.5 * c.links.longest
    while True:
        largest, off = _estimate(c, dt, speed)
        if largest <= longest or dt <= SHORTEST_STEP:
            break
        dt *= 0.5
    return dt, off


@routine(inline=True)
def _follow(c: Chained, dt: float, first: int, last: int) -> None:
    """Follow the contacts of blocks first <= j < last along their pieces."""
    links, b = c.links, c.blocks
    for j in range(first, last):
        speed = abs(b.dX[j]) / dt if dt > 0.0 else 0.0
        piece = Piece(dt, speed, math.copysign(1.0, b.dX[j]))
        columns = c.totals.shape[1]
        for k in range(columns):
            c.totals[j, k] = 0.0
        for begin in range(links.ends[j], links.ends[j + 1], BLOCK):
            here = Range(begin, min(begin + BLOCK, links.ends[j + 1]))
            for k in range(columns):
                c.part_row[j, k] = 0.0
            follow_range(c.laws, piece, c.key, c.first, c.population, here, c.part[j])
            for k in range(columns):
                c.totals[j, k] += c.part_row[j, k]
        for k in range(columns):
            c.totals[j, k] /= links.mean_count


@routine(inline=True)
def _fall_behind(c: Chained, dt: float, off: float) -> None:
    """Find what is left to make up for after a step, whose estimate `missed` forces at
    its end. In a free chain it did so before in proportion to time, as for a slider; in
    a coupled one the times of breaks tell the impulse that it has missed. What a step
    has missed is given back within as long a time. A front after long steps misses far
    more than these have left, so that in a coupled chain a mean counts."""
    links, b = c.links, c.blocks
    lag = b.lag
    for j in range(lag.size):
        missed = b.missed[j]
        if not links.free:
            expected = b.rho[j] * b.dX[j] + b.r[j] * dt
            missed = -2.0 * c.then[j].impulse / dt - expected
        lag[j] = -0.5 * missed
        b.net[j] = 0.0
        b.gain[j] = -missed / dt
    if links.mass > 0.0:
        _solve(links, b, off, lag)
    else:
        _relax(links, c, off, dt, lag)
    for j in range(lag.size):
        velocity = 0.0
        if links.mass > 0.0:
            velocity = lag[j] / (b.theta[j] * dt)
        left = max(dt, b.over[j] - dt)
        if not links.free and lag[j] != 0.0 and math.isfinite(lag[j]):
            old = abs(b.behind[j] - b.made_up[j])
            left = dt + (left - dt) * old / (old + abs(lag[j]))
        b.over[j] = left
        if math.isfinite(lag[j]):
            b.behind[j] = b.behind[j] - b.made_up[j] + lag[j]
            b.behind_V[j] = b.behind_V[j] - b.made_up_V[j] + velocity
        else:
            b.behind[j] = 0.0
            b.behind_V[j] = 0.0


@routine(inline=True)
def _account(c: Chained, dt: float, speed: float) -> None:
    """Take a step in which forces are taken for their estimates in the mean. Dampers
    take what is left of the work of the springs."""
    links, b, s = c.links, c.blocks, c.course[0]
    size = b.X.size
    dY = speed * dt
    work, damped, lost, missed = 0.0, 0.0, 0.0, 0.0
    for j in range(size):
        now, then = c.now[j], c.then[j]
        change = (now.stiffness + b.rho[j]) * b.dX[j] + b.r[j] * dt
        b.missed[j] = then.force - now.force - change
        momentum = b.damping[j] * b.made_up[j]
        momentum += links.mass * b.made_up_V[j]
        if links.bulk > 0.0:
            momentum += links.bulk * _differences(links, b.made_up, j)
        force = now.force + 0.5 * change - momentum / dt
        spring = links.springs[j] * (s.Y + 0.5 * dY - b.X[j] - 0.5 * b.dX[j])
        pull = spring
        if links.coupling > 0.0:
            apart = _differences(links, b.X, j) + 0.5 * _differences(links, b.dX, j)
            pull -= links.coupling * apart
        kinetic = 0.5 * links.mass * (b.next_V[j] * b.next_V[j] - b.V[j] * b.V[j])
        work += spring * dY
        damped += (pull - force) * b.dX[j] - kinetic
        lost += then.lost
        missed += force * b.dX[j] - (then.stored - now.stored) - then.lost
    s.work += work / size
    s.damped += damped / size
    s.lost += lost / size
    s.missed += missed / size


@routine(inline=True)
def _note_breaks(links: Links, b: Blocks, sums: Any, j: int, dt: float) -> None:
    """Take account of the breaks of a block in a step (`slider.BreakRates`). In a front
    all contacts of a block break within a short way, after which hardly any does. So in
    a coupled chain what is known of breaks by motion is forgotten with those that it
    lets expect, too."""
    breaks = sums.breaks * links.mean_count
    kept = math.exp(-breaks / MEMORY)
    moving = kept
    if not links.free and b.moved[j] > 0.0:
        expected = b.counted[j] * abs(b.dX[j]) / b.moved[j]
        moving = math.exp(-max(breaks, expected) / MEMORY)
    direction = math.copysign(1.0, b.dX[j])
    if direction != b.direction[j]:
        b.direction[j] = direction
        b.moved[j] = 0.0
        b.by_motion[j] = 0.0
        b.counted[j] = 0.0
    b.moved[j] = moving * b.moved[j] + abs(b.dX[j])
    b.by_motion[j] = moving * b.by_motion[j] + direction * sums.by_motion
    b.counted[j] = moving * b.counted[j] + breaks
    b.waited[j] = kept * b.waited[j] + dt
    b.by_heat[j] = kept * b.by_heat[j] + sums.by_heat
    b.breaks[j] += breaks


@routine(inline=True)
def _next_step(c: Chained, dt: float, cut: bool) -> float:
    """Length of the next step that the tolerance allows after one of dt, which is `cut`
    if it was not as long as it might have been (`slider.Slider`)."""
    links, b, s = c.links, c.blocks, c.course[0]
    error = 0.0
    longest = math.inf
    # waves of single breaks, which a block of few contacts always has
    finest, breaks = 1.0, 0.0
    for j in range(b.X.size):
        breaks += b.breaks[j]
    if breaks > 0.0:
        finest = links.tolerance / max(links.tolerance, 1.0 / links.mean_count)
    for j in range(b.X.size):
        sums = c.now[j]
        noise = NOISE * math.sqrt(sums.scatter / links.mean_count)
        error = max(error, abs(b.missed[j]) - noise)
        elastic = links.springs[j] + sums.stiffness
        if links.mass > 0.0:
            stiffest = elastic + 2.0 * links.coupling * links.neighbours[j]
            shaken = 4.0 * dt * dt * b.jump[j] * stiffest
            error = max(error, shaken if links.free else shaken * finest)
        if links.waits and sums.square > 0.0:
            force = math.sqrt(sums.square / sums.pinned) / links.mean_count
            against = math.sqrt(elastic * (elastic + 4.0 * links.coupling))
            few = 1.5 * links.longest * against * b.waited[j] / force
            longest = min(longest, few)
    factor = 2.0
    if error > 0.0:
        factor = min(max(0.9 * math.sqrt(links.tolerance / error), 0.3), 2.0)
    allowed = dt * factor
    if cut and error < links.tolerance:
        allowed = max(allowed, s.dt)
    return min(allowed, longest)


@routine(inline=True)
def _force(c: Chained) -> float:
    """Force of all springs that drive, over N k."""
    links, b = c.links, c.blocks
    total = 0.0
    for j in range(b.X.size):
        total += links.springs[j] * (c.course[0].Y - b.X[j])
    return total / b.X.size


@routine(inline=True)
def _watch(c: Chained, dt: float) -> None:
    """Tell when events begin and end, and when their blocks break, after a step."""
    links, b, s = c.links, c.blocks, c.course[0]
    size = b.X.size
    force = _force(c)
    s.peak = max(s.peak, force)
    s.least = min(s.least, force)
    fastest, motion = 0.0, 0.0
    for j in range(size):
        fastest = max(fastest, abs(b.V[j]))
        motion += b.V[j]
    if fastest > links.fast and not s.going_on:
        s.going_on = True
        s.event += 1
        s.begin = s.time - dt
        s.dissipated = s.damped + s.lost
        s.force = force
        s.direction = math.copysign(1.0, motion)
        b.broken.fill(0.0)
        for j in range(size):
            b.breaks_before[j] = b.breaks[j] - c.now[j].breaks * links.mean_count
    if not s.going_on:
        return
    for j in range(size):
        half = 0.5 * (links.ends[j + 1] - links.ends[j])
        count = b.breaks[j] - b.breaks_before[j]
        if b.broken[j] == 0.0 and count >= half:
            b.broken[j] = 1.0
            latest = c.now[j].breaks * links.mean_count
            row = c.broke[s.rows]
            row.event = s.event
            row.block = j
            row.t = s.time - dt * min(1.0, (count - half) / latest)
            row.X = b.X[j]
            s.rows += 1
    if fastest > links.fast:
        return
    s.going_on = False
    blocks = b.broken.sum()
    if blocks > 0:
        event = c.events[s.events]
        event.event = s.event
        event.t = s.begin
        event.duration = s.time - s.begin
        event.blocks = blocks
        event.peak = s.peak if s.direction > 0.0 else s.least
        event.drop = s.direction * (s.force - force)
        event.energy = s.damped + s.lost - s.dissipated
        event.ended = True
        s.events += 1
    s.peak = force
    s.least = force


@routine(inline=True)
def _end_step(c: Chained, dt: float, until: float, speed: float, off: float) -> None:
    """Take the step whose contacts have been followed."""
    b, s = c.blocks, c.course[0]
    cut = dt == until - s.time
    _account(c, dt, speed)
    _fall_behind(c, dt, off)
    for j in range(b.X.size):
        acceleration = (b.next_V[j] - b.V[j]) / dt
        b.jump[j] = abs(acceleration - b.acceleration[j])
        b.acceleration[j] = acceleration
        b.X[j] += b.dX[j]
        b.V[j] = b.next_V[j]
        _note_breaks(c.links, b, c.then[j], j, dt)
        c.now[j] = c.then[j]
    _know_blocks(c)
    s.time += dt
    s.Y += speed * dt
    s.steps += 1
    s.dt = _next_step(c, dt, cut)
    if cut:
        s.time = until
    _watch(c, dt)


@routine(inline=True)
def _has_room(c: Chained) -> bool:
    """True if the lists have room for what a step may tell."""
    s = c.course[0]
    return c.broke.size - s.rows >= c.blocks.X.size and c.events.size > s.events


@kernel
def march(c: Chained, until: float, speed: float, most: int, stop: Array) -> bool:
    """Make up to `most` steps, not beyond time `until`, while what drives moves at
    `speed`. Returns False if a list has no more room."""
    for _ in range(most):
        if c.course[0].time >= until or stop[0] != 0:
            break
        if not _has_room(c):
            return False
        dt, off = _begin_step(c, until, speed)
        _follow(c, dt, 0, c.blocks.X.size)
        _end_step(c, dt, until, speed, off)
    return True


@kernel
def begin_step(c: Chained, until: float, speed: float) -> tuple[float, float]:
    """The first third of a step of `march`, whose contacts threads share."""
    return _begin_step(c, until, speed)


@kernel
def follow_share(c: Chained, dt: float, first: int, last: int) -> None:
    """The second third, for blocks first <= j < last."""
    _follow(c, dt, first, last)


@kernel
def end_step(c: Chained, dt: float, until: float, speed: float, off: float) -> bool:
    """The last third. Returns whether lists have room for the next step."""
    _end_step(c, dt, until, speed, off)
    return _has_room(c)


@kernel
def follow_all(c: Chained) -> None:
    """Fill the sums of contacts that stand still."""
    c.blocks.dX.fill(0.0)
    _follow(c, 0.0, 0, c.blocks.X.size)
    for j in range(c.blocks.X.size):
        c.now[j] = c.then[j]
    _know_blocks(c)
