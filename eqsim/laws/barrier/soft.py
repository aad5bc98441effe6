"""Soft barrier: the elastic energy that a contact lacks at its threshold,

    r = exp(-a (xi^2 - x^2)),    H = exp(-a xi^2) sqrt(pi)/(2 sqrt(a)) erfi(sqrt(a) x)

(behind temper11 of Braun and Peyrard, 2011; H derived).
"""

import functools
import math
from typing import Any, ClassVar

import numpy as np
from scipy import special

from eqsim.laws.barrier import base
from eqsim.laws.barrier.base import Barrier, Numbers
from eqsim.numerics.compiled import routine
from eqsim.numerics.quadrature import gauss_legendre
from eqsim.numerics.tables import (
    Array,
    look_up,
    look_up_all,
    octave_edges,
    octave_table,
)
from eqsim.numerics.vector_math import FLAT, bounded_exp, log_one_plus


class Soft(Numbers, Barrier):
    """E = a (xi^2 - x^2), p = 1."""

    __slots__ = ()
    flat_out: ClassVar[float] = 1e16

    @staticmethod
    def exponent(gap: Any, total: Any, xi: Any, a: Any) -> Any:
        return a * gap * total

    @classmethod
    def log_hazard(cls, x: Any, xi: Any, a: Any) -> Array:
        root = np.sqrt(a)
        with np.errstate(divide="ignore"):  # x = 0
            return cls.log_rate(x, xi, a) + np.log(special.dawsn(root * x) / root)

    @classmethod
    def width(cls, exponent: Any, y: Any, a: Any) -> Array:
        return np.asarray((exponent / a) / (y + np.sqrt(y**2 + exponent / a)))

    def stretch_at(self, levels: Array, xi: Array, a: Array) -> Array:
        c = (a * xi**2)[:, None]
        log_erfi = levels - self.log_w + c + np.log(2.0 * np.sqrt(a / math.pi))[:, None]
        z2 = np.maximum(log_erfi, 1.0)
        for _ in range(3):  # erfi(z) ~ exp(z^2)/(sqrt(pi) z)
            z2 = np.maximum(log_erfi + 0.5 * np.log(math.pi * z2), 1.0)
        small = 0.5 * math.sqrt(math.pi) * np.exp(np.minimum(log_erfi, 1.0))
        z = np.where(log_erfi > 1.0, np.sqrt(z2), np.minimum(small, 1.0))
        return np.asarray(z / np.sqrt(a)[:, None])

    @classmethod
    def table(cls) -> Array:
        return erfi_inverse_table()

    @classmethod
    def hazard_table(cls) -> Array:
        return dawson_table()


def log_erfi(z: Any) -> Array:
    """ln erfi(z) for z > 0 of any size, through Dawson's function."""
    z = np.asarray(z, float)
    return z**2 + np.log(2.0 / math.sqrt(math.pi) * special.dawsn(z))


# It has no parameters, and takes 3 to 8 ms.
@functools.cache
def erfi_inverse_table() -> Array:
    """z as a function of s = ln(1 + erfi(z)): linear at small s, sqrt(s) at large s, up
    to s = 2^60. The relative error is below 5e-10."""
    first, last = -30, 60
    s = octave_edges(first, last)
    target = np.where(s > 40, s, np.log(np.expm1(np.minimum(s, 40))))
    z = np.where(s < 1, s * math.sqrt(math.pi) / 2, np.sqrt(s + 1))
    for _ in range(60):  # Newton for ln erfi, whose derivative is 1/dawsn
        z = np.maximum(z - (log_erfi(z) - target) * special.dawsn(z), z / 4)
    return octave_table(first, z, special.dawsn(z) / -np.expm1(-s))


_LEAST_Z = 2.0**-20  # below it Dawson's function is z, to 1e-12


# It has no parameters.
@functools.cache
def dawson_table() -> Array:
    """z/dawsn(z) as a function of z: 1 at small z, 2 z^2 at large z, up to 2^40."""
    first, last = -20, 40
    z = octave_edges(first, last)
    dawson = special.dawsn(z)
    ratio = z / dawson
    return octave_table(first, ratio, (1.0 - ratio * (1.0 - 2.0 * z * dawson)) / dawson)


