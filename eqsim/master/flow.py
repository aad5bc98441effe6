"""Quenched contacts whose thresholds age in a known way (derived), by quadrature along
their paths.

A contact born with threshold xi0 has, at stretch x (its displacement since birth), the
deterministic threshold xi(x) = xi0 s(x). Under `flow`

    s(x)^2 = rho^2 - (rho^2 - 1) exp(-alpha x),
    rho = x_*f/x_*i,   alpha = 4 D x_*i/(v x_*f^2)

in units of x_*i, the scale of the newborn law: at every age the law of unbroken
thresholds is that of the Smoluchowski equation from P_ci to P_cf, without its
fluctuations. Under `logarithmic`, s(x) = 1 + beta ln(1 + x/(v t_c)). A contact breaks
mechanically where xi(x) = x, thermally at the rate of `laws.barrier` for its current
threshold,

    S(x|xi0) = exp(-(omega/v) int_0^x r(y, xi(y)) dy),

and with the sqrt law its stiffness follows the threshold under `flow`, and is that at
birth under `logarithmic`. C and friction are those of the joint kinetic equation,

    C = E[int S dx],        friction * C = E[int (k_i(x)/k) x S dx]        (no delay).

Flow is over after 1/alpha, logarithms begin at v t_c, lives may end at v/omega, and ln
r may fall and then rise with slopes of 1e9; no two of these scales are related, and the
panels of the path are found by refinement.
"""

import math
from typing import NamedTuple

import numpy as np
from scipy import special

from eqsim.master.quenched import (
    beyond,
    ends,
    kappa_of,
    over_births,
)
from eqsim.model.reduced import Reduced
from eqsim.numerics.panels import ClenshawCurtis, Panels, refined
from eqsim.numerics.tables import Array

# The first panels of a path, in phi. Nodes hold both ends of a panel, where the rate is
# greatest, so that no peak of it can be missed.
_FIRST_PANELS = (
    0.5 * math.pi * np.array([0.0, 1 / 64, 1 / 16, 1 / 4, 1 / 2, 3 / 4, 1.0])
)
# Where a panel is cut, and where the one that begins at 0 is.
_EVEN = np.array([0.0, 0.25, 0.5, 0.75, 1.0])
_TOWARDS_0 = np.array([0.0, 1 / 64, 1 / 16, 1 / 4, 1.0])
# The relative error that ends refinement of a path.
_RESOLVED_PATH = 1e-11
# Hazards too small to matter.
_RARE_HAZARD = 1e-13
# Survivals too small to matter.
_DEAD = 1e-45
# The shortest stretch that matters.
_SHORTEST_STRETCH = 1e-100
# The relative error that ends refinement over births.
_CONVERGED_BIRTHS = 1e-11
# The narrowest panel of births.
_NARROWEST_PATHS = 1e-3
# The least relative error that is quoted.
_ROUNDED_PATHS = 1e-12

# The step of the trapezoidal rule of a hazard, and the share of it that truncation may
# miss.
_STEP_IN_U = 0.45
_UNSEEN_HAZARD = 1e-12
# Numbers of nodes on either side are multiples of this one.
_NODES_APART = 16
# Rates that are found at once, to bound memory.
_RATES_AT_ONCE = 300_000


def kappa_along(contacts: Reduced, xi0: Array, xi: Array) -> Array:
    """k_i/k of contacts born with thresholds `xi0` that are `xi` now, any shapes."""
    return kappa_of(contacts, xi if contacts.aging.stiffens else xi0)


def rate_along(contacts: Reduced, x: Array, xi0: Array, share: float = 1.0) -> Array:
    """Thermal breaking per unit displacement at stretch x, the threshold at birth being
    xi0, arrays that broadcast; with a `share` of the barrier only. Without any it falls
    along a path."""
    if not contacts.barrier.thermal:
        return np.zeros(np.broadcast_shapes(x.shape, xi0.shape))
    return np.exp(_log_rate_along(contacts, x, xi0, share))


def _log_rate_along(
    contacts: Reduced, x: Array, xi0: Array, share: float = 1.0
) -> Array:
    """ln of `rate_along` with heat, up to 300."""
    xi, barrier = xi0 * contacts.aging.growth_at(x), contacts.barrier
    a = share * barrier.b * kappa_along(contacts, xi0, xi)
    log_rate = barrier.log_w + barrier.log_rate(x, np.maximum(xi, x), a)
    return np.asarray(np.minimum(log_rate, 300.0))


class _PathIntegrals(NamedTuple):
    """Integrals over panels of paths, each array of shape (panels,): the hazard inside;
    int S dx and int kappa x S dx with S = 1 at the left end; the highest Chebyshev
    coefficients of the hazard and of the two integrands, which say whether the panel
    resolves them; and whether its nodes may have missed a peak at either end of a path,
    where dx/dphi = 0."""

    hazard: Array
    stretch: Array
    work: Array
    hazard_tail: Array
    stretch_tail: Array
    work_tail: Array
    blind: Array


