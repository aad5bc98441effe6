"""Lives along thresholds that grow in a known way, xi(x) = xi(0) s(x): `flow` and `logarithmic`."""

import math
from typing import Any, NamedTuple

import numpy as np

from eqsim.laws.aging.base import break_lives, end, growth, kappa_at, life, smooth, whole_hazard
from eqsim.laws.barrier.base import height, prefactor, thermal
from eqsim.laws.stiffness import Springs, kappa
from eqsim.numerics.compiled import inlined, routine
from eqsim.numerics.tables import Array

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(10)
_RANGE, _GROWN, _NEGLIGIBLE, _DEEPEST = 4.0, 1.5, 37.0, 1000


class _Path(NamedTuple):
    """A contact: its laws, its threshold at birth, and where it breaks mechanically."""

    law: Any
    barrier: Any
    springs: Springs
    xi: float
    end: float


@inlined
def _at(c: _Path, x: float) -> tuple[float, float]:
    """Threshold at stretch x, and the barrier there."""
    xi = c.xi * growth(c.law, x)
    return xi, height(c.barrier, xi, x, c.barrier.b * kappa_at(c.law, c.springs, c.xi, xi))


@routine
def path_life(law: Any, barrier: Any, springs: Springs, xi: float, clock: float) -> tuple[float, float]:
    """Where a contact with threshold `xi` at birth breaks whose clock shows `clock`, and the hazard it has spent.

    The hazard along xi s(x) has no closed form. It is integrated over z, x = end z (2 - z), which makes it smooth where
    a stiff barrier vanishes, by 10 Gauss-Legendre nodes in dyadic cells. A cell is halved unless the barrier and the
    aging vary little in it, or nothing happens in it: the barrier first rises, then falls (derived, for rising
    thresholds; for falling ones it falls), so its least value in a cell is at an end. Error 5e-9 of the hazard.
    """
    top = end(law, xi)
    if not thermal(barrier):
        return top, 0.0
    log_w = barrier.log_w
    c = _Path(law, barrier, springs, xi, top)
    floor = math.log(min(clock, 100.0)) - _NEGLIGIBLE
    spent, level, index, left = 0.0, 0, 0, height(barrier, xi, 0.0, barrier.b * kappa(springs, xi))
    while True:
        width = 0.5**level
        z = index * width
        x0, x1 = top * z * (2.0 - z), top * (z + width) * (2.0 - z - width)
        now, right = _at(c, x1)
        seen = log_w + math.log(2.0 * top * width) - min(left, right) > floor
        last = level >= _DEEPEST or x1 - x0 <= 4e-16 * x1  # rounding is all that still varies, times b perhaps a lot
        fine = last or (
            abs(right - left) <= _RANGE
            and smooth(law, x0, x1)
            and now <= _GROWN * xi * growth(law, x0)  # thresholds vanish at some x < 0, perhaps nearby
        )
        if seen and fine and not last:
            for quarter in range(1, 4):  # the barrier may rise and fall inside
                part = z + 0.25 * quarter * width
                inner = top * part * (2.0 - part)
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
                return top * z * (2.0 - z), clock
            spent += whole
        left, index = right, index + 1
        while index % 2 == 0 and level > 0:
            level, index = level - 1, index // 2
        if level == 0 and index == 1:
            return top, spent


@inlined
def _rate(c: _Path, z: float) -> float:
    """Hazard per unit z."""
    x = c.end * z * (2.0 - z)
    now = max(c.xi * growth(c.law, x), x)
    barrier = height(c.barrier, now, x, c.barrier.b * kappa_at(c.law, c.springs, c.xi, now))
    return math.exp(c.barrier.log_w - barrier) * 2.0 * c.end * (1.0 - z) * prefactor(c.barrier, now, x)


@routine
def _hazard_in(c: _Path, z: float, width: float) -> float:
    total = 0.0
    for i in range(_NODES.size):
        total += _WEIGHTS[i] * _rate(c, z + 0.5 * width * (1.0 + _NODES[i]))
    return 0.5 * width * total


def along_paths(law: type) -> type:
    """A decorator for a law that has `growth`, `end` and `smooth`: its lives."""
    whole_hazard.register(law)(_whole_hazard)
    life.register(law)(_life)
    break_lives.register(law)(_lives)
    return law


def _whole_hazard(law: Any, barrier: Any, springs: Springs, xi: float) -> tuple[float, float]:
    return path_life(law, barrier, springs, xi, math.inf)


def _life(law: Any, barrier: Any, table: Array, springs: Springs, xi: float, clock: float) -> float:
    return path_life(law, barrier, springs, xi, clock)[0]


def _lives(law: Any, barrier: Any, table: Array, springs: Springs, r: int, lives: Any, row: Array, count: int) -> None:
    stretch, clock, stiffness = lives.stretch, lives.clock, lives.stiffness
    for i in range(count):
        xi = stretch[r, i]
        stiffness[r, i] = kappa(springs, xi)
        stretch[r, i] = path_life(law, barrier, springs, xi, clock[r, i])[0]
