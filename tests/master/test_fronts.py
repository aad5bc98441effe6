"""The share of a cell and a stratum that heat has broken, against sums to many digits
and a plain average."""

import math

import mpmath as mp
import numpy as np
import pytest
from kernels import compiled

from eqsim import Delay, Ensemble, Gamma, NoThresholds, Programme, Segment, Thermal
from eqsim.master import cohorts, fronts
from eqsim.master.programme import course_of, numerics_of


@pytest.mark.parametrize("y", [-30.0, -6.5, -5.5, 0.0, 2.25, 4.0])
def test_second_integral(y):
    """The table's knots against the series, to 1e-13 of it."""
    with mp.workdps(60 + int(2 * np.exp(y))):
        z = mp.e ** mp.mpf(y)
        terms = (
            (-1) ** (n + 1) * z**n / (n**2 * mp.factorial(n))
            for n in range(1, int(60 + 5 * np.exp(y)))
        )
        exact = mp.fsum(terms)
    found = fronts.table_of_w()[round((y - fronts.W_BEGINS) * fronts.W_PER_UNIT), 0]
    assert found == pytest.approx(float(exact), rel=1e-13, abs=0)


@pytest.mark.parametrize("middle", [-12.0, -1.0, 0.4, 3.0, 9.0])
@pytest.mark.parametrize(
    ("by_threshold", "by_birth"),
    [(-0.1, 0.05), (-12.0, 0.2), (-3.0, 7.0), (-150.0, 40.0), (0.0, 0.0)],
)
def test_share_that_is_broken(middle, by_threshold, by_birth):
    """By 2000 x 500 midpoints, .075 and .08 apart at most, which miss (.075^2 +
    .08^2)/24 times a curvature that averages out but at the corners, 1e-4."""
    u, v = ((np.arange(count) + 0.5) / count - 0.5 for count in (2000, 500))
    y = middle + by_threshold * u[:, None] + by_birth * v
    exact = -np.expm1(-np.exp(np.minimum(y, 50.0))).mean()
    found = compiled(fronts._broken)(
        fronts.table_of_w(), middle, by_threshold, by_birth
    )
    assert found == pytest.approx(exact, rel=1.4e-4, abs=1e-9)


@pytest.mark.parametrize("middle", [-5.0, -1.0, -0.36, 1.0, 2.5])
@pytest.mark.parametrize(
    "differences", [(0.0, 0.0), (0.02, 0.0), (0.0, 1.5), (4.0, 0.0)]
)
def test_share_of_small_differences(middle, differences):
    """Differences of ln z for which the table is too coarse, by 20 Gauss-Legendre nodes
    each way. Allowed are twice the table's h^4 W/384 = 2.4e-10 max|W|, 0.6, at
    each of four corners over the product of the differences, at least 0.03 each; the
    least difference for none misses 2e-5."""
    nodes, weights = (part / 2 for part in np.polynomial.legendre.leggauss(20))
    y = middle + differences[0] * nodes[:, None] + differences[1] * nodes
    exact = weights @ -np.expm1(-np.exp(y)) @ weights
    found = compiled(fronts._broken)(fronts.table_of_w(), middle, *differences)
    assert found == pytest.approx(exact, rel=0, abs=1e-6)


@pytest.mark.parametrize("power", [0, 1, 2])
@pytest.mark.parametrize("ends", [(-3.0, -9.0), (0.4, -0.3), (5.0, -2.0), (20.0, 1.0)])
def test_survivors_across_a_stratum(ends, power):
    """Means of int_0^1 u^p exp(-z u) du over ln z between two ends, to 1e-7 of
    themselves: the table is of fourth order in 1/64."""
    integral = compiled(fronts._exponential_integral)
    weak, strong = (
        float(mp.quad(lambda u, y=y: u**power * mp.exp(-u * mp.exp(y)), [0, 0.01, 1]))
        for y in ends
    )
    fall = integral(fronts.table_of_w(), ends[1])
    fall -= integral(fronts.table_of_w(), ends[0])
    apart = ends[0] - ends[1]
    found = compiled(fronts._across)(weak, strong, fall, (power + 1) * apart)
    known = mp.quad(
        lambda y: mp.quad(lambda u: u**power * mp.exp(-u * mp.exp(y)), [0, 0.01, 1]),
        [ends[1], 0.5 * sum(ends), ends[0]],
    )
    assert found == pytest.approx(float(known) / apart, rel=1e-7, abs=0)


@pytest.mark.parametrize(
    ("law", "heat"),
    [
        pytest.param(
            NoThresholds(1.0),
            Thermal(barrier="bell", off_rate=1.0, force_scale=math.inf),
            marks=pytest.mark.verification,
        ),
        (Gamma(2.0), Thermal(kT=0.3, attempt_frequency=20.0)),
    ],
    ids=["constant rate", "gamma"],
)
def test_a_short_step_after_longer_ones(law, heat):
    """In a step of 1e-9 of the whole time some 1e-9 of the contacts break or are born,
    whatever step came before. A plane of ln z down to the newest contacts would take
    those of the step before for too strong: 3e-3 of all contacts would be pinned again.
    Allowed is what is missed of their hazard z < .3 in second order, .02 z^2 of births
    that are a tenth."""
    drive = Programme([Segment(0.2, time=1.0)])
    contacts, course = course_of(Ensemble(law, heat, Delay(0.3)), drive)
    numerics = numerics_of(contacts, course, 1.0)
    t = np.append(np.linspace(0.0, 0.9, 10), 0.9 + 1e-9)
    path = numerics.path(t, course.at(t), 1.0)
    pinned = cohorts.march(numerics.contacts(1.0), path).pinned
    assert pinned[9] < 0.9
    assert abs(pinned[10] - pinned[9]) < 2e-4
