"""Scrambled Sobol sequences against SciPy's, bit by bit."""

import numpy as np
import pytest
from scipy.stats import qmc

from eqsim.numerics.sobol import Sobol


def generators(count, seed=7):
    return [
        np.random.default_rng(np.random.SeedSequence((seed, i), spawn_key=(0,)))
        for i in range(count)
    ]


def scipys(index, dimensions, points, seed=7):
    return (
        qmc.Sobol(dimensions, rng=np.random.default_rng((seed, index))).random(points)
        + 2.0**-31
    )


@pytest.mark.parametrize("dimensions", [1, 2, 3])
def test_points_are_those_of_scipy(dimensions):
    sequences = Sobol.of(generators(3), dimensions, 2**12)
    found = sequences.points(0, 2**12)
    assert found.shape == (dimensions, 3, 2**12)
    for index in range(3):
        assert np.array_equal(found[:, index].T, scipys(index, dimensions, 2**12))
        assert not np.array_equal(
            found[:, index].T, scipys(index, dimensions, 2**12, seed=8)
        )
    later = sequences.points(3 * 2**10, 2**10)
    assert np.array_equal(later, found[:, :, 3 * 2**10 :])


def test_one_point_each():
    assert np.array_equal(
        Sobol.of(generators(1), 2, 1).points(0, 1)[:, 0].T, scipys(0, 2, 1)
    )
