"""Solvers of the master equations where they are hardest: laws with edges, very short
lives, steep layers."""

import itertools
import math
import warnings

import numpy as np
import pytest
import scipy.stats
from cases import chosen
from reduced_cases import barrier_of, contacts
from scipy import integrate, optimize, special

from eqsim import (
    Distribution,
    Drive,
    Ensemble,
    Gamma,
    Table,
    Thermal,
    reference,
)
from eqsim.laws.barrier import pooled
from eqsim.laws.stiffness import relative_stiffness
from eqsim.master import annealed, flow, quenched
from eqsim.master.quenched import LifeMoments
from eqsim.master.survivors import survivor_moments
from eqsim.model.reduced import reduced

LAWS = list(itertools.product(["soft", "stiff"], ["uniform", "sqrt"]))


def annealed_of(*case):
    return LifeMoments(*np.ravel(annealed.annealed_moments([contacts(*case)])[:4]))


def quenched_of(*case):
    return LifeMoments(*np.ravel(quenched.quenched_moments([contacts(*case)])[:4]))


def flowing_of(*case):
    return LifeMoments(*flow.moments_along_paths(contacts(*case)))


def exponent(barrier, x, xi, a):
    return (
        a * (xi - x) * (xi + x)
        if barrier == "soft"
        else a * xi**2 * (1 - x / xi) ** 1.5
    )


def rate(barrier, x, xi, a):
    """The bare rate of `laws.barrier`, whose integrals are closed forms there."""
    return (1.0 if barrier == "soft" else math.sqrt(1 - x / xi)) * math.exp(
        -exponent(barrier, x, xi, a)
    )


# -------------------------------------------------------------------------------------------
# annealed, laws with edges

# densities constant between edges; lengths in units of the mean, as the solvers have
# them
EDGED = {
    "above 0": ([1.0, 2.0], [1.0]),
    "from 0": ([0.0, 1.0], [1.0]),
    "gap and jumps": ([0.4, 0.8, 1.1, 1.7, 2.5], [1.0, 0.0, 1.0, 0.25]),
}


def histogram(name):
    edges, heights = np.array(EDGED[name][0]), np.array(EDGED[name][1])
    density = heights / (heights @ np.diff(edges))
    law = Distribution(scipy.stats.rv_histogram((density, edges), density=True))
    return law, edges / law.scale, density * law.scale


def plain_annealed(edges, density, rms, stiffness, barrier, b, w):
    """C and work by SciPy: an adaptive quadrature of the bare rate inside an ODE
    solver."""
    pieces = list(zip(edges[:-1], edges[1:], density, strict=True))

    def beyond(x, power):
        """E[xi^power; xi > x]."""
        return sum(
            p * (hi ** (power + 1) - max(lo, x) ** (power + 1)) / (power + 1)
            for lo, hi, p in pieces
            if hi > x
        )

    def pooled(x):
        def term(xi):
            return rate(barrier, x, xi, b * xi / rms if stiffness == "sqrt" else b)

        return sum(
            p * integrate.quad(term, max(lo, x), hi, epsabs=1e-14, epsrel=1e-11)[0]
            for lo, hi, p in pieces
            if hi > x
        )

    def slope(x, y):
        alive = math.exp(-y[0])
        stiff = beyond(x, 1) / rms if stiffness == "sqrt" else beyond(x, 0)
        return [w * pooled(x), alive * beyond(x, 0), alive * x * stiff]

    state = np.zeros(3)
    for pair in itertools.pairwise(np.unique(np.append(0.0, edges))):
        state = integrate.solve_ivp(
            slope, pair, state, "DOP853", rtol=1e-10, atol=1e-12
        ).y[:, -1]
    return state[1:]


