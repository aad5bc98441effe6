"""Quenched contacts: the stationary joint kinetic equation by quadrature (derived).

Without aging a contact of threshold xi survives to stretch x < xi with S(x|xi) = exp(-(omega/v) H(x)), H the closed
form of `laws.thermal`. The joint density of pinned contacts is P_c(xi) S(x|xi)/C on 0 <= x < xi, with

    C = E[int_0^xi S dx],        friction * C = E[(k_i/k) int_0^xi x S dx]        (no delay).

Inside, x = xi sin^2(phi) makes the integrand smooth at xi, and Gauss-Legendre panels end where the integrated hazard
passes fixed levels, so that the drop of S is resolved however sharp. Outside, panels in ln(-ln J_c(xi)) are halved
until the highest Chebyshev coefficients of the integrands are negligible.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.polynomial import chebyshev
from scipy import special

from eqsim.laws.barrier import Barrier
from eqsim.laws.stiffness import StiffnessLaw, relative_stiffness
from eqsim.laws.threshold import ThresholdLaw, panels_above
from eqsim.model.reduced import Reduced
from eqsim.numerics.tables import Array

METHOD = "joint kinetic equation"

_LEVELS = np.array([-48.0, -24.0, -12.0, -6.0, -3.0, -1.5, -0.5, 0.25, 1.0, 1.75, 2.5, 3.25, 4.0])  # of ln Lambda
_NODES, _WEIGHTS = special.roots_legendre(14)
# births: the first panels in ln(-ln J_c(xi)), from 2^-50 to 500; the errors that end refinement, the
# narrowest panels and how many more there may be (laws known with noise never converge); the error of life_moments
_BIRTHS = np.array([-34.7, -20.0, -12.0, -7.0, -4.0, -2.0, -0.5, 0.75, 1.75, 2.75, 3.75, 5.0, 6.2])
_CONVERGED, _NARROWEST, _MORE_PANELS, _PANELS = 2e-12, 1e-4, 500, 1e-11
_LONGEST, _SHORTEST = 2.0, 1e-3  # panels in ln x


class ClenshawCurtis:
    """Nodes on [-1, 1], which hold both ends; weights; `cumulative` (value, node), integrals from -1 to each node;
    Chebyshev `coefficients` of the values, and `tail`, the two highest, which say whether a function is resolved."""

    _order = 16
    nodes = -np.cos(math.pi * np.arange(_order + 1) / _order)
    coefficients = np.linalg.inv(chebyshev.chebvander(nodes, _order))
    cumulative = chebyshev.chebval(nodes, chebyshev.chebint(coefficients, lbnd=-1))
    weights = cumulative[:, -1]
    tail = coefficients[-2:].T


def interpolated(function: Callable[[Array], Array], x: Array, smooth: float, greatest: float | None = None) -> Array:
    """`function`, of shape (values, n), at every one of the ascending x > 0 from few evaluations: by Chebyshev panels
    in ln x, split until they resolve to `smooth` times `greatest`, or else of the greatest of each value, and of it
    times x and x^2, on which integrals depend."""
    log_x = np.log(x)
    low, high = log_x[0], max(log_x[-1], log_x[0] + 1e-3)
    edges = np.linspace(low, high, math.ceil((high - low) / _LONGEST) + 1)
    left, right = edges[:-1], edges[1:]
    most = np.zeros((3, 1, 1)) if greatest is None else greatest
    done: list[tuple[Array, Array, Array]] = []
    while left.size:
        nodes = np.exp(left[:, None] + 0.5 * (right - left)[:, None] * (1 + ClenshawCurtis.nodes))
        values = function(nodes.ravel()).reshape(-1, *nodes.shape)
        weighed = values[None]
        if greatest is None:
            weighed = np.array([values * nodes**power for power in range(3)])
            most = np.maximum(most, weighed.max(axis=(2, 3))[:, :, None])
        rough = (np.abs(weighed @ ClenshawCurtis.tail).sum(axis=3) > smooth * most).any(axis=(0, 1))
        rough &= right - left > _SHORTEST
        done.append((left[~rough], right[~rough], values[:, ~rough] @ ClenshawCurtis.coefficients.T))
        middle = 0.5 * (left + right)[rough]
        left, right = np.append(left[rough], middle), np.append(middle, right[rough])
    left, right = (np.concatenate([part[side] for part in done]) for side in (0, 1))
    coefficients = np.concatenate([part[2] for part in done], axis=1)
    order = np.argsort(left)
    panel = order[np.searchsorted(left[order], log_x[1:], side="left") - 1]
    panel = np.append(order[:1], panel)
    t = (2 * log_x - left[panel] - right[panel]) / (right[panel] - left[panel])
    return np.asarray(chebyshev.chebval(t, np.moveaxis(coefficients[:, panel], 2, 0), tensor=False))


class Moments(NamedTuple):
    """C = E[x_b], work = E[int_0^{x_b} (k_i/k) x dx], in units of the law's scale, and absolute errors of both."""

    stretch: float
    work: float
    stretch_error: float
    work_error: float


