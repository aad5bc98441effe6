"""Sizes of the avalanches of infinitely many contacts that are pulled infinitely slowly at T = 0 (derived).

A break of stretch l moves all contacts by so much that rho l/<l> more of them break in the mean, independently of each
other, whatever elastic response shares that out among blocks: rho = n k/(n k + K_d). An avalanche is then the progeny
of one break, or the customers of a busy period of the queue M/G/1 with load rho and service l:

    P(s) = E[exp(-t) t^(s-1)]/s!,        t = rho (l_1 + ... + l_s)/<l>.
"""

from typing import Any

import numpy as np
from scipy import special

from eqsim.errors import require_integer, require_number
from eqsim.laws.threshold import ThresholdLaw
from eqsim.numerics.tables import Array

_OCTAVES = range(-54, 6)  # of -ln P(xi > .), beyond which nothing counts
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(12)
_MOST = 20_000


def size_law(law: ThresholdLaw, load: float, most: int) -> Array:
    """P(1), ..., P(most), shape (most,), to 1e-10 (thresholds whose law has gaps: 1e-4).

    Parameters
    ----------
    law : ThresholdLaw
        Of uniform contacts.
    load : float
        rho, in (0, 1).
    most : int
        Largest size, up to 20000.

    Raises
    ------
    InputError
        For values out of range.
    """
    require_number("load", load, above=0.0, most=1.0)
    require_integer("most", most, 1, _MOST)
    points = 1 << (4 * most + 60).bit_length()
    # P(s) = P(s offspring of s - 1 in all)/s (Dwass, 1969), by the characteristic function of the offspring
    offspring = np.fft.fft(_offspring(law, load, points // 2), points)
    angle = np.exp(2j * np.pi * np.arange(points) / points)
    found, power = np.empty(most), offspring.copy()
    for s in range(1, most + 1):
        found[s - 1] = power.mean().real / s
        power *= offspring
        power *= angle
    return np.maximum(found, 0.0)


def _offspring(law: ThresholdLaw, load: float, most: int) -> Array:
    """P(0), ..., P(most - 1) of the number of breaks that follow from one directly, E[exp(-t) t^k/k!]."""
    xi: Any
    weight: Any
    if law.steps.size:
        xi, weight = np.unique(law.steps, return_counts=True)
        weight = weight / law.steps.size
    else:
        octave = 2.0 ** np.array(_OCTAVES)[:, None]
        e = (octave * (1.5 + 0.5 * _NODES)).ravel()
        weight = (0.5 * octave * _WEIGHTS).ravel() * np.exp(-e)
        xi = law.inverse_survival(e)
    mean = np.sum(weight * xi) / np.sum(weight)  # of the same nodes
    t = load * np.asarray(xi) / mean
    found = np.zeros(most)
    for k in range(most):
        found[k] = np.sum(weight * np.exp(special.xlogy(k, t) - t - special.gammaln(k + 1.0)))
        if k > t.max() and found[k] < 1e-20:
            break
    return np.asarray(found / np.sum(weight))
