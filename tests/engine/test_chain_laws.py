"""Chains of contacts of other laws than those of `test_chain`: bonds without
thresholds, births at a stretch, annealed disorder, thresholds that grow with age.

Every law has kernels of its own, whose compilation takes half a minute: most cases run
with -m verification.
"""

import math
from dataclasses import replace

import numpy as np
import pytest
from cases import chosen
from test_chain import STARTS, behind_a_stage, programme, step

from eqsim import (
    Aging,
    Chain,
    Delay,
    Drive,
    Ensemble,
    Newborn,
    NoThresholds,
    Pathway,
    Thermal,
    reference,
    trajectory,
    transient,
)
from eqsim.engine.chain import chained
from eqsim.engine.slider import Slider

WAITS = {"delay": Delay(1.0), "count": 400}
LAWS = {
    "bell": Ensemble(
        NoThresholds(1.0),
        Thermal(barrier="bell", off_rate=0.02, force_scale=0.2),
        **WAITS,
    ),
    "catch-slip": Ensemble(
        NoThresholds(1.0),
        Thermal(barrier="catch-slip", catch=Pathway(0.5, 0.2), slip=Pathway(0.02, 0.3)),
        **WAITS,
    ),
    "newborn": Ensemble(
        thermal=Thermal(0.1), newborn=Newborn("normal", mean=-0.1, std=0.2), **WAITS
    ),
    "newborn, cold": Ensemble(
        newborn=Newborn("uniform", "threshold", low=-0.3, high=0.5), **WAITS
    ),
    "annealed": Ensemble(thermal=Thermal(0.1), disorder="annealed", **WAITS),
    "logarithmic": Ensemble(
        thermal=Thermal(0.1),
        aging=Aging("logarithmic", beta=0.2, cutoff_time=0.5),
        **WAITS,
    ),
    "pooled": Ensemble(
        thermal=Thermal(0.1),
        disorder="annealed",
        aging=Aging("flow", float("inf"), 2.0),
        **WAITS,
    ),
}
OF_EACH_LAW = chosen("law", LAWS, [])


@OF_EACH_LAW
@pytest.mark.parametrize("mass", [0.0, 2.0])
@pytest.mark.parametrize("start", STARTS, ids=["fresh", "stationary"])
def test_one_block_is_a_slider_bit_for_bit(law, mass, start):
    contacts = LAWS[law]
    chain = Chain(1, 5.0, 0.25, mass=mass, damping=0.5)
    c = chained(contacts, programme(chain, **start), 3)
    with Slider(contacts, behind_a_stage(chain, **start), 3, 0, 1) as slider:
        for _ in range(600):
            step(c)
            slider.step(1e9, 1.0)
            here, now = c.course[0], slider.state
            assert (here["time"], here["Y"]) == (now.time, now.Y)
            assert (c.blocks.X[0], c.blocks.V[0]) == (now.X, now.V)
            assert c.now["force"][0] == now.sums.force
        assert c.blocks.breaks[0] > 0
        energies = now.work, now.damped, now.lost, now.missed
        assert tuple(here[["work", "damped", "lost", "missed"]]) == energies


@OF_EACH_LAW
@pytest.mark.parametrize("mass", [0.0, 2.0])
def test_blocks_without_coupling_are_separate_sliders_bit_for_bit(law, mass):
    """Sliders that take the steps of the chain, which are short enough for all three."""
    contacts = LAWS[law]
    chain = Chain(3, 0.0, 0.25, mass=mass, damping=0.5)
    alone = replace(contacts, count=100)
    c = chained(replace(contacts, count=300), programme(chain), 1)
    sliders = [Slider(alone, behind_a_stage(chain), 1, j, 1) for j in range(3)]
    s = c.course[0]
    for _ in range(600):
        before, dt = s["time"], s["dt"]
        step(c)
        dt *= 2.0 ** round(math.log2((s["time"] - before) / dt))  # it may be halved
        for j, slider in enumerate(sliders):
            slider.dt = dt
            now = slider.step(1e9, 1.0)
            assert (c.blocks.X[j], c.now["force"][j]) == (now.X, now.sums.force)
    assert c.blocks.breaks.min() > 0


UNIFORM = Chain(4, 2.0, 0.5, damping=0.5, bulk_damping=0.1, tolerance=1e-3)


@OF_EACH_LAW
def test_energy_is_kept(law):
    """Energies balance as in `test_chain`, up to the rounding of some 1e3 steps."""
    pulled = replace(UNIFORM, drive="both", edge_stiffness=1.0, mass=0.5)
    run = trajectory(LAWS[law], programme(pulled, 30.0, 0.3), points=11, replicas=2)
    work, stored, taken, missed = run.energy.T
    assert np.abs(work - stored - taken - missed).max() < 1e-13 * work.max()
    assert np.abs(missed).max() < 0.02 * work.max()
    assert run.lives > 2.4 * LAWS[law].count


def largest_score(contacts, drive, exact, error):
    """The largest |z| of force and displacement, in quoted errors, of 12 replicas of
    4 blocks of 1000 contacts, whose mean differs from that of infinitely many by some
    1e-3 of itself, a third of its error."""
    contacts = replace(contacts, count=4000)
    run = trajectory(contacts, drive, points=5, replicas=12)
    ours = np.stack((run.X, run.force))[:, 1:]
    sigma = np.hypot(np.stack((run.X_stderr, run.force_stderr))[:, 1:], error)
    return float(np.abs((ours - exact) / sigma).max())


@chosen("law", [name for name in LAWS if "newborn" not in name], [])
def test_equal_blocks_move_as_the_mean_field_of_one(law):
    """Eight scores at a time, each |z| < 4.5: false alarm 6e-5. Of hotter contacts some
    are beyond 4.5."""
    contacts = LAWS[law]
    drive = programme(UNIFORM, 10.0, 0.3)
    stage = replace(behind_a_stage(UNIFORM), segments=drive.segments)
    known = transient(contacts, stage, 5)
    exact = np.stack((known.X, known.force))[:, 1:]
    error = np.stack((known.X_error, known.force_error))[:, 1:]
    assert largest_score(contacts, drive, exact, error) < 4.5
    assert largest_score(hotter(contacts), drive, exact, error) > 4.5


def hotter(contacts):
    """Contacts that heat breaks faster, or three times as hot ones."""
    heat = contacts.thermal
    if heat.off_rate:
        heat = replace(heat, off_rate=2.0 * heat.off_rate)
    elif heat.slip:
        slip = heat.slip._replace(rate=4.0 * heat.slip.rate)
        heat = replace(heat, slip=slip)
    else:
        heat = replace(heat, kT=3.0 * heat.kT)
    return replace(contacts, thermal=heat)


@chosen("law", [name for name in LAWS if "newborn" in name], [])
def test_equal_blocks_slide_as_a_rigid_slider(law):
    """Blocks of contacts born stretched, in the stationary state: the force after two
    mean thresholds and more is that of a rigid slider. Four scores, |z| < 4.5: false
    alarm 3e-5; births that are not stretched fail."""
    contacts = LAWS[law]
    steady = programme(UNIFORM, 10.0, 0.3, start="stationary", velocity=0.3)
    known = reference(contacts, Drive(0.3)).friction
    for shown, right in (
        (contacts, True),
        (replace(contacts, newborn=Newborn()), False),
    ):
        run = trajectory(replace(shown, count=4000), steady, points=5, replicas=12)
        sigma = np.hypot(run.force_stderr[1:], known.stderr or 0.0)
        assert (np.abs((run.force[1:] - known.value) / sigma).max() < 4.5) == right
