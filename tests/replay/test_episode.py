"""The neutral file gives back exactly what was put in, and refuses everything else in one sentence."""

from __future__ import annotations

import json
import pickle
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest
from small_episode import DECOY, HEADS, ROUNDS, SAMPLES, UAVS, small_episode

from usnet_env import ArgumentError
from usnet_env.replay import EpisodeRecord

DATA = Path(__file__).parent / "data"  # small_episode() as earlier versions of the file held it
LATER = ("attention_heads", "probability", "features", "reasons")  # fields that version 4 added


@pytest.fixture(scope="module")
def episode() -> EpisodeRecord:
    return small_episode()


def same(one: EpisodeRecord, other: EpisodeRecord) -> bool:
    for item in fields(EpisodeRecord):
        here, there = getattr(one, item.name), getattr(other, item.name)
        if isinstance(here, np.ndarray):
            if not isinstance(there, np.ndarray) or here.dtype != there.dtype or not np.array_equal(here, there):
                return False
        elif here != there:
            return False
    return True


def test_round_trip_is_exact(tmp_path, episode):
    path = episode.save(tmp_path / "new" / "episode.npz")
    assert same(EpisodeRecord.load(path), episode)
    assert [file.name for file in path.parent.iterdir()] == ["episode.npz"]


def test_what_a_detector_did_not_give_stays_none(tmp_path):
    absent = ("clusters", "leader_estimate", "attention", *LATER, "seed", "detector_seed")
    bare = small_episode(**dict.fromkeys(absent))
    loaded = EpisodeRecord.load(bare.save(tmp_path / "e.npz"))
    assert {name for name in absent if getattr(loaded, name) is None} == set(absent)
    assert same(loaded, bare)


def test_counts_follow_the_definitions(episode):
    assert episode.hits.tolist() == [1, 1]
    assert episode.redundant.tolist() == [1, 0]
    assert episode.heads_left.tolist() == [1, 0]


def test_over_budget_destroys_no_uav():
    alive = np.ones((ROUNDS, UAVS), bool)
    record = small_episode(over_budget=[True, False], alive=alive)
    assert record.hits.tolist() == [0, 1]
    assert record.redundant.tolist() == [0, 0]
    assert record.heads_left.tolist() == [2, 1]


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
    by_attention = small_episode(leader_estimate=None)
    assert by_attention.hierarchy(1).tolist() == episode.hierarchy(1).tolist()
    itself = np.where(np.eye(UAVS, dtype=bool), 1.0, by_attention.attention)
    assert small_episode(leader_estimate=None, attention=itself).hierarchy(1).tolist() == episode.hierarchy(1).tolist()
    silent = small_episode(leader_estimate=None, attention=np.zeros((ROUNDS, UAVS, UAVS)))
    assert silent.hierarchy(1).shape == (0, 2)
    assert small_episode(leader_estimate=None, attention=None).hierarchy(1) is None


def test_the_topology_matrix_is_equation_5(episode):
    """Every row against the printed matrix: p at t - T_0 + 1, then v from there to t, UAV by UAV."""
    memory, t = 4, 9
    x = episode.topology_matrix(1, t, head=HEADS[1])
    members = [5, 6, 7, 8, 9, 10]
    assert x.shape == (3 * len(members), memory + 1)
    assert x.dtype == np.float32
    for place, i in enumerate(members):
        for axis in range(3):
            printed = [episode.position[0, t - memory + 1, i, axis]]
            printed += [episode.velocity[0, time, i, axis] for time in range(t - memory + 1, t + 1)]
            assert x[3 * place + axis].tolist() == printed


@pytest.mark.parametrize(
    ("arguments", "name"),
    [
        ({"number": 0, "t": 5}, "number"),
        ({"number": 3, "t": 5}, "number"),
        ({"number": 1, "t": 2}, "t"),
        ({"number": 1, "t": SAMPLES - 1}, "t"),
        ({"number": 1, "t": 5, "head": 1}, "head"),
        ({"number": 2, "t": 5, "head": 0}, "head"),
        ({"number": 1, "t": 5, "memory": 0}, "memory"),
        ({"number": 1, "t": 5, "memory": SAMPLES}, "memory"),
    ],
)
def test_refuses_rounds_times_and_heads_that_are_not_there(episode, arguments, name):
    with pytest.raises(ArgumentError, match=rf"^{name} must"):
        episode.topology_matrix(**arguments)


def test_the_file_holds_the_links_for_readers_without_this_class(tmp_path, episode):
    with np.load(episode.save(tmp_path / "e.npz"), allow_pickle=False) as file:
        links = file["communication_links"]
    for number in (1, 2):
        own = links[links[:, 0] == number, 1:]
        assert own.tolist() == episode.communication_links(number).tolist()


