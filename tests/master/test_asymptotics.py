"""The published closed forms against the solver, and which expansions converge."""

import math

import numpy as np
import pytest
from scipy import integrate, optimize, special

from eqsim import Delta, Drive, Ensemble, InputError, Thermal, reference
from eqsim.laws.barrier import BARRIERS
from eqsim.laws.barrier.pooled import pooled_rate
from eqsim.laws.threshold import Gamma
from eqsim.master.closed_forms import (
    C_0,
    Published,
    PublishedAging,
    beta,
    minimum_velocity,
)


def solved(kT, v):
    ensemble = Ensemble(
        thermal=Thermal(kT), disorder="annealed", stiffness_law="uniform"
    )
    return reference(ensemble, Drive(v))


@pytest.mark.parametrize("kT", [0.05, 0.5, 5.0])
def test_closed_forms(kT):
    """nt01-nt12 against the law, their own derivatives and integrals, and pooled_rate,
    in units with x_* = 2.

    Between closed forms only a few operations are rounded (1e-12; U is a difference of
    numbers near 1, hence 4e-16 absolute); 1e-9 is the accuracy asked of the
    quadratures, 1e-8 the documented one of pooled_rate."""
    form = Published(kT, stiffness=3.0, x_star=2.0, attempt_frequency=5.0)
    law, x = Gamma(1.0, 2.0), np.linspace(0.05, 6.0, 40)
    np.testing.assert_allclose(form.P_c(x), law.pdf(x), rtol=1e-12)
    np.testing.assert_allclose(form.J_c(x), law.sf(x), rtol=1e-12)
    np.testing.assert_allclose(form.P(x), form.P_c(x) / form.J_c(x), rtol=1e-12)
    np.testing.assert_allclose(form.U(x), -np.log(form.J_c(x)), rtol=1e-12, atol=4e-16)
    np.testing.assert_allclose(
        form.H(x, 0.7),
        5.0 / 0.7 * pooled_rate(law, "uniform", BARRIERS["soft"], form.b, x / 2.0),
        rtol=1e-8,
    )
    np.testing.assert_allclose(
        form.dU(x, 0.7),
        [integrate.quad(form.H, 0, end, args=(0.7,), epsabs=1e-13)[0] for end in x],
        rtol=1e-9,
    )
    assert form.dU(60.0, form.v_star) == pytest.approx(1.0, rel=1e-15, abs=0)
    C = integrate.quad(form.E_P, 0, 14.0, args=(0.7,), epsabs=1e-12)[0]
    ensemble = Ensemble(
        law,
        Thermal(kT, 5.0),
        stiffness=3.0,
        disorder="annealed",
        stiffness_law="uniform",
    )
    exact = reference(ensemble, Drive(0.7))
    assert exact.break_stretch.value == pytest.approx(C, rel=1e-9, abs=0)
    assert ensemble.crossover_velocity == pytest.approx(form.v_star, rel=1e-8, abs=0)
    assert form.kT_star / kT == pytest.approx(form.b, rel=1e-15, abs=0)


def order_of_convergence(kT, approximation):
    """Exponent of the relative error against S_2, from a fit over a decade of high
    velocities."""
    form = Published(kT)
    v = form.S_2(1.0) / np.geomspace(0.003, 0.03, 7)
    error = [
        abs(approximation(form, speed) / solved(kT, speed).friction.value - 1)
        for speed in v
    ]
    return np.polyfit(np.log(1 / v), np.log(error), 1)[0]


@pytest.mark.parametrize("kT", [0.25, 1.0, 4.0])
def test_high_velocity_expansion(kT):
    """nt16: to first order the corrected form leaves an error of second order, to
    second order one of third; what is printed never leaves more than the first order
    (slopes within 0.1, the next order contributes 3 %)."""
    assert order_of_convergence(
        kT, lambda f, v: f.high_velocity(v, order=1)
    ) == pytest.approx(2.0, abs=0.1)
    assert order_of_convergence(kT, lambda f, v: f.high_velocity(v)) == pytest.approx(
        3.0, abs=0.1
    )
    for order in (1, 2):
        printed = order_of_convergence(
            kT, lambda f, v, o=order: f.high_velocity(v, printed=True, order=o)
        )
        assert printed == pytest.approx(1.0, abs=0.1)


