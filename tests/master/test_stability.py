"""Stability of sliding through a spring: closed forms, other quadratures, other
solvers, and the command."""

import json
import math
from dataclasses import replace
from itertools import pairwise

import kicks
import numpy as np
import pytest
from cases import chosen
from command_line import call
from scipy import integrate, optimize, special, stats

from eqsim import (
    Aging,
    Delay,
    Delta,
    Distribution,
    Drive,
    Ensemble,
    Gamma,
    InputError,
    Pathway,
    Programme,
    Segment,
    Stage,
    Table,
    Thermal,
    Weibull,
    fresh_slip,
    reference,
    stability,
    trajectory,
    transient,
)
from eqsim.laws.named import Lognormal, Normal, Pareto, Uniform
from eqsim.master import characteristic
from eqsim.master.stability import critical_stiffness, critical_stiffnesses, pulled_by
from eqsim.model.reduced import pull_of, reduced
from eqsim.model.slip import least_slip

LOGARITHMIC = Aging("logarithmic", beta=0.05, cutoff_time=0.1)
GROWING = Aging("flow", rate=0.05, x_star_final=2.0)
CATCH = Thermal(barrier="catch-slip", catch=Pathway(1.0, 1.0), slip=Pathway(0.01, 4.0))
ABOVE = Ensemble(  # no threshold is less than .35
    Distribution(stats.uniform(0.3545, 0.9315)),
    Thermal(0.2),
    disorder="annealed",
    stiffness_law="uniform",
)


def contacts(n=1.0, tau=0.0, **more):
    return Ensemble(Gamma(n), delay=Delay(tau), **{"stiffness_law": "uniform", **more})


def pulled(stiffness, damping=0.1, mass=0.0, velocity=0.1):
    return Programme(
        (Segment(velocity, time=1.0),), stage=Stage(stiffness, damping, mass)
    )


def loop(ensemble, programme, nodes=characteristic.FINE):
    s = reduced(ensemble, programme.segments[0].velocity)
    return characteristic.loop_of(s, pull_of(ensemble, programme), nodes)


def volterra(n, length, cells):
    """Steepest fall of F and its peak, T = 0, uniform, no delay: the renewal equation
    by the trapezoidal rule, which is of second order, and central differences."""
    x = np.linspace(0.0, length, cells + 1)
    h, survive = x[1], special.gammaincc(n + 1, x**2)
    broken = np.zeros(cells + 1)
    broken[1:] = 2.0 * np.exp(
        (1 + 2 * n) * np.log(x[1:]) - x[1:] ** 2 - special.gammaln(n + 1)
    )
    rate = broken.copy()
    for i in range(1, cells + 1):
        rate[i] += h * (rate[1:i] @ broken[i - 1 : 0 : -1])
    force = x * survive + h * np.convolve(rate, x * survive)[: cells + 1]
    fall = -(force[2:] - force[:-2]) / (2.0 * h)
    top = np.argmax(fall)
    a, b, c = fall[top - 1 : top + 2]
    return b + (a - c) ** 2 / (8.0 * (2.0 * b - a - c)), force.max()


@pytest.mark.parametrize(
    ("law", "n", "critical", "digit"),
    [("uniform", 0, 0.0348, 1e-4), ("uniform", 1, 0.1742, 1e-4), ("uniform", 4, 0.757, 1e-3),
     ("uniform", 20, 2.64, 1e-2), ("uniform", 100, 7.01, 1e-2), ("sqrt", 0, 0.0416, 1e-4), ("sqrt", 1, 0.1740, 1e-4)],
)  # fmt: skip
def test_fresh_slip_known(law, n, critical, digit):
    found = fresh_slip(contacts(n, stiffness_law=law), Drive(0.1))
    assert found.critical_stiffness.value == pytest.approx(critical, abs=digit)
    assert found.critical_stiffness.stderr < 1e-5 * max(critical, 0.1)


@pytest.mark.parametrize(
    ("n", "length", "peak"),
    [
        (0, 3.0, 1.026),
        (1, 3.0, 1.092),
        (4, 4.0, 1.270),
        (20, 6.5, None),
        (100, 12.0, None),
    ],
)
def test_fresh_slip_by_the_trapezoidal_rule(n, length, peak):
    coarse, fine = (np.array(volterra(n, length, cells)) for cells in (1000, 2000))
    fall, most = fine + (fine - coarse) / 3.0
    missed = np.abs(fine - coarse)  # four times what the finer one misses
    found, friction = (
        fresh_slip(contacts(n), Drive(0.1)),
        (n + 1) / (2.0 * special.poch(n + 1, 0.5)),
    )
    assert found.critical_stiffness.value == pytest.approx(
        fall, abs=missed[0] + found.critical_stiffness.stderr
    )
    # the largest of values at edges falls short of the peak by up to curvature h^2/8,
    # curvature below 10 falls
    h = length / 2000
    assert found.peak_ratio.value == pytest.approx(
        most / friction, abs=(missed[1] + 10.0 * fall * h * h) / friction
    )
    if peak:
        assert found.peak_ratio.value == pytest.approx(peak, abs=1e-3)
        assert 1.0 < found.peak_ratio.value < 2.0


