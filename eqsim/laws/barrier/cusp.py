"""Cusp barrier: a harmonic well that ends in a cusp,

    r = (1 - x/xi) exp(-a xi^2 (1 - x/xi)^2),
    H = 1/(2 a xi) (exp(-a xi^2 (1 - x/xi)^2) - exp(-a xi^2))

(nu = 1/2 of eq. (3) of Dudko, Hummer and Szabo, Phys. Rev. Lett. 96, 108101, 2006; H
derived). The stiff barrier is their nu = 2/3; the soft one, a difference of squares, is
none of theirs.
"""

import math
from typing import Any, ClassVar

import numpy as np

from eqsim.laws.barrier import base
from eqsim.laws.barrier.base import Barrier, Numbers
from eqsim.numerics.compiled import routine
from eqsim.numerics.tables import Array
from eqsim.numerics.vector_math import FLAT, bounded_exp, log_one_plus


class Cusp(Numbers, Barrier):
    """E = a (xi - x)^2, p = 1 - x/xi."""

    __slots__ = ()
    # thermal breaks are within sqrt(230/b) xi of the threshold
    flat_out: ClassVar[float] = 1e23

    @staticmethod
    def exponent(gap: Any, total: Any, xi: Any, a: Any) -> Any:
        return a * gap * gap

    @staticmethod
    def prefactor(gap: Any, xi: Any) -> Any:
        return gap / xi

    @classmethod
    def log_hazard(cls, x: Any, xi: Any, a: Any) -> Array:
        fall = a * x * (2.0 * xi - x)  # of E
        with np.errstate(divide="ignore"):  # x = 0
            log_share = np.log(-np.expm1(-fall))
        return np.asarray(log_share - np.log(2.0 * a * xi) - a * (xi - x) ** 2)

    @classmethod
    def width(cls, exponent: Any, y: Any, a: Any) -> Array:
        return np.asarray(np.sqrt(exponent / a) + 0.0 * y)

    def stretch_at(self, levels: Array, xi: Array, a: Array) -> Array:
        c = (a * xi**2)[:, None]
        log_odds = c + np.log(2.0 * (a * xi))[:, None] + levels - self.log_w
        spent = np.minimum(np.logaddexp(0.0, log_odds) / c, 1.0)  # 1 - (1 - x/xi)^2
        return np.asarray(xi[:, None] * spent / (1.0 + np.sqrt(1.0 - spent)))


@routine(inline=True)
def _way(gap: float, barrier: float, log_w: float, odds: float) -> float:
    """Travel of a contact that is `gap` below its threshold until (omega/v) H has grown
    by its clock: `odds` is exp(fall of the barrier) - 1, the exponent cut at FLAT."""
    excess, log_odds = barrier - log_w, log_one_plus(odds)
    spent = (log_odds + max(excess - FLAT, 0.0)) / barrier
    # 1 - spent, without cancellation where the barrier is high
    left = ((barrier if excess < FLAT else FLAT + log_w) - log_odds) / barrier
    return min(gap, gap * spent / (1.0 + math.sqrt(left))) if left > 0.0 else gap


@base.stretch.register(Cusp)
def _stretch(law: Cusp, table: Array, xi: float, k: float, clock: float) -> float:
    a = law.b * k
    barrier = a * xi * xi
    odds = 2.0 * a * xi * clock * bounded_exp(min(barrier - law.log_w, FLAT))
    return _way(xi, barrier, law.log_w, odds)


@base.mean_rate.register(Cusp)
def _mean_rate(
    law: Cusp, table: Array, xi: float, k: float, x: float, length: float
) -> float:
    near, far, a = max(xi - x - length, 0.0), max(xi - x, 0.0), law.b * k
    fall = a * length * (near + far)  # of E
    # of exp(-E), over its greatest value
    mean = -math.expm1(-fall) / fall if fall > 0.0 else 1.0
    return math.exp(law.log_w - a * near * near) * mean * 0.5 * (near + far) / xi


@base.onward.register(Cusp)
def _onward(law: Cusp, c: Any, xi: float, k: float, y: float, clock: float) -> float:
    """Travel of an unstretched contact of threshold xi - y with the barrier that is
    left at y (derived)."""
    a, gap = law.b * k, xi - y
    barrier = max(a * gap * gap, 1e-300)
    odds = 2.0 * a * xi * clock * bounded_exp(min(barrier - law.log_w, FLAT))
    return _way(gap, barrier, law.log_w, odds)


@base.back.register(Cusp)
def _back(
    law: Cusp, c: Any, xi: float, k: float, y: float, clock: float
) -> tuple[float, float]:
    a, gap = law.b * k, xi - y
    barrier = a * gap * gap
    odds = 2.0 * a * xi * clock * bounded_exp(min(barrier - law.log_w, FLAT))
    most = -math.expm1(-a * y * (gap + xi))
    if odds >= most:
        return y, clock * (1.0 - most / odds)
    rise = -math.log1p(-odds) / a
    return min(rise / (gap + math.sqrt(gap * gap + rise)), y), -1.0
