"""Laws of thresholds: NumPy side against SciPy and mpmath, kernel side against NumPy,
draws, and bad input."""

import functools
import math
import pickle
import warnings
from contextlib import suppress

import mpmath
import numpy as np
import pytest
import scipy.stats
from cases import chosen
from kernels import compiled

from eqsim import (
    Delta,
    Distribution,
    Drive,
    Ensemble,
    Gamma,
    InputError,
    Table,
    Thermal,
    reference,
    steady,
    transient,
)
from eqsim.laws import threshold
from eqsim.laws.threshold import FIRST_OCTAVE, LAST_OCTAVE, for_kernels
from eqsim.numerics import streams
from eqsim.numerics.streams import TRAJECTORY, key
from eqsim.numerics.tables import CELLS

uniforms, threshold_draw = (
    compiled(streams.uniforms),
    compiled(threshold.threshold_draw),
)

EPS = np.finfo(float).eps
SMALLEST, LARGEST = 2.0**-64, 1.0 - 2.0**-53  # of the uniforms a kernel sees
SHAPES = [0.0, 0.5, 1.0, 2.7, 30.0]
# a cubic in a cell of relative width 1/64: |p(p-1)(p-2)(p-3)|/(384 * 64^4) for s^p
# (numerics.tables). The quantile behaves as e^(1/(2n+2)) at small e and as sqrt(e) at
# large e; no p in (0, 1/2] gives more than p = 0.38 does.
TABLE_ERROR = 1.001 / (384 * CELLS**4)


@functools.cache
def kernel_uniforms():
    return np.array([uniforms(key(11, TRAJECTORY), i, 0, 0)[0] for i in range(100_000)])


def nakagami(law):
    return scipy.stats.nakagami(law.n + 1, scale=law.x_star * math.sqrt(law.n + 1))


def drawn(law, u):
    lowered = for_kernels(law)
    return law.scale * np.array([threshold_draw(lowered, value) for value in u])


# ---------------------------------------------------------------------------------------------------
# NumPy side


@pytest.mark.parametrize("n", SHAPES)
def test_gamma_is_nakagami(n):
    law, x = Gamma(n, 2.5), np.linspace(0.01, 25.0, 400)
    reference = nakagami(law)
    np.testing.assert_allclose(law.pdf(x), reference.pdf(x), rtol=1e-12, atol=1e-300)
    np.testing.assert_allclose(law.cdf(x), reference.cdf(x), rtol=1e-12)
    np.testing.assert_allclose(law.sf(x), reference.sf(x), rtol=1e-12, atol=1e-300)
    assert law.mean == pytest.approx(reference.mean(), rel=1e-12, abs=0)
    assert law.rms == pytest.approx(math.sqrt(reference.moment(2)), rel=1e-12, abs=0)
    assert law.support == (0.0, math.inf)
    np.testing.assert_array_equal(law.pdf(np.array([-1.0, 0.0])), 0.0)
    np.testing.assert_array_equal(law.cdf(np.array([-1.0, 0.0])), 0.0)
    np.testing.assert_array_equal(law.sf(np.array([-1.0, 0.0])), 1.0)


@chosen("n", SHAPES, [0.0, 2.7])
def test_gamma_against_forty_digits(n):
    """P_c ~ x^(1+2n) exp(-x^2/x_*^2) (PxPf2), its moments and its tail, from the
    definition."""
    law = Gamma(n, 0.7)
    with mpmath.workdps(40):

        def density(x):
            return x ** (1 + 2 * n) * mpmath.exp(-((x / mpmath.mpf(0.7)) ** 2))

        pieces = [0, 0.5, 1, 2, 4, 8, 20]
        norm, first, second = (
            mpmath.quad(lambda x, j=j: x**j * density(x), pieces) for j in range(3)
        )
        assert law.mean == pytest.approx(float(first / norm), rel=1e-13, abs=0)
        assert law.rms == pytest.approx(
            float(mpmath.sqrt(second / norm)), rel=1e-13, abs=0
        )
        for x in (0.05, 0.4, 1.3, 5.0, 12.0):
            # in units of the density at x, as quad knows errors of an integral of order
            # 1 only
            top = density(mpmath.mpf(x))
            rest = mpmath.quad(
                lambda y, top=top: density(y) / top,
                [x, x + 0.05, x + 0.2, x + 1, x + 5, x + 30],
            )
            # the exponent and its rounding
            assert float(law.sf(x)) == pytest.approx(
                float(top * rest / norm), rel=4 * EPS * (1 + (x / 0.7) ** 2), abs=0
            )
            assert float(law.pdf(x)) == pytest.approx(
                float(density(mpmath.mpf(x)) / norm), rel=1e-12, abs=0
            )