@pytest.mark.parametrize("velocity", [0.01, 0.1, 1.0])
def test_fresh_slip_with_heat_along_a_programme(velocity):
    """By the renewal equation in two times: a polynomial through half a threshold to
    either side of the steepest fall, so that its slope is as good as the force over a
    sixth of that."""
    ensemble = contacts(thermal=Thermal(0.1))
    found = fresh_slip(ensemble, Drive(velocity))
    other = transient(ensemble, Programme((Segment(velocity, distance=2.5),)), 501)
    near = np.abs(other.X - found.X.value) < 0.5
    curve = np.polynomial.Polynomial.fit(other.X[near], other.force[near], 8)
    fall = -curve.deriv()(
        np.linspace(found.X.value - 0.2, found.X.value + 0.2, 401)
    ).min()
    missed = other.force_error[near].max() * 6.0 / 0.5
    # quoted errors of the force are largest at a velocity of 0.1: 7e-4
    assert missed < 1e-2
    assert found.critical_stiffness.value == pytest.approx(fall, abs=missed)
    assert found.critical_stiffness.value == pytest.approx(
        {0.01: 0.1445, 0.1: 0.1802, 1.0: 0.1764}[velocity], abs=1e-4
    )


def test_fresh_slip_is_that_of_any_unit():
    found, other = (
        fresh_slip(contacts(), Drive(0.1)),
        fresh_slip(Ensemble(Gamma(1.0, 1e-6), stiffness_law="uniform"), Drive(1e-3)),
    )
    assert other.critical_stiffness.value == pytest.approx(
        found.critical_stiffness.value, abs=1e-9
    )
    assert other.X.value == pytest.approx(1e-6 * found.X.value, abs=1e-14)


# -F' on the left of the greatest threshold of uniform laws, where contacts born since
# have stiffnesses of 1 and .625, and on the right of the least one of a Pareto law, X p
# - S
EDGED = [
    (Uniform(0.9, 1.1), 4.5, 0.9),
    (Uniform(0.5, 1.5), 0.875, 0.625),
    (Pareto(3.5), 2.5, 1.0),
    # kinks where in their cells slopes differ the most from those of two grids
    (Pareto(3.210302702525091), 2.210302702525091, 1.0),
    (Uniform(0.67, 0.787), 0.67 / 0.117, 0.67),
]


@pytest.mark.parametrize(("law", "fall", "peak"), EDGED)
def test_fresh_slip_at_the_edge_of_a_law(law, fall, peak):
    found = fresh_slip(Ensemble(law, stiffness_law="uniform"), Drive(0.1))
    assert found.critical_stiffness.value == pytest.approx(
        fall, abs=found.critical_stiffness.stderr
    )
    assert found.critical_stiffness.stderr < 2e-3 * max(fall, 1.0)
    steady = law.rms**2 / (2.0 * law.mean)
    assert found.peak_ratio.value == pytest.approx(
        peak / steady, abs=found.peak_ratio.stderr
    )
    assert found.peak_ratio.stderr < 1e-5
    assert found.slip_stiffness.value < found.critical_stiffness.value


def test_fresh_slip_at_an_infinite_density():
    """No spring follows, but the jump is no slip behind a stiff one."""
    found = fresh_slip(
        Ensemble(Distribution(stats.beta(0.5, 0.5)), stiffness_law="uniform"),
        Drive(0.1),
    )
    assert math.isinf(found.critical_stiffness.value)
    assert found.X.value == pytest.approx(1.0, abs=found.X.stderr)
    assert 1.0 < found.slip_stiffness.value < 2.0


@pytest.mark.parametrize(
    ("law", "exact"),
    # F falls from 1 to the smallest slip; from .65 to .15 over it, at 1.1
    [(Delta(), (1.0 - 0.005) / 0.005), (Table([0.9, 1.1]), (0.65 - 0.15) / 0.05)],
)
def test_steps_that_are_slips(law, exact):
    found = fresh_slip(Ensemble(law, stiffness_law="uniform"), Drive(0.1))
    assert found.slip_stiffness.value == pytest.approx(
        exact, abs=found.slip_stiffness.stderr
    )
    assert found.slip_stiffness.stderr < 0.03 * exact
    assert found.critical_stiffness == found.slip_stiffness


@pytest.mark.parametrize("count", [12, 500])
@pytest.mark.parametrize("law", [Gamma(20.0), Lognormal(0.9)])
def test_a_table_slips_as_the_law_that_it_samples(law, count):
    """Quantiles: the break of one changes the force by at most the greatest over their
    number, and a slope over the smallest slip by that over its length, half of which is
    allowed besides for what follows from it."""
    steps = law.inverse_survival(-np.log((np.arange(count) + 0.5) / count))
    table, smooth = (
        fresh_slip(Ensemble(one, stiffness_law="uniform"), Drive(0.1))
        for one in (Table(steps), law)
    )
    allowed = 1.5 * steps.max() / count / least_slip(law)
    assert table.critical_stiffness == table.slip_stiffness
    assert table.slip_stiffness.value == pytest.approx(
        smooth.slip_stiffness.value, abs=allowed
    )


SLIPPING = [
    (Table([0.9, 1.1]), 2.0, "slips"), (Table([0.9, 1.1]), 40.0, "slides"), (Uniform(0.9, 1.1), 1.0, "slips"),
    (Uniform(0.9, 1.1), 12.0, "slides"), (Table(np.random.default_rng(5).lognormal(0.0, 0.9, 500)), 0.3, "slides"),
    (Lognormal(0.9), 0.3, "slides"), (Uniform(0.9, 1.1), 4.45, "jumps"),
]  # fmt: skip


