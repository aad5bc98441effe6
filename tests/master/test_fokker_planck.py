"""Fluctuating thresholds: the Fokker-Planck solver against tabulated values, exact
limits and a simulation.

What fails by chance: `test_simulation` alone, see there; its seeds are fixed.
"""

import itertools
import math

import numpy as np
import pytest
from cases import chosen
from reduced_cases import contacts
from rows import aging
from scipy.interpolate import CubicSpline

from eqsim import Gamma
from eqsim.master import fokker_planck
from eqsim.master.quenched import quenched_moments
from eqsim.master.survivors import survivor_moments

ROWS = list(aging("langevin").itertuples())


def numbers(n, final, mobility, stiffness, barrier, b, log_w):
    """The laws of fluctuating contacts, mobility = D/(v x_*i)."""
    s = contacts(
        Gamma(n),
        stiffness,
        barrier,
        b,
        log_w,
        final,
        4 * mobility / final**2,
        fluctuates=True,
    )
    return s.aging, s.stiffness, s.barrier


def survival(*case):
    """`survival_of_fluctuating` of `numbers`, solved anew."""
    return fokker_planck._survival.__wrapped__(*numbers(*case))


def solve(row, mobility=1.0, final=1.0):
    """`survival` of a row, with its mobility and final scale multiplied."""
    unit = row.x_star
    cold = row.kT == 0
    return survival(
        row.n,
        final * row.x_star_final / unit,
        mobility * row.rate / (row.velocity * unit),
        row.stiffness_law,
        None if cold else row.barrier,
        1.0 if cold else 0.5 * row.stiffness * unit**2 / row.kT,
        math.log(row.attempt_frequency * unit / row.velocity),
    )


def averages(row, life):
    """friction, pinned, break_stretch in the user's units, and their relative errors."""
    delay = row.velocity * row.delay / row.x_star
    stretch, work = life.stretch_error / life.stretch, life.work_error / life.work
    values = (
        row.x_star * life.work / (life.stretch + delay),
        life.stretch / (life.stretch + delay),
        row.x_star * life.stretch,
    )
    return values, (stretch + work, stretch, stretch)


@chosen(  # by default cold contacts, hot ones, and ones with a delay
    "row", ROWS, ["public-000", "public-028", "public-039"], ids=lambda row: row.id
)
def test_table(row):
    """Every row within its own accuracy and the quoted error, which is below 1e-5."""
    values, errors = averages(row, solve(row))
    for value, error, expected in zip(
        values, errors, (row.friction, row.pinned, row.break_stretch), strict=True
    ):
        assert value == pytest.approx(expected, rel=row.rel_accuracy + error, abs=0)
        assert error < 1e-5


@pytest.mark.verification
@pytest.mark.parametrize(
    ("wrong", "rows"),
    [({"mobility": 1.05}, (0, 2, 6, 7)), ({"final": 1.05}, (0, 1, 3, 5))],
    ids=["diffusion", "drift"],
)
def test_table_control(wrong, rows):
    """A diffusion or (by the final law) a drift that is 5 % off fails, in lives short
    and long, cold and warm."""
    for row in (ROWS[i] for i in rows):
        values, errors = averages(row, solve(row, **wrong))
        assert abs(values[0] / row.friction - 1) > row.rel_accuracy + errors[0]


@chosen(
    ("v", "friction"),
    [(0.01, 0.228496), (0.1, 0.462044), (1.0, 0.333598), (10.0, 0.100408)],
    [(0.01, 0.228496), (10.0, 0.100408)],
)
def test_aging(v, friction):
    """x_*i = .1, x_*f = 1, D = .1, T = 0, uniform (friction printed to six digits, that
    is to 5e-7)."""
    life = survival(1.0, 10.0, 0.1 / (0.1 * v), "uniform", None, 1.0, 0.0)
    found = 0.1 * life.work / life.stretch
    assert found == pytest.approx(
        friction, abs=5e-7 + found * (life.work_error / life.work + 1e-6)
    )