@pytest.mark.parametrize("n", SHAPES)
def test_quantile_inverts_the_survival(n):
    """J_c of it is exp(-e), up to relative errors of 1e-13 in xi (d ln J_c = -xi
    P_c/J_c d ln xi) and in e."""
    law, e = Gamma(n, 3.0), np.geomspace(1e-15, 500, 600)
    xi = law.inverse_survival(e)
    small = e < 0.7
    found = np.append(-np.log1p(-law.cdf(xi[small])), -np.log(law.sf(xi[~small])))
    assert np.all(np.abs(found - e) < 1e-13 * (e + xi * law.pdf(xi) / law.sf(xi)))


def test_discrete_laws():
    law = Table([3.0, 1.0, 2.0, 2.0])
    assert law.mean == law.scale == 2.0
    assert law.rms == pytest.approx(math.sqrt(18 / 4), rel=1e-15, abs=0)
    assert law.support == (1.0, 3.0)
    x = np.array([0.5, 1.0, 1.5, 2.0, 3.0, 4.0])
    np.testing.assert_array_equal(law.cdf(x), [0, 0.25, 0.25, 0.75, 1, 1])
    np.testing.assert_array_equal(law.sf(x), 1 - law.cdf(x))
    np.testing.assert_array_equal(
        law.inverse_survival(-np.log([0.1, 0.26, 0.6, 0.8, 1.0])), [3, 2, 2, 1, 1]
    )
    one = Delta(2.0)
    assert (one.mean, one.rms, one.scale, one.support) == (2.0, 2.0, 2.0, (2.0, 2.0))
    np.testing.assert_array_equal(one.sf([1.0, 2.0, 3.0]), [1, 0, 0])
    for discrete in (law, one):
        with pytest.raises(NotImplementedError):
            discrete.pdf(1.0)


def test_table_keeps_order_and_source_out():
    """Any order and shape, and a copy: what happens to the user's array later does not
    matter."""
    source = np.array([[2.0, 1.0], [4.0, 3.0]])
    law = Table(source)
    source[:] = 9.0
    np.testing.assert_array_equal(law.steps, [1, 2, 3, 4])


FROZEN = {
    "lognorm": scipy.stats.lognorm(0.5, scale=2.0),
    "uniform": scipy.stats.uniform(0.5, 1.0),
    "weibull": scipy.stats.weibull_min(2.0),
    "beta": scipy.stats.beta(2.0, 3.0, scale=4.0),
}


@pytest.mark.parametrize("name", FROZEN)
def test_distribution_is_what_scipy_says(name):
    frozen, law = FROZEN[name], Distribution(FROZEN[name])
    x = np.linspace(0.01, 5.0, 100)
    for side in ("pdf", "cdf", "sf"):
        np.testing.assert_array_equal(getattr(law, side)(x), getattr(frozen, side)(x))
    assert law.mean == law.scale == pytest.approx(frozen.mean(), rel=1e-15, abs=0)
    assert law.rms == pytest.approx(
        math.hypot(frozen.mean(), frozen.std()), rel=1e-15, abs=0
    )
    assert law.support == frozen.support()
    e = np.array([1e-12, 1e-3, 0.5, 0.7, 3.0, 40.0])
    np.testing.assert_allclose(
        law.sf(law.inverse_survival(e)), np.exp(-e), rtol=1e-9, atol=2 * EPS
    )


# --------------------------------------------------------------------------------------------------
# kernel side


@pytest.mark.parametrize("n", SHAPES)
def test_draw_is_the_quantile(n):
    """Pointwise within the error of the table, from the smallest uniform to the
    largest; e in [1e-16, 44.4]."""
    law, rng = Gamma(n, 2.5), np.random.default_rng(3)
    u = np.concatenate(
        (
            2.0 ** rng.uniform(-64, 0, 4000),
            -np.expm1(-(2.0 ** rng.uniform(-53, 0, 4000))),
        )
    )
    u = np.concatenate((1.0 - u, u, [SMALLEST, LARGEST]))
    u = u[(u >= SMALLEST) & (u <= LARGEST)]
    np.testing.assert_allclose(
        drawn(law, u), law.inverse_survival(-np.log(u)), rtol=TABLE_ERROR + 1e-13
    )