@pytest.mark.parametrize(("law", "stiffness", "verdict"), SLIPPING)
def test_simulated_contacts_slip_as_the_mean_field_says(law, stiffness, verdict):
    """20 000 of them, behind a stage that moves by two thresholds."""
    ensemble = Ensemble(law, stiffness_law="uniform", count=20_000)
    stage = Stage(stiffness)
    found = stability(ensemble, Programme((Segment(0.1, time=1.0),), stage=stage))
    assert (found.fresh_verdict, found.fresh_slips) == (verdict, verdict == "slips")
    way = law.mean * (2.0 + 1.2 / stiffness)
    run = trajectory(
        ensemble, Programme((Segment(0.1, distance=way),), stage=stage), points=400
    )
    if verdict != "jumps":
        assert bool(run.slips) == (verdict == "slips")


def test_a_verdict_that_errors_do_not_decide():
    """Negative control of `fresh_verdict`: within two errors of a border it says so."""
    found = stability(contacts(), pulled(0.1))
    slip = found.fresh.slip_stiffness
    near = replace(found, stiffness=slip.value + 0.5 * slip.stderr)
    assert near.fresh_verdict == "undecided"
    assert (
        replace(found, stiffness=slip.value - 3.0 * slip.stderr).fresh_verdict
        == "slips"
    )


def test_no_fresh_slip():
    """Thresholds so different that friction only rises: the sum of many steps is
    smooth."""
    found = fresh_slip(
        Ensemble(Distribution(stats.lognorm(0.9)), stiffness_law="uniform"), Drive(0.1)
    )
    assert (found.critical_stiffness.value, found.X.value) == (0.0, None)
    assert found.peak_ratio.value == pytest.approx(1.0, abs=found.peak_ratio.stderr)


def impedance(p, velocity, tau, damping, law="uniform", eta=0.0):
    """eta_s p + Z(p) of gamma contacts with n = 1 and a fixed delay, from J_c = (1 +
    x^2) exp(-x^2) by `quad`."""
    q = p / velocity

    def transform(f):
        def part(which):
            return integrate.quad(
                lambda x: which(np.exp(-q * x) * f(x)), 0, 9, epsabs=1e-12, limit=400
            )[0]

        return complex(part(np.real), part(np.imag))

    def stiff(x):  # E[k_i/k; xi > x], k_i/k = xi/sqrt(2)
        if law == "uniform":
            return (1.0 + x * x) * np.exp(-x * x)
        return special.gamma(2.5) * special.gammaincc(2.5, x * x) / math.sqrt(2.0)

    P, M = (
        transform(lambda x: 2.0 * x**3 * np.exp(-x * x)),
        transform(lambda x: x * stiff(x)),
    )
    D, beta = np.exp(-p * tau), 1.0 / (special.gamma(2.5) + velocity * tau)
    elastic = -beta * q * M * (1.0 - D) / (1.0 - D * P)
    detached = (
        velocity * beta * (1.0 - D) * (1.0 - P) / (1.0 - D * P)
        + p * velocity * tau * beta
    )
    return damping * p + elastic + eta * detached


# uniform and sqrt, n = 1: V, tau, and kappa_c for eta_s = 0, .01, .1
BORDERS = [
    ("uniform", 0.1, 1.0, (0.15000, 0.14976, 0.14169)),
    ("uniform", 0.1, 3.0, (0.43046, 0.42947, 0.41890)),
    ("uniform", 1.0, 1.0, (1.13877, 1.12245, 0.91300)),
    ("sqrt", 0.1, 1.0, (0.14178, 0.14135, 0.13320)),
]


@chosen(("law", "velocity", "tau", "values"), BORDERS, [BORDERS[0], BORDERS[3]])
def test_border(law, velocity, tau, values):
    """It solves the equation by another quadrature, and has one pair of roots with Re p
    > 0 below and none above."""
    for damping, value in zip((0.0, 0.01, 0.1), values, strict=True):
        ensemble, programme = (
            contacts(tau=tau, stiffness_law=law),
            pulled(0.1, damping, velocity=velocity),
        )
        assert critical_stiffness(
            pulled_by(ensemble, programme)
        ).value == pytest.approx(value, abs=1e-5)
        fine, scan = (
            loop(ensemble, programme),
            loop(ensemble, programme, characteristic.SCAN),
        )
        found = characteristic.border_of(fine, scan)
        exact = found.stiffness + impedance(
            1j * found.frequency * velocity, velocity, tau, damping, law
        )
        assert abs(exact) < 1e-9
        assert unstable(scan, 1.01 * found.stiffness) == 0
        assert unstable(scan, 0.99 * found.stiffness) == 2