@pytest.mark.parametrize("b", [0.1, 0.5, 3.0])
def test_corrected_coefficients(b):
    """C_1 = 0.25573 + 0.08789 b and C_2 = .008254 + .016370 b + .004587 b^2, to the
    digits given."""
    C_1, C_2 = Published(0.5 / b)._expansion()
    assert pytest.approx(0.25573 + 0.08789 * b, abs=6e-6 * (1 + b)) == C_1
    assert (
        pytest.approx(
            0.008254 + 0.016370 * b + 0.004587 * b**2, abs=6e-7 * (1 + b + b**2)
        )
        == C_2
    )


@pytest.mark.parametrize("b", [0.1, 3.0, 40.0])
def test_printed_coefficients(b):
    """As the paper prints them, for any b: nt16 with C_1 = 5 sqrt(pi)/8 - C_0 (.356)
    and C_2 = 16/(9 pi) - 1/3, star4 with a = 1, c = C_0 + C_1, C_12 = 1.324 and C~_12 =
    1.789. Rounding: of sums of terms of 1e-4 and more, 1e-12."""
    form, v = Published(0.5 / b), Published(0.5 / b).S_2(1.0) / 0.01
    first, second = (
        form.high_velocity(v, printed=True, order=order) / form.f_k0 - 1
        for order in (1, 2)
    )
    slope = -first / 0.01
    assert slope == pytest.approx(5 * math.sqrt(math.pi) / 8 - C_0, rel=1e-12, abs=0)
    assert slope == pytest.approx(0.356, abs=5e-4)
    assert (second - first) / 1e-4 == pytest.approx(
        16 / (9 * math.pi) - 1 / 3, rel=1e-10, abs=0
    )
    cold, hot = (
        PublishedAging(0.1, 0.5, 1.0),
        PublishedAging(0.0, 0.5, 1.0, kT=0.125 / b),
    )
    for aging, thermal, S in ((0.0, 1.0, hot.S_2(v)), (1.0, 0.0, cold.S_3(v))):
        which = cold if aging else hot
        stretch = which.C(v, printed=True) / 0.5
        assert (stretch - 1 / C_0) / S == pytest.approx(
            1.324 * aging - thermal, rel=1e-9, abs=0
        )
        bracket = which.f_k(v, printed=True) * stretch / 0.5
        assert (bracket - 1) / S == pytest.approx(
            1.789 * aging - (C_0 + slope) * thermal, rel=1e-9, abs=0
        )


def test_low_velocity():
    """nt15 becomes exact as S_2 grows; its relative error falls at least as 1/S_2."""
    form = Published(1.0)
    errors = [
        abs(form.low_velocity(v) / solved(1.0, v).friction.value - 1)
        for v in (1e-3, 1e-4, 1e-5)
    ]
    assert errors[0] < 1e-3
    assert errors[1] < 0.11 * errors[0]
    assert errors[2] < 0.11 * errors[1]


def test_minimum_of_viscous_friction():
    """v_0 minimises beta(v)/(1 + v/v_d); the printed limit is right for v_eta >> v_d
    only."""
    for v_eta, v_d in ((3.0, 1.0), (1e4, 0.1)):
        found = optimize.minimize_scalar(
            lambda v, e=v_eta, d=v_d: beta(v, e, d) / (1 + v / d),
            bounds=(0, 10 * math.sqrt(v_eta * v_d)),
            method="bounded",
        )
        assert minimum_velocity(v_eta, v_d) == pytest.approx(found.x, rel=1e-4, abs=0)
    assert minimum_velocity(1e4, 0.1, printed=True) == pytest.approx(
        minimum_velocity(1e4, 0.1), rel=0.01, abs=0
    )
    assert minimum_velocity(3.0, 1.0, printed=True) == pytest.approx(
        math.sqrt(3.0), rel=1e-15, abs=0
    )