# The inverse of (omega/v) H in steps, each of which is a loop of its own where many
# contacts break: a look-up between the others would keep them from being vectorised,
# and in one long loop every result would wait for many before it.

_SOFT = 2.0 / math.sqrt(math.pi)


@routine(inline=True)
def _excess(xi: float, root: float, log_w: float) -> float:
    """a xi^2 - ln(omega/v), root = sqrt(a)."""
    top = root * xi
    return top * top - log_w


@routine(inline=True)
def _odds(xi: float, root: float, log_w: float, clock: float) -> float:
    """erfi(root x) of the x where (omega/v) H(x) = clock, with the exponent cut at
    FLAT."""
    return _SOFT * clock * root * bounded_exp(min(_excess(xi, root, log_w), FLAT))


@routine(inline=True)
def _rank(xi: float, root: float, log_w: float, odds: float) -> float:
    """ln(1 + erfi(root x)) of the same x."""
    return log_one_plus(odds) + max(_excess(xi, root, log_w) - FLAT, 0.0)


@routine(inline=True)
def _end(xi: float, per_root: float, z: float) -> float:
    """Stretch x = z per_root at which a soft contact breaks, per_root = 1/root; past
    the table it is xi, to double precision."""
    return min(xi, z * per_root + (math.inf if z > 1e9 else 0.0))


@base.height_slope.register(Soft)
def _height_slope(law: Soft, xi: float, x: float, a: float) -> float:
    return 2.0 * a * xi


@base.stretch.register(Soft)
def _stretch(law: Soft, table: Array, xi: float, k: float, clock: float) -> float:
    root = math.sqrt(law.b * k)
    rank = _rank(xi, root, law.log_w, _odds(xi, root, law.log_w, clock))
    return _end(xi, 1.0 / root, look_up(table, rank))


@base.stretches.register(Soft)
def _stretches(
    law: Soft, table: Array, springs: Any, lives: Any, r: int, count: int
) -> None:
    threshold, stiffness = lives.threshold, lives.stiffness
    clock, travel, log_w = lives.clock, lives.travel, law.log_w
    root, per_root, rank = lives.root, lives.per_root, lives.rank
    if springs.slope == 0.0:  # roots and divisions are the same for all
        same = math.sqrt(law.b)
        for i in range(count):
            root[i] = same
            per_root[i] = 1.0 / same
    else:
        for i in range(count):
            root[i] = math.sqrt(law.b * stiffness[r, i])
            per_root[i] = 1.0 / root[i]
    for i in range(count):
        rank[i] = _odds(threshold[r, i], root[i], log_w, clock[r, i])
    for i in range(count):
        rank[i] = _rank(threshold[r, i], root[i], log_w, rank[i])
    look_up_all(table, rank, lives.row, count)
    for i in range(count):
        travel[r, i] = _end(threshold[r, i], per_root[i], rank[i])


@base.hazard.register(Soft)
def _hazard(law: Soft, table: Array, xi: float, k: float, x: float) -> float:
    a = law.b * k
    per_dawson = look_up(table, max(math.sqrt(a) * x, _LEAST_Z))
    return math.exp(law.log_w - a * max(xi - x, 0.0) * (xi + x)) * x / per_dawson


@base.mean_rate.register(Soft)
def _mean_rate(
    law: Soft, table: Array, xi: float, k: float, x: float, length: float
) -> float:
    """Expand short lengths about the middle: mean of exp(p t + q t^2) over -1 < t < 1
    (derived)."""
    middle = x + 0.5 * length
    p, q = (law.b * k * middle * length, 0.25 * law.b * k * length * length)
    if p > 0.25 or q > 0.004:
        end = base.hazard(law, table, xi, k, x + length)
        return (end - base.hazard(law, table, xi, k, x)) / length
    p2 = p * p
    mean = 1.0 + p2 * (1.0 / 6.0 + p2 * (1.0 / 120.0 + p2 / 5040.0))
    mean += q * (1.0 / 3.0 + p2 * (0.1 + p2 / 168.0) + q * (0.1 + p2 / 28.0 + q / 42.0))
    return base.rate(law, xi, k, middle) * mean


