"""Rival A: a researcher's NumPy script. Every contact is moved by dX at a time and breaks with probability r dt.

Two kindnesses to it: the barrier a xi^2 is kept from birth, and a detached contact counts up from -v tau, so that no
lists of pinned and detached contacts are needed.
"""

import math

import numpy as np
from numpy.typing import NDArray

from analysis.benchmarks.cases import Case

STEP = 0.005  # dX, in x_*


def mean_force(case: Case, contacts: int, distance: float, seed: int) -> tuple[float, float]:
    """Friction over the second half of the distance after a fresh start, and its standard error."""
    rng = np.random.default_rng(seed)
    stretch, total = np.zeros(contacts), np.zeros(contacts)
    threshold = thresholds(rng, contacts)
    steps = round(distance / STEP)
    half_b = 0.5 / case.kT if case.kT else 0.0
    dt = case.attempts_per_length * STEP
    stiffness = _stiffness(case, threshold)
    rate_factor = half_b * stiffness
    barrier = rate_factor * threshold**2
    for step in range(steps):
        stretch += STEP
        broken = stretch >= threshold
        if case.kT:
            broken |= rng.random(contacts) < dt * _rate(case, stretch, threshold, rate_factor, barrier)
        new = np.flatnonzero(broken)
        threshold[new] = thresholds(rng, new.size)
        stiffness[new] = _stiffness(case, threshold[new])
        rate_factor[new] = half_b * stiffness[new]
        barrier[new] = rate_factor[new] * threshold[new] ** 2
        stretch[new] = -case.gap
        if step >= steps // 2:
            total += stiffness * (np.maximum(stretch, 0.0) if case.gap else stretch)
    mean = total / (steps - steps // 2)
    return float(mean.mean()), float(mean.std(ddof=1)) / math.sqrt(contacts)
