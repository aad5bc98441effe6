"""Steady averages at many velocities at once: against single solves, and against the
pooled law of births."""

import math

import numpy as np
import pytest
import scipy.stats
from cases import chosen

from eqsim import (
    Aging,
    Delay,
    Delta,
    Distribution,
    Drive,
    Ensemble,
    Gamma,
    InputError,
    Thermal,
    reference,
    steady,
)
from eqsim.laws.barrier import Soft, Stiff, pooled
from eqsim.laws.barrier.pooled import pooled_rate
from eqsim.laws.newborn import Newborn
from eqsim.master.annealed import annealed_moments
from eqsim.master.steady import curve, lives_of, settled

VELOCITIES = np.geomspace(1e-4, 30.0, 9)
UNIFORM = {"stiffness_law": "uniform"}
CASES = {
    "annealed": Ensemble(thermal=Thermal(0.1), disorder="annealed", **UNIFORM),
    "annealed sqrt": Ensemble(Gamma(0.3, 2.0), Thermal(1e-3), disorder="annealed"),
    "annealed stiff": Ensemble(
        Gamma(4.0), Thermal(0.02, 3.0, "stiff"), disorder="annealed", **UNIFORM
    ),
    "annealed hot": Ensemble(
        Gamma(0.0), Thermal(30.0), Delay(0.4), disorder="annealed", eta=2.0
    ),
    "annealed narrow": Ensemble(
        Gamma(80.0), Thermal(0.1), disorder="annealed", **UNIFORM
    ),
    "annealed, another law": Ensemble(
        Distribution(scipy.stats.weibull_min(2.3)),
        Thermal(0.1),
        disorder="annealed",
        **UNIFORM,
    ),
    "annealed, aged at once": Ensemble(
        Gamma(2.0, 0.1),
        Thermal(0.1),
        aging=Aging("flow", math.inf, 1.0),
        disorder="annealed",
    ),
    "quenched": Ensemble(thermal=Thermal(0.1), **UNIFORM),
    "quenched sqrt": Ensemble(
        Gamma(3.0, 0.5), Thermal(0.1), Delay(0.2, "exponential"), eta=0.5
    ),
    "quenched stiff": Ensemble(Gamma(0.2), Thermal(1e-4, 1e6, "stiff")),
    "quenched cold": Ensemble(Gamma(1.0), Thermal(1e-7, 1e9), **UNIFORM),
    "quenched hot": Ensemble(Gamma(1.0), Thermal(20.0), **UNIFORM),
    "no heat": Ensemble(Gamma(2.0, 3.0), Thermal(0.0), Delay(0.1), eta=1.0),
    "identical": Ensemble(Delta(0.5), Thermal(0.02)),
    "born stretched": Ensemble(
        thermal=Thermal(0.1),
        newborn=Newborn("delta", "length", stretch=0.1),
        delay=Delay(0.3),
    ),
    "logarithmic": Ensemble(aging=Aging("logarithmic", beta=0.05, cutoff_time=0.1)),
}


@chosen(
    "name",
    CASES,
    [
        name
        for name in CASES
        if name not in ("annealed, aged at once", "born stretched")
    ],
)
def test_single_solves(name):
    """The same within the errors of both, which are small."""
    contacts = CASES[name]
    found = curve(contacts, VELOCITIES)
    for i, v in enumerate(VELOCITIES):
        exact = reference(contacts, Drive(v))
        for observable in ("friction", "pinned", "break_stretch"):
            estimate = getattr(exact, observable)
            value, error = (
                getattr(found, observable)[i],
                getattr(found, f"{observable}_error")[i],
            )
            assert value == pytest.approx(
                estimate.value, abs=error + estimate.stderr + 4e-16 * estimate.value
            )
            assert error <= 2e-8 * value


@chosen(
    ("n", "final", "D", "kT", "law"),
    [
        (*aging, kT, law)
        for aging in (
            (1.0, 1.0, 0.1),
            (6.0, 0.02, 3.0),
            (0.0, 3.0, 1e-3),
            (25.0, 0.3, 0.2),
        )
        for kT in (0.0, 0.1)
        for law in ("uniform", "sqrt")
    ],
    [
        (1.0, 1.0, 0.1, 0.1, "uniform"),
        (6.0, 0.02, 3.0, 0.0, "sqrt"),
        (0.0, 3.0, 1e-3, 0.1, "sqrt"),
        (25.0, 0.3, 0.2, 0.0, "uniform"),
    ],
)
def test_annealed_contacts_that_age(law, kT, n, final, D):
    """C is that of contacts born with the law of star1 that C implies, kept as splines
    whose errors, of P_c 2e-8, are the tolerance; and so is the work."""
    contacts = Ensemble(
        Gamma(n, 0.1),
        Thermal(kT),
        aging=Aging("flow", D, final),
        disorder="annealed",
        stiffness_law=law,
    )
    few = tuple(VELOCITIES[::4].tolist())
    found = lives_of(contacts, few)
    for i, v in enumerate(few):
        s = settled(contacts, v)
        if s.annealed:
            stretch, work = np.ravel(annealed_moments([s])[:2])
        else:
            stretch, work = (
                curve(Ensemble(s.law, stiffness_law=law), [v]).break_stretch[0] / 0.1,
                None,
            )
        assert found.stretch[i] == pytest.approx(
            stretch, rel=2e-8 + found.stretch_error[i] / stretch, abs=0
        )
        if work is not None:
            assert found.work[i] == pytest.approx(
                work, rel=4e-8 + found.work_error[i] / work, abs=0
            )
        assert found.stretch_error[i] < 2e-8 * stretch


