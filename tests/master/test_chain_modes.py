"""Growth of perturbations of chains of blocks, against a slider behind the spring of
each mode, and against numbers found twice."""

import math

import numpy as np
import pytest

from eqsim import Delay, Ensemble, Gamma, InputError, Stage, Thermal
from eqsim.master.chain_modes import chain_modes
from eqsim.master.stability import SteadyPull, critical_stiffness, stability

COLD = Ensemble(
    Gamma(1.0),
    Thermal(0.0),
    Delay(1.0, "gamma", shape=10.0),
    stiffness_law="uniform",
)
SOFT = Stage(stiffness=0.02, damping=0.03)


def test_a_mode_is_a_slider_behind_a_stiffer_spring():
    pulled = SteadyPull(COLD, 0.3, SOFT)
    found = chain_modes(pulled, 0.5, wave_numbers=np.array([0.75, 0.0]))
    for row, q in enumerate((0.75, 0.0)):
        stage = Stage(0.02 + 0.5 * (2.0 - 2.0 * math.cos(q)), damping=0.03)
        alone = stability(
            COLD, pulled._replace(stage=stage).programme(), critical=False
        )
        error = found.growth_error[row] + alone.growth.stderr
        assert found.growth[row] == pytest.approx(alone.growth.value, rel=0, abs=error)
        frequency = 2.0 * math.pi / (alone.period.value or math.inf)
        assert found.frequency[row] == pytest.approx(frequency, rel=1e-6, abs=1e-6)


def test_the_critical_wave_number_is_that_of_the_critical_stiffness():
    pulled = SteadyPull(COLD, 0.3, SOFT)
    border = critical_stiffness(pulled)
    assert border.value > 0.02
    free = chain_modes(pulled, 0.5).critical_wave_number
    q = math.acos(1.0 - (border.value - 0.02) / (2.0 * 0.5))
    assert free.value == pytest.approx(q, rel=0, abs=free.stderr + 1e-4 * q)
    damped = chain_modes(pulled, 0.5, bulk_damping=0.05).critical_wave_number
    assert 0.0 < damped.value < 0.98 * free.value
    stiff = pulled._replace(stage=Stage(2.0 * border.value, damping=0.1))
    assert chain_modes(stiff, 0.5).critical_wave_number.value == 0.0
    # the stiffest mode, q = pi, has K_d + 4 K
    assert chain_modes(pulled, 1e-4).critical_wave_number.value is None


def test_what_has_no_modes_is_refused():
    still = SteadyPull(Ensemble(Gamma(1.0), Thermal(0.0)), 0.3, SOFT)
    with pytest.raises(InputError, match="no perturbation grows or decays"):
        chain_modes(still, 1.0)
    pulled = SteadyPull(COLD, 0.3, SOFT)
    with pytest.raises(InputError, match="coupling = 0"):
        chain_modes(pulled, 0.0)
    with pytest.raises(InputError, match="wave_numbers"):
        chain_modes(pulled, 1.0, wave_numbers=np.array([4.0]))


@pytest.mark.verification
def test_modes_of_a_ring_of_eight_blocks():
    """Numbers found by solving the equation with integrals over the age by quadrature,
    in another program, to 3e-5 and 1e-6 (errors of its grid); those of eight mean fields that
    are followed in time agree to 2 %."""
    warm = Ensemble(
        Gamma(1.0),
        Thermal(0.1),
        Delay(1.0),
        stiffness_law="uniform",
        disorder="annealed",
    )
    pulled = SteadyPull(warm, 0.3, Stage(stiffness=0.1, damping=0.05))
    found = chain_modes(pulled, 0.05, wave_numbers=math.pi / 4.0 * np.arange(1.0, 4.0))
    growth, frequency = [0.081381, -0.008875, -0.073198], [0.628470, 0.727697, 0.786685]
    assert found.growth.tolist() == pytest.approx(growth, rel=3e-5, abs=1e-6)
    assert found.frequency.tolist() == pytest.approx(frequency, rel=1e-5, abs=0)
    assert found.critical_wave_number.value == pytest.approx(1.48907, rel=1e-5, abs=0)
