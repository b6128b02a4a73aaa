"""Surrogates keep what a UAV does by itself, and break who follows whom."""

import numpy as np
from series_windows import flight

from detectors.series.evidence import regression_evidence
from detectors.series.surrogates import compute_chance, shift_in_time


def test_a_shift_moves_every_sample_by_half_the_length():
    values = flight(0, 11, 3)
    for axis in (0, 1):
        moved = shift_in_time(values, axis)
        half = values.shape[axis] // 2
        for t in range(values.shape[axis]):
            at = (t + half) % values.shape[axis]
            np.testing.assert_array_equal(np.take(moved, at, axis), np.take(values, t, axis))


def test_in_reversed_time_followers_fly_ahead():
    velocity = flight(1, 80, 2)
    seen = np.ones((80, 2), bool)
    forward = regression_evidence(velocity, seen, 3, False, 1e-3)
    backward = regression_evidence(-velocity[::-1], seen, 3, False, 1e-3)
    assert forward.pairs[1, 0] > 0.5 > forward.pairs[0, 1]
    assert backward.pairs[0, 1] > 0.5 > backward.pairs[1, 0]


def test_chance_is_the_median_of_the_row_maxima():
    surrogate = np.array([[-np.inf, 0.1, 0.3], [0.7, -np.inf, 0.2], [0.1, 0.4, -np.inf]])
    assert compute_chance(surrogate) == 0.4
