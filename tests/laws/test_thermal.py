"""Rates, integrated hazards and their inverses: against mpmath, against each other, and
by draws.

a = k_i/(2 kT) in the user's words; b = k x_*^2/(2 kT) with x_* = 1.
"""

import itertools
import math

import mpmath
import numpy as np
import pytest
import scipy.stats
from cases import chosen
from kernels import compiled
from scipy import integrate, interpolate, special

from eqsim import Delta, Distribution, Ensemble, Gamma, InputError, Table, Thermal
from eqsim.engine.contacts import contacts
from eqsim.engine.errorbars import POOLED_STEPS
from eqsim.engine.langevin import STEP
from eqsim.engine.sample import Source, lives
from eqsim.laws.barrier import BARRIERS, base, pooled, soft
from eqsim.laws.barrier.cusp import Cusp
from eqsim.laws.barrier.pooled import MOST_POOLED_STEPS, pooled_hazard, pooled_rate
from eqsim.laws.barrier.soft import Soft, erfi_inverse_table, log_erfi
from eqsim.laws.barrier.stiff import Stiff
from eqsim.laws.stiffness import relative_stiffness
from eqsim.numerics import streams, tables
from eqsim.numerics.streams import TRAJECTORY, key
from eqsim.numerics.vector_math import FLAT

look_up, uniforms = compiled(tables.look_up), compiled(streams.uniforms)
soft_odds, soft_rank = compiled(soft._odds), compiled(soft._rank)
stretch, stretch_of_pool = compiled(base.stretch), compiled(pooled._inverse)
mean_rate = compiled(base.mean_rate)

EPS = np.finfo(float).eps
# barriers that vanish at the threshold
VANISHING = (Soft, Stiff, Cusp)
HEATED = ("soft", "stiff", "cusp")
# E ~ (1 - x/xi)^power with the prefactor (1 - x/xi)^(power - 1)
POWER = {Stiff: 1.5, Cusp: 2.0}
# relative error of the tabulated inverse of ln(1 + erfi z): that of a root in a cell of
# relative width 1/64, three times as large near s = 2 where the function bends, and
# 2^-31 of the straight beginning below s = 2^-30
INVERSE_ERROR = 5e-10


def log_erfi_exactly(z):
    """ln erfi(z) in the working precision, for any z > 0."""
    if z < 8:
        return mpmath.log(mpmath.erfi(z))
    term, total = 1 / z, mpmath.mpf(0)
    for j in range(40):  # asymptotic series of sqrt(pi) exp(-z^2) erfi(z)
        total += term
        term *= (2 * j + 1) / (2 * z * z)
        if term < mpmath.eps * total:
            break
    return z * z + mpmath.log(total / mpmath.sqrt(mpmath.pi))


@pytest.mark.parametrize("barrier", [Stiff, Cusp])
def test_a_rate_that_vanishes_at_the_threshold_is_no_warning(barrier):
    xi = np.array([1.0, 2.0])
    with np.errstate(all="raise"):
        log_rate = barrier.log_attempt(np.array([0.0, 1.0]), 2.0 * xi, xi, 0.5)
    assert log_rate[0] == -math.inf
    assert np.isfinite(log_rate[1])


# -------------------------------------------------------------------------------------------
# one contact, NumPy


@pytest.mark.parametrize(
    "z", [1e-12, 1e-3, 0.3, 0.92, 1.0, 3.0, 7.9, 8.1, 30.0, 1e3, 1e6]
)
def test_log_erfi(z):
    with mpmath.workdps(40):
        exact = float(log_erfi_exactly(mpmath.mpf(z)))
    assert float(log_erfi(z)) == pytest.approx(exact, rel=8 * EPS, abs=8 * EPS)


@pytest.mark.verification
@chosen(
    ("barrier", "a"),
    itertools.product(VANISHING, (1e-6, 0.3, 1.0, 40.0, 1e4, 1e8)),
    [(Soft, 1e8), (Stiff, 1.0), (Cusp, 1e4)],
)
def test_log_hazard_is_the_integral_of_the_rate(barrier, a):
    """Against quadrature of exp(log_rate), in 40 digits and on intervals that shrink
    towards x, where it is largest. Rounding: a few eps of the exponent a xi^2."""
    xi = 1.3
    with mpmath.workdps(40):
        c = mpmath.mpf(a) * mpmath.mpf(xi) ** 2

        def log_r(y):
            gap = 1 - y / mpmath.mpf(xi)
            if barrier is Soft:
                return -c * (1 - (y / mpmath.mpf(xi)) ** 2)
            power = mpmath.mpf(POWER[barrier])
            return (power - 1) * mpmath.log(gap) - c * gap**power

        for part in (1e-6, 0.1, 0.5, 0.9, 0.999, 1.0):
            x = mpmath.mpf(part * xi)
            top = log_r(x * (1 - mpmath.mpf(10) ** -12)) if part == 1.0 else log_r(x)
            edges = [x * (1 - mpmath.mpf(2) ** -j) for j in range(34)] + [x]
            integral = mpmath.quad(
                lambda y, top=top: mpmath.exp(log_r(y) - top) if y < xi else 0, edges
            )
            exact = float(mpmath.log(integral) + top)
            assert float(barrier.log_hazard(part * xi, xi, a)) == pytest.approx(
                exact, abs=1e-11 + 8 * EPS * float(c)
            )
            if part < 1:
                assert float(barrier.log_rate(part * xi, xi, a)) == pytest.approx(
                    float(log_r(x)), abs=1e-12 + 8 * EPS * float(c)
                )


@pytest.mark.parametrize("barrier", VANISHING)
def test_derivative_of_the_hazard_is_the_rate(barrier):
    """d ln H/dx = r/H by central differences, over random contacts (error of second
    order in a step of 1e-5)."""
    rng = np.random.default_rng(5)
    a, xi = 10 ** rng.uniform(-3, 2, 500), rng.uniform(0.2, 3.0, 500)
    x = xi * rng.uniform(0.05, 0.95, 500)
    h = 1e-5 * np.minimum(x, xi - x) / (1 + a * xi**2)
    found = (barrier.log_hazard(x + h, xi, a) - barrier.log_hazard(x - h, xi, a)) / (
        2 * h
    )
    expected = np.exp(barrier.log_rate(x, xi, a) - barrier.log_hazard(x, xi, a))
    np.testing.assert_allclose(found, expected, rtol=1e-5)


