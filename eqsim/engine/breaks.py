"""List every break of the contacts of a run. Meant for small ensembles: there are as
many breaks as lives."""

import math
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np

from eqsim.engine.contacts import Contacts, contacts
from eqsim.engine.lanes import LANES, Lanes, Lives, follow, idle_lanes, note_lives
from eqsim.engine.steady import settled
from eqsim.engine.trajectory import check_run
from eqsim.errors import InputError
from eqsim.model.drive import Drive, Output, require_drive
from eqsim.model.ensemble import Ensemble
from eqsim.numerics.streams import TRAJECTORY
from eqsim.numerics.streams import key as key_of
from eqsim.numerics.tables import Array
from eqsim.numerics.threads import ThreadPool, current_stop
from eqsim.results import Drawn, Result

_BREAKS_BLOCK = 4 * LANES  # contacts whose breaks are listed by one kernel call
# room for breaks, over their predicted number; a block with more is repeated
_MARGIN = 1.5
MOST_BREAKS = 20_000_000  # 0.8 GB


@dataclass(frozen=True, repr=False)
class Breaks(Result):
    """Breaks of contacts along a drive in the order of the displacement, arrays of
    shape (breaks,).

    Attributes
    ----------
    replica, contact : ndarray of int
        Number of the independent ensemble, and of the contact in it.
    t, X : ndarray
        Time and displacement of the slider (length) at which it breaks.
    stretch, travel : ndarray
        Its stretch there, and how far the slider has moved since it was born (lengths).
    stiffness : ndarray
        k_i/k of the contact at birth.
    """

    drawn: ClassVar[Drawn] = Drawn(
        "X", "stretch", "", "displacement  X", "stretch at breaking", dots=True
    )
    replica: Array
    contact: Array
    t: Array
    X: Array
    stretch: Array
    travel: Array
    stiffness: Array


def breaks(
    ensemble: Ensemble,
    drive: Drive,
    *,
    seed: int = 1,
    replicas: int = 1,
    threads: int = 1,
) -> Breaks:
    """List the breaks of the contacts that `trajectory` follows with the same seed, one
    by one. Lengths and times are in the units of the arguments.

    Parameters
    ----------
    ensemble : Ensemble
    drive : Drive
        Constant velocity (length/time) over a distance, from a fresh start; neither a
        programme nor a stage nor blocks.
    seed : int
        Seed of the random numbers; threads and blocks change nothing.
    replicas : int
        Number of independent ensembles.
    threads : int
        Changes speed only.

    Returns
    -------
    Breaks

    Raises
    ------
    InputError
        For a drive that is not constant or not from a fresh start, for thresholds that
        fluctuate, and for more than 2e7 breaks.

    Examples
    --------
    >>> from eqsim import Drive, Ensemble, breaks
    >>> found = breaks(Ensemble(count=100), Drive(0.1, distance=5.0))
    >>> bool(found.X[0] <= found.X[-1] <= 5.0)  # in the order of the displacement
    True
    """
    expected = check_breaks(ensemble, drive, Output(2, seed, replicas))
    c = contacts(ensemble, drive.velocity, settled(ensemble, drive, seed, threads))
    unit, count = ensemble.thresholds.scale, ensemble.count * replicas
    distance, key = drive.over(ensemble) / unit, key_of(seed, TRAJECTORY)
    each = expected / count

    def block(first: int) -> Array:
        last = min(first + _BREAKS_BLOCK, count)
        size = int(_MARGIN * each * (last - first)) + 100
        while True:
            rows, number = np.empty(size, BREAK), np.zeros(1, np.int64)
            listed = BreakList(distance, rows, number, current_stop())
            follow(c, listed, first, last, *idle_lanes(c, key))
            size = int(listed.number[0])
            if size <= listed.rows.size:
                return listed.rows[:size]

    with ThreadPool(max(1, threads)) as pool:
        rows = np.concatenate(list(pool.map(block, range(0, count, _BREAKS_BLOCK))))
    rows = rows[np.lexsort((rows["contact"], rows["X"]))]
    replica, contact = np.divmod(rows["contact"], ensemble.count)
    X, stretch, travel = (rows[name] * unit for name in ("X", "stretch", "travel"))
    t, stiffness = X / drive.velocity, rows["stiffness"].copy()
    return Breaks(replica, contact, t, X, stretch, travel, stiffness)


def check_breaks(ensemble: Ensemble, drive: Drive, output: Output) -> float:
    """Predict the number of breaks. Raises InputError if they cannot be listed."""
    require_drive(drive)
    if drive.start != "fresh":
        raise InputError(
            f'drive.start = "{drive.start}": breaks are listed from a fresh start only'
        )
    if ensemble.populations:
        raise InputError("population: breaks are listed of contacts of one kind only")
    if ensemble.fluctuates:
        raise InputError(
            f'aging.rule = "{ensemble.aging.rule}": breaks are not listed of '
            "thresholds that fluctuate"
        )
    expected = check_run(ensemble, drive, output, math.inf)
    if expected > MOST_BREAKS:
        raise InputError(
            f"breaks: there are about {expected:.3g}; "
            f"at most {MOST_BREAKS:.0e} are listed"
        )
    return expected


_LENGTHS = [(name, float) for name in ("X", "stretch", "travel", "stiffness")]
BREAK = np.dtype([("contact", np.int64), *_LENGTHS])


class BreakList(NamedTuple):
    """A recorder of `engine.lanes` that lists the breaks within a distance: an array
    of BREAK, shape (rows,), and how many there are, shape (1,); those for which there
    is no row are lost."""

    distance: float
    rows: Array
    number: Array
    stop: Array
    begin: int = 0


@note_lives.register(BreakList)
def _note_lives(
    recorder: BreakList, c: Contacts, lanes: Lanes, lives: Lives, r: int, active: int
) -> bool:
    ended, position = False, lanes.position
    for i in range(active):
        broke = position[i] + lives.travel[r, i]
        if broke <= recorder.distance:
            if recorder.number[0] < recorder.rows.size:
                row = recorder.rows[recorder.number[0]]
                row.contact = lanes.contact[i]
                row.X = broke
                row.stretch = lives.birth[r, i] + lives.travel[r, i]
                row.travel = lives.travel[r, i]
                row.stiffness = lives.stiffness[r, i]
            recorder.number[0] += 1
        position[i] = broke + lives.delay[r, i]
        if position[i] > recorder.distance:
            position[i] = math.inf
            ended = True
    return ended
