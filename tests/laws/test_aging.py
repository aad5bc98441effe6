"""Laws of aging thresholds: the pooled law against a mixture by another quadrature,
contacts along flowing thresholds against an ODE and against their own hazard, messages.

By chance fail only the draws of a pooled law (Kolmogorov-Smirnov, p > 1e-5 in each of
eight); the seeds are fixed.
"""

import itertools
import math

import mpmath
import numpy as np
import pytest
import scipy.stats
from cases import chosen
from kernels import compiled
from reduced_cases import barrier_of
from scipy import integrate, special

from eqsim import Delta, Ensemble, Gamma, InputError, Table, Thermal
from eqsim.laws.aging import Aging, Flow, PooledThresholds, Unaged, along, base, flow
from eqsim.laws.barrier.base import height, stretch
from eqsim.laws.stiffness import Springs
from eqsim.laws.threshold import NO_STEPS, Thresholds, threshold_draw
from eqsim.model.reduced import births, reduced

flow_end, path_life, growth, work = map(
    compiled, (flow.flow_end, along.path_life, base.growth, base.work)
)
height, stretch, threshold_draw = map(compiled, (height, stretch, threshold_draw))

# -------------------------------------------------------------------------------------------------------
# messages


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            {"rule": "drift"},
            r'^rule = \'drift\': must be one of "none", "langevin", "flow", "logarithmic"$',
        ),
        ({"rule": "flow", "rate": -1.0}, r"^rate = -1.0: must be a finite number >= 0"),
        ({"rule": "flow", "rate": math.nan}, r"^rate = nan"),
        ({"rule": "flow", "rate": -math.inf}, r"^rate = -inf"),
        ({"rule": "flow", "rate": "fast"}, r"^rate = 'fast'"),
        (
            {"rule": "flow", "rate": 1.0, "x_star_final": 0.0},
            r"^x_star_final = 0.0: must be a finite number > 0",
        ),
        (
            {"rule": "flow", "rate": 1.0, "x_star_final": math.inf},
            r"^x_star_final = inf",
        ),
        ({"x_star_final": None}, r"^x_star_final = None"),
        ({"rate": 1.0, "x_star_final": 2.0}, '^rate: not allowed with rule = "none"'),
        ({"beta": 0.1, "cutoff_time": 1}, '^beta: not allowed with rule = "none"'),
    ],
)
def test_aging_refuses(arguments, message):
    with pytest.raises(InputError, match=message):
        Aging(**arguments)


@pytest.mark.parametrize(
    ("aging", "law", "disorder", "message"),
    [
        (
            Aging("flow", 1.0),
            Delta(1.0),
            "quenched",
            r'^rule = "flow": needs thresholds of law "gamma"$',
        ),
        (
            Aging("langevin", 0.0),
            Table([1.0, 2.0]),
            "annealed",
            r'^rule = "langevin": needs',
        ),
        (
            Aging("langevin", math.inf),
            Gamma(),
            "quenched",
            r"^rate = inf: must be finite",
        ),
        (
            Aging("flow", 1.0, 1.001e3),
            Gamma(),
            "quenched",
            r"^x_star_final = 1001.0: must be within a factor 1000",
        ),
        (
            Aging("flow", 1.0, 0.999e-3),
            Gamma(),
            "annealed",
            r"^x_star_final = 0.000999",
        ),
        (
            Aging("flow", 1.0),
            Gamma(1001.0),
            "annealed",
            r"^rule: annealed contacts can age for n <= 1000; n is 1001$",
        ),
        (
            Aging("langevin", 1.0),
            Gamma(1001.0),
            "quenched",
            r'^rule: contacts of rule "langevin" can age for n',
        ),
    ],
)
def test_ensemble_refuses(aging, law, disorder, message):
    with pytest.raises(InputError, match=message):
        aging.check(law, disorder)
    with pytest.raises(InputError, match=message):
        Ensemble(law, aging=aging, disorder=disorder)


def test_what_may_age():
    """Bounds belong to what is allowed; without a rule nothing is asked."""
    for rule, rate, final, law, disorder in [
        ("none", 0.0, 1.0, Delta(1.0), "quenched"),
        ("langevin", math.inf, 1.0, Gamma(), "annealed"),
        ("flow", math.inf, 1e3, Gamma(), "quenched"),
        ("flow", 1.0, 1e-3, Gamma(1000.0), "annealed"),
        ("langevin", 1.0, 1.0, Gamma(1000.0), "quenched"),
        ("flow", 1.0, 1.0, Gamma(1e6), "quenched"),
    ]:
        Aging(rule, rate, final).check(law, disorder)


