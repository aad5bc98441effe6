"""Lives as the kernels draw them, many side by side, against a plain twin: one contact
at a time, NumPy's generator, libm, and an equation solved by SciPy. And many contacts
side by side against the same contacts one by one."""

import itertools
import math

import numpy as np
import pytest
import scipy.stats
from cases import chosen
from scipy import optimize, special

from eqsim import (
    Aging,
    Delay,
    Delta,
    Distribution,
    Drive,
    Ensemble,
    Gamma,
    InputError,
    Table,
    Thermal,
    steady,
)
from eqsim.engine.blocks import Totals
from eqsim.engine.contacts import contacts
from eqsim.engine.lanes import LANES, ROUNDS, follow, idle_lanes
from eqsim.engine.langevin import STEP
from eqsim.engine.programme import constant_drive
from eqsim.engine.randomise import PlainSums
from eqsim.engine.recorder import Run, Scales, moments
from eqsim.engine.sample import Source, lives
from eqsim.engine.stationary import stationary
from eqsim.estimate import difference
from eqsim.numerics.streams import STEADY, TRAJECTORY, key
from eqsim.numerics.threads import NEVER

V = 0.1
UNIFORM = {"stiffness_law": "uniform"}
STARTS = ("fresh", "stationary")
POINTS = (2, 11, 501)


def hazard(barrier, x, xi, a):
    """Integrated hazard per attempt frequency and velocity."""
    if barrier == "soft":
        return (
            np.exp(-a * (xi * xi - x * x))
            * special.dawsn(math.sqrt(a) * x)
            / math.sqrt(a)
        )
    c = a * xi * xi
    return 2 / (3 * a * xi) * (math.exp(-c * (1 - x / xi) ** 1.5) - math.exp(-c))


def twin(rng, n, kT, barrier, law):
    """Stretch at breaking and work over k of one contact, omega = x_* = k = 1."""
    xi = math.sqrt(rng.gamma(n + 1.0))
    stiffness = xi / math.sqrt(n + 1.0) if law == "sqrt" else 1.0
    x, clock = xi, V * rng.exponential() if kT else math.inf
    if kT and hazard(barrier, xi, xi, stiffness / (2 * kT)) > clock:
        x = optimize.brentq(
            lambda x: hazard(barrier, x, xi, stiffness / (2 * kT)) - clock,
            0.0,
            xi,
            xtol=1e-12,
        )
    return x, 0.5 * stiffness * x * x


def side_by_side(ensemble, seed, ages=8):
    """Sums of stretch and work over the lives of a kernel's lanes, one for each age,
    shape (2, sums)."""
    c, rows = contacts(ensemble, V), []
    for age in range(ages):
        sums = PlainSums.empty(0, age, age + 1, NEVER)
        follow(c, sums, 0, LANES, *idle_lanes(c, key(seed, STEADY)))
        rows.append((sums.travel.sum(), sums.work.sum()))
    return np.array(rows).T


@pytest.mark.verification
@pytest.mark.parametrize("n", [0.0, 1.0, 2.0])
@pytest.mark.parametrize(
    ("kT", "barrier"), [(0.0, "soft"), (0.3, "soft"), (0.3, "stiff")]
)
@pytest.mark.parametrize("law", ["uniform", "sqrt"])
def test_lives_have_the_law_of_the_twin(n, kT, barrier, law):
    """Means of x, of the work and of both squares, 4096 lives against 2000 of the twin:
    54 scores, |z| < 4.5: 4e-4."""
    rng = np.random.default_rng(8)
    theirs = np.array([twin(rng, n, kT, barrier, law) for _ in range(2000)]).T
    per_age = LANES * ROUNDS
    ours = side_by_side(
        Ensemble(Gamma(n), Thermal(kT, 1.0, barrier), stiffness_law=law), 21, ages=100
    )
    for mine, other in zip(ours, theirs, strict=True):
        error = math.hypot(
            mine.std(ddof=1) / per_age / 10, other.std(ddof=1) / math.sqrt(other.size)
        )
        assert abs(mine.mean() / per_age - other.mean()) < 4.5 * error
        # the scatter of sums of independent lives is that of a life: also says that
        # lanes and ages are independent
        ratio = mine.var(ddof=1) / per_age / other.var(ddof=1)
        kurtosis = scipy.stats.kurtosis(other, fisher=False)
        assert abs(ratio - 1) < 4.5 * math.sqrt(2 / 99 + (kurtosis - 1) / other.size)


