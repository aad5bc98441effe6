"""Stiffness of a contact from its threshold."""

from typing import Literal, NamedTuple

import numpy as np

from eqsim.numerics.compiled import routine
from eqsim.numerics.tables import Array

StiffnessLaw = Literal["sqrt", "uniform"]


def relative_stiffness(law: StiffnessLaw, xi: Array, xi_rms: float) -> Array:
    """k_i/k of contacts with threshold stretches `xi` (any shape, same length unit as
    `xi_rms`). sqrt: k_i = k sqrt(f_si/f_s) (section II of Braun and Peyrard, 2011),
    which with f_si = k_i xi_i is k_i = k xi_i/xi_rms (derived), f_s being the mean
    threshold force. uniform: k_i = k."""
    return xi / xi_rms if law == "sqrt" else np.ones_like(xi)


class Springs(NamedTuple):
    """k_i/k = constant + slope xi for kernels: (0, 1/xi_rms) is the sqrt law, (1, 0)
    the uniform one."""

    constant: float
    slope: float


@routine(inline=True)
def kappa(springs: Springs, xi: float) -> float:
    """k_i/k of a contact of threshold `xi`."""
    return springs.constant + springs.slope * xi
