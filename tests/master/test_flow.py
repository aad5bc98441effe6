"""Flow aging of quenched contacts: closed forms, limits, given rows, a plain ODE of
single contacts, its own errors."""

import itertools
import math
import warnings

import numpy as np
import pytest
from cases import chosen
from reduced_cases import barrier_of, contacts
from rows import aging
from scipy import integrate, optimize
from scipy.interpolate import CubicSpline

from eqsim import Aging, Drive, Ensemble, Pareto, Thermal, reference
from eqsim.laws.threshold import Gamma
from eqsim.master import flow, quenched
from eqsim.master.quenched import LifeMoments
from eqsim.master.survivors import survivor_moments

ROWS = aging("flow")
LAW = Gamma(1.0)
COLD = (None, math.inf, -math.inf)
LAWS = list(itertools.product(["soft", "stiff"], ["uniform", "sqrt"]))


def at(row, alpha_factor=1.0):
    """friction, pinned and break_stretch of a row in its own units."""
    unit, final = row.x_star, row.x_star_final / row.x_star
    b = row.stiffness * unit**2 / (2 * row.kT)
    alpha = alpha_factor * 4 * row.rate * unit / (row.velocity * row.x_star_final**2)
    log_w = math.log(row.attempt_frequency * unit / row.velocity)
    m = aged_of(
        Gamma(row.n, unit), row.stiffness_law, row.barrier, b, log_w, final, alpha
    )
    cycle = unit * m.stretch + row.velocity * row.delay
    return unit**2 * m.work / cycle, unit * m.stretch / cycle, unit * m.stretch


def aged_of(*case):
    return LifeMoments(*flow.moments_along_paths(contacts(*case)))


def still_of(*case):
    return LifeMoments(*np.ravel(quenched.quenched_moments([contacts(*case)])[:4]))


@pytest.mark.parametrize("row", list(ROWS.itertuples()), ids=lambda row: row.id)
def test_table(row):
    """Every row to 2e-7: its own accuracy is 1e-7, its figures are printed to 9 digits."""
    assert at(row) == pytest.approx(
        (row.friction, row.pinned, row.break_stretch), rel=2e-7, abs=0
    )


@pytest.mark.parametrize("row", list(ROWS.itertuples()), ids=lambda row: row.id)
def test_table_rejects_a_wrong_rate(row):
    """Aging 1 % faster moves friction by more than 20 times what the table is tested
    to."""
    assert abs(at(row, 1.01)[0] / row.friction - 1) > 4e-6


@pytest.mark.parametrize(
    ("v", "value"),
    [(0.01, 0.752253), (0.1, 0.751955), (1.0, 0.463275), (10.0, 0.108048)],
)
def test_zero_temperature(v, value):
    """x_*i = .1, x_*f = 1, D = .1: the six printed digits; S(x) = J_ci(x/s(x)); its
    integral is C."""
    alpha = 4 * 0.1 * 0.1 / v
    m = aged_of(LAW, "uniform", *COLD, 10.0, alpha)
    assert 0.1 * m.work / m.stretch == pytest.approx(value, abs=6e-7)
    x = np.geomspace(1e-15, 70.0, 2500)
    s = np.sqrt(100 - 99 * np.exp(-alpha * x))
    cold = contacts(LAW, "uniform", *COLD, 10.0, alpha)
    survive, k1, k2 = survivor_moments(cold, x)[0]
    np.testing.assert_allclose(survive, LAW.sf(x / s), rtol=0, atol=1e-8)
    assert np.array_equal(survive, k1)
    assert np.array_equal(survive, k2)
    total = integrate.quad(
        lambda x: LAW.sf(x / math.sqrt(100 - 99 * math.exp(-alpha * x))),
        0,
        70,
        limit=500,
        epsabs=0,
    )
    assert m.stretch == pytest.approx(total[0], rel=1e-9, abs=0)


@chosen(
    ("final", "law"),
    itertools.product((0.3, 10.0), LAWS),
    [(0.3, LAWS[0]), (10.0, LAWS[3])],
)
def test_limits_of_slow_and_fast_aging(law, final):
    """alpha -> 0 is no aging. alpha -> inf is the law of x_*f from birth on: lengths
    scale by rho, b by rho^2 and, as the sqrt law's rms stays that of the newborn, k_i
    by rho once more. The corrections are of order alpha (rho^2 - 1) = 1e-11 and 1/alpha
    = 1e-16, the shortest lives 1e-6."""
    barrier, stiffness = law
    for b, log_w in itertools.product((0.1, 30.0, 1e5), (-3.0, 3.0, 12.0)):
        still = still_of(LAW, stiffness, barrier, b, log_w)
        slow = aged_of(LAW, stiffness, barrier, b, log_w, final, 1e-13)
        assert slow[:2] == pytest.approx(still[:2], rel=1e-9, abs=0)
        more = final if stiffness == "sqrt" else 1.0
        aged = still_of(
            LAW, stiffness, barrier, b * final**2 * more, log_w + math.log(final)
        )
        fast = aged_of(LAW, stiffness, barrier, b, log_w, final, 1e16)
        assert fast.stretch == pytest.approx(final * aged.stretch, rel=1e-9, abs=0)
        assert fast.work == pytest.approx(final**2 * more * aged.work, rel=1e-9, abs=0)


