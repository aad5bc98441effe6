"""Densities from which steady estimates draw thresholds and clocks.

Births are a poor sample where strong contacts are rare at birth but dominate time, so
lives are drawn from densities proportional to births times the root mean square of what
a life contributes, found beforehand on a fixed grid, and weighted back: exact for any
such density, and of finite variance in the heavy-tailed regime where plain averages
over births never converge.
"""

import functools
import math
from typing import NamedTuple

import numpy as np
from scipy import integrate, interpolate

from eqsim.engine.contacts import Contacts, contacts
from eqsim.engine.langevin import STEP
from eqsim.engine.sample import Sample, Source, lives
from eqsim.laws.newborn import DeltaBirths, Stretched
from eqsim.model.ensemble import Ensemble
from eqsim.numerics.compiled import kernel
from eqsim.numerics.streams import STEADY, key
from eqsim.numerics.tables import Array
from eqsim.numerics.vector_math import exp

RANDOMISATIONS = 32  # Sobol sequences of an estimate
FEWEST_LIVES = 2**11  # of a randomisation at the first attempt
# ranges of ln e and of ln of a clock beyond which nothing happens
LOG_RANKS = -53 * math.log(2), math.log(500)
_LOG_CLOCKS = -12, math.log(40)
_NEGLIGIBLE_DENSITY = 1e-12
# clocks beyond all that are drawn, and the share of a mean that each may contribute in an
# e-fold of clocks
_LATE_CLOCKS = np.array([41.0, 45.0, 50.0, 60.0, 80.0, 120.0, 200.0, 400.0, 700.0])
_NEGLIGIBLE_CLOCKS = 1e-10
# expected lives among all that are drawn, below which a sample may have met none
_EXPECTED_UNMET = 4.0
# share of unmet lives in the mean square from which on lives are drawn for it, too;
# gamma laws at T = 0 have up to 6e-4, which shows in the scatter
_UNMET_SQUARES = 7e-4


def births_per_log(log_e: Array) -> Array:
    """Density of ln e, e exponentially distributed as ranks and clocks at birth are."""
    return np.exp(log_e - np.exp(log_e))


def births_vary(c: Contacts) -> bool:
    """True if the stretch at birth is random."""
    stretched = isinstance(c.newborn, Stretched)
    return stretched and not isinstance(c.newborn.law, DeltaBirths)


def lives_on_grid(c: Contacts, u: Array, v: Array) -> Sample:
    """Lives from each pair of uniforms of thresholds and of clocks, shape (thresholds,
    clocks), in the mean over births: root mean squares, with the sign lost."""
    source, shape = Source(key(0, STEADY), 0, STEP), (u.size, v.size)
    u, v = np.repeat(u, v.size), np.tile(v, u.size)
    if not births_vary(c):
        return Sample(*np.reshape(lives(c, source, u, v), (-1, *shape)))
    births = [np.full(u.size, (i + 0.5) / 16) for i in range(16)]
    squares = [np.square(lives(c, source, u, v, birth)) for birth in births]
    return Sample(*np.sqrt(np.mean(squares, axis=0)).reshape(-1, *shape))


class Density(NamedTuple):
    """A density of an exponential variable e, drawn by inversion: ln e is piecewise
    linear in a uniform p, with a `slope` in each cell. `guide` holds the cell of each
    of many equidistant p: where a search begins, and nearly ends."""

    p: Array
    log_e: Array
    slope: Array
    guide: Array

    @classmethod
    def of(cls, log_e: Array, density: Array) -> "Density":
        """Invert values of the density of ln e, given up to a factor; values of p that
        cannot be told apart are dropped."""
        # fine, since in each cell weights are off by up to (cell width) * e
        fine = np.linspace(log_e[0], log_e[-1], 2**14)
        smooth = interpolate.PchipInterpolator(log_e, density)(fine)
        p = integrate.cumulative_trapezoid(smooth, fine, initial=0)
        p /= p[-1]
        keep = np.append(True, np.diff(p) > 1e-15)
        p, log_e = p[keep] / p[keep][-1], fine[keep]
        guide = np.searchsorted(p, np.linspace(0.0, 1.0, 2**14 + 1), side="right") - 1
        # short numbers, for the processor's cache
        guide = np.clip(guide, 0, p.size - 2).astype(np.uint16)
        return cls(p, log_e, np.diff(log_e) / np.diff(p), guide)

    def draw(self, p: Array) -> tuple[Array, Array]:
        """exp(-e), and weights that turn averages over e into averages over Exp(1)."""
        u, weight = np.empty(p.size), np.empty(p.size)
        invert(self, p, u, weight)
        return u, weight


@kernel
def invert(density: Density, at: Array, u: Array, weight: Array) -> None:
    """The kernel of `Density.draw`."""
    p, log_e, slope, guide = density
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


class Squares(NamedTuple):
    """Contributions to the mean square of forces per ln e at `log_e`, up to a factor,
    and the `density` of ln e from which lives are drawn; arrays (n,)."""

    log_e: Array
    contribution: Array
    density: Array

    def unmet(self, lives: float) -> float:
        """Share of the mean square due to lives so rare that fewer than _EXPECTED_UNMET
        are expected among so many `lives`."""
        parts = np.array([self.density, self.contribution])[:, ::-1]  # the rarest first
        log_e = -self.log_e[::-1]
        drawn, made = integrate.cumulative_trapezoid(parts, log_e, initial=0.0)
        if not math.isfinite(made[-1]):
            return math.inf
        if made[-1] == 0.0:  # squares of forces so small underflow
            return 0.0
        few = drawn[-1] * _EXPECTED_UNMET / lives
        return float(made[np.searchsorted(drawn, few, side="right") - 1] / made[-1])

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


