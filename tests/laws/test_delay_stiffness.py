"""Delays and stiffnesses: NumPy side, kernel side, and bad input."""

import math

import numpy as np
import pytest
import scipy.stats
from kernels import compiled
from scipy import integrate

from eqsim import Delay, Gamma, InputError
from eqsim.laws import delay, stiffness
from eqsim.laws.delay import DELAYS
from eqsim.laws.stiffness import Springs, relative_stiffness

delay_draw, residual_delay_draw = (
    compiled(delay.delay_draw),
    compiled(delay.residual_delay_draw),
)
kappa = compiled(stiffness.kappa)

MEAN = 2.5
LAWS = ["fixed", "exponential"]
OTHER = {"fixed": "exponential", "exponential": "fixed"}
UNIFORMS = np.random.default_rng(4).random(50_000)


def draws(draw, law):
    return np.array([draw(DELAYS[law](MEAN).for_kernels(), u) for u in UNIFORMS])


def test_exponential_delay():
    t = np.linspace(0, 20, 50)
    np.testing.assert_allclose(
        Delay(MEAN, "exponential").cdf(t),
        scipy.stats.expon(scale=MEAN).cdf(t),
        rtol=1e-14,
    )
    np.testing.assert_array_equal(
        Delay(MEAN, "exponential").cdf(np.array([-1.0, 0.0])), 0.0
    )


def test_fixed_delay():
    np.testing.assert_array_equal(
        Delay(MEAN).cdf(np.array([0.0, 2.4999, 2.5, 3.0])), [0, 0, 1, 1]
    )
    assert set(draws(delay_draw, "fixed")) == {MEAN}


@pytest.mark.parametrize("law", LAWS)
def test_no_delay(law):
    np.testing.assert_array_equal(
        Delay(0.0, law).cdf(np.array([-1.0, 0.0, 1.0])), [0, 1, 1]
    )
    assert delay_draw(DELAYS[law](0.0).for_kernels(), 0.3) == 0.0
    assert residual_delay_draw(DELAYS[law](0.0).for_kernels(), 0.3) == 0.0


@pytest.mark.parametrize("law", LAWS)
def test_no_delay_leaves_no_rest(law):
    np.testing.assert_array_equal(
        Delay(0.0, law).residual_cdf(np.array([0.0, 1.0])), 1.0
    )


@pytest.mark.parametrize("law", LAWS)
def test_residual_is_the_integrated_tail(law):
    """Renewal theory: P(rest <= t) = int_0^t P(delay > s) ds / mean."""
    delay = Delay(MEAN, law)
    for t in (0.3, 1.7, 2.5, 6.0):
        tail = integrate.quad(
            lambda s: 1 - float(delay.cdf(s)), 0, t, points=[min(t, MEAN)]
        )[0]
        assert float(delay.residual_cdf(t)) == pytest.approx(
            tail / MEAN, rel=1e-9, abs=0
        )
    np.testing.assert_array_equal(delay.residual_cdf(np.array([-1.0, 0.0])), 0.0)
    assert float(delay.residual_cdf(math.inf)) == 1.0


def ks(sample, cdf):
    return scipy.stats.kstest(sample, cdf).pvalue


@pytest.mark.parametrize("draw", [delay_draw, residual_delay_draw])
def test_a_uniform_is_the_share_of_longer_delays(draw):
    """To rounding; no statistics would see a mean that is 1 % off."""
    law = scipy.stats.expon(scale=MEAN)
    np.testing.assert_allclose(
        draws(draw, "exponential"), law.isf(UNIFORMS), rtol=1e-13
    )


def test_exponential_draws():
    """KS over 5e4 draws, p > 1e-5 (as everywhere in this file; six tests, false alarm
    4e-5 together)."""
    assert ks(draws(delay_draw, "exponential"), Delay(MEAN, "exponential").cdf) > 1e-5
    # negative control
    assert (
        ks(draws(delay_draw, "exponential"), Delay(1.05 * MEAN, "exponential").cdf)
        < 1e-5
    )


@pytest.mark.parametrize("law", LAWS)
def test_residual_draws(law):
    assert ks(draws(residual_delay_draw, law), Delay(MEAN, law).residual_cdf) > 1e-5
    # negative control
    assert (
        ks(draws(residual_delay_draw, law), Delay(MEAN, OTHER[law]).residual_cdf) < 1e-5
    )


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"time": -1.0}, "time = -1.0: must be a finite number >= 0"),
        ({"time": float("nan")}, "time = nan"),
        ({"time": -float("inf")}, "time = -inf"),
        ({"time": "1"}, "time = '1'"),
    ],
)
def test_bad_delay(arguments, message):
    with pytest.raises(InputError) as caught:
        Delay(**arguments)
    assert message in str(caught.value)


@pytest.mark.parametrize("n", [0.0, 1.0, 3.5])
def test_sqrt_law_is_the_root_of_the_force(n):
    """k_i = k sqrt(f_si/f_s) with f_si = k_i xi_i (section II): kappa^2 = kappa
    xi/<kappa xi>, and <f_s> = k xi_rms."""
    law = Gamma(n, 2.0)
    xi = np.linspace(0.1, 9.0, 50)
    k = relative_stiffness("sqrt", xi, law.rms)
    mean_force = integrate.quad(
        lambda x: float(law.pdf(x) * relative_stiffness("sqrt", x, law.rms) * x), 0, 60
    )[0]
    assert mean_force == pytest.approx(law.rms, rel=1e-8, abs=0)
    np.testing.assert_allclose(k, np.sqrt(k * xi / mean_force), rtol=1e-8)


@pytest.mark.parametrize("n", [0.0, 1.0, 3.5])
def test_sqrt_law_makes_forces_gamma(n):
    """f_si follows f^n exp(-f/f_*) (eq:pcf) under the sqrt law, and does not under the
    uniform one."""
    law = Gamma(n, 2.0)
    xi = law.inverse_survival(-np.log(UNIFORMS))
    gamma = scipy.stats.gamma(n + 1, scale=law.rms / (n + 1))
    assert ks(relative_stiffness("sqrt", xi, law.rms) * xi, gamma.cdf) > 1e-5
    # negative control
    assert ks(relative_stiffness("uniform", xi, law.rms) * xi, gamma.cdf) < 1e-5


def test_kernel_stiffness():
    xi = np.linspace(0.0, 5.0, 30)
    found = [kappa(Springs(0.0, 1 / 1.7), x) for x in xi]
    np.testing.assert_allclose(found, relative_stiffness("sqrt", xi, 1.7), rtol=4e-16)
    assert [kappa(Springs(1.0, 0.0), x) for x in xi] == list(
        relative_stiffness("uniform", xi, 1.7)
    )
