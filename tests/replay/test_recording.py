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
from usnet_env.replay import write_comparison, write_recording
from usnet_env.replay.mind import attention_maps
from usnet_env.replay.scribe import list_steps

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


def shown(row):
    """The instances of a row that are not NaN."""
    values = np.array(row, float).reshape(len(row), -1)
    return values[np.isfinite(values).all(axis=1)]


def test_a_row_for_each_instant_of_the_whole_swarm(chunks):
    rows = Counter()
    for chunk in chunks:
        if not chunk.is_static:
            rows[chunk.entity_path] = max(rows[chunk.entity_path], chunk.num_rows)
    moving = ("heads", "followers")
    assert {rows[f"/world/swarm/{name}"] for name in moving} == {ROUNDS * (SAMPLES + 1)}
    assert rows["/world/swarm/decoys"] == ROUNDS * SAMPLES
    answered = ("world/verdict/hit", "world/found/uavs", "world/found/attention", "mind/features", "scores/bars")
    assert {rows[f"/{name}"] for name in answered} == {2 * ROUNDS}
    assert rows["/this_round"] == 4 * ROUNDS


def test_positions_are_those_seen(chunks):
    episode = small_episode()
    heads = column(chunks, "/world/swarm/heads", "Points3D:positions")
    assert [len(shown(row)) for row in heads] == [2] * SAMPLES + [1] + [1] * SAMPLES + [
        0
    ]  # the last of each: destroyed
    np.testing.assert_array_equal(shown(heads[-2]), episode.position[1, -1, [5]])
    followers = column(chunks, "/world/swarm/followers", "Points3D:positions")
    watched = [row for k, row in enumerate(followers) if k % (SAMPLES + 1) < SAMPLES]
    assert sum(len(shown(row)) for row in watched) == episode.seen[:, :, ~episode.head & ~episode.decoy].sum()


def test_tracks_grow_behind_the_uavs(chunks):
    strips = column(chunks, "/world/swarm/tracks", "LineStrips3D:strips")
    lengths = sorted(len(row[0]) for row in strips if row)
    assert lengths == sorted(list(range(2, SAMPLES + 1)) * ROUNDS)
    assert sum(not row for row in strips) == ROUNDS  # none at the start of a window
    (longest,) = [row for row in strips if row and len(row[0]) == SAMPLES and np.isfinite(row[0]).all()]
    np.testing.assert_array_equal(longest[4], small_episode().position[0, :, 4])


def test_the_answer_is_shown_when_it_is_given(chunks):
    """Rows alternate: nothing at the start of a round, then the answer."""
    episode = small_episode()
    found = column(chunks, "/world/found/uavs", "Points3D:positions")
    assert [len(row) for row in found] == [0, UAVS, 0, UAVS - 2]
    radii = column(chunks, "/world/found/uavs", "Points3D:radii")[1]
    assert sorted(np.argsort(radii)[-2:].tolist()) == [0, 5]  # the UAVs with the highest probability
    assert column(chunks, "/world/found/labels", "Points3D:labels") == [
        [],
        ["0, p 0.90", "3, p 0.10"],
        [],
        ["5, p 0.90"],
    ]
    links = column(chunks, "/world/found/links", "LineStrips3D:strips")
    pairs = episode.hierarchy(1)
    np.testing.assert_allclose(links[1], episode.position[0, -1][pairs], rtol=1e-6)
    for chunk in chunks:
        if chunk.entity_path == "/world/found/uavs" and not chunk.is_static:
            steps = chunk.to_record_batch().column("step").to_pylist()
            assert steps == [list_steps(episode)[r, i] for r in range(ROUNDS) for i in (0, -1)]


