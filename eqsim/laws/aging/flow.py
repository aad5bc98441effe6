"""Thresholds that flow: xi(x) = xi(0) x_*(x)/x_*i (derived, see `laws.aging.base`)."""

import math
from typing import Any, NamedTuple

import numpy as np

from eqsim.laws.aging.base import (
    AgingLaw,
    break_lives,
    change2,
    end,
    growth,
    life,
    scale2,
    stiffness_varies,
    whole_hazard,
    work,
)
from eqsim.laws.barrier.base import height, prefactor, thermal
from eqsim.laws.stiffness import Springs, kappa
from eqsim.numerics.compiled import inlined, routine
from eqsim.numerics.tables import NO_TABLE, Array, look_up, octave_edges, octave_table


class _Numbers(NamedTuple):
    final2: float
    alpha: float


class Flow(_Numbers, AgingLaw):
    """Every threshold moves with the scale of the law. The stiffness of the sqrt law follows it."""

    __slots__ = ()

    @classmethod
    def reduced(cls, final2: float, alpha: float, n: float) -> "Flow":
        """The law from its numbers; n has no part in it."""
        return cls(final2, alpha)

    def growth_at(self, x: Array) -> Array:
        return np.sqrt(scale2(self.final2, self.alpha * x))

    def table(self, springs: Springs) -> Array:
        return work_table(self.final2) if springs.slope > 0.0 else NO_TABLE


def work_table(final2: float) -> Array:
    """By how much the mean of x_*(y)/x_*i, weighted with y, over 0 < y < x differs from 1, up to the sign, over
    2 and of alpha x: it rises, from a line through the origin to a constant, over which the table may be continued."""
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


_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(10)
_RANGE, _GROWN, _NEGLIGIBLE, _DEEPEST = 4.0, 1.5, 37.0, 60


@growth.register(Flow)
def _growth(law: Flow, x: float) -> float:
    return math.sqrt(1.0 - (law.final2 - 1.0) * math.expm1(-law.alpha * x))


@routine
def flow_end(law: Flow, xi: float) -> float:
    """Where a threshold born as `xi` meets the stretch, by Newton's method kept inside a shrinking bracket."""
    final2, alpha = law.final2, law.alpha
    low, high = xi * min(1.0, math.sqrt(final2)), xi * max(1.0, math.sqrt(final2))
    x = high
    for _ in range(200):
        decay = math.exp(-alpha * x)
        excess = xi * xi * (final2 - (final2 - 1.0) * decay) - x * x
        if excess >= 0.0:
            low = x
        if excess <= 0.0:
            high = x
        slope = xi * xi * (final2 - 1.0) * alpha * decay - 2.0 * x
        step = x - excess / slope if slope < 0.0 else low
        if not low <= step <= high:
            step = 0.5 * (low + high)
        if abs(step - x) <= 2e-16 * x:
            return step
        x = step
    return x


class _Flowing(NamedTuple):
    """A contact that flows: its laws, its threshold at birth, and where it breaks mechanically."""

    law: Flow
    barrier: Any
    springs: Springs
    xi: float
    end: float


@inlined
def _at(c: _Flowing, x: float) -> tuple[float, float]:
    """Threshold at stretch x, and the barrier there."""
    xi = c.xi * growth(c.law, x)
    return xi, height(c.barrier, xi, x, c.barrier.b * kappa(c.springs, xi))


