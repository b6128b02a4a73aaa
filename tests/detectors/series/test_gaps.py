"""The one rule for missed samples."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from synthetic_windows import window_of

from detectors.series.gaps import fill_gaps


@given(st.integers(0, 2**31), st.integers(1, 15), st.integers(1, 6), st.sampled_from([0.0, 0.3, 0.8, 1.0]))
def test_a_filled_window_has_no_gaps_and_keeps_what_was_seen(seed, steps, uavs, missed):
    rng = np.random.default_rng(seed)
    seen, alive = rng.random((steps + 1, uavs)) >= missed, rng.random(uavs) >= 0.2
    window = window_of(rng.standard_normal((steps, uavs, 3)), seen, alive, round=2)
    filled = fill_gaps(window)
    assert filled.round == window.round
    np.testing.assert_array_equal(filled.alive, window.alive)
    np.testing.assert_array_equal(filled.position[window.seen], window.position[window.seen])
    there = window.velocity_seen
    np.testing.assert_array_equal(filled.velocity[there], window.velocity[there])
    assert not filled.position[:, ~window.alive].any()
    assert not filled.velocity[:, ~window.alive].any()
    if window.seen.any():
        assert filled.seen[:, window.alive].all()
        moved = np.diff(filled.position.astype(float), axis=0)
        np.testing.assert_allclose(filled.velocity[:, window.alive], moved[:, window.alive], atol=1e-4)
    if window.seen[:, window.alive].all():
        assert filled is window


def test_missed_positions_lie_on_the_line_between_their_neighbours():
    velocity, seen = np.random.default_rng(1).standard_normal((6, 3, 3)), np.ones((7, 3), bool)
    whole = window_of(velocity).position
    seen[2:4, 0] = False  # in the middle
    seen[:2, 1] = seen[6, 1] = False  # at both ends
    seen[:, 2] = False  # never seen
    filled = fill_gaps(window_of(velocity, seen))
    for step in (1, 2):
        np.testing.assert_allclose(
            filled.position[1 + step, 0], whole[1, 0] + step / 3 * (whole[4, 0] - whole[1, 0]), atol=1e-6
        )
    for step in (1, 2, 3):
        np.testing.assert_allclose(filled.velocity[step, 0], (whole[4, 0] - whole[1, 0]) / 3, atol=1e-6)
    np.testing.assert_allclose(filled.position[:2, 1], whole[[2, 2], 1], atol=1e-6)
    np.testing.assert_allclose(filled.position[6, 1], whole[5, 1], atol=1e-6)
    assert not filled.velocity[[0, 1, 5], 1].any()
    np.testing.assert_allclose(filled.position[:, 2], filled.position[:, :2].mean(axis=1), atol=1e-6)
