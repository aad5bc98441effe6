"""The published closed forms against the solver, and which expansions converge."""

import math

import numpy as np
import pytest
from scipy import integrate, optimize

from eqsim import Ensemble, InputError, Thermal, reference
from eqsim.laws.thermal import pooled_rate
from eqsim.laws.threshold import Gamma
from eqsim.master.asymptotics import C_0, Published, beta, minimum_velocity


def solved(kT, v):
    ensemble = Ensemble(thermal=Thermal(kT), disorder="annealed", stiffness_law="uniform")
    return reference(ensemble, v)


@pytest.mark.parametrize("kT", [0.05, 0.5, 5.0])
def test_closed_forms(kT):
    """nt01-nt12 against the law, their own derivatives and integrals, and pooled_rate, in units with x_* = 2.

    Between closed forms only a few operations are rounded (1e-12; U is a difference of numbers near 1, hence 4e-16
    absolute); 1e-9 is the accuracy asked of the quadratures, 1e-8 the documented one of pooled_rate."""
    form = Published(kT, stiffness=3.0, x_star=2.0, attempt_frequency=5.0)
    law, x = Gamma(1.0, 2.0), np.linspace(0.05, 6.0, 40)
    np.testing.assert_allclose(form.P_c(x), law.pdf(x), rtol=1e-12)
    np.testing.assert_allclose(form.J_c(x), law.sf(x), rtol=1e-12)
    np.testing.assert_allclose(form.P(x), form.P_c(x) / form.J_c(x), rtol=1e-12)
    np.testing.assert_allclose(form.U(x), -np.log(form.J_c(x)), rtol=1e-12, atol=4e-16)
    np.testing.assert_allclose(form.H(x, 0.7), 5.0 / 0.7 * pooled_rate(law, "uniform", "soft", form.b, x / 2.0), 1e-8)
    np.testing.assert_allclose(
        form.dU(x, 0.7), [integrate.quad(form.H, 0, end, args=(0.7,), epsabs=1e-13)[0] for end in x], rtol=1e-9
    )
    assert form.dU(60.0, form.v_star) == pytest.approx(1.0)
    C = integrate.quad(form.E_P, 0, 14.0, args=(0.7,), epsabs=1e-12)[0]
    ensemble = Ensemble(law, Thermal(kT, 5.0), stiffness=3.0, disorder="annealed", stiffness_law="uniform")
    exact = reference(ensemble, 0.7)
    assert exact.break_stretch.value == pytest.approx(C, rel=1e-9)
    assert ensemble.crossover_velocity == pytest.approx(form.v_star, rel=1e-8)
    assert form.kT_star / kT == pytest.approx(form.b)


def order_of_convergence(kT, approximation):
    """Exponent of the relative error against S_2, from a fit over a decade of high velocities."""
    form = Published(kT)
    v = form.S_2(1.0) / np.geomspace(0.003, 0.03, 7)
    error = [abs(approximation(form, speed) / solved(kT, speed).friction.value - 1) for speed in v]
    return np.polyfit(np.log(1 / v), np.log(error), 1)[0]


@pytest.mark.parametrize("kT", [0.25, 1.0, 4.0])
def test_high_velocity_expansion(kT):
    """nt16: to first order the corrected form leaves an error of second order, to second order one of third; what is
    printed never leaves more than the first order (slopes within 0.1, the next order contributes 3 %)."""
    assert order_of_convergence(kT, lambda f, v: f.high_velocity(v, order=1)) == pytest.approx(2.0, abs=0.1)
    assert order_of_convergence(kT, lambda f, v: f.high_velocity(v)) == pytest.approx(3.0, abs=0.1)
    for order in (1, 2):
        printed = order_of_convergence(kT, lambda f, v, o=order: f.high_velocity(v, printed=True, order=o))
        assert printed == pytest.approx(1.0, abs=0.1)


@pytest.mark.parametrize("b", [0.1, 0.5, 3.0])
def test_corrected_coefficients(b):
    """C_1 = 0.25573 + 0.08789 b and C_2 = .008254 + .016370 b + .004587 b^2, to the digits given."""
    C_1, C_2 = Published(0.5 / b)._expansion()
    assert pytest.approx(0.25573 + 0.08789 * b, abs=6e-6 * (1 + b)) == C_1
    assert pytest.approx(0.008254 + 0.016370 * b + 0.004587 * b**2, abs=6e-7 * (1 + b + b**2)) == C_2


def test_low_velocity():
    """nt15 becomes exact as S_2 grows; its relative error falls at least as 1/S_2."""
    form = Published(1.0)
    errors = [abs(form.low_velocity(v) / solved(1.0, v).friction.value - 1) for v in (1e-3, 1e-4, 1e-5)]
    assert errors[0] < 1e-3
    assert errors[1] < 0.11 * errors[0]
    assert errors[2] < 0.11 * errors[1]


def test_minimum_of_viscous_friction():
    """v_0 minimises beta(v)/(1 + v/v_d); the printed limit is right for v_eta >> v_d only."""
    for v_eta, v_d in ((3.0, 1.0), (1e4, 0.1)):
        found = optimize.minimize_scalar(
            lambda v, e=v_eta, d=v_d: beta(v, e, d) / (1 + v / d),
            bounds=(0, 10 * math.sqrt(v_eta * v_d)),
            method="bounded",
        )
        assert minimum_velocity(v_eta, v_d) == pytest.approx(found.x, rel=1e-4)
    assert minimum_velocity(1e4, 0.1, printed=True) == pytest.approx(minimum_velocity(1e4, 0.1), rel=0.01)
    assert minimum_velocity(3.0, 1.0, printed=True) == pytest.approx(math.sqrt(3.0))


def test_limits_and_refusals():
    assert pytest.approx(0.752253, abs=5e-7) == C_0
    assert Published(1e9).v_star == pytest.approx(1 / C_0)
    assert Published(1e-9).v_star == pytest.approx(0.443 * 2e-9, rel=1e-3)
    with pytest.raises(InputError, match="kT"):
        Published(0.0)
