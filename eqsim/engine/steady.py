"""Steady averages by renewal-reward: contacts at constant velocity are independent
renewal processes, so averages over whole lives are averages over time (derived):

    friction = E[int_y^{x_b} (k_i/k) x dx] / (E[l] + v<tau>) + (eta v/k)(1 - pinned)
    pinned   = E[l] / (E[l] + v<tau>)                (eq:ncnf, for any law of the delay)
    travel   = E[l] = C[P, R],    break_stretch = E[x_b] = travel + E[y]                            (Gamma0)
    force_variance = E[int_y^{x_b} (k_i x/k)^2 dx] / (E[l] + v<tau>) + (eta v/k)^2 (1 -
    pinned) - friction^2

with y the stretch at birth and l = x_b - y the travel.

A life needs two uniforms, threshold and clock, and a third for its birth unless
contacts are born unstressed or all at the same stretch, so it is sampled by randomised
quasi-Monte Carlo: 32 independently scrambled Sobol sequences, whose scatter is the
error. Births are a poor sample where strong contacts are rare at birth but dominate
time, so both are drawn from densities proportional to births times the root mean square
of what a life contributes, found beforehand on a fixed grid, and weighted back: exact
for any such density, and of finite variance in the heavy-tailed regime where plain
averages over births never converge. The path of a `langevin` threshold is plain Monte
Carlo on top of these two, with steps so short that their error is at most a third of
the one asked for.

Annealed contacts that age are born with thresholds whose age is set by their own mean
pinned time C/v. Each randomisation finds its own fixed point C = E[x_b; C], to first
order from lives at two values of C near it, so that the errors quoted hold the error of
C.
"""

import dataclasses
import functools
import math
import time
from collections.abc import Callable, Iterator
from concurrent.futures import CancelledError
from contextlib import nullcontext
from dataclasses import dataclass
from itertools import repeat
from typing import NamedTuple

import numpy as np
from scipy import integrate, interpolate

from eqsim.engine.contacts import Contacts, contacts
from eqsim.engine.follow import admit, follow, note_lives
from eqsim.engine.lanes import LANES, ROUNDS, Lanes, Lives, idle_lanes, life_work
from eqsim.engine.langevin import STEP, step_error
from eqsim.engine.sample import Sample, Source, lives, rough_stretch, square_of
from eqsim.errors import InputError, require_number
from eqsim.estimate import Averages, Estimate, infinite, known
from eqsim.laws.aging.base import stiffness_varies
from eqsim.laws.barrier.pooled import Pooled
from eqsim.laws.delay import Waits
from eqsim.laws.newborn import DeltaBirths, Stretched
from eqsim.laws.threshold import Smooth
from eqsim.model.drive import Drive, require_drive
from eqsim.model.ensemble import Ensemble
from eqsim.model.reduced import bare, drag_of
from eqsim.numerics.compiled import kernel
from eqsim.numerics.sobol import Sobol
from eqsim.numerics.streams import STEADY, Key, key, name_of
from eqsim.numerics.tables import Array
from eqsim.numerics.threads import ThreadPool, current_stop
from eqsim.numerics.vector_math import exp, third

RANDOMISATIONS = 32
_FIRST, _BLOCK = (
    2**11,
    2**15,
)  # lives of a randomisation at the first attempt; lives handled at a time
_BEGUN = 8  # Sobol sequences that begin at a time, at least
_COARSE = 1e-2  # a relative error from which on half as many will do at first
_DECAY = 0.75  # assumed when lives are predicted: error ~ lives^-0.75, between Monte Carlo and smooth integrands
_NEGLIGIBLE = 1e-12
_NUDGE = 1e-2  # relative change of C that shows how births respond to it; the fixed point is linearised within 1e-4
_SETTLED = 3e-5  # relative error of the C that a trajectory's births are given
_POOLED_SMOOTH, _POOLED_STEPS = (
    2e-7,
    3e-5,
)  # relative error of averages over the tabulated inverse
_DOMINANT = 0.02  # a single life that makes up more of a sum than this has siblings that were not seen
_BROAD = 0.05  # a variance with a greater relative error has them, too: squares have heavier tails than the force
_UNMET = 4.0  # expected lives among all that are drawn, below which a sample may have met none
_UNSEEN_SQUARES = 7e-4  # share of the mean square that such lives make, from which on lives are drawn for it, too;
# gamma laws at T = 0 have up to 6e-4, which 32 randomisations show in their scatter

