"""Every break of the contacts of a run, one by one: of small ensembles, as their number is that of lives."""

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from eqsim.engine.contacts import Contacts, contacts
from eqsim.engine.lanes import LANES, ROUNDS, complete, draw_lives, empty_lanes, empty_lives
from eqsim.engine.simulate import draw_delays
from eqsim.engine.steady import settled
from eqsim.engine.trajectory import check_run
from eqsim.errors import InputError
from eqsim.model.drive import Drive, require_drive
from eqsim.model.ensemble import Ensemble
from eqsim.numerics.compiled import kernel
from eqsim.numerics.streams import TRAJECTORY, Key, key
from eqsim.numerics.tables import Array
from eqsim.numerics.threads import ThreadPool
from eqsim.results import Drawn, Result

_BLOCK = 4 * LANES  # contacts whose breaks are noted together, whoever does it
_MARGIN = 1.5  # room for breaks, over their predicted number; with more a block is done again
MOST_BREAKS = 20_000_000  # 0.8 GB


@dataclass(frozen=True, repr=False)
class Breaks(Result):
    """Breaks of contacts along a drive in the order of the displacement, arrays of shape (breaks,).

    Attributes
    ----------
    replica, contact : ndarray of int
        Which of the independent ensembles, and which of its contacts.
    t, X : ndarray
        Time and displacement of the slider (length) at which it breaks.
    stretch, travel : ndarray
        Its stretch there, and how far the slider has moved since it was born (lengths).
    stiffness : ndarray
        k_i/k of the contact at birth.
    """

    drawn: ClassVar[Drawn] = Drawn("X", "stretch", "", "displacement  X", "stretch at breaking", dots=True)
    replica: Array
    contact: Array
    t: Array
    X: Array
    stretch: Array
    travel: Array
    stiffness: Array


def breaks(ensemble: Ensemble, drive: Drive, *, seed: int = 1, replicas: int = 1, threads: int = 1) -> Breaks:
    """The breaks of the contacts that `trajectory` follows with the same seed, from a fresh start.

    Parameters
    ----------
    ensemble : Ensemble
    drive : Drive
        Constant velocity over a distance.
    seed : int
        Of the random numbers; the result depends on nothing else.
    replicas : int
        Independent ensembles.
    threads : int
        Changes speed only.

    Returns
    -------
    Breaks

    Raises
    ------
    InputError
        For a drive that is not constant or not from a fresh start, for thresholds that fluctuate, and for more than 2e7
        breaks.
    """
    expected = check_breaks(ensemble, drive, seed, replicas)
    c = contacts(ensemble, drive.velocity, settled(ensemble, drive, seed, threads))
    unit, count = ensemble.thresholds.scale, ensemble.count * replicas
    distance, stream, each = drive.over(ensemble) / unit, key(seed, TRAJECTORY), expected / count

    def block(first: int) -> Array:
        last = min(first + _BLOCK, count)
        size = int(_MARGIN * each * (last - first)) + 100
        while True:
            rows = np.empty((size, 5))
            size = note_breaks(c, distance, stream, first, last, rows)
            if size <= len(rows):
                return rows[:size]

    with ThreadPool(max(1, threads)) as pool:
        found = np.concatenate(list(pool.map(block, range(0, count, _BLOCK))))
    contact = found[:, 0].astype(np.int64)
    found = found[order := np.lexsort((contact, found[:, 1]))]
    replica, contact = np.divmod(contact[order], ensemble.count)
    X = found[:, 1] * unit
    return Breaks(replica, contact, X / drive.velocity, X, found[:, 2] * unit, found[:, 3] * unit, found[:, 4])


def check_breaks(ensemble: Ensemble, drive: Drive, seed: int, replicas: int) -> float:
    """About how many breaks there are. Raises InputError if they cannot be listed."""
    require_drive(drive)
    if drive.start != "fresh":
        raise InputError(f'drive.start = "{drive.start}": breaks are listed from a fresh start only')
    if ensemble.fluctuates:
        raise InputError(f'aging.rule = "{ensemble.aging.rule}": breaks are not listed of thresholds that fluctuate')
    expected = check_run(ensemble, drive, 2, seed, replicas, math.inf)
    if expected > MOST_BREAKS:
        raise InputError(f"breaks: there are about {expected:.3g}; at most {MOST_BREAKS:.0e} are listed")
    return expected


@kernel
def note_breaks(c: Contacts, distance: float, stream: Key, first: int, last: int, found: Array) -> int:
    """Contact, displacement, stretch, travel and stiffness of the breaks within the distance of contacts first <= i <
    last, in rows of `found`, shape (rows, 5). How many there are; those for which there is no row are lost."""
    lanes, lives = empty_lanes(), empty_lives(c, ROUNDS)
    position, delay = np.zeros(LANES), np.full((ROUNDS, LANES), c.delay.mean)
    count = 0
    for begin in range(first, last, LANES):
        for i in range(LANES):
            lanes.contact[i], lanes.age[i], position[i] = begin + i, 0, 0.0 if begin + i < last else math.inf
        going = True
        while going:
            draw_lives(c.newborn, c, stream, lanes, lives, LANES)
            if c.delay.random > 0.0:
                draw_delays(c.delay, stream, lanes, delay, LANES)
            complete(c.aging, c, stream, lanes, lives, LANES)
            going = False
            for i in range(LANES):
                for r in range(ROUNDS):
                    broke = position[i] + lives.stretch[r, i]
                    if broke <= distance:
                        if count < found.shape[0]:
                            found[count, 0], found[count, 1] = lanes.contact[i], broke
                            found[count, 2] = lives.birth[r, i] + lives.stretch[r, i]
                            found[count, 3], found[count, 4] = lives.stretch[r, i], lives.stiffness[r, i]
                        count += 1
                    position[i] = broke + delay[r, i]
                going = going or position[i] <= distance
                lanes.age[i] += 1
    return count
