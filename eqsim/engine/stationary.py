"""Draw contacts as a snapshot of the steady state finds them, from tables.

A snapshot sees contacts in proportion to their time, not to their births (length bias,
derived): pinned contacts have thresholds of density P_c(xi) m(xi)/C, where m(xi) =
E[x_b|xi] and C = E[x_b], and given xi a stretch of density S(x|xi)/m(xi) with S(x|xi) =
P(x_b > x|xi).

S decreases, so x S(x) <= int_0^x S dy <= m and S is below the envelope g(x) = min(1,
m/x). A stretch x proposed from g is kept with probability S(x)/g(x): that is, if a life
with the exponential clock -ln(U g(x)), U uniform, breaks beyond x. Given that, this
clock is Lambda(x) + Exp(1), so the same clock also says where the contact found at x
will break.
"""

import itertools
import math
from typing import Any, NamedTuple

import numpy as np
from scipy import integrate, interpolate

from eqsim.engine.contacts import Contacts
from eqsim.engine.proposal import LOG_RANKS, Proposal, births_per_log
from eqsim.engine.sample import unnamed_lives
from eqsim.errors import InputError
from eqsim.laws import threshold
from eqsim.laws.aging.base import end, life, whole_hazard
from eqsim.laws.barrier.base import travel
from eqsim.laws.delay import residual_delay_draw
from eqsim.laws.newborn import Stretched, newborn_draw
from eqsim.laws.stiffness import kappa
from eqsim.laws.threshold import NO_STEPS, Thresholds, threshold_draw
from eqsim.numerics import tables
from eqsim.numerics.compiled import by_law, kernel, routine
from eqsim.numerics.quadrature import gauss_legendre
from eqsim.numerics.streams import Key, uniforms
from eqsim.numerics.tables import NO_TABLE, Array, look_up, search

_EXTREME_RANK = 45.0  # bound on -ln of a 63-bit uniform
_EXTREME_PRODUCT = 129.0  # rank of the product of two uniforms of 2^-96
_EXTREME_CLOCK = 110.0  # bound on the clock of a contact in a snapshot
_ENVELOPE_MARGIN = 1.0 + 1e-4  # the envelope may be too high, never too low


class Stationary(NamedTuple):
    """Tables of the stationary state, in the units of `Contacts`. `pinned` is the
    pinned fraction. A smooth law has `biased`, the rank e of a threshold in a snapshot
    against -ln of a uniform, and `life`, m against e; a discrete one has `share`, the
    cumulative share of its thresholds in a snapshot, and `step_life`, m of each.
    Contacts of `langevin` thresholds and contacts born stretched, whose lives are found
    by trying, only have `longest`: no life is longer."""

    pinned: float = 1.0
    longest: float = math.inf
    biased: Array = NO_TABLE
    life: Array = NO_TABLE
    share: Array = NO_STEPS
    step_life: Array = NO_STEPS


class Fresh(NamedTuple):
    """Fresh start: a type of its own, so that its kernels compile no snapshots."""


def stationary(c: Contacts) -> Stationary:
    """The stationary state of contacts; tables are good to 1e-6 relative. Raises
    InputError where contacts that live 1000 times longer than the mean still matter, if
    they are found by trial, for which they are too rare."""
    if c.aging.fluctuates or isinstance(c.newborn, Stretched):
        return Stationary(longest=_longest(c))
    if c.thresholds.steps.size:
        means = mean_lives(c, c.thresholds.steps)
        mean = float(means.mean())
        share = np.cumsum(means) / means.sum()
        return Stationary(mean / (mean + c.delay.mean), share=share, step_life=means)
    # lives that age take long
    grid = np.linspace(*LOG_RANKS, 3000 if c.aging.closed else 600)
    xi = np.empty(grid.size)
    thresholds(c.thresholds, np.exp(-np.exp(grid)), xi)
    means = mean_lives(c, xi)
    time = means * births_per_log(grid)  # density of contacts found in ln e, times C
    cell = grid[1] - grid[0]
    below = integrate.cumulative_simpson(time, dx=cell, initial=0)
    above = integrate.cumulative_simpson(time[::-1], dx=cell, initial=0)[::-1]
    mean = float(below[-1])
    use = (below > 0) & (above > 1e-200 * mean)  # beyond, nothing to draw
    below, above, log_e = below[use] / mean, above[use] / mean, grid[use]
    rank = np.where(below < 0.5, -np.log1p(-np.minimum(below, 0.5)), -np.log(above))
    log_rank = np.log(rank)
    rising = np.append(True, log_rank[1:] > np.maximum.accumulate(log_rank)[:-1])
    biased = _octaves(interpolate.PchipInterpolator(log_rank[rising], log_e[rising]))
    of_e = _octaves(interpolate.CubicSpline(grid, np.log(means)))
    return Stationary(mean / (mean + c.delay.mean), biased=biased, life=of_e)


