"""Aging of pinned contacts: one file for each rule. This is where they are listed."""

import math
from dataclasses import dataclass
from typing import Any

from eqsim.errors import NOT_NEGATIVE, POSITIVE, InputError, require_choice, require_number
from eqsim.laws.aging.base import AgingLaw, Unaged
from eqsim.laws.aging.flow import Flow
from eqsim.laws.aging.langevin import Langevin
from eqsim.laws.aging.pooled import PooledThresholds
from eqsim.laws.threshold import Gamma

RULES: dict[str, type[AgingLaw]] = {"langevin": Langevin, "flow": Flow}
__all__ = ["RULES", "Aging", "AgingLaw", "Flow", "Langevin", "PooledThresholds", "Unaged"]
_MOST_N = 1000.0  # of a pooled law and of a Fokker-Planck equation: their grids resolve the width of the newborn law


@dataclass(frozen=True)
class Aging:
    """How thresholds age while pinned.

    Parameters
    ----------
    rule : str
        "none", or for quenched contacts one of `RULES`; annealed contacts draw from `PooledThresholds` under any.
    rate : float
        D (length^2/time); may be infinite for "flow" and for annealed contacts.
    x_star_final : float
        Scale x_*f of the final law (length).

    Raises
    ------
    InputError
        For an unknown rule and values out of range.
    """

    rule: str = "none"
    rate: float = 0.0
    x_star_final: float = 1.0

    def __post_init__(self) -> None:
        require_choice("rule", self.rule, ("none", *RULES))
        if self.rate != math.inf:
            require_number("rate", self.rate, **NOT_NEGATIVE)
        require_number("x_star_final", self.x_star_final, **POSITIVE)

    @property
    def active(self) -> bool:
        """Whether thresholds move at all."""
        return self.rule != "none" and self.rate > 0

    def check(self, law: Any, disorder: str) -> None:
        """Raise InputError unless contacts with these newborn thresholds can age so."""
        if self.rule == "none":
            return
        if not isinstance(law, Gamma):
            raise InputError(f'rule = "{self.rule}": needs thresholds of law "gamma"')
        fluctuates = disorder == "quenched" and RULES[self.rule].fluctuates
        if self.rate == math.inf and fluctuates:
            raise InputError(f'rate = inf: must be finite with rule = "{self.rule}" and quenched disorder')
        ratio = self.x_star_final / law.x_star
        if not 1e-3 <= ratio <= 1e3:
            raise InputError(f"x_star_final = {self.x_star_final!r}: must be within a factor 1000 of x_star")
        if self.active and law.n > _MOST_N and (disorder == "annealed" or fluctuates):
            who = "annealed contacts" if disorder == "annealed" else f'contacts of rule "{self.rule}"'
            raise InputError(f"rule: {who} can age for n <= {_MOST_N:g}; n is {law.n:g}")

    def alpha(self, x_star: float, velocity: float) -> float:
        """4 D x_*i/(v x_*f^2), decay of x_*(t)^2 per x_*i of displacement. Raises InputError beyond 1e100."""
        if not self.active or self.rate == math.inf:
            return math.inf if self.active else 0.0
        alpha = 4.0 * self.rate / self.x_star_final * (x_star / self.x_star_final) / velocity
        require_number("aging rate * x_star / (velocity * x_star_final^2)", alpha, least=0, most=1e100)
        return alpha

    def law(self, x_star: float, n: float, velocity: float) -> AgingLaw:
        """What quenched contacts of newborn thresholds Gamma(n, x_star) do at `velocity`. Raises InputError."""
        if not self.active:
            return Unaged()
        return RULES[self.rule].reduced((self.x_star_final / x_star) ** 2, self.alpha(x_star, velocity), n)