def _integrals(
    contacts: Reduced, xi0: Array, end: Array, left: Array, right: Array
) -> Array:
    """`_PathIntegrals`, as rows, of paths from births `xi0` to `end`, each of shape
    (panels,)."""
    half, xi0 = 0.5 * (right - left)[:, None], xi0[:, None]
    phi = left[:, None] + half * (1 + ClenshawCurtis.nodes)
    # x = end sin^2(phi) makes a stiff rate smooth at the threshold
    x = end[:, None] * np.sin(phi) ** 2
    width = half * end[:, None] * np.sin(2 * phi)  # dx/dt
    per_x = rate_along(contacts, x, xi0)
    hazard = per_x * width
    # where the panel is too wide for its polynomial, that may be negative
    passed = np.maximum(hazard @ ClenshawCurtis.cumulative, 0.0)
    alive = np.exp(-passed) * width
    kappa = kappa_along(contacts, xi0, xi0 * contacts.aging.growth_at(x))
    integrands = np.array([alive, alive * kappa * x])
    # the least barrier on any piece of a path is at one of its ends, and that at the
    # end of life is 0
    first, whole = left == 0, passed[:, -1]
    bare = rate_along(contacts, x[:, 0], xi0[:, 0], 0.0)
    peak = np.where(first, np.maximum(per_x[:, 0], per_x[:, -1]), bare)
    peak *= np.ptp(x, axis=1)
    blind = (peak > _RARE_HAZARD) & ((peak > 20 * whole) | (first & (whole > 0.5)))
    blind &= first | ((right == _FIRST_PANELS[-1]) & (np.cos(left) > 1e-7))
    every = np.concatenate((hazard[None], integrands))
    tails = np.abs(every @ ClenshawCurtis.tail).sum(axis=2)
    sums = integrands @ ClenshawCurtis.weights
    return np.concatenate((whole[None], sums, tails, blind[None]))


def path_moments(contacts: Reduced, xi0: Array) -> tuple[Array, Array]:
    """int S dx and int kappa x S dx along paths from thresholds xi0 (n,) at birth, and
    bounds of their errors, each of shape (2, n). Panels are split until the highest
    coefficients of the hazard, times the life that is left, and of the integrands are
    negligible."""
    n, end = xi0.size, ends(contacts, xi0)
    stiffest = np.maximum(*(kappa_along(contacts, xi0, xi) for xi in (xi0, end)))
    # no life is longer than without heat
    most = np.array([end, 0.5 * stiffest * end**2])

    def evaluate(left: Array, right: Array, path: Array) -> Array:
        return _integrals(contacts, xi0[path], end[path], left, right)

    def judge(panels: Panels) -> tuple[Array, tuple[Array, Array]]:
        of, path = _PathIntegrals(*panels.values), panels.interval
        counts = np.bincount(path, minlength=n)
        panel = np.arange(path.size) - np.repeat(np.cumsum(counts) - counts, counts)
        table = np.zeros((3, n, counts.max() + 1))
        table[0, path, panel + 1] = of.hazard
        alive = np.exp(-table[0].cumsum(axis=1)[path, panel])
        table[1:, path, panel] = alive * panels.values[1:3]
        moments = table[1:].sum(axis=2)
        onward = table[1:, :, ::-1].cumsum(axis=2)[:, :, ::-1][:, path, panel]
        with np.errstate(over="ignore"):  # of panels far too long
            blurred = (of.hazard_tail + of.blind) * onward
        errors = alive * panels.values[4:6] + blurred
        rough = (errors > _RESOLVED_PATH * moments[:, path]).any(axis=0)
        rough &= panels.right - panels.left > 1e-14 * panels.right
        rough |= (of.blind > 0) & (alive > _DEAD)
        missed = np.array([np.bincount(path, error, n) for error in errors])
        rough &= panels.right > _SHORTEST_STRETCH
        return rough, (moments, np.minimum(missed, most))

    _, (moments, missed) = refined(
        evaluate,
        judge,
        _FIRST_PANELS,
        intervals=n,
        pieces=_EVEN,
        pieces_at_0=_TOWARDS_0,
    )
    return moments, missed


def moments_along_paths(contacts: Reduced) -> Array:
    """C, work and their errors, shape (4,), of quenched contacts that age in a known
    way (derived); the errors are what is left unresolved along paths and across
    births."""
    (total, error), _ = over_births(
        contacts,
        lambda _, xi0: path_moments(contacts, xi0),
        _CONVERGED_BIRTHS,
        _NARROWEST_PATHS,
    )
    rarest = beyond(contacts)
    total, error = total + rarest, error + rarest
    return np.append(total, error + _ROUNDED_PATHS * total)


def hazard_along(contacts: Reduced, x: Array, xi0: Array) -> Array:
    """(omega/v) int_0^x r dy along the paths of births `xi0` to stretches x, arrays of
    one shape.

    ln r may be steep at either end: the trapezoidal rule in ln(y/(x - y)) converges
    exponentially whatever the slopes, with as many nodes as it takes to leave out a
    hazard of 1e-12.
    """
    x_flat = np.maximum(x.ravel(), _SHORTEST_STRETCH)
    # no attempt frequency bounds the rates of bonds, which are greatest at an end
    greatest = _log_rate_along(contacts, x_flat, xi0.ravel())
    greatest = np.maximum(greatest, contacts.barrier.log_w)
    found, reach = np.zeros(x.size), greatest + np.log(x_flat)
    nodes = np.ceil((reach - math.log(_UNSEEN_HAZARD)) / _STEP_IN_U / _NODES_APART)
    for many in np.unique(nodes[nodes > 0]):
        u = _STEP_IN_U * np.arange(-many * _NODES_APART, many * _NODES_APART + 1)
        alike = np.flatnonzero(nodes == many)
        for part in np.array_split(
            alike, math.ceil(alike.size * u.size / _RATES_AT_ONCE)
        ):
            y = x_flat[part, None] * special.expit(u)
            per_u = rate_along(contacts, y, xi0.ravel()[part, None]) * y
            found[part] = per_u @ (_STEP_IN_U * special.expit(-u))
    return found.reshape(x.shape)
