"""Contacts without a mechanical limit: only heat breaks them."""

import math
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from eqsim.errors import POSITIVE, InputError, require_number
from eqsim.laws.threshold import NO_STEPS, Discrete
from eqsim.numerics.tables import Array

# Threshold that stands for none, in typical stretches: bonds are stretched by less than
# some 500 force scales, as their rates rise by e with each.
BEYOND = 1000.0
# Hazard that no contact outlives.
SPENT = 100.0


@dataclass(frozen=True)
class NoThresholds(Discrete):
    """No thresholds: bonds that break by heat alone.

    Parameters
    ----------
    x_star : float, optional
        Typical stretch at breaking, the unit of length of tables and grids, on which no
        result depends. By default the force scale of the bond over its stiffness. Raises
        InputError unless > 0.

    Examples
    --------
    >>> NoThresholds(x_star=2.0).mean
    2.0
    """

    x_star: float | None = None
    of_bond: float = field(default=1.0, init=False, repr=False)

    def __post_init__(self) -> None:
        if self.x_star is not None:
            require_number("x_star", self.x_star, **POSITIVE)

    def of(self, length: float) -> "NoThresholds":
        """The law of bonds with this force scale over stiffness. Raises InputError if it
        is infinite, and x_star is not given."""
        if self.x_star is None and length == math.inf:
            said = 'is required with law = "none" if no force changes the rate'
            raise InputError(f"x_star: {said}; give about velocity/rate")
        if self.x_star is None:
            require_number("force / stiffness", length, **POSITIVE)
        law = replace(self)
        object.__setattr__(law, "of_bond", length if self.x_star is None else 1.0)
        return law

    @property
    def declared(self) -> tuple[Any, ...]:
        return self.scale, "none"

    @property
    def scale(self) -> float:
        return self.of_bond if self.x_star is None else self.x_star

    @property
    def mean(self) -> float:
        """A typical stretch at breaking, in the place of a mean threshold."""
        return self.scale

    @property
    def rms(self) -> float:
        """The same."""
        return self.scale

    @property
    def steps(self) -> Array:  # type: ignore[override]
        return np.array([BEYOND * self.scale])

    @property
    def breakpoints(self) -> Array:
        return NO_STEPS

    @property
    def kinks(self) -> Array:
        return NO_STEPS
