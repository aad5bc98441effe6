"""Rival A: a researcher's NumPy script. All contacts move by dX at a time and each
breaks with probability r dt.

It is faster than most: the constants of a rate are kept from birth, and a detached
contact counts up from -v tau, which saves lists of pinned and detached contacts.
"""

import math

import numpy as np
from numpy.typing import NDArray

from analysis.benchmarks.cases import VELOCITY, Case

STEP = 0.005  # dX

Array = NDArray[np.float64]


def friction(
    case: Case, contacts: int, distance: float, seed: int
) -> tuple[float, float]:
    """<F>/(N k) over the second half of the distance after a fresh start, and its
    standard error."""
    rng = np.random.default_rng(seed)
    x, xi, kappa, a, barrier = np.zeros((5, contacts))
    area, steps = np.zeros(contacts), round(distance / STEP)

    def give_birth(index: NDArray[np.intp]) -> None:
        new = np.sqrt(rng.standard_gamma(2.0, index.size))
        xi[index], kappa[index] = new, new / math.sqrt(2.0) if case.general else 1.0
        if case.kT:
            a[index] = kappa[index] / (2 * case.kT)
            barrier[index] = a[index] * new**2

    give_birth(np.arange(contacts))
    for step in range(steps):
        x += STEP
        broken = x >= xi
        if case.kT:
            broken |= rng.random(contacts) < STEP / VELOCITY * _rate(
                case, x, xi, a, barrier
            )
            if case.delay:
                broken &= x > 0
        index = np.flatnonzero(broken)
        give_birth(index)
        x[index] = -case.delay
        if step >= steps // 2:
            area += kappa * np.maximum(x, 0.0) if case.delay else kappa * x
    area /= steps - steps // 2
    return float(area.mean()), float(area.std(ddof=1)) / math.sqrt(contacts)


def _rate(case: Case, x: Array, xi: Array, a: Array, barrier: Array) -> Array:
    if case.barrier == "soft":
        return np.exp(a * x * x - barrier)
    left = np.maximum(1.0 - x / xi, 0.0)
    root = np.sqrt(left)
    return root * np.exp(-barrier * left * root)