@routine
def flow_life(law: Flow, barrier: Any, springs: Springs, xi: float, clock: float) -> tuple[float, float]:
    """Where a contact with threshold `xi` at birth breaks whose clock shows `clock`, and the hazard it has spent.

    The hazard along xi s(x) has no closed form. It is integrated over z, x = end z (2 - z), which makes it smooth where
    a stiff barrier vanishes, by 10 Gauss-Legendre nodes in dyadic cells. A cell is halved unless the barrier and the
    aging vary little in it, or nothing happens in it: the barrier first rises, then falls (derived, for rising
    thresholds; for falling ones it falls), so its least value in a cell is at an end. Error 5e-9 of the hazard.
    """
    end = flow_end(law, xi)
    if not thermal(barrier):
        return end, 0.0
    final2, alpha, log_w = law.final2, law.alpha, barrier.log_w
    c = _Flowing(law, barrier, springs, xi, end)
    floor = math.log(min(clock, 100.0)) - _NEGLIGIBLE
    spent, level, index, left = 0.0, 0, 0, height(barrier, xi, 0.0, barrier.b * kappa(springs, xi))
    while True:
        width = 0.5**level
        z = index * width
        x0, x1 = end * z * (2.0 - z), end * (z + width) * (2.0 - z - width)
        now, right = _at(c, x1)
        seen = log_w + math.log(2.0 * end * width) - min(left, right) > floor
        last = level >= _DEEPEST or x1 - x0 <= 4e-16 * x1  # rounding is all that still varies, times b perhaps a lot
        fine = last or (
            abs(right - left) <= _RANGE
            and (alpha * (x1 - x0) <= 1.0 or alpha * x0 > 40.0 or final2 == 1.0)
            and now <= _GROWN * xi * growth(law, x0)  # x_*(x)^2 vanishes at some x < 0, perhaps nearby
        )
        if seen and fine and not last:
            for quarter in range(1, 4):  # the barrier may rise and fall inside
                part = z + 0.25 * quarter * width
                inner = end * part * (2.0 - part)
                _, middle = _at(c, inner)
                fine = fine and max(abs(middle - left), abs(middle - right)) <= _RANGE
        if seen and not fine:
            level, index = level + 1, 2 * index
            continue
        if seen:
            whole = _hazard_in(c, z, width)
            if spent + whole >= clock:
                # Newton for the hazard in part of the cell, in a bracket
                low, high, part = 0.0, width, width * (clock - spent) / whole
                for _ in range(60):
                    found = _hazard_in(c, z, part)
                    excess = spent + found - clock
                    if excess > 0.0:
                        high = part
                    else:
                        low = part
                    rate = _rate(c, z + part)
                    step = part - excess / rate if rate > 0.0 else 0.5 * (low + high)
                    if not low <= step <= high:
                        step = 0.5 * (low + high)
                    if abs(step - part) <= 1e-13 * part or abs(excess) <= 1e-14 * clock:
                        part = step
                        break
                    part = step
                z += part
                return end * z * (2.0 - z), clock
            spent += whole
        left, index = right, index + 1
        while index % 2 == 0 and level > 0:
            level, index = level - 1, index // 2
        if level == 0 and index == 1:
            return end, spent


@inlined
def _rate(c: _Flowing, z: float) -> float:
    """Hazard per unit z."""
    x = c.end * z * (2.0 - z)
    now = max(c.xi * growth(c.law, x), x)
    barrier = height(c.barrier, now, x, c.barrier.b * kappa(c.springs, now))
    return math.exp(c.barrier.log_w - barrier) * 2.0 * c.end * (1.0 - z) * prefactor(c.barrier, now, x)


@routine
def _hazard_in(c: _Flowing, z: float, width: float) -> float:
    total = 0.0
    for i in range(_NODES.size):
        total += _WEIGHTS[i] * _rate(c, z + 0.5 * width * (1.0 + _NODES[i]))
    return 0.5 * width * total


@end.register(Flow)
def _end(law: Flow, xi: float) -> float:
    return flow_end(law, xi)


@whole_hazard.register(Flow)
def _whole_hazard(law: Flow, barrier: Any, springs: Springs, xi: float) -> tuple[float, float]:
    return flow_life(law, barrier, springs, xi, math.inf)


@life.register(Flow)
def _life(law: Flow, barrier: Any, table: Array, springs: Springs, xi: float, clock: float) -> float:
    return flow_life(law, barrier, springs, xi, clock)[0]


@break_lives.register(Flow)
def _lives(law: Flow, barrier: Any, table: Array, springs: Springs, r: int, lives: Any, row: Array, count: int) -> None:
    stretch, clock, stiffness = lives.stretch, lives.clock, lives.stiffness
    for i in range(count):
        xi = stretch[r, i]
        stiffness[r, i] = kappa(springs, xi)
        stretch[r, i] = flow_life(law, barrier, springs, xi, clock[r, i])[0]


@stiffness_varies.register(Flow)
def _varies(law: Flow, springs: Springs) -> bool:
    return springs.slope > 0.0


@work.register(Flow)
def _work(law: Flow, table: Array, springs: Springs, stiffness: float, x: float) -> float:
    if springs.slope == 0.0:
        return 0.5 * stiffness * x * x
    excess = look_up(table, law.alpha * x)
    return stiffness * (x * x * (0.5 + excess if law.final2 > 1.0 else 0.5 - excess))
