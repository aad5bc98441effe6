"""Adaptive panels: functions that are known, in few evaluations."""

import math

import numpy as np
import pytest

from eqsim.numerics.panels import ClenshawCurtis, refined


def integral(function, edges, converged=1e-12, **given):
    """Of a function from x to y, by panels; and their ends."""

    def evaluate(left, right, _):
        half = 0.5 * (right - left)[:, None]
        y = function(left[:, None] + half * (1 + ClenshawCurtis.nodes)) * half
        return np.array(
            [y @ ClenshawCurtis.weights, np.abs(y @ ClenshawCurtis.tail).sum(axis=1)]
        )

    def judge(p):
        return p.values[1] > converged, p.values[0].sum()

    p, total = refined(evaluate, judge, np.asarray(edges), **given)
    return total, np.append(p.left, p.right[-1])


@pytest.mark.parametrize("width", [1.0, 1e-3, 1e-6])
def test_a_peak(width):
    """A Lorentzian peak at 0.3, to the 1e-12 left unresolved by each of some ten
    panels; without splits it is lost."""
    exact = math.atan(0.7 / width) + math.atan(0.3 / width)
    total, ends = integral(lambda x: width / (width**2 + (x - 0.3) ** 2), [0.0, 1.0])
    assert total == pytest.approx(exact, rel=1e-11, abs=0)
    assert np.all(np.diff(ends) > 0)
    assert (ends[0], ends[-1]) == (0.0, 1.0)
    rough, _ = integral(
        lambda x: width / (width**2 + (x - 0.3) ** 2), [0.0, 1.0], most=0
    )
    assert (abs(rough / exact - 1) > 1e-3) == (width < 1.0)


def test_pieces():
    """A root is reached in few panels if these crowd towards 0; intervals are apart
    from each other."""
    even = integral(np.sqrt, [0.0, 1.0])
    crowded = integral(
        np.sqrt,
        [0.0, 1.0],
        pieces=np.array([0, 0.5, 1]),
        pieces_at_0=np.array([0, 1e-3, 1]),
    )
    for total, _ in (even, crowded):
        assert total == pytest.approx(2 / 3, rel=1e-11, abs=0)
    assert crowded[1].size < even[1].size

    def evaluate(left, right, interval):
        half = 0.5 * (right - left)
        return np.array([(left + half) ** 2 * 2 * half * (1 + interval), 2 * half])

    p, _ = refined(
        evaluate,
        lambda p: ((p.values[1] > 1e-3) & (p.interval == 1), None),
        np.array([0.0, 1.0]),
        intervals=3,
    )
    assert np.bincount(p.interval).tolist() == [1, 1024, 1]
    sums = np.bincount(p.interval, p.values[0])
    np.testing.assert_allclose(sums, [0.25, 2 / 3, 0.75], rtol=1e-6)  # the middle rule
