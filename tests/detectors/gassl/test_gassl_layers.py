"""The compiled exp and tanh against NumPy's."""

import numpy as np
import pytest

from detectors.gassl.layers import exp_in_place, tanh_in_place


@pytest.mark.parametrize("size", [1, 7, 1000])
def test_exp_of_numbers_up_to_0(size):
    x = -np.random.default_rng(size).exponential(10.0, size).astype(np.float32)
    x[0] = 0.0
    expected = np.exp(x.astype(np.float64))
    exp_in_place(x, np.empty(size + 3, np.int32))
    np.testing.assert_allclose(x, expected, rtol=2e-5)
    assert x[0] == 1.0


@pytest.mark.parametrize("shape", [(1,), (5, 3), (2, 3, 4)])
def test_tanh_is_odd_bounded_and_numpys(shape):
    x = np.random.default_rng(0).normal(0, 3, shape).astype(np.float32)
    result, opposite = x.copy(), -x
    tanh_in_place(result)
    tanh_in_place(opposite)
    assert result.shape == shape
    np.testing.assert_allclose(result, np.tanh(x.astype(np.float64)), atol=2e-6)
    np.testing.assert_array_equal(opposite, -result)
    ends = np.array([-1e4, 1e4, 0.0], np.float32)
    tanh_in_place(ends)
    assert ends.tolist() == [-1.0, 1.0, 0.0]
