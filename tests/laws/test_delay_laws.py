"""Delays by the gamma and the lognormal law: formulas against SciPy and mpmath, draws
of kernels, and the engine beside exact transients. Values of pinned shares are those of
the Laplace transform 1/(s + k_off (1 - w(s))), inverted by mpmath."""

import math
import warnings
from dataclasses import replace

import mpmath
import numpy as np
import pytest
import scipy.stats
from cases import chosen
from kernels import compiled
from scipy import integrate

from eqsim import (
    Delay,
    Delta,
    Drive,
    Ensemble,
    Exponential,
    InputError,
    Programme,
    Segment,
    Stage,
    Thermal,
    Weibull,
    fit,
    fluctuations,
    reference,
    stability,
    trajectory,
    transient,
)
from eqsim.laws import delay
from eqsim.laws.delay import GammaDelay, LognormalDelay, begun_at

MEAN = 2.5
LAWS = [
    *[GammaDelay(MEAN, shape) for shape in (0.1, 1.0, 4.0, 1000.0)],
    *[LognormalDelay(MEAN, sigma) for sigma in (0.03, 0.5, 2.0)],
]
UNIFORMS = np.append(np.random.default_rng(4).random(2000), [1e-18, 1e-9, 1 - 1e-9])


def scipy_law(law):
    if isinstance(law, GammaDelay):
        return scipy.stats.gamma(law.shape, scale=law.mean / law.shape)
    scale = law.mean * math.exp(-0.5 * law.shape**2)
    return scipy.stats.lognorm(law.shape, scale=scale)


@pytest.mark.parametrize("law", LAWS)
def test_formulas(law):
    """To rounding; the rest of a delay is the integral of its tail (renewal theory)."""
    known = scipy_law(law)
    t = MEAN * np.array([0.0, 1e-3, 0.3, 0.97, 1.0, 1.02, 2.0, 8.0])
    np.testing.assert_allclose(law.cdf(t), known.cdf(t), rtol=1e-9, atol=1e-15)
    assert law.variance == pytest.approx(known.var(), rel=1e-12, abs=0)
    for x in t[1:6]:
        cuts = [point for point in known.isf([0.99, 0.5, 0.01]) if point < x]
        tail = integrate.quad(known.sf, 0, x, points=cuts or None, epsabs=1e-13)[0]
        share = float(law.residual_cdf(x))
        assert share == pytest.approx(tail / MEAN, rel=1e-9, abs=0)
        rest = float(law.rest(np.array([x]))[0])
        assert rest == pytest.approx(MEAN - tail, rel=1e-9, abs=1e-12)
    waiting = law.waiting(0.1, 40)
    np.testing.assert_allclose(
        waiting, -np.diff(law.rest(0.1 * np.arange(41))) / 0.1, rtol=0, atol=1e-13
    )


@pytest.mark.verification
@pytest.mark.parametrize("p", [1e-5, 0.3, 0.1j, 0.2 + 5j])
@pytest.mark.parametrize("law", LAWS)
def test_laplace_transform(law, p):
    """1 - E[exp(-p delay)], beside the closed form of the gamma law, and beside a sum
    over a normal variable, which sigma = 2 needs more nodes for than are worth it."""
    with mpmath.workdps(25):
        if isinstance(law, GammaDelay):
            known = 1 - (1 + mpmath.mpc(p) * MEAN / law.shape) ** (-law.shape)
        elif law.shape > 1.0 and abs(p) > 0.01:
            pytest.skip("the sum does not converge")
        else:
            h, nodes = mpmath.mpf(1) / 200, range(-2400, 2401)
            known = h * sum(
                mpmath.npdf(h * i)
                * -mpmath.expm1(
                    -mpmath.mpc(p)
                    * MEAN
                    * mpmath.exp(law.shape * h * i - mpmath.mpf(law.shape) ** 2 / 2)
                )
                for i in nodes
            )
    found = complex(law.forgotten(np.array([p]))[0])
    assert abs(found - complex(known)) < 1e-9 * abs(complex(known))