def test_uniform_law_above_zero():
    """Thresholds even on (1, 2), kT = v = 1: C = 1.1232368 by nested adaptive
    quadrature (7 digits: 5e-8)."""
    law = Distribution(scipy.stats.uniform(1, 1))
    m = annealed_of(law, "uniform", "soft", 1.5**2 / 2, math.log(1.5))
    assert 1.5 * m.stretch == pytest.approx(1.1232368, abs=6e-8)
    assert m.stretch_error < 1e-9 * m.stretch


@chosen(
    ("law", "name"),
    itertools.product(LAWS, EDGED),
    [(LAWS[0], "above 0"), (LAWS[0], "gap and jumps"), (LAWS[3], "from 0")],
)
def test_annealed_laws_with_edges(name, law):
    """Both moments to 1e-8, the ODE solver being good to some 1e-9; a law moved by 1e-4
    is 1000 times that off."""
    (barrier, stiffness), (law, edges, density) = law, histogram(name)
    for b, w in ((1.0, 2.0), (40.0, 100.0)):
        m = annealed_of(law, stiffness, barrier, b, math.log(w))
        plain = plain_annealed(
            edges, density, law.rms / law.scale, stiffness, barrier, b, w
        )
        assert m[:2] == pytest.approx(plain, rel=1e-8, abs=0)
        assert m.stretch_error < 1e-9 * m.stretch
        assert m.work_error < 1e-9 * m.work
        more = b * 1.0001**2, math.log(w * 1.0001)
        moved = annealed_of(law, stiffness, barrier, *more)
        assert abs(1.0001 * moved.stretch / plain[0] - 1) > 1e-5


@chosen(
    ("barrier", "thresholds"),
    itertools.product(("soft", "stiff"), ([1e-6, 0.3, 2.0], [0.03, 1.0], [1e-4, 1.0])),
    [("soft", [1e-6, 0.3, 2.0]), ("stiff", [1e-4, 1.0])],
)
def test_annealed_thresholds_of_many_scales(thresholds, barrier):
    """C and work, lives from longer than the greatest threshold to shorter than the
    least, against an ODE solver that starts anew above each threshold. Each of some
    hundred intervals is solved to 1e-9, all to 1e-7; 1e-30 is nothing beside the least
    work, C^2 ~ 1e-14. What e^-60 survive adds nothing."""
    law, b = Table(thresholds), 1.5
    xi = law.steps / law.scale
    for w in 10.0 ** np.arange(-1.0, 8.0):

        def slope(x, y, w=w):
            h = np.mean([rate(barrier, x, s, b) if x < s else 0.0 for s in xi])
            alive = math.exp(-y[0]) * np.mean(xi > x)
            return [w * h, alive, x * alive]

        state = np.zeros(3)
        for low, high in itertools.pairwise(np.append(0.0, xi)):
            grid = low + np.append(
                0.0, np.geomspace(1e-9 * min(xi[0], 1 / w), high - low, 100)
            )
            for left, right in itertools.pairwise(grid):
                right = min(right, np.nextafter(high, 0.0))
                if state[0] < 60.0:
                    state = integrate.solve_ivp(
                        slope, (left, right), state, "DOP853", rtol=1e-9, atol=1e-30
                    ).y[:, -1]
        m = annealed_of(law, "uniform", barrier, b, math.log(w))
        assert m.stretch == pytest.approx(state[1], rel=1e-7, abs=0)
        assert m.work == pytest.approx(state[2], rel=1e-7, abs=0)
        assert m.stretch_error < 1e-6 * m.stretch
        assert m.work_error < 1e-6 * m.work


@pytest.mark.parametrize("b", [1e-3, 1.0, 30.0])
@pytest.mark.parametrize("n", [0.0, 1.0, 30.0])
def test_annealed_lives_much_shorter_than_any_threshold(n, b):
    """Soft, uniform: the rate of newborn contacts is omega (1 + b)^-(n+1) (nt15), so C
    is (v/omega) (1 + b)^(n+1) as long as that is small; corrections are of relative
    order b C^2 = 1e-38."""
    C = math.exp(-46.0)
    m = annealed_of(Gamma(n), "uniform", "soft", b, 46.0 + (n + 1) * math.log1p(b))
    assert m.stretch == pytest.approx(C, rel=1e-10, abs=0)
    assert m.work == pytest.approx(C**2, rel=1e-10, abs=0)