# Travel from stretch y, with z = sqrt(a) y, s = sqrt(a) l and T = (v/omega) clock
# sqrt(a) exp(a (xi^2 - y^2)): I(z, s) = int_0^s exp(2 z t + t^2) dt = exp(s^2 + 2 z s)
# D(z + s) - D(z) = T,   D Dawson's function     (derived)

_SHORT_NODES, _SHORT_WEIGHTS = (tuple(part.tolist()) for part in gauss_legendre(8))


@routine(inline=True)
def _ahead(z: float, s: float) -> float:
    """I(z, s) where its integrand changes by a factor of a few."""
    total = 0.0
    for i in range(8):
        t = 0.5 * s * (1.0 + _SHORT_NODES[i])
        total += _SHORT_WEIGHTS[i] * math.exp(t * (2.0 * z + t))
    return 0.5 * s * total


@routine(inline=True)
def _dawson(table: Array, z: float) -> float:
    return z / look_up(table, max(z, _LEAST_Z))


@routine(inline=True)
def _log_ticks(law: Soft, xi: float, a: float, y: float, clock: float) -> float:
    """ln T."""
    return math.log(clock) - law.log_w + 0.5 * math.log(a) + a * (xi - y) * (xi + y)


@routine(inline=True)
def _short(z: float, ticks: float) -> float:
    """s to third order in T, (2|z| + 1) T < 1e-4, z of any sign."""
    return ticks * (1.0 + ticks * (-z + ticks * (4.0 * z * z - 1.0) / 3.0))


@base.onward.register(Soft)
def _onward(law: Soft, c: Any, xi: float, k: float, y: float, clock: float) -> float:
    a = law.b * k
    root = math.sqrt(a)
    z, log_ticks = root * y, _log_ticks(law, xi, a, y, max(clock, 1e-300))
    ticks, D = math.exp(min(log_ticks, 700.0)), _dawson(c.hazard_table, z)
    if (2.0 * z + 1.0) * ticks < 1e-4:
        s = _short(z, ticks)
    else:
        # an upper bound, to begin with
        s = math.log1p(2.0 * z * ticks) / (2.0 * z) if z > 1e-8 else ticks
        if s * (2.0 * z + s) < 1.0:
            for _ in range(5):  # Newton
                s += (ticks - _ahead(z, s)) * math.exp(-s * (2.0 * z + s))
        else:
            level = log_ticks + math.log1p(D * math.exp(-log_ticks))
            # s^2 + 2 z s
            e = max(1.0, level + 0.5 * math.log(4.0 * (z * z + max(level, 1.0))))
            for _ in range(6):  # Newton
                end = math.sqrt(z * z + e)
                D = _dawson(c.hazard_table, end)
                e = max(e - (e + math.log(D) - level) * 2.0 * end * D, 0.1)
            s = e / (z + math.sqrt(z * z + e))
    return min(s / root, xi - y)


@base.back.register(Soft)
def _back(
    law: Soft, c: Any, xi: float, k: float, y: float, clock: float
) -> tuple[float, float]:
    a = law.b * k
    root = math.sqrt(a)
    z, D = root * y, _dawson(c.hazard_table, root * y)
    ticks = math.exp(min(_log_ticks(law, xi, a, y, max(clock, 1e-300)), 700.0))
    if ticks >= D:
        return y, clock * (1.0 - D / ticks)
    if (2.0 * z + 1.0) * ticks < 1e-4:
        s = _short(-z, ticks)
    elif 2.0 * z * ticks < 0.5:
        s = ticks
        for _ in range(6):  # Newton
            s += (ticks - _ahead(-z, s)) * math.exp(s * (2.0 * z - s))
    else:
        rest = D - ticks
        level = z * z + math.log(_SOFT * rest)  # ln erfi(z - s)
        rank = math.log1p(math.exp(level)) if level < FLAT else level
        end = look_up(c.barrier_table, rank)
        s = max(math.log(_dawson(c.hazard_table, end) / rest), 0.0) / (z + end)
    return min(s / root, y), -1.0