def impedance_of_pareto(w, exponent, law, tau, shape):
    """Z(i w) at velocity 1, from the means of xi^s exp(-i w xi) along the contour xi = 1
    - i y/w, on which they decay, by the trapezoidal rule in ln y."""
    points = np.linspace(-40.0, 5.0, 300)
    y, q = np.exp(points), 1j * w[:, None]
    means = [
        np.exp(-q) / q * y * np.exp(-y) * exponent * (1.0 + y / q) ** (s - exponent - 1)
        for s in range(3)
    ]
    E = [mean.sum(axis=1) * (points[1] - points[0]) for mean in means]
    q = 1j * w
    mean, rms = exponent / (exponent - 1.0), math.sqrt(exponent / (exponent - 2.0))
    sqrt = (mean - E[1] - q * E[2]) / (q**2 * rms)
    M = sqrt if law == "sqrt" else (1.0 - E[0] - q * E[1]) / q**2
    D = np.exp(-q * tau) if shape == "fixed" else 1.0 / (1.0 + q * tau)
    return -q * M * (1.0 - D) / (1.0 - D * E[0]) / (mean + tau)


@pytest.mark.parametrize(
    ("exponent", "law", "tau", "shape"),
    # delays much shorter than the least threshold resonate with its harmonics
    [
        (3.1, "sqrt", 0.05, "exponential"),
        (3.7, "uniform", 0.08, "fixed"),
        (3.8, "sqrt", 1.2, "fixed"),
        (5.5, "uniform", 0.0095, "exponential"),
    ],
)
def test_border_of_heavy_tails(exponent, law, tau, shape):
    """Rare thresholds many periods long, without damping: the greatest -Re Z where Im Z
    = 0."""

    def Z(w):
        return impedance_of_pareto(np.atleast_1d(w), exponent, law, tau, shape)

    w = np.arange(0.02, 120.0, 0.02)
    phase = Z(w).imag
    roots = [
        optimize.brentq(lambda w: Z(w)[0].imag, w[i], w[i + 1], xtol=1e-14)
        for i in np.flatnonzero(phase[:-1] * phase[1:] < 0.0)
    ]
    ensemble = Ensemble(Pareto(exponent), delay=Delay(tau, shape), stiffness_law=law)
    programme = pulled(0.1, 0.0, velocity=1.0)
    found = critical_stiffness(pulled_by(ensemble, programme))
    assert abs(found.value + Z(np.array(roots)).real.min()) < found.stderr
    assert found.stderr < 1e-8


@pytest.mark.verification
def test_short_delays_resonate_with_both_edges_of_a_law():
    """The greatest -Re Z where Im Z = 0, at the third resonance, by a scan of a wide
    range."""
    ensemble = Ensemble(
        Uniform(0.216, 1.784), delay=Delay(0.0057), stiffness_law="uniform"
    )
    programme = pulled(0.1, 0.0, velocity=1.0)
    found = critical_stiffness(pulled_by(ensemble, programme))
    w = np.arange(0.01, 60.0, 0.005)
    Z = loop(ensemble, programme).response(1j * w * ensemble.thresholds.scale)
    roots = np.flatnonzero(Z.imag[:-1] * Z.imag[1:] < 0.0)
    most = float((-Z.real[roots]).max())
    step = float(np.abs(np.diff(Z.real)).max())
    assert step < 1e-4
    assert found.value == pytest.approx(most, abs=step)


def unstable(fine, stiffness, beyond=0.0):
    """How many roots have Re p > beyond, by the argument principle: around the upper
    half of a large box, where the equation is real on the real axis."""
    size = 40.0
    right, top = (
        size + 1j * np.linspace(0.0, size, 200),
        np.linspace(size, beyond, 200) + 1j * size,
    )
    path = np.concatenate((right, top, beyond + 1j * np.linspace(size, 1e-6, 4000)))
    angle = np.unwrap(np.angle(fine.balance(path, stiffness)))
    return round((angle[-1] - angle[0]) / math.pi)


ROOTS = [
    (0.05, 0.12938 + 0.18667j), (0.1, 0.04272 + 0.27538j), (0.12, 0.01970 + 0.28924j), (0.17, -0.01975 + 0.30822j),
    (0.3, -0.06785 + 0.32832j),
]  # fmt: skip


@pytest.mark.parametrize(("stiffness", "root"), ROOTS)
def test_roots(stiffness, root):
    found = stability(contacts(tau=1.0), pulled(stiffness))
    assert found.growth.value == pytest.approx(root.real, abs=6e-6)
    assert 2.0 * math.pi / found.period.value == pytest.approx(root.imag, abs=6e-6)
    assert found.verdict == ("unstable" if root.real > 0 else "stable")
    assert (stiffness < found.critical_stiffness.value) == (root.real > 0)


@pytest.mark.verification
def test_no_root_is_missed():
    """None has a larger real part than the one found, which has."""
    for tau, stiffness, damping, mass in (
        (1.0, 0.1, 0.1, 0.0),
        (1.0, 0.02, 0.3, 0.0),
        (20.0, 0.5, 0.1, 0.5),
        (5.0, 0.3, 1.0, 3.0),
    ):
        fine = loop(
            contacts(tau=tau), pulled(stiffness, damping, mass), characteristic.SCAN
        )
        p = characteristic.root_of(fine, fine, stiffness)
        margin = 1e-3 * abs(p)
        pair = 2 if p.imag > 0 else 1
        assert (
            unstable(fine, stiffness, p.real + margin),
            unstable(fine, stiffness, p.real - margin),
        ) == (0, pair)


