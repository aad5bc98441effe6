"""Annealed contacts: the published master equation (Braun and Peyrard, 2011),
stationary.

With J_c(x) = P(xi > x), U = -ln J_c and Delta U(x) = (omega/v) G(x), G the integral of
the pooled rate h (temper11, temper12 are H = (omega/v) h), the stationary density of
stretches is Q(x) = E_P(x)/C with E_P = J_c exp(-Delta U) (Q11a, nt13) and

    C = int_0^inf E_P dx,        friction * C = int_0^inf x exp(-Delta U) E[k_i/k; xi > x] dx        (no delay),

where k_i = k gives nt13 and the sqrt law, beyond the paper, uses the threshold drawn at
birth (derived).

Panels in x end where the density of thresholds jumps, and are split towards their ends
until the highest Chebyshev coefficients of the hazard, times the life that is left, and
of the integrands are negligible.
"""

import math
from typing import NamedTuple

import numpy as np

from eqsim.errors import InputError
from eqsim.laws.barrier.pooled import mean_hazard, pooled_rate
from eqsim.master.quenched import (
    Moments,
    beyond,
    different_steps,
    panels_between_steps,
)
from eqsim.model.reduced import Reduced
from eqsim.numerics.panels import ClenshawCurtis, Panels, refined
from eqsim.numerics.quadrature import gauss_legendre
from eqsim.numerics.tables import Array

METHOD = "published master equation"

# Different thresholds of a discrete law at most, to bound time.
_MOST_STEPS = 1000

# The factor by which the first panels in x rise.
_RISE = 5.0
# -ln J_c where the first panels end.
_LAW = np.array([1e-4, 0.02, 0.3, 1.0, 2.5, 6.0, 15.0, 40.0, 120.0, 500.0])
# Where a panel is split: crowded, as the trouble is mostly at one end.
_PIECES = np.array([0.0, 0.1, 0.5, 0.9, 1.0])
# The relative error that ends refinement.
_RESOLVED = 2e-12
# The narrowest panel, relative to its right end.
_STEP = 1e-14
# Panels at most.
_MOST_PANELS = 1500
# The least relative error that is quoted.
_ROUNDING = 1e-11

# A survival that is out of sight.
_DEAD = 1e-20


def stationary(contacts: Reduced) -> Moments:
    """Moments of the lives of annealed contacts at kT > 0. Raises InputError for a
    discrete law of more than 1000 thresholds."""
    if contacts.law.steps.size:
        return _of_steps(contacts)
    p, (parts, errors) = refined(
        lambda left, right, _: _integrals(contacts, left, right),
        _judged,
        _first_edges(contacts),
        pieces=_PIECES,
        most=_MOST_PANELS,
    )
    # the rate's own error, from a finer rule in the middle of panels; eightfold, as
    # that may not be the worst place
    alive, onward = _alive(p), _onward(parts)
    seen = alive > _DEAD
    better = (
        successful_attempts(contacts, 0.5 * (p.left + p.right)[seen], finer=True)
        * (p.right - p.left)[seen]
    )
    missed = np.abs(2.0 * _Integrals(*p.values).middle[seen] - better)
    errors[:, seen] += np.minimum(8.0 * missed, 1.0) * onward[:, seen]
    total, rarest = parts.sum(axis=1), alive[-1] * beyond(contacts)
    error = errors.sum(axis=1) + _ROUNDING * total + rarest
    return Moments(*(total + rarest).tolist(), *error.tolist())


class _Integrals(NamedTuple):
    """Integrals over panels of 0 < x < inf, each array of shape (panels,).

    Delta U gained inside; with exp(-Delta U) = 1 at the left end, the integrals of E_P
    and of x exp(-Delta U) E[kappa; xi > x], but for thresholds beyond the panel, for
    which the latter is `carried`, the integral of x exp(-Delta U), times the sum of
    `heavier` = int J_c dx/xi_rms of later panels (0 if stiffness is uniform); the
    highest Chebyshev coefficients of each integrand; and the rate in the middle times
    half the width.
    """

    hazard: Array
    stretch: Array
    work: Array
    carried: Array
    heavier: Array
    hazard_tail: Array
    stretch_tail: Array
    work_tail: Array
    carried_tail: Array
    heavier_tail: Array
    middle: Array


