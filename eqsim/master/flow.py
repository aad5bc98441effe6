"""Quenched contacts whose thresholds age by `flow` (derived), by quadrature along their paths.

A contact born with threshold xi0 has, at stretch x (its displacement since birth), the deterministic threshold

    xi(x) = xi0 s(x),   s(x)^2 = rho^2 - (rho^2 - 1) exp(-alpha x),   rho = x_*f/x_*i,   alpha = 4 D x_*i/(v x_*f^2)

in units of x_*i, the scale of the newborn law: at every age the law of unbroken thresholds is that of the Smoluchowski
equation from P_ci to P_cf, without its fluctuations. It breaks mechanically where xi(x) = x, thermally at the rate of
`laws.thermal` for its current threshold,

    S(x|xi0) = exp(-(omega/v) int_0^x r(y, xi(y)) dy),

and with the sqrt law its stiffness follows the threshold. C and friction are those of the joint kinetic equation,

    C = E[int S dx],        friction * C = E[int (k_i(x)/k) x S dx]        (no delay).

Aging is over after 1/alpha, lives may end at v/omega, and ln r may fall and then rise with slopes of 1e9; no two of
these scales are related, and the panels of the path are found by refinement.
"""

import math
from typing import NamedTuple

import numpy as np
from scipy import special
from scipy.optimize import elementwise

from eqsim.laws.aging.base import scale2
from eqsim.laws.stiffness import relative_stiffness
from eqsim.master.quenched import ClenshawCurtis, Moments, births_above, interpolated, strongest
from eqsim.model.reduced import Reduced
from eqsim.numerics.tables import Array

METHOD = "joint kinetic equation along flowing thresholds"

# the nodes of Clenshaw and Curtis hold both ends of a panel, where r is greatest, so that no peak of it can be missed
_NODES, _WEIGHTS, _TAIL = ClenshawCurtis.nodes, ClenshawCurtis.weights, ClenshawCurtis.tail

# paths: the first panels in phi, the errors that end refinement, hazards and survivals too small to matter
_FIRST = 0.5 * math.pi * np.array([0.0, 1 / 64, 1 / 16, 1 / 4, 1 / 2, 3 / 4, 1.0])
_RESOLVED, _RARE, _DEAD, _MOST_ROUNDS = 1e-11, 1e-13, 1e-45, 60
_EVEN, _TOWARDS_0 = np.array([0.0, 0.25, 0.5, 0.75, 1.0]), np.array([0.0, 1 / 64, 1 / 16, 1 / 4, 1.0])
# births: the first panels in ln(-ln J_c(xi0)), from 2^-50 to 500
_BIRTHS = np.array([-34.7, -20.0, -12.0, -7.0, -4.0, -2.0, -0.5, 0.75, 1.75, 2.75, 3.75, 5.0, 6.2])
_CONVERGED, _ROUNDING = 1e-11, 1e-12

# of survivors: their resolution; step and truncation of the hazard; its levels, where to seek them
_SMOOTH = 1e-9
_STEP, _UNSEEN = 0.45, 1e-12
_LEVELS = np.array([3.5, 2.75, 2.0, 1.25, 0.5, -0.5, -1.5, -3.0, -6.0, -12.0, -20.0])  # of ln((omega/v) H)
_DEPTHS = np.append(2.0 ** np.arange(-50.0, -5.0), np.arange(1, 33) / 32)
_FEW_NODES, _FEW_WEIGHTS = special.roots_legendre(8)


def aged(s: Reduced, x: Array) -> Array:
    """s(x): by how much thresholds have grown."""
    return np.sqrt(scale2(s.aging.final2, s.aging.alpha * x))


def rate(s: Reduced, x: Array, xi: Array) -> Array:
    """Thermal breaking per unit displacement at stretch x, the current threshold being xi."""
    return _rate(s, x, xi, s.barrier.b * relative_stiffness(s.stiffness, xi, s.rms))


def _rate(s: Reduced, x: Array, xi: Array, a: Array | float) -> Array:
    """`rate` at a = k_i/(2 kT); at a = 0 what it would be without a barrier, which falls along a path."""
    if not s.barrier.thermal:
        return np.zeros(np.broadcast_shapes(x.shape, xi.shape))
    with np.errstate(divide="ignore"):  # a stiff contact at its threshold
        return np.exp(s.barrier.log_w + s.barrier.log_rate(x, np.maximum(xi, x), a))


def _ends(s: Reduced, xi0: Array) -> Array:
    """Where contacts break mechanically: the root of xi0 s(x) = x."""
    bracket = (xi0 * min(1.0, s.aging.final), xi0 * max(1.0, s.aging.final))
    found = elementwise.find_root(lambda x, xi0: np.log(xi0 * aged(s, x) / x), bracket, args=(xi0,))
    return np.asarray(found.x)