@pytest.mark.parametrize("name", ["lognorm", "weibull", "beta"])
def test_draw_of_a_distribution_is_the_quantile(name):
    """The same for smooth SciPy laws, to 1e-9 where a kernel's uniforms fall."""
    law, rng = Distribution(FROZEN[name]), np.random.default_rng(4)
    u = np.concatenate(
        (
            2.0 ** rng.uniform(-64, 0, 2000),
            1 - 2.0 ** rng.uniform(-53, -1, 2000),
            [SMALLEST, LARGEST],
        )
    )
    np.testing.assert_allclose(
        drawn(law, u), law.inverse_survival(-np.log(u)), rtol=1e-9
    )


def test_the_table_covers_every_uniform():
    assert -math.log(LARGEST) > 2.0**FIRST_OCTAVE
    assert -math.log(SMALLEST) < 2.0**LAST_OCTAVE


def test_tail_is_not_cut_at_32_bits():
    """xi^2/x_*^2 reaches 45 at the smallest uniform; 32 bits would end at 22."""
    top = drawn(Gamma(0.0), [SMALLEST])[0]
    assert top**2 == pytest.approx(64 * math.log(2), rel=1e-9, abs=0)
    assert (
        np.unique(drawn(Gamma(0.0), 2.0**-64 + 2.0**-63 * np.arange(100))).size == 100
    )


@pytest.mark.parametrize("size", [1, 2, 3, 7, 64, 1000, 4097])
def test_ranks_are_equally_likely(size):
    """Threshold j of a table belongs to u in [j, j+1)/size counted from the greatest;
    no uniform falls outside."""
    steps = np.arange(1.0, size + 1)
    law = Table(steps)
    middles = (np.arange(size) + 0.5) / size
    np.testing.assert_array_equal(
        drawn(law, middles), steps[::-1] / law.scale * law.scale
    )
    assert drawn(law, [SMALLEST])[0] == pytest.approx(size, rel=2 * EPS, abs=0)
    assert drawn(law, [LARGEST])[0] == pytest.approx(1.0, rel=2 * EPS, abs=0)
    np.testing.assert_allclose(
        drawn(law, middles), law.inverse_survival(-np.log(middles)), rtol=2 * EPS
    )


# ------------------------------------------------------------------------------------------------------
# by draws


def ks(sample, cdf):
    return scipy.stats.kstest(sample, cdf).pvalue


@pytest.mark.verification
@chosen("n", SHAPES, [0.0, 2.7])
def test_gamma_draws(n):
    """KS over 1e5 draws of the engine's streams, p > 1e-5 (false alarm of the whole
    file 2e-4); n + 0.05 (n+1) must fail."""
    sample = drawn(Gamma(n, 2.5), kernel_uniforms())
    assert ks(sample, nakagami(Gamma(n, 2.5)).cdf) > 1e-5
    assert ks(sample, nakagami(Gamma(n + 0.05 * (n + 1), 2.5)).cdf) < 1e-5


@pytest.mark.parametrize("name", FROZEN)
def test_distribution_draws(name):
    frozen = FROZEN[name]
    sample = drawn(Distribution(frozen), kernel_uniforms())
    assert ks(sample, frozen.cdf) > 1e-5
    assert ks(1.02 * sample, frozen.cdf) < 1e-5  # negative control


def test_table_draws():
    """Chi-square over five equally likely thresholds, p > 1e-5; unequal weights must
    fail."""
    counts = np.unique(
        drawn(Table([5.0, 1.0, 2.0, 4.0, 3.0]), kernel_uniforms()), return_counts=True
    )[1]
    assert scipy.stats.chisquare(counts).pvalue > 1e-5
    weights = np.array([0.206, 0.2, 0.2, 0.2, 0.194])
    assert scipy.stats.chisquare(counts, weights * counts.sum()).pvalue < 1e-5