def survival(barrier: Barrier, x: Array, xi: Array, kappa: Array) -> Array:
    """S(x|xi) for 0 < x < xi of contacts of relative stiffness `kappa`."""
    if not barrier.thermal:
        return np.where(x < xi, 1.0, 0.0)
    log_lambda = barrier.log_hazard(np.minimum(x, xi), xi, barrier.b * kappa) + barrier.log_w
    return np.where(x < xi, np.exp(-np.exp(np.minimum(log_lambda, 7.0))), 0.0)


def life_moments(barrier: Barrier, xi: Array, kappa: Array) -> tuple[Array, Array]:
    """int_0^xi S dx and int_0^xi x S dx for thresholds `xi`, shape (n,), with k_i/k of the same shape."""
    if not barrier.thermal:
        return xi, 0.5 * xi**2
    levels = barrier.stretch_at(_LEVELS, xi, barrier.b * kappa) / xi[:, None]
    phi = np.arcsin(np.sqrt(np.clip(levels, 0.0, 1.0)))
    edges = np.concatenate((np.zeros((xi.size, 1)), phi, np.full((xi.size, 1), 0.5 * math.pi)), axis=1)
    half = 0.5 * np.diff(edges, axis=1)[:, :, None]
    phi = edges[:, :-1, None] + half * (1.0 + _NODES)
    xi, kappa = xi[:, None, None], kappa[:, None, None]
    x = np.maximum(xi * np.sin(phi) ** 2, 1e-200)
    terms = half * _WEIGHTS * xi * np.sin(2 * phi) * survival(barrier, x, xi, kappa)
    return terms.sum(axis=(1, 2)), (terms * x).sum(axis=(1, 2))


def stationary(s: Reduced) -> Moments:
    """C and work of quenched contacts that do not age."""
    law = s.law

    def moments(xi: Array) -> Array:
        kappa = relative_stiffness(s.stiffness, xi, s.rms)
        zeroth, first = life_moments(s.barrier, xi, kappa)
        return np.array([zeroth, kappa * first])

    if law.steps.size:
        xi, counts = np.unique(law.steps / law.scale, return_counts=True)
        mean = moments(xi) @ (counts / counts.sum())
        return Moments(mean[0], mean[1], *(1e-11 * mean))

    def integrate(left: Array, right: Array) -> tuple[Array, Array]:
        """Both integrals over panels of ln(-ln J_c), shape (2, panels), and what is left unresolved of them."""
        half = 0.5 * (right - left)[:, None]
        e = np.exp(left[:, None] + half * (1.0 + ClenshawCurtis.nodes))
        found = moments(np.asarray(law.exceeded_by(e.ravel())) / law.scale).reshape(2, *e.shape)
        terms = found * (half * e * np.exp(-e))
        return terms @ ClenshawCurtis.weights, np.abs(terms @ ClenshawCurtis.tail).sum(axis=2)

    with np.errstate(divide="ignore"):  # a breakpoint at an end of the support
        kinks = np.log(-np.log(law.sf(law.breakpoints)))
    edges = np.union1d(_BIRTHS, kinks[(kinks > _BIRTHS[0]) & (kinks < _BIRTHS[-1])])
    left, right = edges[:-1], edges[1:]
    parts, errors = integrate(left, right)
    while True:
        total = parts.sum(axis=1)
        split = (errors > _CONVERGED * total[:, None]).any(axis=0) & (right - left > _NARROWEST)
        if not split.any() or left.size > edges.size + _MORE_PANELS:
            break
        middle = 0.5 * (left[split] + right[split])
        new_left, new_right = np.append(left[split], middle), np.append(middle, right[split])
        new_parts, new_errors = integrate(new_left, new_right)
        left, right = np.append(left[~split], new_left), np.append(right[~split], new_right)
        parts = np.append(parts[:, ~split], new_parts, axis=1)
        errors = np.append(errors[:, ~split], new_errors, axis=1)
    rarest = beyond(law, s.stiffness)
    error = errors.sum(axis=1) + _PANELS * total + rarest
    total = total + rarest
    return Moments(float(total[0]), float(total[1]), float(error[0]), float(error[1]))


def beyond(law: ThresholdLaw, stiffness: StiffnessLaw) -> Array:
    """C and work of the contacts beyond the last panel, shape (2,), not negligible where x^3 P_c is barely integrable:
    at T = 0, and as of a power law (derived)."""
    e = np.array([0.95, 1.0]) * math.exp(_BIRTHS[-1])
    xi = np.asarray(law.exceeded_by(e)) / law.scale
    early, late = (np.array([xi, 0.5 * relative_stiffness(stiffness, xi, law.rms / law.scale) * xi**2]) * np.exp(-e)).T
    with np.errstate(divide="ignore", invalid="ignore"):
        rest = late * np.diff(e) / np.log(early / late)
    return np.where(late > 0, np.where(early > late, rest, np.inf), 0.0)


_FEW_NODES, _FEW_WEIGHTS = special.roots_legendre(8)