@pytest.mark.parametrize(
    "law",
    [*(histogram(name)[0] for name in EDGED), Gamma(0.0), Gamma(0.37), Gamma(1000.0)],
)
def test_annealed_attempts_without_a_barrier(law):
    """Soft, b -> 0: h = J_c, hence C = int J_c exp(-(omega/v) int J_c) dx = (v/omega)
    (1 - exp(-omega <xi>/v)) for any law (derived), within the quoted error and a
    rounding of 1e-13."""
    mean = law.mean / law.scale
    for w in (1e-3, 1.0, 30.0):
        for stiffness in ("uniform", "sqrt"):
            m = annealed_of(law, stiffness, "soft", 1e-15, math.log(w))
            assert (
                abs(m.stretch + math.expm1(-w * mean) / w)
                < m.stretch_error + 1e-13 * m.stretch
            )
            assert m.stretch_error < 1e-9 * m.stretch
        wrong = annealed_of(law, "uniform", "stiff", 1e-15, math.log(w))
        assert abs(wrong.stretch + math.expm1(-w * mean) / w) > 1e3 * m.stretch_error


SMOOTH = [Gamma(0.0), Gamma(0.37), Gamma(1.0), Gamma(30.0), Gamma(1000.0)]
OTHERS = [
    histogram("above 0")[0],
    Distribution(scipy.stats.beta(1.3, 2.7, loc=1)),
    Distribution(scipy.stats.lognorm(1)),
]


def scan(laws, seed):
    """Random b from 1e-3 to 1e9 and log_w from -50 to 50 for each law, barrier and
    stiffness."""
    rng = np.random.default_rng(seed)
    for law, (barrier, stiffness) in itertools.product(laws, LAWS):
        yield law, stiffness, barrier, 10 ** rng.uniform(-3, 9), rng.uniform(-50, 50)


def covered(law, m, exact):
    """Errors cover the difference; they are below 1e-9 except for laws whose density
    has no power series at an end."""
    for value, error, true in zip(m[:2], m[2:4], exact[:2], strict=True):
        assert 0 < error < (1e-9 if law is not OTHERS[1] else 1e-6) * value
        assert abs(value - true) < error


def test_annealed_errors_cover_a_refined_result(monkeypatch):
    """The quoted errors, always below 1e-9, against twice as many panels, of x and of
    the rate, with more nodes."""
    cases = list(scan(SMOOTH + OTHERS, 1))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = [annealed_of(*case) for case in cases]
    between = np.sqrt(pooled._EXPONENTS[1:] * pooled._EXPONENTS[:-1])
    finer = {
        "_EXPONENTS": np.sort(np.append(pooled._EXPONENTS, between)),
        "_NEAR_ENDS": 10.0 ** np.arange(-13.0, 0.0, 0.5),
        "_UNSEEN_ATTEMPTS": -60.0,
        "_ORDER": 24,
        "_TRAPEZOID_STEP": 0.04,
    }
    for name, value in finer.items():
        monkeypatch.setattr(pooled, name, value)
    monkeypatch.setattr(annealed, "_RISE_IN_X", 2.2)
    monkeypatch.setattr(annealed, "_RESOLVED_IN_X", 5e-13)
    for case, m in zip(cases, found, strict=True):
        covered(case[0], m, annealed_of(*case))


# ----------------------------------------------------------------------------------------------
# quenched, short lives