# -------------------------------------------------------------------------------------
# one contact, kernel side


@pytest.mark.parametrize("factor", [1e-30, 1.0, 1e9])
def test_soft_rank(factor):
    """ln(1 + factor e^y) from where it is factor e^y to where it is y + ln(factor), and
    where e^y overflows."""
    clock = factor * math.sqrt(math.pi) / 2
    for y in (
        -690.0,
        -40.0,
        -1.0,
        0.0,
        3.0,
        39.9,
        40.1,
        399.9,
        400.1,
        720.0,
        1e10,
        1e19,
    ):
        xi, log_w = (math.sqrt(y), 0.0) if y > 0 else (1e-30, -y)
        y = xi * xi - log_w
        with mpmath.workdps(400):
            exact = (
                float(mpmath.log1p(factor * mpmath.exp(y)))
                if y < 1e5
                else y + math.log(factor)
            )
        rank = soft_rank(xi, 1.0, log_w, soft_odds(xi, 1.0, log_w, clock))
        assert rank == pytest.approx(exact, rel=4 * EPS, abs=0.0)


def test_inverse_table():
    """ln(1 + erfi(z(s))) = s in 40 digits; d ln z = (1 - e^-s) D(z)/z ds turns the
    residual into an error of z."""
    rng = np.random.default_rng(6)
    s = np.concatenate(
        (2.0 ** rng.uniform(-40, 60, 1000), 2.0 ** rng.uniform(-3, 6, 1000))
    )
    worst = 0.0
    with mpmath.workdps(40):
        for value in s:
            z = look_up(erfi_inverse_table(), value)
            residual = mpmath.log1p(
                mpmath.exp(log_erfi_exactly(mpmath.mpf(z)))
            ) - mpmath.mpf(value)
            worst = max(
                worst,
                abs(float(residual))
                * -math.expm1(-value)
                * float(special.dawsn(z))
                / z,
            )
    assert worst < INVERSE_ERROR


def stretches(barrier, xi, a, log_w, clock):
    laws = [barrier(*row) for row in zip(a, log_w, strict=True)]
    return np.array(
        [
            stretch(law, barrier.table(), x, 1.0, c)
            for law, x, c in zip(laws, xi, clock, strict=True)
        ]
    )


def round_trip(barrier, xi, a, log_w, clock):
    """Where exp(log_w) H(x) = clock or x = xi: by how much, in units of what is
    allowed, the answers miss. Allowed are the relative error of x (table and a few eps)
    times d ln H/d ln x, and a few eps of each term of ln(w H/clock); of high barriers
    all but `Stiff` solve for the gap to the threshold, whose terms are below FLAT."""
    x = stretches(barrier, xi, a, log_w, clock)
    assert np.all((x > 0) & (x <= xi))
    log_h = barrier.log_hazard(x, xi, a)
    residual = log_w + log_h - np.log(clock)
    inside = x < xi
    steepness = np.zeros(x.size)
    steepness[inside] = x[inside] * np.exp(
        barrier.log_rate(x[inside], xi[inside], a[inside]) - log_h[inside]
    )
    if barrier is Soft:
        steepness[~inside] = (np.sqrt(a) * xi / special.dawsn(np.sqrt(a) * xi))[~inside]
    relative = 16 * EPS + (INVERSE_ERROR if barrier is Soft else 0.0)
    highest = math.inf if barrier is Stiff else FLAT
    allowed = relative * steepness + 16 * EPS * (
        1 + np.abs(log_w) + np.minimum(a * xi**2, highest) + np.abs(np.log(clock))
    )
    # a clock may show more than H(xi)
    missed = np.where(inside, np.abs(residual), np.maximum(residual, 0.0))
    return missed / allowed, inside


def random_contacts(rng, count, log_b, log_xi=(-2.0, 1.0)):
    """Random contacts, half of them where the exponent leaves the choice between
    thermal and mechanical open."""
    a, xi = 10 ** rng.uniform(*log_b, count), 10 ** rng.uniform(*log_xi, count)
    clock = np.where(
        rng.random(count) < 0.5,
        rng.exponential(size=count),
        10 ** rng.uniform(-16, 1.6, count),
    )
    return a, xi, clock


@pytest.mark.parametrize("barrier", VANISHING)
def test_inverse_is_the_inverse_of_the_hazard(barrier):
    """b from 1e-3 to 1e9, |ln(omega/v)| <= 60, thresholds over three decades:
    exp(log_w) H(x) = clock."""
    rng = np.random.default_rng(7)
    a, xi, clock = random_contacts(rng, 6000, (-3, 9))
    log_w = rng.uniform(-60, 60, a.size)
    # half the velocities such that the contact breaks at a stretch of our choice, near
    # xi if the barrier is high
    near = xi * np.sqrt(
        np.maximum(1 - rng.uniform(0, 60, a.size) / (a * xi**2), rng.random(a.size))
    )
    aimed = np.log(clock) - barrier.log_hazard(near, xi, a)
    log_w = np.where((rng.random(a.size) < 0.7) & (np.abs(aimed) <= 60), aimed, log_w)
    missed, inside = round_trip(barrier, xi, a, log_w, clock)
    assert missed.max() <= 1.0
    assert 0.2 < inside.mean() < 0.9  # both ends of a life are met