Progress = Callable[[int, int], None]


@dataclass(frozen=True, repr=False)
class Steady(Averages):
    """Steady averages as estimated.

    Attributes
    ----------
    friction, pinned, break_stretch, travel, birth_stretch, force_variance : Estimate
        As in `Averages`; no `force_variance` where the stiffness of a contact follows
        its aging threshold, and an infinite one where there is none
        (`Ensemble.divergence`).
    lives, seed, engine_seconds
        Lives of contacts that were simulated, and how.
    reached : bool
        Whether the requested error was.
    hidden : float
        What of the errors is no scatter: a bound on the relative error of means over
        lives.
    """

    lives: int
    seed: int
    engine_seconds: float
    reached: bool
    hidden: float


def steady(
    ensemble: Ensemble,
    drive: Drive,
    *,
    rel_error: float = 1e-3,
    seed: int = 1,
    threads: int = 1,
    max_lives: float = 1e10,
    progress: Progress | None = None,
    plain: bool = False,
) -> Steady:
    """Estimate steady averages by renewal-reward over whole lives of contacts.

    Parameters
    ----------
    ensemble : Ensemble
    drive : Drive
        Its velocity is all that matters.
    rel_error : float
        Relative standard error asked of all observables.
    seed : int
        Of the random numbers.
    threads : int
        Changes speed only.
    max_lives : float
        Work that would need more lives of contacts is refused before it starts.
    progress : callable, optional
        `progress(done, total)` is told about the lives of an attempt, each of which
        begins with done = 0.
    plain : bool
        Draw independent lives as they are born, without Sobol sequences and weights:
        slower, a check of the default, and unreliable where tails are heavy.

    Returns
    -------
    Steady

    Raises
    ------
    InputError
        For arguments out of range, and if more than `max_lives` lives would be needed.
    """
    require_drive(drive)
    velocity = drive.velocity
    require_number("rel_error", rel_error, above=0)
    require_number("max_lives", max_lives, above=0)
    rough = rough_stretch(ensemble, velocity)
    c = contacts(ensemble, velocity, rough)
    proposal = None if plain else _proposal(bare(ensemble), velocity, rough)
    divergence = ensemble.divergence
    # parameters enter the streams, so that the errors of many parameter sets at one
    # seed are independent; as they were declared, because a table's last bits are the
    # processor's
    identity = name_of(*ensemble.declared(velocity))
    step = STEP
    if c.aging.fluctuates and proposal:
        step *= min(1.0, math.sqrt(rel_error / (3.0 * step_error(c.aging))))
    job = _Job(ensemble, velocity, proposal, identity, seed, threads, progress, step)
    begin = time.perf_counter()
    drag, unit = drag_of(ensemble, velocity), ensemble.thresholds.scale
    tables = 1e-9
    if isinstance(c.barrier, Pooled):
        tables = _POOLED_STEPS if c.thresholds.steps.size else _POOLED_SMOOTH
    if c.aging.fluctuates:
        tables = step_error(c.aging, step)
    tables_of_squares = tables
    if isinstance(ensemble.thresholds, Smooth):
        tables = max(tables, ensemble.thresholds.drawn_to)
        if not divergence:
            tables_of_squares = max(
                tables,
                ensemble.thresholds.squares_drawn_to[ensemble.stiffness_law == "sqrt"],
            )
    response: Array | None = None
    # where half as many do, errors are a hundredth of what is asked; plain lives and
    # random paths have larger ones
    size, done = (
        _FIRST // 2
        if proposal and rel_error >= _COARSE and not c.aging.fluctuates
        else _FIRST,
        0,
    )
    while True:
        if RANDOMISATIONS * size > max_lives:
            raise InputError(
                f"this needs {RANDOMISATIONS * size:.3g} lives, more than max_lives = {max_lives:.3g}"
            )
        if rough is None:
            sums, lives_used = _randomise(job, c, size), RANDOMISATIONS * size
        else:
            sums, rough, response, lives_used = _self_consistent(
                job, rough, response, size
            )
        done += lives_used
        count = RANDOMISATIONS * size
        others = math.hypot(_unseen(c, proposal, count), _uneven(c, count))
        hidden = math.hypot(tables, others)
        # both lower the mean square, so that they add up
        lowered = tables_of_squares + (
            0.0 if divergence else _unmet(c, proposal, count)
        )
        of_squares = math.hypot(lowered, others)
        covered = proposal is None or proposal.covered
        result = _averages(
            c, sums, drag, unit, size, covered, Unseen(hidden, of_squares)
        )
        if divergence:
            result = (*result[:-1], infinite(count))
        error = _relative(result)
        excess = error / max(
            rel_error, 1.5 * tables
        )  # more lives do not improve a table
        # the next attempt aims at less than what was asked for, so that stopping hardly
        # selects lucky error bars
        aim, decay = (1.3, 0.5) if plain or c.aging.fluctuates else (2.0, _DECAY)
        needed = 2 ** math.ceil(
            math.log2(max(size * (aim * excess) ** (1 / decay), 2.0 * size))
        )
        enough = excess <= 1 and (size >= _FIRST or result[0].reliable)
        if enough or (
            done > 2 * RANDOMISATIONS * _FIRST and RANDOMISATIONS * needed > max_lives
        ):
            how = done, seed, time.perf_counter() - begin, error <= rel_error, hidden
            return Steady(*result, *how)  # type: ignore[call-arg,arg-type]  # in the order of the fields
        size = needed


