"""Bell's bond, whose off-rate grows by e in each f_b of its force f = k_i x (Bell,
Science 200, 618, 1978):

    k(f) = k_0 exp(f/f_b),    H = (exp(a x) - 1)/a,    a = k_i/f_b

(H derived). The rate at zero force, k_0, stands in the place of omega. A threshold
breaks the bond besides, but does not change the rate.
"""

import math
from typing import Any, ClassVar

import numpy as np

from eqsim.laws.barrier import base
from eqsim.laws.barrier.base import Barrier, Numbers
from eqsim.numerics.compiled import routine
from eqsim.numerics.tables import Array

# Rates stop to rise at exp(MOST) k_0: whatever else is in range, a bond has broken far
# before, and no product of rate, exp(log_w) and length overflows.
MOST = 460.0


class ByForce(Barrier):
    """Base of bonds whose rate depends on their force alone; b = k x_* over a force."""

    __slots__ = ()
    flat_out: ClassVar[float] = math.inf
    by_force: ClassVar[bool] = True

    @classmethod
    def width(cls, exponent: Any, y: Any, a: Any) -> Array:
        return np.full(np.broadcast(exponent, y, a).shape, math.inf)

    @property
    def lasting(self) -> bool:
        return True

    @property
    def opened_alone(self) -> "ByForce":
        """The bond without the pathway that force closes."""
        return self

    @classmethod
    def declared(
        cls, thermal: Any, stiffness: float, unit: float, velocity: float
    ) -> tuple[float, ...]:
        b, rate, *others = cls.numbers(thermal, stiffness, unit)
        return b, rate * unit / velocity, *others


@base.slopes.register(ByForce)
def _slopes(
    law: ByForce, xi: float, x: float, k: float, growth: float
) -> tuple[float, float, float]:
    a, part = law.b * k, 1e-6
    more = base.height(law, xi, x, a * (1.0 + part)) - base.height(law, xi, x, a)
    stiffer = growth * x
    most = max(law.b * (k + stiffer), 1e-300)
    return more / part * growth / k, most, stiffer / (k + stiffer)


def log_mean(z: Any) -> Array:
    """ln((exp(z) - 1)/z) of z of any sign: the mean of exp over 0 to z."""
    size = np.maximum(np.abs(z), 1e-300)
    return np.asarray(np.log(-np.expm1(-size) / size) + np.maximum(z, 0.0))


def opened(slope: Array, log_ticks: Array) -> Array:
    """Stretch x at which the mean of exp(slope y) over 0 < y < x, times x, is
    exp(log_ticks)."""
    slope = np.maximum(slope, 1e-100)
    return np.asarray(np.logaddexp(0.0, np.log(slope) + log_ticks) / slope)


@routine(inline=True)
def fallen(z: float) -> float:
    """(1 - exp(-z))/z, z >= 0: the mean of exp(-y) over 0 to z."""
    return -math.expm1(-z) / z if z > 0.0 else 1.0


class Bell(Numbers, ByForce):
    """E = -a x, p = 1."""

    __slots__ = ()
    keys: ClassVar[tuple[str, ...]] = ("force_scale", "off_rate")
    b_words: ClassVar[str] = "k x_*/force_scale"

    @classmethod
    def numbers(cls, thermal: Any, stiffness: float, unit: float) -> tuple[float, ...]:
        return stiffness * unit / thermal.force_scale, thermal.off_rate

    @staticmethod
    def exponent(gap: Any, total: Any, xi: Any, a: Any) -> Any:
        return -np.minimum(0.5 * a * (total - gap), MOST)

    @classmethod
    def log_rate(cls, x: Any, xi: Any, a: Any) -> Array:
        """ln r without the gap, in which x is lost far below a threshold."""
        return np.asarray(np.minimum(a * x, MOST) + 0.0 * xi)

    @classmethod
    def log_hazard(cls, x: Any, xi: Any, a: Any) -> Array:
        with np.errstate(divide="ignore"):  # x = 0
            return np.log(x) + np.minimum(log_mean(a * x), MOST) + 0.0 * xi

    def stretch_at(self, levels: Array, xi: Array, a: Array) -> Array:
        return opened(a[:, None], levels - self.log_w)


@base.height.register(Bell)
def _height(law: Bell, xi: float, x: float, a: float) -> float:
    return -min(a * x, MOST)


@base.averaged.register(Bell)
def _averaged(law: Bell, xi: float, k: float, x: float, length: float) -> float:
    way = law.b * k * length
    return math.exp(law.log_w + min(law.b * k * x + way, MOST)) * fallen(way)


@routine(inline=True)
def _odds(law: Bell, a: float, y: float, clock: float) -> float:
    """The clock over the hazard in a travel of 1/a at the rate of stretch y."""
    return a * clock * math.exp(-law.log_w - min(a * y, MOST))


@base.stretch.register(Bell)
def _stretch(law: Bell, table: Array, xi: float, k: float, clock: float) -> float:
    return min(math.log1p(_odds(law, law.b * k, 0.0, clock)) / (law.b * k), xi)


@base.onward.register(Bell)
def _onward(law: Bell, c: Any, xi: float, k: float, y: float, clock: float) -> float:
    return min(math.log1p(_odds(law, law.b * k, y, clock)) / (law.b * k), xi - y)


@base.back.register(Bell)
def _back(
    law: Bell, c: Any, xi: float, k: float, y: float, clock: float
) -> tuple[float, float]:
    odds, most = _odds(law, law.b * k, y, clock), -math.expm1(-law.b * k * y)
    if odds >= most:
        return y, clock * (1.0 - most / odds)
    return min(-math.log1p(-odds) / (law.b * k), y), -1.0
