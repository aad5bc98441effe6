"""Breaks one after another, and their avalanches, behind a stage that pulls infinitely
slowly at T = 0, or under a force that is raised so.

Without heat, damping and mass the slider is always in balance, kappa (Y - X) =
F(X), or slips until it is. A contact breaks where X reaches X_birth + xi - y, with y
its stretch at birth, and is pinned again at once, or never; the stage has to be at

    Y(X) = X + F(X)/kappa

for that. All breaks with Y(X) below the largest Y so far follow at once: an avalanche.
F is linear in X between breaks, so nothing is approximate. Under a force f instead of a
stage f = F(X) takes the place of Y(X), and the last avalanche leaves nothing behind.
"""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from eqsim.engine.contacts import Contacts
from eqsim.engine.lanes import draw_birth
from eqsim.laws.stiffness import kappa
from eqsim.numerics.compiled import kernel, routine
from eqsim.numerics.streams import Key
from eqsim.numerics.tables import Array

_ROOM = 8192  # avalanches per call of a kernel, so many that calls cost nothing

# Slider and stage; forces and energies are divided by the number of contacts.
STATE = np.dtype(
    [
        ("X", np.float64),  # displacement of the slider
        ("Y", np.float64),  # displacement of the stage, or the force
        ("force", np.float64),
        ("stiffness", np.float64),  # of all contacts
        ("X_begun", np.float64),  # X where the avalanche that goes on has begun
        ("force_begun", np.float64),  # force there
        ("size", np.int64),  # its breaks so far; 0 if none goes on
        ("breaks", np.int64),  # so far
        ("work", np.float64),  # of the stage or the force
        ("lost", np.float64),  # energy lost by breaks
        ("slipped", np.float64),  # energy set free by slips
    ]
)

# An avalanche.
EVENT = np.dtype(
    [
        ("Y", np.float64),  # of the stage, or the force
        ("X", np.float64),  # of the slider at the first break
        ("breaks", np.int64),
        ("drop", np.float64),  # of the force
        ("distance", np.float64),  # by which the slider moves
    ]
)


class Queue(NamedTuple):
    """Contacts, arrays (contacts,), and a heap of where they break next."""

    laws: Contacts
    key: Key  # of their random numbers
    first: int  # number of the first contact
    position: Array  # where a contact breaks, in the order of a heap
    contact: Array  # which one
    threshold: Array  # of each contact
    lives: Array  # of each contact that have been drawn


class Way(NamedTuple):
    """Motion of the stage, or rise of the force."""

    stiffness: float  # of its spring; 0 without one
    until: float  # displacement at its end
    stop: Array  # a flag (1,): anything but 0 ends the kernel


def queue_of(laws: Contacts, key: Key, first: int, population: Array) -> Queue:
    """Queue of contacts (`slider.CONTACT`), all pinned, with the slider at 0."""
    position = population["threshold"] - population["stretch"]
    order = np.argsort(position, kind="stable")
    threshold, lives = population["threshold"].copy(), population["lives"].copy()
    return Queue(laws, key, first, position[order], order, threshold, lives)


def events_of(
    dtype: np.dtype[Any], kernel: Callable[..., tuple[int, bool]], *arguments: Any
) -> Array:
    """Join the events that `kernel(*arguments, events)` finds. The kernel fills an
    array, and returns the number of events and whether it has come to its end. Else the
    array is full, and the kernel is called again."""
    events = np.empty(_ROOM, dtype)
    found = []
    done = False
    while not done:
        count, done = kernel(*arguments, events)
        found.append(events[:count].copy())
    return np.concatenate(found)


@routine
def put_back(heap: Array, contacts: Array, position: float, at: int = 0) -> None:
    """Give the contact at a place of the heap, by default the one that is next, a later
    position, and restore the heap's order. `heap` holds positions and `contacts` which
    contact each belongs to."""
    contact = contacts[at]
    n = heap.size
    i = at
    while True:
        child = 2 * i + 1
        if child >= n:
            break
        if child + 1 < n and heap[child + 1] < heap[child]:
            child += 1
        if heap[child] >= position:
            break
        heap[i] = heap[child]
        contacts[i] = contacts[child]
        i = child
    heap[i] = position
    contacts[i] = contact