def settled(
    ensemble: Ensemble, drive: Drive, seed: int, threads: int = 1
) -> float | None:
    """The mean stretch at breaking that births of annealed contacts that age depend on,
    by a steady estimate; None for all others."""
    if not ensemble.self_consistent:
        return None
    return known(
        steady(
            ensemble, drive, rel_error=_SETTLED, seed=seed, threads=threads
        ).break_stretch
    )


class _Job(NamedTuple):
    """What does not change while a steady estimate is refined."""

    ensemble: Ensemble
    velocity: float
    proposal: "Proposal | None"  # None: plain births
    identity: int
    seed: int
    threads: int
    progress: Progress | None
    step: float  # accuracy of the steps of `langevin` thresholds


def _self_consistent(
    job: _Job, stretch: float, response: Array | None, size: int
) -> tuple[Array, float, Array, int]:
    """Sums of each randomisation at its own fixed point of C, the mean fixed point, the
    response of the sums to C (measured unless it is known), and the lives this took."""
    used, unit = 0, job.ensemble.thresholds.scale

    def sums(stretch: float) -> Array:
        nonlocal used
        used += RANDOMISATIONS * size
        return _randomise(job, contacts(job.ensemble, job.velocity, stretch), size)

    if response is None:
        near, far = (
            sums(stretch * factor).mean(axis=0) for factor in (1.0, 1.0 + _NUDGE)
        )
        response = (far - near) / (_NUDGE * stretch / unit)
    for _ in range(20):
        rows = sums(stretch)
        shift = (rows[:, 1] - stretch / unit) / (1.0 - response[1])
        stretch += float(shift.mean()) * unit
        if abs(shift.mean()) * unit < _NUDGE * _NUDGE * stretch:
            break
    rows[:, :4] += shift[:, None] * response[:4]
    return rows, stretch, response, used


class Density(NamedTuple):
    """A density of an exponential variable e, drawn by inversion: ln e is piecewise
    linear in a uniform p, with a `slope` in each cell. `guide` holds the cell of each
    of many equidistant p: where a search begins, and nearly ends.
    """

    p: Array
    log_e: Array
    slope: Array
    guide: Array

    @classmethod
    def of(cls, log_e: Array, density: Array) -> "Density":
        """From values of the density of ln e, up to a factor; values of p that cannot
        be told apart are dropped."""
        fine = np.linspace(
            log_e[0], log_e[-1], 2**14
        )  # the weights saw-tooth by (cell width) * e
        log_e, density = fine, interpolate.PchipInterpolator(log_e, density)(fine)
        p = integrate.cumulative_trapezoid(density, log_e, initial=0)
        p /= p[-1]
        keep = np.append(True, np.diff(p) > 1e-15)
        p, log_e = p[keep] / p[keep][-1], log_e[keep]
        guide = np.searchsorted(p, np.linspace(0.0, 1.0, 2**14 + 1), side="right") - 1
        guide = np.clip(guide, 0, p.size - 2).astype(
            np.uint16
        )  # short, for the processor's cache
        return cls(p, log_e, np.diff(log_e) / np.diff(p), guide)

    def draw(self, p: Array) -> tuple[Array, Array]:
        """exp(-e), and the weights that turn averages over e into averages over Exp(1)."""
        u, weight = np.empty(p.size), np.empty(p.size)
        invert(self.p, self.log_e, self.slope, self.guide, p, u, weight)
        return u, weight