@pytest.mark.parametrize("barrier", ["soft", "stiff"])
@pytest.mark.parametrize("stiffness", ["uniform", "sqrt"])
def test_quenched_lives_much_shorter_than_any_threshold(barrier, stiffness):
    """Every contact breaks at the rate of a newborn one: C = (v/omega)
    E[exp(barrier/kT)] by quadrature over xi, work = E[(k_i/k) exp(2 barrier/kT)]
    (v/omega)^2, both barriers alike; corrections are of the order of C. To the quoted
    1e-11 and the quadrature's 1e-12; another n fails."""
    law = Gamma(1.0)
    for b, log_w in ((1e-3, 50.0), (1e-3, 40.0), (0.02, 45.0)):
        m = quenched_of(law, stiffness, barrier, b, log_w)

        def mean(power, b=b):
            def term(xi):
                kappa = float(relative_stiffness(stiffness, xi, law.rms))
                return (
                    float(law.pdf(xi))
                    * kappa ** (power - 1)
                    * math.exp(power * b * kappa * xi**2)
                )

            return (
                integrate.quad(term, 0, 4, epsabs=0, epsrel=1e-13)[0]
                + integrate.quad(term, 4, 12, epsabs=0)[0]
            )

        assert m.stretch == pytest.approx(math.exp(-log_w) * mean(1), rel=2e-11, abs=0)
        assert m.work == pytest.approx(math.exp(-2 * log_w) * mean(2), rel=2e-11, abs=0)
        wrong = quenched_of(Gamma(1.01), stiffness, barrier, b, log_w)
        assert wrong.stretch != pytest.approx(m.stretch, rel=1e-6, abs=0)


def test_heavy_tailed_short_lives():
    """Stiff, uniform, b = 1, log_w = 50: C = 2.2494e-19 (five digits)."""
    found = quenched_of(Gamma(1.0), "uniform", "stiff", 1.0, 50.0)
    assert found.stretch == pytest.approx(2.2494e-19, rel=3e-5, abs=0)


@chosen("n", [0.0, 0.37, 1.0, 30.0], [0.0, 30.0])
def test_quenched_errors_cover_another_solver(n):
    """Against the solver for aging contacts, without aging: it has the bare rate and
    panels of its own."""
    law = Gamma(n)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = [(*case, quenched_of(*case)) for case in scan([law] * 4, 2)]
    for law, stiffness, barrier, b, log_w, m in found:
        other = flowing_of(law, stiffness, barrier, b, log_w, 1.0, 1.0)
        assert 0 < m.stretch_error < 1e-9 * m.stretch
        assert 0 < m.work_error < 1e-9 * m.work
        assert abs(m.stretch - other.stretch) < m.stretch_error + other.stretch_error
        assert abs(m.work - other.work) < m.work_error + other.work_error


def test_quenched_errors_cover_a_refined_result(monkeypatch):
    """The quoted errors against a start from a hundred panels; chance agreement of two
    rules has no say in them."""
    cases = [*scan(SMOOTH + OTHERS, 3), (Gamma(1.0), "uniform", "soft", 1e3, 50.0)]
    found = [quenched_of(*case) for case in cases]
    monkeypatch.setattr(quenched, "BIRTHS", np.linspace(-34.7, 6.2, 101))
    monkeypatch.setattr(quenched, "CONVERGED", 1e-13)
    for case, m in zip(cases, found, strict=True):
        covered(case[0], m, quenched_of(*case))


def test_levels_are_where_the_hazard_says():
    """Stiff: (omega/v) H at the stretches of `stretch_at` is exp(level) to 1e-12
    however short the lives."""
    xi, log_w, levels = np.array([0.1, 1.0, 3.0]), 50.0, np.arange(-24.0, 5.0, 2.0)
    for b in (1e-3, 1.0, 1e3):
        a = np.full(3, b)
        stiff = barrier_of("stiff", 1.0, log_w)
        x = stiff.stretch_at(levels, xi, a)
        inside = x < xi[:, None]
        reached = (
            stiff.log_hazard(np.minimum(x, 0.999999 * xi[:, None]), xi[:, None], b)
            + log_w
        )
        far = inside & (x < 0.9 * xi[:, None])
        np.testing.assert_allclose(
            reached[far],
            np.broadcast_to(levels, x.shape)[far],
            rtol=0,
            atol=1e-10,
        )