UNAGED = [
    (1.0, 3.0, ("uniform", None, 1.0, 0.0)),
    (30.0, 0.3, ("sqrt", None, 1.0, 0.0)),
    (1.0, 3.0, ("sqrt", "soft", 3.0, 10.0)),
    (0.0, 0.5, ("sqrt", "stiff", 100.0, 5.0)),
    (2.5, 1.0, ("uniform", "stiff", 0.3, -3.0)),
    (0.5, 100.0, ("uniform", "soft", 1e4, 8.0)),
]


@pytest.mark.verification
@chosen(  # by default each barrier once
    ("mobility", "case"),
    itertools.product((0.0, 1e-10), UNAGED),
    [(0.0, UNAGED[0]), (1e-10, UNAGED[2]), (0.0, UNAGED[4])],
)
def test_without_mobility(mobility, case):
    """The joint kinetic equation by quadrature, without aging. At 1e-10 the thresholds
    drift by 2e-10 xi/rho^2 per stretch, and fluctuations change rates in proportion to
    b: `slack` is several times the sum."""
    n, final, law = case
    life = survival(n, final, mobility, *law)
    exact = quenched_moments([contacts(Gamma(n), *law)])
    slack = 10 * mobility * max(law[2], math.sqrt(n + 1.0) / final**2, 1.0)
    assert (
        abs(life.stretch / exact.stretch - 1)
        < life.stretch_error / life.stretch + 1e-11 + slack
    )
    assert abs(life.work / exact.work - 1) < life.work_error / life.work + 1e-11 + slack
    inside = np.flatnonzero(life.x > 1e-6)[:-1]
    profile = survivor_moments(contacts(Gamma(n), *law), life.x[inside])[0]
    assert np.all(
        np.abs(life.values[:, inside] - profile)
        < life.errors[:, inside] + 1e-7 * profile[:, :1] + slack
    )


def test_rate_that_forgets_the_threshold():
    """Without a barrier every contact breaks at the rate omega, whatever its threshold
    does (exact): S exp(-w x)."""
    cold = survival(0.5, 4.0, 0.7, "sqrt", None, 1.0, 0.0)
    warm = survival(0.5, 4.0, 0.7, "sqrt", "soft", 1e-100, 0.5)
    exact = CubicSpline(np.log(cold.x[1:]), cold.values[:, 1:], axis=1)(
        np.log(warm.x[1:])
    )
    exact *= np.exp(-math.exp(0.5) * warm.x[1:])
    # both errors, and that of the spline
    assert np.abs(warm.values[:, 1:] - exact).max() < 2e-6


@chosen("final", [0.3, 1.0, 3.0], [0.3, 3.0])
def test_unbroken_law(final):
    """While hardly a contact has broken E[(k_i/k)^2] = <xi^2>/(n+1) = s(x)^2, the scale
    of the unbroken law (exact): n = 30, P(xi < 0.5 s) < 1e-16."""
    life = survival(30.0, final, 2.0, "sqrt", None, 1.0, 0.0)
    s2 = final**2 - (final**2 - 1) * np.exp(-8.0 * life.x / final**2)
    early = life.x < 0.5 * np.sqrt(s2)
    assert early.sum() > 50
    assert np.abs(life.values[2, early] / s2[early] - 1).max() < 1e-8
    assert np.abs(life.values[0, early] - 1).max() < 1e-8


@pytest.mark.parametrize("stiffness", ["sqrt", "uniform"])
def test_profile(stiffness):
    """S falls from 1 to nothing; its spline integrates to `stretch`, and x times the
    second to `work`."""
    life = survival(2.5, 3.0, 0.3, stiffness, "stiff", 10.0, 4.0)
    assert life.x[0] == 0.0
    assert np.all(np.diff(life.x) > 0)
    assert life.values[0, 0] == pytest.approx(1.0, abs=1e-8)
    assert np.all(np.diff(life.values[0]) < 1e-8)
    assert life.values[0, -1] < 1e-9
    if stiffness == "uniform":
        assert np.allclose(life.values[1:], life.values[0], rtol=1e-12, atol=0.0)
    log_x, x = np.log(life.x[1:]), life.x[1:]
    for values, power, total in (
        (life.values[0], 1, life.stretch),
        (life.values[1], 2, life.work),
    ):
        spline = CubicSpline(log_x, values[1:] * x**power)
        assert spline.integrate(log_x[0], log_x[-1]) == pytest.approx(
            total, rel=1e-5, abs=0
        )