def roots_beyond(characteristic_loop, stiffness, beyond):
    """How many roots have Re p > beyond and no more than 10 periods per cycle, by the
    argument principle: the winding of the equation, and that of 1 - D P, whose zeros
    are its poles but for p = 0."""
    top, cycle = 20.0 * math.pi / characteristic_loop.cycle, characteristic_loop.cycle
    corners = [40.0 / cycle, 40.0 / cycle + 1j * top, beyond + 1j * top, beyond]
    corners[3] += 1e-6j * top  # the root of 1 - D P is within
    share = np.linspace(0.0, 1.0, 8000)
    p = np.concatenate(
        [first + (last - first) * share for first, last in pairwise(corners)]
    )
    P = np.exp(-p[:, None] * characteristic_loop.xi) @ characteristic_loop.share
    poles = (1.0 - np.exp(-p * characteristic_loop.delay.mean) * P) / p
    path = characteristic_loop.balance(p, stiffness) * poles
    angle = np.unwrap(np.angle(path))
    assert np.abs(np.diff(angle)).max() < 1.5  # below pi, or turns are lost
    return round((angle[-1] - angle[0]) / math.pi)


# V, thresholds, law of stiffnesses, mass; kappa_s over the critical one; growth, which
# was followed in kappa_s from that on the border
STIFF = [
    (10.0, Gamma(1.0), "sqrt", 0.0, 2.1, -0.0160),
    (10.0, Gamma(1.0), "sqrt", 0.0, 12.0, -0.0289),
    (1.0, Gamma(1.0), "sqrt", 0.0, 40.0, -0.362),
    (1.0, Normal(0.2), "sqrt", 0.0, 3.6, -0.070),
    (3.0, Gamma(1.0), "sqrt", 0.05, 2.1, -0.105),
    (3.0, Gamma(1.0), "sqrt", 0.05, 40.0, -0.169),
    (3.0, Gamma(1.0), "uniform", 0.0, 3.6, -0.123),
    (3.0, Gamma(1.0), "sqrt", 0.0, 1e5, -0.1714),  # the pole, D P = 1
]


@pytest.mark.parametrize(
    ("velocity", "law", "stiffness_law", "mass", "factor", "growth"), STIFF
)
def test_slowest_root_behind_a_stiff_spring(
    velocity, law, stiffness_law, mass, factor, growth
):
    """It is next to a pole of Z, and no other is slower."""
    ensemble = Ensemble(law, delay=Delay(1.0), stiffness_law=stiffness_law)
    soft = pulled_by(ensemble, pulled(1.0, 0.03, mass, velocity))
    stiffness = factor * critical_stiffness(soft).value
    drive = pulled(stiffness, 0.03, mass, velocity)
    found = stability(ensemble, drive, critical=False)
    digit = 10.0 ** -len(str(growth).split(".")[1])
    assert found.growth.value == pytest.approx(growth, rel=0, abs=digit)
    if factor > 1e3 or velocity > 3.0:
        return
    p = found.growth.value * law.scale / velocity
    scan = loop(ensemble, drive, characteristic.SCAN)
    margin = 0.1 * abs(p)
    counts = [roots_beyond(scan, stiffness, p + side) for side in (margin, -margin)]
    assert counts == [0, 2]


def test_viscosity_of_detached_contacts():
    fine = loop(contacts(tau=1.0, eta=0.5), pulled(0.12))
    for p in (0.02 + 0.3j, 0.2 + 0.1j, -0.01 + 1.0j):
        ours = fine.damping * p / 0.1 + fine.response(np.array([p / 0.1]))[0]
        assert ours == pytest.approx(impedance(p, 0.1, 1.0, 0.1, eta=0.5), abs=1e-9)


def test_a_wrong_rate_of_births_is_seen():
    fine = loop(contacts(tau=1.0), pulled(0.12), characteristic.SCAN)
    wrong = fine._replace(beta=1.0 / special.gamma(2.5))
    assert (
        abs(
            characteristic.root_of(wrong, wrong, 0.12)
            - characteristic.root_of(fine, fine, 0.12)
        )
        > 1e-3
    )


def test_identical_contacts():
    """P = exp(-q), M = (1 - (1 + q) exp(-q))/q^2 and D = 1/(1 + p tau)."""
    fine = loop(Ensemble(Delta(), delay=Delay(2.0, "exponential")), pulled(0.1))
    for q in (0.1 + 3.0j, 1e-3 + 1e-4j, 12.0j):
        P, M, D = (
            np.exp(-q),
            (1.0 - (1.0 + q) * np.exp(-q)) / q**2,
            1.0 / (1.0 + 0.2 * q),
        )
        exact = -q * M * (1.0 - D) / (1.0 - D * P) / 1.2
        # rounding of 1 - (1 + q) exp(-q), over q^2
        assert fine.response(np.array([q]))[0] == pytest.approx(
            exact, abs=1e-14 + 1e-15 / abs(q)
        )
    found = stability(Ensemble(Delta(), delay=Delay(2.0, "exponential")), pulled(0.1))
    assert found.fresh_slips
    with pytest.raises(InputError, match="identical contacts with a fixed delay"):
        stability(Ensemble(Delta(), delay=Delay(2.0)), pulled(0.1))


