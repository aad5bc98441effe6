"""Quenched contacts whose thresholds age in a known way (derived), by quadrature along
their paths.

A contact born with threshold xi0 has, at stretch x (its displacement since birth), the
deterministic threshold xi(x) = xi0 s(x). Under `flow`

    s(x)^2 = rho^2 - (rho^2 - 1) exp(-alpha x),   rho = x_*f/x_*i,   alpha = 4 D x_*i/(v x_*f^2)

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
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.polynomial import chebyshev
from scipy import special

from eqsim.master.quenched import (
    Moments,
    beyond,
    births_above,
    different_steps,
    ends,
    kappa_of,
    over_births,
    rarest_that_counts,
    weakest,
)
from eqsim.model.reduced import Reduced
from eqsim.numerics.panels import ClenshawCurtis, Panels, refined
from eqsim.numerics.tables import Array

METHOD = "joint kinetic equation along flowing thresholds"

# The first panels of a path, in phi. Nodes hold both ends of a panel, where the rate is
# greatest, so that no peak of it can be missed.
_FIRST = 0.5 * math.pi * np.array([0.0, 1 / 64, 1 / 16, 1 / 4, 1 / 2, 3 / 4, 1.0])
# Where a panel is cut, and where the one that begins at 0 is.
_EVEN = np.array([0.0, 0.25, 0.5, 0.75, 1.0])
_TOWARDS_0 = np.array([0.0, 1 / 64, 1 / 16, 1 / 4, 1.0])
# The relative error that ends refinement of a path.
_RESOLVED = 1e-11
# Hazards too small to matter.
_RARE = 1e-13
# Survivals too small to matter.
_DEAD = 1e-45
# The shortest stretch that matters.
_SHORTEST = 1e-100
# The relative error that ends refinement over births.
_CONVERGED = 1e-11
# The narrowest panel of births.
_NARROWEST = 1e-3
# The least relative error that is quoted.
_ROUNDING = 1e-12

# The step of the trapezoidal rule of a hazard, and the share of it that truncation may
# miss.
_STEP = 0.45
_UNSEEN = 1e-12
# Levels of the hazard where panels end, and depths of the path where these are sought.
_LEVELS = np.array(
    [3.5, 2.75, 2.0, 1.25, 0.5, -0.5, -1.5, -3.0, -6.0, -12.0, -20.0]
)  # of ln((omega/v) H)
_DEPTHS = np.append(2.0 ** np.arange(-50.0, -5.0), np.arange(1, 33) / 32)
_NODES, _WEIGHTS = special.roots_legendre(8)


def kappa_along(contacts: Reduced, xi0: Array, xi: Array) -> Array:
    """k_i/k of contacts born with thresholds `xi0` that are `xi` now, any shapes."""
    return kappa_of(contacts, xi if contacts.aging.stiffens else xi0)


def rate(contacts: Reduced, x: Array, xi0: Array, share: float = 1.0) -> Array:
    """Thermal breaking per unit displacement at stretch x, the threshold at birth being
    xi0, arrays that broadcast; with a `share` of the barrier only. Without any it falls
    along a path."""
    if not contacts.barrier.thermal:
        return np.zeros(np.broadcast_shapes(x.shape, xi0.shape))
    xi = xi0 * contacts.aging.growth_at(x)
    a = share * contacts.barrier.b * kappa_along(contacts, xi0, xi)
    with np.errstate(divide="ignore"):  # a stiff contact at its threshold
        return np.exp(
            contacts.barrier.log_w + contacts.barrier.log_rate(x, np.maximum(xi, x), a)
        )


class _Integrals(NamedTuple):
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


def _on_path(
    contacts: Reduced, xi0: Array, end: Array, left: Array, right: Array
) -> tuple[Array, Array, Array]:
    """Stretch, dx/dt and rate at the nodes t of panels of paths, shape (panels, nodes)."""
    half = 0.5 * (right - left)[:, None]
    phi = left[:, None] + half * (1 + ClenshawCurtis.nodes)
    # x = end sin^2(phi) makes a stiff rate smooth at the threshold
    x = end[:, None] * np.sin(phi) ** 2
    width = half * end[:, None] * np.sin(2 * phi)
    return x, width, rate(contacts, x, xi0[:, None])


def _integrals(
    contacts: Reduced, xi0: Array, end: Array, left: Array, right: Array
) -> Array:
    """`_Integrals`, as rows, of paths from births `xi0` to `end`, each of shape
    (panels,)."""
    x, width, per_x = _on_path(contacts, xi0, end, left, right)
    xi0, hazard = xi0[:, None], per_x * width
    # where the panel is too wide for its polynomial, that may be negative
    passed = np.maximum(hazard @ ClenshawCurtis.cumulative, 0.0)
    alive = np.exp(-passed) * width
    integrands = np.array(
        [
            alive,
            alive * kappa_along(contacts, xi0, xi0 * contacts.aging.growth_at(x)) * x,
        ]
    )
    # the least barrier on any piece of a path is at one of its ends, and that at the
    # end of life is 0
    first = left == 0
    peak = np.where(
        first,
        np.maximum(per_x[:, 0], per_x[:, -1]),
        rate(contacts, x[:, 0], xi0[:, 0], 0.0),
    ) * np.ptp(x, axis=1)
    whole = passed[:, -1]
    blind = (peak > _RARE) & ((peak > 20 * whole) | (first & (whole > 0.5)))
    blind &= first | ((right == _FIRST[-1]) & (np.cos(left) > 1e-7))
    tails = np.abs(
        np.concatenate((hazard[None], integrands)) @ ClenshawCurtis.tail
    ).sum(axis=2)
    return np.concatenate(
        (whole[None], integrands @ ClenshawCurtis.weights, tails, blind[None])
    )


def life_moments(contacts: Reduced, xi0: Array) -> tuple[Array, Array]:
    """Moments of lives along paths.

    Parameters
    ----------
    xi0 : ndarray, shape (n,)
        Thresholds at birth.

    Returns
    -------
    moments, errors : ndarray, shape (2, n)
        int S dx and int kappa x S dx, and bounds of their errors.
    """
    _, found = _resolved(contacts, xi0, ends(contacts, xi0))
    return found


def _resolved(
    contacts: Reduced, xi0: Array, end: Array
) -> tuple[Panels, tuple[Array, Array]]:
    """The panels of paths from births `xi0` to `end`, (n,), and what `life_moments`
    returns.

    Panels are split until the highest coefficients of the hazard, times the life that
    is left, and of the integrands are negligible.
    """
    n = xi0.size

    def judge(panels: Panels) -> tuple[Array, tuple[Array, Array]]:
        of = _Integrals(*panels.values)
        counts = np.bincount(panels.interval, minlength=n)
        at = (
            panels.interval,
            np.arange(panels.interval.size)
            - np.repeat(np.cumsum(counts) - counts, counts),
        )
        table = np.zeros((3, n, counts.max() + 1))
        table[0, at[0], at[1] + 1] = of.hazard
        alive = np.exp(-table[0].cumsum(axis=1)[at])
        table[1:, at[0], at[1]] = alive * panels.values[1:3]
        moments = table[1:].sum(axis=2)
        onward = table[1:, :, ::-1].cumsum(axis=2)[:, :, ::-1][:, at[0], at[1]]
        errors = alive * panels.values[4:6] + (of.hazard_tail + of.blind) * onward
        rough = (errors > _RESOLVED * moments[:, panels.interval]).any(axis=0) & (
            panels.right - panels.left > 1e-14 * panels.right
        )
        rough |= (of.blind > 0) & (alive > _DEAD)
        return rough & (panels.right > _SHORTEST), (
            moments,
            np.array([np.bincount(panels.interval, e, n) for e in errors]),
        )

    return refined(
        lambda left, right, path: _integrals(
            contacts, xi0[path], end[path], left, right
        ),
        judge,
        _FIRST,
        intervals=n,
        pieces=_EVEN,
        pieces_at_0=_TOWARDS_0,
    )


def stationary(contacts: Reduced) -> Moments:
    """Moments of the lives of quenched contacts that age in a known way (derived); the
    errors are what is left unresolved along paths and across births."""
    if contacts.law.steps.size:
        xi0, share, _ = different_steps(contacts)
        total, error = (part @ share for part in life_moments(contacts, xi0))
    else:
        total, error = over_births(
            contacts.law,
            lambda xi0: life_moments(contacts, xi0),
            _CONVERGED,
            _NARROWEST,
        )
        rarest = beyond(contacts)
        total, error = total + rarest, error + rarest
    return Moments(*total.tolist(), *(error + _ROUNDING * total).tolist())


def survivors(contacts: Reduced, x: Array) -> Array:
    """S(x) = P(x_b > x), E[kappa; x_b > x] and E[kappa^2; x_b > x] at x > 0, shape (3,
    n), kappa now."""
    if not contacts.law.steps.size:
        return _survivors_of_density(contacts, x)
    total, grown = np.zeros((3, x.size)), contacts.aging.growth_at(x)
    xi0, shares, _ = different_steps(contacts)
    for xi, share, alive in zip(xi0, shares, _survivals(contacts, xi0, x), strict=True):
        total += (
            share
            * kappa_along(contacts, np.full(x.size, xi), xi * grown)
            ** np.arange(3)[:, None]
            * alive
        )
    return total


def _survivals(contacts: Reduced, xi0: Array, x: Array) -> Iterator[Array]:
    """S(x|xi0) at x > 0 of each of some births, from the polynomials of the hazard in
    the panels of its path."""
    end = ends(contacts, xi0)
    p, _ = _resolved(contacts, xi0, end)
    _, width, per_x = _on_path(
        contacts, xi0[p.interval], end[p.interval], p.left, p.right
    )
    hazards = chebyshev.chebint(
        ClenshawCurtis.coefficients @ (per_x * width).T, lbnd=-1
    )
    for i in range(xi0.size):
        mine, inside = p.interval == i, x < end[i]
        left, right, hazard = p.left[mine], p.right[mine], hazards[:, mine]
        before = np.append(
            0.0, np.cumsum(hazard.sum(axis=0))
        )  # at 1 every Chebyshev polynomial is 1
        phi = np.arcsin(np.sqrt(x[inside] / end[i]))
        panel = np.clip(np.searchsorted(left, phi, side="right") - 1, 0, left.size - 1)
        t = np.clip(
            (2 * phi - left[panel] - right[panel]) / (right[panel] - left[panel]),
            -1.0,
            1.0,
        )
        spent = before[panel] + chebyshev.chebval(t, hazard[:, panel], tensor=False)
        alive = np.zeros(x.size)
        alive[inside] = np.exp(-np.maximum(spent, 0.0))
        yield alive


def _survivors_of_density(contacts: Reduced, x: Array) -> Array:
    """`survivors` of a smooth law, over births xi0 > x/s(x), by panels
    that end at fixed shares of the stronger contacts and where the hazard passes fixed
    levels."""
    law, grown = contacts.law, contacts.aging.growth_at(x)
    least = x / grown
    layer = weakest(law) + np.zeros((x.size, 1))
    if contacts.barrier.thermal:
        layer = np.concatenate((layer, _births_at(contacts, x, least)), axis=1)
    edges = births_above(law, least, layer, rarest_that_counts(contacts.barrier))
    half = 0.5 * np.diff(edges, axis=1)[:, :, None]
    xi0 = (edges[:, :-1, None] + half * (1 + _NODES)).reshape(x.size, -1)
    with np.errstate(invalid="ignore"):
        weight = (
            (half * _WEIGHTS).reshape(x.size, -1) * law.pdf(xi0 * law.scale) * law.scale
        )
        weight *= np.exp(-_hazard(contacts, x, xi0))
    weight = np.where(np.isfinite(weight), weight, 0.0)
    kappa = kappa_along(contacts, xi0, xi0 * grown[:, None])
    return np.array([(weight * kappa**power).sum(axis=1) for power in range(3)])


def _hazard(contacts: Reduced, x: Array, xi0: Array) -> Array:
    """(omega/v) int_0^x r dy along the paths of births `xi0`, shape (n, any), to
    stretches x (n,).

    ln r may be steep at either end: the trapezoidal rule in ln(y/(x - y)) converges
    exponentially whatever the slopes, with as many nodes as it takes to leave out a
    hazard of 1e-12.
    """
    found = np.zeros(xi0.shape)
    if not contacts.barrier.thermal:
        return found
    reach = contacts.barrier.log_w + np.log(x) - math.log(_UNSEEN)
    for i in np.flatnonzero(reach > 0):
        u = _STEP * np.arange(
            -math.ceil(reach[i] / _STEP), math.ceil(reach[i] / _STEP) + 1
        )
        y = x[i] * special.expit(u)
        found[i] = rate(contacts, y, xi0[i, :, None]) @ (_STEP * y * special.expit(-u))
    return found


def _births_at(contacts: Reduced, x: Array, least: Array) -> Array:
    """Roughly the birth whose hazard at x passes each level, shape (n, levels): only
    panels depend on it."""
    rarest = max(60.0, rarest_that_counts(contacts.barrier))
    beyond = (
        np.maximum(
            float(contacts.law.inverse_survival(rarest)) / contacts.law.scale - least,
            1e-3 * least,
        )[:, None]
        * _DEPTHS
    )
    with np.errstate(divide="ignore"):
        log_hazard = np.log(_hazard(contacts, x, least[:, None] + beyond))
        for _ in range(2):
            # stronger contacts are safer; where attempts hardly need energy that may
            # fail, but there nothing is steep
            falling = np.maximum(np.minimum.accumulate(log_hazard, axis=1), -1e3)
            found = np.array(
                [
                    np.interp(-_LEVELS, -h, d)
                    for h, d in zip(falling, beyond, strict=True)
                ]
            )
            beyond = np.concatenate((beyond, found), axis=1)
            log_hazard = np.concatenate(
                (log_hazard, np.log(_hazard(contacts, x, least[:, None] + found))),
                axis=1,
            )
            order = np.argsort(beyond, axis=1)
            beyond, log_hazard = (
                np.take_along_axis(part, order, axis=1) for part in (beyond, log_hazard)
            )
    return least[:, None] + found