def contact(stiffness, barrier, b, log_w, final, alpha, xi0, frozen=False):
    """int S dx and int kappa x S dx of one contact: the bare rate, an ODE solver,
    nothing of eqsim. `frozen`, wrongly, holds the stiffness at birth."""

    def s(x):
        return math.sqrt(final**2 - (final**2 - 1) * math.exp(-alpha * x))

    def slope(x, y):
        xi = max(xi0 * s(x), x)
        kappa = (xi0 if frozen else xi) / math.sqrt(2.0) if stiffness == "sqrt" else 1.0
        if barrier == "soft":
            rate = math.exp(log_w - kappa * b * (xi**2 - x**2))
        else:
            gap = 1 - x / xi
            rate = math.sqrt(gap) * math.exp(log_w - kappa * b * xi**2 * gap**1.5)
        alive = math.exp(-y[0])
        return [rate, alive, kappa * x * alive]

    end = optimize.brentq(
        lambda x: xi0 * s(x) - x, 0, 1.01 * xi0 * max(final, 1), xtol=1e-15
    )
    return integrate.solve_ivp(
        slope, (0, end), [0, 0, 0], "DOP853", rtol=1e-10, atol=1e-13, max_step=end / 100
    ).y[1:, -1]


@pytest.mark.parametrize(("barrier", "stiffness"), LAWS)
def test_single_contacts(barrier, stiffness):
    """Paths to 1e-8 (the ODE solver's own accuracy is some 1e-9); a stiffness or rate 1
    % off is 1000 times that."""
    xi0 = np.array([0.4, 1.5])
    for b, log_w, final, alpha in [
        (1.0, 1.0, 3.0, 0.7),
        (8.0, 3.0, 0.4, 2.0),
        (0.3, 3.0, 10.0, 20.0),
        (2.0, -1.0, 1, 1),
    ]:
        moments, errors = flow.path_moments(
            contacts(LAW, stiffness, barrier, b, log_w, final, alpha), xi0
        )
        plain = np.transpose(
            [
                contact(stiffness, barrier, b, log_w, final, alpha, float(xi))
                for xi in xi0
            ]
        )
        np.testing.assert_allclose(moments, plain, rtol=1e-8)
        assert np.all(errors < 1e-9 * moments)
        more_b, more_alpha = (1.01, 1.0) if final == 1 else (1.0, 1.01)
        off = contacts(
            LAW, stiffness, barrier, more_b * b, log_w, final, more_alpha * alpha
        )
        assert np.all(
            np.abs(flow.path_moments(off, xi0)[0] / plain - 1).max(axis=1) > 1e-5
        )


@pytest.mark.parametrize("barrier", ["soft", "stiff"])
def test_single_contacts_reject_stiffness_frozen_at_birth(barrier):
    """With the sqrt law k_i follows the current threshold; thresholds that grow
    threefold show it beyond any error."""
    case = ("sqrt", barrier, 1.0, 1.0, 3.0, 0.7)
    moments, _ = flow.path_moments(contacts(LAW, *case), np.array([1.5]))
    assert np.all(np.abs(contact(*case, 1.5, frozen=True) / moments[:, 0] - 1) > 0.01)


WIDE = list(
    itertools.product(
        ["uniform", "sqrt"],
        ["soft", "stiff"],
        [1e-3, 1.0, 1e9],
        [-50.0, 0.0, 50.0],
        [0.01, 30.0],
        [1e-12, 1.0, 1e12],
    )
)


