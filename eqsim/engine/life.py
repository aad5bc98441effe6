"""One contact's life: threshold and stiffness at birth, the stretch at which it breaks, and the work done on it."""

import functools
import math

import numpy as np
from scipy import optimize

from eqsim.compiled import inlined, kernel, routine
from eqsim.engine.paths import STEP, PathLaw, langevin_lives, path_law
from eqsim.engine.streams import ROUGH, Key, fill_words, fine_product, product, uniform
from eqsim.engine.streams import key as key_of
from eqsim.ensemble import Contacts, Ensemble, lower
from eqsim.laws.aging import FLOW, LANGEVIN, UNAGED, flow_stretch, flow_work
from eqsim.laws.elementary import log
from eqsim.laws.octaves import Array, look_up_all
from eqsim.laws.stiffness import kappa
from eqsim.laws.thermal import (
    MECHANICAL,
    POOLED,
    SOFT,
    STIFF,
    pooled_stretch,
    soft_end,
    soft_odds,
    soft_rank,
    soft_stretch,
    stiff_end,
    stiff_odds,
    stiff_spent,
    stiff_stretch,
)
from eqsim.laws.threshold import exponential_threshold, threshold_draw

LANES = 256  # contacts that advance together
ROUNDS = 2  # lives of a contact that are drawn together


@inlined
def break_stretch(c: Contacts, xi: float, clock: float) -> float:
    """Where a contact of threshold `xi` at birth breaks whose exponential clock shows `clock` (not `langevin`)."""
    if c.aging == FLOW:
        slope, constant = c.kappa_slope, c.kappa_constant
        return flow_stretch(c.final2, c.alpha, c.breaking, slope, constant, c.b, c.log_w, xi, clock)[0]
    if c.breaking == SOFT:
        return soft_stretch(c.erfi_inverse, xi, c.b * kappa(c.kappa_slope, c.kappa_constant, xi), c.log_w, clock)
    if c.breaking == STIFF:
        return stiff_stretch(xi, c.b * kappa(c.kappa_slope, c.kappa_constant, xi), c.log_w, clock)
    if c.breaking == POOLED:
        return min(xi, pooled_stretch(c.pool_x, c.pool_G, c.pool_slopes, clock * math.exp(-c.log_w)))
    return xi


@inlined
def spring_work(c: Contacts, stiffness: float, x: float) -> float:
    """int_0^x (k_i/k) y dy of a contact of relative stiffness `stiffness` at birth (not `langevin`)."""
    if c.aging == FLOW and c.kappa_slope > 0.0:
        return stiffness * flow_work(c.spring_work, c.final2, c.alpha, x)
    return 0.5 * stiffness * x * x


@routine
def draw_rounds(
    table: Array, steps: Array, exponentials: int, mechanical: bool, key: Key, contact: Array, turn: Array,
    index: Array, words: Array, threshold: Array, clock: Array, lanes: int,
) -> None:  # fmt: skip
    """Thresholds and clocks, shape (ROUNDS, lanes), of the next ROUNDS lives of `lanes` contacts, each `turn` times
    ROUNDS lives old.

    Half of a Philox result serves one draw. Where no clock is needed, the two halves are the thresholds of two lives.
    """
    for r in range(ROUNDS):
        if not mechanical or r == 0:
            for i in range(lanes):
                index[i] = turn[i] if mechanical else ROUNDS * turn[i] + r
            fill_words(key, contact, index, 0, words, lanes)
        half = r if mechanical else 0
        if exponentials == 2:
            rough = 0
            for i in range(lanes):
                p = product(words[2 * half, i], words[2 * half + 1, i])
                threshold[r, i] = p
                rough += p < ROUGH
            if rough > 0:
                for i in range(lanes):
                    if threshold[r, i] < ROUGH:
                        threshold[r, i] = fine_product(
                            key, contact[i], index[i], 2 + half, words[2 * half, i], words[2 * half + 1, i]
                        )
        else:
            for i in range(lanes):
                threshold[r, i] = uniform(words[2 * half, i], words[2 * half + 1, i])
        if exponentials > 0:
            for i in range(lanes):
                threshold[r, i] = exponential_threshold(threshold[r, i])
        else:
            draw_thresholds(table, steps, r, threshold, index, lanes)
        if not mechanical:
            for i in range(lanes):
                clock[r, i] = -log(uniform(words[2, i], words[3, i]))


@routine
def draw_thresholds(table: Array, steps: Array, r: int, u: Array, row: Array, lanes: int) -> None:
    """Thresholds in the place of the uniforms u[r]; `row` is scratch."""
    if steps.size > 0:
        for i in range(lanes):
            u[r, i] = threshold_draw(table, steps, u[r, i])
        return
    for i in range(lanes):
        u[r, i] = -log(u[r, i])
    look_up_all(table, r, u, row, lanes)


