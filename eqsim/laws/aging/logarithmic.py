"""Thresholds that grow as the logarithm of the pinned time, as contact areas do in
laboratories:

    xi(t) = xi(0) (1 + beta ln(1 + t/t_c))

New area joins unstressed, so that the force of a contact stays as it is: its stiffness
is that at birth. Any law of newborn thresholds will do. At velocity v the stretch is x
= v t, and `per_time` is x_*/(v t_c).
"""

import math
from typing import Any, ClassVar, NamedTuple

import numpy as np

from eqsim.errors import InputError, require_number
from eqsim.laws.aging.along import AlongPaths
from eqsim.laws.aging.base import end, growth, smooth
from eqsim.numerics.tables import Array


class Logarithmic(
    NamedTuple("LogarithmicNumbers", [("beta", float), ("per_time", float)]), AlongPaths
):
    """Growth 1 + beta ln(1 + per_time x)."""

    __slots__ = ()
    keys: ClassVar[tuple[str, ...]] = ("beta", "cutoff_time")

    @classmethod
    def check(cls, aging: Any, law: Any, disorder: str) -> None:
        if disorder == "annealed":
            why = "an annealed contact has no threshold that could grow with its age"
            said = f'needs disorder = "quenched"; {why}'
            raise InputError(f'rule = "logarithmic": {said}')

    @classmethod
    def reduced(cls, aging: Any, law: Any, velocity: float) -> "Logarithmic":
        """The law of an `Aging`. Raises InputError unless v t_c is within 1e-100 to
        1e100 of a threshold."""
        slid = velocity / law.scale * aging.cutoff_time
        name = "velocity * cutoff_time / threshold"
        require_number(name, slid, least=1e-100, most=1e100)
        return cls(aging.beta, 1.0 / slid)

    def growth_at(self, x: Array) -> Array:
        return np.asarray(1.0 + self.beta * np.log1p(self.per_time * x))

    def bracket(self, xi: Any) -> tuple[Any, Any]:
        # The growth is concave, so below any of its tangents; that of slope 1/2, or of
        # less where it starts flatter, meets the stretch no later than here.
        flatness = np.maximum(2.0 * xi * self.beta * self.per_time, 1.0)
        return xi, 2.0 * xi * (1.0 + self.beta * np.log(flatness))


@growth.register(Logarithmic)
def _growth(law: Logarithmic, x: float) -> float:
    return 1.0 + law.beta * math.log1p(law.per_time * x)


@end.register(Logarithmic)
def _end(law: Logarithmic, xi: float) -> float:
    # The growth is concave, so that Newton's method, begun beyond the only root where
    # the excess falls (at the end of `bracket`), descends to it.
    beta, rate = law.beta, law.per_time
    x = 2.0 * xi * (1.0 + beta * math.log(max(2.0 * xi * beta * rate, 1.0)))
    for _ in range(100):
        slope = xi * beta * rate / (1.0 + rate * x)
        step = (xi * (1.0 + beta * math.log1p(rate * x)) - slope * x) / (1.0 - slope)
        if not step < x * (1.0 - 2e-16):
            break
        x = step
    return x


@smooth.register(Logarithmic)
def _smooth(law: Logarithmic, x0: float, x1: float) -> bool:
    # ln(1 + x/(v t_c)) has an end at x = -v t_c
    return law.per_time * (x1 - x0) <= 2.0 * (1.0 + law.per_time * x0)