class Proposal(NamedTuple):
    """Densities from which thresholds (e = -ln J_c(xi)) and clocks are drawn. `covered`
    is False if thresholds rarer than e = 500, or clocks beyond 40, would still contribute
    to means. `squares` says where mean squares come from."""

    threshold: Density
    clock: Density
    covered: bool
    squares: Squares

    @classmethod
    def of(cls, c: Contacts, variance: bool = True) -> "Proposal":
        """Make densities on a fixed grid: births times the root mean square of what a
        life contributes to friction and to break_stretch, plus a tenth of plain births
        so that no weight can grow large. For clocks this tenth is the root of births:
        the few clocks so early that they change a whole life contribute little, but
        errors have to show them.

        Where rare lives make up too much of the mean square of forces, and there is a
        `variance`, the contribution to the square is the third one.
        """
        fine = (1000, 100) if c.aging.closed else (200, 40)  # lives that age take long
        log_e = np.linspace(*LOG_RANKS, fine[0])
        log_clock = np.linspace(*_LOG_CLOCKS, fine[1])
        births, clock_births = births_per_log(log_e), births_per_log(log_clock)
        ranks, clocks = np.exp(-np.exp(log_e)), np.exp(-np.exp(log_clock))
        found = lives_on_grid(c, ranks, clocks)
        stretched = isinstance(c.newborn, Stretched)
        squares, sizes, roots = [], [], []

        def add(reward: Array) -> None:
            """Add a contribution of lives, at least 0."""
            # squares of extreme thresholds overflow
            size = np.maximum(reward.max(axis=1), 1e-300)
            square = reward / size[:, None]
            square *= square
            squares.append(square)
            sizes.append(births * size / (births @ reward @ clock_births))
            roots.append(sizes[-1] * np.sqrt(square @ clock_births))

        def mixed(log_x: Array, *parts: Array) -> Array:
            shares = np.array([0.1] + [0.9 / (len(parts) - 1)] * (len(parts) - 1))
            return shares / integrate.trapezoid(parts, log_x) @ np.array(parts)

        add(found.travel)
        add(np.abs(found.work))
        density = mixed(log_e, births, *roots)
        covered = bool(density[-1] < _NEGLIGIBLE_DENSITY * density.max())
        with np.errstate(all="ignore"):  # squares of extreme thresholds overflow
            # k_i x from 0 on: int (k_i x)^2 dx = 4 (int k_i x dx)^2/(3 travel), sooner
            # found than `Sample.square`
            other = found.work * found.work / found.travel
            square = found.square if stretched else other
            made = births * (square @ clock_births)
        source = Squares(log_e, made, density)
        # forces of contacts born stretched may nearly cancel in the work
        fewest = RANDOMISATIONS * FEWEST_LIVES
        if variance and (stretched or source.unmet(fewest) > _UNMET_SQUARES):
            add(square)
            density = mixed(log_e, births, *roots)
            source = source._replace(density=density)
        clock_density = clock_births
        if c.barrier.thermal:
            over = np.maximum(density, 1e-300)
            pairs = zip(squares, sizes, strict=True)
            means = [(size**2 / over) @ square for square, size in pairs]
            parts = [clock_births * np.sqrt(mean) for mean in means]
            clock_density = mixed(log_clock, np.sqrt(clock_births), *parts)
            covered &= not _late_clocks_matter(c, log_e, found, log_clock)
        # below the grid nothing happens but short lives
        low = np.linspace(-53 * math.log(2), log_clock[0], 100)[:-1]
        rise = math.log(clock_density[1] / clock_density[0])
        falls = rise / (log_clock[1] - log_clock[0])
        below = clock_density[0] * np.exp(falls * (low - log_clock[0]))
        clock = Density.of(np.append(low, log_clock), np.append(below, clock_density))
        return cls(Density.of(log_e, density), clock, covered, source)


def _late_clocks_matter(
    c: Contacts, log_e: Array, found: Sample, log_clock: Array
) -> bool:
    """True if lives with clocks beyond all that are drawn contribute to the means of
    travel and work, beside the lives `found` on a grid of thresholds and clocks."""
    births, clocks = births_per_log(log_e), births_per_log(np.log(_LATE_CLOCKS))
    drawn = births_per_log(log_clock) * (log_clock[1] - log_clock[0])
    late = lives_on_grid(c, np.exp(-np.exp(log_e)), np.exp(-_LATE_CLOCKS))
    for of_drawn, of_late in ((found.travel, late.travel), (found.work, late.work)):
        mean = births @ np.abs(of_drawn) @ drawn
        beyond = births @ np.abs(of_late) * clocks
        if not np.all(beyond <= _NEGLIGIBLE_CLOCKS * mean):  # also of what overflows
            return True
    return False


# Points of a sweep that differ by their delay share it: it takes 20 ms.
@functools.lru_cache(maxsize=16)
def proposal_of(ensemble: Ensemble, velocity: float, stretch: float | None) -> Proposal:
    """Cached `Proposal` of an ensemble; it does not depend on the delay."""
    return Proposal.of(contacts(ensemble, velocity, stretch), not ensemble.divergence)
