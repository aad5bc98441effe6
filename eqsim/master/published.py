"""Annealed contacts: the published master equation (Braun and Peyrard, 2011), stationary.

With J_c(x) = P(xi > x), U = -ln J_c and Delta U(x) = (omega/v) G(x), G the integral of the pooled rate h (temper11,
temper12 are H = (omega/v) h), the stationary density of stretches is Q(x) = E_P(x)/C with E_P = J_c exp(-Delta U)
(Q11a, nt13) and

    C = int_0^inf E_P dx,        friction * C = int_0^inf x exp(-Delta U) E[k_i/k; xi > x] dx        (no delay),

where k_i = k gives nt13 and the sqrt law, beyond the paper, uses the threshold drawn at birth (derived).
"""

import math

import numpy as np

from eqsim.errors import InputError
from eqsim.laws.octaves import Array
from eqsim.laws.stiffness import StiffnessLaw, relative_stiffness
from eqsim.laws.thermal import Barrier, log_hazard, pooled_rate
from eqsim.laws.threshold import ThresholdLaw
from eqsim.master.kinetic import Moments, panels

_STEP = 0.05  # in ln x; the trapezoidal rule converges as exp(-const/step)
_LEAST = 1e-14  # below this stretch, in units of x_*, the pooled rate is constant to 1e-9 for b up to 1e9
_MOST_STEPS = 1000
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(3)


def stationary(law: ThresholdLaw, stiffness: StiffnessLaw, barrier: Barrier, b: float, log_w: float) -> Moments:
    """C and work of annealed contacts at kT > 0; lengths, b and log_w = ln(omega x_*/v) in units of `law.scale`.

    Raises InputError for a discrete law of more than 1000 thresholds.
    """
    if law.steps.size:
        return _discrete(law, stiffness, barrier, b, log_w)
    top = math.log(float(law.exceeded_by(45.0)) / law.scale)
    x = np.exp(top - _STEP * np.arange(2 * math.ceil((top - math.log(_LEAST)) / _STEP / 2) + 1)[::-1])
    survive, stiff, _ = survivors(law, stiffness, barrier, b, log_w, x)
    # strong thermal breaking ends lives long before the first node, where h is constant
    below = x[0] * np.exp(-_STEP * np.arange(1, 2 * math.ceil(32.0 / _STEP / 2) + 1)[::-1])
    decay = np.log(survive[0]) / x[0] * below
    x = np.append(below, x)
    stretch = x * np.append(np.exp(decay), survive)
    work = x**2 * np.append(np.exp(decay) * (stiff[0] / survive[0]), stiff)
    fine = np.array([stretch.sum(), work.sum()]) * _STEP
    coarse = np.array([stretch[::2].sum(), work[::2].sum()]) * 2 * _STEP
    error = np.abs(fine - coarse) ** 1.5 / np.sqrt(fine) + 1e-10 * fine  # halving the step squares the error
    return Moments(fine[0], fine[1], error[0], error[1])


def survivors(
    law: ThresholdLaw, stiffness: StiffnessLaw, barrier: Barrier, b: float, log_w: float, x: Array
) -> tuple[Array, Array, Array]:
    """E_P(x) = P(x_b > x), E[k_i/k; x_b > x] and E[(k_i/k)^2; x_b > x] at ascending x > 0 in units of `law.scale`; for
    a smooth law x has to begin near 0 and to rise by small factors, up to where nothing survives."""
    rms = law.rms / law.scale
    if law.steps.size:
        xi, share, kappa = _shares(law, stiffness)
        G = _discrete_pool(barrier, xi, share, b * kappa, x)
        above = np.searchsorted(xi, x, side="right")
        means = [np.append(np.cumsum((share * kappa**power)[::-1])[::-1], 0.0)[above] for power in range(3)]
    else:
        inner, weights = _between(x)
        G = x[0] * pooled_rate(law, stiffness, barrier, b, x[:1])[0] + np.append(
            0.0,
            np.cumsum((weights * pooled_rate(law, stiffness, barrier, b, inner.ravel()).reshape(inner.shape)).sum(1)),
        )
        J, inner_J = law.sf(x * law.scale), law.sf(inner * law.scale)
        means = [J, J, J]
        if stiffness == "sqrt":  # E[xi^p; xi > x] = x^p J + int_x^inf p y^(p-1) J dy
            for p in (1, 2):
                cells = (weights * p * inner ** (p - 1) * inner_J).sum(1)
                means[p] = (x**p * J + np.append(np.cumsum(cells[::-1])[::-1], 0.0)) / rms**p
    with np.errstate(divide="ignore"):
        thermal = np.exp(-np.exp(np.minimum(np.log(G) + log_w, 7.0)))
    return thermal * means[0], thermal * means[1], thermal * means[2]


def _between(x: Array) -> tuple[Array, Array]:
    """Gauss-Legendre nodes in ln x between neighbours, and their weights for integrals over x, shape (n - 1, 3)."""
    log_x = np.log(x)
    half = 0.5 * np.diff(log_x)[:, None]
    inner = np.exp(log_x[:-1, None] + half * (1.0 + _NODES))
    return inner, half * _WEIGHTS * inner


def _shares(law: ThresholdLaw, stiffness: StiffnessLaw) -> tuple[Array, Array, Array]:
    """The different thresholds of a discrete law, their shares and stiffnesses k_i/k."""
    xi, counts = np.unique(law.steps / law.scale, return_counts=True)
    if xi.size > _MOST_STEPS:
        raise InputError(f"thresholds: {xi.size} different values; the annealed reference takes at most {_MOST_STEPS}")
    return xi, counts / counts.sum(), relative_stiffness(stiffness, xi, law.rms / law.scale)


def _discrete_pool(barrier: Barrier, xi: Array, share: Array, a: Array, x: Array) -> Array:
    """G of equally likely thresholds, a mean of closed forms."""
    G = np.zeros(x.size)
    for j in range(xi.size):
        k = np.searchsorted(x, xi[j])
        G[:k] += share[j] * np.exp(log_hazard(barrier, x[:k], xi[j], a[j]))
        G[k:] += share[j] * np.exp(log_hazard(barrier, xi[j], xi[j], a[j]))
    return G


def _discrete(law: ThresholdLaw, stiffness: StiffnessLaw, barrier: Barrier, b: float, log_w: float) -> Moments:
    """Discrete thresholds: E_P drops at each of them, after a layer in which attempts on it succeed."""
    edge = panels(law, stiffness, b)

    def integrate(order: int) -> Array:
        nodes, weights = np.polynomial.legendre.leggauss(order)
        half = 0.5 * np.diff(edge)[:, None]
        x = (edge[:-1, None] + half * (1.0 + nodes)).ravel()
        survive, stiff, _ = survivors(law, stiffness, barrier, b, log_w, x)
        return (half * weights).ravel() @ np.stack((survive, stiff * x), axis=1)

    fine, coarse = integrate(8), integrate(5)
    error = np.abs(fine - coarse) + 1e-11 * fine
    return Moments(fine[0], fine[1], error[0], error[1])
