"""The logarithm by which friction heals in holds (Dieterich, 1972):

    peak - force before the hold = beta log10(1 + t/t_c),

beta per decade of the time t of the hold, and t_c the time beyond which it is
logarithmic.
"""

import math
import warnings
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy import optimize, special

from eqsim.estimate import Estimate
from eqsim.numerics.tables import Array

_FEWEST = 3  # holds, one more than the law has parameters
_LOG_CUTOFF = -500.0, 500.0  # range of the logarithm of a cutoff that is found
_UNLIKELY = 1e-3  # probability of a chi-square above which the law holds within errors


class Healing(NamedTuple):
    """A logarithm through healing after holds: its `rate` per decade and the `cutoff`
    t_c, with errors that are larger by the root of chi-square over its degrees of
    freedom, `dof`, where that is above 1."""

    rate: Estimate
    cutoff: Estimate
    chi_square: float
    dof: int

    @property
    def logarithmic(self) -> bool:
        """True if the healing is a logarithm within its errors."""
        return bool(special.chdtrc(self.dof, self.chi_square) > _UNLIKELY)

    def at(self, hold: Array) -> Array:
        """The law at times of holds."""
        values = (estimate.value or math.nan for estimate in (self.rate, self.cutoff))
        return _law(hold, *values)

    def as_dict(self) -> dict[str, object]:
        """Fields for JSON."""
        found = {"rate": self.rate.as_dict(), "cutoff": self.cutoff.as_dict()}
        return {**self._asdict(), **found, "logarithmic": self.logarithmic}

    def parts(
        self, units: tuple[str, str], rate: Estimate | None = None
    ) -> tuple[str, str, str]:
        """The rate, or `rate` in another quantity, and the cutoff with their units, and
        ", unreliable" if one of them is."""
        both = rate or self.rate, self.cutoff
        slope, time = (
            f"{replace(one, reliable=True)} {unit}".rstrip()
            for one, unit in zip(both, units, strict=True)
        )
        return slope, time, "" if all(one.reliable for one in both) else ", unreliable"

    def told(self, rate: Estimate | None = None, unit: str = "") -> str:
        """The law in words; `rate` in another quantity, `unit` of time."""
        slope, time, unsure = self.parts(("", unit), rate)
        said = f"{slope} per decade, logarithmic beyond {time}"
        doubt = "" if self.logarithmic else ": no logarithm within errors"
        doubt += unsure
        return f"{said} (chi-square {self.chi_square:.3g} of {self.dof}{doubt})"


def _law(hold: Array, rate: float, cutoff: float) -> Array:
    return np.asarray(rate * np.log10(1.0 + hold / cutoff))


def healing_law(hold: Array, healing: Array, stderr: Array) -> Healing | None:
    """Fit the logarithm to healing with independent errors after holds of some times,
    arrays (holds,). None for fewer than three times, or where no logarithm is found.

    Examples
    --------
    >>> hold = np.array([1.0, 10.0, 100.0, 1000.0])
    >>> law = healing_law(hold, np.array([0.001, 0.01, 0.026, 0.046]), np.full(4, 1e-3))
    >>> print(law.told())
    0.0199(10) per decade, logarithmic beyond 5.0(10) (chi-square 0.707 of 2)
    """
    known = (hold > 0.0) & (stderr > 0.0)
    t, y, error = hold[known], healing[known], stderr[known]
    if np.unique(t).size < _FEWEST:
        return None
    # the cutoff by its logarithm, which is positive
    steep = math.copysign(float(np.ptp(y)), y.sum()) / math.log10(t.max() / t.min())
    start = steep, math.log(np.median(t))

    def law(hold: Array, rate: float, log_cutoff: float) -> Array:
        return _law(hold, rate, math.exp(np.clip(log_cutoff, *_LOG_CUTOFF)))

    with warnings.catch_warnings():
        # a cutoff without an end has infinite errors
        warnings.simplefilter("ignore", optimize.OptimizeWarning)
        try:
            found = optimize.curve_fit(law, t, y, start, error, absolute_sigma=True)
        except RuntimeError:
            return None
    (rate, log_cutoff), covariance = found
    cutoff, dof = math.exp(np.clip(log_cutoff, *_LOG_CUTOFF)), t.size - 2
    chi_square = float(np.sum(((y - _law(t, rate, cutoff)) / error) ** 2))
    wider = math.sqrt(max(chi_square / dof, 1.0))
    errors = wider * np.sqrt(np.diag(covariance))
    if not np.all(np.isfinite(errors)):
        return None
    how = (t.size, None, bool(errors[1] < 1.0))  # the cutoff is known to a factor of e
    slope = Estimate(float(rate), float(errors[0]), *how)
    beyond = Estimate(cutoff, float(errors[1]) * cutoff, *how)
    return Healing(slope, beyond, chi_square, dof)