def test_many_equal_steps_are_a_smooth_law():
    """Table of quantiles: means over 2000 of them miss 1/2000 of a threshold's spread
    at most."""
    steps = Gamma(1.0).inverse_survival(-np.log((np.arange(2000) + 0.5) / 2000))
    table = Ensemble(
        Table(steps), delay=Delay(1.0, "exponential"), stiffness_law="uniform"
    )
    smooth = Ensemble(
        Gamma(1.0), delay=Delay(1.0, "exponential"), stiffness_law="uniform"
    )
    found, exact = (
        critical_stiffness(pulled_by(one, pulled(0.1))).value for one in (table, smooth)
    )
    assert found == pytest.approx(exact, abs=5e-4 * exact)


@pytest.mark.verification
def test_limit_of_short_delays():
    """kappa_c is of first order in tau: D = 1 - p tau, Z = -beta_0 q M p tau/(1 - P)."""
    short, shorter = (
        critical_stiffness(pulled_by(contacts(tau=tau), pulled(0.1, 0.0))).value
        for tau in (2e-4, 1e-4)
    )
    assert 0.0 < shorter < 1e-4
    assert short / shorter == pytest.approx(2.0, abs=1e-3)


def test_without_delay_it_is_neutral():
    found = stability(contacts(), pulled(0.1))
    assert (found.verdict, found.growth.value, found.critical_stiffness.value) == (
        "neutral",
        0.0,
        0.0,
    )
    assert found.fresh_slips
    assert not stability(contacts(), pulled(0.2)).fresh_slips


def test_mass():
    """Without damping a slider resonates with the delay, on any spring; with it the
    border is where roots say."""
    assert math.isinf(
        critical_stiffness(pulled_by(contacts(tau=1.0), pulled(0.1, 0.0, 1.0))).value
    )
    ensemble, programme = contacts(tau=1.0), pulled(0.1, 0.1, 0.3)
    kappa = critical_stiffness(pulled_by(ensemble, programme)).value
    rates = [
        stability(ensemble, pulled(part * kappa, 0.1, 0.3)).growth.value
        for part in (0.999, 1.001)
    ]
    assert rates[0] > 0.0 > rates[1]


@pytest.mark.verification
@pytest.mark.parametrize(
    ("stiffness", "eta", "mass", "period"),
    [
        (0.17, 0.0, 0.0, 20.37),
        pytest.param(0.12, 0.0, 0.0, 21.72, marks=pytest.mark.verification),
        pytest.param(0.3, 0.0, 0.0, 19.14, marks=pytest.mark.verification),
        pytest.param(0.12, 0.5, 0.3, 24.61, marks=pytest.mark.verification),
    ],
)
def test_kicks(stiffness, eta, mass, period):
    """In mean field perturbations grow or decay as the characteristic equation says."""
    ensemble = contacts(tau=1.0, eta=eta)
    exact, found = (
        stability(ensemble, pulled(stiffness, mass=mass)),
        kicks.mode_of(ensemble, 0.1, Stage(stiffness, 0.1, mass)),
    )
    assert found.growth.reliable
    assert found.growth.value == pytest.approx(
        exact.growth.value, abs=2.0 * found.growth.stderr
    )
    assert found.growth.stderr < 0.1 * abs(exact.growth.value)
    assert found.period.value == pytest.approx(
        exact.period.value, abs=2.0 * found.period.stderr
    )
    assert found.period.value == pytest.approx(period, abs=0.05)


@pytest.mark.verification
def test_border_by_kicks():
    ensemble = contacts(tau=1.0)
    found = kicks.border_by_kicks(ensemble, 0.1, Stage(0.12, 0.1))
    assert found.value == pytest.approx(0.1416883, abs=2.0 * found.stderr)
    assert found.stderr < 0.02 * found.value


@pytest.mark.verification
def test_heat_stabilises():
    """Contacts that heat breaks, too, strengthen with velocity: no delay, no
    instability."""
    found = stability(contacts(thermal=Thermal(0.1)), pulled(0.17))
    assert (found.verdict, found.critical_stiffness.value) == ("stable", 0.0)
    friction = [
        reference(contacts(thermal=Thermal(0.1)), Drive(v)).friction.value
        for v in (0.1, 0.2)
    ]
    assert friction[1] > friction[0]


# Critical stiffnesses without damping, found by another program, to its last digits; at
# V = .1 annealed contacts are never unstable.
WARM_BORDERS = [
    ("annealed", 0.1, 0.0),
    ("annealed", 0.3, 0.222236),
    ("annealed", 1.0, 0.967351),
    ("quenched", 0.1, 0.141571),
    ("quenched", 0.3, 0.410630),
]


@chosen(("disorder", "velocity", "known"), WARM_BORDERS, WARM_BORDERS[1::2])
def test_border_with_heat(disorder, velocity, known):
    warm = contacts(tau=1.0, thermal=Thermal(0.1), disorder=disorder)
    found = critical_stiffness(pulled_by(warm, pulled(0.1, 0.0, velocity=velocity)))
    assert found.value == pytest.approx(known, abs=3e-6)
    assert found.stderr < 1e-6


@chosen(
    ("stiffness", "root"),
    [(0.129289, 0.081381 + 0.62847j), (0.2, -0.008875 + 0.727697j),
     (0.270711, -0.073198 + 0.786685j)],
    [],
)  # fmt: skip
def test_roots_with_heat(stiffness, root):
    """The modes of a ring of 8 blocks, known from another program."""
    warm = contacts(tau=1.0, thermal=Thermal(0.1), disorder="annealed")
    found = stability(warm, pulled(stiffness, 0.05, velocity=0.3), critical=False)
    assert found.growth.value == pytest.approx(root.real, abs=3e-6)
    assert 2.0 * math.pi / found.period.value == pytest.approx(root.imag, abs=3e-6)


