"""Drag of a detached contact (section V of Braun and Peyrard, 2011)."""

import math
from dataclasses import dataclass
from typing import Annotated

from eqsim.errors import Checked, Limits, NotNegative, Positive


@dataclass(frozen=True)
class Viscosity(Checked):
    """How the drag of a detached contact depends on the velocity,

        f_l = force + eta v (v/reference_velocity)^(exponent - 1),

    with eta that of the ensemble (the published f_l = eta v, where eta may depend on
    the velocity, for example as v^4: then the exponent is 5). It acts against the
    motion, and vanishes in a hold.

    Raises InputError for a value out of range.

    Parameters
    ----------
    force : float
        Constant drag (force).
    exponent : float
        From 0 to 10.
    reference_velocity : float
        Velocity (length/time) at which the second term is eta v whatever the exponent.

    Examples
    --------
    >>> round(Viscosity(exponent=5.0).factor(2.0), 9)
    16.0
    """

    force: NotNegative = 0.0
    exponent: Annotated[float, Limits(0.0, 10.0)] = 1.0
    reference_velocity: Positive = 1.0

    def factor(self, v: float) -> float:
        """(v/reference_velocity)^(exponent - 1)."""
        logs = math.log(v) - math.log(self.reference_velocity)
        return math.exp(min((self.exponent - 1.0) * logs, 700.0))  # no overflow