def simulated(seed, contacts, steps, n, final, mobility, stiffness, barrier, b, log_w):
    """Stretch and work of contacts that are followed in small steps, shape (2,
    contacts): no equation of density.

    The threshold moves as the norm of a (2n+2)-dimensional Ornstein-Uhlenbeck process,
    exactly over a step. Contacts carry the probability that they are still pinned:
    between steps the gap is a Brownian bridge, which has met 0 with probability exp(-g
    g'/(D h)), and the thermal rate is averaged over its values at both ends.
    """
    rng = np.random.default_rng(seed)
    xi = np.sqrt(rng.gamma(n + 1.0, size=contacts))
    alive, total, x = np.ones(contacts), np.zeros((2, contacts)), 0.0

    def state():
        kappa = xi / math.sqrt(n + 1.0) if stiffness == "sqrt" else np.ones(contacts)
        gap = np.maximum(1.0 - x / xi, 0.0)
        if barrier == "soft":
            return kappa, np.exp(log_w - b * kappa * np.maximum(xi**2 - x**2, 0.0))
        if barrier == "stiff":
            return kappa, np.sqrt(gap) * np.exp(log_w - b * kappa * xi**2 * gap**1.5)
        return kappa, np.zeros(contacts)

    kappa, rate = state()
    for j in itertools.count(1):
        later = 4.0 * (j / steps) ** 2
        h = later - x
        before, gap = (alive, kappa * alive * x, rate), xi - x
        keep = math.exp(-2.0 * mobility * h / final**2)
        spread2 = 0.5 * final**2 * (1.0 - keep**2)
        along = xi * keep + math.sqrt(spread2) * rng.standard_normal(contacts)
        xi = np.sqrt(along**2 + spread2 * 2.0 * rng.gamma(n + 0.5, size=contacts))
        x = later
        new_gap = xi - x
        kappa, rate = state()
        alive = alive * np.where(
            new_gap > 0,
            -np.expm1(-gap * np.maximum(new_gap, 0.0) / (mobility * h)),
            0.0,
        )
        alive = alive * np.exp(-0.5 * h * (before[2] + rate))
        total[0] += 0.5 * h * (before[0] + alive)
        total[1] += 0.5 * h * (before[1] + kappa * alive * x)
        if alive.mean() < 1e-6:
            return total


CASES = [
    (1.0, 0.4, 0.3, "uniform", None, 1.0, 0.0),
    (1.0, 1.0, 1.0, "sqrt", None, 1.0, 0.0),
    (1.0, 1.0, 0.5, "sqrt", "soft", 3.0, 3.0),
    (0.0, 2.0, 0.2, "sqrt", "stiff", 3.0, 2.0),
    (2.5, 0.7, 0.3, "sqrt", "stiff", 1.0, 1.0),
    (0.5, 3.0, 0.1, "uniform", "stiff", 5.0, 3.0),
]


def scores(case, mobility=1.0, final=1.0):
    """z of stretch and work of a simulation, the solver being given other values by
    these factors."""
    n, rho, d, *rest = case
    total = simulated(11, 30_000, 200, *case)
    life = survival(n, final * rho, mobility * d, *rest)
    mean, stderr = total.mean(axis=1), total.std(axis=1) / math.sqrt(total.shape[1])
    return (mean - (life.stretch, life.work)) / stderr


@chosen(
    "case", CASES[2:5], [CASES[2], CASES[4]], ids=str
)  # by default each barrier once
def test_simulation(case):
    """|z| < 4.5 for 12 scores: a false alarm once in 10 000 seeds."""
    assert np.abs(scores(case)).max() < 4.5


