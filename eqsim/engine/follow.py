"""The one loop in which contacts are followed: along segments at constant velocity,
LANES at a time.

What becomes of their lives is a matter of a recorder, a NamedTuple by whose type
kernels are compiled: `recorder` adds up forces on a grid, `breaks` lists breaks,
`steady` sums plain lives. A recorder has the fields `carries`, whether where lives
break is found for all lanes together, and `stop`, of which anything but 0 ends the
kernel; and bodies of `admit`, `note_lives` and, if it keeps something for each lane,
`move_lane`.
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
    """Put a contact into an idle lane, unless it has come to its end. Fills its number,
    how often lives of it were drawn, and where its next one begins: that is
    `recorder.begin` times, and at 0, unless a recorder knows better."""
    lanes.contact[lane] = contact
    lanes.age[lane] = recorder.begin
    lanes.position[lane] = 0.0
    return True


@by_law
def note_lives(
    recorder: Any, c: Contacts, lanes: Lanes, lives: Lives, r: int, active: int
) -> bool:
    """Note the lives of round r of the `active` lanes. Moves these contacts to their
    next births. Lanes from there to `padded(active)` are idle, and may be used. Returns
    whether any contact has come to its end, and has its next birth at infinity."""
    raise TypeError("no recorder")


@by_law
def move_lane(recorder: Any, source: int, target: int) -> None:
    """Move what is kept of a lane to another one."""


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
