"""The two things that cross the border between the world and a detector: a window and a detection."""

import gymnasium as gym
import numpy as np
import pytest
from hypothesis import given
from hypothesis.extra import numpy as hnp

from usnet_env import ArgumentError, Detection, Window
from usnet_env.detection import Tags, fit_window


def parts(instants=4, uavs=3, **changes):
    rng = np.random.default_rng(0)
    values = {
        "position": rng.normal(size=(instants, uavs, 3)),
        "velocity": rng.normal(size=(instants - 1, uavs, 3)),
        "seen": np.ones((instants, uavs), np.int8),
        "alive": np.ones(uavs, np.int8),
        "round": 1,
    }
    return {**values, **changes}


def test_fields_sizes_and_types():
    window = Window(**parts(instants=6, uavs=5, round=np.int64(3)))
    assert (window.uavs, window.observation_steps, window.round) == (5, 5, 3)
    assert type(window.round) is int
    names, types = ("position", "velocity", "seen", "alive"), [np.float32, np.float32, bool, bool]
    assert [getattr(window, name).dtype for name in names] == types


def test_arrays_are_read_only_copies():
    given_parts = parts()
    window = Window(**given_parts)
    for name in ("position", "velocity", "seen", "alive"):
        array = getattr(window, name)
        before = array.copy()
        given_parts[name][:] = 0
        assert np.array_equal(array, before)
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0
    with pytest.raises(AttributeError):
        window.round = 2


@given(hnp.arrays(bool, (5, 4)), hnp.arrays(bool, 4))
def test_a_velocity_is_seen_where_both_its_ends_are_and_the_uav_lives(seen, alive):
    window = Window(**parts(instants=5, uavs=4, seen=seen, alive=alive))
    for t in range(4):
        for i in range(4):
            assert window.velocity_seen[t, i] == (seen[t, i] and seen[t + 1, i] and alive[i])


def test_from_observation_is_the_window_that_the_observation_holds():
    whole = parts(6, 5, round=np.array([3], np.float32), step=np.float32([0.5]))
    window = Window.from_observation(whole)
    for name in ("position", "velocity"):
        np.testing.assert_array_equal(getattr(window, name), whole[name].astype(np.float32))
    assert (window.round, window.step) == (3, 0.5)
    assert Window.from_observation(parts()).step is None


@pytest.mark.parametrize("key", ["position", "velocity", "seen", "alive", "round"])
def test_an_observation_without_a_key_is_refused(key):
    observation = parts()
    del observation[key]
    for value in (observation, None, [1, 2]):
        with pytest.raises(ArgumentError, match=r"^observation must be a mapping with the keys position, .*, got "):
            Window.from_observation(value)


class NeedsGradient:
    def __array__(self, dtype=None, copy=None):
        raise RuntimeError("Can't call numpy() on Tensor that requires grad.")  # as torch does


@pytest.mark.parametrize(
    ("name", "value"),
    [
        *(("position", value) for value in (NeedsGradient(), [[1], [1, 2]], None)),
        *(("position", np.zeros(shape)) for shape in ((4, 3, 2), (1, 3, 3), (4, 0, 3))),
        *(("position", np.full((4, 3, 3), value)) for value in (np.nan, 1e39, 0j)),
        ("position", np.ma.masked_equal(np.arange(36.0).reshape(4, 3, 3), 3.0)),
        *(("velocity", value) for value in (np.full((3, 3, 3), -1e300), np.zeros((4, 3, 3)))),
        *(("seen", value) for value in (np.ones((3, 3)), np.full((4, 3), 2), np.full((4, 3), np.nan))),
        ("alive", np.ones(2)),
        *(("round", value) for value in (None, "first", 1.5, np.nan, [1, 2], np.zeros(0), 0, True)),
        *(("step", value) for value in (0, np.nan, "a second", [1, 2])),
    ],
)
@pytest.mark.parametrize("make", [Window.from_observation, lambda parts: Window(**parts)])
def test_a_bad_part_is_refused_in_one_sentence_that_names_it(make, name, value):
    with pytest.raises(ArgumentError, match=rf"^{name} must .*, got .*[^.]\.$") as caught:
        make(parts(**{name: value}))
    assert "\n" not in str(caught.value)


N = 4


def detection_parts(**changes):
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
    whole = detection_parts()
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
    bare = Detection(candidates=[True, False], scores=[1, 0])
    assert (bare.clusters, bare.leader, bare.attention, bare.extras) == (None, None, None, {})


@pytest.mark.parametrize(
    ("name", "value"),
    [
        *(("candidates", value) for value in ([0, 0.5, 0, 0], [[0, 1]], None)),
        *(("scores", value) for value in (np.zeros(3), [0, 0, 0, np.nan])),
        *(("clusters", value) for value in ([0, 0, 0], [0, 0.5, 1, 1])),
        *(("leader", [0, 0, 0, value]) for value in (4, -2, 1.5)),
        ("attention", np.zeros((N, N - 1))),
        ("extras", [1, 2]),
        *(("probability", value) for value in ([0, 0.5, 1, 1.5], [0.5])),
    ],
)
def test_a_bad_part_of_a_detection_is_refused_in_one_sentence(name, value):
    with pytest.raises(ArgumentError, match=rf"^{name} must .*, got .*\.$") as caught:
        Detection(**detection_parts(**({"extras": {name: value}} if name == "probability" else {name: value})))
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
