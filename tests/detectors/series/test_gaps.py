"""The one rule for missed samples."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from detectors.series.gaps import fill_gaps
from usnet_env import Window


def window_of(seed, steps=12, uavs=5, missed=0.3, gone=0.2):
    """A window with gaps, and the same without them."""
    rng = np.random.default_rng(seed)
    alive = rng.random(uavs) >= gone
    whole = np.cumsum(rng.standard_normal((steps + 1, uavs, 3)), axis=0)
    seen = (rng.random((steps + 1, uavs)) >= missed) & alive
    there = (seen[1:] & seen[:-1])[..., None]
    return Window(whole * seen[..., None], np.diff(whole, axis=0) * there, seen, alive, 2), whole


@given(st.integers(0, 2**31), st.integers(1, 15), st.integers(1, 6), st.sampled_from([0.0, 0.3, 0.8, 1.0]))
def test_a_filled_window_has_no_gaps_and_keeps_what_was_seen(seed, steps, uavs, missed):
    window, _ = window_of(seed, steps, uavs, missed)
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
    window, whole = window_of(1, steps=6, uavs=3, missed=0.0, gone=0.0)
    seen = np.ones((7, 3), bool)
    seen[2:4, 0] = False  # in the middle
    seen[:2, 1] = seen[6, 1] = False  # at both ends
    seen[:, 2] = False  # never seen
    there = (seen[1:] & seen[:-1])[..., None]
    holed = Window(window.position * seen[..., None], window.velocity * there, seen, np.ones(3))
    filled = fill_gaps(holed)
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