@pytest.mark.parametrize(("version", "absent"), [(1, ("attention", *LATER)), (3, LATER), (4, ())])
def test_files_of_earlier_versions_still_open(version, absent):
    old = EpisodeRecord.load(DATA / f"episode-version-{version}.npz")
    assert same(old, small_episode(**dict.fromkeys(absent), versions=old.versions))
    assert old.topology_matrix(1, 9, head=5).shape == (18, 5)


def test_arrays_are_read_only(episode):
    with pytest.raises(ValueError, match="read-only"):
        episode.position[0] = 0


@pytest.mark.parametrize(
    ("changes", "name"),
    [
        ({"velocity": np.zeros((2, 3, UAVS, 3))}, "velocity"),
        ({"scores": np.full((ROUNDS, UAVS), np.nan)}, "scores"),
        ({"root": np.full((ROUNDS, UAVS), UAVS)}, "root"),
        ({"leader_estimate": np.full((ROUNDS, UAVS), -2)}, "leader_estimate"),
        ({"attention": np.zeros((ROUNDS, UAVS))}, "attention"),
        ({"attention_heads": np.zeros((ROUNDS, UAVS, UAVS))}, "attention_heads"),
        ({"features": np.zeros((ROUNDS, UAVS, 3))}, "features"),
        ({"observers": np.zeros((2, 3))}, "observers"),
        ({"alive": np.ones((ROUNDS, UAVS), bool)}, "alive"),
    ],
)
def test_impossible_records_are_refused_when_they_are_read(changes, name):
    assert small_episode().find_fault() == ""
    assert small_episode(**changes).find_fault().startswith(name)


def refusal(path) -> str:
    with pytest.raises(ArgumentError) as caught:
        EpisodeRecord.load(path)
    message = str(caught.value)
    assert message.startswith("path must be an intact episode file, got ")
    assert "\n" not in message
    assert len(message) < 400
    return message


def test_refuses_what_is_no_episode(tmp_path):
    assert "No such file" in refusal(tmp_path / "nothing.npz")
    assert "directory" in refusal(tmp_path)
    for name, content in {"empty": b"", "text": b"hello, world", "zip": b"PK\x03\x04rest"}.items():
        (tmp_path / name).write_bytes(content)
        refusal(tmp_path / name)
    np.save(tmp_path / "array.npy", np.ones(3))
    np.savez(tmp_path / "foreign.npz", weights=np.ones(3))
    np.savez(tmp_path / "other.npz", metadata=np.array('{"format": "something else"}'))
    np.savez(tmp_path / "list.npz", metadata=np.array("[1]"))
    for name in ("array.npy", "foreign.npz", "other.npz", "list.npz"):
        refusal(tmp_path / name)


def test_never_unpickles(tmp_path):
    trap = np.array([print], dtype=object)  # any object: only pickle could write it
    np.savez(tmp_path / "trap.npz", metadata=trap, allow_pickle=True)
    (tmp_path / "trap.pkl").write_bytes(pickle.dumps(print))
    assert "allow_pickle" in refusal(tmp_path / "trap.npz")
    assert "pickle" in refusal(tmp_path / "trap.pkl")


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
    for change in (
        lambda arrays, words: arrays.pop("position"),
        lambda arrays, words: words.update(surprise=1),
        lambda arrays, words: arrays.update(alive=np.ones_like(arrays["alive"])),
        lambda arrays, words: arrays.update(seen=arrays["seen"][:, :-1]),
        lambda arrays, words: arrays.update(scores=arrays["scores"] * np.nan),
    ):
        refusal(rewritten(episode.save(path), change))


def test_a_damaged_file_never_loads_as_another_episode(tmp_path, episode):
    whole = episode.save(tmp_path / "e.npz").read_bytes()
    rng = np.random.default_rng(0)
    path = tmp_path / "damaged.npz"
    for length in rng.integers(1, len(whole), 10):
        path.write_bytes(whole[:length])
        refusal(path)
    refused = 0
    for place in rng.integers(0, len(whole), 80):
        damaged = bytearray(whole)
        damaged[place] ^= 1 << int(rng.integers(8))
        path.write_bytes(damaged)
        try:
            assert same(EpisodeRecord.load(path), episode)  # a bit that carries nothing, as a date in the archive
        except ArgumentError:
            refused += 1
    assert refused > 40


def test_a_place_that_cannot_be_written_is_one_sentence(tmp_path, episode):
    (tmp_path / "file").write_text("")
    for path in (tmp_path / "file" / "e.npz", tmp_path):
        with pytest.raises(ArgumentError, match=r"^path must be a file that can be written"):
            episode.save(path)
