"""Follow contacts along a segment at constant velocity, LANES at a time.

A recorder, a NamedTuple by whose type kernels are compiled, takes their lives:
`recorder` adds up forces on a grid, `breaks` lists breaks, `randomise` sums plain
lives. It has the fields `carries`, True if `follow` finds travels before it calls
`note_lives`, and `stop`, a flag (1,) of which anything but 0 ends the kernel. It has
bodies of `note_lives`, of `admit` unless its contacts begin alike, and of `move_lane`
if it keeps something for each lane.
"""

from typing import Any

import numpy as np

from eqsim.engine.contacts import Contacts
from eqsim.engine.lanes import (
    LANES,
    ROUNDS,
    Lanes,
    Lives,
    carry_lives,
    draw_lives,
    padded,
)
from eqsim.numerics.compiled import by_law, kernel


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
        if recorder.carries:
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