@routine
def _move(now: Any, x: float) -> None:
    """Move the slider to x, without a break on the way."""
    now.force += now.stiffness * (x - now.X)
    now.X = x


@routine
def _slip(now: Any, stiffness: float, x: float) -> None:
    """Move the slider to x while the stage stands still, and note the energy lost."""
    x0 = now.X
    force = now.force
    _move(now, x)
    spring = stiffness * (now.Y - 0.5 * (x0 + x))
    if stiffness == 0.0:
        spring = now.Y
        now.work += spring * (x - x0)
    now.slipped += (spring - 0.5 * (force + now.force)) * (x - x0)


@routine
def _break(queue: Queue, now: Any) -> None:
    """Break the next contact, and pin it again unless its delay is infinite."""
    laws, i = queue.laws, queue.contact[0]
    each = 1.0 / queue.threshold.size
    xi = queue.threshold[i]
    stiffness = kappa(laws.springs, xi)
    now.force -= stiffness * xi * each
    now.lost += 0.5 * stiffness * xi * xi * each
    now.size += 1
    now.breaks += 1
    if laws.delay.mean == math.inf:
        now.stiffness -= stiffness * each
        put_back(queue.position, queue.contact, math.inf)
        if queue.position[0] == math.inf:  # else rounding is left
            now.force = 0.0
            now.stiffness = 0.0
        return
    number = queue.first + i
    born, y, _ = draw_birth(laws.newborn, laws, queue.key, number, queue.lives[i])
    queue.threshold[i] = born
    queue.lives[i] += 1
    stiffness_born = kappa(laws.springs, born)
    now.force += stiffness_born * y * each
    now.lost -= 0.5 * stiffness_born * y * y * each
    now.stiffness += (stiffness_born - stiffness) * each
    put_back(queue.position, queue.contact, queue.position[0] + born - y)


@kernel
def load(queue: Queue, state: Array, way: Way, events: Array) -> tuple[int, bool]:
    """Move the stage along its way, and note the avalanches that end (`EVENT`); `state`
    (1,) is a `STATE`. Returns the number of avalanches, and False if there are more
    than `events` has room for."""
    now = state[0]
    rows = 0
    sprung = way.stiffness > 0.0
    lever = way.stiffness if sprung else 1.0  # force per load
    while way.stop[0] == 0:
        next_break = queue.position[0]
        needed = math.inf
        if next_break < math.inf:
            force = now.force + now.stiffness * (next_break - now.X)
            needed = next_break + force / lever if sprung else force
        if needed <= now.Y:
            _slip(now, way.stiffness, next_break)
        else:
            let_go = not sprung and next_break == math.inf
            net = (lever * (now.Y - now.X) if sprung else now.Y) - now.force
            rest = now.X
            if not let_go:
                rest += net / (way.stiffness + now.stiffness)
            if now.size > 0:
                if rows == events.size:
                    return rows, False
                _slip(now, way.stiffness, rest)
                event = events[rows]
                event.Y = now.Y
                event.X = now.X_begun
                event.breaks = now.size
                event.drop = now.force_begun - now.force
                event.distance = now.X - now.X_begun
                rows += 1
                now.size = 0
            elif rest > now.X:  # the spring begins with more force than contacts hold
                _slip(now, way.stiffness, rest)
            if let_go:
                break
            target = min(needed, way.until)
            force = now.force
            moved = (target - now.Y) * lever / (way.stiffness + now.stiffness)
            _move(now, now.X + moved)
            way_of_load = target - now.Y if sprung else moved
            now.work += 0.5 * (force + now.force) * way_of_load
            now.Y = target
            if needed > way.until:
                break
            _move(now, next_break)
            now.X_begun = next_break
            now.force_begun = now.force
        _break(queue, now)
    return rows, True
