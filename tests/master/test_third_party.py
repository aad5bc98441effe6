"""The published master equation solved again by a third party, py-pde: nothing is
shared but the paper."""

import numpy as np
import pytest
from suites import needed

from eqsim import Drive, Ensemble, Thermal, reference
from eqsim.master.transient import transient


@pytest.mark.verification
@pytest.mark.parametrize("kT", [0.1, 1.0])
def test_published_master_equation(kT):
    """F(X) from a fresh start into the steady state. Central differences are of second
    order, which three grids show; two extrapolations to cells of no width differ by
    more than the better one is in error, so that this difference (3e-6 to 1e-5) is the
    tolerance. The quenched ensemble at the same kT is 0.1 away."""
    needed("pde")
    from published import END, POINTS, V, friction

    runs = [friction(0.5 / kT, cells) for cells in (100, 200, 400)]
    X, (coarse, fine, finest) = runs[0][0], [F for _, F in runs]
    order = np.log2(np.abs(fine - coarse).max() / np.abs(finest - fine).max())
    assert order == pytest.approx(2.0, abs=0.1)
    first, best = (4 * fine - coarse) / 3, (4 * finest - fine) / 3
    tolerance = np.abs(best - first).max()
    assert tolerance < 2e-5

    annealed = Ensemble(
        thermal=Thermal(kT), disorder="annealed", stiffness_law="uniform"
    )
    ours = transient(annealed, Drive(V, END), points=POINTS)
    np.testing.assert_allclose(X, ours.X, rtol=0, atol=1e-9)
    assert np.abs(best - ours.force).max() < tolerance
    assert best[-1] == pytest.approx(
        reference(annealed, Drive(V)).friction.value, abs=tolerance
    )

    quenched = Ensemble(thermal=Thermal(kT), stiffness_law="uniform")
    assert (
        np.abs(best - transient(quenched, Drive(V, END), points=POINTS).force).max()
        > 1000 * tolerance
    )
    assert (
        abs(best[-1] - reference(quenched, Drive(V)).friction.value) > 1000 * tolerance
    )
