"""Mean field of sliders under a force and behind motors, against ordinary differential
equations that SciPy integrates."""

import math

import numpy as np
import pytest
from cases import chosen
from scipy import integrate, optimize

from eqsim import (
    Aging,
    Delay,
    Delta,
    Ensemble,
    InputError,
    Programme,
    Segment,
    Stage,
    Thermal,
    Weibull,
    transient,
)
from eqsim.master import slider

NEVER = Delay(math.inf)
BUNDLE = Ensemble(Weibull(2.0), delay=NEVER, stiffness_law="uniform")


def worst(found, known, error):
    """Largest difference in quoted errors, where there is one."""
    return np.max(np.abs(found - known) / np.where(error > 0.0, error, np.inf))


def test_a_bundle_under_a_ramp_lets_go():
    """X exp(-X^2) = f t up to its maximum; then X is not a number, and nothing is
    pinned. The lifetime is known better than its instants are apart."""
    found = transient(BUNDLE, Programme([Segment(force_rate=0.5, time=1.0)]), 101)
    strength = math.sqrt(0.5) * math.exp(-0.5)
    assert found.lifetime.value == pytest.approx(strength / 0.5, rel=1e-6, abs=0)
    assert found.lifetime.stderr < 1e-5
    holds = found.t < strength / 0.5

    def stretch(force):
        return optimize.brentq(
            lambda x: x * math.exp(-x * x) - force, 0.0, math.sqrt(0.5)
        )

    X = np.array([stretch(0.5 * t) for t in found.t[holds]])
    assert np.abs(found.X[holds] - X).max() < 1e-4
    assert worst(found.X[holds], X, found.X_error[holds]) < 1.5
    pinned = np.exp(-(X**2))
    assert worst(found.pinned[holds], pinned, found.pinned_error[holds]) < 1.5
    assert np.isnan(found.X[~holds]).all()
    assert not found.pinned[~holds].any()
    assert not found.force[~holds].any()


def test_a_constant_force_that_a_bundle_can_bear():
    found = transient(BUNDLE, Programme([Segment(force=0.42, time=1.0)]), 5)
    assert found.lifetime is None
    X = optimize.brentq(lambda x: x * math.exp(-x * x) - 0.42, 0.0, math.sqrt(0.5))
    assert found.X[1:] == pytest.approx(np.full(4, X), rel=0, abs=1e-3)
    gone = transient(BUNDLE, Programme([Segment(force=0.43, time=1.0)]), 5)
    assert gone.lifetime.value < 1e-6
    assert np.isnan(gone.X[1:]).all()


def test_forces_up_and_down():
    """A force that is taken away leaves what has broken; each segment goes on from the
    force at the end of the one before."""
    segments = [
        Segment(force_rate=0.4, time=1.0, points=1),
        Segment(force_rate=-0.4, time=1.0, points=1),
        Segment(force=0.2, time=1.0, points=1),
    ]
    found = transient(BUNDLE, Programme(segments), 4)
    X = optimize.brentq(lambda x: x * math.exp(-x * x) - 0.4, 0.0, math.sqrt(0.5))
    left = math.exp(-X * X)
    assert found.X[1:] == pytest.approx([X, 0.0, 0.2 / left], rel=0, abs=3e-4)
    assert found.pinned[1:] == pytest.approx([left] * 3, rel=0, abs=3e-4)


@chosen("force", [0.05, 0.4, 0.9], [])
def test_creep_to_failure(force):
    """All n pinned contacts have the stretch f/n, and break at n exp(-b (1 - x^2)) until
    it is 1: failure in a finite time, where X has an infinite slope, so that its error
    is compared up to 0.95 of the lifetime. Negative control: a force 1 % larger."""

    def rate(t, n):
        return [-n[0] * math.exp(-2.5 * (1.0 - min(force / n[0], 1.0) ** 2))]

    def holds(t, n):
        return n[0] - force

    holds.terminal = True
    known = integrate.solve_ivp(
        rate, (0, 1e3), [1.0], events=holds, rtol=1e-11, atol=1e-13, dense_output=True
    )
    end = known.t_events[0][0]
    bonds = Ensemble(Delta(), Thermal(0.2), NEVER)
    found = transient(bonds, Programme([Segment(force=force, time=1.5 * end)]), 61)
    assert abs(found.lifetime.value - end) < 1.5 * found.lifetime.stderr
    assert found.lifetime.stderr < 1e-3 * end
    early = (found.t > 0.0) & (found.t < 0.95 * end)
    X = force / known.sol(found.t[early])[0]
    assert worst(found.X[early], X, found.X_error[early]) < 2.0
    harder = Programme([Segment(force=1.01 * force, time=1.5 * end)])
    other = transient(bonds, harder, 3).lifetime
    assert abs(other.value - end) > 5.0 * other.stderr