@pytest.mark.parametrize("law", LAWS)
def test_draws(law):
    """A uniform is the share of longer delays: to 1e-5, the error of the steepest
    table, and to 1e-7 of the share that kernels interpolate."""
    draw, rest = compiled(delay.delay_draw), compiled(delay.residual_delay_draw)
    waits = law.for_kernels()
    assert waits.law == law
    drawn = np.array([draw(waits, u) for u in UNIFORMS])
    np.testing.assert_allclose(drawn, scipy_law(law).isf(UNIFORMS), rtol=1e-5)
    drawn = np.array([rest(waits, u) for u in UNIFORMS])
    assert np.abs(1 - law.residual_cdf(drawn) - UNIFORMS).max() < 1e-7


@pytest.mark.parametrize("law", LAWS)
def test_share_that_kernels_interpolate(law):
    """The residual share between knots, to 1e-7, and 1 beyond the last."""
    at, waits = compiled(begun_at), law.for_kernels()
    for u in np.append(np.geomspace(1e-6, 30.0, 200), np.linspace(0.9, 1.1, 50)):
        share = float(law.begun(np.array([u]))[0])
        assert at(waits, u, 0)[0] == pytest.approx(share, rel=0, abs=1e-7)
    assert at(waits, 1e200, 0)[0] == pytest.approx(1.0, rel=0, abs=1e-12)


# ---- in every drive ----


def widow(delay, count=100_000):
    """Contacts that break at the constant rate 0.4 per unit displacement."""
    return Ensemble(Exponential(2.5), delay=delay, stiffness_law="uniform", count=count)


GAMMA = Delay(2.0, "gamma", shape=4.0)
LOGNORMAL = Delay(2.0, "lognormal", sigma=1.0)
ENDS = {
    GAMMA: (0.6831579072, 0.5580441858, 0.5536277619, 0.5555395486),
    Delay(2.0, "exponential"): (0.7362531821, 0.6290217281, 0.5676994322, 0.5558873715),
}


@pytest.mark.verification
@pytest.mark.parametrize("law", ENDS)
def test_pinned_share_of_contacts_with_a_constant_rate(law):
    """At t = 1, 2, 4 and 8: not monotone for the gamma law. The renewal equation to
    1e-8, and that in two times within its quoted error, 1e-5 or less."""
    exact = transient(widow(law), Drive(1.0, 8.0), points=9)
    np.testing.assert_allclose(exact.pinned[[1, 2, 4, 8]], ENDS[law], rtol=1e-8)
    along = transient(widow(law), Programme([Segment(1.0, distance=8.0)]), points=9)
    off = np.abs(along.pinned[[1, 2, 4, 8]] - ENDS[law])
    assert (off < along.pinned_error[[1, 2, 4, 8]]).all()
    assert along.pinned_error.max() < 1e-5


def test_lognormal_pinned_share():
    """Beside the renewal equation of the detached share, d(t) = int_0^t 0.4 (1 - d(t -
    s)) P(delay > s) ds, by the trapezoidal rule in steps of 1/200 and 1/400,
    extrapolated."""
    longer = scipy_law(LognormalDelay(2.0, 1.0)).sf

    def pinned(steps):
        h = 1.0 / steps
        weights = 0.4 * h * longer(h * np.arange(8 * steps + 1))
        share = np.ones(weights.size)
        for n in range(1, share.size):
            past = weights[1:n] @ share[n - 1 : 0 : -1] + 0.5 * weights[n]
            share[n] = (1.0 - past) / (1.0 + 0.5 * weights[0])
        return share[steps::steps]

    rough, fine = pinned(200), pinned(400)
    known = fine + (fine - rough) / 3.0
    exact = transient(widow(LOGNORMAL), Drive(1.0, 8.0), points=9)
    np.testing.assert_allclose(exact.pinned[1:], known, rtol=0, atol=1e-8)
    assert (np.abs(exact.pinned[1:] - known) < exact.pinned_error[1:]).all()


def largest_z(run, exact):
    pairs = (
        (run.force, exact.force, run.force_stderr, exact.force_error),
        (run.pinned, exact.pinned, run.pinned_stderr, exact.pinned_error),
    )
    scores = []
    for found, known, *errors in pairs:
        error = np.hypot(*errors)
        scores.append(np.abs(found - known)[error > 0] / error[error > 0])
    return max(score.max() for score in scores)


