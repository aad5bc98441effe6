"""Stiff barrier: that of a tilted well, close to the force that removes it,

    r = sqrt(1 - x/xi) exp(-a xi^2 (1 - x/xi)^(3/2)),
    H = 2/(3 a xi) (exp(-a xi^2 (1 - x/xi)^(3/2)) - exp(-a xi^2))

(behind temper12 of Braun and Peyrard, 2011; H derived).
"""

import math
from typing import Any, ClassVar

import numpy as np

from eqsim.laws.barrier import base
from eqsim.laws.barrier.base import Barrier, Numbers
from eqsim.numerics.compiled import routine
from eqsim.numerics.tables import Array
from eqsim.numerics.vector_math import FLAT, bounded_exp, log_one_plus, two_thirds_power


class Stiff(Numbers, Barrier):
    """E = a xi^2 (1 - x/xi)^(3/2), p = sqrt(1 - x/xi)."""

    __slots__ = ()
    flat_out: ClassVar[float] = 1e18

    @staticmethod
    def exponent(gap: Any, total: Any, xi: Any, a: Any) -> Any:
        return a * gap * np.sqrt(gap * xi)

    @staticmethod
    def prefactor(gap: Any, xi: Any) -> Any:
        return np.sqrt(gap / xi)

    @classmethod
    def log_hazard(cls, x: Any, xi: Any, a: Any) -> Array:
        c = np.asarray(a * xi**2, float)
        # exp(-c gap^1.5) - exp(-c) = exp(-c gap^1.5) (1 - exp(-c (1 - gap^1.5)))
        with np.errstate(divide="ignore"):  # x = xi
            # 1 - (1 - x/xi)^1.5 without cancellation
            gap15 = -np.expm1(1.5 * np.log1p(-x / xi))
            log_H = math.log(2 / 3) - np.log(a * xi) - c * (1 - gap15)
            return log_H + np.log(-np.expm1(-c * gap15))

    def hazard_over(self, x: Array, way: Array, xi: Array, a: Array) -> Array:
        c, q, step = a * xi**2, np.maximum(xi - x, 0.0) / xi, way / xi
        lower = q + step
        with np.errstate(divide="ignore", invalid="ignore"):
            rise = step * (lower**2 + lower * q + q**2) / (lower**1.5 + q**1.5)
        size = np.exp(np.minimum(self.log_w - c * q**1.5, 300.0)) / (1.5 * a * xi)
        return np.asarray(-np.expm1(-c * np.where(step > 0, rise, 0.0)) * size)

    @classmethod
    def width(cls, exponent: Any, y: Any, a: Any) -> Array:
        return np.asarray(y * np.minimum((exponent / (a * y**2)) ** (2.0 / 3.0), 1e6))

    def stretch_at(self, levels: Array, xi: Array, a: Array) -> Array:
        c = (a * xi**2)[:, None]
        log_odds = c + np.log(1.5 * (a * xi))[:, None] + levels - self.log_w
        spent = np.minimum(np.logaddexp(0.0, log_odds) / c, 1.0)  # 1 - (1 - x/xi)^1.5
        q = (1.0 - spent) ** (2.0 / 3.0)
        # 1 - q without cancellation
        return np.asarray(xi[:, None] * spent * (2.0 - spent) / (1.0 + q + q * q))


@routine(inline=True)
def _odds(xi: float, a: float, log_w: float, clock: float) -> float:
    """exp(a xi^2 (1 - (1 - x/xi)^(3/2))) - 1 of the x where (omega/v) H(x) = clock,
    with the exponent cut at FLAT."""
    return 1.5 * a * xi * clock * bounded_exp(min(a * xi * xi - log_w, FLAT))


@routine(inline=True)
def _spent(xi: float, a: float, log_w: float, odds: float) -> float:
    """1 - (1 - x/xi)^(3/2) of the same x, or more than 1."""
    barrier = a * xi * xi
    return (log_one_plus(odds) + max(barrier - log_w - FLAT, 0.0)) / barrier


@routine(inline=True)
def _end(xi: float, spent: float) -> float:
    """Stretch at which a stiff contact breaks."""
    q = two_thirds_power(max(1.0 - spent, 1e-17))
    x = xi * spent * (2.0 - spent) / (1.0 + q + q * q)  # 1 - q without cancellation
    return min(x, xi) if spent < 1.0 else xi


