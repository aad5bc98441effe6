"""Delay between the breaking of a contact and its re-attachment (section V of Braun and Peyrard, 2011)."""

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from eqsim.compiled import inlined
from eqsim.errors import NOT_NEGATIVE, require_choice, require_number
from eqsim.laws.elementary import log
from eqsim.laws.octaves import Array

DelayLaw = Literal["fixed", "exponential"]


@dataclass(frozen=True)
class Delay:
    """Time a contact stays detached: `time` always (fixed), or exponential with mean `time`.

    Raises InputError for a negative time or an unknown law.
    """

    time: float = 0.0
    law: DelayLaw = "fixed"

    def __post_init__(self) -> None:
        require_number("time", self.time, **NOT_NEGATIVE)
        require_choice("law", self.law, ("fixed", "exponential"))

    def cdf(self, t: Array) -> Array:
        """P(delay <= t)."""
        if self.law == "fixed" or self.time == 0:
            return np.where(np.asarray(t) >= self.time, 1.0, 0.0)
        return -np.expm1(-np.maximum(t, 0.0) / self.time)

    def residual_cdf(self, t: Array) -> Array:
        """P(rest of the delay <= t) for a contact found detached in the stationary state (derived, renewal theory):
        uniform on (0, time) if fixed, again exponential if exponential."""
        if self.time == 0:
            return self.cdf(t)
        if self.law == "fixed":
            return np.clip(np.asarray(t) / self.time, 0.0, 1.0)
        return self.cdf(t)


@inlined
def delay_draw(mean: float, exponential: bool, u: float) -> float:
    """A delay from a uniform u in (0, 1)."""
    return -mean * log(u) if exponential else mean


@inlined
def residual_delay_draw(mean: float, exponential: bool, u: float) -> float:
    """The rest of a delay in the stationary state from a uniform u in (0, 1)."""
    return -mean * math.log(u) if exponential else mean * u