THERE_AND_BACK = (
    Segment(1.0, distance=1.3),
    Segment(0.0, time=1.0),
    Segment(-0.5, distance=2.0),
)
WARM = Ensemble(
    Weibull(2.0), Thermal(kT=0.1), stiffness_law="uniform", count=100_000
)  # fmt: skip


@chosen("law", [GAMMA, LOGNORMAL], [])
def test_transients(law):
    """1e5 contacts, some 1e5 lives: |z| < 4.5, from a fresh and from a stationary
    start. Negative control: an exponential delay of the same mean, from a fresh
    start."""
    contacts = widow(law)
    for start in ("fresh", "stationary"):
        drive = Drive(1.0, 8.0, start)
        run = trajectory(contacts, drive, points=81)
        assert run.lives > 1e5
        assert largest_z(run, transient(contacts, drive, points=81)) < 4.5
    other = trajectory(widow(Delay(2.0, "exponential")), Drive(1.0, 8.0), points=81)
    assert largest_z(other, transient(contacts, Drive(1.0, 8.0), points=81)) > 4.5


@pytest.mark.verification
@pytest.mark.parametrize("start", ["fresh", "stationary"])
@pytest.mark.parametrize("law", [GAMMA, LOGNORMAL])
def test_programmes_with_a_hold(law, start):
    """There, at rest, and back, 1e5 warm contacts: |z| < 4.5. Negative control: a
    gamma delay in the place of a lognormal one, and the reverse."""
    programme = Programme(THERE_AND_BACK, start, 0.5 if start == "stationary" else None)
    contacts = replace(WARM, delay=law)
    exact = transient(contacts, programme, points=61)
    run = trajectory(contacts, programme, points=61)
    assert run.lives > 1e5
    assert largest_z(run, exact) < 4.5
    other = replace(WARM, delay=LOGNORMAL if law is GAMMA else GAMMA)
    if start == "fresh":
        assert largest_z(trajectory(other, programme, points=61), exact) > 4.5


@chosen("law", [GAMMA, LOGNORMAL], [])
def test_behind_a_stage(law):
    """8 ensembles of 2e4 contacts, with a hold: |z| < 4.5, which the other law
    exceeds."""
    stage = Stage(0.5, damping=0.1)
    programme = Programme(
        (Segment(1.0, distance=2.0), Segment(0.0, time=1.0)), stage=stage
    )
    contacts = replace(WARM, delay=law, count=20_000)
    exact = transient(contacts, programme, points=41)
    run = trajectory(contacts, programme, points=41, replicas=8)
    assert run.lives > 1e5
    assert largest_z(run, exact) < 4.5
    other = replace(contacts, delay=LOGNORMAL if law is GAMMA else GAMMA)
    again = trajectory(other, programme, points=41, replicas=8)
    assert largest_z(again, exact) > 4.5


@pytest.mark.parametrize("law", [GAMMA, LOGNORMAL])
def test_steady_averages_know_the_mean_alone(law):
    fixed = reference(widow(Delay(2.0)), Drive(1.0))
    found = reference(widow(law), Drive(1.0))
    assert found.friction == fixed.friction
    assert found.pinned.value == pytest.approx(2.5 / 4.5, rel=1e-9, abs=0)


@pytest.mark.parametrize("law", [GAMMA, LOGNORMAL])
def test_fluctuations(law):
    """The covariance at lag s is E[f f'], of which contacts with a constant rate have a
    closed part: those that survive. Beside the gamma law of shape 1 in the place of an
    exponential one, and the variance of the steady state."""
    found = fluctuations(widow(law), Drive(1.0, 6.0), points=25)
    steady = reference(widow(law), Drive(1.0), variance=True).force_variance.value
    assert found.covariance[0] == pytest.approx(steady, rel=1e-6, abs=0)
    once = fluctuations(
        widow(Delay(2.0, "gamma", shape=1.0)), Drive(1.0, 6.0), points=25
    )
    known = fluctuations(widow(Delay(2.0, "exponential")), Drive(1.0, 6.0), points=25)
    off = np.abs(once.covariance - known.covariance)
    assert (off <= once.error + known.error).all()
    assert np.abs(found.covariance - known.covariance).max() > 0.03


