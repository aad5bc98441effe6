"""Block means of long records: nothing is smeared, and their errors hold."""

import numpy as np
import pytest
from scipy.signal import lfilter

from eqsim.io.series import RowErrors, blocks_of, means


def peak(t):
    """A velocity step at t = 50."""
    after = np.maximum(t - 50.0, 0.0)
    decay = np.exp(-after / 2.0)
    return 0.6 + 1e-5 * t + (t > 50.0) * (0.01 * decay - 0.005 * (1.0 - decay))


def rows(size, correlation=0.0, sd=1e-3):
    t = np.linspace(0.0, 100.0, size)
    noise = np.random.default_rng(size).standard_normal(size)
    white = np.sqrt(1.0 - correlation**2)
    return t, peak(t) + sd * lfilter([white], [1.0, -correlation], noise)


@pytest.mark.parametrize("size", [4001, 100_000])
@pytest.mark.parametrize("correlation", [0.0, 0.9])
def test_blocks_smear_nothing(size, correlation):
    """Means are those of the curve at the mean time to 5/24 of their errors, whether or
    not the step is known; and chi-square of some hundred is between .7 (12 standard
    deviations of 1000 degrees of freedom) and 2: correlated rows have errors that are
    known to a factor of 1.4 only."""
    t, y = rows(size, correlation)
    for segment in (np.zeros(size, int), (t > 50.0).astype(int)):
        blocks = blocks_of(y, segment, RowErrors(np.zeros(size)))
        assert 100 < blocks.first.size <= 2000
        assert blocks.rows.sum() == size
        assert blocks.straight.all()
        at = peak(means(t, blocks))
        bias = (means(peak(t), blocks) - at) / blocks.error
        assert np.abs(bias).max() < 5 / 24
        score = (means(y, blocks) - at) / blocks.error
        assert 0.7 < np.mean(score**2) < 2.0


def test_blocks_that_are_given_say_what_they_smear():
    """Blocks of 2 in time, a tenth of which hold the peak and its decay."""
    t, y = rows(4001)
    given = np.floor(t / 2.0).astype(int)
    blocks = blocks_of(y, np.zeros(t.size, int), RowErrors(np.zeros(t.size)), given)
    assert blocks.first.size == 51
    smeared = np.flatnonzero(~blocks.straight)
    assert 25 in smeared
    assert smeared.size < 20
    fine = np.flatnonzero(means(t, blocks) < 40.0)
    score = (means(y, blocks) - peak(means(t, blocks)))[fine] / blocks.error[fine]
    # 20 degrees of freedom: outside in 1 of 10 000 cases
    assert 0.3 < np.mean(score**2) < 2.6


def test_errors_that_scatter_does_not_show_stay():
    """Rows without scatter whose errors are known are alike in their errors."""
    t, y = rows(4001, sd=0.0)
    blocks = blocks_of(y, (t > 50.0).astype(int), RowErrors(np.full(t.size, 1e-3)))
    assert blocks.first.size < 500
    np.testing.assert_allclose(blocks.error, 1e-3, rtol=1e-12, atol=0)  # rounding