@pytest.mark.verification
@pytest.mark.parametrize("barrier", VANISHING)
def test_mean_rate_between_two_stretches(barrier):
    """Against quadrature of the rate in 30 digits on intervals that shrink towards the
    end: to the documented 1e-8 and a few eps of each term of the exponent, over pieces
    from all of a threshold down to 1e-12 of it, those that a series only just holds
    for, too, from 0 and up to xi. The rate in the middle times the length fails."""
    rng = np.random.default_rng(8)
    a, xi, part = (
        10 ** rng.uniform(-3, 5, 200),
        rng.uniform(0.2, 3.0, 200),
        rng.random(200),
    )
    length = np.where(
        rng.random(200) < 0.5,
        10 ** rng.uniform(-12, 0, 200),
        10 ** rng.uniform(-2, 0.5, 200) / (a * xi),
    )
    part[:30], part[30:60] = 0.0, 1.0
    x = part * np.maximum(xi - length, 0.0)
    other = np.where(part == 1.0, xi, np.minimum(x + length, xi))
    log_w = rng.uniform(-5, 5, 200) - barrier.log_rate(
        np.minimum(other, (1 - 1e-9) * xi), xi, a
    )
    missed, of_middle = np.zeros(200), np.zeros(200)
    for i in range(200):
        law = barrier(a[i], log_w[i])
        way = other[i] - x[i]
        found = mean_rate(law, barrier.hazard_table(), xi[i], 1.0, x[i], way) * way
        with mpmath.workdps(30):
            c, low, high, end = (
                mpmath.mpf(v) for v in (a[i] * xi[i] ** 2, x[i], other[i], xi[i])
            )

            def r(y, c=c, end=end):
                gap = 1 - y / end
                if barrier is Soft:
                    return mpmath.exp(-c * gap * (2 - gap))
                power = mpmath.mpf(POWER[barrier])
                return gap ** (power - 1) * mpmath.exp(-c * gap**power)

            steps = max(
                2, int(math.log2(1.0 + 3.0 * a[i] * xi[i] * (other[i] - x[i]))) + 3
            )
            edges = [
                high - (high - low) * mpmath.mpf(2) ** -j for j in range(steps)
            ] + [high]
            exact = mpmath.quad(r, edges) * mpmath.exp(mpmath.mpf(log_w[i]))
            missed[i] = abs(found / exact - 1) / (
                1e-8 + 16 * EPS * (1 + abs(log_w[i]) + float(c))
            )
            of_middle[i] = abs(
                r((low + high) / 2) * (high - low) * mpmath.exp(log_w[i]) / exact - 1
            )
    assert missed.max() <= 1.0
    assert np.mean(of_middle > 1e-7) > 0.3


@pytest.mark.parametrize("barrier", VANISHING)
@pytest.mark.parametrize("log_b", [(-12, -9), (10, 15)])
@pytest.mark.parametrize("ratio", [1e-12, 1e12])
def test_inverse_at_extremes(barrier, log_b, ratio):
    """Next to no barrier, next to no temperature, v from 1e-12 to 1e12 omega x_*."""
    a, xi, clock = random_contacts(np.random.default_rng(8), 1000, log_b)
    missed, _ = round_trip(barrier, xi, a, np.full(a.size, -math.log(ratio)), clock)
    assert missed.max() <= 1.0


@pytest.mark.parametrize("ratio", [1e-12, 1.0, 1e12])
def test_no_barrier_is_a_constant_rate(ratio):
    """b = 1e-12, soft: H(x) = x, so a contact breaks at clock v/omega or at its
    threshold."""
    clock = np.geomspace(1e-15, 40, 200)
    x = stretches(
        Soft, np.ones(200), np.full(200, 1e-12), np.full(200, -math.log(ratio)), clock
    )
    np.testing.assert_allclose(
        x, np.minimum(clock * ratio, 1.0), rtol=INVERSE_ERROR + 1e-11
    )


@pytest.mark.parametrize("barrier", VANISHING)
@pytest.mark.parametrize("a", [1e13, 1e16, 1e18, 1e22, 1e60])
def test_no_temperature_breaks_at_the_threshold(barrier, a):
    """At b -> infinity, whatever the clock, x = xi within ln(omega/v)/(2b) (soft) or
    its power 2/3 (stiff) or 1/2 (cusp)."""
    xi = np.array([0.3, 1.0, 12.0])
    for log_w in (-60.0, 0.0, 60.0):
        x = stretches(
            barrier, xi, np.full(3, a), np.full(3, log_w), np.array([1e-3, 1.0, 5.0])
        )
        early = (60 + math.log(a) + 20) / (a * xi**2)
        assert np.all(
            1 - x / xi
            <= INVERSE_ERROR
            + early ** (1.0 if barrier is Soft else 1.0 / POWER[barrier])
        )


@pytest.mark.parametrize("barrier", VANISHING)
def test_wrong_barrier_fails_the_round_trip(barrier):
    """Negative control: temperature off by 1e-6."""
    rng = np.random.default_rng(9)
    a, xi = 10 ** rng.uniform(0, 3, 200), rng.uniform(0.5, 2, 200)
    x = xi * rng.uniform(0.2, 0.9, 200)
    log_w = -barrier.log_hazard(x, xi, a)
    found = stretches(barrier, xi, a * (1 + 1e-6), log_w, np.ones(200))
    assert np.median(np.abs(log_w + barrier.log_hazard(found, xi, a))) > 1e-7
    assert (
        np.median(
            np.abs(
                log_w
                + barrier.log_hazard(
                    stretches(barrier, xi, a, log_w, np.ones(200)), xi, a
                )
            )
        )
        < 1e-7
    )


# ------------------------------------------------------------------------------------------
# annealed, smooth laws

# documented relative error of the pooled inverse: by kind of support
ERROR = {"smooth": 2e-7, "edge": 1e-4}
B = [1e-8, 1e-3, 0.1, 1.0, 10.0, 1e3, 1e6, 1e9, 1e12]


def nt09(b, u):
    """(S, G) of nt09: n = 1, soft, uniform stiffness, lengths in x_*."""
    c0 = 4 / (3 * math.sqrt(math.pi))
    s, s1 = (1 + b / 3) / (c0 * (1 + b) ** 2), (c0 / 2) * (1 + b) / (1 + b / 3)
    return s, s * (special.erf(u) - s1 * u * np.exp(-(u**2)))


@pytest.mark.parametrize("b", B)
def test_pooled_rate_is_nt08(b):
    u = np.geomspace(1e-10, 7, 300)
    found = pooled_rate(Gamma(1.0, 3.0), "uniform", Soft, b, u)
    np.testing.assert_allclose(
        found, (1 + (1 + b) * u**2) / (1 + b) ** 2 * np.exp(-(u**2)), rtol=1e-12
    )