def survivors(s: Reduced, x: Array) -> Array:
    """S(x) = P(x_b > x), E[k_i/k; x_b > x] and E[(k_i/k)^2; x_b > x] at ascending x > 0, shape (3, n).

    Over xi > x by panels that end at fixed shares of the stronger contacts and where the hazard passes fixed levels.
    """
    law = s.law
    if law.steps.size:
        xi, counts = np.unique(law.steps / law.scale, return_counts=True)
        kappa = relative_stiffness(s.stiffness, xi, s.rms)
        weight = np.array([kappa**power for power in range(3)]) * (counts / counts.sum())
        total = np.zeros((3, x.size))
        for j in range(xi.size):
            total += weight[:, j, None] * survival(s.barrier, x, xi[j], kappa[j])
        return total
    layer = weakest(law) + np.zeros((x.size, 1))
    if s.barrier.thermal:
        layer = np.concatenate((layer, _threshold_at(s, x)), axis=1)
    edges = births_above(law, x, layer, strongest(s.barrier))
    half = 0.5 * np.diff(edges, axis=1)[:, :, None]
    xi = edges[:, :-1, None] + half * (1.0 + _FEW_NODES)
    kappa = relative_stiffness(s.stiffness, xi, s.rms)
    with np.errstate(invalid="ignore"):
        terms = half * _FEW_WEIGHTS * law.pdf(xi * law.scale) * law.scale
        terms *= survival(s.barrier, x[:, None, None], xi, kappa)
    terms = np.where((half > 0) & np.isfinite(terms), terms, 0.0)
    return np.array([terms.sum((1, 2)), (terms * kappa).sum((1, 2)), (terms * kappa**2).sum((1, 2))])


_COMMON, _RARER = 45.0, 5.0  # -ln J_c up to which lives hardly differ enough to count, and of panels beyond


def strongest(barrier: Barrier) -> float:
    """-ln J_c up to which contacts count: where lives are as short as exp(-log_w), ones as rare as its square do."""
    return _COMMON + min(max(2.0 * barrier.log_w, 0.0), 455.0)


def births_above(law: ThresholdLaw, x: Array, layer: Array | None, rarest: float) -> Array:
    """`panels_above` up to the threshold that a fraction exp(-rarest) of the contacts exceeds."""
    edges = panels_above(law, x, layer)
    if rarest <= _COMMON:
        return edges
    beyond = law.exceeded_by(np.arange(_COMMON, rarest, _RARER)) / law.scale + np.zeros((x.size, 1))
    if layer is not None:
        beyond = np.concatenate((layer, beyond), axis=1)
    return np.concatenate((edges, np.sort(np.maximum(beyond, edges[:, -1:]), axis=1)), axis=1)


def weakest(law: ThresholdLaw) -> Array:
    """Thresholds that 1e-14 to 1e-7 of the contacts stay below: edges of panels where the law rises steeply."""
    return np.asarray(law.exceeded_by(10.0 ** np.arange(-14.0, -6.0))) / law.scale


_SHALLOWEST, _BISECTIONS = -44.0, 13  # ln(xi/x - 1), where levels are sought


def _threshold_at(s: Reduced, x: Array) -> Array:
    """Roughly the threshold whose ln((omega/v) H(x)) passes each level, shape (n, levels): only panels depend on it.

    By bisection, as stronger contacts are safer; where attempts hardly need energy that may fail, but nothing is steep.
    """
    x = x[:, None]
    low = np.full((x.size, _LEVELS.size), _SHALLOWEST)
    high = np.log1p(float(s.law.exceeded_by(500.0)) / s.law.scale / x) + np.zeros_like(low)
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        xi = x * (1.0 + np.exp(middle))
        a = s.barrier.b * relative_stiffness(s.stiffness, xi, s.rms)
        weak = s.barrier.log_hazard(x, xi, a) + s.barrier.log_w > _LEVELS
        low, high = np.where(weak, middle, low), np.where(weak, high, middle)
    return np.asarray(x * (1.0 + np.exp(high)))


def panels(s: Reduced) -> Array:
    """Ascending stretches between which what happens to contacts of a discrete law is smooth: they crowd towards
    every threshold from below and, down to a small part of it, from above, and towards 0."""
    xi, b = np.unique(s.law.steps) / s.law.scale, s.barrier.b
    rate = 2.0 * (b if math.isfinite(b) else 0.0) * relative_stiffness(s.stiffness, xi, s.rms) * xi
    edges = [xi[0] * 2.0 ** -np.arange(1.0, 340.0)]
    for low, high, scale in zip(np.append(0.0, xi[:-1]), xi, rate, strict=True):
        depth = 6 + math.ceil(math.log2(max(scale * (high - low), 1.0)))
        edges.append(high - (high - low) * np.append(2.0 ** -(np.arange(2 * depth) / 2), 0.0))
        if low and high - low > low / 64:
            edges.append(low + (high - low) * 2.0 ** -np.arange(1.0, math.log2(64 * (high / low - 1.0)) + 1.0))
    return np.unique(np.concatenate(edges))