def test_limits_and_refusals():
    assert pytest.approx(0.752253, abs=5e-7) == C_0
    assert Published(1e9).v_star == pytest.approx(1 / C_0, rel=1e-9, abs=0)  # b = 5e-10
    assert Published(1e-9).v_star == pytest.approx(0.443 * 2e-9, rel=1e-3, abs=0)
    with pytest.raises(InputError, match="kT"):
        Published(0.0)


def panels(edges, order=12):
    """Gauss-Legendre nodes and weights between ascending edges, end to end."""
    nodes, weights = special.roots_legendre(order)
    half = 0.5 * np.diff(edges)[:, None]
    return (edges[:-1, None] + half * (1 + nodes)).ravel(), (half * weights).ravel()


def star1(v, D, x_i, x_f, kT=0.0):
    """C, f_k and P_c(x) of aging annealed contacts (n = 1, soft, uniform, k = omega =
    1) by plain quadrature over the ages s C/v, s ~ Exp(1), of a mixture of gamma laws
    (derived; solves star1 exactly)."""
    s, share = panels(np.append(0.0, 45 * 2.0 ** np.arange(-30.0, 1.0)))
    share = share * np.exp(-s)
    x, dx = panels(
        np.append(0.0, 7 * max(x_i, x_f) * 2.0 ** (np.arange(-40.0, 1.0) / 3))
    )

    def mixture(C):
        scale = np.sqrt(
            x_f**2 - (x_f**2 - x_i**2) * np.exp(-4 * D * s * C / v / x_f**2)
        )
        u = x[:, None] / scale
        survive = ((1 + u**2) * np.exp(-(u**2))) @ share
        if kT > 0:
            # int_0^u of the rate of each component (nt08), per attempt
            b = scale**2 / (2 * kT)
            G = math.sqrt(math.pi) / 2 * special.erf(u) * (1 + (1 + b) / 2) - (
                1 + b
            ) / 2 * u * np.exp(-(u**2))
            survive = survive * np.exp(-(scale * G / (1 + b) ** 2 / v) @ share)
        return scale, survive

    C = optimize.brentq(
        lambda C: dx @ mixture(C)[1] - C,
        1e-9,
        2 * max(x_i, x_f),
        xtol=1e-15,
        rtol=1e-14,
    )
    scale, survive = mixture(C)

    def P_c(x):
        u = np.asarray(x)[:, None] / scale
        return (2 * u**3 * np.exp(-(u**2)) / scale) @ share

    return C, (dx * x) @ survive / C, P_c


def exponent(x, y):
    return np.polyfit(np.log(x), np.log(np.abs(y)), 1)[0]


def test_oracle_of_aging():
    """Its unaged limit is the solver, and at T = 0 it has these four values of friction
    (6 digits)."""
    assert star1(0.3, 0.0, 1.0, 2.0, kT=0.5)[1] == pytest.approx(
        solved(0.5, 0.3).friction.value, rel=1e-9, abs=0
    )
    for v, friction in (
        (0.01, 0.746793),
        (0.1, 0.697612),
        (1.0, 0.347086),
        (10.0, 0.0986062),
    ):
        assert star1(v, 0.1, 0.1, 1.0)[1] == pytest.approx(friction, rel=2e-6, abs=0)


@pytest.mark.parametrize("x_f", [1.0, 0.3])
@pytest.mark.parametrize("kT", [0.0, 1.0])
def test_aging_expansion(kT, x_f):
    """star4: C and f_k as corrected leave an error of second order in 1/v, as printed
    one of first (slopes within 0.1: over the decade the next order changes an error by
    a factor 1 + O(S), S < 0.02, that is a slope by a few 0.01); strengthening and
    weakening contacts."""
    form = PublishedAging(rate=0.2, x_star_initial=0.5, x_star_final=x_f, kT=kT)
    v = max(form.S_2(1.0), abs(form.S_3(1.0))) / np.geomspace(0.002, 0.02, 5)
    exact = np.array([star1(speed, 0.2, 0.5, x_f, kT)[:2] for speed in v])
    for column, quantity in enumerate((form.C, form.f_k)):
        error = {
            printed: quantity(v, printed=printed) / exact[:, column] - 1
            for printed in (False, True)
        }
        assert exponent(1 / v, error[False]) == pytest.approx(2.0, abs=0.1)
        assert exponent(1 / v, error[True]) == pytest.approx(1.0, abs=0.1)