@chosen("b", B, [1e-8, 1.0, 1e12])
def test_pooled_hazard_is_nt09(b):
    """G at its nodes; the closed form cancels to a part u^2 of itself at small u, hence
    u > 1e-2."""
    pool = pooled_hazard(Gamma(1.0, 3.0), "uniform", Soft, b)
    beyond = pool.x > 1e-2
    np.testing.assert_allclose(pool.G[beyond], nt09(b, pool.x[beyond])[1], rtol=1e-8)
    small = pool.x < 1e-3  # h is constant plus u^2/(1 + b)
    u = pool.x[small]
    np.testing.assert_allclose(
        pool.G[small], (u + b**2 / (1 + b) * u**3 / 3) / (1 + b) ** 2, rtol=1e-5
    )


@pytest.mark.parametrize("b", [0.1, 1.0, 50.0, 2.7e8])
def test_crossover_velocity_is_nt12(b):
    """v_* = omega x_* S (S_0 = 1)."""
    ensemble = Ensemble(
        Gamma(1.0, 3.0),
        Thermal(4.5 / b * 2.0, 7.0),
        stiffness=2.0,
        stiffness_law="uniform",
    )
    assert ensemble.b == pytest.approx(b, rel=1e-15, abs=0)
    assert ensemble.crossover_velocity == pytest.approx(
        21.0 * nt09(b, 1.0)[0], rel=1e-8, abs=0
    )


@pytest.mark.parametrize("barrier", HEATED)
def test_crossover_velocity_without_temperature(barrier):
    assert Ensemble(thermal=Thermal(0.0, 1.0, barrier)).crossover_velocity == 0.0
    assert (
        0.0
        <= Ensemble(thermal=Thermal(1e-100, 1.0, barrier)).crossover_velocity
        < 1e-60
    )


def quadrature_rate(density, low, high, stiffness, rms, barrier, b, y):
    """h(y) by quadrature in 20 digits, on intervals that grow from the layer next to y."""
    with mpmath.workdps(20):
        y, b = mpmath.mpf(y), mpmath.mpf(b)
        left = max(y, mpmath.mpf(low))

        def integrand(xi):
            if xi <= y:
                return mpmath.mpf(0)
            a = b * xi / rms if stiffness == "sqrt" else b
            if barrier is Soft:
                return density(xi) * mpmath.exp(-a * (xi**2 - y**2))
            gap = 1 - y / xi
            p, q = (1, 2) if barrier is Cusp else (mpmath.mpf(0.5), mpmath.mpf(1.5))
            return density(xi) * gap**p * mpmath.exp(-a * xi**2 * gap**q)

        edges = [left + (high - left) * mpmath.mpf(2) ** -j for j in range(40, -1, -1)]
        return float(mpmath.quad(integrand, [left, *edges], maxdegree=4))


LAWS = {
    "gamma n=0": (Gamma(0.0, 2.0), lambda x: 2 * x * mpmath.exp(-(x**2)), 0, 9),
    "gamma n=1": (Gamma(1.0, 2.0), lambda x: 2 * x**3 * mpmath.exp(-(x**2)), 0, 9),
    "uniform": (
        Distribution(scipy.stats.uniform(1.0, 2.0)),
        lambda x: mpmath.mpf(1),
        0.5,
        1.5,
    ),
    "lognorm": (
        Distribution(scipy.stats.lognorm(0.5, scale=3.0)),
        lambda x: (
            mpmath.exp(-2 * (mpmath.log(x) + 0.125) ** 2)
            / (x * mpmath.sqrt(mpmath.pi / 2))
        ),
        0,
        60,
    ),
}


@chosen(
    ("barrier", "stiffness", "name"),
    itertools.product(VANISHING, ("sqrt", "uniform"), LAWS),
    [
        (Soft, "sqrt", "gamma n=1"),
        (Soft, "uniform", "lognorm"),
        (Stiff, "sqrt", "uniform"),
    ],
)
def test_pooled_rate_by_quadrature(name, stiffness, barrier):
    law, density, low, high = LAWS[name]
    y = np.array([0.02, 0.3, 1.2])
    for b in (0.3, 1e4):
        found = pooled_rate(law, stiffness, barrier, b, y)
        exact = [
            quadrature_rate(
                density, low, high, stiffness, law.rms / law.scale, barrier, b, v
            )
            for v in y
        ]
        np.testing.assert_allclose(
            found, exact, rtol=ERROR["edge" if low else "smooth"], atol=1e-200
        )


@pytest.mark.parametrize(
    ("law", "b"),
    [
        (Gamma(100.0), 0.01),
        (Gamma(1000.0), 1e-3),
        (Distribution(scipy.stats.lognorm(0.03)), 0.5),
        (Distribution(scipy.stats.uniform(0.99, 0.02)), 0.5),
    ],
)
def test_pooled_rate_of_narrow_laws(law, b):
    """All thresholds within a few per cent: the rate is the mean over quantiles
    (trapezoidal in a smooth variable)."""
    t = np.linspace(-3.5, 3.5, 4001)
    tail, weight = (
        special.expit(-2 * np.sinh(t)),
        2 * np.cosh(t) * special.expit(2 * np.sinh(t)) * special.expit(-2 * np.sinh(t)),
    )
    xi = law.inverse_survival(-np.log(tail)) / law.scale
    y = np.array([0.1, 0.5]) * law.mean / law.scale
    exact = [
        np.sum(weight * np.exp(Soft.log_rate(v, xi, b))) * (t[1] - t[0]) for v in y
    ]
    np.testing.assert_allclose(
        pooled_rate(law, "uniform", Soft, b, y), exact, rtol=ERROR["smooth"]
    )


def test_pooled_rate_of_a_histogram():
    """Two equal blocks with nothing between: closed form in erf."""
    law = Distribution(
        scipy.stats.rv_histogram(
            (np.array([1.0, 0.0, 0.0, 0.0, 1.0]), np.linspace(1.0, 3.0, 6))
        )
    )
    b, y = 0.3, np.array([0.01, 0.3, 0.6, 1.0, 1.4])
    exact = np.zeros(y.size)
    for low, high in ((0.5, 0.7), (1.3, 1.5)):
        inside = special.erf(math.sqrt(b) * np.maximum(y, high)) - special.erf(
            math.sqrt(b) * np.maximum(y, low)
        )
        exact += inside / 0.4 * math.sqrt(math.pi / b) / 2 * np.exp(b * y**2)
    np.testing.assert_allclose(
        pooled_rate(law, "uniform", Soft, b, y), exact, rtol=ERROR["edge"]
    )