def test_ends_of_the_ranges():
    """No warning, finite values, errors below 1e-9, over 24 decades of v, b, alpha, and
    both signs of aging."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for stiffness, barrier, b, log_w, final, alpha in WIDE[::5]:
            m = aged_of(LAW, stiffness, barrier, b, log_w, final, alpha)
            assert np.all(np.isfinite(m[:4]))
            assert 0 < m.stretch <= (1 + 1e-9) * max(final, 1.0) * LAW.mean
            assert 0 < m.stretch_error < 1e-9 * m.stretch
            assert 0 < m.work_error < 1e-9 * m.work


@pytest.mark.verification
def test_errors_cover_a_refined_result(monkeypatch):
    """The quoted error against the difference from panels resolved a thousand times
    better (to rounding, 2e-14)."""
    cases = [(*case, m) for case in WIDE[::11] for m in [aged_of(LAW, *case)]]
    monkeypatch.setattr(flow, "_RESOLVED_PATH", 1e-14)
    monkeypatch.setattr(flow, "_CONVERGED_BIRTHS", 1e-14)
    monkeypatch.setattr(quenched, "BIRTHS", np.linspace(-34.7, 6.2, 60))
    monkeypatch.setattr(flow, "_SHORTEST_STRETCH", 64.0**-25)
    for *case, m in cases:
        fine = aged_of(LAW, *case)
        assert abs(m.stretch - fine.stretch) < m.stretch_error + 2e-14 * m.stretch
        assert abs(m.work - fine.work) < m.work_error + 2e-14 * m.work


AGED = [(0.3, 2.0, 1.0), (30.0, 12.0, 0.1), (1e8, 10.0, 1e3)]  # b, ln w, D


@pytest.mark.verification
@chosen(
    ("final", "law", "aged"),
    itertools.product((0.5, 10.0), LAWS, AGED),
    [(0.5, LAWS[3], AGED[0]), (0.5, LAWS[3], AGED[2])],
)
def test_survivors(final, law, aged):
    """Splined in ln x they integrate to the stationary moments: two methods that share
    the rate alone. Without aging they are those of a contact whose hazard has a closed
    form."""
    barrier, stiffness = law
    x = np.exp(
        np.arange(math.log(7.5 * max(1.0, final)), math.log(1e-15), -0.015)[::-1]
    )
    b, log_w, alpha = aged
    case = LAW, stiffness, barrier, b, log_w, final, alpha
    values, m = survivor_moments(contacts(*case), x)[0], aged_of(*case)
    for power, moment in enumerate((m.stretch, m.work)):
        total = CubicSpline(np.log(x), values[power] * x ** (power + 1)).integrate(
            math.log(x[0]), math.log(x[-1])
        )
        # 1e-8 of each value, and of a cubic spline with this step 2e-8
        assert total == pytest.approx(moment, rel=3e-8, abs=0)
    assert np.all(np.diff(values[0]) < 1e-8)
    assert values[0][0] == pytest.approx(1.0, abs=1e-8)


@pytest.mark.parametrize("barrier", ["soft", "stiff"])
def test_survivors_without_aging(barrier):
    """S, E[k] and E[k^2] at some x against plain quadrature over births of the closed
    form, to 1e-8."""
    x = np.array([1e-3, 0.03, 0.3, 1.0, 2.5])
    slow = contacts(LAW, "sqrt", barrier, 40.0, 8.0, 2.0, 1e-14)
    found = survivor_moments(slow, x)[0]
    for j, xj in enumerate(x):
        for power in range(3):

            def term(xi, xj=xj, power=power):
                heat, kappa = barrier_of(barrier, 40.0, 8.0), xi / LAW.rms
                at = np.array([xj]), np.array([xi]), np.array([heat.b * kappa])
                hazard = float(np.exp(heat.log_hazard(*at) + heat.log_w)[0])
                return float(LAW.pdf(xi)) * math.exp(-hazard) * kappa**power

            edges = xj + np.append(0.0, np.geomspace(1e-4, 7.0, 60))
            plain = sum(
                integrate.quad(term, low, high, epsabs=1e-13)[0]
                for low, high in itertools.pairwise(edges)
            )
            assert found[power][j] == pytest.approx(plain, abs=1e-8)


@pytest.mark.verification
def test_rare_bonds_that_break_at_once():
    """Bonds that age as ln t and pull harder the stronger they are: the rarest ones of
    a power law live too short a time to be resolved, and what they add to the error is
    no more than they would live without heat: 1e-10 of C, as a law says that ends where
    one in 1e26 is left."""
    heat = Thermal(barrier="bell", off_rate=4e-12, force_scale=0.15)
    aging = Aging("logarithmic", beta=0.19, cutoff_time=0.18)
    bonds = Ensemble(Pareto(5.0), heat, aging=aging)
    found = reference(bonds, Drive(0.2)).friction
    assert found.stderr < 1e-9 * found.value
    assert found.value == pytest.approx(1.1102489614891378, rel=1e-9, abs=0)