def test_destruction_and_remerge_follow_the_answer(chunks):
    episode = small_episode()
    crosses = column(chunks, "/world/swarm/destroyed", "LineStrips3D:strips")
    assert [len(row) for row in crosses] == [0, 4, 4, 6]
    middles = np.array(crosses[1]).reshape(2, 4, 3).mean(axis=1)
    np.testing.assert_allclose(middles, episode.position[0, -1, [0, 3]], rtol=1e-5)
    before, orphans, after, *_ = column(chunks, "/world/swarm/followers", "Points3D:colors")
    members = np.flatnonzero(~episode.head & ~episode.decoy).tolist()
    first, fifth = members.index(1), members.index(6)
    assert before[first] != before[fifth]
    assert orphans[first] not in (before[first], before[fifth])
    assert after[first] == after[fifth] == before[fifth]


def test_attention_is_as_wide_as_its_weight_and_has_a_map_for_each_head(chunks):
    episode = small_episode()
    strips = column(chunks, "/world/found/attention", "LineStrips3D:strips")
    assert [len(row) for row in strips] == [0, UAVS - 3, 0, UAVS - 4]
    assert len(set(column(chunks, "/world/found/attention", "LineStrips3D:radii")[1])) == 1
    assert column(chunks, "/mind/attention/titles", "Points2D:labels")[0] == [
        "all weights",
        "attention head 1",
        "attention head 2",
    ]
    (title, first), (_, head), _ = attention_maps(episode, 0)
    assert title == "all weights"
    np.testing.assert_array_equal(first, head)
    assert first.shape == (UAVS, UAVS)
    assert attention_maps(episode, 1)[0][1].shape == (UAVS - 2,) * 2
    large = np.zeros((1, 600, 600), np.float32)
    large[0, 599, 0] = 1.0
    blank = {
        "position": np.zeros((1, 2, 600, 3)),
        "velocity": np.zeros((1, 1, 600, 3)),
        "seen": np.ones((1, 2, 600), bool),
    }
    rows = {name: np.zeros((1, 600), kind) for name, kind in {"candidates": bool, "root": int, "scores": float}.items()}
    masks = {"head": np.arange(600) == 0, "decoy": np.zeros(600, bool), "alive": np.ones((1, 600), bool)}
    values = large_episode(**blank, **rows, **masks, attention=large)
    ((_, reduced),) = attention_maps(values, 0)
    assert reduced.shape == (200, 200)
    assert reduced.max() == 1.0


def test_views_that_wait_for_the_answer_say_so_and_the_grid_has_a_scale_in_each_round(chunks):
    for view in ("scores", "mind/attention", "mind/features"):
        assert column(chunks, f"/{view}/waiting", "Points2D:labels") == [["no answer yet"], []] * ROUNDS
    places = column(chunks, "/world/ground/scale", "Points3D:positions")
    low = [small_episode().position[r][small_episode().seen[r]].min(axis=0) for r in range(ROUNDS)]
    assert all(place[0][1] < each[1] for place, each in zip(places, low, strict=True))


def test_the_feature_space_is_that_of_the_record(chunks):
    points = column(chunks, "/mind/features", "Points2D:positions")
    plane = small_episode().features[1][small_episode().alive[1]]
    np.testing.assert_allclose(points[-1], plane / (2 * np.abs(plane).max()), rtol=1e-5)


def test_marks_are_the_answers(chunks):
    kinds = {"hit": "Ellipsoids3D", "missed": "Ellipsoids3D", "redundant": "Boxes3D"}
    counts = {}
    for name, kind in kinds.items():
        path = f"/world/verdict/{name}"
        rows = column(chunks, path, f"{kind}:centers")
        assert [len(row) for row in rows] == [len(row) for row in column(chunks, path, f"{kind}:half_sizes")]
        counts[name] = [len(row) for row in rows]
    assert counts == {"hit": [0, 1, 0, 1], "missed": [0, 1, 0, 0], "redundant": [0, 1, 0, 0]}