def test_pooled_rate_of_an_integrable_singularity():
    """The arcsine law xi = sin^2(t), t uniform, whose density is infinite at both ends."""
    law = Distribution(scipy.stats.beta(0.5, 0.5))
    b, y = 0.3, np.array([0.02, 0.6, 1.4])
    node, weight = np.polynomial.legendre.leggauss(60)
    exact = []
    for v in y:
        half = (math.pi / 2 - math.asin(math.sqrt(v / 2))) / 2
        xi = 2 * np.sin(math.pi / 2 - half * (1 - node)) ** 2
        exact.append(weight @ np.exp(Soft.log_rate(v, xi, b)) * half / (math.pi / 2))
    np.testing.assert_allclose(
        pooled_rate(law, "uniform", Soft, b, y), exact, rtol=ERROR["edge"]
    )


def test_wrong_pooled_rates_fail():
    """Negative controls of the comparisons above: 1e-6 of temperature, the other
    stiffness, the other barrier."""
    law, density, low, high = LAWS["gamma n=1"]
    y = np.array([0.3])
    exact = quadrature_rate(
        density, low, high, "sqrt", law.rms / law.scale, Soft, 30.0, y[0]
    )
    for wrong in (
        ("sqrt", Soft, 30.0 * (1 + 1e-6)),
        ("uniform", Soft, 30.0),
        ("sqrt", Stiff, 30.0),
    ):
        assert abs(pooled_rate(law, *wrong, y)[0] / exact - 1) > 1e-7
    u = np.geomspace(1e-2, 5, 50)
    pool = pooled_hazard(Gamma(1.0), "uniform", Soft, 1.0 + 1e-6)
    assert np.max(np.abs(np.interp(u, pool.x, pool.G) / nt09(1.0, u)[1] - 1)) > 1e-7


def integrated_rate(law, stiffness, barrier, b, x):
    """G at ascending x by Gauss-Legendre quadrature of pooled_rate, on intervals that
    halve towards 0 and towards both sides of the ends of the support."""
    halves = 2.0 ** -np.arange(0.0, 44.0)
    low, high = (edge / law.scale for edge in law.support)
    edges = [x, x[-1] * halves]
    for end, width in ((low, low), (low, x[-1] - low), (high, high - low)):
        if 0 < end < math.inf:
            edges += [end - width * halves, end + width * halves]
    edges = np.unique(np.concatenate(edges))
    edges = edges[(edges > 0) & (edges <= x[-1])]
    node, weight = np.polynomial.legendre.leggauss(40)
    half, middle = np.diff(edges) / 2, (edges[:-1] + edges[1:]) / 2
    inner = (middle[:, None] + half[:, None] * node).ravel()
    h = pooled_rate(law, stiffness, barrier, b, np.append(edges[0], inner))
    G = edges[0] * h[0] + np.append(
        0.0, np.cumsum(h[1:].reshape(-1, 40) @ weight * half)
    )
    return G[np.searchsorted(edges, x)]


@chosen(
    ("b", "barrier", "stiffness", "name"),
    itertools.product((0.1, 30.0, 1e6), VANISHING, ("sqrt", "uniform"), LAWS),
    [
        (0.1, Soft, "sqrt", "gamma n=0"),
        (0.1, Stiff, "uniform", "lognorm"),
        (30.0, Stiff, "sqrt", "gamma n=1"),
        (1e6, Soft, "sqrt", "lognorm"),
        (1e6, Stiff, "uniform", "gamma n=0"),
    ],
)
def test_pooled_inverse_of_smooth_laws(name, stiffness, barrier, b):
    """The integral of the rate up to the inverse is the target, within the documented
    error of the inverse times h."""
    law, low = LAWS[name][0], LAWS[name][2]
    pool = pooled_hazard(law, stiffness, barrier, b)
    targets = pool.G[-1] * np.array([1e-6, 1e-3, 0.03, 0.1, 0.3, 0.5, 0.8, 0.95, 0.999])
    x = np.array([pooled_stretch(*pool, target) for target in targets])
    residual = integrated_rate(law, stiffness, barrier, b, x) - targets
    allowed = (
        ERROR["edge" if low else "smooth"]
        * x
        * pooled_rate(law, stiffness, barrier, b, x)
    )
    assert np.all(np.abs(residual) < allowed)


def inverse_errors(pool, u, G):
    found = np.array([pooled_stretch(*pool, target) for target in G])
    return np.abs(found / u - 1)


@pytest.mark.parametrize("b", B)
def test_pooled_inverse_against_nt09(b):
    """Documented error against the closed form, up to u = 3, beyond which one contact
    in 800 has its threshold."""
    u = np.linspace(0.02, 3.0, 4001)
    G = nt09(b, u)[1]
    pool = pooled_hazard(Gamma(1.0), "uniform", Soft, b)
    assert inverse_errors(pool, u, G).max() < ERROR["smooth"]
    # negative control
    assert inverse_errors(pool, u * (1 + 1e-6), G).min() > ERROR["smooth"]


@chosen(
    ("n", "b"),
    [(3e4, 0.05), (1e5, 0.02), (1e6, 1e-3), (1e6, 5e-3)],
    [(3e4, 0.05), (1e6, 5e-3)],
)
def test_pooled_inverse_far_below_a_narrow_law(n, b):
    """Attempts so many that contacts break far below all thresholds, on the weakest of
    a share of 1e-20 to 1e-240: h = exp(b y^2) Q(n+1, (1+b) y^2)/(1+b)^(n+1), Q the
    regularised incomplete gamma function, and its integral by Simpson's rule over steps
    in which it rises by a few per cent. Control: b 1e-4 off."""
    x, pool = (
        np.linspace(0.3, 0.999, 100) * math.sqrt(n),
        pooled_hazard(Gamma(n), "uniform", Soft, b),
    )

    def errors(b):
        found = []
        for end in x:
            at = np.linspace(
                max(0.0, end - 45.0 / min(2 * b * end, 4 * (math.sqrt(n) - end))),
                end,
                8001,
            )
            h = np.exp(
                b * at**2
                - (n + 1) * math.log1p(b)
                + np.log(special.gammaincc(n + 1, (1 + b) * at**2))
            )
            G = integrate.simpson(h, x=at)
            if 1e-240 < G < 1e-20:
                found.append(pooled_stretch(*pool, G) / end - 1)
        return np.abs(found)

    assert errors(b).size > 5
    assert errors(b).max() < ERROR["smooth"]
    assert errors(b * (1 + 1e-4)).max() > ERROR["smooth"]


