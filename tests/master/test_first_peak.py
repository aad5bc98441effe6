"""The first force peak of identical contacts at T = 0 (Farkas, Dahmen and Wolf, 2005:
peak over plateau is in [1, 2]).

Contacts that all break at x_* stay in step for ever: F(X) = X mod x_*, a sawtooth whose
peaks approach x_* from below, twice the plateau x_*/2, the upper end of the range. It
is the one law without a steady state (below Q6). The gamma family is in
master/test_reference.py.
"""

import numpy as np
import pytest

from eqsim import Delta, Drive, Ensemble, Table, reference, trajectory
from eqsim.master.transient import transient

# CELL in x_*: between points, and of the coarser grid of the master equation
X_STAR, PERIODS, CELL = (2.5, 20, 0.02)
DRIVE, POINTS = Drive(1.0, PERIODS * X_STAR), round(PERIODS / CELL) + 1
# of the cycle; an integer rule, so that rounding cannot move a jump
PHASE = np.arange(POINTS) % round(1 / CELL) * CELL
AWAY = (PHASE > 4.5 * CELL) & (PHASE < 1 - 4.5 * CELL)


def test_master_equation():
    """The exact sawtooth within the stated error, which covers the jumps; away from
    them, where the scheme sees a straight line over five points, it is below five
    cells. Two thresholds 20 % apart fall out of step."""
    found = transient(Ensemble(Delta(X_STAR), count=1), DRIVE, points=POINTS)
    exact = X_STAR * PHASE
    assert np.all(np.abs(found.force - exact) <= found.force_error)
    assert found.force_error[AWAY].max() < 5 * CELL * X_STAR
    peak, plateau = (
        int(np.argmax(found.force)),
        reference(Ensemble(Delta(X_STAR)), Drive(1.0)).friction.value,
    )
    assert plateau == pytest.approx(X_STAR / 2, rel=1e-10, abs=0)
    assert (
        abs(found.force[peak] / plateau - 2 * (1 - CELL))
        <= found.force_error[peak] / plateau
    )
    assert found.force[peak] / plateau < 2
    two = transient(Ensemble(Table([0.9 * X_STAR, 1.1 * X_STAR])), DRIVE, points=POINTS)
    assert np.any(np.abs(two.force - exact) > two.force_error + 0.2 * X_STAR)


@pytest.mark.parametrize("stiffness_law", ["sqrt", "uniform"])
def test_particles(stiffness_law):
    """The sawtooth to rounding (a fixed-point sum, 1e-12), in every period: peak over
    plateau is 2 less two cells."""
    run = trajectory(
        Ensemble(Delta(X_STAR), count=1000, stiffness_law=stiffness_law),
        DRIVE,
        points=POINTS,
    )
    np.testing.assert_allclose(run.force, X_STAR * PHASE, rtol=0, atol=1e-12)
    assert run.force.max() / (X_STAR / 2) == pytest.approx(
        2 * (1 - CELL), rel=1e-12, abs=0
    )
    last = run.force[-round(1 / CELL) - 1 : -1]
    assert np.ptp(last) == pytest.approx(X_STAR * (1 - CELL), rel=1e-12, abs=0)
