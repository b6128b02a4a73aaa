"""The neutral file gives back exactly what was put in, and refuses everything else in one sentence."""

from __future__ import annotations

import json
import pickle

import numpy as np
import pytest
from small_episode import DECOY, MIND, ROUNDS, UAVS, small_episode

from usnet_env import ArgumentError
from usnet_env.replay import EpisodeRecord


@pytest.fixture(scope="module")
def episode():
    return small_episode()


def same(one, other):
    pairs = [(value, getattr(other, name)) for name, value in vars(one).items()]
    return all(np.array_equal(a, b) and getattr(a, "dtype", "") == getattr(b, "dtype", "") for a, b in pairs)


def test_round_trip_is_exact(tmp_path, episode):
    path = episode.save(tmp_path / "new" / "episode.npz")
    assert same(EpisodeRecord.load(path), episode)
    assert [file.name for file in path.parent.iterdir()] == ["episode.npz"]
    with pytest.raises(ValueError, match="read-only"):
        episode.position[0] = 0
    with np.load(path, allow_pickle=False) as file:  # for readers without this class
        links = file["communication_links"]
    for number in (1, 2):
        assert links[links[:, 0] == number, 1:].tolist() == episode.communication_links(number).tolist()


def test_what_a_detector_did_not_give_stays_none(tmp_path):
    absent = (*MIND, "seed", "detector_seed")
    bare = small_episode(**dict.fromkeys(absent))
    loaded = EpisodeRecord.load(bare.save(tmp_path / "e.npz"))
    assert {name for name in absent if getattr(loaded, name) is None} == set(absent)
    assert same(loaded, bare)


@pytest.mark.parametrize(
    ("over", "hits", "redundant", "left"), [(False, [1, 1], [1, 0], [1, 0]), (True, [0, 1], [0, 0], [2, 1])]
)
def test_counts_follow_the_definitions(over, hits, redundant, left):
    """Over budget, no UAV is destroyed."""
    changes = {"over_budget": [True, False], "alive": np.ones((ROUNDS, UAVS), bool)} if over else {}
    record = small_episode(**changes)
    assert [x.tolist() for x in (record.hits, record.redundant, record.heads_left)] == [hits, redundant, left]


def test_destroyed_uavs_stay_where_they_were_seen_last(episode):
    last = episode.last_position(2)
    np.testing.assert_array_equal(last[[0, 3]], episode.position[0, -1, [0, 3]])
    np.testing.assert_array_equal(last[7], episode.position[1, -2, 7])  # missed at the last instant
    seen = episode.seen.copy()
    seen[:, :, 9] = False
    assert np.isnan(small_episode(seen=seen).last_position(2)[9]).all()


def test_communication_links_lead_from_living_followers_to_living_heads(episode):
    assert episode.communication_links(1).tolist() == [[i, 0] for i in range(1, 5)] + [[i, 5] for i in range(6, 11)]
    assert episode.communication_links(2).tolist() == [[i, 5] for i in (1, 2, 4, 6, 7, 8, 9, 10)]  # 0 and 3 are gone
    headless = np.where(np.arange(UAVS) == DECOY, DECOY, -1)
    leader = np.stack([episode.root[0], headless])
    assert small_episode(root=leader).communication_links(2).shape == (0, 2)


def test_the_found_hierarchy_links_to_candidates(episode):
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


def test_refuses_what_is_no_episode(tmp_path):
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
    for name in ("array.npy", "foreign.npz", "other.npz"):
        refusal(tmp_path / name)


def rewritten(path, change):
    with np.load(path) as file:
        arrays = dict(file)
    words = json.loads(str(arrays["metadata"]))
    change(arrays, words)
    arrays["metadata"] = np.array(json.dumps(words))
    np.savez(path, **arrays)
    return path


def test_refuses_other_versions_and_incomplete_files(tmp_path, episode):
    path = episode.save(tmp_path / "e.npz")
    assert "version 99" in refusal(rewritten(path, lambda arrays, words: words.update(version=99)))
    for change in (lambda arrays, words: arrays.pop("position"), lambda arrays, words: words.update(surprise=1)):
        refusal(rewritten(episode.save(path), change))


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


def test_a_file_that_was_cut_off_is_refused(tmp_path, episode):
    whole = episode.save(tmp_path / "e.npz").read_bytes()
    rng = np.random.default_rng(0)
    path = tmp_path / "damaged.npz"
    for length in rng.integers(1, len(whole), 10):
        path.write_bytes(whole[:length])
        refusal(path)