def rate_of_weak(shape, barrier, b, y):
    """h(y) of the gamma law of this shape < 1, uniform stiffness, lengths in its scale:
    trapezoidal in ln(xi - y)."""
    step = np.linspace(-80.0, 6.0, 4000)
    beyond = np.exp(step)
    xi = y + beyond
    weight = np.exp((shape - 1) * np.log(xi) - xi - math.lgamma(shape) + step) * (
        step[1] - step[0]
    )
    if barrier is Soft:
        return weight @ np.exp(-b * beyond * (beyond + 2 * y))
    if barrier is Cusp:
        return weight @ (beyond / xi * np.exp(-b * beyond**2))
    return weight @ (np.sqrt(beyond / xi) * np.exp(-b * xi**2 * (beyond / xi) ** 1.5))


@chosen(
    ("barrier", "shape"),
    itertools.product(VANISHING, (0.2, 0.5)),
    [(Soft, 0.2), (Stiff, 0.5)],
)
def test_pools_of_infinite_density_at_zero(shape, barrier):
    """So many weak contacts that the rate still varies where stretches are 1e-25: rate
    and inverse. Control: a shape 1e-4 off."""
    law, b = Distribution(scipy.stats.gamma(shape)), 20.0
    unit = law.scale
    y = np.array([1e-25, 1e-15, 1e-9, 1e-3, 0.3, 2.0])
    exact = np.array([rate_of_weak(shape, barrier, b, v) for v in y])
    found = pooled_rate(law, "uniform", barrier, b * unit**2, y / unit)
    np.testing.assert_allclose(found, exact, rtol=ERROR["smooth"])
    other = rate_of_weak(shape + 1e-4, barrier, b, y[0])
    assert abs(found[0] / other - 1) > 10 * ERROR["smooth"]
    u = np.linspace(-75.0, 1.0, 1200)
    G = integrate.cumulative_simpson(
        np.exp(u) * [rate_of_weak(shape, barrier, b, v) for v in np.exp(u)],
        x=u,
        initial=0,
    )
    pool = pooled_hazard(law, "uniform", barrier, b * unit**2)
    inverse = [unit * pooled_stretch(*pool, G[i] / unit) for i in range(400, 1200, 50)]
    np.testing.assert_allclose(inverse, np.exp(u[400::50]), rtol=ERROR["smooth"])


@pytest.mark.parametrize(
    ("low", "high", "b"),
    [
        (0.9, 1.1, 1e3),
        (0.1, 1.9, 1e4),
    ],
)
def test_pooled_inverse_with_a_gap_below_the_support(low, high, b):
    """Uniform thresholds: for y < low all thresholds are above y, and with uniform
    stiffness G = <exp(-b xi^2)> int_0^u exp(b y^2) dy, in erfc (scaled, against
    overflow) and erfi. At u the exponent is up to 20 below its value at low, as matters
    at v/omega > 1e-9."""
    root = math.sqrt(b)
    pool = pooled_hazard(
        Distribution(scipy.stats.uniform(low, high - low)), "uniform", Soft, b
    )
    u = low - np.linspace(min(20.0, b * low**2), 0.5, 400) / (2 * b * low)
    above = special.erfcx(root * low) - math.exp(
        -b * (high**2 - low**2)
    ) * special.erfcx(root * high)
    # of exp(-b (xi^2 - low^2))
    mean = math.sqrt(math.pi) / (2 * root) * above / (high - low)
    G = mean * np.exp(Soft.log_hazard(u, low, b))
    assert inverse_errors(pool, u, G).max() < ERROR["edge"]


# ---------------------------------------------------------------------------------------
# annealed, discrete laws

STEPS = np.array([0.4, 1.0, 1.0, 1.1, 2.5])


def mean_hazard(law, stiffness, barrier, b, x):
    """G(x) of equally likely thresholds: the mean of the closed forms."""
    xi = law.steps / law.scale
    a = b * relative_stiffness(stiffness, xi, law.rms / law.scale)
    return np.mean(
        [
            np.exp(barrier.log_hazard(np.minimum(x, s), s, r))
            for s, r in zip(xi, a, strict=True)
        ],
        axis=0,
    )


def exact_inverse(law, stiffness, barrier, b, targets):
    low, high = np.zeros(targets.size), np.full(targets.size, law.steps[-1] / law.scale)
    for _ in range(100):
        middle = (low + high) / 2
        short = mean_hazard(law, stiffness, barrier, b, middle) < targets
        low, high = np.where(short, middle, low), np.where(short, high, middle)
    return high


@pytest.mark.parametrize("stiffness", ["sqrt", "uniform"])
@pytest.mark.parametrize("barrier", VANISHING)
@pytest.mark.parametrize("b", [1e-3, 1.0, 1e3, 1e8])
def test_pool_of_a_table_is_the_mean(stiffness, barrier, b):
    """At the nodes to rounding (of exponents up to 8 b); between them the mean error of
    the inverse over targets is below 1e-4 of the mean distance between neighbours. With
    another temperature it is not."""
    law = Table(3.0 * STEPS)
    pool = pooled_hazard(law, stiffness, barrier, b)
    np.testing.assert_allclose(
        pool.G,
        mean_hazard(law, stiffness, barrier, b, pool.x),
        rtol=1e-12 + 128 * EPS * b,
    )
    targets = pool.G[-1] * np.random.default_rng(10).uniform(0, 0.999999, 1000)
    found = np.array([pooled_stretch(*pool, target) for target in targets])
    tolerance = 1e-4 * law.steps[-1] / law.scale / np.unique(law.steps).size
    assert (
        np.mean(np.abs(found - exact_inverse(law, stiffness, barrier, b, targets)))
        < tolerance
    )
    assert (
        np.mean(
            np.abs(
                found - exact_inverse(law, stiffness, barrier, 1.5 * b + 0.1, targets)
            )
        )
        > tolerance
    )


