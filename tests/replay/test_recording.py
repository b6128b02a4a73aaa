"""The recording, read back by Rerun's own tools."""

from __future__ import annotations

import random
import subprocess
import sys
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from small_episode import ROUNDS, SAMPLES, UAVS, small_episode

from usnet_env import ArgumentError
from usnet_env.drawing import MissingExtraError
from usnet_env.replay import write_recording
from usnet_env.replay.recording import list_steps

rr = pytest.importorskip("rerun")


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    return write_recording(small_episode(), tmp_path_factory.mktemp("recording") / "new" / "replay.rrd")


@pytest.fixture(scope="module")
def chunks(recording):
    from rerun.chunk import RrdReader

    return RrdReader(recording).stream().to_chunks()


def column(chunks, entity, component):
    """The rows of one component of one entity, as lists of instances."""
    rows = []
    for chunk in chunks:
        batch = chunk.to_record_batch()
        if chunk.entity_path == entity and component in batch.schema.names:
            rows += batch.column(component).to_pylist()
    return rows


def test_rerun_verifies_the_file(recording):
    tool = Path(sys.executable).with_name("rerun")
    if not tool.exists():
        pytest.skip("the rerun command is not beside this Python")
    done = subprocess.run([tool, "rrd", "verify", recording], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "1 file verified without error" in done.stdout + done.stderr


def test_one_row_an_instant_for_the_whole_swarm(chunks):
    rows = Counter()
    for chunk in chunks:
        if not chunk.is_static:
            rows[chunk.entity_path] += chunk.num_rows
    moving = ("swarm/heads", "swarm/followers", "swarm/decoys", "swarm/links", "candidates/hit", "candidates/redundant")
    assert {rows[f"/{name}"] for name in moving} == {ROUNDS * SAMPLES}
    assert {rows[f"/{name}"] for name in ("swarm/tracks", "swarm/destroyed", "scores/heads")} == {ROUNDS}
    assert {rows[f"/game/{name}"] for name in ("heads_left", "redundant", "J")} == {ROUNDS + 1}


def test_positions_are_those_seen(chunks):
    episode = small_episode()
    heads = column(chunks, "/swarm/heads", "Points3D:positions")
    assert [len(row) for row in heads] == [2] * SAMPLES + [1] * SAMPLES
    np.testing.assert_array_equal(heads[-1], episode.position[1, -1, [5]])
    followers = column(chunks, "/swarm/followers", "Points3D:positions")
    assert sum(map(len, followers)) == episode.seen[:, :, ~episode.head & ~episode.decoy].sum()
    destroyed = column(chunks, "/swarm/destroyed", "Points3D:positions")
    assert [len(row) for row in destroyed] == [0, 2]
    np.testing.assert_array_equal(destroyed[1], episode.position[0, -1, [0, 3]])


def test_links_lead_from_followers_to_their_heads(chunks):
    episode = small_episode()
    strips = column(chunks, "/swarm/links", "LineStrips3D:strips")
    assert len(strips[0]) == UAVS - 3
    np.testing.assert_array_equal(strips[0][0], episode.position[0, 0, [1, 0]])


def test_marks_are_the_answers(chunks):
    kinds = {"hit": "Ellipsoids3D", "missed": "Ellipsoids3D", "redundant": "Boxes3D"}
    counts = {}
    for name, kind in kinds.items():
        rows = column(chunks, f"/candidates/{name}", f"{kind}:centers")
        assert [len(row) for row in rows] == [
            len(row) for row in column(chunks, f"/candidates/{name}", f"{kind}:half_sizes")
        ]
        counts[name] = (len(rows[0]), len(rows[-1]))
    assert counts == {"hit": (1, 1), "missed": (1, 0), "redundant": (1, 0)}


def test_timelines_are_named_and_in_steps(chunks):
    assert {name for chunk in chunks for name in chunk.timeline_names} == {"round", "step"}
    steps = list_steps(small_episode())
    assert steps[0].tolist() == list(range(4, 4 + 2 * SAMPLES, 2))
    assert steps[1, 0] == steps[0, -1] + 4  # the unobserved steps after the re-merge


def test_it_explains_itself(recording, chunks):
    from rerun.chunk import RrdReader

    assert len(RrdReader(recording).blueprints()) == 1
    ((text,),) = column(chunks, "/about", "TextDocument:text")
    assert "All 2 heads found in 2 rounds" in text
    entities = {chunk.entity_path for chunk in chunks}
    links = [part.partition(")")[0] for part in text.split("recording://")[1:]]
    assert len(links) >= 8
    assert {f"/{link}" for link in links} <= entities


def test_nothing_global_is_touched(tmp_path):
    before = random.getstate(), str(np.random.get_state())  # noqa: NPY002  # that it is left alone is what is tested
    write_recording(small_episode(), tmp_path / "e.rrd")
    assert before == (random.getstate(), str(np.random.get_state()))  # noqa: NPY002
    assert rr.get_global_data_recording() is None
    assert rr.get_thread_local_data_recording() is None
    assert [file.name for file in tmp_path.iterdir()] == ["e.rrd"]


def test_a_swarm_that_was_never_seen_can_be_written(tmp_path):
    unseen = small_episode(seen=np.zeros((ROUNDS, SAMPLES, UAVS), bool))
    assert write_recording(unseen, tmp_path / "e.rrd").stat().st_size > 0


def test_a_place_that_cannot_be_written(tmp_path):
    with pytest.raises(ArgumentError, match=r"^path must be a file that can be written"):
        write_recording(small_episode(), tmp_path)


def test_without_rerun_one_sentence_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "rerun", None)
    with pytest.raises(MissingExtraError, match=r"pip install 'usnet\[replay\]'"):
        write_recording(small_episode(), tmp_path / "e.rrd")
    assert list(tmp_path.iterdir()) == []