# ------------------------------------------------------------------------------------------------
# quenched, survivors


@chosen(
    ("barrier", "stiffness", "law"),
    [(*kind, law) for kind in LAWS for law in (Gamma(0.0), Gamma(1.0))],
    [(*LAWS[0], Gamma(0.0)), (*LAWS[3], Gamma(1.0))],
)
def test_survivors(law, barrier, stiffness):
    """S, E[k] and E[k^2] against adaptive quadrature over thresholds, cut where S
    passes 1/2, to 1e-10 of their values at 0. A temperature 1e-4 off shows."""
    rms, laws = law.rms, (stiffness, barrier)

    def hazard(b, log_w, x, xi):
        """ln((omega/v) H(x)) through the bare rate at its end: closed forms written
        anew."""
        a = b * float(relative_stiffness(stiffness, xi, rms))
        if barrier == "soft":
            return (
                log_w
                - exponent("soft", x, xi, a)
                + math.log(special.dawsn(math.sqrt(a) * x) / math.sqrt(a))
            )
        most, least = exponent("stiff", 0.0, xi, a), exponent("stiff", x, xi, a)
        spent = -most * math.expm1(1.5 * math.log1p(-x / xi))
        return (
            log_w + math.log(2 / (3 * a * xi)) - least + math.log(-math.expm1(-spent))
        )

    worst = 0.0
    for b, log_w, x in (
        (1e3, 10.0, 0.0338),
        (1.0, 10.0, 0.05),
        (1.0, 10.0, 1e-6),
        (30.0, 4.0, 0.6),
        (1e6, 30.0, 0.2),
    ):
        near = [contacts(law, *laws, f * b, log_w) for f in (1.0, 1.0001)]
        found, off = (survivor_moments(s, np.array([x]))[0] for s in near)
        depth = np.geomspace(1e-12, 8.0, 241)
        drop = [hazard(b, log_w, x, x + d) > -0.37 for d in depth]
        middle = 0.0
        if drop[0] and not drop[-1]:
            bracket = depth[drop.index(False) - 1], depth[drop.index(False)]
            middle = optimize.brentq(
                lambda d, b=b, w=log_w, x=x: hazard(b, w, x, x + d) + 0.37,
                *bracket,
                xtol=1e-15,
            )
        edges = x + np.unique(np.concatenate(([0.0, middle], depth[::6])))
        for power in range(3):

            def term(xi, b=b, log_w=log_w, x=x, power=power):
                if xi <= x:
                    return 0.0
                alive = math.exp(-math.exp(min(hazard(b, log_w, x, xi), 7.0)))
                return (
                    float(law.pdf(xi))
                    * alive
                    * float(relative_stiffness(stiffness, xi, rms)) ** power
                )

            plain = sum(
                integrate.quad(term, *pair, epsabs=1e-13)[0]
                for pair in itertools.pairwise(edges)
            )
            assert found[power][0] == pytest.approx(plain, abs=1e-10)
            worst = max(worst, abs(off[power][0] - plain))
    assert worst > 1e-8


# ----------------------------------------------------------------------------------------------------
# barely a moment


@pytest.mark.parametrize("a", [3.02, 3.05, 3.5])
@pytest.mark.parametrize("barrier", [None, "soft"])
def test_moments_that_hardly_exist(a, barrier):
    """Pareto's law, J_c = x^-a, sqrt law: work = <xi^3>/(2 xi_rms) at T = 0 (exact), of
    which 4 % are beyond any table of thresholds if a = 3.02. Heat and annealing that
    hardly break a contact change less than 1e-9 of it."""
    law = Distribution(scipy.stats.pareto(a))
    exact = a / (a - 3) / (2 * law.rms) / law.scale**2
    found = quenched_of(law, "sqrt", barrier, 1.0, -30.0)
    assert abs(found.work / exact - 1) < 1e-9
    assert abs(found.stretch - 1) < 1e-9
    assert (found.work_error > 0.02 * exact) == (a == 3.02)
    if barrier is not None:
        pooled = annealed_of(law, "sqrt", barrier, 1.0, -60.0)
        assert abs(pooled.work / exact - 1) < 1e-9 + pooled.work_error / exact
        assert pooled.work_error < 0.1 * exact


