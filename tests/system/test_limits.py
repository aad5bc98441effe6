"""Limits that eqsim states: memory does not know how many contacts there are, and a
grid may be as fine as it is allowed to be."""

import numpy as np
import pytest

from analysis.limits import measure
from eqsim import Drive, Ensemble, InputError, Thermal, trajectory


@pytest.mark.long
@pytest.mark.parametrize("contacts", [2 * 10**6, 10**8])
def test_memory_does_not_grow_with_contacts(contacts):
    """Peak memory of a run with many contacts is that with a thousand, but for what the
    allocator rounds up to; a single number per contact would take 16 MB."""
    few, many = (measure(count, 0.2, 101) for count in (1000, contacts))
    assert many.lives > 0.9 * contacts
    assert many.megabytes - few.megabytes < 8


@pytest.mark.parametrize(
    "points", [10**5 + 1, pytest.param(10**7 + 1, marks=pytest.mark.long)]
)
def test_finest_grids(points):
    """Forces do not depend on the grid: every point of a coarse one is a point of a
    fine one. Deposits are the same integers; X <= 10 is rounded in two ways, by 2e-15
    at the most, and enters with slopes <= 2 (means of k_i/k)."""
    ensemble, drive = Ensemble(thermal=Thermal(kT=0.1), count=1000), Drive(0.01, 10.0)
    coarse, fine = (
        trajectory(ensemble, drive, points=count, seed=2) for count in (101, points)
    )
    step = (points - 1) // 100
    assert fine.lives == coarse.lives
    np.testing.assert_array_equal(fine.pinned[::step], coarse.pinned)
    np.testing.assert_allclose(fine.force[::step], coarse.force, rtol=0, atol=1e-14)
    assert np.all(np.isfinite(fine.force_stderr))


def test_beyond_the_finest():
    with pytest.raises(InputError, match="points"):
        trajectory(Ensemble(count=1), Drive(1.0, 1.0), points=2 * 10**7 + 1)
