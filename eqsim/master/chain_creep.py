"""The two limits of the steady creep of chains of blocks below their threshold
(derived).

Stiffnesses are over n k, thresholds are 1 and all equal, and rates of a contact of
stretch x are omega exp(-b (1 - x^2)).
"""

import math

import numpy as np
from scipy import optimize, special

from eqsim.errors import require_number
from eqsim.numerics.quadrature import gauss_legendre

# Panels and nodes of a mean over a life: breaks may all be within 1/(2 b) of a stretch.
_PANELS = 512
_ORDER = 16


def creep_velocity(stretch: float, b: float, *, coupled: bool) -> float:
    """Velocity over omega x_s of steady creep under a constant force x_0 (over n k x_s)
    on each block, whose contacts take hold again at once. Blocks of one contact that
    are not coupled move by x_0 at each break,

        V = x_0 exp(-b (1 - x_0^2)),

    and rigidly coupled ones at the velocity whose steady friction is x_0,

        x_0 = int_0^1 x S dx/int_0^1 S dx,
        S = exp[-exp(b (x^2 - 1)) D(sqrt(b) x)/(V sqrt(b))],

    D being Dawson's integral. Chains of any coupling lie between them. Raises
    InputError for numbers out of range; a rigid slider bears no more than 1/2."""
    require_number("b", b, above=0.0, most=500.0)
    require_number("stretch", stretch, above=0.0, most=0.499 if coupled else 1.0)
    alone = stretch * math.exp(-b * (1.0 - stretch**2))
    if not coupled:
        return alone
    edges = np.linspace(0.0, 1.0, _PANELS + 1)
    x, weights = (
        a.ravel() for a in gauss_legendre(_ORDER).between(edges[:-1], edges[1:])
    )
    hazard = np.exp(b * (x**2 - 1.0)) * special.dawsn(math.sqrt(b) * x) / math.sqrt(b)

    def excess(log_V: float) -> float:
        S = weights * np.exp(-hazard * math.exp(-log_V))
        return float(x @ S / S.sum()) - stretch

    low = math.log(alone)
    return math.exp(optimize.brentq(excess, low - 5.0, low + b + 20.0, xtol=1e-14))
