"""Sums over lives of contacts, as steady estimates draw them: by randomised quasi-Monte
Carlo from the densities of a proposal, or plainly as they are born.

A life needs two uniforms, threshold and clock, and a third for its birth unless
contacts are born unstressed or all at the same stretch. Each randomisation has a
scrambled Sobol sequence of its own.
"""

from collections.abc import Callable, Iterator
from concurrent.futures import CancelledError
from contextlib import nullcontext
from itertools import repeat
from typing import NamedTuple

import numpy as np

from eqsim.engine.contacts import Contacts
from eqsim.engine.lanes import (
    LANES,
    ROUNDS,
    Lanes,
    Lives,
    follow,
    idle_lanes,
    life_work,
    note_lives,
)
from eqsim.engine.proposal import RANDOMISATIONS, Proposal, births_vary
from eqsim.engine.sample import Sample, Source, lives, square_of
from eqsim.laws.delay import Waits
from eqsim.model.ensemble import Ensemble
from eqsim.numerics.compiled import kernel
from eqsim.numerics.sobol import Sobol
from eqsim.numerics.streams import STEADY, Key, generator
from eqsim.numerics.streams import key as key_of
from eqsim.numerics.tables import Array
from eqsim.numerics.threads import ThreadPool, current_stop

_LIVES_AT_A_TIME = 2**15
_BEGUN = 8  # Sobol sequences that begin at a time, at least


class SteadyJob(NamedTuple):
    """Parameters of a steady estimate that stay while it is refined."""

    ensemble: Ensemble
    velocity: float
    proposal: Proposal | None  # None: plain births
    identity: int
    seed: int
    threads: int
    progress: Callable[[int, int], None] | None
    step: float  # accuracy of the steps of `langevin` thresholds


