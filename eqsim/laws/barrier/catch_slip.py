"""Catch-slip bond: one pathway that force closes and one that it opens (Pereverzev,
Prezhdo, Forero, Sokurenko and Thomas, Biophys. J. 89, 1446, 2005),

    k(f) = k_c exp(-f/f_c) + k_s exp(f/f_s),
    H = (k_c (1 - exp(-c x))/c + k_s (exp(s x) - 1)/s)/(k_c + k_s)

with c = k_i/f_c and s = k_i/f_s (H derived, without inverse in closed form). The rate
at zero force, k_c + k_s, stands in the place of omega, and the lesser force in that of
f_b.
"""

import math
from typing import Any, ClassVar, NamedTuple

import numpy as np

from eqsim.laws.barrier import base
from eqsim.laws.barrier.bell import MOST, ByForce, fallen, log_mean, opened
from eqsim.numerics.compiled import routine
from eqsim.numerics.tables import Array

# Stretches times k_i/f_c up to which the rate of the catch pathway falls.
_FALLING = 2.0 ** np.arange(-3.0, 6.0)


class _Numbers(NamedTuple):
    b: float
    log_w: float
    # logarithms of the shares of k_s and k_c in the rate at f = 0
    log_slip: float = 0.0
    log_catch: float = -math.inf
    slip: float = 1.0  # f_b/f_s and f_b/f_c
    catch: float = 0.0


class CatchSlip(_Numbers, ByForce):
    """r = exp(log_slip + slip a x) + exp(log_catch - catch a x), p = 1."""

    __slots__ = ()
    keys: ClassVar[tuple[str, ...]] = ("catch", "slip")
    b_words: ClassVar[str] = "k x_*/min(catch.force, slip.force)"

    @property
    def lasting(self) -> bool:
        return self.log_slip > -math.inf or self.catch == 0.0

    @property
    def opened_alone(self) -> "CatchSlip":
        return self._replace(log_catch=-math.inf)

    @classmethod
    def numbers(cls, thermal: Any, stiffness: float, unit: float) -> tuple[float, ...]:
        paths = thermal.slip, thermal.catch
        rate, force = sum(p.rate for p in paths), min(p.force for p in paths)
        logs = (math.log(p.rate / rate) if p.rate > 0 else -math.inf for p in paths)
        over = (1.0 if p.force == force else force / p.force for p in paths)
        return stiffness * unit / force, rate, *logs, *over

    def log_rate(self, x: Any, xi: Any, a: Any) -> Array:  # type: ignore[override]
        slip = np.minimum(self.log_slip + self.slip * a * x, MOST)
        return np.logaddexp(slip, self.log_catch - self.catch * a * x) + 0.0 * xi

    def log_attempt(self, gap: Any, total: Any, xi: Any, a: Any) -> Array:  # type: ignore[override]
        return self.log_rate(0.5 * (total - gap), xi, a)

    def exponent(self, gap: Any, total: Any, xi: Any, a: Any) -> Any:  # type: ignore[override]
        return -self.log_attempt(gap, total, xi, a)

    def log_hazard(self, x: Any, xi: Any, a: Any) -> Array:  # type: ignore[override]
        slip = np.minimum(self.log_slip + log_mean(self.slip * a * x), MOST)
        catch = self.log_catch + log_mean(-self.catch * a * x)
        with np.errstate(divide="ignore"):  # x = 0
            return np.log(x) + np.logaddexp(slip, catch) + 0.0 * xi

    def layers(self, xi: Array, a: Array) -> Array:
        with np.errstate(divide="ignore"):  # no catch
            scale = 1.0 / (self.catch * a)
        return np.minimum(scale[:, None] * _FALLING, xi[:, None])

    def ends_of_panels(self, levels: Array, xi: Array, a: Array) -> Array:
        # once the catch pathway is spent the hazard may rest below a level
        alone = levels - self.log_w - max(self.log_slip, -MOST)
        slip = opened(self.slip * a[:, None], alone)
        return np.concatenate((slip, super().ends_of_panels(levels, xi, a)), 1)


@base.height.register(CatchSlip)
def _height(law: CatchSlip, xi: float, x: float, a: float) -> float:
    slip = min(law.log_slip + law.slip * a * x, MOST)
    catch = law.log_catch - law.catch * a * x
    return -max(slip, catch) - math.log1p(math.exp(-abs(slip - catch)))


@base.averaged.register(CatchSlip)
def _averaged(law: CatchSlip, xi: float, k: float, x: float, length: float) -> float:
    slip, catch = law.slip * law.b * k, law.catch * law.b * k
    rate = math.exp(law.log_w + min(law.log_slip + slip * (x + length), MOST))
    other = math.exp(law.log_w + law.log_catch - catch * x)
    return rate * fallen(slip * length) + other * fallen(catch * length)


@routine(inline=True)
def _longest(law: CatchSlip, k: float, y: float, clock: float) -> float:
    """Travel from y on in which the pathway that force opens alone spends the clock."""
    if law.log_slip < -MOST:
        return math.inf
    slope = law.slip * law.b * k
    ticks = clock * math.exp(-law.log_w - law.log_slip - min(slope * y, MOST))
    return math.log1p(slope * ticks) / slope if slope * ticks > 1e-300 else ticks


@base.stretch.register(CatchSlip)
def _stretch(law: CatchSlip, table: Array, xi: float, k: float, clock: float) -> float:
    most = min(_longest(law, k, 0.0, clock), xi)
    return base.carried(law, xi, k, 0.0, most, clock, 1.0)


@base.onward.register(CatchSlip)
def _onward(
    law: CatchSlip, c: Any, xi: float, k: float, y: float, clock: float
) -> float:
    most = min(_longest(law, k, y, clock), xi - y)
    return base.carried(law, xi, k, y, most, clock, 1.0)
