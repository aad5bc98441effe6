"""Simulated bundles, clusters and motors against their exact laws, and motors against a
time-stepped script."""

import math

import numpy as np
import pytest
from scipy import stats

from analysis.motor_clutch import Clutch, stepped
from eqsim import (
    Delay,
    Delta,
    Ensemble,
    Gamma,
    Programme,
    Segment,
    Stage,
    Thermal,
    Weibull,
    bursts,
    lifetime,
    trajectory,
    transient,
)

NEVER = Delay(math.inf)


def creep(force, time):
    return Programme([Segment(force=force, time=time)])


@pytest.mark.parametrize("count", [1, 2, 10])
def test_lifetimes(count):
    """The mean of 1e5 lives or more, and the law by Kolmogorov and Smirnov's test.
    Negative control: a force 5 % smaller."""
    bonds = Ensemble(Delta(), Thermal(0.2), NEVER, count=count)
    replicas = max(20_000, 100_000 // count)
    drive = creep(0.4, 200.0)
    found = trajectory(bonds, drive, points=2, replicas=replicas, seed=5).lifetimes
    assert np.isfinite(found).all()
    exact = lifetime(bonds, drive, points=400)
    stderr = exact.std.value / math.sqrt(replicas)
    assert abs(found.mean() - exact.mean.value) < 4.5 * stderr
    t = np.quantile(found, np.linspace(0.02, 0.98, 25))
    law = np.interp(t, exact.t, exact.survival)
    seen = 1.0 - np.linspace(0.02, 0.98, 25)
    assert np.abs(law - seen).max() < stats.kstwobign.isf(1e-5) / math.sqrt(replicas)
    weaker = lifetime(bonds, creep(0.38, 200.0), points=2).mean.value
    assert abs(found.mean() - weaker) > 4.5 * stderr


def test_two_bonds_that_are_pinned_again_unstretched():
    """One that is pinned again bears nothing until the other breaks: with k of a bond
    at the force F of both, t = 1/(2 k(F/2)) + (1 + g/(k(F) + k(0)))/k(F). Equal shares
    of the force make it 18 % longer."""

    def k(x):
        return math.exp(-2.5 * (1.0 - x * x))

    g, replicas = 0.5, 20_000
    bonds = Ensemble(Delta(), Thermal(0.2), Delay(1.0 / g, "exponential"), count=2)
    found = trajectory(bonds, creep(0.3, 1e4), points=2, replicas=replicas, seed=6)
    exact = 1.0 / (2.0 * k(0.3)) + (1.0 + g / (k(0.6) + k(0.0))) / k(0.6)
    stderr = found.lifetimes.std() / math.sqrt(replicas)
    assert abs(found.lifetimes.mean() - exact) < 4.5 * stderr
    shared = Programme([Segment(force=0.3, time=1e4)], rebinding="shared")
    equal = lifetime(bonds, shared, points=2).mean.value
    assert equal == pytest.approx(1.179 * exact, rel=1e-3, abs=0)


def test_clusters_that_share_the_force_when_pinned_again():
    """Erdmann and Schwarz: 10 bonds. Negative control: a rate of births 3 % larger."""
    replicas, shared = 20_000, {"rebinding": "shared"}
    drive = Programme([Segment(force=0.45, time=1e4)], **shared)

    def bonds(tau):
        return Ensemble(Delta(), Thermal(0.2), Delay(tau, "exponential"), count=10)

    found = trajectory(bonds(2.0), drive, points=2, replicas=replicas, seed=9).lifetimes
    exact = lifetime(bonds(2.0), drive, points=2)
    stderr = exact.std.value / math.sqrt(replicas)
    assert abs(found.mean() - exact.mean.value) < 4.5 * stderr
    other = lifetime(bonds(1.94), drive, points=2).mean.value
    assert abs(found.mean() - other) > 4.5 * stderr


@pytest.mark.verification
def test_bursts():
    """Chi-square over 20 bundles of 2e5 contacts, and their strength. Negative control:
    sqrt law of stiffness in the curve."""
    contacts = Ensemble(
        Weibull(2.0), delay=NEVER, count=200_000, stiffness_law="uniform"
    )
    ramp = Programme([Segment(force_rate=0.5, time=1.0)])
    run = trajectory(contacts, ramp, points=2, replicas=20, seed=7)
    edges = np.array([1, 2, 3, 4, 6, 8, 12, 18, 27, 40, 60, 90, 140])
    counts = np.histogram(run.avalanches["breaks"], edges)[0]

    def chance(stiffness):
        ensemble = Ensemble(Weibull(2.0), stiffness_law=stiffness)
        number = bursts(ensemble, np.arange(1, 140)).number
        sums = np.add.reduceat(number, edges[:-1] - 1) * 200_000 * 20
        return stats.chi2.sf(np.sum((counts - sums) ** 2 / sums), counts.size)

    assert chance("uniform") > 1e-4
    assert chance("sqrt") < 1e-6
    strength = bursts(contacts, [1]).strength
    # the largest force of N contacts exceeds its mean course by about N^(-2/3) of it
    forces = 0.5 * run.lifetimes
    allowed = 4.5 * forces.std(ddof=1) / math.sqrt(20) + strength * 200_000 ** (-2 / 3)
    assert abs(forces.mean() - strength) < allowed


@pytest.mark.verification
@pytest.mark.parametrize("substrate", [None, 1.0])
def test_motors_beside_a_time_stepped_script(substrate):
    """75 clutches that let go at a constant rate; steps of 4 ms miss nothing of this
    scatter. Negative control: a stall force 2 % larger."""
    clutch = Clutch(velocity=10.0, force_scale=1e9, off_rate=0.5, on_rate=1.0)
    script = stepped(clutch, substrate, 60.0, 4e-3, 40, 2)
    contacts = Ensemble(
        Delta(1e5),
        Thermal(1e40, 0.5),
        Delay(1.0, "exponential"),
        count=75,
        stiffness=0.8,
    )
    stage = None if substrate is None else Stage(substrate / 60.0)

    def score(stall):
        motors = Programme(
            [Segment(10.0, time=60.0, points=600)], stage=stage, stall_force=stall / 0.8
        )
        run = trajectory(contacts, motors, points=2, replicas=100, seed=4)
        force = run.force_replicas[:, 301:].mean(axis=1) * 0.8
        error = force.std(ddof=1) / math.sqrt(100)
        return (force.mean() - script.force) / math.hypot(error, script.force_error)

    assert abs(score(2.0)) < 4.5
    assert abs(score(2.1)) > 4.5


def test_creep_of_many_contacts_is_the_mean_field():
    """X of 2000 contacts of different thresholds, 8 times, halfway to failure."""
    contacts = Ensemble(Gamma(), Thermal(0.1), NEVER, count=2000)
    drive = creep(0.4, 5.0)
    mean = transient(contacts, drive, 11)
    run = trajectory(contacts, drive, points=11, replicas=8, seed=8)
    assert np.isfinite(mean.X).all()
    sigma = np.hypot(run.X_stderr, mean.X_error)[1:]
    assert np.max(np.abs(run.X - mean.X)[1:] / sigma) < 5.5
