"""The recording, read back by Rerun's own tools."""

from __future__ import annotations

import random
import subprocess
import sys
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from small_episode import DECOY, ROUNDS, SAMPLES, UAVS, large_episode, small_episode

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
    assert {rows[f"/{name}"] for name in ("swarm/tracks", "swarm/destroyed", "scores/bars", "this_round")} == {ROUNDS}
    assert {rows[f"/game/{name}"] for name in ("heads_left", "redundant", "J")} == {ROUNDS + 1}


def test_positions_are_those_seen(chunks):
    episode = small_episode()
    heads = column(chunks, "/swarm/heads", "Points3D:positions")
    assert [len(row) for row in heads] == [2] * SAMPLES + [1] * SAMPLES
    np.testing.assert_array_equal(heads[-1], episode.position[1, -1, [5]])
    followers = column(chunks, "/swarm/followers", "Points3D:positions")
    assert sum(map(len, followers)) == episode.seen[:, :, ~episode.head & ~episode.decoy].sum()
    crosses = column(chunks, "/swarm/destroyed", "LineStrips3D:strips")
    assert [len(row) for row in crosses] == [0, 2 * 2]
    middles = np.array(crosses[1]).reshape(2, 4, 3).mean(axis=1)
    np.testing.assert_allclose(middles, episode.position[0, -1, [0, 3]], rtol=1e-5)


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


def test_decoys_look_like_no_other_uav(chunks):
    """They are diamonds of 8 edges; destroyed UAVs are crosses of another colour."""
    episode = small_episode()
    diamonds = column(chunks, "/swarm/decoys", "LineStrips3D:strips")
    assert len(diamonds) == ROUNDS * SAMPLES
    ((diamond,), *_) = diamonds
    np.testing.assert_allclose(np.mean(diamond[1:], axis=0), episode.position[0, 0, DECOY], atol=1e-3)
    decoy, destroyed = (column(chunks, f"/swarm/{name}", "LineStrips3D:colors") for name in ("decoys", "destroyed"))
    assert decoy != destroyed


def test_scores_say_which_uavs_were_named(chunks):
    episode = small_episode()
    (labels, _), (colors, _), (numbers, _) = (
        column(chunks, f"/scores/{name}", component)
        for name, component in (("bars", "Boxes2D:labels"), ("bars", "Boxes2D:colors"), ("numbers", "Points2D:labels"))
    )
    order = np.argsort(-episode.scores[0])
    words = {0: "hit", 3: "redundant", 5: "missed"}
    expected = [f"UAV {i}: score {episode.scores[0, i]:.3g}, {words.get(i, 'other')}" for i in order.tolist()]
    assert labels == expected
    assert sorted(map(int, numbers)) == [0, 3, 5]
    assert len(set(colors)) == 4
    first, second = column(chunks, "/this_round", "TextDocument:text")
    assert "**Round 1 of 2:** 2 candidates (1 head hit, 1 redundant), 1 head left." in first[0]
    assert f"| 3 | redundant | {episode.scores[0, 3]:.3g} |" in first[0]
    assert "| 3 |" not in second[0]


def test_scores_of_zero_are_drawn_and_named(tmp_path):
    from rerun.chunk import RrdReader

    path = write_recording(small_episode(scores=np.zeros((ROUNDS, UAVS))), tmp_path / "e.rrd")
    found = RrdReader(path).stream().to_chunks()
    assert column(found, "/scores/scale", "Points2D:labels") == [["all scores are 0"]] * ROUNDS
    sizes = column(found, "/scores/bars", "Boxes2D:half_sizes")
    assert all(0 < height < 0.1 for row in sizes for _, height in row)
    assert column(found, "/scores/bars", "Boxes2D:labels")[0][0] == "UAV 0: score 0, hit"


def test_labels_are_beside_the_marks_and_the_text_says_where_they_are_left_out(chunks, tmp_path):
    from rerun.chunk import RrdReader

    episode = small_episode()
    labels = column(chunks, "/candidates/labels", "Points3D:labels")
    assert labels[0] == ["hit 0", "redundant 3", "missed 5"]
    above = column(chunks, "/candidates/labels", "Points3D:positions")[0] - episode.position[0, 0, [0, 3, 5]]
    assert (above[:, 2] > 50).all()

    large = large_episode(candidates=np.ones((1, 60), bool))
    found = RrdReader(write_recording(large, tmp_path / "large.rrd")).stream().to_chunks()
    assert {len(row) for row in column(found, "/candidates/labels", "Points3D:labels")} == {0}
    ((text,),) = column(found, "/this_round", "TextDocument:text")
    assert "The marks have no labels here, because there are too many." in text
    assert "… and 30 more." in text


def eye_of(path):
    """Position and target of the camera."""
    from rerun.chunk import RrdReader

    reader = RrdReader(path)
    (blueprint,) = reader.blueprints()
    for chunk in reader.stream(store=blueprint).to_chunks():
        if chunk.entity_path.endswith("EyeControls3D"):
            batch = chunk.to_record_batch()
            return [
                np.array(batch.column(f"EyeControls3D:{name}")[0].as_py()[0]) for name in ("position", "look_target")
            ]
    raise AssertionError("the blueprint has no camera")


def on_screen(places, eye, target):
    """``(n, 2)``, from -1 to 1 where the camera, whose view is a square of 55 degrees, shows a place."""
    forward = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(forward, [0, 0, 1]) / np.linalg.norm(np.cross(forward, [0, 0, 1]))
    away = places - eye
    flat = np.stack([away @ right, away @ np.cross(right, forward)], axis=1)
    return flat / (away @ forward)[:, None] / np.tan(np.radians(55 / 2))


@pytest.mark.parametrize("drift", [0, 1000, -5000])
def test_the_camera_has_every_round_in_view(tmp_path, drift):
    """Round 2 is far from round 1; in each, all UAVs are in view and fill most of it."""
    from rerun.chunk import RrdReader

    small = small_episode()
    position = (small.position + np.array([0, drift], np.float32)[:, None, None, None]) * small.seen[..., None]
    path = write_recording(small_episode(position=position), tmp_path / "e.rrd")
    found = RrdReader(path).stream().to_chunks()
    shift = np.array(column(found, "/swarm", "Transform3D:translation")).reshape(ROUNDS, 3)
    assert shift.tolist() == np.array(column(found, "/candidates", "Transform3D:translation")).reshape(-1, 3).tolist()
    for r in range(ROUNDS):
        shown = on_screen(position[r][small.seen[r]] + shift[r], *eye_of(path))
        assert np.abs(shown).max() < 1
        assert np.ptp(shown, axis=0).max() > 0.6


def test_recordings_that_are_opened_together_have_cameras_of_their_own(tmp_path):
    """The viewer has one layout, and thus one camera, for all recordings with the same application id."""
    from rerun.chunk import RrdReader

    paths = [write_recording(small_episode(), tmp_path / name) for name in ("a.rrd", "b.rrd")]
    ids = [{entry.application_id for entry in (*r.recordings(), *r.blueprints())} for r in map(RrdReader, paths)]
    assert [len(each) for each in ids] == [1, 1]
    assert ids[0] != ids[1]


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