@pytest.mark.parametrize("barrier", VANISHING)
def test_documented_error_of_the_pool_of_a_table(barrier):
    """Below 1e-4 of the distance between neighbours, at every target."""
    law = Table([0.5, 1.0, 2.0])
    pool = pooled_hazard(law, "uniform", barrier, 1.0)
    targets = pool.G[-1] * np.linspace(1e-3, 0.999999, 5000)
    exact = exact_inverse(law, "uniform", barrier, 1.0, targets)
    gaps = (
        np.diff(law.steps, prepend=0.0)[
            np.searchsorted(law.steps, exact * law.scale).clip(max=2)
        ]
        / law.scale
    )
    found = np.array([pooled_stretch(*pool, target) for target in targets])
    assert np.max(np.abs(found - exact) / gaps) < 1e-4


@pytest.mark.parametrize("barrier", VANISHING)
@pytest.mark.parametrize(
    "thresholds", [[0.03, 1.0], [1e-4, 1.0], [1e-6, 0.3, 2.0], [1e-20, 1e-10, 1.0]]
)
def test_pool_of_thresholds_of_many_scales(thresholds, barrier):
    """The inverse from the least threshold on, where lives end that are much shorter
    than the next one, to the error that averages allow for it. Of a temperature 1 % off
    it is not."""
    law = Table(thresholds)
    pool = pooled_hazard(law, "uniform", barrier, 1.0)
    x = np.geomspace(law.steps[0], 0.5 * law.steps[-1], 2000) / law.scale

    def error(b):
        inverse = [
            pooled_stretch(*pool, target)
            for target in mean_hazard(law, "uniform", barrier, b, x)
        ]
        return np.max(np.abs(inverse / x - 1))

    assert error(1.0) < POOLED_STEPS
    assert error(1.01) > 100 * POOLED_STEPS


@pytest.mark.parametrize("barrier", VANISHING)
def test_pool_of_one_threshold_is_the_contact_itself(barrier):
    """Identical contacts: the pooled inverse is that of a single quenched contact."""
    pool = pooled_hazard(Delta(2.0), "sqrt", barrier, 5.0)
    clock = np.geomspace(1e-6, 1.0, 50) * pool.G[-1] * 0.99
    alone = stretches(barrier, np.ones(50), np.full(50, 5.0), np.zeros(50), clock)
    np.testing.assert_allclose(
        [pooled_stretch(*pool, t) for t in clock], alone, rtol=1e-3
    )


def test_pooled_stretch_at_its_ends():
    """Linear from 0, with the rate there; infinite when no stretch is enough."""
    for stiffness, barrier, b in (("sqrt", Soft, 30.0), ("uniform", Stiff, 1e6)):
        pool = pooled_hazard(Gamma(1.0), stiffness, barrier, b)
        start = (
            1.0 / pooled_rate(Gamma(1.0), stiffness, barrier, b, np.array([1e-100]))[0]
        )
        for target in (1e-200, 0.5 * pool.G[0], pool.G[0], 1.5 * pool.G[0]):
            assert pooled_stretch(*pool, target) == pytest.approx(
                start * target, rel=ERROR["smooth"], abs=0
            )
    pool = pooled_hazard(Gamma(1.0), "uniform", Soft, 1.0)
    for target in (1e-200, 1e-30, 0.3 * float(pool.G[0])):  # h(0) = 1/(1 + b)^2
        assert pooled_stretch(*pool, target) == pytest.approx(
            4.0 * target, rel=1e-8, abs=0.0
        )
    assert pooled_stretch(*pool, float(pool.G[-1])) == math.inf
    assert pooled_stretch(*pool, 1e300) == math.inf
    assert pooled_stretch(*pool, math.inf) == math.inf
    x = [pooled_stretch(*pool, t) for t in np.linspace(0, 1, 5000)[1:-1] * pool.G[-1]]
    assert np.diff(x).min() > 0


def test_too_many_different_thresholds():
    with pytest.raises(InputError, match=f"{MOST_POOLED_STEPS + 1} different values"):
        pooled_hazard(Table(np.arange(1.0, MOST_POOLED_STEPS + 2)), "sqrt", Soft, 1.0)
    pooled_hazard(
        Table(np.tile(np.arange(1.0, 11), MOST_POOLED_STEPS)), "sqrt", Soft, 1.0
    )


# ------------------------------------------------------------------------------------------------------
# by draws


def survival(ensemble, velocity):
    """S(x) = P(x_b > x) of newborn contacts as a function: over thresholds by
    Gauss-Legendre in -ln of their rank (quenched), or J_c(x) exp(-(omega/v) G(x))
    (annealed)."""
    law, barrier, b = (
        ensemble.thresholds,
        BARRIERS[ensemble.thermal.barrier],
        ensemble.b,
    )
    x = np.linspace(0.0, float(law.inverse_survival(20.0)), 300)[1:]
    w = ensemble.thermal.attempt_frequency / velocity
    if ensemble.disorder == "annealed":
        G = integrated_rate(law, ensemble.stiffness_law, barrier, b, x / law.scale)
        s = law.sf(x) * np.exp(-w * law.scale * G)
    else:
        node, weight = np.polynomial.legendre.leggauss(60)
        start = -np.log(law.sf(x))[:, None]
        # up to 30 beyond, denser at the beginning
        e = start + 15.0 * (node + 1) ** 2 / 4 * 2
        xi = law.inverse_survival(e)
        a = b / law.scale**2 * relative_stiffness(ensemble.stiffness_law, xi, law.rms)
        loss = w * np.exp(
            barrier.log_hazard(np.broadcast_to(x[:, None], xi.shape), xi, a)
        )
        s = np.sum(weight * 15.0 * (node + 1) * np.exp(-e - loss), axis=1)
    spline = interpolate.PchipInterpolator(np.append(0.0, x), np.append(1.0, s))
    return lambda at: np.where(at < x[-1], spline(np.minimum(at, x[-1])), 0.0)


