"""Delay between the breaking of a contact and its re-attachment (section V of Braun and Peyrard, 2011).

`DELAYS` lists the laws. Each is a NamedTuple of the number that kernels need, the mean as a displacement v<tau>, with
NumPy's formulas as methods and a body of each kernel routine below.
"""

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from eqsim.errors import NOT_NEGATIVE, require_choice, require_number
from eqsim.numerics.compiled import by_law
from eqsim.numerics.tables import Array
from eqsim.numerics.vector_math import log


class Fixed(NamedTuple):
    """Every delay is `mean`."""

    mean: float

    def cdf(self, t: Any) -> Array:
        """P(delay <= t)."""
        return np.where(np.asarray(t) >= self.mean, 1.0, 0.0)

    def residual_cdf(self, t: Any) -> Array:
        """P(rest of the delay <= t) of a contact found detached in the stationary state (derived, renewal theory)."""
        return np.clip(np.asarray(t) / self.mean, 0.0, 1.0) if self.mean else self.cdf(t)

    def rest(self, x: Array) -> Array:
        """E[(delay - x)+]."""
        return np.maximum(self.mean - x, 0.0)

    def waiting(self, h: float, cells: int) -> Array:
        """Chance that a contact that breaks anywhere in a cell of width `h` is still detached at the end of that cell,
        and of the next ones, shape (cells,)."""
        return np.clip(self.mean / h - np.arange(cells), 0.0, 1.0)

    def coherence(self, k: Array) -> Array:
        """|E[exp(i k delay)]|."""
        return np.ones_like(k)

    def sample(self) -> Array:
        """Equally likely delays that stand for the law."""
        return np.full(1, self.mean)


class Exponential(NamedTuple):
    """Delays are exponential with mean `mean`; methods are those of `Fixed`."""

    mean: float

    def cdf(self, t: Any) -> Array:
        return -np.expm1(-np.maximum(t, 0.0) / self.mean) if self.mean else np.where(np.asarray(t) >= 0, 1.0, 0.0)

    def residual_cdf(self, t: Any) -> Array:
        return self.cdf(t)

    def rest(self, x: Array) -> Array:
        return self.mean * np.exp(-x / self.mean) if self.mean else np.zeros_like(x)

    def waiting(self, h: float, cells: int) -> Array:
        later = np.arange(cells)
        if not self.mean:
            return np.zeros(cells)
        return np.asarray(-math.expm1(-h / self.mean) * self.mean / h * np.exp(-h / self.mean * later))

    def coherence(self, k: Array) -> Array:
        return np.asarray(1.0 / np.hypot(1.0, k * self.mean))

    def sample(self) -> Array:
        return self.mean * -np.log((np.arange(16) + 0.5) / 16)


DELAYS: dict[str, type[Fixed] | type[Exponential]] = {"fixed": Fixed, "exponential": Exponential}


@dataclass(frozen=True)
class Delay:
    """Time a contact stays detached.

    Parameters
    ----------
    time : float
        Mean delay tau (time).
    law : str
        One of `DELAYS`.

    Raises
    ------
    InputError
        For a negative time or an unknown law.
    """

    time: float = 0.0
    law: str = "fixed"

    def __post_init__(self) -> None:
        require_number("time", self.time, **NOT_NEGATIVE)
        require_choice("law", self.law, tuple(DELAYS))

    def reduced(self, velocity: float = 1.0, unit: float = 1.0) -> Fixed | Exponential:
        """The law of v tau in units of `unit` (length)."""
        return DELAYS[self.law](velocity * self.time / unit)

    def cdf(self, t: Any) -> Array:
        """P(delay <= t), t a time."""
        return self.reduced().cdf(t)

    def residual_cdf(self, t: Any) -> Array:
        """P(rest of the delay <= t) of a contact found detached in the stationary state (derived, renewal theory)."""
        return self.reduced().residual_cdf(t)


@by_law
def is_random(law: Any) -> bool:
    """Whether delays differ from each other."""
    return True


@by_law
def delay_draw(law: Any, u: float) -> float:
    """A delay from a uniform u in (0, 1)."""
    return law.mean


@by_law
def residual_delay_draw(law: Any, u: float) -> float:
    """The rest of a delay in the stationary state from a uniform u in (0, 1)."""
    return law.mean * u


@is_random.register(Fixed)
def _fixed(law: Fixed) -> bool:
    return False


@delay_draw.register(Exponential)
def _exponential(law: Exponential, u: float) -> float:
    return -law.mean * log(u)


@residual_delay_draw.register(Exponential)
def _residual_exponential(law: Exponential, u: float) -> float:
    return -law.mean * math.log(u)