class _Panels(NamedTuple):
    """Pieces of paths, in the order of contacts and along each path, shape (panels,): which contact, the ends in phi,
    the hazard inside, int S dx and int kappa x S dx with S = 1 at the left end (2, panels), and the highest Chebyshev
    coefficients of the hazard and of the two integrands, which say whether the panel resolves them, and whether its
    nodes may have missed a peak at either end of a path, where dx/dphi = 0."""

    contact: Array
    left: Array
    right: Array
    hazard: Array
    parts: Array
    hazard_tail: Array
    tails: Array
    blind: Array


def _panels(s: Reduced, xi0: Array, end: Array, contact: Array, left: Array, right: Array) -> _Panels:
    half = 0.5 * (right - left)[:, None]
    phi = left[:, None] + half * (1 + _NODES)
    xi0, end = xi0[contact, None], end[contact, None]
    # x = end sin^2(phi) makes a stiff rate smooth at the threshold
    x = end * np.sin(phi) ** 2
    width = half * end * np.sin(2 * phi)
    xi = xi0 * aged(s, x)
    per_x = rate(s, x, xi)
    hazard = per_x * width
    # where the panel is too wide for its polynomial, that may be negative
    passed = np.maximum(hazard @ ClenshawCurtis.cumulative, 0.0)
    alive = np.exp(-passed) * width
    work = alive * relative_stiffness(s.stiffness, xi, s.rms) * x
    # the least barrier on any piece of a path is at one of its ends, and that at the end of life is 0
    peak = np.where(left == 0, np.maximum(per_x[:, 0], per_x[:, -1]), _rate(s, x[:, 0], xi[:, 0], 0.0))
    peak *= np.ptp(x, axis=1)
    blind = (peak > _RARE) & ((peak > 20 * passed[:, -1]) | ((left == 0) & (passed[:, -1] > 0.5)))
    return _Panels(
        contact,
        left,
        right,
        passed[:, -1],
        np.array([alive @ _WEIGHTS, work @ _WEIGHTS]),
        np.abs(hazard @ _TAIL).sum(axis=1),
        np.array([np.abs(alive @ _TAIL).sum(axis=1), np.abs(work @ _TAIL).sum(axis=1)]),
        blind & ((left == 0) | ((right == _FIRST[-1]) & (np.cos(left) > 1e-7))),
    )


def life_moments(s: Reduced, xi0: Array) -> tuple[Array, Array]:
    """int S dx and int kappa x S dx of contacts born with thresholds `xi0` (n,), and bounds of their errors; both of
    shape (2, n).

    Panels are split until the highest coefficients of the hazard, times the life that is left, and of the integrands
    are negligible.
    """
    n, end = xi0.size, _ends(s, xi0)
    contact, piece = (part.ravel() for part in np.indices((n, _FIRST.size - 1)))
    p = _panels(s, xi0, end, contact, _FIRST[piece], _FIRST[piece + 1])
    for last in range(_MOST_ROUNDS, -1, -1):
        counts = np.bincount(p.contact, minlength=n)
        at = p.contact, np.arange(p.contact.size) - np.repeat(np.cumsum(counts) - counts, counts)
        table = np.zeros((3, n, counts.max() + 1))
        table[0, at[0], at[1] + 1] = p.hazard
        alive = np.exp(-table[0].cumsum(axis=1)[at])
        table[1:, at[0], at[1]] = alive * p.parts
        moments = table[1:].sum(axis=2)
        left = table[1:, :, ::-1].cumsum(axis=2)[:, :, ::-1][:, at[0], at[1]]  # of the moments, from here on
        errors = alive * p.tails + (p.hazard_tail + p.blind) * left
        split = (errors > _RESOLVED * moments[:, p.contact]).any(axis=0) & (p.right - p.left > 1e-14 * p.right)
        split |= p.blind & (alive > _DEAD)
        if last == 0 or not split.any():
            break
        p = _split(s, xi0, end, p, split)
    return moments, np.array([np.bincount(p.contact, error, n) for error in errors])


def _split(s: Reduced, xi0: Array, end: Array, p: _Panels, split: Array) -> _Panels:
    """Four panels for each marked one; the first of a path is split towards 0, where all scales are possible."""
    left, right = p.left[split, None], p.right[split, None]
    edges = left + (right - left) * np.where(left > 0, _EVEN, _TOWARDS_0)
    new = _panels(s, xi0, end, np.repeat(p.contact[split], 4), edges[:, :-1].ravel(), edges[:, 1:].ravel())
    pieces = np.where(split, 4, 1)
    fresh = np.repeat(split, pieces)
    merged = []
    for old, found in zip(p, new, strict=True):
        value = np.repeat(old, pieces, axis=-1)
        value[..., fresh] = found
        merged.append(value)
    return _Panels(*merged)


