import gymnasium as gym
import numpy as np
import pytest

from usnet_env import ArgumentError, Detection, Window
from usnet_env.detection import Tags, fit_window

N = 4


def parts(**changes):
    values = {
        "candidates": np.array([1, 0, 0, 1], np.int8),
        "scores": np.arange(N, dtype=np.float32),
        "clusters": [0, 0, -1, 1],
        "leader": np.array([0, 0, -1, 3]),
        "attention": np.eye(N),
        "extras": {"probability": np.full(N, 0.5)},
    }
    return {**values, **changes}


def test_types_and_read_only_copies():
    whole = parts()
    detection = Detection(**whole)
    types = {"candidates": bool, "scores": float, "clusters": np.int64, "leader": np.int64, "attention": float}
    for name, dtype in types.items():
        array = getattr(detection, name)
        assert array.dtype == dtype
        np.testing.assert_array_equal(array, whole[name])
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0
    whole["candidates"][:] = 0
    whole["extras"]["late"] = 1
    assert detection.candidates.sum() == 2
    assert "late" not in detection.extras


def test_only_candidates_and_scores_are_needed():
    detection = Detection(candidates=[True, False], scores=[1, 0])
    assert (detection.clusters, detection.leader, detection.attention, detection.extras) == (None, None, None, {})


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("candidates", [0, 0.5, 0, 0]),
        ("candidates", [[0, 1]]),
        ("candidates", None),
        ("scores", np.zeros(3)),
        ("scores", [0, 0, 0, np.nan]),
        ("clusters", [0, 0, 0]),
        ("clusters", [0, 0.5, 1, 1]),
        ("leader", [0, 0, 0, 4]),
        ("leader", [0, 0, 0, -2]),
        ("leader", [0, 0, 0, 1.5]),
        ("attention", np.zeros((N, N - 1))),
        ("extras", [1, 2]),
        ("probability", [0, 0.5, 1, 1.5]),
        ("probability", [0.5]),
    ],
)
def test_a_bad_part_is_refused_in_one_sentence_that_names_it(name, value):
    with pytest.raises(ArgumentError, match=rf"^{name} must .*, got .*\.$") as caught:
        Detection(**parts(**({"extras": {name: value}} if name == "probability" else {name: value})))
    assert "\n" not in str(caught.value)


class MadeForUnitSpeed:
    tags = Tags(needs_unit_speed=True)


def test_recorded_tracks_are_scaled_for_a_detector_that_was_made_for_one_metre_a_step():
    track = np.arange(5)[:, None, None] * np.array([[3.0, 4.0, 0.0], [30.0, 40.0, 0.0]])
    masks = {"seen": np.ones((5, 2), bool), "alive": [True, False]}
    recorded = Window(track, np.diff(track, axis=0), **masks, step=0.5)
    fitted = fit_window(MadeForUnitSpeed(), recorded)  # the second UAV counts for nothing
    np.testing.assert_allclose(fitted.velocity[:, 0], np.broadcast_to([0.6, 0.8, 0.0], (4, 3)), rtol=1e-6)
    np.testing.assert_allclose(fitted.position, track / 5, rtol=1e-6)
    assert fit_window(object(), recorded) is recorded
    simulated = Window(track, np.diff(track, axis=0), **masks)
    assert fit_window(MadeForUnitSpeed(), simulated) is simulated
    still = Window(0 * track, 0 * np.diff(track, axis=0), **masks, step=0.5)
    assert fit_window(MadeForUnitSpeed(), still).velocity.any() == 0


@pytest.mark.parametrize("follow", ["f1", "chain"])
def test_after_names_the_next_head_of_each_orphan(follow):
    env = gym.make("usnet_env:USNET/MultiCluster-v0", follow=follow, clusters=3, uavs=20, memory=16)
    window = Window.from_observation(env.reset(seed=5)[0])
    swarm = env.unwrapped.swarm
    truth = Detection(swarm.head, swarm.head * 1.0, leader=swarm.source)
    removed = np.zeros(20, bool)
    removed[[np.flatnonzero(swarm.head)[1], *np.flatnonzero(~swarm.head)[3:6]]] = True
    assert truth.after(np.zeros(20, bool), window).tolist() == swarm.root.tolist()
    said = truth.after(removed, window)
    env.step(removed)
    assert said.tolist() == np.where(removed, -1, env.unwrapped.swarm.root).tolist()
    assert (truth.after(swarm.head, window) == -1).all()
    by_cluster = Detection(swarm.head, swarm.head * 1.0, clusters=swarm.root).after(np.zeros(20, bool), window)
    assert by_cluster.tolist() == swarm.root.tolist()
    with pytest.raises(ArgumentError, match=r"^removed must have shape \(20,\)"):
        truth.after([True], window)