def test_slow_perturbations_follow_the_steady_force():
    """Z/p -> dF/dV, by differences of the reference, whose error is of second order in
    their step; also where thresholds grow. The error of Z is that which is quoted."""
    for warm in (
        contacts(tau=1.0, thermal=Thermal(0.1)),
        contacts(thermal=Thermal(0.1), aging=LOGARITHMIC),
        contacts(aging=LOGARITHMIC, stiffness_law="sqrt"),
        contacts(tau=1.0, aging=GROWING, stiffness_law="sqrt"),
        ABOVE,
        *(
            contacts(tau=1.0, thermal=heat, aging=aging)
            for heat in (Thermal(0.2, barrier="stiff"), Thermal(0.2, barrier="cusp"))
            for aging in (LOGARITHMIC, GROWING)
        ),
        contacts(thermal=CATCH, aging=LOGARITHMIC),
    ):
        p, h = 1e-6, 1e-3
        # V = 1 in the units of the equation, the law's scale is that of lengths
        slope, coarse = (
            loop(warm, pulled(0.1), nodes).response(np.array([p]))[0].real
            / p
            * warm.thresholds.scale
            for nodes in (characteristic.FINE, characteristic.COARSE)
        )
        up, down = (
            reference(warm, Drive(0.1 * math.exp(step))).friction for step in (h, -h)
        )
        missed = (up.stderr + down.stderr) / (2.0 * h) + 1e-5
        missed += characteristic.OF_COARSER * abs(slope - coarse)  # as it is quoted
        assert (up.value - down.value) / (2.0 * h) == pytest.approx(slope, abs=missed)


@pytest.mark.verification
def test_panels_of_ages_resolve_the_period():
    """Perturbations that heat breaks decay without a period."""
    found = stability(ABOVE, pulled(0.1, damping=0.0), critical=False)
    assert found.growth.reliable
    assert found.period.value is None
    assert found.growth.stderr < 1e-4
    assert found.growth.value < 0.0


# Heat breaks these long before their thresholds; all slide steadily.
HOT = {
    "narrow, hot": (
        {"thresholds": Normal(0.2), "thermal": Thermal(0.241)},
        pulled(0.00953, damping=0.0, velocity=1.8),
    ),
    "slow": (
        {
            "thresholds": Uniform(0.5, 1.5),
            "thermal": Thermal(0.435),
            "stiffness_law": "sqrt",
        },
        pulled(0.00329, damping=1.0, velocity=0.0288),
    ),
    "delayed": (
        {
            "thresholds": Weibull(2.1232),
            "thermal": Thermal(0.0181),
            "delay": Delay(0.4845),
        },
        pulled(0.238, damping=0.0, velocity=0.0262),
    ),
}


@pytest.mark.parametrize("case", HOT)
def test_perturbations_that_panels_of_ages_do_not_resolve(case):
    """Growth within a panel of ages changes Z little: Z is within 2e-3 of that of eight
    times as many panels where exp(p a) changes by any factor in a panel. Polynomials
    miss 2e-2 where it changes by exp(14), and 1e3 where by exp(30)."""
    changed, drive = HOT[case]
    ensemble = Ensemble(**{"stiffness_law": "uniform", **changed}, disorder="annealed")
    usual = loop(ensemble, drive, characteristic.Nodes(64, 8.2, 14))
    better = loop(ensemble, drive, characteristic.Nodes(64, 8.2, 112))
    sizes = np.geomspace(1.0, 60.0, 12) / usual.lives.width.max()
    p = np.append(sizes, sizes * np.exp(0.25j * np.pi))
    assert np.abs(usual.response(p) - better.response(p)).max() < 2e-3


@pytest.mark.verification
@pytest.mark.parametrize("case", ["narrow, hot", "slow", "delayed"])
def test_perturbations_that_do_not_exist(case):
    """A slider that no spring, however soft, makes unstable has no growing perturbation,
    and the slowest is that of eight times as many panels of ages."""
    changed, drive = HOT[case]
    ensemble = Ensemble(**{"stiffness_law": "uniform", **changed}, disorder="annealed")
    found = stability(ensemble, drive)
    assert found.critical_stiffness.value == 0.0
    assert found.verdict == "stable"
    assert found.growth.reliable
    better = loop(ensemble, drive, characteristic.Nodes(64, 8.2, 112))
    rate = found.velocity / ensemble.thresholds.scale
    near = np.array([found.growth.value / rate + 0j])
    root = characteristic.roots_from(better, near, found.stiffness)[0] * rate
    assert abs(root - found.growth.value) < found.growth.stderr


