"""Sliders on a few contacts behind a spring, in holds: the engine against a brute
force, event by event."""

import math

import numpy as np
import pytest
from hold_oracle import Sled, simulate
from scipy import integrate

from eqsim import Delay, Ensemble, Programme, Segment, Stage, Thermal, trajectory
from eqsim.validation.pulled import pinned_in_hold as pinned


def ours(sled, replicas, seed=1):
    """The engine's run of the same slider over its first segment, a hold."""
    ensemble = Ensemble(
        thermal=Thermal(sled.kT, barrier="stiff" if sled.stiff else "soft"),
        delay=Delay(sled.delay, "exponential" if sled.exponential else "fixed"),
        stiffness_law="sqrt" if sled.sqrt else "uniform",
        disorder="annealed" if sled.annealed else "quenched",
        count=sled.count,
    )
    ((_, time),) = sled.segments
    stage = Stage(sled.stiffness, preload=sled.preload)
    return trajectory(
        ensemble,
        Programme((Segment(0.0, time=time, points=1),), stage=stage),
        points=2,
        seed=seed,
        replicas=replicas,
    )


def score(run, sled, wrong=""):
    """The pinned share after the hold of a run of the engine, less that of the brute
    force, over the joint error."""
    replicas = min(20_000, 200_000 // sled.count)
    exact = simulate(
        sled._replace(wrong=wrong),
        [sled.segments[0][1]],
        replicas,
        np.random.default_rng(1),
    )
    error = exact.pinned[0].std() / math.sqrt(replicas)
    return (run.pinned[-1] - exact.pinned[0].mean()) / math.hypot(
        run.pinned_stderr[-1], error
    )


def test_one_contact_by_quadrature():
    """The brute force of a single contact against an integral over its threshold, and
    that without heat is far off (|z| < 4.5: false alarm 7e-6 for each of two)."""
    for stiff in (False, True):
        sled = Sled(1, 0.1, 4.5, delay=1e12, stiff=stiff)
        found = simulate(sled, [100.0], 100_000, np.random.default_rng(1)).pinned[0]
        x = 0.45 / 1.1

        def survives(xi, stiff=stiff, x=x):
            gap = 1.0 - x / xi
            r = (
                math.sqrt(gap) * math.exp(-5 * xi**2 * gap**1.5)
                if stiff
                else math.exp(-5 * (xi**2 - x**2))
            )
            return 2.0 * xi**3 * math.exp(-(xi**2) - 100.0 * r)

        exact = integrate.quad(survives, x, 20.0, limit=500)[0]
        error = math.sqrt(exact * (1.0 - exact) / found.size)
        assert abs(found.mean() - exact) < 4.5 * error
        frozen = simulate(
            sled._replace(wrong="frozen"), [100.0], 10_000, np.random.default_rng(1)
        )
        assert frozen.pinned.mean() - exact > 10.0 * error


def test_anchors():
    """100 and 10 contacts after a hold of 100: pinned .604 and .581 (computed
    elsewhere, to 1e-3)."""
    for count, value, replicas in ((100, 0.604, 2000), (10, 0.581, 20_000)):
        found = simulate(
            Sled(count, 0.1, 4.5, delay=1e12),
            [100.0],
            replicas,
            np.random.default_rng(1),
        ).pinned[0]
        assert (
            abs(found.mean() - value) < 4.5 * found.std() / math.sqrt(replicas) + 1e-3
        )


@pytest.mark.parametrize(
    "case", [{}, {"stiff": True}, {"annealed": True}], ids=["soft", "stiff", "annealed"]
)
def test_two_contacts(case):
    """The law of two contacts that the validation uses against the brute force (|z| <
    4.5: false alarm 7e-6), which with a slider that stays where it is is far from it.
    """
    ensemble = Ensemble(
        thermal=Thermal(0.1, barrier="stiff" if case.get("stiff") else "soft"), stiffness_law="uniform", count=2,
        disorder="annealed" if case.get("annealed") else "quenched",
    )  # fmt: skip
    time = 5.0 if case.get("annealed") else 20.0
    exact, coarse = (
        pinned(ensemble, Stage(0.3, preload=2.5), each)(time) for each in (18, 9)
    )
    sled = Sled(2, 0.3, 2.5, ((0.0, time),), delay=1e12, **case)
    found = simulate(sled, [time], 40_000, np.random.default_rng(2)).pinned[0]
    assert abs(found.mean() - exact) < 4.5 * found.std() / math.sqrt(found.size) + abs(
        exact - coarse
    )
    wrong = simulate(
        sled._replace(wrong="pinned slider"), [time], 40_000, np.random.default_rng(2)
    )
    assert abs(wrong.pinned.mean() - exact) > 10.0 * found.std() / math.sqrt(found.size)


def test_a_hundred_contacts():
    """The engine after a hold against the brute force, and against one whose holds
    break no contact (|z| < 4.5: false alarm 7e-6)."""
    sled = Sled(100, 0.1, 4.5, delay=1e12)
    run = ours(sled, 10)
    assert abs(score(run, sled)) < 4.5
    assert abs(score(run, sled, "frozen")) > 8.0


@pytest.mark.verification
@pytest.mark.parametrize(
    "sled",
    [
        Sled(2, 0.1, 4.5, delay=1e12),
        Sled(10, 0.1, 4.5, delay=1e12),
        Sled(30, 0.3, 2.5, delay=1e12, stiff=True),
        Sled(10, 0.3, 2.5, delay=30.0, exponential=True, sqrt=True),
        Sled(100, 1.0, 1.5, delay=10.0),
        Sled(30, 0.3, 2.5, ((0.0, 5.0),), delay=1e12, annealed=True),
        Sled(100, 1e9, 0.4, delay=1e12, sqrt=True),
    ],
)
def test_holds(sled):
    """Sliders on 2 to 100 contacts (|z| < 4.5: false alarm 5e-5 in all)."""
    assert abs(score(ours(sled, 200), sled)) < 4.5
