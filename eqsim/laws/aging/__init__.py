"""Aging of pinned contacts: one file for each rule. This is where they are listed."""

import math
from dataclasses import dataclass, field, fields
from typing import Any

from eqsim.errors import (
    NOT_NEGATIVE,
    POSITIVE,
    InputError,
    require_choice,
    require_number,
    require_number_or_infinity,
)
from eqsim.laws.aging.base import AgingLaw, Unaged
from eqsim.laws.aging.flow import Flow
from eqsim.laws.aging.langevin import Langevin
from eqsim.laws.aging.logarithmic import Logarithmic
from eqsim.laws.aging.pooled import PooledThresholds
from eqsim.laws.threshold import Gamma

RULES: dict[str, type[AgingLaw]] = {
    "langevin": Langevin,
    "flow": Flow,
    "logarithmic": Logarithmic,
}
__all__ = [
    "RULES",
    "Aging",
    "AgingLaw",
    "Flow",
    "Langevin",
    "Logarithmic",
    "PooledThresholds",
    "Unaged",
]
_MOST_BETA = 1000.0  # thresholds then grow a thousandfold per e-fold of their age


@dataclass(frozen=True)
class Aging:
    """Growth of thresholds while contacts are pinned.

    Raises InputError for an unknown rule, values out of range, and parameters of
    another rule.

    Parameters
    ----------
    rule : str
        "none", or for quenched contacts one of `RULES`; annealed contacts draw from
        `PooledThresholds` under "langevin" and "flow", and cannot age by "logarithmic".
    rate : float
        D (length^2/time) of "langevin" and "flow"; may be infinite for "flow" and for
        annealed contacts.
    x_star_final : float
        Scale x_*f of the final law (length) of the same.
    beta : float, optional
        Growth under "logarithmic", required there, from 0 to 1000:
        xi(t) = xi(0) (1 + beta ln(1 + t/t_c)).
    cutoff_time : float, optional
        t_c (time) of the same.

    Examples
    --------
    >>> Aging("logarithmic", beta=0.1, cutoff_time=1.0).active
    True
    """

    rule: str = "none"
    rate: float = 0.0
    x_star_final: float = field(default=1.0, metadata={"no_default_in_files": True})
    beta: float | None = None
    cutoff_time: float | None = None

    def __post_init__(self) -> None:
        require_choice("rule", self.rule, ("none", *RULES))
        require_number_or_infinity("rate", self.rate, **NOT_NEGATIVE)
        require_number("x_star_final", self.x_star_final, **POSITIVE)
        if self.beta is not None:
            require_number("beta", self.beta, least=0.0, most=_MOST_BETA)
        if self.cutoff_time is not None:
            require_number("cutoff_time", self.cutoff_time, **POSITIVE)
        given = (one for one in fields(self) if getattr(self, one.name) != one.default)
        self.check_keys({one.name for one in given})

    @classmethod
    def of_keys(cls, values: dict[str, Any], given: set[str]) -> "Aging":
        """Aging from the keys of a run file: `values`, None where a key has none, and
        the keys that are `given`. Raises InputError."""
        rule = values["rule"] or "none"
        if rule == "none":  # the others are kept where a file is varied
            return cls()
        aging = cls(**{k: v for k, v in values.items() if v is not None})
        aging.check_keys(given)
        for name in RULES[aging.rule].keys:
            if values[name] is None:
                raise InputError(f'{name}: is required with rule = "{aging.rule}"')
        return aging

    def check_keys(self, given: set[str]) -> None:
        """Raise InputError if parameters are `given` that are not of this rule, or one
        is missing that has no default."""
        keys = RULES[self.rule].keys if self.rule != "none" else ()
        for name in (one.name for one in fields(self)[1:]):
            taken = name in keys
            if name in given and not taken:
                raise InputError(f'{name}: not allowed with rule = "{self.rule}"')
            if taken and getattr(self, name) is None:
                raise InputError(f'{name}: is required with rule = "{self.rule}"')

    @property
    def active(self) -> bool:
        """True if thresholds move at all."""
        return self.rule != "none" and (self.rate > 0 or (self.beta or 0.0) > 0)

    def check(self, law: Any, disorder: str) -> None:
        """Raise InputError unless contacts with these newborn thresholds can age so."""
        if self.rule != "none":
            RULES[self.rule].check(self, law, disorder)

    def final(self, x_star: float) -> float:
        """x_*f/x_*i, the scale of the final law over that of the newborn one."""
        return self.x_star_final / x_star

    def declared(self, unit: float, velocity: float) -> tuple[Any, ...]:
        """The dimensionless numbers of its rule, for `Ensemble.declared`."""
        if self.cutoff_time is not None:
            return self.beta, self.cutoff_time * velocity / unit
        return self.rate / (unit * velocity), self.final(unit)

    def alpha(self, x_star: float, velocity: float, most: float = 1e100) -> float:
        """4 D x_*i/(v x_*f^2), decay of x_*(t)^2 per x_*i of displacement. Raises
        InputError beyond `most`."""
        if not self.active or self.rate == math.inf:
            return math.inf if self.active else 0.0
        decay = 4.0 * self.rate / self.x_star_final
        alpha = decay * (x_star / self.x_star_final) / velocity
        name = "4 rate x_star / (velocity x_star_final^2)"
        require_number(name, alpha, least=0, most=most)
        return alpha

    def pooled(self, law: Gamma, decay: float) -> PooledThresholds:
        """Thresholds at birth of annealed contacts that age."""
        return PooledThresholds(law, self.x_star_final, decay)

    def law(self, thresholds: Any, velocity: float) -> AgingLaw:
        """The law of quenched contacts of these newborn thresholds at `velocity`.
        Raises InputError."""
        if not self.active:
            return Unaged()
        return RULES[self.rule].reduced(self, thresholds, velocity)