def test_alpha():
    """4 D x_*i/(v x_*f^2), and its own message beyond 1e100."""
    assert Aging("flow", 0.3, 2.0).alpha(0.5, 3.0) == pytest.approx(
        4 * 0.3 * 0.5 / (3.0 * 4.0), rel=1e-15, abs=0
    )
    assert Aging("flow", 0.0).alpha(1.0, 1.0) == Aging().alpha(1.0, 1.0) == 0.0
    assert Aging("flow", math.inf).alpha(1.0, 1.0) == math.inf
    with pytest.raises(
        InputError, match=r"^4 rate x_star / \(velocity x_star_final\^2\) = "
    ):
        Aging("flow", 1e60).alpha(1.0, 1e-60)
    with pytest.raises(InputError, match="constant velocity only"):
        reduced(Ensemble(aging=Aging("flow", 1.0), disorder="annealed"), 1.0)


# -----------------------------------------------------------------------------------------------------
# pooled law

POOLS = [
    (n, final, decay)
    for n, final in [(0.0, 10.0), (1.0, 10.0), (1.0, 0.1), (2.5, 1000.0), (0.3, 1e-3), (10.7, 3.0), (30.0, 30.0),
                     (30.0, 0.2)]
    for decay in (1e-8, 1e-3, 0.3, 1.0, 20.0, 1e4, 1e8, math.inf)
]  # fmt: skip


def ages():
    """ln s and weights of int_0^inf exp(-s) ds: 24 Gauss-Legendre nodes in each of 400
    panels of ln s."""
    nodes, weights = np.polynomial.legendre.leggauss(24)
    edges = np.linspace(-45.0, math.log(2000.0), 401)
    half = 0.5 * np.diff(edges)[:, None]
    log_s = (edges[:-1, None] + half * (1 + nodes)).ravel()
    return np.exp(log_s), (half * weights).ravel() * np.exp(log_s)


def mixture(n, final, decay, x):
    """ln J_c, ln P_c and ln cdf of the pooled law at x, x_*i = 1, from SciPy's
    incomplete gamma functions."""
    s, weight = ages()
    square = final**2 - (final**2 - 1) * (
        np.exp(-decay * s) if decay < math.inf else 0.0
    )
    with np.errstate(divide="ignore", under="ignore"):
        log_weight = np.log(weight) - s
        out = []
        for y in x:
            t = y * y / square
            log_pdf = math.log(2 / y) + (n + 1) * np.log(t) - t - math.lgamma(n + 1)
            parts = (
                np.log(special.gammaincc(n + 1, t)),
                log_pdf,
                np.log(special.gammainc(n + 1, t)),
            )
            out.append([special.logsumexp(part + log_weight) for part in parts])
    return np.array(out).T


@chosen("pool", POOLS, POOLS[::9])  # each law with another decay
def test_pooled_law(pool):
    """-ln J_c, J_c from below and P_c from e = 1e-12 to e = 500, to the documented 2e-9
    for e < 100, 3e-2 in J_c beyond, 1e-16 absolute in cdf. The mixture's own error is
    1e-12."""
    n, final, decay = pool
    law = PooledThresholds(Gamma(n, 2.0), 2.0 * final, decay)
    e = np.concatenate((np.geomspace(1e-12, 0.5, 12), np.geomspace(0.7, 500.0, 15)))
    x = law.inverse_survival(e)
    assert np.all(np.diff(x) > 0)
    log_sf, log_pdf, log_cdf = mixture(n, final, decay, x / 2.0)
    exact = np.where(e < 0.6, -np.log1p(-np.exp(np.minimum(log_cdf, -0.1))), -log_sf)
    deep, low = 3e-2 * (e > 100), 1e-16 / e
    np.testing.assert_array_less(
        np.abs(-np.log(law.sf(x)) / exact - 1)[12:], (2e-9 + deep / e)[12:]
    )
    np.testing.assert_array_less(np.abs(law.cdf(x) / -np.expm1(-exact) - 1), 2e-9 + low)
    pdf_error = np.abs(np.log(law.pdf(x)) - log_pdf + math.log(2.0))
    np.testing.assert_array_less(pdf_error, 2e-8 * np.maximum(e, 1) + deep + low)
    np.testing.assert_array_less(
        np.abs(e / exact - 1), 5e-8 * np.maximum(e, 1) + deep / e + low
    )


