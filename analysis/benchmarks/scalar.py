"""Rival B: the same event-driven algorithm as a plain scalar numba kernel: libm,
np.random, float64 sums, and of all that eqsim records only the mean force.

It is written for n = 1 and for moderate kT: xi^2 is the sum of two exponential
variables, which is quickest to draw, and the stiff inverse is the short formula that
does without logarithms of exponentials.
"""

import math

import numba
import numpy as np
from numpy.typing import NDArray

from analysis.benchmarks.cases import VELOCITY, Case

BATCHES = 32  # independent parts of a run, whose scatter is the error

_HALF_ROOT_PI = math.sqrt(math.pi) / 2
_DAWSON_STEP = 0.4
_DAWSON_WEIGHTS = tuple(
    math.exp(-(((2 * i + 1) * _DAWSON_STEP) ** 2)) for i in range(6)
)


@numba.njit
def dawson(z: float) -> float:
    """Dawson's function of z > 0 to 5e-8 (Rybicki, 1989)."""
    if z < 0.2:
        q = z * z
        return z * (1.0 - 2.0 / 3.0 * q * (1.0 - 0.4 * q * (1.0 - 2.0 / 7.0 * q)))
    even = 2 * int(0.5 * z / _DAWSON_STEP + 0.5)
    rest = z - even * _DAWSON_STEP
    up = math.exp(2.0 * rest * _DAWSON_STEP)
    down, total = 1.0 / up, 0.0
    up_square, down_square = up * up, down * down
    for i in range(6):
        odd = 2 * i + 1
        # up / (even + odd) + down / (even - odd) with one division
        total += (
            _DAWSON_WEIGHTS[i]
            * (up * (even - odd) + down * (even + odd))
            / (even * even - odd * odd)
        )
        up *= up_square
        down *= down_square
    return math.exp(-rest * rest) * total / math.sqrt(math.pi)


@numba.njit
def soft_stretch(xi: float, a: float, log_clock: float) -> float:
    """Stretch at which ln of the soft hazard is `log_clock`, or xi, by Newton's method
    for ln erfi(z) = z^2 + ln(D(z)) + const, slope 1/D."""
    root = math.sqrt(a)
    target = log_clock + math.log(root / _HALF_ROOT_PI) + a * xi * xi
    if target < 0.0:
        z = _HALF_ROOT_PI * math.exp(target)
        z /= 1.0 + z * z / 3.0
    else:
        z = math.sqrt(target + math.log(2.0 * _HALF_ROOT_PI * math.sqrt(target + 1.0)))
    for _ in range(20):
        d = dawson(z)
        step = d * (z * z + math.log(d / _HALF_ROOT_PI) - target)
        z -= step
        if abs(step) < 1e-4 * z:  # what is left is of the order of its square
            break
    return min(z / root, xi)


@numba.njit
def stiff_stretch(xi: float, a: float, clock: float) -> float:
    """Stretch at which the stiff hazard is `clock`, or xi."""
    c = a * xi * xi
    y = math.exp(-c) + 1.5 * a * xi * clock
    return xi if y >= 1.0 else xi * (1.0 - (-math.log(y) / c) ** (2.0 / 3.0))


@numba.njit
def newborn(general: bool) -> tuple[float, float]:
    """k_i/k and threshold of a newborn contact."""
    xi = math.sqrt(-math.log((1.0 - np.random.random()) * (1.0 - np.random.random())))  # noqa: NPY002
    return xi / math.sqrt(2.0) if general else 1.0, xi


@numba.njit
def life(kT: float, stiff: bool, general: bool) -> tuple[float, float]:
    """k_i/k of a newborn contact, and the stretch at which it breaks."""
    kappa, xi = newborn(general)
    if kT == 0.0:
        return kappa, xi
    a = kappa / (2.0 * kT)
    clock = VELOCITY * (1e-300 - math.log(1.0 - np.random.random()))  # noqa: NPY002
    return kappa, stiff_stretch(xi, a, clock) if stiff else soft_stretch(
        xi, a, math.log(clock)
    )


@numba.njit
def force(
    kT: float,
    stiff: bool,
    general: bool,
    delay: float,
    contacts: int,
    distance: float,
    points: int,
    seed: int,
) -> NDArray[np.float64]:
    """<F>/(N k) on the grid after a fresh start."""
    np.random.seed(seed)  # noqa: NPY002
    slope, offset = np.zeros(points), np.zeros(points)
    per_step = (points - 1) / distance
    for _ in range(contacts):
        born = 0.0
        while born <= distance:
            kappa, stretch = life(kT, stiff, general)
            broke = born + stretch
            first, last = math.ceil(born * per_step), math.ceil(broke * per_step)
            if first < last and first < points:
                slope[first] += kappa
                offset[first] -= kappa * born
                if last < points:
                    slope[last] -= kappa
                    offset[last] += kappa * born
            born = broke + delay
    return (
        np.cumsum(offset) + np.cumsum(slope) * np.linspace(0.0, distance, points)
    ) / contacts


@numba.njit
def totals(
    kT: float, stiff: bool, general: bool, lives: int, seed: int
) -> tuple[float, float]:
    """Sums of elastic work per k and of stretch at breaking over lives."""
    np.random.seed(seed)  # noqa: NPY002
    work, stretches = 0.0, 0.0
    for _ in range(lives):
        kappa, stretch = life(kT, stiff, general)
        work += 0.5 * kappa * stretch * stretch
        stretches += stretch
    return work, stretches


def law_of(case: Case) -> tuple[float, bool, bool]:
    """kT, and whether barriers are stiff and contacts general."""
    return case.kT, case.barrier == "stiff", case.general


def friction(
    case: Case, contacts: int, distance: float, points: int, seed: int
) -> tuple[float, float]:
    """Mean of the force over the second half of the grid, and its standard error."""
    size = contacts // BATCHES
    curves = [
        force(*law_of(case), case.delay, size, distance, points, seed * BATCHES + batch)
        for batch in range(BATCHES)
    ]
    means = np.array([curve[points // 2 :].mean() for curve in curves])
    return float(means.mean()), float(means.std(ddof=1)) / math.sqrt(BATCHES)


def steady_friction(case: Case, lives: int, seed: int) -> tuple[float, float]:
    """Steady friction by renewal-reward over plainly drawn lives, and its standard
    error."""
    size = lives // BATCHES
    work, stretch = np.array(
        [
            totals(*law_of(case), size, seed * BATCHES + batch)
            for batch in range(BATCHES)
        ]
    ).T
    cycle = stretch + size * case.delay
    value = work.sum() / cycle.sum()
    return float(value), float((work - value * cycle).std(ddof=1)) * math.sqrt(
        BATCHES
    ) / float(cycle.sum())