@pytest.mark.verification
@pytest.mark.parametrize(
    ("more", "stiffness"),
    [
        ({"tau": 1.0, "thermal": Thermal(0.1)}, 0.1),
        ({"tau": 1.0, "thermal": Thermal(0.1), "stiffness_law": "sqrt"}, 0.2),
        ({"tau": 0.5, "aging": LOGARITHMIC}, 0.15),
        ({"tau": 0.5, "aging": LOGARITHMIC, "thermal": Thermal(0.05)}, 0.1),
    ],
)
def test_kicks_with_heat_and_age(more, stiffness):
    ensemble = contacts(**more)
    exact = stability(ensemble, pulled(stiffness), critical=False)
    found = kicks.mode_of(ensemble, 0.1, Stage(stiffness, 0.1))
    assert found.growth.reliable
    assert found.growth.value == pytest.approx(
        exact.growth.value, abs=2.0 * found.growth.stderr + exact.growth.stderr
    )
    assert found.growth.stderr < 0.2 * abs(exact.growth.value)
    assert found.period.value == pytest.approx(
        exact.period.value, abs=2.0 * found.period.stderr
    )


@pytest.mark.parametrize(
    ("ensemble", "programme", "said"),
    [
        (contacts(), Drive(0.1), "drive.stage: is required"),
        (contacts(), Programme((Segment(0.1, time=1.0),)), "drive.stage: is required"),
        (
            contacts(),
            Programme((Segment(0.1, time=1.0),) * 2, stage=Stage(0.1)),
            "one constant velocity > 0",
        ),
        (
            contacts(),
            Programme((Segment(0.0, time=1.0),), stage=Stage(0.1)),
            "one constant velocity > 0",
        ),
        (
            contacts(),
            Programme((Segment(-0.1, time=1.0),), stage=Stage(0.1)),
            "one constant velocity > 0",
        ),
        (
            contacts(aging=Aging("langevin", rate=0.1, x_star_final=2.0)),
            pulled(0.1),
            "langevin",
        ),
        (
            contacts(
                aging=Aging("flow", rate=0.1, x_star_final=2.0), disorder="annealed"
            ),
            pulled(0.1),
            "aging",
        ),
        (
            contacts(tau=1.0),
            pulled(0.1, 1e-9, 1.0),
            "damping is too small beside its mass",
        ),
        (contacts(tau=1e6), pulled(0.1), "delay.time: is 7.52e.04 thresholds long"),
    ],
)
def test_errors(ensemble, programme, said):
    with pytest.raises(InputError, match=said):
        stability(ensemble, programme)


def test_border_over_velocity():
    found = critical_stiffnesses(pulled_by(contacts(tau=1.0), pulled(0.1)), [0.1, 1.0])
    assert found["critical_stiffness"] == pytest.approx(
        np.array([0.14169, 0.91300]), abs=1e-5
    )
    assert np.all(found["fresh_critical_stiffness"] > 0.17)
    fresh = critical_stiffnesses(
        pulled_by(contacts(tau=1.0), pulled(0.1)), [0.1], critical=False
    )
    assert np.isnan(fresh["critical_stiffness"][0])
    assert fresh["fresh_critical_stiffness"][0] == found["fresh_critical_stiffness"][0]
    with pytest.raises(InputError, match="velocity = "):
        critical_stiffnesses(pulled_by(contacts(tau=1.0), pulled(0.1)), [0.0])


RUN = """
[contacts]
stiffness_law = "uniform"
[delay]
time = 1.0
[drive]
velocity = 0.1
distance = 5.0
[drive.stage]
stiffness = 0.1
damping = 0.1
"""


def command(*arguments):
    """Exit code, standard output and error of `eqsim`."""
    done = call(*arguments)
    return done.exit_code, done.stdout, done.stderr


def test_command(tmp_path):
    (tmp_path / "run.toml").write_text(RUN)
    code, out, _ = command(
        "stability", tmp_path / "run.toml", "--json", "--out", tmp_path / "out"
    )
    found = json.loads(out)
    assert code == 0
    assert found["verdict"] == "unstable"
    assert found["fresh_slips"] is True
    assert found["critical_stiffness"]["value"] == pytest.approx(0.1416883, abs=1e-7)
    assert found["growth"]["value"] == pytest.approx(0.04272, abs=6e-6)
    assert {path.name for path in (tmp_path / "out").iterdir()} == {
        "summary.json",
        "stability.png",
        "border.parquet",
    }
    assert command("replay", tmp_path / "out" / "border.parquet", "--quiet")[0] == 0
    code, out, _ = command(
        "stability", tmp_path / "run.toml", "--set", "drive.stage.stiffness=0.17"
    )
    assert code == 0
    assert "stable" in out
    assert "0.14168831" in out
    assert "yours is kappa_s = 0.17: it slips at its start" in out
    assert command(
        "stability", tmp_path / "run.toml", "--quiet", "--set", "delay.time=0"
    ) == (0, "", "")
    for change, said in (
        ("aging.rule=langevin", "aging."),
        ("drive.stage.stiffness=-1", "drive.stage.stiffness"),
        ("thresholds.law=delta", "identical contacts"),
    ):
        code, out, error = command("stability", tmp_path / "run.toml", "--set", change)
        assert (code, out, error.count("\n")) == (2, "", 1)
        assert said in error


@chosen("log_rate", [5.0, 60.0], [60.0])
def test_heat_that_breaks_contacts_long_before_a_slip(log_rate):
    """The force of a fresh start is level within less than a slip, and does not fall."""
    hot = Ensemble(Gamma(1.0), Thermal(kT=2.0, attempt_frequency=math.exp(log_rate)))
    found = stability(hot, pulled(0.1, damping=0.0, velocity=1.0), critical=False)
    assert found.fresh.slip_stiffness.value == pytest.approx(0.0, abs=1e-9)
    assert not found.fresh_slips