def randomise(job: SteadyJob, c: Contacts, size: int) -> Array:
    """Average over lives in each randomisation, shape (RANDOMISATIONS, 6): elastic work
    per k, travel, square of the force added up over the travel, and stretch at birth;
    then the largest single share of the first two, and of the third."""
    key = key_of(job.seed, STEADY + job.identity)
    together = 1
    sequences: Iterator[Sobol | None] = repeat(None)
    if job.proposal:
        each = -(-RANDOMISATIONS // job.threads)
        together = min(max(1, _LIVES_AT_A_TIME // size), each)
    firsts = range(0, RANDOMISATIONS, together)
    groups = [range(i, min(i + together, RANDOMISATIONS)) for i in firsts]

    def averaged(group: range, sobol: Sobol | None) -> Array:
        if job.proposal is None or sobol is None:
            return _plainly(c, key, group.start, size, stop)
        source = Source(key, group.start * size, job.step)
        return _weighted(job.proposal, c, source, sobol, size, stop)

    if job.proposal:
        sequences = _sequences(job, 2 + births_vary(c), size, groups)
    rows: list[Array] = []
    report = job.progress or (lambda *_: None)
    report(0, RANDOMISATIONS * size)
    # blocks of weighted lives are so short that Ctrl-C can wait for them, unless lives
    # are paths of many steps
    alone = job.threads == 1 and job.proposal is not None and not c.aging.fluctuates
    with nullcontext() if alone else ThreadPool(job.threads) as pool:
        stop = pool.stop if pool else current_stop()
        for found in (pool.map if pool else map)(averaged, groups, sequences):
            rows.extend(found)
            report(len(rows) * size, RANDOMISATIONS * size)
    return np.array(rows)


def _plainly(c: Contacts, key: Key, index: int, size: int, stop: Array) -> Array:
    """A row of `randomise` from `size` independent lives; each row has contacts of its
    own."""
    rounds = size // (ROUNDS * LANES)  # an attempt of another size takes other rounds
    sums = PlainSums.empty(index * LANES, rounds, 2 * rounds, stop)
    without = c._replace(delay=Waits(c.delay.mean, 0.0))  # no sum depends on a delay
    lanes = idle_lanes(without, key)
    follow(without, sums, sums.first, sums.first + LANES, *lanes)
    # cumulative sums are added in order, without pairing: the same bits everywhere
    parts = sums.work, sums.travel, sums.square, sums.birth, sums.size
    *means, work = (np.cumsum(part)[-1] for part in parts)
    largest = max(sums.most_work.max() / work, sums.most_travel.max() / means[1])
    # no largest share of squares: `errorbars.unmet_squares` replaces it
    return np.array([[*(mean / size for mean in means), largest, 0.0]])


class PlainSums(NamedTuple):
    """A recorder of `engine.lanes` that adds up plainly drawn lives: those of the
    LANES contacts from `first` on, from the age `begin` up to `end`, ROUNDS lives each
    time. Sums and largest values are those of each lane, arrays (LANES,): a single sum
    would have to wait for every addition. They are work over k, travel, square of the
    force along it, stretch at birth and |work|, and the largest |work| and travel."""

    first: int
    begin: int
    end: int
    stop: Array
    work: Array
    travel: Array
    square: Array
    birth: Array
    size: Array
    most_work: Array
    most_travel: Array

    @classmethod
    def empty(cls, first: int, begin: int, end: int, stop: Array) -> "PlainSums":
        """Empty sums."""
        return cls(first, begin, end, stop, *np.zeros((7, LANES)))


@note_lives.register(PlainSums)
def _note_lives(
    recorder: PlainSums, c: Contacts, lanes: Lanes, lives: Lives, r: int, active: int
) -> bool:
    work, travel, square = recorder.work, recorder.travel, recorder.square
    birth, size = recorder.birth, recorder.size
    most_work, most_travel = recorder.most_work, recorder.most_travel
    for i in range(active):
        w, s = life_work(c.aging, c, lives, r, i), lives.travel[r, i]
        y, k = lives.birth[r, i], lives.stiffness[r, i]
        work[i] += w
        travel[i] += s
        square[i] += square_of(k, s, y)
        birth[i] += y
        size[i] += abs(w)
        most_work[i] = max(most_work[i], abs(w))
        most_travel[i] = max(most_travel[i], s)
    ended = r + 1 == ROUNDS and lanes.age[0] + 1 == recorder.end
    for i in range(active if ended else 0):
        lanes.position[i] = np.inf
    return ended


def _sequences(
    job: SteadyJob, dimensions: int, size: int, groups: list[range]
) -> Iterator[Sobol]:
    """Sobol sequences of each group of randomisations, of `size` points each. They
    begin a few at a time, which is faster than one by one, while threads work on the
    first."""
    at_once = -(-_BEGUN // len(groups[0]))
    for first in range(0, len(groups), at_once):
        begun = groups[first : first + at_once]
        begin, end = begun[0].start, begun[-1].stop
        names = ((job.seed, STEADY, job.identity, size, i) for i in range(begin, end))
        generators = [generator(*name) for name in names]
        sobol = Sobol.of(generators, dimensions, size)
        for group in begun:
            yield sobol.some(slice(group.start - begin, group.stop - begin))


def _weighted(
    proposal: Proposal,
    c: Contacts,
    source: Source,
    sobol: Sobol,
    size: int,
    stop: Array,
) -> Array:
    """Rows of `randomise` from weighted points of several Sobol sequences; `source` is
    that of the first one's contacts."""
    vary = births_vary(c)
    block = min(size, _LIVES_AT_A_TIME)
    sums = np.zeros((len(sobol.shift), 8))
    for first in range(0, size, block):
        if stop[0]:
            raise CancelledError
        points = sobol.points(first, block).reshape(2 + vary, -1)
        u, weight = proposal.threshold.draw(points[0])
        v, clock_weight = proposal.clock.draw(points[1])
        here = source._replace(first=source.first + first)
        found = lives(c, here, u, v, points[2] if vary else None)
        add_weighted(found, weight, clock_weight, sums)
    with np.errstate(invalid="ignore"):  # squares of broad laws overflow
        shares = sums[:, 5:] / sums[:, [4, 1, 2]]
    largest = shares[:, :2].max(axis=1)
    return np.column_stack((sums[:, :4] / size, largest, shares[:, 2]))


@kernel
def add_weighted(
    found: Sample, weight: Array, clock_weight: Array, sums: Array
) -> None:
    """Add to each row of `sums` those of its share of lives, one row after the other:
    work, travel, square, birth and |work|; the last three columns are the largest
    |work|, |travel| and square of a life."""
    count = weight.size // sums.shape[0]
    for row in range(sums.shape[0]):
        total = sums[row]
        # in registers: a sum in memory would have to wait for every addition
        work, travel, square, birth = total[0], total[1], total[2], total[3]
        size, most_work, most_travel = total[4], total[5], total[6]
        most_square = total[7]
        for i in range(row * count, (row + 1) * count):
            w, s, y = weight[i] * clock_weight[i], found.travel[i], found.birth[i]
            w_work, w_travel = w * found.work[i], w * s
            w_square = w * square_of(found.stiffness[i], s, y)
            work += w_work
            travel += w_travel
            square += w_square
            birth += w * y
            size += abs(w_work)
            most_work = max(most_work, abs(w_work))
            most_travel = max(most_travel, abs(w_travel))
            most_square = max(most_square, w_square)
        # one by one: to assign a tuple to a slice takes seconds to compile
        total[0], total[1], total[2], total[3] = work, travel, square, birth
        total[4], total[5] = size, most_work
        total[6], total[7] = most_travel, most_square
