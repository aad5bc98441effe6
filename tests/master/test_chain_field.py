"""Mean field of a chain of blocks, against that of a slider behind a stage, a chain in
equilibrium, and the growth of its modes."""

import math

import numpy as np
import pytest
from chain_field import Links, chain_field

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
    transient,
)

WARM = Ensemble(
    Gamma(1.0),
    Thermal(0.1),
    Delay(1.0),
    stiffness_law="uniform",
    disorder="annealed",
)
COLD = Ensemble(Gamma(1.0), Thermal(0.0), stiffness_law="uniform")


@pytest.mark.verification
def test_one_block_is_a_slider_behind_a_stage():
    drive = Programme([Segment(0.3, distance=3.0)], stage=Stage(0.1, damping=0.05))
    found = chain_field(WARM, drive, Links(np.array([0.1]), 0.0), 200)
    alone = transient(WARM, drive, 5)
    assert found.X[::50, 0] == pytest.approx(alone.X, rel=0, abs=alone.X_error.max())
    error = alone.force_error.max()
    assert found.force[::50, 0] == pytest.approx(alone.force, rel=0, abs=error)
    # equal blocks move alike, whatever couples them
    three = chain_field(WARM, drive, Links(np.full(3, 0.1), 5.0, ring=True), 200)
    assert np.abs(three.X - found.X).max() < 1e-6


@pytest.mark.verification
def test_a_chain_that_is_pulled_slowly_at_its_edge():
    """Its edge bears sqrt(2 K W) + F/2 but for the next order in 1/sqrt(K); that force
    in equilibrium is 4.69940 at X_0 = 1 (`test_chains`), here but for a drag of
    0.002."""
    drive = Programme([Segment(1.0, distance=1.005)], stage=Stage(1e3, damping=1e-4))
    plate = np.append(1e3, np.zeros(31))
    found = chain_field(COLD, drive, Links(plate, 20.0), 100)
    pulled = 1e3 * (found.t - found.X[:, 0])
    assert np.interp(1.0, found.X[:, 0], pulled) == pytest.approx(
        4.6994, rel=1e-3, abs=0
    )


def test_what_has_no_mean_field_is_refused():
    two = Programme([Segment(0.3, distance=3.0)] * 2, stage=Stage(0.1))
    with pytest.raises(InputError, match="one segment"):
        chain_field(WARM, two, Links(np.ones(2), 1.0), 10)


@pytest.mark.verification
def test_a_slip_needs_short_steps():
    drive = Programme([Segment(0.3, distance=100.0)], stage=Stage(0.02, damping=1e-4))
    with pytest.raises(InputError, match="steps = 20: are too few"):
        chain_field(COLD, drive, Links(np.full(2, 0.02), 1.0), 20)


@pytest.mark.verification
@pytest.mark.parametrize("mode", [1, 2, 3])
def test_modes_grow_as_the_characteristic_equation_says(mode):
    """Modes of a ring of eight blocks that are even about an edge, as those of four
    with free ends. Half the difference of two perturbations of opposite sign is free of
    even orders and of what cohorts make by themselves. It is one mode from five units
    of time on: from two on the smallest rate of growth is 13 % off, whatever the mesh.
    2 % of growth and of frequency: cohorts and steps of this width leave .8 %; without
    coupling p is 20 % off or more."""
    drive = Programme(
        [Segment(0.3, distance=4.8)],
        stage=Stage(0.1, damping=0.05),
        start="stationary",
        velocity=0.3,
    )
    shape = np.cos(0.25 * math.pi * mode * (np.arange(4.0) + 0.5))

    def root(coupling):
        links = Links(np.full(4, 0.1), coupling)
        up, down = (
            chain_field(WARM, drive, links, 160, offset=x * shape, fine=8.0).X
            for x in (0.006, -0.006)
        )
        u = ((up - down) @ shape)[50:]  # at every tenth of a unit of time
        before = np.stack([u[20:-20], u[:-40]], axis=1)
        first, second = np.linalg.lstsq(before, u[40:], rcond=None)[0]
        z = np.roots([1.0, -first, -second]).astype(complex)
        return np.log(z[np.argmax(z.imag)]) / 2.0

    chain = Chain(8, 0.05, 0.1, damping=0.05, edges="periodic")
    sliding = Programme([Segment(0.3, distance=1.0)], chain=chain)
    modes = chain_modes(WARM, sliding, np.array([0.25 * math.pi * mode]))
    p = complex(modes.growth[0], modes.frequency[0])
    found = root(0.05)
    assert found.real == pytest.approx(p.real, rel=0.02, abs=0)
    assert found.imag == pytest.approx(p.imag, rel=0.02, abs=0)
    if mode == 1:
        assert abs(root(0.0) - p) > 0.04 * abs(p)
