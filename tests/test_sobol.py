"""Scrambled Sobol sequences against SciPy's, bit by bit."""

import numpy as np
import pytest
from scipy.stats import qmc

from eqsim.numerics.sobol import CELL, Sobol, put_points
from tests.kernels import compiled


def generators(count, seed=7):
    return [np.random.default_rng(np.random.SeedSequence((seed, i), spawn_key=(0,))) for i in range(count)]


def scipys(index, dimensions, points, seed=7):
    return qmc.Sobol(dimensions, rng=np.random.default_rng((seed, index))).random(points) + 2.0**-31


def points(sequences, index, first, count):
    """Those of one sequence, shape (count, dimensions)."""
    put, found = compiled(put_points), np.empty((len(sequences.shift), count), np.uint32)
    for start, words, row in zip(sequences.at(first)[:, index], sequences.words[:, index], found, strict=True):
        put(start, words, row)
    return (found.T + 0.5) * CELL


@pytest.mark.parametrize("dimensions", [1, 2, 3])
def test_points_are_those_of_scipy(dimensions):
    sequences = Sobol.of(generators(3), dimensions, 2**12)
    for index in range(3):
        found = points(sequences, index, 0, 2**12)
        assert np.array_equal(found, scipys(index, dimensions, 2**12))
        assert not np.array_equal(found, scipys(index, dimensions, 2**12, seed=8))
        assert np.array_equal(points(sequences, index, 3 * 2**10, 2**10), found[3 * 2**10 :])
        assert np.array_equal(points(sequences.some(slice(index, 3)), 0, 0, 2**12), found)


def test_one_point_each():
    assert np.array_equal(points(Sobol.of(generators(1), 2, 1), 0, 0, 1), scipys(0, 2, 1))
