"""follow-mixture on tracks that begin and end, and on a swarm that drifts as a whole."""

import numpy as np
import pytest
from mixture_windows import answer, swarm_window

from detectors.follow_mixture.motion import read_motion
from usnet_env import Window


def unit(vectors):
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def groups_then_others(seed, groups=3, followers=6, others=17, steps=60):
    """Groups whose followers fly towards their head leave before many independent UAVs come."""
    rng = np.random.default_rng(seed)
    uavs = others + groups * (followers + 1)
    leader = np.arange(uavs)
    leader[others:] = others + np.arange(uavs - others) // (followers + 1) * (followers + 1)
    independent = (leader == np.arange(uavs))[:, None]
    fresh = unit(rng.standard_normal((steps + 1, uavs, 3)))
    place, before = rng.uniform(-300.0, 300.0, (uavs, 3)), fresh[0]
    position, velocity = np.empty((steps + 1, uavs, 3)), np.empty((steps, uavs, 3))
    position[0] = place
    for t in range(steps):
        towards = place[leader] - place
        towards /= np.maximum(np.linalg.norm(towards, axis=1, keepdims=True), 1e-9)
        wanted = unit(before[leader] + 0.8 * towards + 0.05 * rng.standard_normal((uavs, 3)))
        velocity[t] = before = np.where(independent, fresh[t + 1], wanted)
        position[t + 1] = place = place + before
    seen = np.zeros((steps + 1, uavs), bool)
    seen[: 2 * steps // 3, others:] = True
    seen[2 * steps // 3 + 5 :, :others] = True
    both = seen[:-1] & seen[1:]
    return Window(
        np.where(seen[..., None], position, 0), np.where(both[..., None], velocity, 0), seen, np.ones(uavs, bool)
    )


@pytest.mark.parametrize("seed", [0, 1])
def test_a_follower_that_is_never_seen_together_with_its_head(seed):
    window = groups_then_others(seed)
    detection = answer(window)
    assert detection.candidates.any()
    assert np.isfinite(detection.scores).all()
    assert np.isfinite(detection.extras["probability"]).all()


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