def test_another_law_fails():
    """Negative control: n = 0 does not pass for n = 0.5, nor kT = 0.3 for 0.1."""
    rng = np.random.default_rng(8)
    for n, kT in ((0.5, 0.3), (0.0, 0.1)):
        theirs = np.array([twin(rng, n, kT, "soft", "sqrt")[0] for _ in range(4000)])
        mine = side_by_side(Ensemble(Gamma(0.0), Thermal(0.3)), 21, ages=100)[0] / (
            LANES * ROUNDS
        )
        error = math.hypot(
            mine.std(ddof=1) / 10, theirs.std(ddof=1) / math.sqrt(theirs.size)
        )
        assert abs(mine.mean() - theirs.mean()) > 4.5 * error


def test_direct_draws_have_the_law_of_the_table():
    """Gamma thresholds drawn directly (n = 0, 1) and through the table of the same law
    under another name: all of 2e5 stretches at T = 0 from sums of 512 lives, means and
    variances."""
    for n in (0.0, 1.0):
        named = Distribution(scipy.stats.nakagami(n + 1, scale=math.sqrt(n + 1)))
        assert contacts(Ensemble(Gamma(n)), V).thresholds.exponentials == n + 1
        assert contacts(Ensemble(named), V).thresholds.exponentials == 0
        direct = side_by_side(Ensemble(Gamma(n), **UNIFORM), 5, ages=400)
        table = side_by_side(Ensemble(named, **UNIFORM), 6, ages=400) * np.array(
            [[named.scale], [named.scale**2]]
        )
        for mine, other in zip(direct, table, strict=True):
            error = math.hypot(mine.std(ddof=1), other.std(ddof=1)) / 20
            assert abs(mine.mean() - other.mean()) < 4.5 * error
            assert abs(mine.var() / other.var() - 1) < 4.5 * math.sqrt(4 / 399)


CASES = [
    Ensemble(**UNIFORM),
    Ensemble(),
    Ensemble(delay=Delay(2.0), **UNIFORM),
    Ensemble(thermal=Thermal(0.1), delay=Delay(2.0)),
    Ensemble(
        Gamma(0.0), Thermal(0.3, 1.0, "stiff"), Delay(2.0, "exponential"), **UNIFORM
    ),
    Ensemble(Gamma(2.5), Thermal(0.3, 1.0, "stiff"), disorder="annealed"),
    Ensemble(Table([0.5, 0.9, 2.0]), Thermal(0.05), **UNIFORM),
    Ensemble(Delta(1.0)),
    Ensemble(thermal=Thermal(0.1), aging=Aging("flow", 0.1, 2.0), **UNIFORM),
]