def test_decoys_look_like_no_other_uav(chunks):
    """They are diamonds of 8 edges; destroyed UAVs are crosses of another colour."""
    episode = small_episode()
    diamonds = column(chunks, "/world/swarm/decoys", "LineStrips3D:strips")
    ((diamond,), *_) = diamonds
    np.testing.assert_allclose(np.mean(diamond[1:], axis=0), episode.position[0, 0, DECOY], atol=1e-3)
    decoy, destroyed = (
        column(chunks, f"/world/swarm/{name}", "LineStrips3D:colors") for name in ("decoys", "destroyed")
    )
    assert decoy != destroyed


def test_scores_say_which_uavs_were_named(chunks):
    episode = small_episode()
    (labels, _), (colors, _), (numbers, _) = (
        column(chunks, f"/scores/{name}", component)[1::2]
        for name, component in (("bars", "Boxes2D:labels"), ("bars", "Boxes2D:colors"), ("numbers", "Points2D:labels"))
    )
    order = np.argsort(-episode.scores[0])
    words = {0: "hit", 3: "redundant", 5: "missed"}
    expected = [f"UAV {i}: score {episode.scores[0, i]:.3g}, {words.get(i, 'other')}" for i in order.tolist()]
    assert labels == expected
    assert sorted(map(int, numbers)) == [0, 3, 5]
    assert len(set(colors)) == 4


def test_the_round_is_told_as_it_happens(chunks):
    texts = [text for (text,) in column(chunks, "/this_round", "TextDocument:text")]
    watched, answered, shot, merged = texts[:4]
    assert watched == "**Round 1 of 2:** the detector watches 20 steps. To it, all UAVs look alike.\n"
    assert "It names 2 UAVs as heads." in answered
    assert "- **3** redundant, p 0.10, score" in answered
    assert "Adds 2 nats." in answered
    assert "destroyed" not in answered
    assert "1 is a head (hit), 1 is not (redundant). All 2 are destroyed." in shot
    assert "3 followers of 0 join 5" not in shot
    assert "3 followers without a head join the nearest remaining head." not in shot
    assert "followers of 0 join 5" in merged
    assert "All heads are destroyed after 2 rounds: J = 2.08" in texts[-1]


def test_lanes_and_curves_follow_the_game(chunks):
    lanes = {path: column(chunks, f"/lanes/{path}", "StateChange:state") for path in ("game", "head_0", "head_5")}
    assert [word for (word,) in lanes["head_0"]] == ["watched", "named: hit", "destroyed"]
    assert [word for (word,) in lanes["head_5"]] == ["watched", "not named", "watched", "named: hit", "destroyed"]
    assert [word for (word,) in lanes["game"]][-1] == "end"
    curves = {
        name: [x for (x,) in column(chunks, f"/game/{name}", "Scalars:scalars")]
        for name in ("precision", "recall", "J")
    }
    assert curves["precision"] == pytest.approx([0.5, 2 / 3, 2 / 3])
    assert curves["recall"] == [0.0, 0.5, 1.0, 1.0]
    assert curves["J"] == pytest.approx([0.0, 1 + 1 / UAVS, 2 + 1 / UAVS, 2 + 1 / UAVS])


def test_scores_of_zero_are_drawn_and_named(tmp_path):
    from rerun.chunk import RrdReader

    bare = dict.fromkeys(
        ("attention", "attention_heads", "probability", "features", "reasons", "clusters", "leader_estimate")
    )
    path = write_recording(small_episode(scores=np.zeros((ROUNDS, UAVS)), **bare), tmp_path / "e.rrd")
    found = RrdReader(path).stream().to_chunks()
    assert column(found, "/scores/scale", "Points2D:labels")[1::2] == [["all scores are 0"]] * ROUNDS
    sizes = column(found, "/scores/bars", "Boxes2D:half_sizes")
    assert all(0 < height < 0.1 for row in sizes for _, height in row)
    assert column(found, "/scores/bars", "Boxes2D:labels")[1][0] == "UAV 0: score 0, hit"
    assert "mind" not in " ".join(chunk.entity_path for chunk in found)