def break_stretches(ensemble, velocity, count=40_000):
    stream = key(21, TRAJECTORY)
    u, v = np.array([uniforms(stream, i, 0, 0) for i in range(count)]).T.copy()
    work, stretch, *_ = lives(
        contacts(ensemble, velocity), Source(stream, 0, STEP), u, v
    )
    stiffness = 2.0 * work / stretch**2
    xi = ensemble.thresholds.inverse_survival(-np.log(u))
    np.testing.assert_allclose(
        stiffness,
        relative_stiffness(ensemble.stiffness_law, xi, ensemble.thresholds.rms),
        rtol=1e-9,
    )
    assert np.all(stretch * ensemble.thresholds.scale <= xi * (1 + 1e-9))
    return stretch * ensemble.thresholds.scale


@chosen(
    ("disorder", "stiffness", "barrier"),
    itertools.product(("quenched", "annealed"), ("sqrt", "uniform"), HEATED),
    [("quenched", "uniform", "soft"), ("annealed", "sqrt", "stiff")],
)
def test_lives_follow_the_survival(disorder, stiffness, barrier):
    """KS of 4e4 lives against S(x) by quadrature, p > 1e-5 (twelve tests: false
    alarm 1.2e-4); at two thirds of the temperature, and with the other disorder, it
    must fail."""

    def ensemble(kT=1.0, disorder=disorder):
        return Ensemble(
            Gamma(1.0, 2.0),
            Thermal(kT, 1.5, barrier),
            stiffness=0.5,
            stiffness_law=stiffness,
            disorder=disorder,
        )

    def p(sample, law):
        s = survival(law, 1.0)
        return scipy.stats.kstest(sample, lambda x: 1 - s(x)).pvalue

    sample = break_stretches(ensemble(), 1.0)
    assert p(sample, ensemble()) > 1e-5
    assert p(sample, ensemble(kT=1.0 / 1.5)) < 1e-5
    assert (
        p(
            sample,
            ensemble(disorder="annealed" if disorder == "quenched" else "quenched"),
        )
        < 1e-5
    )


@chosen(
    ("disorder", "stiffness", "barrier"),
    itertools.product(("quenched", "annealed"), ("sqrt", "uniform"), HEATED),
    [("quenched", "sqrt", "soft"), ("annealed", "uniform", "stiff")],
)
def test_lives_spend_their_clocks(disorder, stiffness, barrier):
    """A life that heat ends does so where its integrated hazard is its clock, and one
    that it does not has not spent it: 400 lives, to what the errors of tables do to a
    hazard (1e-6 of the clock)."""
    law = Gamma(1.0, 2.0)
    ensemble = Ensemble(
        law,
        Thermal(2.0, 1.5, barrier),
        stiffness=0.5,
        stiffness_law=stiffness,
        disorder=disorder,
    )
    u, v = np.random.default_rng(14).random((2, 400))
    x = lives(contacts(ensemble, 1.0), Source(key(0, TRAJECTORY), 0, STEP), u, v).travel
    xi, b, w = law.inverse_survival(-np.log(u)) / law.scale, ensemble.b, 1.5 * law.scale
    if disorder == "annealed":
        at, back = np.unique(x, return_inverse=True)
        spent = w * integrated_rate(law, stiffness, BARRIERS[barrier], b, at)[back]
    else:
        a = b * relative_stiffness(stiffness, xi, law.rms / law.scale)
        spent = w * np.exp(BARRIERS[barrier].log_hazard(np.minimum(x, xi), xi, a))
    hot = x < xi * (1 - 1e-9)
    assert 20 < hot.sum() < 380
    np.testing.assert_allclose(spent[hot], -np.log(v[hot]), rtol=1e-6)
    assert np.all(spent[~hot] <= -np.log(v[~hot]) * (1 + 1e-6))


# -----------------------------------------------------------------------------------------------------
# bad input


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"kT": -1.0}, "kT = -1.0: must be a finite number >= 0"),
        ({"kT": math.inf}, "kT = inf"),
        ({"kT": "warm"}, "kT = 'warm'"),
        ({"attempt_frequency": -1.0}, "attempt_frequency = -1.0"),
        ({"attempt_frequency": math.nan}, "attempt_frequency = nan"),
        (
            {"barrier": "hard"},
            'barrier = \'hard\': must be one of "soft", "stiff", "cusp", "bell", "catch-slip"',
        ),
    ],
)
def test_bad_temperature(arguments, message):
    with pytest.raises(InputError) as caught:
        Thermal(**arguments)
    assert message in str(caught.value)


def pooled_stretch(x, G, slopes, greatest, target):
    """The inverse of a table of G."""
    return stretch_of_pool(pooled.Pooled(0.0, x, G, slopes, greatest), target)


def soft_hazard_over(x, way, xi, a):
    """e (H(x) - H(x - way)) of the soft barrier, by Dawson's function, or where E
    changes by less than 1 by the integral of exp(-a s (2 x - s)) over s."""
    z, dz = np.sqrt(a) * x, np.sqrt(a) * way
    less = dz * (2.0 * z - dz)
    found = special.dawsn(z) - np.exp(-less) * special.dawsn(z - dz)
    short = less < 1.0
    nodes, weights = special.roots_legendre(10)
    t = 0.5 * dz[short, None] * (1.0 + nodes)
    integrand = np.exp(-t * (2.0 * z[short, None] - t))
    found[short] = 0.5 * dz[short] * (integrand @ weights)
    return np.exp(1.0 - a * (xi - x) * (xi + x)) * found / np.sqrt(a)


@pytest.mark.parametrize(("law", "error"), [(Soft, 1e-12), (Stiff, 1e-8)])
def test_hazards_over_a_way(law, error):
    """The difference of hazards that any barrier has against closed forms, over ways
    down to 1e-12 of the stretch. Gauss's rule sees the root in the prefactor of a stiff
    barrier from a tenth of the threshold: 1e-8."""
    random = np.random.default_rng(1)
    xi = random.uniform(0.3, 3.0, 10_000)
    x = xi * random.uniform(0.01, 0.9, xi.size)
    way, a = x * 10 ** random.uniform(-12, 0, xi.size), random.uniform(0.2, 20, xi.size)
    exact = law(1.0, 1.0).hazard_over(x, way, xi, a)
    if law is Soft:
        exact = soft_hazard_over(x, way, xi, a)
    found = base.Barrier.hazard_over(law(1.0, 1.0), x, way, xi, a)
    np.testing.assert_allclose(found, exact, rtol=error, atol=0)