# ---- layers of heat that are far narrower than thresholds are apart

NARROW = 5e7  # k x_*^2/(2 kT), lengths in x_*


def _log_hazard_below(barrier, left, xi):
    """ln of int_0^x r dx', x = xi (1 - left), but for what is negligible at such a
    temperature: closed forms, written anew."""
    if barrier == "stiff":
        return -NARROW * xi**2 * left**1.5 - np.log(1.5 * NARROW * xi)
    return -NARROW * xi**2 * left**2 - np.log(2.0 * NARROW * xi)  # cusp


def _annealed(law, barrier, attempts):
    heat = Thermal(kT=0.5 / NARROW, attempt_frequency=attempts, barrier=barrier)
    return Ensemble(law, heat, disorder="annealed", stiffness_law="uniform")


@pytest.mark.parametrize("barrier", ["stiff", "cusp"])
def test_layers_below_thresholds_of_a_table(barrier):
    """Annealed contacts with thresholds 1 and 2 break by heat just below these. Their
    mean stretch then is int J exp(-Lambda) dx, by the trapezoidal rule in ln of the
    distance to each (1e-9 by halving its steps)."""
    w = 1e7
    ensemble = _annealed(Table([1.0, 2.0]), barrier, w)
    pooled = annealed.pooled_polynomials(reduced(ensemble, 1.0))
    gap = np.append(np.geomspace(1.0, 1e-9, 40_001), 0.0)
    passed, travel = 0.0, 0.0
    for xi, share in ((1.0, 1.0), (2.0, 0.5)):
        x = xi - gap
        hazard = passed + 0.5 * w * np.exp(_log_hazard_below(barrier, gap / xi, xi))
        travel += share * np.trapezoid(np.exp(-hazard), x)
        # panels resolve it to 1e-9 where it is below 1
        np.testing.assert_allclose(
            pooled.integral(x / ensemble.thresholds.scale), hazard, rtol=1e-8, atol=1e-9
        )
        passed = hazard[-1]
    assert travel < 1.49  # without heat it is 1.5
    found = reference(ensemble, Drive(1.0)).break_stretch
    assert abs(found.value - travel) < 1e-8 + found.stderr


def test_a_layer_below_an_infinite_density():
    """Pooled hazards of annealed contacts of a law that begins with an infinite
    density, by the midpoint rule in the angle in which it is even: they break within
    3e-5 below it, and what is beyond, where rates are not known as well, must not keep
    that from being resolved."""
    law = Distribution(scipy.stats.beta(0.5, 0.5, loc=1.0))
    w = 1e15
    pooled = annealed.pooled_polynomials(reduced(_annealed(law, "stiff", w), 1.0))
    angle = (np.arange(200_000) + 0.5) * 1e-7  # of pi/2; beyond .02 nothing counts
    xi = 1.0 + np.sin(0.5 * np.pi * angle) ** 2
    x = 1.0 - np.linspace(2e-5, 4e-5, 21)
    left = 1.0 - x[:, None] / xi
    hazard = 1e-7 * w * np.exp(_log_hazard_below("stiff", left, xi)).sum(axis=1)
    assert hazard[0] > 1.0 > hazard[-1]
    # numbers next to 1 miss as much of such a density as is within some 1e-15 of 1:
    # (1e-15/3e-5)^(1/2) = 6e-6 of those that break in a layer of 3e-5
    np.testing.assert_allclose(
        pooled.integral(x / law.scale), hazard, rtol=2e-5, atol=0
    )