# Laws of breaking for many contacts: stiffness at birth, and stretch at breaking in the place of thresholds. Each is a
# pass of its own, so that loops are simple, and takes the arrays it needs and no more, because numba counts references.


@routine
def stiffen_all(slope: float, constant: float, r: int, threshold: Array, stiffness: Array, lanes: int) -> None:
    """Relative stiffness k_i/k at birth."""
    for i in range(lanes):
        stiffness[r, i] = kappa(slope, constant, threshold[r, i])


@routine
def soft_all(
    erfi_inverse: Array, b: float, log_w: float, even: bool, r: int,
    stretch: Array, clock: Array, stiffness: Array, row: Array, lanes: int,
) -> None:  # fmt: skip
    """Soft contacts, `even` if k_i = k, so that roots and divisions are the same for all; clocks are overwritten."""
    if even:
        root, per_root = math.sqrt(b), 1.0 / math.sqrt(b)
        for i in range(lanes):
            clock[r, i] = soft_odds(stretch[r, i], root, log_w, clock[r, i])
        for i in range(lanes):
            clock[r, i] = soft_rank(stretch[r, i], root, log_w, clock[r, i])
        look_up_all(erfi_inverse, r, clock, row, lanes)
        for i in range(lanes):
            stretch[r, i] = soft_end(stretch[r, i], per_root, clock[r, i])
    else:
        for i in range(lanes):
            clock[r, i] = soft_odds(stretch[r, i], math.sqrt(b * stiffness[r, i]), log_w, clock[r, i])
        for i in range(lanes):
            clock[r, i] = soft_rank(stretch[r, i], math.sqrt(b * stiffness[r, i]), log_w, clock[r, i])
        look_up_all(erfi_inverse, r, clock, row, lanes)
        for i in range(lanes):
            stretch[r, i] = soft_end(stretch[r, i], 1.0 / math.sqrt(b * stiffness[r, i]), clock[r, i])


@routine
def stiff_all(b: float, log_w: float, r: int, stretch: Array, clock: Array, stiffness: Array, lanes: int) -> None:
    """Stiff contacts; clocks are overwritten."""
    for i in range(lanes):
        clock[r, i] = stiff_odds(stretch[r, i], b * stiffness[r, i], log_w, clock[r, i])
    for i in range(lanes):
        clock[r, i] = stiff_spent(stretch[r, i], b * stiffness[r, i], log_w, clock[r, i])
    for i in range(lanes):
        stretch[r, i] = stiff_end(stretch[r, i], clock[r, i])


@routine
def pooled_all(
    x: Array, G: Array, slopes: Array, log_w: float, r: int, stretch: Array, clock: Array, lanes: int
) -> None:
    """Annealed contacts."""
    per_attempt = math.exp(-log_w)
    for i in range(lanes):
        stretch[r, i] = min(stretch[r, i], pooled_stretch(x, G, slopes, clock[r, i] * per_attempt))


@routine
def flow_all(c: Contacts, r: int, stretch: Array, clock: Array, lanes: int) -> None:
    """Contacts whose thresholds flow."""
    for i in range(lanes):
        stretch[r, i] = break_stretch(c, stretch[r, i], clock[r, i])


@routine
def langevin_all(
    paths: PathLaw, key: Key, contact: Array, turn: Array, stretch: Array, clock: Array, life: Array, lanes: int
) -> None:
    """Contacts whose thresholds fluctuate, for all rounds; work over k in the place of clocks; `life` is scratch."""
    for r in range(ROUNDS):
        for i in range(lanes):
            life[i] = ROUNDS * turn[i] + r
        x, spent = stretch[r, :lanes], clock[r, :lanes]
        langevin_lives(paths, key, STEP, contact, life, x, spent, x, spent)


@inlined
def break_all(c: Contacts, stretch: Array, clock: Array, stiffness: Array, row: Array, lanes: int) -> None:
    """The law that holds (none of `langevin`), for all rounds; clocks are overwritten, `row` is scratch."""
    for r in range(stretch.shape[0]):
        stiffen_all(c.kappa_slope, c.kappa_constant, r, stretch, stiffness, lanes)
        if c.aging == FLOW:
            flow_all(c, r, stretch, clock, lanes)
        elif c.breaking == SOFT:
            even = c.kappa_slope == 0.0
            soft_all(c.erfi_inverse, c.b, c.log_w, even, r, stretch, clock, stiffness, row, lanes)
        elif c.breaking == STIFF:
            stiff_all(c.b, c.log_w, r, stretch, clock, stiffness, lanes)
        elif c.breaking == POOLED:
            pooled_all(c.pool_x, c.pool_G, c.pool_slopes, c.log_w, r, stretch, clock, lanes)


