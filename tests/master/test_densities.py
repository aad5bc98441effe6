"""Densities of the stationary state: closed forms, normalisation, each other, and the
particles of the engine."""

import itertools
import math

import numpy as np
import pytest
from cases import chosen
from scipy import integrate, interpolate, stats

from eqsim import (
    Delay,
    Delta,
    Distribution,
    Drive,
    Ensemble,
    Gamma,
    InputError,
    Table,
    Thermal,
    reference,
)
from eqsim.engine.contacts import contacts
from eqsim.engine.stationary import found_pinned, stationary
from eqsim.laws.aging import Aging
from eqsim.laws.stiffness import kappa
from eqsim.master.closed_forms import Published
from eqsim.master.curves import StationaryState
from eqsim.numerics.compiled import kernel
from eqsim.numerics.streams import TRAJECTORY, key, uniforms

ANNEALED, UNIFORM = {"disorder": "annealed"}, {"stiffness_law": "uniform"}
SMOOTH = [
    (Ensemble(Gamma(1.0, 2.0), Thermal(0.4), stiffness=0.7), 0.05),
    (Ensemble(Gamma(0.0), Thermal(0.2, 3.0, "stiff"), **UNIFORM), 0.1),
    (
        Ensemble(Gamma(2.5, 0.5), Thermal(0.1, 1.0, "stiff"), Delay(3.0), **ANNEALED),
        0.05,
    ),
    (
        Ensemble(Distribution(stats.lognorm(0.5)), Thermal(0.3), **ANNEALED, **UNIFORM),
        0.1,
    ),
    (Ensemble(Gamma(1.0)), 1.0),
]


def grid(ensemble, points=4001, least=1e-12):
    """Stretches, equidistant in ln x, up to one that a fraction exp(-45) of the
    thresholds exceeds."""
    law = ensemble.thresholds
    return np.geomspace(least * law.scale, float(law.inverse_survival(45.0)), points)


def cumulative(x, density):
    """The distribution function of a density tabulated on `grid`."""
    below = integrate.cumulative_simpson(density * x, x=np.log(x), initial=0)
    return interpolate.make_interp_spline(np.log(x), below + density[0] * x[0], k=3)


@pytest.mark.parametrize("kT", [0.05, 0.5, 5.0])
def test_closed_forms(kT):
    """n = 1, soft, uniform, x_* = 2: nt03, nt03a, nt08, nt09 and E_P to the documented
    1e-8; one per mille of temperature would show."""
    ensemble = Ensemble(
        Gamma(1.0, 2.0), Thermal(kT, 5.0), stiffness=3.0, **ANNEALED, **UNIFORM
    )
    state, v = StationaryState(ensemble, Drive(0.7)), 0.7
    form, other = (
        Published(T, stiffness=3.0, x_star=2.0, attempt_frequency=5.0)
        for T in (kT, 1.001 * kT)
    )
    x = np.append(np.geomspace(1e-3, 0.1, 20), np.linspace(0.1, 8.0, 80)).reshape(4, 25)
    np.testing.assert_allclose(state.P(x), form.P(x), rtol=1e-12)
    # u^2 - ln(1 + u^2) cancels
    np.testing.assert_allclose(state.U(x), form.U(x), rtol=1e-8, atol=1e-15)
    for name in ("H", "dU", "E_P"):
        found = getattr(state, name)(x)
        np.testing.assert_allclose(found, getattr(form, name)(x, v), rtol=1e-8)
        assert np.abs(found / getattr(other, name)(x, v) - 1).max() > 1e-5
    C = integrate.quad(form.E_P, 0, 14.0, args=(v,), epsabs=1e-13)[0]
    np.testing.assert_allclose(state.density(x), form.E_P(x, v) / C, rtol=1e-8)
    np.testing.assert_allclose(state.C, C, rtol=1e-9)
    assert state.dU(0.0) == 0.0
    assert state.H(0.0) == pytest.approx(float(form.H(0.0, v)), rel=1e-8, abs=0)


