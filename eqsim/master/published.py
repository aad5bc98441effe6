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
from eqsim.master.kinetic import Moments

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
    count = 2 * math.ceil((top - math.log(_LEAST)) / _STEP / 2)
    log_x = top - _STEP * np.arange(count + 1)[::-1]
    # Delta U at the nodes: 3-point Gauss-Legendre in ln x between them
    inner = np.exp(log_x[:-1, None] + 0.5 * _STEP * (1.0 + _NODES))
    h = pooled_rate(law, stiffness, barrier, b, inner.ravel()).reshape(inner.shape)
    start = h[0, 0] * math.exp(log_x[0])
    G = start + np.concatenate(([0.0], np.cumsum((0.5 * _STEP * _WEIGHTS * h * inner).sum(axis=1))))
    # strong thermal breaking ends lives long before the first node, where h is constant
    below = log_x[0] - _STEP * np.arange(1, 2 * math.ceil(32.0 / _STEP / 2) + 1)[::-1]
    log_x, G = np.append(below, log_x), np.append(h[0, 0] * np.exp(below), G)
    x = np.exp(log_x)
    thermal = np.exp(-np.exp(np.minimum(np.log(G) + log_w, 7.0)))
    J = law.sf(x * law.scale)
    stretch = x * thermal * J
    work = x**2 * thermal * (_mean_above(law, log_x) * law.scale / law.rms if stiffness == "sqrt" else J)
    fine = np.array([stretch.sum(), work.sum()]) * _STEP
    coarse = np.array([stretch[::2].sum(), work[::2].sum()]) * 2 * _STEP
    error = np.abs(fine - coarse) ** 1.5 / np.sqrt(fine) + 1e-10 * fine  # halving the step squares the error
    return Moments(fine[0], fine[1], error[0], error[1])


def _mean_above(law: ThresholdLaw, log_x: Array) -> Array:
    """E[xi; xi > x] = x J_c(x) + int_x^inf J_c dy in units of `law.scale`; nothing is left above the last node."""
    inner = np.exp(log_x[:-1, None] + 0.5 * _STEP * (1.0 + _NODES))
    cells = (0.5 * _STEP * _WEIGHTS * law.sf(inner * law.scale) * inner).sum(axis=1)
    x = np.exp(log_x)
    return np.asarray(x * law.sf(x * law.scale) + np.append(np.cumsum(cells[::-1])[::-1], 0.0))


def _discrete(law: ThresholdLaw, stiffness: StiffnessLaw, barrier: Barrier, b: float, log_w: float) -> Moments:
    """Equally likely thresholds: E_P drops at each of them, after a layer in which attempts on it succeed. Panels
    halve towards every threshold from below, and towards 0."""
    xi, counts = np.unique(law.steps / law.scale, return_counts=True)
    if xi.size > _MOST_STEPS:
        raise InputError(f"thresholds: {xi.size} different values; the annealed reference takes at most {_MOST_STEPS}")
    share = counts / counts.sum()
    kappa = relative_stiffness(stiffness, xi, law.rms / law.scale)
    a = b * kappa
    edges = [xi[0] * 2.0 ** -np.arange(1.0, 100.0)]
    for low, high, scale in zip(np.append(0.0, xi[:-1]), xi, 2 * a * xi, strict=True):
        depth = 6 + math.ceil(math.log2(max(scale * (high - low), 1.0)))
        edges.append(high - (high - low) * np.append(2.0 ** -(np.arange(2 * depth) / 2), 0.0))
    edge = np.unique(np.concatenate(edges))

    def integrate(order: int) -> Array:
        nodes, weights = np.polynomial.legendre.leggauss(order)
        half = 0.5 * np.diff(edge)[:, None]
        x = (edge[:-1, None] + half * (1.0 + nodes)).ravel()
        G = np.zeros(x.size)
        for j in range(xi.size):
            k = np.searchsorted(x, xi[j])
            G[:k] += share[j] * np.exp(log_hazard(barrier, x[:k], xi[j], a[j]))
            G[k:] += share[j] * np.exp(log_hazard(barrier, xi[j], xi[j], a[j]))
        above = np.searchsorted(xi, x, side="right")
        alive = np.append(np.cumsum(share[::-1])[::-1], 0.0)[above]
        stiff = np.append(np.cumsum((share * kappa)[::-1])[::-1], 0.0)[above]
        thermal = np.exp(-np.exp(np.minimum(np.log(G) + log_w, 7.0))) * (half * weights).ravel()
        return np.array([np.sum(thermal * alive), np.sum(thermal * stiff * x)])

    fine, coarse = integrate(8), integrate(5)
    error = np.abs(fine - coarse) + 1e-11 * fine
    return Moments(fine[0], fine[1], error[0], error[1])
