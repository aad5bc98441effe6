"""Growth of perturbations of chains of blocks, against a slider behind the spring of
each mode, and against numbers found twice."""

import json
import math

import numpy as np
import pytest
from command_line import call

from eqsim import (
    Chain,
    Delay,
    Ensemble,
    Gamma,
    InputError,
    Programme,
    Segment,
    Stage,
    Thermal,
    chain_modes,
    stability,
)

COLD = Ensemble(
    Gamma(1.0),
    Thermal(0.0),
    Delay(1.0, "gamma", shape=10.0),
    stiffness_law="uniform",
)

RING = """
disorder = "annealed"
[contacts]
count = 800
stiffness_law = "uniform"
[thermal]
kT = 0.1
[delay]
time = 1.0
[drive]
velocity = 0.3
[elastic]
blocks = 8
coupling = 0.05
drive_stiffness = 0.1
damping = 0.05
edges = "periodic"
"""


def chain(coupling=0.5, drive_stiffness=0.02, blocks=10, **more):
    return Programme(
        [Segment(0.3, distance=1.0)],
        chain=Chain(blocks, coupling, drive_stiffness, **{"damping": 0.03} | more),
    )


def slider(stiffness):
    stage = Stage(stiffness, damping=0.03)
    drive = Programme([Segment(0.3, distance=1.0)], stage=stage)
    return stability(COLD, drive)


def test_a_mode_is_a_slider_behind_a_stiffer_spring():
    found = chain_modes(COLD, chain(), wave_numbers=np.array([0.75, 0.0]))
    for row, q in enumerate((0.75, 0.0)):
        alone = slider(0.02 + 0.5 * (2.0 - 2.0 * math.cos(q)))
        error = found.growth_error[row] + alone.growth.stderr
        assert found.growth[row] == pytest.approx(alone.growth.value, rel=0, abs=error)
        frequency = 2.0 * math.pi / (alone.period.value or math.inf)
        assert found.frequency[row] == pytest.approx(frequency, rel=1e-6, abs=1e-6)
    assert found.softest.value == found.growth[1]
    assert found.lowest == 0.0


def test_the_critical_wave_number_is_that_of_the_critical_stiffness():
    border = slider(0.02).critical_stiffness.value
    assert border > 0.02
    free = chain_modes(COLD, chain()).critical_wave_number
    q = math.acos(1.0 - (border - 0.02) / (2.0 * 0.5))
    assert free.value == pytest.approx(q, rel=0, abs=free.stderr + 1e-6 * q)
    damped = chain_modes(COLD, chain(bulk_damping=0.05)).critical_wave_number
    assert 0.0 < damped.value < 0.98 * free.value
    stiff = chain_modes(COLD, chain(drive_stiffness=2.0 * border))
    assert stiff.critical_wave_number.value == 0.0
    assert stiff.verdict == "stable"
    # the stiffest mode, q = pi, has K_d + 4 K
    assert chain_modes(COLD, chain(1e-4)).critical_wave_number.value is None


def test_chains_that_are_pulled_at_the_edge_are_stable_if_they_are_short():
    """The softest mode with a stiff spring at the edge is pi/(2 B - 1)."""
    pulled = {"drive": "edge", "drive_stiffness": 1e6}
    every = {B: chain_modes(COLD, chain(blocks=B, **pulled)) for B in (2, 20)}
    for B, found in every.items():
        q = math.pi / (2.0 * B - 1.0)
        assert found.lowest == pytest.approx(q, rel=1e-5, abs=0)
        unstable = q < found.critical_wave_number.value
        assert found.verdict == ("unstable" if unstable else "stable")
    assert {found.verdict for found in every.values()} == {"stable", "unstable"}


@pytest.mark.parametrize("stiffness", [0.5, 5.0, 20.0])
def test_a_single_block_is_a_slider(stiffness):
    """Whatever pulls it, also behind a spring much stiffer than the critical one."""
    drive = Programme([Segment(3.0, distance=1.0)], stage=Stage(stiffness, 0.03))
    alone = stability(Ensemble(delay=Delay(1.0)), drive, critical=False)
    half = {"drive_stiffness": 0.5 * stiffness, "edge_stiffness": 0.5 * stiffness}
    for more in ({}, {"drive": "edge"}, {"drive": "both", **half}):
        block = Chain(
            1,
            **{"coupling": 0.01, "drive_stiffness": stiffness, "damping": 0.03} | more,
        )
        pulled = Programme([Segment(3.0, distance=1.0)], chain=block)
        found = chain_modes(Ensemble(delay=Delay(1.0)), pulled)
        assert (found.verdict, found.lowest) == (alone.verdict, 0.0)
        error = found.softest.stderr + alone.growth.stderr
        assert found.softest.value == pytest.approx(
            alone.growth.value, rel=0, abs=error
        )


def test_what_has_no_modes_is_refused():
    for drive, said in (
        (chain(), "no perturbation grows or decays"),
        (chain(load=(1.0,) * 9 + (2.0,)), "chain.load: must be even"),
        (chain(drive="edge", bulk_damping=0.1), "bulk_damping = 0.1"),
        (chain(coupling=0.0), "coupling = 0.0"),
        (Programme([Segment(0.3, distance=1.0)]), "must have a chain"),
    ):
        with pytest.raises(InputError, match=said):
            chain_modes(Ensemble(Gamma(1.0), Thermal(0.0)), drive)
    with pytest.raises(InputError, match="wave_numbers"):
        chain_modes(COLD, chain(), wave_numbers=np.array([4.0]))


@pytest.mark.verification
def test_modes_of_a_ring_of_eight_blocks():
    """Numbers found by solving the equation with integrals over the age by quadrature,
    in another program, to 3e-5 and 1e-6 (errors of its grid)."""
    warm = Ensemble(
        Gamma(1.0),
        Thermal(0.1),
        Delay(1.0),
        stiffness_law="uniform",
        disorder="annealed",
    )
    ring = chain(0.05, 0.1, 8, edges="periodic", damping=0.05)
    found = chain_modes(warm, ring, math.pi / 4.0 * np.arange(1.0, 4.0))
    growth, frequency = [0.081381, -0.008875, -0.073198], [0.628470, 0.727697, 0.786685]
    assert found.growth.tolist() == pytest.approx(growth, rel=3e-5, abs=1e-6)
    assert found.frequency.tolist() == pytest.approx(frequency, rel=1e-5, abs=0)
    assert found.critical_wave_number.value == pytest.approx(1.48907, rel=1e-5, abs=0)


@pytest.mark.verification
def test_command(tmp_path):
    """`eqsim stability` of a chain: the critical wave number of a ring of 8, known from
    another program."""
    (tmp_path / "ring.toml").write_text(RING)
    done = call("stability", tmp_path / "ring.toml", "--out", tmp_path / "out")
    assert done.exit_code == 0, done.output
    assert "perturbations longer than 4.22 blocks grow" in done.output
    assert (tmp_path / "out" / "modes.png").stat().st_size > 10_000
    found = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert found["critical_wave_number"]["value"] == pytest.approx(
        1.48907, rel=0, abs=1e-4
    )
    assert found["verdict"] == "unstable"