def test_aging_changes_the_law():
    """star3a, star3b: J' = -P; corrected, P_c - P_ci integrates to 0 and misses the
    exact one in second order only."""
    form, x = PublishedAging(0.2, 0.5, 1.0), np.linspace(0.1, 1.5, 30)
    step = 1e-5  # central differences, to 1e-5^2 times a third derivative of order 100
    slope = (form.J_change(x + step, 10.0) - form.J_change(x - step, 10.0)) / (2 * step)
    np.testing.assert_allclose(form.P_change(x, 10.0), -slope, rtol=0, atol=1e-7)
    whole = [integrate.quad(form.P_change, 0, 5, args=(10.0,), epsabs=1e-12)[0]]
    assert whole[0] == pytest.approx(0.0, abs=1e-10)
    assert (
        abs(integrate.quad(lambda x: form.P_change(x, 10.0, printed=True), 0, 5)[0])
        > form.S_3(10.0) / 2
    )
    v = form.S_3(1.0) / np.geomspace(0.001, 0.01, 4)
    change = [star1(speed, 0.2, 0.5, 1.0)[2](x) - Gamma(1.0, 0.5).pdf(x) for speed in v]
    for printed, order in ((False, 2.0), (True, 1.0)):
        off = [
            np.abs(form.P_change(x, s, printed=printed) - c).max()
            for s, c in zip(v, change, strict=True)
        ]
        assert exponent(1 / v, off) == pytest.approx(order, abs=0.1)


@pytest.mark.parametrize("kT", [0.05, 0.5, 5.0])
def test_aging_coefficients(kT):
    """The closed forms of a, c, C_12 and C~_12 are the moments of nt09, by quadrature
    (to its 1e-9), and have the digits .883573 + .169524 b and .920403 + .215413 b."""
    newborn, v = Published(kT), 1.0
    hot = PublishedAging(0.0, 1.0, 2.0, kT)
    a = integrate.quad(lambda u: newborn.J_c(u) * newborn.dU(u, v), 0, 9, epsabs=1e-13)[
        0
    ] / newborn.S_2(v)
    c = integrate.quad(
        lambda u: u * newborn.J_c(u) * newborn.dU(u, v), 0, 9, epsabs=1e-13
    )[0] / newborn.S_2(v)
    assert hot.S_2(v) == pytest.approx(newborn.S_2(v), rel=1e-15, abs=0)
    assert (1 / C_0 - hot.C(v)) / hot.S_2(v) == pytest.approx(a, rel=1e-9, abs=0)
    assert (1 - hot.f_k(v) * hot.C(v)) / hot.S_2(v) == pytest.approx(c, rel=1e-9, abs=0)
    assert a == pytest.approx(0.883573 + 0.169524 * hot.b, abs=6e-7 * (1 + hot.b))
    assert c == pytest.approx(0.920403 + 0.215413 * hot.b, abs=6e-7 * (1 + hot.b))
    cold = PublishedAging(0.1, 1.0, 2.0)
    moments = [
        integrate.quad(lambda u, p=p: u**p * math.exp(-(u**2)), 0, 9, epsabs=1e-13)[0]
        for p in (4, 5)
    ]
    assert (cold.C(v) - 1 / C_0) / cold.S_3(v) == pytest.approx(
        moments[0], rel=1e-9, abs=0
    )
    assert (cold.f_k(v) * cold.C(v) - 1) / cold.S_3(v) == pytest.approx(
        moments[1], rel=1e-9, abs=0
    )
    assert moments == pytest.approx([0.664670, 1.0], abs=5e-7)


