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
from eqsim.engine.lanes import LANES, ROUNDS, Lanes, Lives, carry_lives, draw_lives
from eqsim.numerics.compiled import by_law, kernel
from eqsim.numerics.streams import Key

# lanes are used in such groups, so that no loop ends in a tail of single ones
_TOGETHER = 32


@by_law
def admit(
    recorder: Any, c: Contacts, key: Key, lanes: Lanes, lane: int, contact: int
) -> bool:
    """Put a contact into an idle lane: its number, how often lives of it were drawn,
    and where its next life begins. Whether there is one."""
    raise TypeError("no recorder")


@by_law
def note_lives(
    recorder: Any,
    c: Contacts,
    key: Key,
    lanes: Lanes,
    lives: Lives,
    r: int,
    active: int,
    full: int,
) -> bool:
    """Note the lives of round r of the `active` lanes and move these contacts to their
    next births; lanes from there to `full` are idle, and may be used. Whether any
    contact has come to its end, and has its next birth at infinity."""
    raise TypeError("no recorder")


@by_law
def move_lane(recorder: Any, source: int, target: int) -> None:
    """Move what is kept of a lane to another one."""


@kernel
def follow(
    c: Contacts,
    recorder: Any,
    key: Key,
    first: int,
    last: int,
    lanes: Lanes,
    lives: Lives,
) -> None:
    """Follow contacts first <= i < last to their ends; `lanes` are idle, and `lives`
    empty.

    Contacts begin together, so that they all write in one stretch of a grid, and new
    ones fill the lanes only when half of them have come to their ends.
    """
    contact, age, position = lanes.contact, lanes.age, lanes.position
    active, upcoming = (
        np.int64(0),
        np.int64(first),
    )  # typed: a literal 0 would be compiled for itself
    while True:
        if 2 * active <= LANES:
            while active < LANES and upcoming < last:
                if admit(recorder, c, key, lanes, active, upcoming):
                    active += 1
                upcoming += 1
        if active == 0 or recorder.stop[0] != 0:
            return
        full = min(LANES, (active + _TOGETHER - 1) // _TOGETHER * _TOGETHER)
        draw_lives(c.newborn, c, key, lanes, lives, full)
        if recorder.carries:
            carry_lives(c.newborn, c, lives, full)
        ended = False
        for r in range(ROUNDS):
            if note_lives(recorder, c, key, lanes, lives, r, active, full):
                ended = True
        for i in range(active):
            age[i] += 1
        for i in range(active - 1 if ended else -1, -1, -1):
            if position[i] == np.inf:
                active -= 1
                contact[i], age[i], position[i] = (
                    contact[active],
                    age[active],
                    position[active],
                )
                position[active] = np.inf
                move_lane(recorder, active, i)
