"""What contacts leave on the output grid: exact ramps of force in fixed point, one kernel for every run.

A life pinned from X0 to X1 adds kappa (X - X0) to the force between them, so it leaves six numbers at the first grid
point j0 >= X0 and takes them back at the first j1 >= X1; cumulative sums over the grid then give the exact force, its
variance over contacts, and the number of pinned contacts at every point. All sums are of 64-bit integers (fixed point,
one power of 2 per column, so small that no sum can overflow): the result cannot depend on order, threads or blocks.
"""

import math
from typing import NamedTuple

import numpy as np

from eqsim.compiled import inlined, kernel
from eqsim.engine.life import draw_lives, typical_lives
from eqsim.engine.standing import Standing, standing_contact, stretches, thresholds
from eqsim.engine.streams import Key, uniforms
from eqsim.ensemble import Contacts
from eqsim.errors import InputError
from eqsim.laws.delay import delay_draw, residual_delay_draw
from eqsim.laws.octaves import Array

LANES = 128  # contacts that advance together
BATCHES = 64  # independent groups whose scatter is the error of averages over the second half
_EXTREME_RANK, _EXTREME_CLOCK = 45.0, 110.0  # -ln of no 63-bit uniform, no clock of a standing contact, exceeds these
_LEAST_UNITS = 2.0**10  # the typical force in units of the last bit, far below any statistical error
_BITS = 62  # of a sum; the sign and one more are left

# columns of the deposits; d is the distance slid since the life began
COUNT, SLOPE, FORCE, SLOPE2, RAMP2, SQUARE = range(6)  # 1, kappa, kappa d, kappa^2, kappa^2 d, (kappa d)^2
# columns of the batch sums, for each of the two quarters of the second half
AREA, PINNED, ELAPSED, BREAKS, STRETCH = range(5)


class Run(NamedTuple):
    """What a kernel needs to know of a run, lengths in units of the threshold law's scale."""

    distance: float
    points: int
    stationary: bool
    batch_by_life: bool  # few contacts: whole lives, not contacts, are the independent samples


class Scales(NamedTuple):
    """Powers of 2 that turn the deposits (6 columns), batch sums (5 columns) and replicas' forces into integers, and
    the typical force of a pinned contact."""

    deposits: Array
    batches: Array
    replica: float
    replica_square: float
    typical: float

    @classmethod
    def of(cls, c: Contacts, run: Run, contacts: int, replicas: int, drag: float) -> "Scales":
        """The finest that no sum over all contacts can overflow, from the longest life there can be.

        Raises InputError if these are too coarse for the typical contact.
        """
        ranks = np.linspace(0.01, _EXTREME_RANK, 2000)
        xi, stretch = np.empty(ranks.size), np.empty(ranks.size)
        thresholds(c, np.exp(-ranks), xi)
        stretches(c, xi, np.full(ranks.size, _EXTREME_CLOCK), stretch)
        x = 1.1 * float(stretch.max())
        x = x if run.stationary else min(x, run.distance)
        kappa = c.kappa_constant + c.kappa_slope * 1.1 * float(xi.max())
        way = run.distance + x
        force = kappa * x
        deposits = [1.0, kappa, kappa * way, kappa**2, kappa**2 * way, 2 * kappa**2 * way * x]
        batches = [force * way, way, way, 1.0, way]

        def power(bounds: list[float], terms: int) -> Array:
            return 2.0 ** np.floor(_BITS - np.log2(terms) - np.log2(bounds))

        stiffness, stretch = typical_lives(c)
        typical = float(np.mean(0.5 * stiffness * stretch**2) / np.mean(stretch))
        by_column = power(deposits, contacts)
        if not typical * by_column[FORCE] > _LEAST_UNITS:
            raise InputError(
                f"thresholds: the strongest of {contacts} contacts can carry {force / typical:.2g} times the typical "
                "force, too much to add up in 64 bits; take fewer contacts or a narrower law"
            )
        by_column[COUNT] = 1.0
        by_batch = power(batches, contacts)
        by_batch[BREAKS] = 1.0
        most = max(force, drag)
        by_replica = power([most, most**2], replicas)
        return cls(by_column, by_batch, float(by_replica[0]), float(by_replica[1]), typical)


def _before(x: Array) -> Array:
    """Sum of all earlier elements."""
    return np.cumsum(x) - x


def moments(deposits: Array, scales: Scales, run: Run, contacts: int, drag: float) -> tuple[Array, Array, Array]:
    """Mean force, pinned fraction, and variance of the force over contacts, at every grid point."""
    h = run.distance / (run.points - 1)
    total = np.cumsum(deposits, axis=0) / (scales.deposits * contacts)
    force = total[:, FORCE] + h * _before(total[:, SLOPE])
    ramp = total[:, RAMP2] + h * _before(total[:, SLOPE2])
    square = total[:, SQUARE] + _before(2 * h * ramp + h**2 * total[:, SLOPE2])
    detached = 1.0 - total[:, COUNT]
    force += drag * detached
    variance = np.maximum(square + drag**2 * detached - force**2, 0.0)
    return force, total[:, COUNT], variance