def test_simulation_control():
    """A diffusion 5 % off fails, in either law of stiffness and with and without a
    barrier."""
    for case in (CASES[0], CASES[4]):
        assert np.abs(scores(case, mobility=1.05)).max() > 4.5


def drawn(rng):
    """Parameters of a contact, spread over what the solver is for."""
    return (
        float(rng.choice([0.0, 0.5, 1.0, 2.5, 7.0, 30.0])),
        10 ** rng.uniform(-1, 2),
        10 ** rng.uniform(-6, 4),
        str(rng.choice(["sqrt", "uniform"])),
        [None, "soft", "stiff"][rng.integers(3)],
        10 ** rng.uniform(-3, 6),
        rng.uniform(-20, 20),
    )


RNG = np.random.default_rng(2011)
DRAWN = [drawn(RNG) for _ in range(20)]


@pytest.mark.verification
@chosen("case", DRAWN, [DRAWN[0], DRAWN[3]], ids=str)  # by default a barrier and none
def test_error_estimate(case, monkeypatch):
    """Halving cells and steps changes nothing by more than the quoted errors, at any
    stretch."""
    fine = survival(*case)
    assert fine.stretch_error < 3e-5 * fine.stretch
    assert fine.work_error < 3e-5 * fine.work
    for name, factor in (("_FINEST_CELL", 2), ("_ERROR_OF_STEP", 16)):
        rough = factor * getattr(fokker_planck, name)
        monkeypatch.setattr(fokker_planck, name, rough)
    coarse = survival(*case)
    assert abs(coarse.stretch - fine.stretch) < coarse.stretch_error
    assert abs(coarse.work - fine.work) < coarse.work_error
    spline = CubicSpline(np.log(fine.x[1:]), fine.values[0, 1:])
    inside = (coarse.x > fine.x[1]) & (coarse.x < fine.x[-1])
    # 5e-5: the splines between the points of `fine`
    change = np.abs(coarse.values[0, inside] - spline(np.log(coarse.x[inside])))
    assert np.all(change < coarse.errors[0, inside] + 5e-5)


@pytest.mark.verification
@pytest.mark.parametrize(
    "case",
    [
        (1.0, 10.0, 1.0, "uniform", None, 1.0, 0.0),
        pytest.param(
            (0.0, 0.3, 30.0, "sqrt", "soft", 3.0, 3.0), marks=pytest.mark.verification
        ),
        (2.5, 2.0, 0.01, "sqrt", "stiff", 30.0, 6.0),
    ],
    ids=str,
)
def test_order(case):
    """Halving the cells divides the change by 4 (second order: 3.5 to 4.5 while cells
    are finite), halving the steps by 16 (fourth order; at least 8, as long as rounding
    does not show)."""
    life = fokker_planck._Life(*numbers(*case))
    first = fokker_planck._solve_along(life, fokker_planck._Grid(life, 0.12))

    def totals(dz, stops):
        grid = fokker_planck._Grid(life, dz)
        return fokker_planck._solve_along(life, grid, stops).totals[:, -1]

    one, two, three = (totals(dz, first.x) for dz in (0.12, 0.06, 0.03))
    assert (one - two) / (two - three) == pytest.approx(4.0, abs=0.5)
    stops, found = first.x, [one]
    for _ in range(2):
        stops = np.sort(np.append(stops, 0.5 * (stops[1:] + stops[:-1])))
        found.append(totals(0.12, stops))
    assert np.all(np.abs(found[0] - found[1]) > 8 * np.abs(found[1] - found[2]))


def test_laws_with_equal_numbers():
    """Solutions are remembered, and those of a soft and a stiff barrier of the same b
    and log_w are not the same."""
    case = Gamma(1.0), "uniform"
    soft, stiff = (
        contacts(*case, name, 3.0, 1.0, 1.0, 4.0, fluctuates=True)
        for name in ("soft", "stiff")
    )
    assert soft != stiff
    assert tuple(soft.barrier) == tuple(stiff.barrier)
    found = [fokker_planck.survival_of_fluctuating(s).stretch for s in (soft, stiff)]
    assert abs(found[0] / found[1] - 1) > 0.01
