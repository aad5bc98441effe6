"""Tables in octaves: the documented error of powers, exact nodes, both ends, and no
overshoot."""

import math

import numpy as np
import pytest
from kernels import compiled

from eqsim.numerics import tables
from eqsim.numerics.tables import CELLS, octave_edges, octave_table, search

look_up = compiled(tables.look_up)

EPS = np.finfo(float).eps


def looked_up(table, s):
    return np.array([look_up(table, value) for value in s])


def power_table(p, first, last):
    s = octave_edges(first, last)
    return octave_table(first, s**p, p * s ** (p - 1))


def random_arguments(first, last, count=4000):
    return 2.0 ** np.random.default_rng(1).uniform(first, last, count)


def test_edges():
    """Each octave in 64 equal cells."""
    edges = octave_edges(-2, 3)
    assert edges.size == 5 * CELLS + 1
    assert edges[0] == 0.25
    assert edges[-1] == 8.0
    assert edges[2 * CELLS] == 1.0
    np.testing.assert_array_equal(np.diff(edges[2 * CELLS : 3 * CELLS + 1]), 1 / CELLS)


@pytest.mark.parametrize("p", [0.1, 1 / 3, 0.5, 1.5, 2.5, 3.5, 6.0])
def test_documented_error_of_powers(p):
    """Below |p(p-1)(p-2)(p-3)| / (384 * 64^4), plus 4 eps of rounding; and not ten
    times below, so that the test can fail."""
    s = random_arguments(-40, 40)
    error = np.abs(looked_up(power_table(p, -40, 40), s) / s**p - 1)
    bound = abs(p * (p - 1) * (p - 2) * (p - 3)) / (384 * CELLS**4)
    assert error.max() < bound + 4 * EPS
    assert error.max() > bound / 10


@pytest.mark.parametrize("p", [1.0, 2.0, 3.0])
def test_cubics_are_exact(p):
    s = random_arguments(-40, 40)
    np.testing.assert_allclose(
        looked_up(power_table(p, -40, 40), s), s**p, rtol=8 * EPS
    )


def test_nodes_are_exact_and_cells_join():
    """At a node the value itself, just below it the same to rounding."""
    edges = octave_edges(-20, 20)
    table = octave_table(-20, np.sqrt(edges), 0.5 / np.sqrt(edges))
    np.testing.assert_allclose(looked_up(table, edges), np.sqrt(edges), rtol=2 * EPS)
    below = np.nextafter(edges[1:], 0)
    np.testing.assert_allclose(looked_up(table, below), np.sqrt(below), rtol=4 * EPS)


def test_beyond_the_ends():
    """A line through the origin below, a constant above, for arguments of any size."""
    table = power_table(0.5, -4, 4)
    for s in (5e-324, 1e-300, 2.0**-5, np.nextafter(2.0**-4, 0)):
        assert look_up(table, s) == pytest.approx(
            0.25 * (s * 16), rel=4 * EPS, abs=5e-324
        )
    for s in (16.0, np.nextafter(16.0, 17), 1e300, np.inf):
        assert look_up(table, s) == pytest.approx(4.0, rel=4 * EPS, abs=0)


def test_rising_data_give_a_rising_function():
    """Steps, plateaus, and slopes that would overshoot: limited to a monotone function
    that keeps the nodes."""
    rng = np.random.default_rng(2)
    edges = octave_edges(-1, 1)
    y = 1.0 + np.cumsum(
        rng.exponential(size=edges.size) * (rng.random(edges.size) < 0.3)
    )
    table = octave_table(-1, y, rng.exponential(1e3, edges.size))
    s = np.linspace(0.5, 2.0, 100_001)[:-1]
    found = looked_up(table, s)
    assert np.diff(found).min() >= -8 * EPS * y[-1]
    np.testing.assert_allclose(looked_up(table, edges[:-1]), y[:-1], rtol=4 * EPS)


@pytest.mark.parametrize("side", ["left", "right"])
@pytest.mark.parametrize("values", [[], [1.0], [0.0, 0.5, 0.5, 0.5, 2.0, math.inf]])
def test_search_is_that_of_numpy(values, side):
    values = np.array(values)
    for x in (-1.0, 0.0, 0.25, 0.5, 1.0, 2.0, 3.0, math.inf):
        assert compiled(search)(values, x, side == "right") == np.searchsorted(
            values, x, side=side
        )
