"""Quadrature: tables of nodes, each computed once."""

import functools
from typing import NamedTuple

import numpy as np

from eqsim.numerics.tables import Array


class Rule(NamedTuple):
    """Nodes in (-1, 1) and their weights, whose sum is 2; arrays (count,)."""

    nodes: Array
    weights: Array


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