def test_pooled_law_in_mpmath():
    """Two points of one law to 12 digits, of all orders of magnitude in age."""
    n, final, decay = 1.5, 10.0, 3.0
    law = PooledThresholds(Gamma(n), final, decay)
    for x in (0.3, 20.0):

        def survive(s, x=x):
            square = final**2 - (final**2 - 1) * mpmath.exp(-decay * s)
            return mpmath.exp(-s) * mpmath.gammainc(
                n + 1, x * x / square, mpmath.inf, regularized=True
            )

        exact = mpmath.quad(survive, [0, 1e-3, 0.1, 1, 5, 20, 100])
        assert law.sf(x) == pytest.approx(float(exact), rel=1e-9, abs=0)


@pytest.mark.parametrize("n", [0.0, 1.0, 30.0])
def test_pooled_quantiles_far_below(n):
    """Where nobody is, too: a power of xi, as of the newborn law, without a warning."""
    law = PooledThresholds(Gamma(n), 12.0, 0.7)
    with np.errstate(all="raise"):
        x = law.inverse_survival(np.geomspace(1e-300, 511.0, 2000))
    assert np.all(np.diff(x) > 0)
    assert x[0] ** (2 * n + 2) == pytest.approx(
        x[1] ** (2 * n + 2) * (1e-300 / 511.0) ** (1 / 1999), rel=1e-9, abs=0
    )


def test_pooled_limits():
    """No aging is the newborn law, infinite decay the final one; scale and rms stay
    those of newborn contacts; the mean is the integral of J_c."""
    newborn = Gamma(1.5, 3.0)
    e = np.geomspace(1e-10, 99.0, 50)
    for decay, like in ((1e-14, newborn), (math.inf, Gamma(1.5, 12.0))):
        law = PooledThresholds(newborn, 12.0, decay)
        np.testing.assert_allclose(
            law.inverse_survival(e), like.inverse_survival(e), rtol=5e-9
        )
        assert law.mean == pytest.approx(like.mean, rel=1e-12, abs=0)
        assert (law.scale, law.rms) == (newborn.scale, newborn.rms)
    for final, decay in ((12.0, 0.7), (0.3, 20.0)):
        law = PooledThresholds(newborn, final, decay)
        total, _ = integrate.quad(
            law.sf,
            0.0,
            float(law.inverse_survival(60.0)),
            limit=500,
            epsabs=0,
            epsrel=1e-11,
        )
        assert law.mean == pytest.approx(total, rel=1e-9, abs=0)
    assert law.sf(0.0) == 1.0
    assert law.cdf(-1.0) == law.pdf(0.0) == 0.0


def draws(table, u):
    """`threshold_draw` of a smooth law for many uniforms."""
    law = Thresholds(table, NO_STEPS, 0, NO_STEPS)
    return np.array([threshold_draw(law, one) for one in u])


@pytest.mark.parametrize("case", [(0.0, 10.0, 0.3), (1.0, 0.1, 5.0)])
def test_pooled_draws(case):
    """100 000 draws from the kernel's table follow the mixture, and not one whose decay
    is 5 % off."""
    n, final, decay = case
    table = PooledThresholds(Gamma(n), final, decay).table()
    drawn = draws(table, np.random.default_rng(5).random(100_000))
    grid = np.geomspace(drawn.min(), drawn.max(), 200)  # interpolated to 3e-4

    def p_value(decay):
        cdf = -np.expm1(mixture(n, final, decay, grid)[0])
        return scipy.stats.kstest(
            drawn, lambda x: np.interp(np.log(x), np.log(grid), cdf)
        ).pvalue

    assert p_value(decay) > 1e-5
    if decay < 100:
        assert p_value(1.15 * decay) < 1e-5


@pytest.mark.parametrize("x_star", [0.01, 1.0, 300.0])
def test_pooled_table_in_any_unit(x_star):
    """The kernel's table is the quantile in units of x_*i, between its nodes too: to
    the 5e-8 of a quantile and the 1e-8 of a cubic in a cell of relative width 1/64, of
    laws that are powers at both ends. A table whose slopes are of another unit is off
    by 1e-3."""
    law = PooledThresholds(Gamma(1.0, x_star), 3.0 * x_star, 0.7)
    table, e = (
        law.table(),
        np.random.default_rng(6).permutation(np.geomspace(1e-8, 99.0, 2000)),
    )
    drawn = draws(table, np.exp(-e))
    np.testing.assert_allclose(drawn * x_star, law.inverse_survival(e), rtol=2e-7)


# -----------------------------------------------------------------------------------------------------------
# flow