@pytest.mark.parametrize("kT", [0.1, 0.3])
def test_fixed_points_that_are_known_to_the_last_bit(kT):
    """One velocity at a time: where a fixed point is found again with more panels, it
    may be known to the last bit already. As all together, within twice the errors."""
    aging = Aging("flow", rate=0.1, x_star_final=1.0)
    ensemble = Ensemble(Gamma(1.0, 0.1), Thermal(kT), aging=aging, disorder="annealed")
    velocities = np.logspace(-3, 1, 40)
    together = curve(ensemble, velocities)
    for i, velocity in enumerate(velocities):
        alone = reference(ensemble, Drive(float(velocity))).friction
        error = 2.0 * (alone.stderr + together.friction_error[i])
        assert alone.value == pytest.approx(together.friction[i], rel=0, abs=error)


@pytest.mark.parametrize(
    ("off_rate", "force_scale", "law", "rate", "final", "v"),
    [
        (0.3943, 0.9579, Gamma(1.0, 0.8914), 1.676e-4, 9.778, 0.1237),
        (0.01654, 0.1142, Gamma(1.0, 0.4685), 1.469e-3, 1.841, 1.093e-3),
    ],
)
def test_fixed_points_far_from_the_guess(off_rate, force_scale, law, rate, final, v):
    """Bonds whose lives are a tenth of a threshold, where the secant rule leads away at
    first: as simulated, |z| < 4.5 (7e-6)."""
    contacts = Ensemble(
        law,
        Thermal(barrier="bell", off_rate=off_rate, force_scale=force_scale),
        aging=Aging("flow", rate=rate, x_star_final=final),
        disorder="annealed",
    )
    exact = reference(contacts, Drive(v)).friction
    found = steady(contacts, Drive(v), rel_error=1e-3).friction
    error = math.hypot(found.stderr, exact.stderr)
    assert abs(found.value - exact.value) < 4.5 * error
    assert error < 3e-3 * exact.value


def test_mixtures_end_at_their_ends():
    """Very slow aging leaves newborn thresholds, very fast aging final ones."""
    given = {"thermal": Thermal(0.1), "disorder": "annealed", **UNIFORM}
    for D, plain in ((1e-14, Gamma(1.0, 0.2)), (1e14, Gamma(1.0, 1.0))):
        found = curve(
            Ensemble(Gamma(1.0, 0.2), aging=Aging("flow", D, 1.0), **given), VELOCITIES
        )
        # lengths are in units of the newborn scale, which decides nothing with uniform
        # stiffness
        exact = curve(Ensemble(plain, **given), VELOCITIES)
        np.testing.assert_allclose(found.friction, exact.friction, rtol=1e-9)


@pytest.mark.parametrize("barrier", [Soft, Stiff])
@pytest.mark.parametrize("stiffness", ["uniform", "sqrt"])
@pytest.mark.parametrize("n", [0.0, 0.7, 8.0, 60.0])
def test_pooled_rate(monkeypatch, barrier, stiffness, n):
    """The trapezoidal rule against panels, to 1e-9 wherever the rate is not negligible,
    and at y = 0 with uniform stiffness against (1 + b)^-(n + 1), exact."""
    y = np.concatenate(
        (np.geomspace(1e-8, 1.0, 20), np.linspace(1.1, math.sqrt(n + 1) + 5.0, 30))
    )
    for b in (1e-3, 0.3, 5.0, 200.0, 1e7):
        found = pooled_rate(Gamma(n), stiffness, barrier, b, np.append(0.0, y))
        if stiffness == "uniform":
            assert found[0] == pytest.approx((1.0 + b) ** -(n + 1.0), rel=1e-9, abs=0)
        with monkeypatch.context() as panels:
            panels.setattr(pooled, "_LARGEST_N", -1.0)
            exact = pooled_rate(Gamma(n), stiffness, barrier, b, y, finer=True)
        # `pooled_rate` is good to 1e-12 by the trapezoid and to 1e-10 by panels
        seen = exact > 1e-9
        np.testing.assert_allclose(found[1:][seen], exact[seen], rtol=1e-9)


@pytest.mark.parametrize("log_w", [45.0, 90.0, 200.0])
def test_attempts_so_many_that_rare_ones_count(log_w):
    """Laws solved by panels, where contacts break by successes rarer than exp(-45):
    curves, also with a fast drive beside, against single solves."""
    ensemble = Ensemble(Gamma(80.0), Thermal(0.5 / 3.0), disorder="annealed")
    v = math.exp(-log_w)
    exact = reference(ensemble, Drive(v)).friction.value
    assert curve(ensemble, [v, 1.0]).friction[0] == pytest.approx(
        exact, rel=1e-9, abs=0
    )


def test_bad_velocities():
    for wrong in ([], [[1.0]], [1.0, -1.0], [math.nan]):
        with pytest.raises(InputError, match="velocit"):
            curve(Ensemble(), wrong)
