"""Records of chains of blocks: fronts, events, and what is read off them."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import stats

from eqsim.engine.records import PulledRecord, mean_in_records, with_steps
from eqsim.estimate import Estimate
from eqsim.model.chain import Chain
from eqsim.numerics.tables import Array

_SHORTEST_FRONT = 5  # blocks, through which a speed is fitted
_SLOW = 0.1  # speed of a slow front, at most, over that of waves
ENOUGH_EVENTS = 5  # whose scatter tells the error of their mean


@dataclass(frozen=True, repr=False)
class ChainTrajectory(PulledRecord):
    """A record of a chain of blocks. X, force and pinned share are means over blocks
    and replicas, `spring` is the force of all springs that drive, over N k.

    Attributes are those of `PulledRecord`, and

    Attributes
    ----------
    chain : Chain
        The blocks.
    steps : tuple of int
        Steps of each replica.
    blocks : dict of ndarray
        Columns, with a row for each record of each block: `t`, `block`, displacement
        `X` (length), velocity `V` (length/time), `force` F_j/(n k) (length), `pinned`
        share of its contacts, `breaks` so far, and the `replica`.
    broke : dict of ndarray
        Columns, with a row for each block that broke in an event, when half of its
        contacts had broken: the number of the `event`, `block`, `t`, its `X` then
        (length), and the `replica`.
    events : dict of ndarray
        Columns: the number of the `event`, `t` when it began, `duration`, how many
        `blocks` broke, `peak`, the largest force of the springs that drive since the
        event before, and its `drop` (lengths; in a motion backwards the least force and
        its rise), the `energy` taken by breaks and dampers over N k (length squared),
        whether it `ended`, and the `replica`. An event goes on while a block moves more
        than twice as fast as the drive at its fastest, a stationary start included; at
        least one block breaks. It is a precursor unless all blocks do. One under way
        when the record ends is not in means over events.
    coarser_events : dict of ndarray
        Those of the same contacts in steps four times as long; a third of what these
        change is in the errors of means over events.
    fronts : dict of ndarray
        `fronts_of` the blocks that broke, with errors that include those of finite steps
        (`missing_steps`).
    """

    chain: Chain
    steps: tuple[int, ...]
    blocks: dict[str, Array]
    broke: dict[str, Array]
    events: dict[str, Array]
    coarser_events: dict[str, Array]
    fronts: dict[str, Array]

    def in_space(self, name: str, replica: int = 0) -> Array:
        """A column of `blocks` of a replica, shape (points, blocks)."""
        size = self.t.size * self.chain.count
        rows = self.blocks[name][replica * size : (replica + 1) * size]
        return np.asarray(rows.reshape(self.t.size, self.chain.count))

    def _mean(
        self, name: str, of: Callable[[Array], Array], *, whole: bool = True
    ) -> Estimate:
        """Mean of the values `of` a column of the events of each replica that ended and
        in which all blocks broke, or did not, with the error of finite steps."""
        replicas = range(len(self.steps))

        def mean(events: dict[str, Array]) -> Estimate:
            asked = (events["blocks"] == self.chain.count) == whole
            asked &= events["ended"]
            columns = (events[name][asked & (events["replica"] == i)] for i in replicas)
            return mean_in_records([of(column) for column in columns])

        return with_steps(mean(self.events), mean(self.coarser_events))

    @cached_property
    def static_friction(self) -> Estimate:
        """Largest force of the springs, forwards or backwards, before events in which
        all blocks break, over N k (length), without the first of each replica, which
        depends on the start."""
        return self._mean("peak", lambda peak: np.abs(peak[1:]))

    @cached_property
    def recurrence(self) -> Estimate:
        """Time from one event in which all blocks break to the next, without the first
        of each replica."""
        return self._mean("t", lambda t: np.diff(t[1:]))

    @cached_property
    def drop(self) -> Estimate:
        """Drop of the force of the springs in events in which all blocks break, over
        N k (length), without the first of each replica."""
        return self._mean("drop", lambda drop: drop[1:])

    @cached_property
    def precursors(self) -> Estimate:
        """Share of the blocks that break in an event which does not break all, in the
        mean."""
        return self._mean(
            "blocks", lambda blocks: blocks / self.chain.count, whole=False
        )

    @cached_property
    def front_speed(self) -> Estimate:
        """Speed of fronts (blocks/time), the mean weighted by their lengths."""
        speed, blocks = self.fronts["speed"], self.fronts["blocks"]
        if not speed.size:
            return Estimate(None, None, 0, reliable=False)
        value = float(np.average(speed, weights=blocks))
        square = float(np.average((speed - value) ** 2, weights=blocks))
        each = float(np.average(self.fronts["speed_stderr"], weights=blocks))
        share = float(np.sum(blocks**2)) / float(blocks.sum()) ** 2  # 1/n of equal ones
        scatter = square * share / (1.0 - share) if speed.size > 1 else square
        error = math.hypot(math.sqrt(scatter), each)
        return Estimate(value, error, speed.size, reliable=speed.size >= ENOUGH_EVENTS)

    @cached_property
    def gini(self) -> float:
        """Gini coefficient of slip: of the displacements of blocks between records, of
        all replicas, 0 where all are equal, and near 1 where a few blocks slip at a few
        instants."""
        each = [self.in_space("X", i) for i in range(len(self.steps))]
        slip = np.abs(np.diff(each, axis=1)).ravel()
        total = slip.sum()
        rank = 2.0 * np.arange(1, slip.size + 1) - slip.size - 1.0
        return float(rank @ np.sort(slip) / (slip.size * total)) if total else 0.0

    @cached_property
    def roughness(self) -> Array:
        """Standard deviation of X between blocks at each instant, of all replicas
        (length), shape (points,)."""
        each = [self.in_space("X", i) for i in range(len(self.steps))]
        return np.sqrt(np.mean([X.var(axis=1) for X in each], axis=0))

    @cached_property
    def correlation_length(self) -> float:
        """Distance at which the correlation of X - <X> of two blocks has fallen to 1/e,
        over the second half of the records (blocks)."""
        X = np.concatenate(
            [self.in_space("X", i)[self.t.size // 2 :] for i in range(len(self.steps))]
        )
        X = X - X.mean(axis=1, keepdims=True)
        size = X.shape[1]
        lags = range(size // 2 + 1)
        found = np.array([np.mean(X[:, : size - r] * X[:, r:]) for r in lags])
        below = np.flatnonzero(found < found[0] / math.e)
        if not below.size or found[0] == 0.0:
            return math.inf if found[0] else 0.0
        i = int(below[0])
        share = (found[i - 1] - found[0] / math.e) / (found[i - 1] - found[i])
        return float(i - 1 + share)

    def kind_of(self, speed: float) -> str:
        """Name of a front of this speed (blocks/time) beside c = sqrt(K/M):
        "slow" below 0.1 c, "supersonic" above c, else "fast"; "overdamped" without a
        mass, or without springs between blocks."""
        if not (self.chain.mass and self.chain.coupling):
            return "overdamped"
        mach = speed / self.chain.wave_speed
        return "slow" if mach < _SLOW else "supersonic" if mach > 1.0 else "fast"

    def columns(self) -> dict[str, Array]:
        """The arrays by name, and the roughness."""
        return super().columns() | {"roughness": self.roughness}


# A front.
FRONT = np.dtype(
    [
        ("event", np.int64),
        ("t", float),
        *((name, np.int64) for name in ("block", "blocks", "direction")),
        ("speed", float),
        ("speed_stderr", float),
        ("replica", np.int64),
    ]
)


def fronts_of(broke: dict[str, Array], chain: Chain) -> dict[str, Array]:
    """Fit the speeds of fronts in a chain, by column.

    A front runs to the left or to the right of the block that breaks first in an event,
    through neighbours, at least 5; where all of a ring break, to the last. Its speed is
    that of the straight line through the times at which they break, its error that of
    the fit, as if these were off independently; where the slope is not above two of its
    errors, there is no front.

    Columns: `event`, `block` where it begins, `t` when the line leaves it, how many
    `blocks` it breaks, `direction` (1 or -1), `speed` and `speed_stderr` (blocks/time),
    and the `replica`.
    """
    rows, ring = [], chain.edges == "periodic"
    around = chain.count if ring else chain.count + 1  # -1 and B are no blocks
    names = np.stack((broke["replica"], broke["event"]))
    change = np.any(np.diff(names, axis=1) != 0, axis=0)
    for here in np.split(np.arange(change.size + 1), np.flatnonzero(change) + 1):
        if not broke["t"].size:
            break
        t = dict(
            zip(broke["block"][here].tolist(), broke["t"][here].tolist(), strict=True)
        )
        start = min(t, key=t.__getitem__)
        last = max(t, key=t.__getitem__) if ring and len(t) == chain.count else None
        for direction in (1, -1):
            run = [start]
            while run[-1] != last and (run[-1] + direction) % around in t:
                run.append((run[-1] + direction) % around)
            times = np.array([t[block] for block in run])
            if times.size < _SHORTEST_FRONT:
                continue
            line = stats.linregress(np.arange(times.size), times)
            if line.slope <= 2.0 * line.stderr:  # no motion that can be told
                continue
            speed = 1.0 / line.slope
            begin = float(line.intercept)
            where = int(broke["event"][here[0]]), begin, start, times.size, direction
            error = line.stderr * speed**2
            rows.append((*where, speed, error, int(broke["replica"][here[0]])))
    found = np.array(rows, FRONT)
    return {name: found[name].copy() for name in FRONT.names or ()}


def missing_steps(
    fronts: dict[str, Array], coarse: dict[str, Array]
) -> dict[str, Array]:
    """Fronts whose errors include that of finite steps: a third of what the mean speed
    changes in steps four times as long, which gave `coarse`, or a third of it where
    these have no front."""
    speed = fronts["speed"]
    if not speed.size:
        return fronts
    theirs = float(np.mean(coarse["speed"])) if coarse["speed"].size else 0.0
    missed = (theirs - float(np.mean(speed))) / 3.0
    return fronts | {"speed_stderr": np.hypot(fronts["speed_stderr"], missed)}