@base.height_slope.register(Stiff)
def _height_slope(law: Stiff, xi: float, x: float, a: float) -> float:
    part = math.sqrt(max(xi - x, 1e-16 * xi) / xi)
    return a * xi * part * (1.5 + 0.5 * part * part)


@base.path_step.register(Stiff)
def _path_step(law: Stiff) -> float:
    return 0.5  # the rate falls to 0 at the stretch, like a root


@base.stretch.register(Stiff)
def _stretch(law: Stiff, table: Array, xi: float, k: float, clock: float) -> float:
    a = law.b * k
    return _end(xi, _spent(xi, a, law.log_w, _odds(xi, a, law.log_w, clock)))


@base.stretches.register(Stiff)
def _stretches(
    law: Stiff, table: Array, springs: Any, lives: Any, r: int, count: int
) -> None:
    threshold, stiffness = lives.threshold, lives.stiffness
    clock, travel, spent = lives.clock, lives.travel, lives.rank
    b, log_w = law.b, law.log_w
    for i in range(count):  # in steps, as in `soft`
        spent[i] = _odds(threshold[r, i], b * stiffness[r, i], log_w, clock[r, i])
    for i in range(count):
        spent[i] = _spent(threshold[r, i], b * stiffness[r, i], log_w, spent[i])
    for i in range(count):
        travel[r, i] = _end(threshold[r, i], spent[i])


@base.hazard.register(Stiff)
def _hazard(law: Stiff, table: Array, xi: float, k: float, x: float) -> float:
    a = law.b * k
    barrier = a * xi * xi
    spent = -math.expm1(1.5 * math.log1p(-min(x / xi, 1.0)))  # 1 - (1 - x/xi)^(3/2)
    reached = -math.exp(law.log_w - barrier * (1.0 - spent))
    return reached * math.expm1(-barrier * spent) / (1.5 * a * xi)


@base.mean_rate.register(Stiff)
def _mean_rate(
    law: Stiff, table: Array, xi: float, k: float, x: float, length: float
) -> float:
    near, far = max(xi - x - length, 0.0) / xi, max(xi - x, 0.0) / xi
    whole = law.b * k * xi * xi
    left, before = near * math.sqrt(near), far * math.sqrt(far)
    if left + before == 0.0:
        return 0.0
    per_length = (near * near + near * far + far * far) / (left + before)
    fall = whole * (length / xi) * per_length  # of E
    # of exp(-E), over its greatest value
    mean = -math.expm1(-fall) / fall if fall > 0.0 else 1.0
    return math.exp(law.log_w - whole * left) * mean * per_length / 1.5


@base.onward.register(Stiff)
def _onward(law: Stiff, c: Any, xi: float, k: float, y: float, clock: float) -> float:
    """Travel of an unstretched contact of threshold xi - y with the barrier that is
    left at y (derived)."""
    a, gap = law.b * k, xi - y
    left = gap / xi
    barrier = max(a * xi * xi * left * math.sqrt(left), 1e-300)
    odds = 1.5 * a * xi * clock * bounded_exp(min(barrier - law.log_w, FLAT))
    above = max(barrier - law.log_w - FLAT, 0.0)
    return _end(gap, (log_one_plus(odds) + above) / barrier)


@base.back.register(Stiff)
def _back(
    law: Stiff, c: Any, xi: float, k: float, y: float, clock: float
) -> tuple[float, float]:
    a, left = law.b * k, (xi - y) / xi
    whole, start = a * xi * xi, left * math.sqrt(left)
    barrier = whole * start
    odds = 1.5 * a * xi * clock * bounded_exp(min(barrier - law.log_w, FLAT))
    most = -math.expm1(barrier - whole)
    if odds >= most:
        return y, clock * (1.0 - most / odds)
    rise = -math.log1p(-odds) / whole
    if rise < start:
        s = xi * left * math.expm1(2.0 / 3.0 * math.log1p(rise / start))
    else:
        s = xi * ((start + rise) ** (2.0 / 3.0) - left)
    return min(s, y), -1.0