@kernel
def invert(
    p: Array,
    log_e: Array,
    slope: Array,
    guide: Array,
    at: Array,
    u: Array,
    weight: Array,
) -> None:
    """The kernel of `Density.draw`."""
    for i in range(at.size):
        cell = int(guide[int(at[i] * (guide.size - 1))])
        while cell < slope.size - 1 and p[cell + 1] <= at[i]:
            cell += 1
        u[i] = log_e[cell] + slope[cell] * (at[i] - p[cell])
        weight[i] = slope[cell]
    for i in range(at.size):
        e = exp(u[i])
        u[i] = exp(-e)
        weight[i] *= u[i] * e


class Proposal(NamedTuple):
    """Densities from which thresholds (e = -ln J_c(xi)) and clocks are drawn.

    `covered` is False if thresholds rarer than e = 500 would still contribute to means.
    `squares` says where mean squares come from.
    """

    threshold: Density
    clock: Density
    covered: bool
    squares: "Squares"

    @classmethod
    def of(cls, c: Contacts, variance: bool = True) -> "Proposal":
        """Births times the root mean square of what a life contributes to friction and
        to break_stretch, plus a tenth of plain births so that no weight can grow large;
        all on a fixed grid. This tenth, of clocks, is the root of births: the few
        clocks so early that they change a whole life contribute little, but errors have
        to show them.

        Where lives that would hardly be met make up too much of the mean square of
        forces, and there is a `variance`, the third contribution is that to the square.
        """
        fine = (1000, 100) if c.aging.closed else (200, 40)  # lives that age take long
        log_e = np.linspace(-53 * math.log(2), math.log(500), fine[0])
        log_clock = np.linspace(-12, math.log(40), fine[1])
        births, clock_births = (
            np.exp(log_e - np.exp(log_e)),
            np.exp(log_clock - np.exp(log_clock)),
        )
        u, v = (
            grid.ravel()
            for grid in np.meshgrid(
                *(np.exp(-np.exp(g)) for g in (log_e, log_clock)), indexing="ij"
            )
        )
        found, squares, sizes, roots = _typical(c, u, v), [], [], []

        def add(part: Array) -> None:
            """Another contribution of lives, at least 0."""
            part = part.reshape(log_e.size, log_clock.size)
            size = np.maximum(
                part.max(axis=1), 1e-300
            )  # squares of extreme thresholds overflow
            square = part / size[:, None]
            square *= square
            squares.append(square)
            sizes.append(births * size / (births @ part @ clock_births))
            roots.append(sizes[-1] * np.sqrt(square @ clock_births))

        def mixed(log_x: Array, *parts: Array) -> Array:
            shares = np.array([0.1] + [0.9 / (len(parts) - 1)] * (len(parts) - 1))
            return shares / integrate.trapezoid(parts, log_x) @ np.array(parts)

        add(found.travel)
        add(np.abs(found.work))
        density = mixed(log_e, births, *roots)
        covered = bool(density[-1] < _NEGLIGIBLE * density.max())
        with np.errstate(all="ignore"):  # squares of extreme thresholds overflow
            # k_i x from 0 on: int (k_i x)^2 dx = 4 (int k_i x dx)^2/(3 travel), sooner
            # found than `Sample.square`
            square = (
                found.square
                if isinstance(c.newborn, Stretched)
                else found.work * found.work / found.travel
            )
            source = Squares(
                log_e, births * (square.reshape(log_e.size, -1) @ clock_births), density
            )
        # forces of contacts born stretched may nearly cancel in the work
        needed = (
            isinstance(c.newborn, Stretched)
            or source.unmet(RANDOMISATIONS * _FIRST) > _UNSEEN_SQUARES
        )
        if variance and needed:
            add(square)
            density = mixed(log_e, births, *roots)
            source = source._replace(density=density)
        clock_density = clock_births
        if c.barrier.thermal:
            over = np.maximum(density, 1e-300)
            means = [
                (size**2 / over) @ square
                for square, size in zip(squares, sizes, strict=True)
            ]
            clock_density = mixed(
                log_clock,
                np.sqrt(clock_births),
                *(clock_births * np.sqrt(mean) for mean in means),
            )
        low = np.linspace(-53 * math.log(2), log_clock[0], 100)[
            :-1
        ]  # below the grid nothing happens but short lives
        falls = math.log(clock_density[1] / clock_density[0]) / (
            log_clock[1] - log_clock[0]
        )
        clock_density = np.append(
            clock_density[0] * np.exp(falls * (low - log_clock[0])), clock_density
        )
        clocks = Density.of(np.append(low, log_clock), clock_density)
        return cls(Density.of(log_e, density), clocks, covered, source)