@pytest.mark.parametrize("force_scale", [1.0, 0.1, 0.01])
def test_off_rates_that_rise_by_two_hundred_decades(force_scale):
    """Bell bonds as stiff as each other are tried at k0 e^(x/x_b), and break if they
    draw a threshold above x: dU is the integral of k0/v e^(x/x_b) J_c, to the
    documented 1e-8, whatever rates the highest thresholds would allow."""
    bell = Thermal(barrier="bell", off_rate=1e-6, force_scale=force_scale)
    ensemble = Ensemble(Gamma(2.0), bell, **ANNEALED, **UNIFORM)
    law, v, x = ensemble.thresholds, 1e-4, np.geomspace(1e-6, 0.3, 30)
    dU = [
        integrate.quad(
            lambda y: 1e-6 / v * math.exp(y / force_scale) * law.sf(y),
            *(0.0, top),
            epsabs=0,
            epsrel=1e-10,
            limit=200,
        )[0]
        for top in x
    ]
    state = StationaryState(ensemble, Drive(v))
    np.testing.assert_allclose(state.dU(x), dU, rtol=1e-8)


@chosen(("ensemble", "v"), SMOOTH, [*SMOOTH[:3], SMOOTH[4]])
def test_normalised(ensemble, v):
    """int Q dx = 1 and, for uniform stiffness, int x Q dx = f_k, to 1e-8: the rule in
    ln x is exact to rounding."""
    x = grid(ensemble)
    state = StationaryState(ensemble, Drive(v))
    Q = state.density(x)
    assert x[0] * Q[0] + np.trapezoid(x * Q, np.log(x)) == pytest.approx(
        1.0, rel=1e-8, abs=0
    )
    if ensemble.stiffness_law == "uniform":
        force = np.trapezoid(x**2 * Q, np.log(x))
        assert force == pytest.approx(
            reference(ensemble, Drive(v)).f_k.value, rel=1e-8, abs=0
        )
    assert state.density(0.0) == pytest.approx(1 / state.C, rel=1e-8, abs=0)
    assert np.all(np.diff(Q) <= 1e-9 * Q[0])


@pytest.mark.parametrize("disorder", ["quenched", "annealed"])
@pytest.mark.parametrize("law", [Delta(2.0), Table([2.0, 0.5, 0.7, 0.7, 1.3])])
def test_discrete_laws(law, disorder):
    """Between thresholds, where Q is smooth, 40 Gauss nodes are exact to 1e-9."""
    state = StationaryState(Ensemble(law, Thermal(0.5), disorder=disorder), Drive(0.1))
    edges = np.append(0.0, np.unique(law.steps))
    parts = [
        integrate.fixed_quad(state.density, a, b, n=40)[0]
        for a, b in itertools.pairwise(edges)
    ]
    assert sum(parts) == pytest.approx(1.0, rel=1e-8, abs=0)
    assert state.density(2.0 * edges[-1]) == 0.0


@chosen(("ensemble", "v"), SMOOTH, [*SMOOTH[:3], SMOOTH[4]])
def test_marginal_of_the_joint_density(ensemble, v):
    """int dxi of the joint density is Q, by adaptive quadrature to 1e-10; beyond their
    threshold are no contacts."""
    state, mean = StationaryState(ensemble, Drive(v)), ensemble.thresholds.mean
    top = float(ensemble.thresholds.inverse_survival(45.0))
    for x in (0.0, 0.1 * mean, 0.9 * mean, 1.7 * mean):
        ends = np.append(x + (top - x) * np.array([0.0, 0.01, 0.05, 0.2, 0.5]), top)
        parts = [
            integrate.quad(
                lambda xi, x=x: float(state.joint_density(x, max(xi, 1e-12))),
                a,
                b,
                epsrel=1e-10,
            )[0]
            for a, b in itertools.pairwise(ends)
        ]
        assert sum(parts) == pytest.approx(float(state.density(x)), rel=1e-8, abs=0)
    assert state.joint_density(mean, [0.9 * mean, mean, 1.1 * mean]).astype(
        bool
    ).tolist() == [False, False, True]


@kernel
def snapshot(c, table, words, x, stiffness):
    for i in range(x.size):
        xi, x[i], _, _ = found_pinned(c, table, words, i, uniforms(words, i, 0, 0)[1])
        stiffness[i] = kappa(c.springs, xi)