def test_aging_at_zero_temperature():
    """Given C, f_k = ((n+1)/2C)(x_*f^2 - (x_*f^2 - x_*i^2)/(1 + 4DC/(v x_*f^2)))
    (derived), which falls from its value at rest as v/D and reaches that of newborn
    contacts as D/v (section on aging): slopes within 0.1, at velocities where the next
    order is a few per cent."""
    D, x_i, x_f = 0.1, 0.3, 1.0
    for v in (1e-3, 0.1, 10.0):
        C, f_k, _ = star1(v, D, x_i, x_f)
        assert f_k == pytest.approx(
            (x_f**2 - (x_f**2 - x_i**2) / (1 + 4 * D * C / (v * x_f**2))) / C,
            rel=1e-9,
            abs=0,
        )
    slow, fast = D * np.geomspace(1e-3, 1e-2, 4), D * np.geomspace(1e3, 1e4, 4)
    falling = [star1(v, D, x_i, x_f)[1] - C_0 * x_f for v in slow]
    last = [star1(v, D, x_i, x_f)[1] - C_0 * x_i for v in fast]
    assert max(falling) < 0 < min(last)
    assert exponent(slow, falling) == pytest.approx(1.0, abs=0.1)
    assert exponent(fast, last) == pytest.approx(-1.0, abs=0.1)
    # the same D/v, the same friction
    assert star1(0.2, 2 * D, x_i, x_f)[1] == pytest.approx(
        star1(0.1, D, x_i, x_f)[1], rel=1e-12, abs=0
    )


def test_aging_limits_and_refusals():
    cold, hot = PublishedAging(0.0, 0.5, 1.0), PublishedAging(0.0, 0.5, 1.0, kT=1e-3)
    assert cold.f_k(3.0) == pytest.approx(0.5 * C_0, rel=1e-15, abs=0)
    # c - a < 1 + b
    assert hot.f_k(1e9) == pytest.approx(
        0.5 * C_0, rel=(1 + hot.b) * hot.S_2(1e9), abs=0
    )
    assert PublishedAging(0.1, 0.1, 1.0).inverse_x_if_squared == pytest.approx(
        99.0, rel=1e-15, abs=0
    )
    np.testing.assert_allclose(cold.C(np.array([1.0, 2.0])), 0.5 / C_0, rtol=1e-15)
    for wrong in ({"rate": -1.0}, {"x_star_initial": 0.0}, {"kT": -1.0}):
        with pytest.raises(InputError, match=next(iter(wrong))):
            PublishedAging(
                **{"rate": 0.1, "x_star_initial": 0.1, "x_star_final": 1.0, **wrong}
            )


HAZARDS = {
    "soft": lambda gap, a: (
        np.exp(-a * gap * (2.0 - gap))
        * special.dawsn(math.sqrt(a) * (1.0 - gap))
        / math.sqrt(a)
    ),
    "stiff": lambda gap, a: 2.0 / (3.0 * a) * np.exp(-a * gap**1.5),
    "cusp": lambda gap, a: 0.5 / a * np.exp(-a * gap**2),
}


@pytest.mark.parametrize("barrier", HAZARDS)
@pytest.mark.parametrize(("b", "log_w"), [(2.7e8, 36.0), (5e6, 23.0), (1e3, 12.0)])
def test_barriers_of_solids(barrier, b, log_w):
    """Equal contacts whose heat acts within 1e-5 of their threshold: <x_b> = 1 - int (1
    - S) d(gap) in ln(gap), a trapezoidal rule that converges exponentially; to the
    quoted 2e-11, and to 1e-9 of how far they break before their threshold. What H
    lacks at x = 0 is below exp(-900)."""
    log_gap, step = np.linspace(-60.0, 0.0, 100_001, retstep=True)
    gap, w = np.exp(log_gap), math.exp(log_w)
    missed = step * np.sum(gap * -np.expm1(-w * HAZARDS[barrier](gap, b)))
    contacts = Ensemble(
        Delta(1.0), Thermal(0.5 / b, w, barrier), stiffness_law="uniform"
    )
    found = reference(contacts, Drive(1.0)).break_stretch
    assert found.value == pytest.approx(1.0 - missed, rel=0, abs=2e-11 + 1e-9 * missed)
