"""A played episode is recorded as it happened, by ``record_episode`` and by the wrapper."""

from __future__ import annotations

import gymnasium as gym
import numpy as np
import pytest

import usnet_env.envs  # noqa: F401  # registers the environments
from usnet_env import ArgumentError, Detection, Window, make_detector
from usnet_env.replay import EpisodeRecord, RecordReplay, record_episode


class Scripted:
    """Names the candidates of a script, round by round, and keeps its windows."""

    def __init__(self, *rounds, **answer):
        self.rounds = rounds
        self.answer = answer
        self.windows = []

    def reset(self, seed):
        self.seed = seed
        self.windows.clear()

    def detect(self, window):
        named = self.rounds[min(len(self.windows), len(self.rounds) - 1)]
        self.windows.append(window)
        candidates = np.isin(np.arange(window.uavs), named)
        return Detection(candidates, scores=candidates + window.round, **self.answer)


def multi(**arguments):
    return gym.make("USNET/MultiCluster-v0", **{"clusters": 3, "uavs": 16, "observation_steps": 12} | arguments)


def roles(seed, **arguments):
    env = multi(**arguments)
    env.reset(seed=seed)
    truth = env.unwrapped.swarm
    return np.flatnonzero(truth.head), np.flatnonzero(~truth.head)


def test_records_what_was_seen_true_and_answered():
    heads, others = roles(0)
    script = (heads[0], others[0]), heads[1:]
    detector = Scripted(*script, clusters=np.arange(16), attention=np.eye(16))
    record = record_episode(multi(), detector, 0, 7, label="scripted")

    twin = multi()
    observation, _ = twin.reset(seed=0)
    for r, named in enumerate(script):
        truth = twin.unwrapped.swarm
        for name in ("position", "velocity", "seen"):
            np.testing.assert_array_equal(getattr(record, name)[r], observation[name])
        np.testing.assert_array_equal(record.alive[r], truth.alive)
        np.testing.assert_array_equal(record.root[r], truth.root)
        observation, _, over, _, info = twin.step(np.isin(np.arange(16), named).astype(np.int8))
        left = twin.unwrapped.swarm.heads_left
        assert (record.hits[r], record.redundant[r], record.heads_left[r]) == (info["hits"], info["redundant"], left)
        assert record.objective[r] == info["J"]
    assert over
    assert record.rounds == 2
    assert np.flatnonzero(record.head).tolist() == heads.tolist()
    assert record.scores[1].max() == 3
    assert record.clusters.tolist() == [list(range(16))] * 2
    assert record.leader_estimate is None
    np.testing.assert_array_equal(record.attention, [np.eye(16)] * 2)
    assert (record.seconds > 0).all()
    assert all(type(window) is Window for window in detector.windows)


def test_says_where_it_comes_from(tmp_path):
    heads, _ = roles(5)
    detector = Scripted(heads)
    record = record_episode(gym.wrappers.RecordEpisodeStatistics(multi(shot_budget=9)), detector, 5, 7)
    assert detector.seed == 7
    assert (record.seed, record.detector_seed, record.detector) == (5, 7, "Scripted")
    assert (record.env_id, record.problem) == ("USNET/MultiCluster-v0", "P2")
    assert {"follow": "f1", "clusters": 3, "memory": 4, "shot_budget": 9}.items() <= record.config.items()
    assert record.versions["numpy"] == np.__version__
    assert EpisodeRecord.load(record.save(tmp_path / "e.npz")).config == record.config


def test_over_budget_and_truncated():
    _, others = roles(2)
    record = record_episode(multi(shot_budget=2, max_rounds=3), Scripted(others[:4], others[:1]), 2, None)
    assert record.over_budget.tolist() == [True, False, False]
    assert record.redundant.tolist() == [0, 1, 1]  # the second shot at a destroyed UAV is redundant again
    assert record.heads_left.tolist() == [3, 3, 3]
    assert record.objective[-1] == 3 + 2 / 16


def test_single_cluster_with_decoys():
    env = gym.make("USNET/SingleCluster-Decoy-v0")
    record = record_episode(env, Scripted([0, 1]), 3, None)
    assert (record.problem, record.rounds, record.decoy.sum(), record.head.sum()) == ("P1", 1, 1, 1)
    assert record.objective[0] == record.hits[0] - 2


def test_the_mind_of_the_detector_is_recorded():
    heads, others = roles(0)
    extras = {"probability": np.linspace(0, 1, 16), "heads": heads[:1], "reasons": ["Because."]}
    record = record_episode(multi(), Scripted((others[0],), heads, extras=extras), 0, 7)
    np.testing.assert_array_equal(record.probability[0], extras["probability"])
    assert record.reasons == [{str(heads[0]): "Because."}] * 2
    bare = record_episode(multi(), Scripted(heads), 0, 7)
    assert bare.probability is bare.attention is bare.reasons is None


# --- the wrapper -----------------------------------------------------------------------------------------------------


def small():
    return multi(clusters=2, uavs=12, max_rounds=3)


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
    env = RecordReplay(small(), tmp_path / "new", lambda episode: episode % 2 == 1, label="mine")
    for seed in range(4):
        play(env, make_detector("one-per-round"), seed)
    assert sorted(path.name for path in (tmp_path / "new").iterdir()) == ["episode-1.npz", "episode-3.npz"]
    found = EpisodeRecord.load(tmp_path / "new" / "episode-3.npz")
    assert (found.seed, found.detector, found.env_id) == (3, "mine", "USNET/MultiCluster-v0")
    np.testing.assert_array_equal(found.scores, found.candidates)
    assert repr(found).startswith(f"<EpisodeRecord: mine on USNET/MultiCluster-v0, {found.rounds} rounds, 12 UAVs")


def test_a_noted_detection_is_kept_whole(tmp_path):
    env = RecordReplay(small(), tmp_path)
    play(env, make_detector("lagged-correlation"), 5, note=True)
    found = EpisodeRecord.load(tmp_path / "episode-0.npz")
    same = record_episode(small(), make_detector("lagged-correlation"), 5, 1)
    for name in ("position", "alive", "root", "candidates", "scores", "clusters", "attention", "objective", "head"):
        np.testing.assert_array_equal(getattr(found, name), getattr(same, name))


def test_an_episode_that_is_left_is_written_when_the_next_begins_or_at_the_end(tmp_path):
    env = RecordReplay(small(), tmp_path)
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


def test_other_environments_are_refused(tmp_path):
    other = gym.make("CartPole-v1")
    with pytest.raises(ArgumentError, match=r"^env must be"):
        record_episode(other, Scripted(), 0, None)
    with pytest.raises(ArgumentError, match=r"^env must be"):
        RecordReplay(other, tmp_path)