# ------------------------------------------------------------------------------------------------------- kernels


@inlined
def fixed(x: float, scale: float) -> int:
    """x in fixed point."""
    return int(np.rint(x * scale))


@inlined
def leave(deposits: Array, j: int, sign: int, stiffness: float, d: float, scales: Array) -> None:
    """Add (sign 1) or take back (sign -1) a life's ramp at a grid point where it has slid d."""
    square = stiffness * stiffness
    deposits[j, COUNT] += sign
    deposits[j, SLOPE] += sign * fixed(stiffness, scales[SLOPE])
    deposits[j, FORCE] += sign * fixed(stiffness * d, scales[FORCE])
    deposits[j, SLOPE2] += sign * fixed(square, scales[SLOPE2])
    deposits[j, RAMP2] += sign * fixed(square * d, scales[RAMP2])
    deposits[j, SQUARE] += sign * fixed(square * d * d, scales[SQUARE])


@inlined
def deposit(deposits: Array, run: Run, stiffness: float, born: float, broke: float, scales: Array) -> None:
    """A life pinned at `born` <= X < `broke`."""
    per_step = (run.points - 1) / run.distance
    step = run.distance / (run.points - 1)
    start = max(0, math.ceil(born * per_step))
    end = math.ceil(min(broke, 2.0 * run.distance) * per_step)
    if start < end:  # otherwise no grid point sees it
        if start < run.points:
            leave(deposits, start, 1, stiffness, start * step - born, scales)
        if end < run.points:
            leave(deposits, end, -1, stiffness, end * step - born, scales)


@inlined
def record(
    batches: Array, batch: int, run: Run, stiffness: float, born: float, broke: float, reborn: float, scales: Array
) -> None:
    """What a life and the delay after it leave in the two quarters of the second half."""
    for quarter in range(2):
        low = run.distance * (0.5 + 0.25 * quarter)
        high = low + 0.25 * run.distance
        start = max(born, low)
        end = min(broke, high)
        if end > start:
            batches[batch, quarter, AREA] += fixed(
                stiffness * (end - start) * (0.5 * (start + end) - born), scales[AREA]
            )
            batches[batch, quarter, PINNED] += fixed(end - start, scales[PINNED])
        end = min(reborn, high)
        if end > start:
            batches[batch, quarter, ELAPSED] += fixed(end - start, scales[ELAPSED])
        if low < broke <= high:
            batches[batch, quarter, BREAKS] += 1
            batches[batch, quarter, STRETCH] += fixed(broke - born, scales[STRETCH])


@kernel
def simulate(
    c: Contacts,
    standing: Standing,
    run: Run,
    scales: Array,
    batch_scales: Array,
    key: Key,
    deposits: Array,
    batches: Array,
    status: Array,
    first: int,
    last: int,
) -> None:
    """Follow contacts first <= i < last over the whole distance, LANES at a time, and add up what they leave."""
    contact, life = np.empty(LANES, np.int64), np.empty(LANES, np.int64)
    position, stiffness, stretch = np.empty(LANES), np.empty(LANES), np.empty(LANES)
    u, v = np.empty(LANES), np.empty(LANES)
    active, upcoming = 0, first
    while True:
        while active < LANES and upcoming < last:  # lanes whose contact has reached the end take the next one
            contact[active], life[active], position[active] = upcoming, 0, 0.0
            if run.stationary:
                life[active] = 1  # what the start finds is life 0
                batch = upcoming % BATCHES
                u_state, u_residual = uniforms(key, upcoming, 0, 0)
                if u_state < standing.pinned:
                    kappa, x, ends = standing_contact(c, standing, key, upcoming, u_residual)
                    gap = delay_draw(c.delay, c.exponential, uniforms(key, upcoming, 0, 65535)[0])
                    broke = ends - x
                    deposit(deposits, run, kappa, -x, broke, scales)
                    position[active] = broke + gap
                    record(batches, batch, run, kappa, -x, broke, position[active], batch_scales)
                else:
                    position[active] = residual_delay_draw(c.delay, c.exponential, u_residual)
                    record(batches, batch, run, 0.0, 0.0, 0.0, position[active], batch_scales)
            upcoming += 1
            active += position[active] <= run.distance
        if active == 0 or status[1] != 0:
            return
        for i in range(active):
            u[i], v[i] = uniforms(key, contact[i], life[i], 0)
        draw_lives(c, u, v, stiffness, stretch, active)
        status[0] += active
        for i in range(active - 1, -1, -1):
            broke = position[i] + stretch[i]
            reborn = broke + c.delay
            if c.exponential:
                reborn = broke + delay_draw(c.delay, True, uniforms(key, contact[i], life[i], 1)[0])
            deposit(deposits, run, stiffness[i], position[i], broke, scales)
            if reborn > 0.5 * run.distance:
                batch = (contact[i] + life[i] * run.batch_by_life) % BATCHES
                record(batches, batch, run, stiffness[i], position[i], broke, reborn, batch_scales)
            position[i] = reborn
            life[i] += 1
            if reborn > run.distance:
                active -= 1
                contact[i], life[i], position[i] = contact[active], life[active], position[active]