def test_labels_are_beside_the_marks_unless_there_are_too_many(chunks, tmp_path):
    from rerun.chunk import RrdReader

    episode = small_episode()
    labels = column(chunks, "/world/verdict/labels", "Points3D:labels")
    assert labels[1] == ["hit 0", "redundant 3", "missed 5"]
    above = column(chunks, "/world/verdict/labels", "Points3D:positions")[1] - episode.position[0, -1, [0, 3, 5]]
    assert (above[:, 2] > 5).all()

    large = large_episode(candidates=np.ones((1, 60), bool))
    found = RrdReader(write_recording(large, tmp_path / "large.rrd")).stream().to_chunks()
    assert {len(row) for row in column(found, "/world/verdict/labels", "Points3D:labels")} == {0}
    assert "… and 30 more" in column(found, "/this_round", "TextDocument:text")[1][0]


def test_observers_and_choices_are_shown(tmp_path):
    from rerun.chunk import RrdReader

    chosen = [{"head_0": "UAV 0: iid, jitter; price 0.1"}, {}]
    record = small_episode(observers=[[0, 0, 0, 300.0], [400, 0, 0, 200.0]], choices=chosen)
    found = RrdReader(write_recording(record, tmp_path / "e.rrd")).stream().to_chunks()
    ((first, _),) = column(found, "/world/observers", "Points3D:labels")
    assert first == "observer 0, range 300 m"
    ((ring, _),) = column(found, "/world/observers/ranges", "LineStrips3D:strips")
    np.testing.assert_allclose(np.linalg.norm(ring, axis=1), 300.0, rtol=1e-5)
    texts = column(found, "/this_round", "TextDocument:text")
    assert "- head_0, UAV 0: iid, jitter; price 0.1" in texts[0][0]


def test_two_detectors_on_one_swarm(tmp_path):
    from rerun.chunk import RrdReader

    other = np.zeros((ROUNDS, UAVS), bool)
    other[0, [0, 3]] = other[1, 4] = True
    path = write_comparison(small_episode(), small_episode(candidates=other, detector="another"), tmp_path / "both.rrd")
    found = RrdReader(path).stream().to_chunks()
    entities = {chunk.entity_path for chunk in found}
    assert {"/a/world/swarm/heads", "/b/world/swarm/heads", "/a/game/J", "/b/game/J", "/about"} <= entities
    ((text,),) = column([chunk for chunk in found if chunk.entity_path == "/about"], "/about", "TextDocument:text")
    assert "**by hand:**" in text
    assert "**another:**" in text
    with pytest.raises(ArgumentError, match=r"^second must begin with the same swarm as first"):
        write_comparison(
            small_episode(), small_episode(position=np.zeros((ROUNDS, SAMPLES, UAVS, 3))), tmp_path / "c.rrd"
        )


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
    shift = np.array(column(found, "/world", "Transform3D:translation")).reshape(ROUNDS, 3)
    for r in range(ROUNDS):
        places = on_screen(position[r][small.seen[r]] + shift[r], *eye_of(path))
        assert np.abs(places).max() < 1
        assert np.ptp(places, axis=0).max() > 0.6


def test_recordings_that_are_opened_together_have_cameras_of_their_own(tmp_path):
    """The viewer has one layout, and thus one camera, for all recordings with the same application id."""
    from rerun.chunk import RrdReader

    paths = [write_recording(small_episode(), tmp_path / name) for name in ("a.rrd", "b.rrd")]
    ids = [{entry.application_id for entry in (*r.recordings(), *r.blueprints())} for r in map(RrdReader, paths)]
    assert [len(each) for each in ids] == [1, 1]
    assert ids[0] != ids[1]


def test_timelines_are_named_and_in_steps(chunks):
    assert {name for chunk in chunks for name in chunk.timeline_names} == {"round", "step", "time"}
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
