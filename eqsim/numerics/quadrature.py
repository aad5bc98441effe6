"""Quadrature, with tables of nodes that are each computed once, and extrapolation."""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from scipy import ndimage, special

from eqsim.numerics.tables import Array

# How often panels are halved at most, and the number of them, to bound memory.
_HALVINGS = 50
_MOST_PANELS = 40_000


class Rule(NamedTuple):
    """Nodes in (-1, 1) and their weights, whose sum is 2; arrays (count,)."""

    nodes: Array
    weights: Array

    def between(self, low: Array, high: Array) -> "Rule":
        """The rule on intervals, arrays (...,): nodes and weights (..., count)."""
        half = 0.5 * (high - low)[..., None]
        return Rule(low[..., None] + half * (1.0 + self.nodes), half * self.weights)


# A solver asks for its rule at each panel; some twenty orders are in use.
@functools.lru_cache(maxsize=64)
def gauss_legendre(count: int) -> Rule:
    """Gauss-Legendre rule, exact for polynomials up to the degree 2 count - 1.

    Examples
    --------
    >>> rule = gauss_legendre(2)
    >>> float(rule.weights @ rule.nodes**2)  # the integral of x^2 from -1 to 1
    0.6666666666666...
    """
    nodes, weights = np.polynomial.legendre.leggauss(count)
    nodes.flags.writeable = weights.flags.writeable = False
    return Rule(nodes, weights)


def halved(
    panels: Callable[[Array, Array], Array], edges: Array, alike: float
) -> tuple[float, float]:
    """Integral between `edges` (n + 1,), and a bound of its error: `panels(low, high)`
    integrates over panels, arrays (n,), by some rule, and panels are halved until the
    halves of each agree with the whole to `alike`, absolute and relative to all.

    Examples
    --------
    >>> rule = gauss_legendre(4)
    >>> def panels(low, high):
    ...     x, weights = rule.between(low, high)
    ...     return (np.sqrt(x) * weights).sum(axis=-1)
    >>> value, error = halved(panels, np.array([0.0, 1.0]), 1e-14)
    >>> abs(value - 2.0 / 3.0) < error < 1e-12
    True
    """
    low, high = edges[:-1], edges[1:]
    whole = panels(low, high)
    alike *= max(float(np.abs(whole).sum()), 1.0)
    total = missed = 0.0
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        halves = np.array([panels(low, middle), panels(middle, high)])
        apart = np.abs(halves.sum(axis=0) - whole)
        unlike = apart > alike
        total += float(halves[:, ~unlike].sum())
        missed += float(apart[~unlike].sum())
        low, middle, high = low[unlike], middle[unlike], high[unlike]
        low, high = np.append(low, middle), np.append(middle, high)
        whole = halves[:, unlike].ravel()
        if not 0 < whole.size < _MOST_PANELS:
            break
    return total + float(whole.sum()), missed + float(apart[unlike].sum())


def normal_exponent(z: Array) -> Array:
    """-ln P(Z > z) of a normal deviate Z, without loss on either side: e of the quantile
    function `inverse_survival`."""
    rare = np.minimum(z, 0.0)
    return np.where(
        z < 0.0, -np.log1p(-special.ndtr(rare)), -special.log_ndtr(-np.maximum(z, 0.0))
    )


def gamma_quantile(shape: float, e: Any) -> Array:
    """Value that a gamma variable exceeds with probability exp(-e), without loss on
    either side."""
    e = np.asarray(e, float)
    found, low = np.empty_like(e), e < 0.7  # either inverse takes long
    found[low] = special.gammaincinv(shape, -np.expm1(-e[low]))
    found[~low] = special.gammainccinv(shape, np.exp(-e[~low]))
    return found


def extrapolated(coarse: Array, fine: Array, ratio: float = 4.0) -> Array:
    """Values at no step at all, from those at two steps whose errors have a `ratio`,
    which is 4 if one is half the other and the scheme of second order (Richardson)."""
    return fine + (fine - coarse) / (ratio - 1.0)


def largest_nearby(values: Array, points: int) -> Array:
    """The largest |value| of so many neighbours: the difference of two grids may vanish
    by chance where the error of neither does."""
    return np.asarray(ndimage.maximum_filter1d(np.abs(values), points, axis=-1))
