"""Contacts that never form again, as in a fibre bundle: `delay.time = inf`.

At T = 0 the force is F(X) = k X (1 - P_c(X)); with the Weibull law of shape 2 its peak
is at X = 1/sqrt(2) and is exp(-1/2)/sqrt(2)."""

import math
from dataclasses import replace

import numpy as np
import pytest
from cases import chosen

from eqsim import (
    Delay,
    Drive,
    Ensemble,
    InputError,
    Programme,
    Segment,
    Stage,
    Thermal,
    Weibull,
    curve,
    fluctuations,
    reference,
    stability,
    steady,
    trajectory,
    transient,
)
from eqsim.master.peak import first_peak

BUNDLE = Ensemble(
    Weibull(2.0), delay=Delay(math.inf), stiffness_law="uniform", count=100_000
)
WARM = replace(BUNDLE, thermal=Thermal(kT=0.1))
PULLED = Drive(1.0, distance=3.0)
BACK_AND_FORTH = Programme(
    [
        Segment(1.0, distance=0.7),
        Segment(0.0, time=10.0),
        Segment(-0.5, distance=2.0),
        Segment(2.0, distance=5.0),
    ]
)


def survival(X):
    return np.exp(-(X**2))


def largest_z(run, force, pinned):
    """The largest |z| of force and pinned share, where they have an error."""
    both = (run.force, force, run.force_stderr), (run.pinned, pinned, run.pinned_stderr)
    z = [np.abs(a - b)[error > 0] / error[error > 0] for a, b, error in both]
    return max(part.max(initial=0.0) for part in z)


def test_the_transient_is_that_of_a_bundle():
    """To 1e-8 and to the quoted errors; 3001 points."""
    exact = transient(BUNDLE, PULLED, points=3001, variance=True)
    X = exact.X
    off = np.abs(exact.force - X * survival(X))
    assert off.max() < 1e-8
    assert (off <= exact.force_error + 1e-15).all()
    assert np.abs(exact.pinned - survival(X)).max() < 1e-8
    spread = X**2 * survival(X) * (1.0 - survival(X))
    assert np.abs(exact.force_variance - spread).max() < 1e-8


def test_the_peak_of_a_bundle():
    peak = first_peak(BUNDLE, 1.0)
    exact = math.exp(-0.5) / math.sqrt(2.0)
    assert exact == pytest.approx(0.428881942, rel=0, abs=5e-10)
    assert abs(peak.force.value - exact) < peak.force.stderr
    assert peak.force.stderr < 1e-6
    assert peak.X.value == pytest.approx(math.sqrt(0.5), rel=0, abs=1e-3)


def test_a_run_of_a_bundle():
    """1e5 contacts, |z| < 4.5 at 300 instants that are not independent. Negative
    control: contacts that form again after a delay of 5 thresholds; and the law of the
    delay makes no difference."""
    run = trajectory(BUNDLE, PULLED, points=301)
    assert largest_z(run, run.X * survival(run.X), survival(run.X)) < 4.5
    other = trajectory(replace(BUNDLE, delay=Delay(1.0)), PULLED, points=301)
    assert largest_z(other, run.X * survival(run.X), survival(run.X)) > 4.5
    assert not run.averages.friction.reliable  # it is not steady
    law = replace(BUNDLE, delay=Delay(math.inf, "exponential"))
    assert (
        transient(law, PULLED).force.tolist()
        == transient(BUNDLE, PULLED).force.tolist()
    )


@chosen("bundle", [BUNDLE, WARM], [BUNDLE])
def test_a_programme(bundle):
    """There and back with a hold, 1e5 contacts: |z| < 4.5 in the errors of both, which
    a delay of 2 thresholds exceeds."""
    run = trajectory(bundle, BACK_AND_FORTH, points=101)
    exact = transient(bundle, BACK_AND_FORTH, points=101)
    run.force_stderr[:] = np.hypot(run.force_stderr, exact.force_error)
    run.pinned_stderr[:] = np.hypot(run.pinned_stderr, exact.pinned_error)
    assert largest_z(run, exact.force, exact.pinned) < 4.5
    again = trajectory(replace(bundle, delay=Delay(2.0)), BACK_AND_FORTH, points=101)
    assert largest_z(again, exact.force, exact.pinned) > 4.5


