"""Rows, columns and units of lagged regressions, against loops."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from series_windows import flight, gaps

from detectors.series.designs import centre_columns, centre_past, count_lags, stack_past


@given(st.integers(1, 120), st.integers(1, 12), st.sampled_from([3, 6, 9]), st.sampled_from([1.5, 2.5]))
def test_the_number_of_lags_leaves_enough_rows(steps, most, width, ratio):
    fitting = [lags for lags in range(1, most + 1) if steps - lags >= ratio * width * lags]
    assert count_lags(steps, most, width, ratio) == max(fitting, default=0)


@pytest.mark.parametrize("lags", [1, 3, 7, 12, 15])
def test_the_past_is_stacked_newest_first(lags):
    values = flight(0, 12, 4)
    past = stack_past(values, lags)
    assert past.shape == (4, max(0, 12 - lags), lags, 3)
    for i in range(4):
        for row in range(12 - lags):
            for lag in range(lags):
                np.testing.assert_array_equal(past[i, row, lag], values[lags + row - 1 - lag, i])


def test_columns_are_centred_over_what_was_seen():
    values, seen = flight(1, 10, 3), gaps(1, 10, 3, 0.4)
    seen[:, 2] = False
    centred = centre_columns(values, seen)
    for i in range(3):
        rows = [t for t in range(10) if seen[t, i]]
        for t in range(10):
            want = values[t, i] - np.mean([values[r, i] for r in rows], axis=0) if t in rows else np.zeros(3)
            np.testing.assert_allclose(centred[t, i], want, atol=1e-12)


@pytest.mark.parametrize("lags", [1, 4])
def test_the_centred_past_is_centred_lag_by_lag(lags):
    values, seen = flight(2, 15, 4), gaps(2, 15, 4)
    past = centre_past(values, seen, lags)
    for lag in range(1, lags + 1):
        part = slice(lags - lag, 15 - lag)
        want = centre_columns(values[part], seen[part]).swapaxes(0, 1)
        np.testing.assert_allclose(past[:, :, 3 * (lag - 1) : 3 * lag], want, atol=1e-12)
