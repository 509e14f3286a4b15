"""Means with their standard errors, shares with their intervals: by the definitions."""

import numpy as np

from dipoletop._base.statistics import mean_and_error, share_of


def test_mean_and_error_of_columns_and_of_too_few_values():
    columns = np.array([[1.0, 2.0], [3.0, 2.0], [8.0, 2.0]])
    mean, error = mean_and_error(columns)
    np.testing.assert_allclose(mean, [4, 2], rtol=1e-15)
    np.testing.assert_allclose(error, [np.sqrt((9 + 1 + 16) / 2 / 3), 0], rtol=1e-15)
    for n, known in ((0, np.nan), (1, 1.0)):
        mean, error = mean_and_error(columns[:n, 0])
        assert np.array_equal(mean, known, equal_nan=True)
        assert np.isnan(error)


def test_intervals_of_shares_end_at_0_and_1():
    assert share_of(0, 10).low == 0
    assert share_of(10, 10)[:3:2] == (1, 1)
    # With no hit of n the interval ends at z²/(n + z²).
    z2 = 1.959963984540054**2
    assert abs(share_of(0, 10).high - z2 / (10 + z2)) < 1e-15
