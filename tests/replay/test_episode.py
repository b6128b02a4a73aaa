"""The neutral file gives back exactly what was put in; an episode is recorded as it happened, also by the demo."""

import json
import pickle
import sys

import gymnasium as gym
import numpy as np
import pytest
from small_episode import DECOY, MIND, ROUNDS, UAVS, small_episode

import usnet_env.envs  # noqa: F401  # registers the environments
from usnet_env import ArgumentError, Detection, Window
from usnet_env.replay import EpisodeRecord, animate, demo, draw_episode, record_episode, write_picture, write_recording
from usnet_env.replay.demo import run_demo
from usnet_env.replay.page import write_page


@pytest.fixture(scope="module")
def episode():
    return small_episode()


def same(one, other):
    pairs = [(value, getattr(other, name)) for name, value in vars(one).items()]
    return all(np.array_equal(a, b) and getattr(a, "dtype", "") == getattr(b, "dtype", "") for a, b in pairs)


def test_round_trip_is_exact_and_what_a_detector_did_not_give_stays_none(tmp_path, episode):
    path = episode.save(tmp_path / "new" / "episode.npz")
    assert same(EpisodeRecord.load(path), episode)
    assert [file.name for file in path.parent.iterdir()] == ["episode.npz"]
    with pytest.raises(ValueError, match="read-only"):
        episode.position[0] = 0
    with np.load(path, allow_pickle=False) as file:  # for readers without this class
        links = file["communication_links"]
    for number in (1, 2):
        assert links[links[:, 0] == number, 1:].tolist() == episode.communication_links(number).tolist()
    absent = (*MIND, "seed", "detector_seed")
    bare = small_episode(**dict.fromkeys(absent))
    loaded = EpisodeRecord.load(bare.save(tmp_path / "e.npz"))
    assert {name for name in absent if getattr(loaded, name) is None} == set(absent)
    assert same(loaded, bare)


@pytest.mark.parametrize("over", [False, True])
def test_counts_follow_the_definitions(over):
    """Over budget, no UAV is destroyed."""
    changes = {"over_budget": [True, False], "alive": np.ones((ROUNDS, UAVS), bool)} if over else {}
    record, expected = small_episode(**changes), [[0, 1], [0, 0], [2, 1]] if over else [[1, 1], [1, 0], [1, 0]]
    assert [x.tolist() for x in (record.hits, record.redundant, record.heads_left)] == expected


def test_destroyed_uavs_stay_where_they_were_seen_last(episode):
    last = episode.last_position(2)
    np.testing.assert_array_equal(last[[0, 3]], episode.position[0, -1, [0, 3]])
    np.testing.assert_array_equal(last[7], episode.position[1, -2, 7])  # missed at the last instant
    seen = episode.seen.copy()
    seen[:, :, 9] = False
    assert np.isnan(small_episode(seen=seen).last_position(2)[9]).all()


def test_links_lead_from_living_followers_to_living_heads_and_those_found_to_candidates(episode):
    assert episode.communication_links(1).tolist() == [[i, 0] for i in range(1, 5)] + [[i, 5] for i in range(6, 11)]
    assert episode.communication_links(2).tolist() == [[i, 5] for i in (1, 2, 4, 6, 7, 8, 9, 10)]  # 0 and 3 are gone
    headless = np.where(np.arange(UAVS) == DECOY, DECOY, -1)
    leader = np.stack([episode.root[0], headless])
    assert small_episode(root=leader).communication_links(2).shape == (0, 2)
    assert episode.hierarchy(1).tolist() == [[i, 0] for i in (1, 2, 4)]  # 3 is a candidate; 5 is none, nor is any other
    assert episode.hierarchy(2).tolist() == episode.communication_links(2).tolist()
    assert small_episode(leader_estimate=None).hierarchy(1) is None


def refusal(path):
    with pytest.raises(ArgumentError) as caught:
        EpisodeRecord.load(path)
    message = str(caught.value)
    assert message.startswith(f"{path}: ")
    assert "\n" not in message
    assert len(message) < 400
    return message


def test_refuses_what_is_no_episode_or_was_cut_off(tmp_path, episode):
    assert "no such file" in refusal(tmp_path / "nothing.npz")
    assert "directory" in refusal(tmp_path)
    for name, content in {"empty": b"", "text": b"hello, world", "zip": b"PK\x03\x04rest"}.items():
        (tmp_path / name).write_bytes(content)
        refusal(tmp_path / name)
    np.savez(tmp_path / "trap.npz", metadata=np.array([print], dtype=object), allow_pickle=True)  # never unpickled
    (tmp_path / "trap.pkl").write_bytes(pickle.dumps(print))
    assert "allow_pickle" in refusal(tmp_path / "trap.npz")
    assert "pickle" in refusal(tmp_path / "trap.pkl")
    np.save(tmp_path / "array.npy", np.ones(3))
    np.savez(tmp_path / "foreign.npz", weights=np.ones(3))
    np.savez(tmp_path / "other.npz", metadata=np.array('{"format": "something else"}'))
    whole = episode.save(tmp_path / "e.npz").read_bytes()
    lengths = np.random.default_rng(0).integers(1, len(whole), 10)
    for length in lengths:
        (tmp_path / f"{length}.npz").write_bytes(whole[:length])
    for name in ("array.npy", "foreign.npz", "other.npz", *(f"{length}.npz" for length in lengths)):
        refusal(tmp_path / name)