@chosen(  # by default every third kind of contacts once
    ("start", "points", "ensemble"),
    itertools.product(STARTS, POINTS, CASES),
    [(STARTS[i % 2], POINTS[i % 9 // 3], CASES[i]) for i in range(0, len(CASES), 3)],
)
def test_side_by_side_as_one_by_one(ensemble, start, points):
    """The same contacts with every life deposited and recorded by itself: force, pinned
    fraction, variance and sums over the second half agree to rounding, of which sums of
    300 contacts and some 1e4 lives have 1e-11."""
    c, count = contacts(ensemble, V), 300
    found = []
    for by_life in (False, True):
        run = Run(20.0, points, start == "stationary", batch_by_life=by_life)
        scales, total = Scales.of(c, run, count, 1, 0.0), Totals(points + 1, points, 1)
        constant_drive(c, stationary(c), run, scales, key(2, TRAJECTORY), 0.0).simulate(
            total, 0, count
        )
        sums = [
            total.windows[name].sum(axis=0) / scale
            for name, scale in scales.windows._asdict().items()
        ]
        found.append(
            (*moments(total.deposits, scales, run, count, 0.0), sums, total.lives)
        )
    for mine, other in zip(*found, strict=True):
        np.testing.assert_allclose(mine, other, rtol=1e-10, atol=1e-10)


PLAIN = [
    Ensemble(**UNIFORM),
    Ensemble(thermal=Thermal(0.1), delay=Delay(2.0), eta=0.5),
    Ensemble(Gamma(0.0), Thermal(0.3, 1.0, "stiff"), **UNIFORM),
    Ensemble(Gamma(2.5), Thermal(0.3), disorder="annealed"),
    Ensemble(aging=Aging("flow", 0.1, 2.0), delay=Delay(1.0)),
    Ensemble(disorder="annealed", aging=Aging("flow", 0.1, 2.0)),
]


@chosen("ensemble", PLAIN, PLAIN[:2])  # quenched contacts that do not age
def test_plain_steady_agrees_with_the_default(ensemble):
    """Three scores a case, |z| < 4.5: false alarm 1e-4."""
    plain, clever = (
        steady(ensemble, Drive(V), rel_error=2e-3, plain=how, seed=31)
        for how in (True, False)
    )
    assert plain.reached
    for name in ("friction", "pinned", "break_stretch"):
        z = difference(getattr(plain, name), getattr(clever, name))
        assert z is None or abs(z) < 4.5


@pytest.mark.verification
def test_plain_langevin():
    ensemble = Ensemble(aging=Aging("langevin", 0.1, 1.0), **UNIFORM)
    plain, clever = (
        steady(ensemble, Drive(1.0), rel_error=1e-2, plain=how, seed=3)
        for how in (True, False)
    )
    assert abs(difference(plain.friction, clever.friction)) < 4.5


@pytest.mark.verification
def test_plain_error_bars_and_threads():
    """200 seeds against the exact T = 0 value: unit variance of the scores (p > 1e-4);
    threads do not change bits, and seeds share no lives."""
    exact = 4 / (3 * math.sqrt(math.pi))
    runs = [
        steady(
            Ensemble(**UNIFORM), Drive(V), rel_error=1.0, seed=seed, plain=True
        ).friction
        for seed in range(200)
    ]
    z = np.array([(run.value - exact) / run.stderr for run in runs])
    spread = np.sum(scipy.stats.norm.ppf(scipy.stats.t.cdf(z, 31)) ** 2)
    assert 1e-4 < scipy.stats.chi2.cdf(spread, 200) < 1 - 1e-4
    assert len({run.value for run in runs}) == 200
    one, two = (
        steady(Ensemble(**UNIFORM), Drive(V), plain=True, threads=threads).friction
        for threads in (1, 2)
    )
    assert one == two


def test_plain_refuses_and_warns():
    with pytest.raises(InputError, match="lives"):
        steady(Ensemble(), Drive(1.0), plain=True, max_lives=1000)
    heavy = steady(
        Ensemble(thermal=Thermal(1.0)), Drive(1e-6), rel_error=0.5, plain=True
    ).friction
    assert not heavy.reliable


def test_lives_of_any_number():
    """Blocks of lanes in `lives` have no seams."""
    c = contacts(Ensemble(thermal=Thermal(0.1)), V)
    u, v = np.random.default_rng(1).random((2, 2 * LANES + 3))
    source = Source(key(0, 0), 0, STEP)
    together = lives(c, source, u, v)
    for i in (0, LANES - 1, LANES, 2 * LANES + 2):
        alone = lives(c, source, u[i : i + 1], v[i : i + 1])
        assert (together.work[i], together.travel[i]) == (
            alone.work[0],
            alone.travel[0],
        )