def _integrals(contacts: Reduced, left: Array, right: Array) -> Array:
    """`_Integrals` as rows."""
    half = 0.5 * (right - left)[:, None]
    x = left[:, None] + half * (1.0 + ClenshawCurtis.nodes)
    hazard = half * successful_attempts(contacts, x.ravel()).reshape(x.shape)
    # where the panel is too wide for its polynomial, that may be negative
    alive = half * np.exp(-np.maximum(hazard @ ClenshawCurtis.cumulative, 0.0))
    J = contacts.law.sf(x * contacts.law.scale)
    stiff, heavier = J, np.zeros_like(J)
    if contacts.stiffness == "sqrt":  # E[xi; xi > x] = x J + int_x^inf J dy
        heavier = half * J / contacts.rms
        inside = heavier @ ClenshawCurtis.weights
        stiff = x * J / contacts.rms + np.maximum(
            inside[:, None] - heavier @ ClenshawCurtis.cumulative, 0.0
        )
    integrands = np.array([hazard, alive * J, alive * x * stiff, alive * x, heavier])
    values = np.maximum(integrands @ ClenshawCurtis.weights, 0.0)
    tails = np.abs(integrands @ ClenshawCurtis.tail).sum(axis=2)
    return np.vstack((values, tails, hazard[:, hazard.shape[1] // 2]))


def _alive(panels: Panels) -> Array:
    """exp(-Delta U) at the left end of each panel."""
    return np.exp(-np.append(0.0, panels.values[0, :-1].cumsum()))


def _onward(parts: Array) -> Array:
    """Sums over each panel and all later ones."""
    return parts[:, ::-1].cumsum(axis=1)[:, ::-1]


def _judged(panels: Panels) -> tuple[Array, tuple[Array, Array]]:
    """Which panels are too rough; what each adds to C and work, and to their errors,
    both of shape (2, panels)."""
    of, alive = _Integrals(*panels.values), _alive(panels)
    heavier = np.append(of.heavier[:0:-1].cumsum()[::-1], 0.0)
    carried = alive * of.carried
    parts = np.array([alive * of.stretch, alive * of.work + heavier * carried])
    errors = of.hazard_tail * _onward(parts)
    errors[0] += alive * of.stretch_tail
    errors[1] += (
        alive * (of.work_tail + heavier * of.carried_tail)
        + of.heavier_tail * carried.cumsum()
    )
    rough = (errors > _RESOLVED * parts.sum(axis=1)[:, None]).any(axis=0) & (
        panels.right - panels.left > _STEP * panels.right
    )
    return rough, (parts, errors)


def _first_edges(contacts: Reduced) -> Array:
    """Ends of the first panels: from lives of newborn contacts to where no threshold is
    left."""
    law = contacts.law
    marks = np.append(law.inverse_survival(_LAW), law.breakpoints) / law.scale
    marks = marks[(marks > 0) & np.isfinite(marks)]
    top = marks.max()
    least, greatest = (edge / law.scale for edge in law.support)
    newborn = successful_attempts(contacts, np.zeros(1))[0]
    first = 0.3 / (1.0 / marks[0] + newborn + math.sqrt(contacts.barrier.b))
    rising = first * _RISE ** np.arange(math.ceil(math.log(top / first, _RISE)))
    edges = np.unique(np.concatenate(([0.0, least, min(greatest, top)], marks, rising)))
    return edges[edges <= min(greatest, top)]


def successful_attempts(contacts: Reduced, y: Array, *, finer: bool = False) -> Array:
    """(omega/v) h(y) of a smooth law: successful attempts per unit displacement."""
    law, stiffness, barrier = contacts.law, contacts.stiffness, contacts.barrier
    b, log_w = barrier.b, barrier.log_w
    h = pooled_rate(law, stiffness, type(barrier), b, y, log_w, finer=finer)
    return math.exp(log_w) * h


def survivors(contacts: Reduced, x: Array) -> Array:
    """E_P(x) = P(x_b > x), E[kappa; x_b > x] and E[kappa^2; x_b > x] of a discrete law
    at ascending x > 0, shape (3, n). Raises InputError for more than 1000 thresholds.
    """
    barrier, (xi, share, kappa) = contacts.barrier, different_steps(contacts)
    if xi.size > _MOST_STEPS:
        raise InputError(
            f"thresholds: {xi.size} different values; the annealed reference takes at "
            f"most {_MOST_STEPS}"
        )
    with np.errstate(divide="ignore"):
        log_G = np.log(mean_hazard(type(barrier), x, xi, share, barrier.b * kappa))
    dU = np.exp(np.minimum(log_G + barrier.log_w, 7.0))
    above = np.searchsorted(xi, x, side="right")
    tails = [np.cumsum((share * kappa**p)[::-1])[::-1] for p in range(3)]
    return np.exp(-dU) * np.array([np.append(tail, 0.0)[above] for tail in tails])


def _of_steps(contacts: Reduced) -> Moments:
    """Discrete thresholds: E_P drops at each of them, after a layer in which attempts
    on it succeed."""
    edge = panels_between_steps(contacts)

    def integrate(order: int) -> Array:
        nodes, weights = gauss_legendre(order)
        half = 0.5 * np.diff(edge)[:, None]
        x = (edge[:-1, None] + half * (1.0 + nodes)).ravel()
        survive, stiff, _ = survivors(contacts, x)
        return (half * weights).ravel() @ np.stack((survive, stiff * x), axis=1)

    fine, coarse = integrate(8), integrate(5)
    error = np.abs(fine - coarse) + 1e-11 * fine
    return Moments(fine[0], fine[1], error[0], error[1])