def test_refuses_other_versions_and_incomplete_files(tmp_path, episode):
    path = episode.save(tmp_path / "e.npz")
    with np.load(path) as file:
        arrays = dict(file)
    about = json.loads(str(arrays["metadata"]))
    for more, lost, sentence in (({"version": 99}, "", "version 99"), ({"surprise": 1}, "", ""), ({}, "position", "")):
        kept = {name: array for name, array in arrays.items() if name != lost}
        np.savez(path, **kept | {"metadata": np.array(json.dumps(about | more))})
        assert sentence in refusal(path)


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("position", np.zeros((2, 21, 12)), r"must have shape \(R, I, N, 3\), got \(2, 21, 12\)"),
        ("root", np.zeros((2, 11)), r"must have shape \(2, 12\), got \(2, 11\)"),
        ("head", np.zeros((12, 1)), r"must have shape \(12\), got \(12, 1\)"),
        ("attention", np.zeros((2, 12, 13)), r"must have shape \(2, 12, 12\), got"),
        ("seconds", None, r"must have shape \(2\), got \(\)"),
        ("scores", "high", "can't be kept, got 'high'"),
        ("config", {"detector": object()}, "can't be kept, got "),
    ],
)
def test_a_wrong_field_is_named(name, value, words):
    with pytest.raises(ArgumentError, match=f"^{name} {words}"):
        small_episode(**{name: value})


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
    mind = {"probability": np.linspace(0, 1, 16), "heads": heads[:1], "reasons": ["Because."]}
    detector = Scripted(*script, clusters=np.arange(16), attention=np.eye(16), extras=mind)
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
    assert (record.rounds, np.flatnonzero(record.head).tolist()) == (2, heads.tolist())
    assert (record.scores[1].max(), record.clusters.tolist()) == (3, [list(range(16))] * 2)
    assert record.leader_estimate is None
    np.testing.assert_array_equal(record.attention, [np.eye(16)] * 2)
    np.testing.assert_array_equal(record.probability, [mind["probability"]] * 2)
    assert record.reasons == [{str(heads[0]): "Because."}] * 2
    assert (record.seconds > 0).all()
    assert all(type(window) is Window for window in detector.windows)


def test_says_where_it_comes_from_and_refuses_other_environments(tmp_path):
    heads, _ = roles(5)
    detector = Scripted(heads)
    record = record_episode(gym.wrappers.RecordEpisodeStatistics(multi(shot_budget=9)), detector, 5, 7)
    assert detector.seed == 7
    assert (record.seed, record.detector_seed, record.detector) == (5, 7, "Scripted")
    assert (record.env_id, record.problem) == ("USNET/MultiCluster-v0", "P2")
    assert {"follow": "f1", "clusters": 3, "memory": 4, "shot_budget": 9}.items() <= record.config.items()
    assert record.versions["numpy"] == np.__version__
    assert EpisodeRecord.load(record.save(tmp_path / "e.npz")).config == record.config
    for name in ("CartPole-v1", "USNET/Probing-v1"):
        with pytest.raises(ArgumentError, match=r"^env must be"):
            record_episode(gym.make(name), Scripted(), 0, None)


def test_over_budget_and_truncated_and_a_single_cluster_with_decoys():
    _, others = roles(2)
    record = record_episode(multi(shot_budget=2, max_rounds=3), Scripted(others[:4], others[:1]), 2, None)
    assert record.over_budget.tolist() == [True, False, False]
    assert record.probability is record.attention is record.reasons is None
    assert record.redundant.tolist() == [0, 1, 1]  # the second shot at a destroyed UAV is redundant again
    assert (record.heads_left.tolist(), record.objective[-1]) == ([3, 3, 3], 3 + 2 / 16)
    record = record_episode(gym.make("USNET/SingleCluster-Decoy-v0"), Scripted([0, 1]), 3, None)
    assert (record.problem, record.rounds, record.decoy.sum(), record.head.sum()) == ("P1", 1, 1, 1)
    assert record.objective[0] == record.hits[0] - 2


@pytest.mark.parametrize("show", [animate, draw_episode, write_page, write_picture, write_recording])
def test_what_is_no_record_is_refused(tmp_path, show):
    with pytest.raises(ArgumentError, match=r"^record must be an object of EpisodeRecord, got 'episode.npz'\.$"):
        show("episode.npz", *[tmp_path / "x.png"] * (show is not draw_episode))
    assert list(tmp_path.iterdir()) == []


pytest.importorskip("matplotlib")
SMALL = {"clusters": 2, "uavs": 14, "detector": "one-per-round", "observation_steps": 30}


def test_the_game_of_the_demo_has_an_error_and_a_recovery(tmp_path, monkeypatch):
    """Without arguments: three to five rounds, a redundant candidate or a missed head, and all heads in the end."""
    for name in ("write_recording", "write_picture", "write_page"):  # they take long
        monkeypatch.setattr(demo, name, lambda record, path: path)
    record = EpisodeRecord.load(run_demo(tmp_path)["episode"])
    assert 3 <= record.rounds <= 5
    assert record.redundant.sum() > 0
    assert record.heads_left[0] > 0 == record.heads_left[-1]
    assert record.config["mobility"] == "gauss_markov"
    assert record.detector_seed != record.seed


def test_without_an_extra_the_rest_is_written(tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "rerun", None)
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    files = run_demo(tmp_path, **SMALL)
    assert set(files) == {"episode"}
    assert {path.name for path in tmp_path.iterdir()} == {"episode.npz"}
    text = capsys.readouterr().out
    assert "pip install 'usnet[replay]'" in text
    assert "pip install 'usnet[render]'" in text