def stationary(s: Reduced) -> Moments:
    """C and work of quenched contacts under flow aging (derived).

    Births are integrated by panels in ln(-ln J_c(xi0)), paths by panels of their own; the errors are what either leave
    unresolved.
    """

    def integrate(left: Array, right: Array) -> tuple[Array, Array, Array]:
        """Both integrals over panels of ln(-ln J_c), what is left unresolved along paths, and across panels."""
        half = 0.5 * (right - left)[:, None]
        e = np.exp(left[:, None] + half * (1 + _NODES))
        moments, errors = life_moments(s, np.asarray(s.law.exceeded_by(e.ravel())) / s.law.scale)
        weight = half * e * np.exp(-e)
        terms = moments.reshape(2, *e.shape) * weight
        return terms @ _WEIGHTS, (errors.reshape(2, *e.shape) * weight) @ _WEIGHTS, np.abs(terms @ _TAIL).sum(axis=2)

    left, right = _BIRTHS[:-1], _BIRTHS[1:]
    parts, along, across = integrate(left, right)
    while True:
        total = parts.sum(axis=1)
        split = (across > _CONVERGED * total[:, None]).any(axis=0) & (right - left > 1e-3)
        if not split.any():
            break
        middle = 0.5 * (left[split] + right[split])
        new_left, new_right = np.append(left[split], middle), np.append(middle, right[split])
        found = integrate(new_left, new_right)
        left, right = np.append(left[~split], new_left), np.append(right[~split], new_right)
        parts, along, across = (
            np.append(old[:, ~split], new, axis=1) for old, new in zip((parts, along, across), found, strict=True)
        )
    error = (along + across).sum(axis=1) + _ROUNDING * total
    return Moments(float(total[0]), float(total[1]), float(error[0]), float(error[1]))


def survivors(s: Reduced, x: Array) -> Array:
    """S(x) = P(x_b > x), E[kappa(x); x_b > x] and E[kappa(x)^2; x_b > x] under flow aging at ascending x > 0, shape
    (3, n).

    To about 1e-8 of the greatest value of each, and of each times x and x^2, by Chebyshev panels in ln x, split until
    they resolve them all.
    """
    return interpolated(lambda at: _surviving(s, at), x, _SMOOTH)


def _surviving(s: Reduced, x: Array) -> Array:
    """The three means of `survivors` at every x (n,), shape (3, n): over births xi0 > x/s(x), by panels that end at
    fixed shares of the stronger contacts and where the hazard passes fixed levels."""
    law, grown = s.law, aged(s, x)
    least = x / grown
    layer = _births_at(s, x, least) if s.barrier.thermal else None
    edges = births_above(law, least, layer, strongest(s.barrier))
    half = 0.5 * np.diff(edges, axis=1)[:, :, None]
    xi0 = (edges[:, :-1, None] + half * (1 + _FEW_NODES)).reshape(x.size, -1)
    weight = (half * _FEW_WEIGHTS).reshape(x.size, -1) * law.pdf(xi0 * law.scale) * law.scale
    weight *= np.exp(-_hazard(s, x, xi0))
    kappa = relative_stiffness(s.stiffness, xi0 * grown[:, None], s.rms)
    return np.array([(weight * kappa**power).sum(axis=1) for power in range(3)])


def _hazard(s: Reduced, x: Array, xi0: Array) -> Array:
    """(omega/v) int_0^x r dy along the paths of births `xi0`, shape (n, any), to stretches x (n,).

    ln r may be steep at either end: the trapezoidal rule in ln(y/(x - y)) converges exponentially whatever the slopes,
    with as many nodes as it takes to leave out a hazard of 1e-12.
    """
    found = np.zeros(xi0.shape)
    if not s.barrier.thermal:
        return found
    reach = s.barrier.log_w + np.log(x) - math.log(_UNSEEN)
    for i in np.flatnonzero(reach > 0):
        u = _STEP * np.arange(-math.ceil(reach[i] / _STEP), math.ceil(reach[i] / _STEP) + 1)
        y = x[i] * special.expit(u)
        found[i] = rate(s, y, xi0[i, :, None] * aged(s, y)) @ (_STEP * y * special.expit(-u))
    return found


def _births_at(s: Reduced, x: Array, least: Array) -> Array:
    """Roughly the birth whose hazard at x passes each level, shape (n, levels): only panels depend on it."""
    rarest = max(60.0, strongest(s.barrier))
    beyond = np.maximum(float(s.law.exceeded_by(rarest)) / s.law.scale - least, 1e-3 * least)[:, None] * _DEPTHS
    with np.errstate(divide="ignore"):
        log_hazard = np.log(_hazard(s, x, least[:, None] + beyond))
        for _ in range(2):
            # stronger contacts are safer; where attempts hardly need energy that may fail, but there nothing is steep
            falling = np.maximum(np.minimum.accumulate(log_hazard, axis=1), -1e3)
            found = np.array([np.interp(-_LEVELS, -h, d) for h, d in zip(falling, beyond, strict=True)])
            beyond = np.concatenate((beyond, found), axis=1)
            log_hazard = np.concatenate((log_hazard, np.log(_hazard(s, x, least[:, None] + found))), axis=1)
            order = np.argsort(beyond, axis=1)
            beyond, log_hazard = (np.take_along_axis(part, order, axis=1) for part in (beyond, log_hazard))
    return least[:, None] + found
