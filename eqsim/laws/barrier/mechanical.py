"""No heat, or none that matters: a contact breaks at its threshold."""

import math
from typing import Any, ClassVar, NamedTuple

import numpy as np

from eqsim.laws.barrier import base
from eqsim.laws.barrier.base import Barrier
from eqsim.numerics.tables import Array


class _Numbers(NamedTuple):
    b: float = math.inf
    log_w: float = 0.0


class Mechanical(_Numbers, Barrier):
    """T = 0: E is infinite whatever b and log_w are."""

    __slots__ = ()
    thermal: ClassVar[bool] = False

    @staticmethod
    def exponent(gap: Any, total: Any, xi: Any, a: Any) -> Any:
        return np.full(np.broadcast(gap, total, xi).shape, math.inf)

    @classmethod
    def log_hazard(cls, x: Any, xi: Any, a: Any) -> Array:
        return np.full(np.broadcast(x, xi).shape, -math.inf)


@base.thermal.register(Mechanical)
def _no_heat(law: Any) -> bool:
    return False


@base.stretch.register(Mechanical)
def _at_threshold(law: Any, table: Array, xi: float, k: float, clock: float) -> float:
    return xi


@base.onward.register(Mechanical)
def _up_to_threshold(
    law: Any, c: Any, xi: float, k: float, y: float, clock: float
) -> float:
    return xi - y


@base.back.register(Mechanical)
def _back(
    law: Any, c: Any, xi: float, k: float, y: float, clock: float
) -> tuple[float, float]:
    return y, clock


@base.mean_rate.register(Mechanical)
def _no_mean_rate(
    law: Any, table: Array, xi: float, k: float, x: float, length: float
) -> float:
    return 0.0