STATIONARY = [
    (Gamma(1.0, 2.0), Thermal(0.4), 0.02),
    (Gamma(0.5), Thermal(0.3, 1.0, "stiff"), 0.1),
]


@chosen(
    ("disorder", "case"),
    itertools.product(("quenched", "annealed"), STATIONARY),
    [("quenched", STATIONARY[0]), ("annealed", STATIONARY[1])],
)
def test_particles_of_a_stationary_start(disorder, case):
    """Stretches of 20 000 contacts follow Q, and their thresholds (from k_i of the sqrt
    law) the other marginal of the joint density: Kolmogorov-Smirnov, false alarm 1e-4
    each, 8e-4 in all. The other ensemble fails."""
    law, thermal, v = case
    ensemble = Ensemble(law, thermal, disorder=disorder)
    c = contacts(ensemble, v)
    x, stiffness = np.empty((2, 20_000))
    snapshot(c, stationary(c), key(5, TRAJECTORY), x, stiffness)
    x, xi = x * law.scale, stiffness * law.rms

    share, weight = np.polynomial.legendre.leggauss(40)
    share, weight = (1 + share) / 2, weight / 2
    at = grid(ensemble, 401, 1e-5)

    def p_values(state):
        Q = cumulative(at, state.density(at))
        J = cumulative(
            at, at * (state.joint_density(at[:, None] * share, at[:, None]) @ weight)
        )
        # far below the 7e-3 that 20 000 contacts resolve
        assert Q(np.log(at[-1])) == pytest.approx(1.0, abs=1e-5)
        assert J(np.log(at[-1])) == pytest.approx(1.0, abs=1e-5)
        return [
            stats.kstest(sample, lambda s, F=F: F(np.log(s))).pvalue
            for sample, F in ((x, Q), (xi, J))
        ]

    assert min(p_values(StationaryState(ensemble, Drive(v)))) > 1e-4
    other = "annealed" if disorder == "quenched" else "quenched"
    assert (
        max(p_values(StationaryState(Ensemble(law, thermal, disorder=other), Drive(v))))
        < 1e-8
    )


def test_zero_temperature():
    """Q = J_c/C_0 (nt06), with the published functions for either ensemble."""
    state = StationaryState(Ensemble(Gamma(1.0, 2.0)), Drive(1.0))
    u = np.linspace(0, 4, 9)
    np.testing.assert_allclose(
        state.density(2 * u),
        2 / (3 * math.sqrt(math.pi)) * (1 + u**2) * np.exp(-(u**2)),
        rtol=1e-8,
    )
    np.testing.assert_allclose(
        state.E_P(2 * u), (1 + u**2) * np.exp(-(u**2)), rtol=1e-12
    )
    assert not state.H(u).any()
    assert not state.dU(u).any()
    assert state.P(1e3) == state.U(1e3) == math.inf


def test_refusals():
    quenched = StationaryState(Ensemble(thermal=Thermal(0.1)), Drive(0.1))
    discrete = StationaryState(
        Ensemble(Table([1.0, 2.0]), Thermal(0.1), **ANNEALED), Drive(0.1)
    )
    for name in ("P", "U", "H", "dU", "E_P"):
        with pytest.raises(InputError, match="annealed"):
            getattr(quenched, name)(1.0)
        with pytest.raises(InputError, match="density"):
            getattr(discrete, name)(1.0)
    with pytest.raises(InputError, match="Table"):
        discrete.joint_density(0.5, 1.0)
    for bad in (-1e-9, [1.0, math.nan], math.inf):
        with pytest.raises(InputError, match="x: every value"):
            quenched.density(bad)
    with pytest.raises(InputError, match="xi: every threshold"):
        quenched.joint_density(0.0, 0.0)
    with pytest.raises(InputError, match="aging"):
        StationaryState(Ensemble(aging=Aging("flow", 0.1, 2.0)), Drive(1.0)).density(
            1.0
        )
    with pytest.raises(InputError, match=r"^drive = 0.1: must be a Drive, for example"):
        StationaryState(Ensemble(), 0.1).density(1.0)