def typical_lives(c: Contacts) -> tuple[Array, Array]:
    """Work over k and stretch at breaking of 64 x 64 lives, at mid-points of equal shares of thresholds and of clocks:
    a rough picture of births that costs nothing; of 16 x 16 where thresholds fluctuate and lives cost something."""
    shares = 16 if c.aging == LANGEVIN else 64
    share = (np.arange(shares) + 0.5) / shares
    u, v = (grid.ravel() for grid in np.meshgrid(share, share))
    return lives(c, key_of(0, 0), 0, u, v)


@functools.lru_cache(maxsize=32)
def rough_stretch(ensemble: Ensemble, velocity: float) -> float | None:
    """The mean stretch at breaking C (length) of annealed contacts that age, to a few per cent, from `typical_lives`
    whose births have aged accordingly; None for all others, whose births do not depend on it."""
    if not ensemble.self_consistent:
        return None

    def next_one(log_stretch: float) -> float:
        c = lower(ensemble, velocity, math.exp(log_stretch))
        return math.log(float(typical_lives(c)[1].mean()) * ensemble.thresholds.scale)

    found = optimize.fixed_point(next_one, math.log(ensemble.thresholds.mean), xtol=1e-3, maxiter=100)
    return math.exp(float(found))


def lives(c: Contacts, key: Key, first: int, u: Array, v: Array, step: float = STEP) -> tuple[Array, Array]:
    """Work over k and stretch at breaking of lives from uniforms `u` (threshold) and `v` (clock), shape (n,). Paths of
    `langevin` thresholds are those of contacts `first`, `first` + 1, ... and take steps of accuracy `step`."""
    work, stretch = np.empty(u.size), np.empty(u.size)
    fill_lives(c, path_law(c), key, first, u, v, step, work, stretch)
    return work, stretch


@kernel
def fill_lives(
    c: Contacts, paths: PathLaw | None, key: Key, contact: int, u: Array, v: Array, step: float, work: Array,
    stretch: Array,
) -> None:  # fmt: skip
    """The kernel of `lives`."""
    r = np.int64(0)  # typed: a literal 0 would be compiled for itself
    if paths is not None:
        for i in range(u.size):
            stretch[i], work[i] = threshold_draw(c.threshold_table, c.steps, u[i]), -log(v[i])
        contacts, first_lives = np.arange(contact, contact + u.size), np.zeros(u.size, np.int64)
        langevin_lives(paths, key, step, contacts, first_lives, stretch, work, stretch, work)
        return
    x, clock, spring = np.empty((1, LANES)), np.empty((1, LANES)), np.empty((1, LANES))
    row = np.empty(LANES, np.int64)
    for first in range(0, u.size, LANES):
        lanes = min(LANES, u.size - first)
        for i in range(lanes):
            x[r, i], clock[r, i] = u[first + i], -log(v[first + i])
        draw_thresholds(c.threshold_table, c.steps, r, x, row, lanes)
        break_all(c, x, clock, spring, row, lanes)
        for i in range(lanes):
            stretch[first + i] = x[r, i]
            work[first + i] = spring_work(c, spring[r, i], x[r, i])


@kernel
def plain_sums(
    c: Contacts, paths: PathLaw | None, key: Key, first: int, begin: int, end: int
) -> tuple[float, float, float, float]:
    """Sums, and largest terms, of work over k and of stretch at breaking over plainly drawn lives: those of the LANES
    contacts from `first` on in their turns begin <= turn < end, ROUNDS lives each."""
    contact, turn, index = np.arange(first, first + LANES), np.full(LANES, begin), np.empty(LANES, np.int64)
    words, stiffness = np.empty((4, LANES), np.uint64), np.empty((ROUNDS, LANES))
    stretch, clock = np.empty((ROUNDS, LANES)), np.full((ROUNDS, LANES), math.inf)
    work, total, most_work, most = np.zeros(LANES), np.zeros(LANES), np.zeros(LANES), np.zeros(LANES)
    table, steps = c.threshold_table, c.steps
    for at in range(begin, end):
        draw_rounds(
            table, steps, c.exponentials, c.breaking == MECHANICAL, key, contact, turn,
            index, words, stretch, clock, LANES,
        )  # fmt: skip
        if paths is not None:
            langevin_all(paths, key, contact, turn, stretch, clock, index, LANES)
        else:
            break_all(c, stretch, clock, stiffness, index, LANES)
        for r in range(ROUNDS):
            if c.aging == FLOW:
                for i in range(LANES):
                    clock[r, i] = spring_work(c, stiffness[r, i], stretch[r, i])
            elif c.aging == UNAGED:
                for i in range(LANES):
                    clock[r, i] = 0.5 * stiffness[r, i] * stretch[r, i] * stretch[r, i]
            for i in range(LANES):  # sums of each lane: a single one would have to wait for every addition
                work[i] += clock[r, i]
                total[i] += stretch[r, i]
                most_work[i] = max(most_work[i], clock[r, i])
                most[i] = max(most[i], stretch[r, i])
        for i in range(LANES):
            turn[i] = at + 1
    return work.sum(), total.sum(), most_work.max(), most.max()
