"""Contacts without a mechanical limit: only heat breaks them."""

import math
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from eqsim.errors import POSITIVE, InputError, require_number
from eqsim.laws.threshold import NO_STEPS, Discrete, ThresholdLaw
from eqsim.numerics.tables import Array

# Threshold that stands for none, in typical stretches: bonds are stretched by less than
# some 500 force scales, as their rates rise by e with each.
BEYOND = 1000.0


@dataclass(frozen=True)
class NoThresholds(Discrete):
    """No thresholds: bonds that break by heat alone.

    Parameters
    ----------
    x_star : float, optional
        Typical stretch at breaking: the unit of length of tables and grids, on which no
        mean depends, of default distances, and of the least slip of a slider behind a
        spring (0.005 of it); by default a force that changes the rate of the bond by e,
        over its stiffness. Raises InputError unless > 0.

    Attributes
    ----------
    scale : float
        The stretch in use (length).

    Examples
    --------
    >>> NoThresholds(x_star=2.0).mean
    2.0
    """

    x_star: float | None = None
    scale: float = field(default=1.0, init=False, repr=False)
    kinks = breakpoints = NO_STEPS

    def __post_init__(self) -> None:
        if self.x_star is not None:
            require_number("x_star", self.x_star, **POSITIVE)
            object.__setattr__(self, "scale", self.x_star)

    def of_bond(self, length: float) -> "NoThresholds":
        """The law of bonds with a force over stiffness. Raises InputError if that is
        infinite, and x_star is not given."""
        law = replace(self)
        if self.x_star is None:
            if length == math.inf:
                said = "is required where no force opens the bond; about velocity/rate"
                raise InputError(f"x_star: {said}")
            require_number("force / stiffness", length, **POSITIVE)
            object.__setattr__(law, "scale", length)
        return law

    @property
    def declared(self) -> tuple[Any, ...]:
        return self.scale, "none"

    @property
    def mean(self) -> float:
        """A typical stretch at breaking."""
        return self.scale

    @property
    def rms(self) -> float:
        """The same."""
        return self.scale

    @property
    def steps(self) -> Array:  # type: ignore[override]
        return np.array([BEYOND * self.scale])


def has_jumps(law: ThresholdLaw) -> bool:
    """True if equal thresholds break contacts at one instant."""
    return law.steps.size > 0 and not isinstance(law, NoThresholds)
