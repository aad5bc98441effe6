"""Thresholds that flow: xi(x) = xi(0) x_*(x)/x_*i (derived, see `laws.aging.base`)."""

import math
from typing import Any, NamedTuple

import numpy as np

from eqsim.laws.aging import base
from eqsim.laws.aging.along import AlongPaths
from eqsim.laws.aging.base import Drift, change2, scale2
from eqsim.laws.stiffness import Springs, kappa
from eqsim.numerics.compiled import routine
from eqsim.numerics.quadrature import gauss_legendre
from eqsim.numerics.roots import Bracket, newton
from eqsim.numerics.tables import NO_TABLE, Array, look_up, octave_edges, octave_table


class Flow(
    NamedTuple("FlowNumbers", [("final2", float), ("alpha", float)]), Drift, AlongPaths
):
    """Every threshold moves with the scale of the law. The stiffness of the sqrt law
    follows it."""

    __slots__ = ()

    @classmethod
    def reduced(cls, aging: Any, law: Any, velocity: float) -> "Flow":
        return cls(aging.final(law.x_star) ** 2, aging.alpha(law.x_star, velocity))

    def growth_at(self, x: Array) -> Array:
        return np.sqrt(scale2(self.final2, self.alpha * x))

    def table(self, springs: Springs) -> Array:
        return work_table(self.final2) if springs.slope > 0.0 else NO_TABLE


def work_table(final2: float) -> Array:
    """Table of int_0^x |x_*(y)/x_*i - 1| y dy / x^2 against alpha x, by which the work
    over k_i x^2 differs from 1/2. It rises from a line through the origin to a
    constant, as tables are continued."""
    first, last = -60, 30
    t = octave_edges(first, last)
    half = 0.5 * np.diff(np.append(0.0, t))[:, None]
    y = t[:, None] - half + half * _NODES

    def excess(t: Array) -> Array:
        """|x_*/x_*i - 1|."""
        change = change2(final2, t)
        return np.asarray(np.abs(change) / (1.0 + np.sqrt(1.0 + change)))

    mean = np.cumsum((half * _WEIGHTS * y * excess(y)).sum(axis=1)) / t**2
    return octave_table(first, mean, (excess(t) - 2.0 * mean) / t)


_NODES, _WEIGHTS = gauss_legendre(10)


@base.growth.register(Flow)
def _growth(law: Flow, x: float) -> float:
    return math.sqrt(1.0 - (law.final2 - 1.0) * math.expm1(-law.alpha * x))


@base.end.register(Flow)
@routine
def flow_end(law: Flow, xi: float) -> float:
    """The stretch that meets a threshold born as `xi`, by Newton's method kept inside
    a shrinking bracket."""
    final2, alpha = law.final2, law.alpha
    final = math.sqrt(final2)
    bracket = Bracket(xi * min(1.0, final), xi * max(1.0, final))
    x = bracket.high
    for _ in range(200):
        decay = math.exp(-alpha * x)
        excess = x * x - xi * xi * (final2 - (final2 - 1.0) * decay)
        slope = 2.0 * x - xi * xi * (final2 - 1.0) * alpha * decay
        bracket, step = newton(bracket, x, excess, slope)
        if abs(step - x) <= 2e-16 * x:
            return step
        x = step
    return x


@base.smooth.register(Flow)
def _smooth(law: Flow, x0: float, x1: float) -> bool:
    return law.alpha * (x1 - x0) <= 1.0 or law.alpha * x0 > 40.0 or law.final2 == 1.0


@base.kappa_at.register(Flow)
def _kappa_at(law: Flow, springs: Springs, born: float, now: float) -> float:
    return kappa(springs, now)


@base.stiffness_varies.register(Flow)
def _varies(law: Flow, springs: Springs) -> bool:
    return springs.slope > 0.0


@base.work.register(Flow)
def _work(
    law: Flow, table: Array, springs: Springs, stiffness: float, x: float
) -> float:
    if springs.slope == 0.0:
        return 0.5 * stiffness * x * x
    excess = look_up(table, law.alpha * x)
    return stiffness * (x * x * (0.5 + excess if law.final2 > 1.0 else 0.5 - excess))