@pytest.mark.verification
def test_behind_a_stage():
    """8 ensembles of 2e4 warm contacts, a spring so soft that the bundle fails at once:
    |z| < 4.5, and nothing is left."""
    programme = Programme(
        [
            Segment(1.0, distance=0.5),
            Segment(0.0, time=1.0),
            Segment(0.5, distance=4.0),
        ],
        stage=Stage(0.2, damping=0.1),
    )
    bundle = replace(WARM, count=20_000)
    run = trajectory(bundle, programme, points=61, replicas=8)
    exact = transient(bundle, programme, points=61)
    run.force_stderr[:] = np.hypot(run.force_stderr, exact.force_error)
    run.pinned_stderr[:] = np.hypot(run.pinned_stderr, exact.pinned_error)
    assert largest_z(run, exact.force, exact.pinned) < 4.5
    assert run.pinned[-1] == run.force[-1] == 0.0


@pytest.mark.verification
@pytest.mark.usefixtures("not_by_events")
@pytest.mark.parametrize("law", ["uniform", "sqrt"])
def test_a_quasi_static_stage(law):
    """Break by break, 10 ensembles of 1e4 contacts behind a spring of kappa = 1, at
    which the bundle is stable: Y = X + F(X)/kappa. Every contact breaks once, in an
    avalanche of its own kind, and no energy is missing. |z| < 4.5, which contacts that
    form again at once exceed."""
    bundle = replace(BUNDLE, count=10_000, stiffness_law=law)
    programme = Programme([Segment(1.0, distance=5.0)], stage=Stage(1.0))
    run = trajectory(bundle, programme, points=51, replicas=10)
    exact = transient(bundle, programme, points=51)
    assert largest_z(run, exact.force, exact.pinned) < 4.5
    assert run.avalanches["breaks"].sum() == run.lives - 10 * 10_000 == 10 * 10_000
    assert run.force[-1] == run.pinned[-1] == 0.0
    work, stored, dissipated, _ = run.energy.T
    assert np.abs(work - stored - dissipated).max() < 1e-11
    again = trajectory(
        replace(bundle, delay=Delay()), programme, points=51, replicas=10
    )
    assert largest_z(again, exact.force, exact.pinned) > 4.5


@pytest.mark.usefixtures("not_by_events")
@pytest.mark.parametrize("count", [1, 2, 10])
def test_small_bundles_break_down_at_once(count):
    """Behind a soft spring all that is left breaks in one avalanche: it has no force
    afterwards, not even rounding, and the slider meets the stage."""
    bundle = replace(BUNDLE, count=count)
    programme = Programme([Segment(1.0, distance=500.0)], stage=Stage(1e-2))
    run = trajectory(bundle, programme, points=21, replicas=20)
    assert run.avalanches["breaks"].sum() == 20 * count
    assert run.force[-1] == run.pinned[-1] == 0.0
    assert run.X[-1] == 500.0


def test_steady_averages_are_those_of_detached_contacts():
    """The limit of a long delay: nothing is pinned, and friction is that of the drag
    alone, exactly; lives are as ever."""
    drag = replace(WARM, eta=0.3)
    known = reference(drag, PULLED, variance=True)
    long = reference(replace(drag, delay=Delay(1e12)), PULLED)
    for found in (known, steady(drag, PULLED, rel_error=1e-2)):
        assert found.friction.value == pytest.approx(0.3, rel=1e-15, abs=0)
        assert found.pinned.value == found.force_variance.value == 0.0
        assert found.friction.stderr == found.pinned.stderr == 0.0
        z = (found.travel.value - long.travel.value) / found.travel.stderr
        assert abs(z) < 4.5
    assert curve(drag, [1.0]).friction == known.friction.value
    assert long.friction.value == pytest.approx(0.3, rel=1e-11, abs=0)


@pytest.mark.parametrize(
    "call",
    [
        lambda: trajectory(BUNDLE, replace(PULLED, start="stationary")),
        lambda: transient(BUNDLE, replace(PULLED, start="stationary")),
        lambda: trajectory(BUNDLE, replace(BACK_AND_FORTH, start="stationary", velocity=1.0)),
        lambda: transient(BUNDLE, replace(BACK_AND_FORTH, start="stationary", velocity=1.0)),
        lambda: fluctuations(BUNDLE, PULLED),
        lambda: stability(BUNDLE, Programme([Segment(1.0, time=1.0)], stage=Stage(1.0))),
    ],
)  # fmt: skip
def test_there_is_no_stationary_state(call):
    with pytest.raises(InputError, match=r"delay\.time = inf: no contact forms again"):
        call()
