"""Thresholds that fluctuate: the process of the Smoluchowski equation itself
(`laws.aging.base`).

The engine follows its paths in `engine.langevin`, the reference solves its
Fokker-Planck equation.
"""

from typing import Any, ClassVar, NamedTuple

from eqsim.laws.aging.base import Drift, stiffness_varies
from eqsim.laws.stiffness import Springs

# most relaxations in x_* of sliding, or in a hold: the number of steps grows with them
MOST_ALPHA = 1e6


class Langevin(
    NamedTuple(
        "LangevinNumbers", [("final2", float), ("alpha", float), ("shape", float)]
    ),
    Drift,
):
    """The norm of an Ornstein-Uhlenbeck process of 2 shape + 2 components, shape = n.
    The stiffness of the sqrt law follows it."""

    __slots__ = ()
    fluctuates: ClassVar[bool] = True

    @classmethod
    def reduced(cls, aging: Any, law: Any, velocity: float) -> "Langevin":
        """The law of an `Aging`. Raises InputError also for rates that would take too
        many steps."""
        alpha = aging.alpha(law.x_star, velocity, MOST_ALPHA)
        return cls(aging.final(law.x_star) ** 2, alpha, law.n)


@stiffness_varies.register(Langevin)
def _varies(law: Any, springs: Springs) -> bool:
    return springs.slope > 0.0