# -----------------------------------------------------------------------------------------------------
# bad input


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Gamma(n=-0.1), "n = -0.1: must be a finite number >= 0"),
        (lambda: Gamma(n=math.nan), "n = nan"),
        (lambda: Gamma(x_star=0.0), "x_star = 0.0: must be a finite number > 0"),
        (lambda: Gamma(x_star=math.inf), "x_star = inf"),
        (lambda: Gamma(x_star="1"), "x_star = '1'"),
        (lambda: Delta(-2.0), "x_star = -2.0"),
        (lambda: Table([]), "is empty"),
        (lambda: Table([1.0, -3.0, 2.0]), "holds -3"),
        (lambda: Table([0.0]), "holds 0"),
        (lambda: Table([1.0, math.nan]), "holds nan"),
        (lambda: Table([math.inf]), "holds inf"),
        (lambda: Table(["soft"]), "every value must be a number"),
        (lambda: Table([[1.0], [2.0, 3.0]]), "every value must be a number"),
        (lambda: Table([1j]), "every value must be a number"),
        (lambda: Distribution(None), "None: must be a frozen continuous"),
        (lambda: Distribution(1.0), "1.0: must be a frozen continuous"),
        (lambda: Distribution(scipy.stats.poisson(3)), "must be a frozen continuous"),
        (lambda: Distribution(scipy.stats.norm(5.0, 1.0)), "support begins at -inf"),
        (
            lambda: Distribution(scipy.stats.uniform(-0.5, 1.0)),
            "support begins at -0.5",
        ),
        (
            lambda: Distribution(scipy.stats.uniform(math.nan, 1.0)),
            "support begins at nan",
        ),
        (lambda: Distribution(scipy.stats.lomax(2.5)), "<xi^3>"),
        (lambda: Distribution(scipy.stats.halfcauchy()), "<xi^3>"),
    ],
)
@pytest.mark.filterwarnings("ignore")
def test_bad_laws(make, message):
    """One line that names what is wrong."""
    with pytest.raises(InputError) as caught:
        make()
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


NOT_FROZEN = {
    "needs a shape": scipy.stats.lognorm,
    "array": scipy.stats.uniform([0.5, 1.0], 1.0),
}


@pytest.mark.parametrize("name", NOT_FROZEN)
def test_not_quite_frozen(name):
    with pytest.raises(InputError):
        Distribution(NOT_FROZEN[name])


class Failing:
    """A lognormal law whose isf is something else below 1e-30."""

    def __init__(self, value):
        self.right, self.value = scipy.stats.lognorm(0.5), value

    def __getattr__(self, name):
        return getattr(self.right, name)

    def isf(self, q):
        return np.where(q < 1e-30, self.value, self.right.isf(q))


@pytest.mark.parametrize("value", [math.inf, math.nan, 1e150])
def test_laws_whose_tail_scipy_does_not_know(value):
    """Refused by solver and simulation alike, in one sentence; what is right of the
    quantiles is given."""
    law = Distribution(Failing(value))
    contacts = Ensemble(law, Thermal(0.05), stiffness_law="uniform")
    for run in (reference, steady):
        with pytest.raises(
            InputError,
            match=r"^threshold distribution: isf of SciPy's lognorm fails at \d\.\de-\d+, and",
        ):
            run(contacts, Drive(0.1))
    np.testing.assert_array_equal(
        law.inverse_survival([1.0, 30.0]), law.frozen.right.isf(np.exp([-1.0, -30.0]))
    )
    with pytest.raises(
        InputError,
        match=r"fails at 4\.2e-35, and must be right down to 1e-222; give another law",
    ):
        law.inverse_survival([30.0, 79.149, 90.0])


@pytest.mark.filterwarnings("ignore:Error in function")
def test_no_friction_is_infinite():
    """That of an inverse Gaussian law was, whose isf is wrong from 1e-64 on in some
    versions of SciPy."""
    law, found = Distribution(scipy.stats.invgauss(0.5)), None
    with suppress(InputError):
        found = reference(Ensemble(law, stiffness_law="uniform"), Drive(0.1)).friction
    assert (
        found is None
        or abs(found.value - law.rms**2 / (2 * law.mean)) < 1e-9 + found.stderr
    )


@pytest.mark.parametrize(
    "frozen",
    [
        scipy.stats.fisk(5.0),
        scipy.stats.loglaplace(5.0),
        scipy.stats.lognorm(0.5),
        scipy.stats.uniform(1.0, 2.0),
    ],
    ids=lambda frozen: frozen.dist.name,
)
def test_laws_whose_tail_scipy_knows(frozen):
    """Control: of heavy tails whose survival function is 0 from 1e-16 on the density is
    not, and of a law with an end both may be 0 there. Friction at T = 0 is <xi^2>/(2
    <xi>). Nothing is said of what SciPy divides by in the tail."""
    contacts = Ensemble(Distribution(frozen), stiffness_law="uniform")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = reference(contacts, Drive(0.1)).friction
        transient(contacts, Drive(0.1, 1.0), points=3)
    assert (
        abs(found.value - frozen.moment(2) / (2 * frozen.mean())) < 1e-9 + found.stderr
    )