def motor_with_constant_rate(kappa, eta, t):
    """X, force and pinned share of contacts that break at the rate 1/2 and are pinned at
    the rate 1, behind a motor of velocity 10 and stall force 3; D is the drag."""
    k, u, s = 0.5, 10.0, 3.0

    def motion(P, F, X, Y):
        D = eta * (1.0 - P)
        if kappa is None:
            return (s - F) / (s / u + D)
        if not eta:
            return (kappa * u * (1.0 - F / s) + k * F) / (kappa + P)
        return (kappa * (Y - X) - F) / (D + 1e-9)  # D = 0 at first

    def rate(t, y):
        P, F, X, Y = y
        V = motion(*y)
        dY = u * (1.0 - kappa * (Y - X) / s) if kappa else 0.0
        return [1.0 - P - k * P, P * V - k * F, V, dY]

    known = integrate.solve_ivp(
        rate, (0, t[-1]), [1.0, 0, 0, 0], "Radau", t, rtol=1e-9, atol=1e-10
    ).y
    V = np.array([motion(*y) for y in known.T])
    return known[2], known[1] + eta * (1.0 - known[0]) * V, known[0]


@pytest.mark.parametrize("eta", [0.0, 0.3])
@pytest.mark.parametrize("kappa", [None, 0.01, 1.0, 1e3])
def test_motors(kappa, eta):
    """On substrates from soft to rigid; no threshold is reached, and heat breaks
    contacts at any stretch at once. Negative control: a stall force 2 % larger."""
    contacts = Ensemble(
        Delta(30.0), Thermal(1e30, 0.5), Delay(1.0, "exponential"), eta=eta
    )
    stage = None if kappa is None else Stage(kappa)

    def solved(stall):
        segments = [Segment(10.0, time=6.0)]
        return transient(
            contacts, Programme(segments, stage=stage, stall_force=stall), 61
        )

    found = solved(3.0)
    X, force, pinned = motor_with_constant_rate(kappa, eta, found.t)
    later = slice(1, None)
    assert worst(found.X, X, found.X_error) < 2.0
    assert worst(found.force[later], force[later], found.force_error[later]) < 2.0
    assert worst(found.pinned, pinned, found.pinned_error) < 2.0
    assert np.max(found.X_error) < 0.02
    other = solved(3.06)
    assert worst(other.X, X, other.X_error) > 4.5


def test_a_motor_backwards_and_at_rest():
    """The way of the motor reversed is the same with other signs; without velocity it
    stands, and heat relaxes the contacts."""
    contacts = Ensemble(Delta(30.0), Thermal(1e30, 0.5), Delay(1.0, "exponential"))
    segments = [Segment(10.0, time=2.0), Segment(0.0, time=2.0, points=2)]
    there = transient(contacts, Programme(segments, stall_force=3.0), 21)
    segments[0] = Segment(-10.0, time=2.0)
    back = transient(contacts, Programme(segments, stall_force=3.0), 21)
    assert np.abs(there.X + back.X).max() < 2.0 * there.X_error.max()
    assert np.abs(there.force + back.force).max() < 2.0 * there.force_error.max()
    at_rest = there.t >= 2.0
    assert np.ptp(there.X[at_rest]) == 0.0
    force = there.force[at_rest][0] * np.exp(-0.5 * (there.t[at_rest] - 2.0))
    assert there.force[at_rest] == pytest.approx(force, rel=0, abs=2e-3)


def test_refused():
    motor = Programme(
        [Segment(1.0, time=1.0)], stage=Stage(1.0, mass=1.0), stall_force=1
    )
    with pytest.raises(InputError, match="must be 0 with drive"):
        transient(BUNDLE, motor)


def test_means_between_steps():
    """Interpolated up to the kinks between segments, within what is said; across a kink
    they are worse by far."""
    edges = np.append(np.linspace(0.0, 0.4, 40), np.linspace(0.4, 1.0, 61)[1:])
    t = np.linspace(0.0, 1.0, 777)

    def means(t):
        return np.array([np.abs(t - 0.4), np.sin(9.0 * t)])

    for ends, right in ((np.array([0.4, 1.0]), True), (np.array([1.0]), False)):
        found, bent = slider._between(edges, means(edges), ends, t)
        off = np.abs(found - means(t))
        assert np.all(off <= bent + 1e-12)
        assert (off.max() < 2e-4) == right


@pytest.mark.verification
def test_steps_that_end_at_fewer_instants(monkeypatch):
    """A velocity step behind a spring, with heat and thresholds that grow as ln t: the
    mean field agrees with that whose steps end at all instants, to a third of the error
    quoted, the difference to a solve of twice the steps: what a method of second order
    misses itself. Instants between steps may add no more than that error again."""
    contacts = Ensemble(
        thermal=Thermal(0.1),
        aging=Aging("logarithmic", beta=0.05, cutoff_time=0.1),
        stiffness_law="uniform",
    )
    segments = [Segment(0.1, distance=1.0), Segment(1.0, distance=2.0)]
    drive = Programme(segments, "stationary", 0.1, Stage(2.0))
    found = transient(contacts, drive, 701)
    monkeypatch.setattr(slider, "_MARKS", 1000)
    other = transient(contacts, drive, 701)
    assert worst(found.force, other.force, other.force_error) < 1.0 / 3.0
    assert worst(found.X[1:], other.X[1:], other.X_error[1:]) < 1.0 / 3.0
    assert np.all(found.force_error < 2.0 * other.force_error)