# barrier, kappa = slope xi + constant
LAWS = [
    ("soft", 1.0, 0.0),
    ("soft", 0.0, 1.0),
    ("stiff", 1.0, 0.0),
    ("stiff", 0.0, 1.0),
]
NAMES = ["soft sqrt", "soft uniform", "stiff sqrt", "stiff uniform"]


def rate(case, x):
    """(omega/v) r of a contact along its path, straight from the equations."""
    (barrier, slope, constant), final2, alpha, b, log_w, xi0 = case
    xi = xi0 * np.sqrt(final2 - (final2 - 1) * np.exp(-alpha * x))
    a, gap = b * (slope * xi + constant), np.maximum(xi - x, 0.0)
    if barrier == "soft":
        return np.exp(log_w - a * gap * (xi + x))
    return np.exp(log_w - a * np.sqrt(xi * gap) * gap) * np.sqrt(gap / xi)


def hazard(case, x):
    """int_0^x of `rate`, by 20 Gauss-Legendre nodes in panels that shrink by 2^(1/4)
    towards both ends, where the rate is greatest."""
    nodes, weights = np.polynomial.legendre.leggauss(20)
    near = 0.5 * 2.0 ** (-np.arange(0, 240) / 4)
    edges = x * np.concatenate(([0.0], near[::-1], 1 - near[1:], [1.0]))
    half = 0.5 * np.diff(edges)[:, None]
    return float(
        (half * weights * rate(case, edges[:-1, None] + half * (1 + nodes))).sum()
    )


def stretch_of(case, clock):
    (barrier, slope, constant), final2, alpha, b, log_w, xi0 = case
    return path_life(
        Flow(final2, alpha),
        barrier_of(barrier, b, log_w),
        Springs(constant, slope),
        xi0,
        clock,
    )


@chosen(
    ("rho", "law"),
    itertools.product((0.05, 0.6, 1.0, 3.0, 100.0), LAWS),
    [(0.05, LAWS[0]), (3.0, LAWS[1]), (100.0, LAWS[3])],
)
def test_flow_stretch_spends_its_clock(law, rho):
    """A contact breaks where its hazard is its clock, or at its threshold with hazard
    to spare, to the documented 5e-9 and what rounding x by 1e-15 makes of the greatest
    exponent."""
    for alpha, b, log_w, xi0 in itertools.product(
        (1e-3, 1.0, 30.0, 1e6),
        (0.05, 3.0, 100.0, 1e6),
        (-5.0, 3.0, 20.0),
        (0.05, 1.0, 4.0),
    ):
        case = law, rho**2, alpha, b, log_w, xi0
        end = flow_end(Flow(rho**2, alpha), xi0)
        assert xi0 * growth(Flow(rho**2, alpha), end) == pytest.approx(
            end, rel=1e-13, abs=0
        )
        steep = (
            b * (1 + xi0 * max(rho, 1)) * (xi0 * max(1.0, rho)) ** 2 * (1 + alpha * end)
        )
        before = 0.0
        for clock in (1e-6, 1e-2, 0.7, 5.0, 50.0):
            x, spent = stretch_of(case, clock)
            assert before <= x <= end
            before = x
            found = hazard(case, x)
            if x == end:
                assert spent == pytest.approx(
                    found, rel=5e-9 + 1e-15 * steep, abs=1e-13 * clock
                )
                assert found <= clock * (1 + 5e-9 + 1e-15 * steep)
            else:
                assert spent == clock
                assert found == pytest.approx(clock, rel=5e-9 + 4e-15 * steep, abs=0)


@pytest.mark.parametrize("law", LAWS, ids=NAMES)
def test_flow_stretch_in_an_ode(law):
    """SciPy's integrator, which stops where the clock is spent or the threshold met."""
    rng = np.random.default_rng(3)
    for _ in range(12):
        rho, alpha, b = (
            10 ** rng.uniform(-1.0, 1.0),
            10 ** rng.uniform(-2.0, 2.0),
            10 ** rng.uniform(-1.5, 1.2),
        )
        case = law, rho**2, alpha, b, rng.uniform(-2.0, 6.0), rng.uniform(0.3, 2.0)
        clock = rng.exponential()

        def spent(x, y, clock=clock):
            return y[0] - clock

        def met(x, y, case=case):
            return case[5] * growth(Flow(case[1], case[2]), x) - x

        spent.terminal = met.terminal = True
        path = integrate.solve_ivp(
            lambda x, y, case=case: [rate(case, x)], (0.0, 100.0), [0.0], "DOP853",
            events=(spent, met), rtol=1e-11, atol=1e-13, max_step=0.01 * flow_end(Flow(rho**2, alpha), case[5]),
        )  # fmt: skip
        assert stretch_of(case, clock)[0] == pytest.approx(path.t[-1], rel=1e-8, abs=0)


