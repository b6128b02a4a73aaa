"""The wrapper writes the episodes that its trigger chooses, as ``record_episode`` would have."""

from __future__ import annotations

import gymnasium as gym
import numpy as np
import pytest

import usnet_env.envs  # noqa: F401  # registers the environments
from usnet_env import ArgumentError, Window, make_detector
from usnet_env.replay import EpisodeRecord, RecordReplay, record_episode


def make(**arguments):
    small = {"clusters": 2, "uavs": 12, "observation_steps": 20, "max_rounds": 3}
    return gym.make("USNET/MultiCluster-v0", **small | arguments)


def play(env, detector, seed, note=False):
    detector.reset(1)
    observation, _ = env.reset(seed=seed)
    over = False
    while not over:
        detection = detector.detect(Window.from_observation(observation))
        if note:
            env.note(detection)
        observation, _, terminated, truncated, _ = env.step(detection.candidates.astype(np.int8))
        over = terminated or truncated


def test_the_episodes_of_the_trigger_are_written(tmp_path):
    env = RecordReplay(make(), tmp_path / "new", lambda episode: episode % 2 == 1, label="mine")
    for seed in range(4):
        play(env, make_detector("one-per-round"), seed)
    assert sorted(path.name for path in (tmp_path / "new").iterdir()) == ["episode-1.npz", "episode-3.npz"]
    found = EpisodeRecord.load(tmp_path / "new" / "episode-3.npz")
    assert (found.seed, found.detector, found.env_id) == (3, "mine", "USNET/MultiCluster-v0")
    np.testing.assert_array_equal(found.scores, found.candidates)
    assert repr(found) == (
        f"<EpisodeRecord of USNET/MultiCluster-v0: {found.rounds} rounds, 12 UAVs, detector 'mine', seed 3>"
    )


def test_files_of_an_earlier_run_are_not_replaced_without_a_word(tmp_path):
    env = RecordReplay(make(), tmp_path)
    play(env, make_detector("one-per-round"), 0)
    with pytest.warns(UserWarning, match=r"^folder '.*' holds episode files, and those of the same number will be "):
        RecordReplay(make(), tmp_path)


def test_a_noted_detection_is_kept_whole(tmp_path):
    env = RecordReplay(make(), tmp_path)
    play(env, make_detector("lagged-correlation"), 5, note=True)
    found = EpisodeRecord.load(tmp_path / "episode-0.npz")
    same = record_episode(make(), make_detector("lagged-correlation"), 5, 1)
    for name in ("position", "alive", "root", "candidates", "scores", "clusters", "attention", "objective", "head"):
        np.testing.assert_array_equal(getattr(found, name), getattr(same, name))


def test_an_episode_that_is_left_is_written_when_the_next_begins_or_at_the_end(tmp_path):
    env = RecordReplay(make(), tmp_path)
    for seed in (7, 8, 9):
        env.reset(seed=seed)
        for _ in range(seed - 7):  # no round of the first episode
            env.step(np.zeros(12, np.int8))
    env.close()
    env.close()
    found = {path.name: EpisodeRecord.load(path) for path in tmp_path.iterdir()}
    assert {name: (each.seed, each.rounds) for name, each in found.items()} == {
        "episode-1.npz": (8, 1),
        "episode-2.npz": (9, 2),
    }


def test_bad_arguments_are_refused(tmp_path):
    with pytest.raises(ArgumentError, match=r"^env must be a USNET environment"):
        RecordReplay(gym.make("CartPole-v1"), tmp_path)
    with pytest.raises(ArgumentError, match=r"^trigger must be a function or None, got 3"):
        RecordReplay(make(), tmp_path, 3)