class Squares(NamedTuple):
    """Where the mean square of forces comes from: what lives contribute per ln e at
    `log_e`, up to a factor, and the `density` of ln e of which they are drawn; arrays
    (n,)."""

    log_e: Array
    contribution: Array
    density: Array

    def unmet(self, lives: float) -> float:
        """The share of the mean square by lives so rare that of so many `lives` fewer
        than _UNMET are expected."""
        drawn, made = (
            integrate.cumulative_trapezoid(part[::-1], -self.log_e[::-1], initial=0.0)
            for part in (self.density, self.contribution)
        )  # from the rarest on
        if not math.isfinite(made[-1]):
            return math.inf
        return float(
            made[np.searchsorted(drawn, drawn[-1] * _UNMET / lives, side="right") - 1]
            / made[-1]
        )

    @property
    def beyond(self) -> float:
        """Share that lives beyond the last e would add to the mean square, relative to
        it: contributions go on falling as they do over the last cell of the grid."""
        e = np.exp(self.log_e[-2:])
        before, last = self.contribution[-2:] / e
        if last == 0.0:
            return 0.0
        if not before > last:
            return math.inf
        rest = (e[1] - e[0]) * last / math.log(before / last)
        return float(rest / integrate.trapezoid(self.contribution, self.log_e))


@functools.lru_cache(maxsize=16)
def _proposal(ensemble: Ensemble, velocity: float, stretch: float | None) -> Proposal:
    """The densities for contacts of any delay, which has no part in lives."""
    return Proposal.of(contacts(ensemble, velocity, stretch), not ensemble.divergence)