@pytest.mark.parametrize("barrier", ["soft", "stiff"])
def test_flow_without_aging(barrier):
    """alpha = 0, and final law = newborn law: the closed forms, to 1e-9 (their table is
    good to 5e-10)."""
    for b, log_w, xi, clock in itertools.product(
        (0.01, 1.0, 50.0, 1e6), (-3.0, 2.0, 20.0), (0.1, 1.0, 3.0), (1e-5, 0.3, 4.0)
    ):
        law = barrier_of(barrier, b, log_w)
        exact = stretch(law, law.table(), xi, 1.0, clock)
        for final2, alpha in ((100.0, 0.0), (100.0, 1e-16), (1.0, 5.0), (0.01, 1e-16)):
            found, _ = path_life(Flow(final2, alpha), law, Springs(1.0, 0.0), xi, clock)
            assert found == pytest.approx(exact, rel=1e-9 + 1e-15 * b * xi * xi, abs=0)


def test_flow_without_attempts():
    """At T = 0 a contact breaks where threshold and stretch meet, and aging has become
    visible."""
    for rho, alpha, xi in itertools.product(
        (1e-3, 0.3, 1.0, 50.0, 1e3), (0.0, 1e-3, 1.0, 1e6), (1e-4, 1.0, 7.0)
    ):
        x, spent = path_life(
            Flow(rho**2, alpha), barrier_of(None), Springs(1.0, 0.0), xi, 1.0
        )
        assert spent == 0.0
        assert x == pytest.approx(
            xi * math.sqrt(rho**2 - (rho**2 - 1) * math.exp(-alpha * x)),
            rel=1e-12,
            abs=0,
        )


def test_barrier_is_that_of_the_thermal_law():
    for xi, x, a in ((2.0, 0.5, 3.0), (1e-3, 0.0, 1e5), (1.0, 1.0, 1e9)):
        assert height(barrier_of("soft"), xi, x, a) == pytest.approx(
            a * (xi**2 - x**2), rel=1e-14, abs=0
        )
        assert height(barrier_of("stiff"), xi, x, a) == pytest.approx(
            a * xi**2 * (1 - x / xi) ** 1.5, rel=1e-14, abs=0
        )


@pytest.mark.parametrize("rho", [1e-3, 0.01, 0.1, 0.5, 2.0, 10.0, 1e3])
def test_flow_work(rho):
    """int_0^x y s(y) dy to 2e-8 (cubic in cells of 1/64), where thresholds fall too,
    and lives of any length."""
    table = flow.work_table(rho**2)
    for alpha in (0.0, 1e-3, 0.1, 1.0, 10.0, 1e3, 1e6, 1e30):
        for x in np.geomspace(1e-100, 1e6, 54):
            edges = [
                0.0,
                *sorted(p / alpha for p in (0.1, 1, 3, 10, 30, 1e3) if p < alpha * x),
                x,
            ]
            exact = sum(
                integrate.quad(
                    lambda y, alpha=alpha: y * growth(Flow(rho**2, alpha), y),
                    *pair,
                    epsabs=0,
                    epsrel=1e-11,
                )[0]
                for pair in itertools.pairwise(edges)
            )
            assert work(
                Flow(rho**2, alpha), table, Springs(0.0, 1.0), 1.0, x
            ) == pytest.approx(exact, rel=2e-8, abs=0)


def test_reduced():
    """Numbers of an aging ensemble: alpha and final2; the newborn rms for the sqrt law,
    final law or not."""
    base = {
        "thresholds": Gamma(1.0, 0.1),
        "thermal": Thermal(0.01),
        "stiffness_law": "sqrt",
    }
    law = reduced(Ensemble(**base, aging=Aging("flow", 0.1, 1.0)), 2.0).aging
    assert isinstance(law, Flow)
    assert tuple(law) == (
        pytest.approx(100.0, rel=1e-15, abs=0),
        pytest.approx(0.02, rel=1e-15, abs=0),
    )
    for disorder in ("quenched", "annealed"):
        at_once = Ensemble(
            **base, aging=Aging("flow", math.inf, 1.0), disorder=disorder
        )
        final = reduced(at_once, 2.0)
        assert isinstance(final.aging, Unaged)
        assert final.springs.slope == pytest.approx(
            1.0 / math.sqrt(2.0), rel=1e-15, abs=0
        )
        assert births(at_once, 2.0).mean == pytest.approx(
            Gamma(1.0, 1.0).mean, rel=1e-12, abs=0
        )
