"""A played episode is recorded as it happened, by ``record_episode`` and by the wrapper."""

from __future__ import annotations

import gymnasium as gym
import numpy as np
import pytest

import usnet_env.envs  # noqa: F401  # registers the environments
from usnet_env import ArgumentError, Detection, Window
from usnet_env.replay import EpisodeRecord, animate, draw_episode, record_episode, write_picture, write_recording
from usnet_env.replay.page import write_page


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


@pytest.mark.parametrize("show", [animate, draw_episode, write_page, write_picture, write_recording])
def test_what_is_no_record_is_refused(tmp_path, show):
    with pytest.raises(ArgumentError, match=r"^record must be an object of EpisodeRecord, got 'episode.npz'\.$"):
        show("episode.npz", *[tmp_path / "x.png"] * (show is not draw_episode))
    assert list(tmp_path.iterdir()) == []


def test_other_environments_are_refused():
    with pytest.raises(ArgumentError, match=r"^env must be"):
        record_episode(gym.make("CartPole-v1"), Scripted(), 0, None)
