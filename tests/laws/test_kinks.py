"""Where densities of thresholds have kinks."""

import numpy as np
import pytest
from scipy import stats

from eqsim import Delta, Gamma, Table
from eqsim.laws.named import Pareto, Uniform, Weibull
from eqsim.laws.threshold import Distribution


class TwoSided(stats.rv_continuous):
    """The square root of the distance from 1/4 has even odds: the density is infinite
    inside."""

    _ends = 0.5 + np.sqrt(0.75)

    def _pdf(self, x):
        return 0.5 / (np.sqrt(np.abs(x - 0.25)) * self._ends)

    def _cdf(self, x):
        return (0.5 + np.sign(x - 0.25) * np.sqrt(np.abs(x - 0.25))) / self._ends

    def _ppf(self, q):
        root = q * self._ends - 0.5
        return 0.25 + np.sign(root) * root**2

    def _isf(self, q):
        root = np.sqrt(0.75) - q * self._ends
        return 0.25 + np.sign(root) * root**2


BINS = stats.rv_histogram(([1, 3, 0, 2], [0.0, 1.0, 2.0, 3.0, 4.0]))
KINKS = {
    "gamma": (Gamma(0.0), []),
    "infinite at 0": (Weibull(0.5), []),
    "delta": (Delta(2.0), [2.0]),
    "two points": (Table([1.0, 3.0, 1.0]), [1.0, 3.0]),
    "uniform": (Uniform(0.9, 1.1), [0.9, 1.1]),
    "pareto": (Pareto(3.5, 2.0), [2.0]),
    "histogram": (Distribution(BINS), [1.0, 2.0, 3.0, 4.0]),
    "triangle": (Distribution(stats.triang(0.3, 0.5, 1.0)), [0.5, 0.8, 1.5]),
    "trapezium": (Distribution(stats.trapezoid(0.2, 0.7)), [0.2, 0.7, 1.0]),
    "infinite at both ends": (Distribution(stats.arcsine(0.5, 1.0)), [0.5, 1.5]),
    "infinite inside": (Distribution(TwoSided(a=0.0, b=1.0)()), [0.25, 1.0]),
    "narrow": (Distribution(stats.lognorm(1e-3)), []),
    "a tail of a power": (Distribution(stats.fisk(7.0)), []),
    "cut": (Distribution(stats.truncnorm(-1.0, 2.0, 1.0, 0.5)), [0.5, 2.0]),
}


@pytest.mark.parametrize(("law", "kinks"), KINKS.values(), ids=KINKS)
def test_kinks(law, kinks):
    """Known from what the laws are; SciPy's inside are sought in values of the density,
    down to 1e-9 of windows that are narrower than the law, and there to the rounding of
    its second differences."""
    assert law.kinks == pytest.approx(np.array(kinks), rel=1e-9, abs=0)