def _octaves(power: Any) -> Array:
    """The table of a function whose logarithm is interpolated in that of its
    argument, constant beyond the nodes."""
    first = threshold.FIRST_OCTAVE
    edges = tables.octave_edges(first, threshold.LAST_OCTAVE)
    log_x = np.log(edges)
    at = np.clip(log_x, power.x[0], power.x[-1])
    y = np.exp(power(at))
    slope = np.where(at == log_x, y * power(at, 1) / edges, 0.0)
    return tables.octave_table(first, y, slope)


def _longest(c: Contacts) -> float:
    """Length beyond which longer lives spend a share of at most 1e-5 of all time, with a
    margin of a tenth."""
    proposal = Proposal.of(c)
    p, q = np.random.default_rng(0).random((2, 2**15))
    (u, weight), (v, clock_weight) = proposal.threshold.draw(p), proposal.clock.draw(q)
    stretch = unnamed_lives(c, u, v).travel
    order = np.argsort(-stretch)
    stretch, weight = stretch[order], (weight * clock_weight)[order]
    # time spent beyond each of these lives
    beyond = np.cumsum(weight * stretch) - stretch * np.cumsum(weight)
    found = int(np.searchsorted(beyond, 1e-5 * (weight @ stretch)))
    # lives of discrete thresholds are far apart: the next longer ones may be many
    longest = max(1.1 * float(stretch[found]), float(stretch[max(found - 1, 0)]))
    mean = float(weight @ stretch / weight.sum())
    if not longest < 1100.0 * mean:
        raise InputError(
            'drive.start = "stationary": contacts that live 1000 times longer than the '
            "mean still matter, and are too rare to be found where thresholds "
            'fluctuate or contacts are born stretched; start "fresh"'
        )
    xi, stretch_at_most = extremes(c)
    return min(longest, stretch_at_most + c.newborn.reach(xi))


def mean_lives(c: Contacts, xi: Array) -> Array:
    """m(xi) = E[x_b|xi] = int_0^inf x_b(xi, E) exp(-E) dE by Gauss-Legendre panels in
    ln E, shape of `xi`. The integrand has a kink where x_b reaches xi, at the
    integrated hazard of xi; panels shrink towards it."""
    if not c.aging.closed:
        ends, kink = np.empty(xi.size), np.empty(xi.size)
        whole_lives(c, xi, ends, kink)
    elif c.barrier.thermal:
        ends = xi
        stiffness = c.springs.constant + c.springs.slope * xi
        kink = c.barrier.whole_hazard(xi, stiffness)
    if not c.barrier.thermal:
        return xi.copy() if c.aging.closed else ends
    low, top = -46.0, math.log(50.0)
    last = np.clip(np.log(np.maximum(kink, 1e-300)), low, top)
    wide, narrow = np.linspace(1.0, 0.05, 28), 0.025 * 2.0 ** -np.arange(0.0, 20.0, 2.0)
    panels = np.concatenate((wide, narrow, [0.0]))
    total, stretch = np.zeros(xi.size), np.empty(xi.size)
    for far, near in itertools.pairwise(panels):
        a, b = last - far * (last - low), last - near * (last - low)
        half = 0.5 * (b - a)
        for node, weight in zip(*gauss_legendre(10), strict=True):
            log_clock = 0.5 * (a + b) + half * node
            clock = np.exp(log_clock)
            stretches(c, xi, clock, stretch)
            total += half * weight * stretch * np.exp(log_clock - clock)
    # what is left breaks next to where it is then, or at its threshold
    stretches(c, xi, np.exp(last), stretch)
    return total + np.where(last < top, ends, stretch) * np.exp(-np.exp(last))


def extremes(c: Contacts) -> tuple[float, float]:
    """Bounds of the threshold that sets a stiffness, and of the stretch at breaking,
    with a margin of a tenth."""
    most = _EXTREME_PRODUCT if c.thresholds.exponentials == 2 else _EXTREME_RANK
    ranks = np.linspace(0.01, most, 2000)
    xi, stretch = np.empty((2, ranks.size))
    thresholds(c.thresholds, np.exp(-ranks), xi)
    strongest = 1.1 * float(xi.max()) * c.aging.most
    if c.aging.fluctuates:
        return strongest, strongest
    stretches(c, xi, np.full(ranks.size, _EXTREME_CLOCK), stretch)
    return strongest, 1.1 * float(stretch.max())


