"""One contact's life: threshold and stiffness at birth, the stretch at which it breaks, and the work done on it."""

import functools
import math

import numpy as np
from scipy import optimize

from eqsim.compiled import inlined, kernel
from eqsim.engine.paths import STEP, langevin_life
from eqsim.engine.streams import Key
from eqsim.engine.streams import key as key_of
from eqsim.ensemble import Contacts, Ensemble, lower
from eqsim.laws.aging import FLOW, LANGEVIN, flow_stretch
from eqsim.laws.octaves import Array, look_up
from eqsim.laws.stiffness import kappa
from eqsim.laws.thermal import POOLED, SOFT, STIFF, pooled_stretch, soft_stretch, stiff_stretch
from eqsim.laws.threshold import threshold_draw


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
        return stiffness * look_up(c.spring_work, x)
    return 0.5 * stiffness * x * x


@inlined
def draw_lives(c: Contacts, u: Array, v: Array, stiffness: Array, stretch: Array, lanes: int) -> None:
    """Relative stiffness k_i/k at birth and stretch at breaking of `lanes` lives, from the uniforms `u` (threshold) and
    `v` (clock); not `langevin`. One pass per law, so that each loop is simple."""
    for i in range(lanes):
        stretch[i] = threshold_draw(c.threshold_table, c.steps, u[i])
    for i in range(lanes):
        stiffness[i] = kappa(c.kappa_slope, c.kappa_constant, stretch[i])
    if c.aging == FLOW:
        for i in range(lanes):
            stretch[i] = break_stretch(c, stretch[i], -math.log(v[i]))
    elif c.breaking == SOFT:
        for i in range(lanes):
            stretch[i] = soft_stretch(c.erfi_inverse, stretch[i], c.b * stiffness[i], c.log_w, -math.log(v[i]))
    elif c.breaking == STIFF:
        for i in range(lanes):
            stretch[i] = stiff_stretch(stretch[i], c.b * stiffness[i], c.log_w, -math.log(v[i]))
    elif c.breaking == POOLED:
        per_attempt = math.exp(-c.log_w)
        for i in range(lanes):
            x = pooled_stretch(c.pool_x, c.pool_G, c.pool_slopes, -math.log(v[i]) * per_attempt)
            stretch[i] = min(stretch[i], x)


def typical_lives(c: Contacts) -> tuple[Array, Array]:
    """Work over k and stretch at breaking of 64 x 64 lives, at mid-points of equal shares of thresholds and of clocks:
    a rough picture of births that costs nothing."""
    share = (np.arange(64) + 0.5) / 64
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
    fill_lives(c, key, first, u, v, step, work, stretch)
    return work, stretch


@kernel
def fill_lives(c: Contacts, key: Key, first: int, u: Array, v: Array, step: float, work: Array, stretch: Array) -> None:
    """The kernel of `lives`."""
    if c.aging == LANGEVIN:
        for i in range(u.size):
            xi = threshold_draw(c.threshold_table, c.steps, u[i])
            stretch[i], work[i] = langevin_life(c, key, first + i, 0, xi, -math.log(v[i]), step)
        return
    draw_lives(c, u, v, work, stretch, u.size)
    for i in range(u.size):
        work[i] = spring_work(c, work[i], stretch[i])
