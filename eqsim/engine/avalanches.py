"""A stage that pulls infinitely slowly at T = 0: one break after another, and which of them follow from each other.

Without heat, delay, damping and mass the slider is always in balance, kappa (Y - X) = F(X), or slips until it is.
Contacts break where X reaches X_birth + xi - y, y the stretch at birth, in the order of a queue; the stage has to be at

    Y(X) = X + F(X)/kappa

for that, and all breaks with Y(X) below what Y has been so far follow at once: an avalanche. F is linear in X between
breaks, so nothing is approximate.
"""

from typing import Any, NamedTuple

import numpy as np

from eqsim.engine.contacts import Contacts
from eqsim.engine.lanes import draw_birth
from eqsim.laws.stiffness import kappa
from eqsim.numerics.compiled import kernel, routine
from eqsim.numerics.streams import Key
from eqsim.numerics.tables import Array

# what is carried along, per contact: X, F, stiffness of all contacts, Y; where the avalanche that goes on has begun, at
# how much force, and how many breaks it has; breaks so far; and energies: work of the stage, and what broken contacts
# and slips have taken
X, FORCE, STIFFNESS, Y, _BEGUN, _BEFORE, _SIZE, BREAKS, WORK, LOST, SLIPPED = range(11)


class Queue(NamedTuple):
    """Where contacts break next, a heap: positions and which contact, arrays (contacts,)."""

    at: Array
    contact: Array


class Way(NamedTuple):
    """Where the stage goes: the stiffness of its spring, how far, and a flag (1,) that ends it early once it is set."""

    stiffness: float
    until: float
    stop: Array


def queue_of(xi: Array, stretch: Array) -> Queue:
    """Of contacts that are all pinned, of thresholds `xi` and signed stretches, the slider at 0."""
    at = xi - stretch
    order = np.argsort(at, kind="stable")
    return Queue(at[order], order.astype(np.int64))


@routine
def put_back(queue: Queue, at: float) -> None:
    """Give the contact that is next another position, and restore the order."""
    contact, i, n = queue.contact[0], 0, queue.at.size
    while True:
        child = 2 * i + 1
        if child >= n:
            break
        if child + 1 < n and queue.at[child + 1] < queue.at[child]:
            child += 1
        if queue.at[child] >= at:
            break
        queue.at[i], queue.contact[i] = queue.at[child], queue.contact[child]
        i = child
    queue.at[i], queue.contact[i] = at, contact


@routine
def _move(now: Array, x: float) -> None:
    """The slider to x, without a break on the way."""
    now[FORCE] += now[STIFFNESS] * (x - now[X])
    now[X] = x


@routine
def _rest(now: Array, stiffness: float) -> float:
    """Where the slider is in balance if no contact breaks before."""
    return now[X] + (stiffness * (now[Y] - now[X]) - now[FORCE]) / (stiffness + now[STIFFNESS])


@routine
def longer(events: Array) -> Array:
    """A copy with twice as many rows."""
    more = np.empty((2 * events.shape[0], events.shape[1]))
    for i in range(events.shape[0]):
        for k in range(events.shape[1]):
            more[i, k] = events[i, k]
    return more


@routine
def _slip(now: Array, stiffness: float, x: float) -> None:
    """The slider to x while the stage stands still, and the energy that this sets free."""
    x0, f0 = now[X], now[FORCE]
    _move(now, x)
    now[SLIPPED] += (stiffness * (now[Y] - 0.5 * (x0 + x)) - 0.5 * (f0 + now[FORCE])) * (x - x0)


@routine
def _break(c: Contacts, stream: Key, first: int, p: Any, queue: Queue, now: Array) -> None:
    """The next contact breaks, and is pinned again."""
    i, each = queue.contact[0], 1.0 / queue.at.size
    xi = p.xi[i]
    k = kappa(c.springs, xi)
    now[FORCE] -= k * xi * each
    now[LOST] += 0.5 * k * xi * xi * each
    p.xi[i], y, _ = draw_birth(c.newborn, c, stream, first + i, p.lives[i])
    stiffness = kappa(c.springs, p.xi[i])
    p.lives[i] += 1
    now[FORCE] += stiffness * y * each
    now[LOST] -= 0.5 * stiffness * y * y * each
    now[STIFFNESS] += (stiffness - k) * each
    now[_SIZE] += 1.0
    now[BREAKS] += 1.0
    put_back(queue, queue.at[0] + p.xi[i] - y)


@kernel
def load(c: Contacts, stream: Key, first: int, p: Any, queue: Queue, now: Array, way: Way) -> Array:
    """Take the stage along its way, and `now` (11,) with it. Returns the avalanches that have ended on the way, of each
    Y, X at its first break, breaks, drop of the force and displacement, shape (avalanches, 5)."""
    rows, events, stiffness, until = 0, np.empty((64, 5)), way.stiffness, way.until
    while way.stop[0] == 0:
        at = queue.at[0]
        needed = at + (now[FORCE] + now[STIFFNESS] * (at - now[X])) / stiffness
        if needed <= now[Y]:
            _slip(now, stiffness, at)
        else:
            rest = now[X] + (stiffness * (now[Y] - now[X]) - now[FORCE]) / (stiffness + now[STIFFNESS])
            if now[_SIZE] > 0.0:
                _slip(now, stiffness, rest)
                if rows == events.shape[0]:
                    events = longer(events)
                events[rows, 0], events[rows, 1], events[rows, 2] = now[Y], now[_BEGUN], now[_SIZE]
                events[rows, 3], events[rows, 4] = now[_BEFORE] - now[FORCE], now[X] - now[_BEGUN]
                rows += 1
                now[_SIZE] = 0.0
            elif rest > now[X]:  # at the start the spring may be stretched more than contacts hold
                _slip(now, stiffness, rest)
            target, force = min(needed, until), now[FORCE]
            _move(now, now[X] + (target - now[Y]) * stiffness / (stiffness + now[STIFFNESS]))
            now[WORK] += 0.5 * (force + now[FORCE]) * (target - now[Y])
            now[Y] = target
            if needed > until:
                return events[:rows]
            _move(now, at)
            now[_BEGUN], now[_BEFORE] = at, now[FORCE]
        _break(c, stream, first, p, queue, now)
    return events[:rows]
