"""Bursts of a bundle under slowly raised force against numbers of Hemmer and Hansen's
integral with 25 digits, closed forms and bundles broken contact by contact."""

import math

import numpy as np
import pytest
from scipy import integrate, stats

from eqsim import (
    Aging,
    Delta,
    Ensemble,
    Exponential,
    Gamma,
    InputError,
    Lognormal,
    Newborn,
    Normal,
    Pareto,
    Table,
    Thermal,
    Uniform,
    Weibull,
    bursts,
)

LAWS = {
    "weibull": Weibull(2.0),
    "uniform": Uniform(0.4, 1.0),
    "lognormal": Lognormal(0.5, 3.0),
    "gamma": Gamma(2.0),
    "normal": Normal(0.3),
}


def bundle(law, stiffness="uniform"):
    return Ensemble(law, stiffness_law=stiffness)


def broken(law, stiffness, count, rng):
    """Sizes of the bursts of one bundle, the last one apart, and its largest force per
    contact: the force at which each contact is due, in the order of thresholds; a burst
    begins at a contact that needs more force than all before it."""
    xi = np.sort(law.inverse_survival(rng.exponential(size=count)))
    k = xi / law.rms if stiffness == "sqrt" else np.ones(count)
    load = xi * np.cumsum(k[::-1])[::-1] / count
    begun = np.flatnonzero(load > np.maximum.accumulate(np.append(0.0, load[:-1])))
    sizes = np.diff(np.append(begun, count))
    return sizes[:-1], sizes[-1], load.max()


@pytest.mark.parametrize(
    ("law", "sizes", "known"),
    [
        (
            Weibull(2.0),
            [1, 2, 10],
            [0.16069559114, 0.027820239802, 0.0004494689851],
        ),
        (Uniform(0.0, 1.0), [1, 5], [0.24185458084, 0.0030004946595]),
    ],
)
def test_hemmer_and_hansen(law, sizes, known):
    """Eleven digits are given."""
    found = bursts(bundle(law), sizes)
    assert found.number == pytest.approx(known, rel=1e-9, abs=0)


def test_tail_and_last_burst():
    """D(s)/N -> p(x_c)/(a'(x_c) sqrt(2 pi)) s^(-5/2), relative corrections of
    1/sqrt(s), then 1/s; Weibull's law of shape 2 has a = 2 x^2, and e^(-1/2) of the
    contacts break last."""
    found = bursts(bundle(Weibull(2.0, 3.0)), [10**6, 10**8])
    tail = math.exp(-0.5) / 2.0 / math.sqrt(2.0 * math.pi)
    near, far = found.number * found.size**2.5
    assert far + (far - near) / 9.0 == pytest.approx(tail, rel=1e-6, abs=0)
    assert found.last == pytest.approx(math.exp(-0.5), rel=1e-14, abs=0)
    assert found.stretch == pytest.approx(3.0 * math.sqrt(0.5), rel=1e-14, abs=0)
    assert found.strength == pytest.approx(3.0 * 0.4288819424803534, rel=1e-14, abs=0)