def _randomise(job: _Job, c: Contacts, size: int) -> Array:
    """Per randomisation: mean elastic work per k, travel, square of the force added up
    over the travel and stretch at birth; the largest single share of the first two, and
    of the third, shape (RANDOMISATIONS, 6)."""
    stream: Key = key(job.seed, STEADY + job.identity)
    together = (
        min(max(1, _BLOCK // size), -(-RANDOMISATIONS // job.threads))
        if job.proposal
        else 1
    )
    groups = [
        range(first, min(first + together, RANDOMISATIONS))
        for first in range(0, RANDOMISATIONS, together)
    ]

    def some(group: range, sobol: Sobol | None) -> Array:
        if sobol is None:
            return _plainly(c, stream, group.start, size, stop)
        return _weighted(
            job,
            c,
            stream,
            sobol,
            range(group.start * size, group.start * size + size),
            stop,
        )

    rows: list[Array] = []
    sequences = (
        _sequences(job, 2 + _births_vary(c), size, groups)
        if job.proposal
        else repeat(None)
    )
    report = job.progress or (lambda *_: None)
    report(0, RANDOMISATIONS * size)
    # blocks of weighted lives are so short that Ctrl-C can wait for them, unless lives
    # are paths of many steps
    alone = job.threads == 1 and job.proposal is not None and not c.aging.fluctuates
    with nullcontext() if alone else ThreadPool(job.threads) as pool:
        stop = pool.stop if pool else current_stop()
        for found in (pool.map if pool else map)(some, groups, sequences):
            rows.extend(found)
            report(len(rows) * size, RANDOMISATIONS * size)
    return np.array(rows)


def _plainly(c: Contacts, stream: Key, index: int, size: int, stop: Array) -> Array:
    """`_randomise` by `size` independent lives of contacts of their own."""
    rounds = size // (ROUNDS * LANES)  # an attempt of another size takes other rounds
    sums = PlainSums.empty(index * LANES, rounds, 2 * rounds, stop)
    without = c._replace(delay=Waits(c.delay.mean, 0.0))  # no sum depends on a delay
    lanes = idle_lanes(without, stream)
    follow(without, sums, sums.first, sums.first + LANES, *lanes)
    work, travel, square, birth, size_of_work = (
        np.cumsum(part)[-1] for part in sums.parts()
    )  # one after the other
    largest = max(sums.most_work.max() / size_of_work, sums.most_travel.max() / travel)
    return np.array(
        [[work / size, travel / size, square / size, birth / size, largest, 0.0]]
    )  # see `_unmet`


class PlainSums(NamedTuple):
    """A recorder of `engine.follow` that adds up plainly drawn lives: those of the
    LANES contacts from `first` on, from the age `begin` up to `end`, ROUNDS lives each
    time.

    Sums and largest values are those of each lane, arrays (LANES,): a single sum would
    have to wait for every addition. They are work over k, travel, square of the force
    along it, stretch at birth and |work|, and the largest |work| and travel.
    """

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
    carries: bool = True

    @classmethod
    def empty(cls, first: int, begin: int, end: int, stop: Array) -> "PlainSums":
        """Sums of nothing."""
        return cls(first, begin, end, stop, *np.zeros((7, LANES)))

    def parts(self) -> tuple[Array, ...]:
        """The sums."""
        return self.work, self.travel, self.square, self.birth, self.size


@admit.register(PlainSums)
def _admit(
    recorder: PlainSums, c: Contacts, lanes: Lanes, lane: int, contact: int
) -> bool:
    lanes.contact[lane] = contact
    lanes.age[lane] = recorder.begin
    lanes.position[lane] = 0.0
    return recorder.begin < recorder.end


@note_lives.register(PlainSums)
def _note_lives(
    recorder: PlainSums, c: Contacts, lanes: Lanes, lives: Lives, r: int, active: int
) -> bool:
    work, travel, square, birth, size = (
        recorder.work,
        recorder.travel,
        recorder.square,
        recorder.birth,
        recorder.size,
    )
    most_work, most_travel = recorder.most_work, recorder.most_travel
    for i in range(active):
        w, s = life_work(c.aging, c, lives, r, i), lives.travel[r, i]
        y, k = lives.birth[r, i], lives.stiffness[r, i]
        work[i] += w
        travel[i] += s
        square[i] += k * k * s * (y * y + s * (y + third(s)))
        birth[i] += y
        size[i] += abs(w)
        most_work[i] = max(most_work[i], abs(w))
        most_travel[i] = max(most_travel[i], s)
    ended = r + 1 == ROUNDS and lanes.age[0] + 1 == recorder.end
    for i in range(active if ended else 0):
        lanes.position[i] = math.inf
    return ended


def _sequences(
    job: _Job, dimensions: int, size: int, groups: list[range]
) -> Iterator[Sobol]:
    """Those of each group of randomisations, of `size` points each. They begin a few at
    a time, which takes less time than one by one; threads are at work on the first
    meanwhile."""
    at_once = -(-_BEGUN // len(groups[0]))
    for first in range(0, len(groups), at_once):
        some = groups[first : first + at_once]
        names = [
            (job.seed, STEADY, job.identity, size, index)
            for group in some
            for index in group
        ]
        # the child of a name, which is what SciPy's own sequence would draw from
        seeds = [np.random.SeedSequence(name, spawn_key=(0,)) for name in names]
        sobol = Sobol.of(
            [np.random.Generator(np.random.PCG64(seed)) for seed in seeds],
            dimensions,
            size,
        )
        for group in some:
            yield sobol.some(
                slice(group.start - some[0].start, group.stop - some[0].start)
            )


def _weighted(
    job: _Job, c: Contacts, stream: Key, sobol: Sobol, numbers: range, stop: Array
) -> Array:
    """`_randomise` by weighted Sobol points, of some sequences at once; `numbers` those
    of the first one's contacts."""
    assert job.proposal
    size, third = len(numbers), _births_vary(c)
    block = min(size, _BLOCK)
    sums = np.zeros((len(sobol.shift), 8))
    for first in range(0, size, block):
        if stop[0]:
            raise CancelledError
        points = sobol.points(first, block).reshape(2 + third, -1)
        u, weight = job.proposal.threshold.draw(points[0])
        v, clock_weight = job.proposal.clock.draw(points[1])
        found = lives(
            c,
            Source(stream, numbers[first], job.step),
            u,
            v,
            points[2] if third else None,
        )
        add_weighted(found, weight, clock_weight, sums)
    with np.errstate(invalid="ignore"):  # squares of broad laws overflow
        shares = sums[:, 5:] / sums[:, [4, 1, 2]]
    return np.column_stack(
        (sums[:, :4] / size, shares[:, :2].max(axis=1), shares[:, 2])
    )


@kernel
def add_weighted(
    found: Sample, weight: Array, clock_weight: Array, sums: Array
) -> None:
    """Add to each row of `sums` those of its share of lives, one row after the other:
    work, travel, square, birth and
    |work|; the last three columns are the largest |work|, |travel| and square of a life.
    """
    count = weight.size // sums.shape[0]
    for row in range(sums.shape[0]):
        work, travel, square, birth = (
            sums[row, 0],
            sums[row, 1],
            sums[row, 2],
            sums[row, 3],
        )
        size, most_work, most_travel, most_square = (
            sums[row, 4],
            sums[row, 5],
            sums[row, 6],
            sums[row, 7],
        )
        for i in range(row * count, (row + 1) * count):
            w, s, y = weight[i] * clock_weight[i], found.travel[i], found.birth[i]
            one, way = w * found.work[i], w * s
            work, travel, birth, size = (
                work + one,
                travel + way,
                birth + w * y,
                size + abs(one),
            )
            two = w * square_of(found.stiffness[i], s, y)
            square += two
            most_work, most_travel = (
                max(most_work, abs(one)),
                max(most_travel, abs(way)),
            )
            most_square = max(most_square, two)
        sums[row, 0], sums[row, 1], sums[row, 2], sums[row, 3] = (
            work,
            travel,
            square,
            birth,
        )
        sums[row, 4], sums[row, 5], sums[row, 6], sums[row, 7] = (
            size,
            most_work,
            most_travel,
            most_square,
        )


def _unseen(c: Contacts, proposal: Proposal | None, count: int) -> float:
    """The relative error that clocks may hide of which `count` lives meet fewer than
    four, early or late."""
    if not c.barrier.thermal or c.aging.fluctuates:  # no clocks; errors of another size
        return 0.0
    share, rare = (
        (np.arange(16) + 0.5) / 16,
        4.0 * 0.5 ** np.arange(37) / count,
    )  # of thresholds; of clocks
    p = np.append(rare, 1.0 - rare)
    clock, weight = proposal.clock.draw(p) if proposal else (p, np.ones(p.size))
    u, v = (grid.ravel() for grid in np.meshgrid(share, clock, indexing="ij"))
    errors = []
    found = _typical(c, u, v)
    for part in (found.work, found.travel):
        part = part.reshape(share.size, 2, rare.size)
        change = np.abs(part - part[:, :, :1]).mean(axis=0) * weight.reshape(
            2, rare.size
        )  # grows with rarity
        errors.append(
            float(
                change.sum(axis=0)[1:] @ -np.diff(rare) / np.abs(part[:, :, 0]).mean()
            )
        )
    return max(errors)


def _unmet(c: Contacts, proposal: Proposal | None, count: int) -> float:
    """Estimate what lives of which `count` may have met none add to the mean square of
    forces, relative to that of all others: those beyond the last threshold, and all
    that are too rare among plain births."""
    if proposal is not None:
        return proposal.squares.beyond
    squares = Proposal.of(c).squares
    births = np.exp(squares.log_e - np.exp(squares.log_e))
    share = squares._replace(density=births).unmet(count)
    return math.inf if share >= 1.0 else (squares.beyond + share) / (1.0 - share)


def _uneven(c: Contacts, count: int) -> float:
    """The relative error that a few different thresholds may hide: each randomisation
    has one life more or less of each than its share, and if one of these is rare all
    may have the same. Then the error exceeds z of these with e^-3z."""
    steps = c.thresholds.steps
    jumps = np.unique(steps).size - 1
    if isinstance(c.barrier, Pooled) or jumps < 1:
        return 0.0
    parts = (steps, steps ** (3 if c.springs.slope else 2))
    return max(
        3.0 * float(np.ptp(part) / part.mean()) / jumps / count for part in parts
    )


def _births_vary(c: Contacts) -> bool:
    """Whether a birth takes a random number."""
    return isinstance(c.newborn, Stretched) and not isinstance(
        c.newborn.law, DeltaBirths
    )


def _typical(c: Contacts, u: Array, v: Array) -> Sample:
    """Lives from uniforms of thresholds and clocks, in the mean over births: root mean
    squares, with the sign lost."""
    if not _births_vary(c):
        return lives(c, Source(key(0, STEADY), 0, STEP), u, v)
    births = [np.full(u.size, (i + 0.5) / 16) for i in range(16)]
    found = [lives(c, Source(key(0, STEADY), 0, STEP), u, v, birth) for birth in births]
    return Sample(
        *(np.sqrt(np.mean([part[j] ** 2 for part in found], axis=0)) for j in range(4))
    )


def _relative(found: tuple[Estimate, ...]) -> float:
    """The largest relative error; of friction and stretch, where births along the
    motion and against it cancel, over a thousandth and a tenth of the root of the
    variance of forces at least."""
    friction, pinned, stretch, travel, birth, variance = found
    typical = (
        math.sqrt(abs(variance.value or 0.0)) if variance.stderr is not None else 0.0
    )
    relative = [(e.stderr or 0.0) / (e.value or 1.0) for e in (pinned, travel)]
    relative.append(
        (friction.stderr or 0.0) / (max(abs(known(friction)), 1e-3 * typical) or 1.0)
    )
    if birth.stderr or birth.value:  # else it is the travel
        relative.append(
            (stretch.stderr or 0.0) / max(abs(known(stretch)), 0.1 * typical)
        )
    return max(relative)


class Unseen(NamedTuple):
    """Relative errors that the scatter of randomisations does not show: of the means
    over lives, and of that of squares."""

    means: float
    squares: float


def _averages(
    c: Contacts,
    sums: Array,
    drag: float,
    unit: float,
    size: int,
    covered: bool,
    unseen: Unseen,
) -> tuple[Estimate, ...]:
    """Delta-method estimates from the randomisations, in the order of `OBSERVABLES`;
    `drag` is eta v/k and `unit` that of length."""
    reliable = covered and float(sums[:, 4].max()) < _DOMINANT
    delay, (hidden, of_squares) = c.delay.mean, unseen
    work, travel, square, birth = sums[:, :4].T
    cycle = travel + delay
    friction = float((work.mean() + drag * delay) / cycle.mean())
    pinned = float(travel.mean() / cycle.mean())
    with np.errstate(over="ignore"):
        second = float((square.mean() + drag**2 * delay) / cycle.mean())
    size_of_force = max(abs(friction), math.sqrt(second) if birth.any() else 0.0)
    n = RANDOMISATIONS * size

    def estimate(value: float, residual: Array, hidden: float, unit: float) -> Estimate:
        stderr = math.hypot(
            float(np.std(residual, ddof=1)) / math.sqrt(RANDOMISATIONS), hidden
        )
        return Estimate(value * unit, stderr * unit, n, RANDOMISATIONS - 1, reliable)

    waiting = delay / float(cycle.mean())
    of_friction = (work + drag * delay - friction * cycle) / cycle.mean()
    scale = float(np.mean(np.abs(travel)) + np.mean(np.abs(birth)))
    with np.errstate(
        over="ignore", invalid="ignore"
    ):  # of laws so broad that there is no variance
        # of all randomisations together: few lives of one make much of its mean square
        largest = float((sums[:, 5] * square).max() / square.sum())
        residual = (
            square + drag**2 * delay - second * cycle
        ) / cycle.mean() - 2.0 * friction * of_friction
        variance = estimate(
            second - friction**2, residual, of_squares * second, unit * unit
        )
    known_too = math.isfinite(known(variance)) and math.isfinite(variance.stderr or 0.0)
    if stiffness_varies(c.aging, c.springs) or not known_too:
        variance = Estimate(None, None, n)
    elif (variance.stderr or 0.0) > _BROAD * abs(
        known(variance)
    ) or largest >= _DOMINANT:
        variance = dataclasses.replace(variance, reliable=False)
    return (
        estimate(friction, of_friction, hidden * size_of_force, unit),
        estimate(
            pinned,
            (travel - pinned * cycle) / cycle.mean(),
            hidden * pinned * waiting,
            1.0,
        ),
        estimate(float((travel + birth).mean()), travel + birth, hidden * scale, unit),
        estimate(float(travel.mean()), travel, hidden * float(travel.mean()), unit),
        estimate(
            float(birth.mean()), birth, hidden * float(np.mean(np.abs(birth))), unit
        ),
        variance,
    )