def test_stability_of_a_gamma_law_of_shape_1():
    """That of an exponential delay, within the errors of both; one of shape 1000 is
    nearly that of a fixed delay."""
    pull = Programme([Segment(1.0, distance=1.0)], stage=Stage(0.2))
    contacts = Ensemble(Weibull(2.0), delay=Delay(0.5, "exponential"))
    known = stability(contacts, pull).critical_stiffness
    once = replace(contacts, delay=Delay(0.5, "gamma", shape=1.0))
    found = stability(once, pull).critical_stiffness
    assert abs(found.value - known.value) < 3.0 * (found.stderr + known.stderr)
    narrow = replace(contacts, delay=Delay(0.5, "gamma", shape=1000.0))
    fixed = replace(contacts, delay=Delay(0.5))
    found, known = (
        stability(kind, pull).critical_stiffness for kind in (narrow, fixed)
    )
    assert found.value == pytest.approx(known.value, rel=5e-3, abs=0)


@pytest.mark.verification
def test_identical_contacts_forget_where_they_began():
    """Contacts that all break at 1: after many cycles gamma delays have spread them,
    and pinned is 1/(1 + 2); engine and reference agree all the way."""
    contacts = Ensemble(Delta(1.0), delay=GAMMA, stiffness_law="uniform", count=50_000)
    drive = Drive(1.0, 30.0)
    exact = transient(contacts, drive, points=301)
    run = trajectory(contacts, drive, points=301)
    assert largest_z(run, exact) < 4.5
    assert exact.pinned[-1] == pytest.approx(1.0 / 3.0, rel=0, abs=2e-3)


# ---- dependence on temperature and velocity ----


def test_rests_at_infinity():
    for wait in (Delay(2.0, "gamma", shape=4.0), Delay(2.0, "lognormal", sigma=0.5)):
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            assert wait.residual_cdf([0.0, math.inf]).tolist() == [0.0, 1.0]


def test_activation():
    """tau = time exp(E/kT), exactly; without temperature contacts never form again."""
    warm = replace(WARM, delay=Delay(0.01, activation=0.3))
    plain = replace(WARM, delay=Delay(0.01 * math.exp(3.0)))
    for drive in (Drive(0.5), Drive(2.0)):
        found, known = (reference(kind, drive).pinned.value for kind in (warm, plain))
        assert found == pytest.approx(known, rel=1e-14, abs=0)
    cold = replace(warm, thermal=Thermal())
    assert reference(cold, Drive(1.0)).pinned.value == 0.0
    endless = replace(cold, delay=Delay(math.inf))
    assert (
        transient(cold, Drive(1.0, 2.0)).force.tolist()
        == transient(endless, Drive(1.0, 2.0)).force.tolist()
    )
    assert Delay(activation=1.0).at(0.0, 1.0).time == 0.0
    # a time of 1e100 and more has no end, whatever makes it so long
    for law, kT, v in (
        (Delay(1e3, activation=229.5), 1.0, 1.0),
        (Delay(1e3, velocity_exponent=10.0), 0.0, 1e10),
        (Delay(1e-3, activation=700.1), 1.0, 1.0),
    ):
        assert law.at(kT, v).time == math.inf
    known = 1e-3 * math.exp(236.0)
    assert Delay(1e-3, activation=236.0).at(1.0, 1.0).time == known


