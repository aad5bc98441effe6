"""Quenched contacts: the stationary joint kinetic equation by quadrature (derived).

Without aging a contact of threshold xi survives to stretch x < xi with S(x|xi) = exp(-(omega/v) H(x)), H the closed
form of `laws.thermal`. The joint density of pinned contacts is P_c(xi) S(x|xi)/C on 0 <= x < xi, with

    C = E[int_0^xi S dx],        friction * C = E[(k_i/k) int_0^xi x S dx]        (no delay).

Inside, x = xi sin^2(phi) makes the integrand smooth at xi, and Gauss-Legendre panels end where the integrated hazard
passes fixed levels, so that the drop of S is resolved however sharp. Outside, the trapezoidal rule in ln(-ln J_c(xi))
converges exponentially; it is refined until it stands still.
"""

import math
from typing import NamedTuple

import numpy as np
from scipy import special

from eqsim.laws.octaves import Array
from eqsim.laws.stiffness import StiffnessLaw, relative_stiffness
from eqsim.laws.thermal import Barrier, log_hazard
from eqsim.laws.threshold import ThresholdLaw, panels_above

_LEVELS = np.array([-48.0, -24.0, -12.0, -6.0, -3.0, -1.5, -0.5, 0.25, 1.0, 1.75, 2.5, 3.25, 4.0])  # of ln Lambda
_NODES, _WEIGHTS = special.roots_legendre(14)
_NEGLIGIBLE, _CONVERGED = 1e-17, 2e-12


class Moments(NamedTuple):
    """C = E[x_b], work = E[int_0^{x_b} (k_i/k) x dx], in units of the law's scale, and absolute errors of both."""

    stretch: float
    work: float
    stretch_error: float
    work_error: float


def survival(barrier: Barrier | None, x: Array, xi: Array, a: Array, log_w: float) -> Array:
    """S(x|xi) for 0 < x < xi; log_w = ln(omega/v) in the unit of length of x; no barrier means T = 0."""
    if barrier is None:
        return np.where(x < xi, 1.0, 0.0)
    log_lambda = log_hazard(barrier, np.minimum(x, xi), xi, a) + log_w
    return np.where(x < xi, np.exp(-np.exp(np.minimum(log_lambda, 7.0))), 0.0)


def life_moments(barrier: Barrier | None, xi: Array, a: Array, log_w: float) -> tuple[Array, Array]:
    """int_0^xi S dx and int_0^xi x S dx for thresholds `xi`, shape (n,), with a = k_i/(2 kT) of the same shape."""
    if barrier is None:
        return xi, 0.5 * xi**2
    levels = _stretch_at(barrier, xi, a, log_w) / xi[:, None]
    phi = np.arcsin(np.sqrt(np.clip(levels, 0.0, 1.0)))
    edges = np.concatenate((np.zeros((xi.size, 1)), phi, np.full((xi.size, 1), 0.5 * math.pi)), axis=1)
    half = 0.5 * np.diff(edges, axis=1)[:, :, None]
    phi = edges[:, :-1, None] + half * (1.0 + _NODES)
    xi, a = xi[:, None, None], a[:, None, None]
    x = np.maximum(xi * np.sin(phi) ** 2, 1e-200)
    terms = half * _WEIGHTS * xi * np.sin(2 * phi) * survival(barrier, x, xi, a, log_w)
    return terms.sum(axis=(1, 2)), (terms * x).sum(axis=(1, 2))


def _stretch_at(barrier: Barrier, xi: Array, a: Array, log_w: float) -> Array:
    """Roughly the stretch where ln((omega/v) H) passes each level, shape (n, levels): only panels depend on it."""
    c = (a * xi**2)[:, None]
    if barrier == "soft":
        log_erfi = _LEVELS - log_w + c + np.log(2.0 * np.sqrt(a / math.pi))[:, None]
        z2 = np.maximum(log_erfi, 1.0)
        for _ in range(3):  # erfi(z) ~ exp(z^2)/(sqrt(pi) z)
            z2 = np.maximum(log_erfi + 0.5 * np.log(math.pi * z2), 1.0)
        small = 0.5 * math.sqrt(math.pi) * np.exp(np.minimum(log_erfi, 1.0))
        return np.asarray(np.where(log_erfi > 1.0, np.sqrt(z2), np.minimum(small, 1.0)) / np.sqrt(a)[:, None])
    gap = np.logaddexp(0.0, c + np.log(1.5 * (a * xi))[:, None] + _LEVELS - log_w) / c
    return xi[:, None] * (1.0 - np.maximum(1.0 - gap, 0.0) ** (2.0 / 3.0))


