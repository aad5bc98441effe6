"""Delay between the breaking of a contact and its re-attachment (section V of Braun and
Peyrard, 2011).

`DELAYS` lists the laws. Each is a NamedTuple of the mean, as a displacement v<tau>,
with NumPy's formulas as methods.
"""

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from eqsim.errors import NOT_NEGATIVE, require_choice, require_number
from eqsim.laws.law import Law
from eqsim.numerics.compiled import routine
from eqsim.numerics.tables import Array
from eqsim.numerics.vector_math import log


class _Mean(NamedTuple):
    mean: float


class Fixed(_Mean, Law):
    """Every delay is `mean`."""

    __slots__ = ()

    def cdf(self, t: Any) -> Array:
        """P(delay <= t)."""
        return np.where(np.asarray(t) >= self.mean, 1.0, 0.0)

    def residual_cdf(self, t: Any) -> Array:
        """P(rest of the delay <= t) of a contact found detached in the stationary state
        (derived, renewal theory)."""
        if not self.mean:
            return self.cdf(t)
        return np.clip(np.asarray(t) / self.mean, 0.0, 1.0)

    def rest(self, x: Array) -> Array:
        """E[(delay - x)+], x ascending, shape (n,); of delays without end that of one
        beyond all x, whose differences are the same."""
        mean = self.mean if self.mean < math.inf else 2.0 * x[-1]
        return np.maximum(mean - x, 0.0)

    def waiting(self, h: float, cells: int) -> Array:
        """Chance that a contact that breaks anywhere in a cell of width `h` is still
        detached at the end of that cell, and of the next ones, shape (cells,)."""
        return np.clip(self.mean / h - np.arange(cells), 0.0, 1.0)

    def coherence(self, k: Array) -> Array:
        """|E[exp(i k delay)]|."""
        return np.ones_like(k)

    def forgotten(self, p: Array) -> Array:
        """1 - E[exp(-p delay)], p complex."""
        return np.asarray(-np.expm1(-p * self.mean))

    def sample(self) -> Array:
        """Equally likely delays that stand for the law."""
        return np.full(1, self.mean)

    def for_kernels(self) -> "Waits":
        return Waits(self.mean, 0.0)


class Exponential(_Mean, Law):
    """Delays are exponential with mean `mean`; methods are those of `Fixed`."""

    __slots__ = ()

    def cdf(self, t: Any) -> Array:
        if not self.mean:
            return np.where(np.asarray(t) >= 0, 1.0, 0.0)
        return -np.expm1(-np.maximum(t, 0.0) / self.mean)

    def residual_cdf(self, t: Any) -> Array:
        return self.cdf(t)

    def rest(self, x: Array) -> Array:
        return self.mean * np.exp(-x / self.mean) if self.mean else np.zeros_like(x)

    def waiting(self, h: float, cells: int) -> Array:
        if not self.mean:
            return np.zeros(cells)
        first = -math.expm1(-h / self.mean) * self.mean / h
        return np.asarray(first * np.exp(-h / self.mean * np.arange(cells)))

    def coherence(self, k: Array) -> Array:
        return np.asarray(1.0 / np.hypot(1.0, k * self.mean))

    def forgotten(self, p: Array) -> Array:
        return np.asarray(p * self.mean / (1.0 + p * self.mean))

    def sample(self) -> Array:
        return self.mean * -np.log((np.arange(16) + 0.5) / 16)

    def for_kernels(self) -> "Waits":
        return Waits(self.mean, self.mean)


DELAYS: dict[str, type[Fixed] | type[Exponential]] = {
    "fixed": Fixed,
    "exponential": Exponential,
}


@dataclass(frozen=True)
class Delay:
    """Time for which a contact stays detached after it has broken.

    Raises InputError for a negative time or an unknown law.

    With an infinite time a contact never forms again, as in a fibre bundle.

    Parameters
    ----------
    time : float
        Mean delay tau (time), or math.inf.
    law : str
        One of `DELAYS`.

    Examples
    --------
    >>> print(f"{Delay(2.0, 'exponential').cdf(2.0):.3f}")  # P(delay <= 2)
    0.632
    """

    time: float = 0.0
    law: str = "fixed"

    def __post_init__(self) -> None:
        if self.time != math.inf:
            require_number("time", self.time, **NOT_NEGATIVE)
        require_choice("law", self.law, tuple(DELAYS))

    def reduced(self, velocity: float = 1.0, unit: float = 1.0) -> Fixed | Exponential:
        """The law of v tau in units of `unit` (length)."""
        if self.time == math.inf:
            return Fixed(math.inf)  # without end all laws are alike
        return DELAYS[self.law](velocity * self.time / unit)

    def cdf(self, t: Any) -> Array:
        """P(delay <= t), t a time."""
        return self.reduced().cdf(t)

    def residual_cdf(self, t: Any) -> Array:
        """P(rest of the delay <= t) of a contact found detached in the stationary state
        (derived, renewal theory)."""
        return self.reduced().residual_cdf(t)


class Waits(NamedTuple):
    """A law of delays for kernels, one type for both: the part `random` of the `mean`
    is exponentially distributed, the rest fixed."""

    mean: float
    random: float

    @property
    def law(self) -> Fixed | Exponential:
        """The law itself."""
        return Exponential(self.mean) if self.random else Fixed(self.mean)


@routine(inline=True)
def delay_draw(law: Waits, u: float) -> float:
    """A delay from a uniform u in (0, 1)."""
    return law.mean - law.random - law.random * log(u)


@routine(inline=True)
def residual_delay_draw(law: Waits, u: float) -> float:
    """The rest of a delay in the stationary state, all of it random or none, from a
    uniform u in (0, 1)."""
    return (law.mean - law.random) * u - law.random * math.log(u)
