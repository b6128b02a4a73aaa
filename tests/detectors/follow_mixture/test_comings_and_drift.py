"""follow-mixture on tracks that begin and end, and on a swarm that drifts as a whole."""

import numpy as np
import pytest
from mixture_windows import answer
from synthetic_windows import swarm_window

from detectors.follow_mixture.motion import read_motion
from usnet_env import Window


def drifting(window, drift):
    """The same swarm in a wind of ``drift`` metres per step."""
    position = window.position + np.arange(len(window.position))[:, None, None] * np.asarray(drift)
    return Window(position, window.velocity + np.asarray(drift), window.seen, window.alive)


@pytest.mark.parametrize(
    ("drift", "config"),
    [
        (30.0, {"follow": "f4", "mobility": "smooth_turn"}),
        (100.0, {"follow": "f1", "mobility": "gauss_markov"}),
    ],
)
def test_a_common_drift_is_not_taken_for_one_speed(drift, config):
    window, truth = swarm_window(900, uavs=24, head_jitter=True, **config)
    detection = answer(drifting(window, [drift, 0.0, 0.0]))
    assert np.array_equal(detection.candidates, truth.head)


@pytest.mark.parametrize("mobility", ["iid", "smooth_turn"])
@pytest.mark.parametrize("drift", [[30.0, 0.0, 0.0], [0.0, -60.0, 80.0]])
def test_the_drift_of_uavs_of_one_speed_is_found_exactly(mobility, drift):
    window, _ = swarm_window(21, uavs=24, mobility=mobility)
    still, moved = (read_motion(some, np.arange(24)) for some in (window, drifting(window, drift)))
    assert still.unit
    assert moved.unit
    assert not still.drift.any()
    np.testing.assert_allclose(moved.drift, drift, atol=1e-3)
    np.testing.assert_allclose(moved.velocity, still.velocity, atol=1e-3)