def stationary(law: ThresholdLaw, stiffness: StiffnessLaw, barrier: Barrier | None, b: float, log_w: float) -> Moments:
    """C and work of quenched contacts; lengths, b = k x_*^2/(2 kT) and log_w = ln(omega x_*/v) in units of
    `law.scale`; barrier None at T = 0."""
    rms = law.rms / law.scale

    def moments(xi: Array) -> Array:
        kappa = relative_stiffness(stiffness, xi, rms)
        zeroth, first = life_moments(barrier, xi, b * kappa, log_w)
        return np.array([zeroth, kappa * first])

    if law.steps.size:
        xi, counts = np.unique(law.steps / law.scale, return_counts=True)
        mean = moments(xi) @ (counts / counts.sum())
        return Moments(mean[0], mean[1], *(1e-11 * mean))

    def terms(log_e: Array) -> Array:
        e = np.exp(log_e)
        return moments(np.asarray(law.exceeded_by(e)) / law.scale) * (e * np.exp(-e))

    step = 0.16
    log_e = np.arange(-50 * math.log(2), math.log(500.0), step)
    found = terms(log_e)
    keep = np.flatnonzero((found > _NEGLIGIBLE * found.max(axis=1, keepdims=True)).any(axis=0))
    low, high = log_e[max(keep[0] - 1, 0)], log_e[min(keep[-1] + 1, log_e.size - 1)]
    total = found.sum(axis=1) * step
    while True:
        finer = 0.5 * total + 0.5 * step * terms(np.arange(low + 0.5 * step, high, step)).sum(axis=1)
        change, total, step = np.abs(finer - total), finer, 0.5 * step
        if np.all(change <= _CONVERGED * total) or step < 0.004:
            break
    # the last refinement squares the error of the one before it; 1e-11 covers the panels
    error = np.minimum(change, np.maximum(change**1.5 / np.sqrt(total), 0.0)) + 1e-11 * total
    return Moments(total[0], total[1], error[0], error[1])


_FEW_NODES, _FEW_WEIGHTS = special.roots_legendre(8)


def survivors(
    law: ThresholdLaw, stiffness: StiffnessLaw, barrier: Barrier | None, b: float, log_w: float, x: Array
) -> tuple[Array, Array, Array]:
    """S(x) = P(x_b > x), E[k_i/k; x_b > x] and E[(k_i/k)^2; x_b > x] at ascending x > 0 in units of `law.scale`.

    Over xi > x by panels that end at fixed shares of the stronger contacts and where the hazard passes fixed levels.
    """
    rms = law.rms / law.scale
    if law.steps.size:
        xi, counts = np.unique(law.steps / law.scale, return_counts=True)
        kappa = relative_stiffness(stiffness, xi, rms)
        weight = np.array([kappa**power for power in range(3)]) * (counts / counts.sum())
        total = np.zeros((3, x.size))
        for j in range(xi.size):
            total += weight[:, j, None] * survival(barrier, x, xi[j], b * kappa[j], log_w)
        return total[0], total[1], total[2]
    layer = None if barrier is None else _threshold_at(x, b, barrier, stiffness, rms, log_w)
    edges = panels_above(law, x, layer)
    half = 0.5 * np.diff(edges, axis=1)[:, :, None]
    xi = edges[:, :-1, None] + half * (1.0 + _FEW_NODES)
    kappa = relative_stiffness(stiffness, xi, rms)
    with np.errstate(invalid="ignore"):
        terms = half * _FEW_WEIGHTS * law.pdf(xi * law.scale) * law.scale
        terms *= survival(barrier, x[:, None, None], xi, b * kappa, log_w)
    terms = np.where((half > 0) & np.isfinite(terms), terms, 0.0)
    return terms.sum((1, 2)), (terms * kappa).sum((1, 2)), (terms * kappa**2).sum((1, 2))


def _threshold_at(x: Array, b: float, barrier: Barrier, stiffness: StiffnessLaw, rms: float, log_w: float) -> Array:
    """Roughly the threshold whose ln((omega/v) H(x)) passes each level, shape (n, levels): only panels depend on it."""
    x = x[:, None]
    xi = x
    for _ in range(4):
        a = b * relative_stiffness(stiffness, xi, rms)
        if barrier == "soft":
            free = np.log(special.dawsn(np.sqrt(a) * x) / np.sqrt(a))
            xi = np.sqrt(x**2 + np.maximum(log_w + free - _LEVELS, 0.0) / a)
        else:
            free = np.maximum(log_w + np.log(2.0 / (3.0 * a * xi)) - _LEVELS, 0.0)
            xi = x + xi * np.minimum(free / (a * xi**2), 1e3) ** (2.0 / 3.0)
    return xi


def panels(law: ThresholdLaw, stiffness: StiffnessLaw, b: float) -> Array:
    """Ascending stretches between which what happens to contacts of a discrete law is smooth: they crowd towards
    every threshold from below, and towards 0."""
    xi = np.unique(law.steps) / law.scale
    rate = 2.0 * (b if math.isfinite(b) else 0.0) * relative_stiffness(stiffness, xi, law.rms / law.scale) * xi
    edges = [xi[0] * 2.0 ** -np.arange(1.0, 100.0)]
    for low, high, scale in zip(np.append(0.0, xi[:-1]), xi, rate, strict=True):
        depth = 6 + math.ceil(math.log2(max(scale * (high - low), 1.0)))
        edges.append(high - (high - low) * np.append(2.0 ** -(np.arange(2 * depth) / 2), 0.0))
    return np.unique(np.concatenate(edges))