@pytest.mark.parametrize("stiffness", ["uniform", "sqrt"])
@pytest.mark.parametrize("law", LAWS.values(), ids=LAWS)
def test_every_contact_breaks_once(law, stiffness):
    """sum s D(s)/N + last = 1. Beyond the largest size M is the sum of the tail
    s^(-3/2) (C + B/sqrt(s)), C and B from two sizes, and less than 10/M^(3/2)."""
    most = 2000
    found = bursts(bundle(law, stiffness), range(1, most + 1))
    quarter, whole = (found.number * found.size**2.5)[[most // 4 - 1, most - 1]]
    slope = (quarter - whole) * math.sqrt(most)
    constant = whole - slope / math.sqrt(most)
    rest = 2.0 * constant / math.sqrt(most + 0.5) + slope / (most + 0.5)
    total = np.sum(found.size * found.number) + rest + found.last
    assert total == pytest.approx(1.0, rel=0, abs=10.0 / most**1.5)


@pytest.mark.verification
@pytest.mark.parametrize("stiffness", ["uniform", "sqrt"])
@pytest.mark.parametrize("law", LAWS.values(), ids=LAWS)
def test_integral_of_the_stiffness_weighted_law(law, stiffness):
    """The same integral over x by SciPy, with the density of Q."""

    def q(x):
        return law.pdf(x) * (x if stiffness == "sqrt" else 1.0)

    def beyond(x):
        return integrate.quad(q, x, law.inverse_survival(60.0), epsabs=0, limit=200)[0]

    found = bursts(bundle(law, stiffness), [1, 3])
    low = max(law.support[0], 0.0)

    def single(x, s):
        a = x * q(x) / beyond(x)
        return a ** (s - 1) * math.exp(-s * a) * (1.0 - a) * float(law.pdf(x))

    for s, number in zip(found.size, found.number, strict=True):
        expected = integrate.quad(single, low, found.stretch, (s,), epsabs=0)[0]
        expected *= s ** (s - 1) / math.factorial(int(s))
        assert number == pytest.approx(expected, rel=1e-7, abs=0)


@pytest.mark.parametrize(
    ("law", "stiffness"),
    [(Weibull(2.0), "uniform"), (Lognormal(0.8), "sqrt")],
)
def test_bundles_broken_contact_by_contact(law, stiffness):
    """Chi-square of 20 bundles of 2e5 contacts; sizes are far below the cut-off of that
    number at s ~ N^(2/3). Negative control: the other law of stiffness."""
    rng = np.random.default_rng(45)
    runs = [broken(law, stiffness, 200_000, rng) for _ in range(20)]
    seen = np.concatenate([sizes for sizes, _, _ in runs])
    edges = np.array([1, 2, 3, 4, 6, 8, 12, 18, 27, 40, 60, 90, 140])
    counts = np.histogram(seen, edges)[0]

    def chance(stiffness):
        found = bursts(bundle(law, stiffness), np.arange(1, 140))
        sums = np.add.reduceat(found.number, edges[:-1] - 1) * 200_000 * 20
        return stats.chi2.sf(np.sum((counts - sums) ** 2 / sums), counts.size)

    assert chance(stiffness) > 1e-4
    assert chance("sqrt" if stiffness == "uniform" else "uniform") < 1e-6
    found = bursts(bundle(law, stiffness), [1])
    # a maximum of N contacts is O(N^(-2/3)) above that of infinitely many
    assert np.mean([force for _, _, force in runs]) == pytest.approx(
        found.strength, rel=2e-3, abs=0
    )


def test_first_break_may_be_the_last_burst():
    """Power law: each contact that is left has the same force to take."""
    found = bursts(bundle(Pareto(3.5, 2.0)), [1, 2])
    assert found.number.tolist() == [0.0, 0.0]
    assert (found.last, found.stretch, found.strength) == (1.0, 2.0, 2.0)
    assert bursts(bundle(Exponential(2.0)), [1]).last == pytest.approx(
        math.exp(-1.0), rel=1e-12, abs=0
    )


@pytest.mark.parametrize(
    ("ensemble", "sizes", "said"),
    [
        (bundle(Delta(1.0)), [1], "must have a density"),
        (bundle(Table([1.0, 2.0])), [1], "must have a density"),
        (Ensemble(thermal=Thermal(kT=0.1)), [1], "thermal: must be off"),
        (Ensemble(aging=Aging("flow", math.inf, 2.0)), [1], "do not age"),
        (Ensemble(newborn=Newborn("delta", stretch=0.3)), [1], "born unstretched"),
        (bundle(Weibull(2.0)), [], "sizes"),
        (bundle(Weibull(2.0)), [0], "sizes"),
        (bundle(Weibull(2.0)), [1.5], "sizes"),
        (bundle(Weibull(2.0)), [[1.0]], "sizes"),
    ],
)
def test_refused(ensemble, sizes, said):
    with pytest.raises(InputError, match=said):
        bursts(ensemble, sizes)