@pytest.mark.parametrize("bins", [1, 3, 40, 1000])
@pytest.mark.parametrize("place", [0.0, 1e-9, 1.0, 1e6])
def test_bins_of_a_histogram_are_found(bins, place):
    """To the last bit, of bins of very different widths; equal neighbours are one bin."""
    rng = np.random.default_rng(bins)
    widths = rng.exponential(size=bins) ** 3
    # bins of no width are none
    edges = np.unique(place + np.cumsum(np.append(0.0, widths)))
    bins = edges.size - 1
    counts = rng.permutation(np.arange(bins) % 7 + 1.0)
    counts[1:][counts[1:] == counts[:-1]] = 0.0  # two of them in a row are one, too
    histogram = scipy.stats.rv_histogram((counts, edges), density=False)
    law = Distribution(histogram)
    jumps = np.append(
        True,
        np.append(np.diff(law.frozen.pdf(0.5 * (edges[1:] + edges[:-1]))) != 0.0, True),
    )
    np.testing.assert_array_equal(law.breakpoints, edges[jumps])
    np.testing.assert_array_equal(Distribution(histogram()).breakpoints, edges[jumps])


def test_breakpoints_may_be_one_number_or_in_any_order():
    law = scipy.stats.gamma(3.0)
    assert Distribution(law, 0.5).breakpoints.tolist() == [0.5]
    assert Distribution(law, [[2.0, 1.0]]).breakpoints.tolist() == [1.0, 2.0]


def test_tables_of_the_same_thresholds_are_equal():
    law = Table([1.0, 3.0, 2.0])
    again = pickle.loads(pickle.dumps(Ensemble(law)))
    assert again == Ensemble(Table([3.0, 2.0, 1.0]))
    assert hash(again) == hash(Ensemble(law))
    assert law != Table([1.0, 2.5, 3.0])
    assert law != Table([1.0, 2.0, 2.0, 3.0])


def test_histogram_law_can_be_printed():
    law = Distribution(
        scipy.stats.rv_histogram(np.histogram([1.0, 2.0, 2.0, 3.0], bins=3))
    )
    assert "Distribution" in repr(law)


@pytest.mark.parametrize(
    ("counts", "edges"),
    [
        ([3, 0, 1], [0.5, 1.0, 1.5, 2.0]),
        ([1, 2, 0, 0, 5, 0.1], [0.0, 0.1, 0.2, 0.5, 1.0, 1.2, 8.0]),
        ([2, 1, 0, 1e-3], [0.0, 1.0, 3.0, 4.0, 9.0]),
    ],
)
def test_draws_beside_jumps_and_across_gaps(counts, edges):
    """Thresholds are those of SciPy's isf on both sides of every jump and elsewhere, to
    what cubics miss of a uniform density, w exp(-e) in cells of e no wider than 1/8
    (h^4/384 of the width w of a bin, 6e-7 w). If the breakpoints are not told, some are
    off by more than 1e-3."""
    frozen = scipy.stats.rv_histogram((counts, edges), density=False)
    law = Distribution(frozen)
    jumps = frozen.sf(law.breakpoints)
    u = np.concatenate(
        (jumps * (1.0 - 1e-9), jumps * (1.0 + 1e-9), np.geomspace(1e-6, 0.999, 400))
    )
    u = u[(u > 0.0) & (u < 1.0)]
    np.testing.assert_allclose(
        drawn(law, u), frozen.isf(u), rtol=1e-9, atol=6.4e-7 * np.diff(edges).max()
    )
    untold = drawn(Distribution(frozen, ()), u)
    assert np.abs(untold / frozen.isf(u) - 1.0).max() > 1e-3


@pytest.mark.parametrize("shares", [(1, 0, 3), (3, 0, 1), (1, 0, 1)])
def test_error_of_draws_across_a_gap_that_is_not_told(shares):
    """What is quoted is the mean absolute error of drawn thresholds and that of their
    cubes, relative to their means: here over 5e4 midpoints of uniforms, and quoted from
    four points of each cell (0.3 of it are left for that). The gap is one of weak
    contacts, whose cubes hardly matter: twice the first is much more."""
    law = Distribution(
        scipy.stats.rv_histogram((shares, [0.1, 0.2, 0.3, 2.0]), density=True), ()
    )
    u = (np.arange(50_000) + 0.5) / 50_000
    found, exact = drawn(law, u), law.frozen.isf(u)
    first, third = (
        np.abs(found**p - exact**p).mean() / (exact**p).mean() for p in (1, 3)
    )
    assert 1e-6 < first < 1e-3
    assert third < 0.3 * first
    assert law.drawn_to == pytest.approx(first + third, rel=0.3, abs=0.0)