def test_velocity_exponent():
    """tau = time (v/v_0)^p; along a programme of one speed, and refused elsewhere."""
    law = Delay(0.5, velocity_exponent=-1.5, reference_velocity=2.0)
    contacts, speed = replace(WARM, delay=law), 0.5
    plain = replace(WARM, delay=Delay(0.5 * 0.25**-1.5))
    back = (Segment(speed, distance=1.0), Segment(-speed, distance=1.0))
    for drive in (Drive(speed, 2.0), Programme(back)):
        known = transient(plain, drive, points=11)
        found = transient(contacts, drive, points=11)
        np.testing.assert_allclose(found.force, known.force, rtol=1e-12, atol=1e-15)
        run, same = (trajectory(kind, drive, points=11) for kind in (contacts, plain))
        np.testing.assert_allclose(run.force, same.force, rtol=1e-12, atol=1e-15)
    assert Delay(1.0, velocity_exponent=10.0).at(0.0, 1e200).time > 1e99
    assert Delay(1.0, velocity_exponent=-10.0).at(0.0, 1e200).time == 0.0
    for programme in (
        Programme(THERE_AND_BACK),
        Programme((*back, Segment(0.0, time=1.0))),
        Programme([Segment(time=1.0)]),
        Programme(back, "stationary", 2.0 * speed),
        Programme(back[:1], stage=Stage(1.0)),
    ):
        for call in (trajectory, transient):
            with pytest.raises(InputError, match=r"delay\.velocity_exponent = -1\.5"):
                call(contacts, programme)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"law": "gamma"}, 'shape: is required with law = "gamma"'),
        ({"law": "lognormal", "shape": 1.0}, 'shape: not allowed with law = "lognormal"'),
        ({"sigma": 1.0}, 'sigma: not allowed with law = "fixed"'),
        ({"law": "gamma", "shape": 1e4}, "shape = 10000.0"),
        ({"law": "lognormal", "sigma": 0.0}, "sigma = 0.0"),
        ({"activation": -1.0}, "activation = -1.0"),
        ({"velocity_exponent": 11.0}, "velocity_exponent = 11.0"),
        ({"reference_velocity": 0.0}, "reference_velocity = 0.0"),
        ({"law": "weibull"}, 'law = \'weibull\': must be one of "fixed"'),
    ],
)  # fmt: skip
def test_bad_laws(arguments, message):
    with pytest.raises(InputError) as caught:
        Delay(**arguments)
    assert message in str(caught.value)


def test_fits_of_steady_averages_refuse_what_has_no_effect(tmp_path):
    """A shape has none; an activation is one more energy, known from friction at two
    temperatures to the noise that there is none of."""
    (tmp_path / "data.csv").write_text(
        "drive.velocity,thermal.kT,friction,friction_stderr\n"
        + "".join(
            f"{v},{kT},{reference(contacts, Drive(v)).friction.value},1e-6\n"
            for v in (0.1, 1.0)
            for kT in (0.1, 0.2)
            for contacts in [
                Ensemble(
                    thermal=Thermal(kT),
                    delay=Delay(0.3, "gamma", shape=2.0, activation=0.15),
                )
            ]
        ),
        encoding="utf-8",
    )
    text = """
        [thermal]
        kT = 0.1
        [delay]
        time = 0.3
        law = "gamma"
        shape = 2.0
        activation = 0.05
        [drive]
        velocity = 1.0
        [fit]
        data = "data.csv"
        scale = 1.0
        [fit.free]
        "delay.{key}" = {{ bounds = [{low}, {high}] }}
    """
    path = tmp_path / "fit.toml"
    path.write_text(text.format(key="shape", low=0.5, high=8.0), encoding="utf-8")
    with pytest.raises(InputError, match=r"delay\.shape: has no effect"):
        fit(path)
    path.write_text(text.format(key="activation", low=0.02, high=0.6), encoding="utf-8")
    (found,) = fit(path).values.values()
    assert found == pytest.approx(0.15, rel=1e-4, abs=0)


@pytest.mark.parametrize("sigma", [0.5, 1.0, 1.4, 2.0])
def test_transform_of_lognormal_delays_at_complex_rates(sigma):
    """1 - E[exp(-p delay)] by the trapezoidal rule in ln(delay), which is exact to
    rounding where exp(-p delay) is resolved."""
    step = 2.0**-14
    z = np.arange(-12.0, 13.0, step)
    share = np.exp(-0.5 * z**2) * step / math.sqrt(2.0 * math.pi)
    delays = np.exp(sigma * (z - 0.5 * sigma))
    for p in (1e-5, 0.3, 1e-4j, 0.1j, 0.2 + 0.9j):
        exact = -(share @ np.expm1(-p * delays))
        found = LognormalDelay(1.0, sigma).forgotten(np.array([p]))[0]
        assert abs(found - exact) < 1e-10 * abs(exact)
