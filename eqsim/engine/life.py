"""One contact's life: threshold and stiffness at birth, and the stretch at which it breaks, drawn exactly."""

import math

import numpy as np

from eqsim.compiled import inlined, kernel
from eqsim.ensemble import POOLED, SOFT, STIFF, Contacts
from eqsim.laws.octaves import Array
from eqsim.laws.stiffness import kappa
from eqsim.laws.thermal import pooled_stretch, soft_stretch, stiff_stretch
from eqsim.laws.threshold import threshold_draw


@inlined
def break_stretch(c: Contacts, xi: float, clock: float) -> float:
    """Where a contact of threshold `xi` breaks whose exponential clock shows `clock`."""
    if c.breaking == SOFT:
        return soft_stretch(c.erfi_inverse, xi, c.b * kappa(c.kappa_slope, c.kappa_constant, xi), c.log_w, clock)
    if c.breaking == STIFF:
        return stiff_stretch(xi, c.b * kappa(c.kappa_slope, c.kappa_constant, xi), c.log_w, clock)
    if c.breaking == POOLED:
        return min(xi, pooled_stretch(c.pool_x, c.pool_G, c.pool_slopes, clock * math.exp(-c.log_w)))
    return xi


@inlined
def draw_lives(c: Contacts, u: Array, v: Array, stiffness: Array, stretch: Array, lanes: int) -> None:
    """Relative stiffness k_i/k and stretch at breaking of `lanes` lives, from the uniforms `u` (threshold) and `v`
    (clock). One pass per law, so that each loop is simple."""
    for i in range(lanes):
        stretch[i] = threshold_draw(c.threshold_table, c.steps, u[i])
    for i in range(lanes):
        stiffness[i] = kappa(c.kappa_slope, c.kappa_constant, stretch[i])
    if c.breaking == SOFT:
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
    """Relative stiffness and stretch at breaking of 64 x 64 lives, at mid-points of equal shares of thresholds and of
    clocks: a rough picture of births that costs nothing."""
    share = (np.arange(64) + 0.5) / 64
    u, v = (grid.ravel() for grid in np.meshgrid(share, share))
    stiffness, stretch = np.empty(u.size), np.empty(u.size)
    lives(c, u, v, stiffness, stretch)
    return stiffness, stretch


@kernel
def lives(c: Contacts, u: Array, v: Array, stiffness: Array, stretch: Array) -> None:
    """`draw_lives` for Python: fills `stiffness` and `stretch`, shape (n,), from uniforms of the same shape."""
    draw_lives(c, u, v, stiffness, stretch, u.size)