@kernel
def whole_lives(c: Contacts, xi: Array, ends: Array, hazard: Array) -> None:
    """Fill `ends` with the stretches at which contacts of thresholds `xi` at birth
    break mechanically, `hazard` with their integrated hazards until then."""
    for i in range(xi.size):
        ends[i], hazard[i] = whole_hazard(c.aging, c, xi[i])


@kernel
def thresholds(law: Thresholds, u: Array, xi: Array) -> None:
    """Fill `xi` with the thresholds that fractions `u` of the contacts exceed."""
    for i in range(u.size):
        xi[i] = threshold_draw(law, u[i])


@kernel
def stretches(c: Contacts, xi: Array, clock: Array, stretch: Array) -> None:
    """Fill `stretch` at breaking, for thresholds `xi` and exponential clocks
    `clock`."""
    for i in range(xi.size):
        stretch[i] = life(c.aging, c, xi[i], clock[i])


class Seen(NamedTuple):
    """A contact of the stationary state. If it is detached, `wait` is the rest of its
    delay. If it is `pinned`, `threshold` and `stretch` are those at birth, `age` its
    travel until now, which may be less than the resolution of a stretch, `length` its
    travel from birth to breaking, and `clock` its exponential clock."""

    pinned: bool
    wait: float
    threshold: float
    stretch: float
    age: float
    length: float
    clock: float


@routine(inline=True)
def seen_detached(wait: float) -> Seen:
    """A detached contact that is pinned after a wait."""
    return Seen(False, wait, 0.0, 0.0, 0.0, 0.0, 0.0)


@by_law
def snapshot(law: Any, c: Contacts, s: Stationary, key: Key, contact: int) -> Seen:
    """Draw a contact of the stationary state, by the law of births."""
    u_state, u_rest = uniforms(key, contact, 0, 0)
    if u_state >= s.pinned:
        return seen_detached(residual_delay_draw(c.delay, u_rest))
    xi, x, ends, clock = found_pinned(c, s, key, contact, u_rest)
    return Seen(True, 0.0, xi, 0.0, x, ends, clock)


@snapshot.register(Stretched)
def _try_cycles(
    law: Stretched, c: Contacts, s: Stationary, key: Key, contact: int
) -> Seen:
    """Try cycles of life and delay, each begun at a uniform time before now within the
    longest one, until one is still under way: a cycle is found in proportion to its
    length (derived)."""
    for attempt in range(32000):
        rank, tick = uniforms(key, contact, 0, 2 * attempt + 1)
        birth, part = uniforms(key, contact, 0, 2 * attempt + 2)
        age, clock = (s.longest + c.delay.mean) * part, -math.log(tick)
        xi, y = newborn_draw(law, c.thresholds, rank, birth)
        length = travel(c, xi, kappa(c.springs, xi), y, clock)
        if length > age:
            return Seen(True, 0.0, xi, y, age, length, clock)
        if length + c.delay.mean > age:
            u_rest = uniforms(key, contact, 0, 0)[1]
            rest = length + c.delay.mean - age
            if c.delay.random > 0.0:
                rest = residual_delay_draw(c.delay, u_rest)
            return seen_detached(rest)
    return seen_detached(0.0)  # reached by one contact in e^32


@routine(inline=True)
def found_pinned(
    c: Contacts, s: Stationary, key: Key, contact: int, u: float
) -> tuple[Any, Any, Any, Any]:
    """Threshold at birth, stretch now, stretch at breaking and exponential clock of a
    pinned contact of the stationary state."""
    steps = c.thresholds.steps
    if steps.size > 0:
        rank = min(search(s.share, u, True), steps.size - 1)
        xi, m = steps[rank], s.step_life[rank]
    else:
        e = look_up(s.biased, -math.log(u))
        xi, m = threshold_draw(c.thresholds, math.exp(-e)), look_up(s.life, e)
    top = end(c.aging, xi)
    m = min(m * _ENVELOPE_MARGIN, top)
    # share of the envelope's area where it is 1
    plateau = 1.0 / (1.0 + math.log(top / m))
    draw = 1
    while True:
        u_stretch, u_clock = uniforms(key, contact, 0, draw)
        if u_stretch < plateau:
            x, log_envelope = m * (u_stretch / plateau), 0.0
        else:
            log_envelope = -(u_stretch / plateau - 1.0)
            x = m * math.exp(-log_envelope)
        clock = -math.log(u_clock) - log_envelope
        ends = life(c.aging, c, xi, clock)
        if ends > x:
            return xi, x, ends, clock
        draw += 1
