"""The recording, read back by Rerun's own tools."""

import resource

import numpy as np
import pytest
from small_episode import DECOY, ROUNDS, SAMPLES, UAVS, large_episode, small_episode

from usnet_env import ArgumentError
from usnet_env.replay import rerun, write_recording
from usnet_env.replay.rerun import attention_sheet, find_groups

rr = pytest.importorskip("rerun")


def read(path):
    from rerun.chunk import RrdReader

    return RrdReader(path).stream().to_chunks()


@pytest.fixture(scope="module")
def chunks(tmp_path_factory):
    return read(write_recording(small_episode(), tmp_path_factory.mktemp("recording") / "new" / "replay.rrd"))


def column(chunks, entity, component):
    """The rows of one component of one entity, as lists of instances, in the order of time."""
    rows = []
    for chunk in chunks:
        batch = chunk.to_record_batch()
        if chunk.entity_path == entity and component in batch.schema.names:
            times = [0] * batch.num_rows if chunk.is_static else batch.column("time").cast("int64").to_pylist()
            rows += [(time, row) for time, row in zip(times, batch.column(component).to_pylist(), strict=True) if row]
    return [row for _, row in sorted(rows, key=lambda row: row[0])]


def test_positions_tracks_and_roles_are_those_of_the_record(chunks):
    episode = small_episode()
    uavs = column(chunks, "/world/swarm/uavs", "Points3D:positions")
    assert len(uavs) == ROUNDS * (SAMPLES + 2)
    np.testing.assert_array_equal(uavs[0], episode.position[0, 0])
    np.testing.assert_array_equal(uavs[SAMPLES + 2], episode.position[1, 0][episode.seen[1, 0]])
    radii = np.array(column(chunks, "/world/swarm/uavs", "Points3D:radii")[0])
    assert np.flatnonzero(radii == radii.max()).tolist() == [0, 5, DECOY]
    colors = column(chunks, "/world/swarm/uavs", "Points3D:colors")[0]
    assert (len({colors[0], colors[5], colors[DECOY]}), colors[1]) == (3, colors[0])
    strips = column(chunks, "/world/swarm/tracks", "LineStrips3D:strips")
    lengths = [len(row[1]) for row in strips]
    assert (lengths[0], lengths[:12], lengths[11]) == (1, sorted(lengths[:12]), SAMPLES)
    np.testing.assert_array_equal(strips[11][4], episode.position[0, :, 4])


def test_the_answer_is_shown_when_it_is_given(chunks):
    episode = small_episode()
    found = column(chunks, "/world/found/uavs", "Points3D:positions")
    assert [len(row) for row in found] == [UAVS, UAVS - 2]
    radii = column(chunks, "/world/found/uavs", "Points3D:radii")[0]
    assert sorted(np.argsort(radii)[-2:].tolist()) == [0, 5]  # the UAVs with the highest probability
    labels = column(chunks, "/world/found/candidates", "Ellipsoids3D:labels")
    assert labels == [[f"{i}: score {episode.scores[r, i]:.3g}" for i in who] for r, who in enumerate(([0, 3], [5]))]
    links = column(chunks, "/world/found/links", "LineStrips3D:strips")
    np.testing.assert_allclose(links[0], episode.position[0, -1][episode.hierarchy(1)], rtol=1e-6)
    for chunk in chunks:
        if chunk.entity_path == "/world/found/uavs" and "Points3D:positions" in chunk.to_record_batch().schema.names:
            times = chunk.to_record_batch().column("time").cast("int64").to_pylist()
            assert set(times) <= {int(1e9 * (12.5 * r + 6.25)) for r in range(ROUNDS)}  # after the window of 6 s


def test_destruction_and_remerge_follow_the_answer(chunks):
    episode = small_episode()
    gone = column(chunks, "/world/swarm/destroyed", "Points3D:positions")
    assert [len(row) for row in gone] == [2, 3]
    np.testing.assert_array_equal(gone[0], episode.position[0, -1, [0, 3]])
    colors = column(chunks, "/world/swarm/uavs", "Points3D:colors")
    left = [i for i in range(UAVS) if i not in (0, 3)]
    before = colors[0]
    orphans, after = (dict(zip(left, colors[instant], strict=True)) for instant in (SAMPLES, SAMPLES + 1))
    assert before[1] != before[6]
    assert orphans[1] not in (before[1], before[6])
    assert after[1] == after[6] == before[6]


def test_marks_and_scores_are_the_answers(chunks):
    episode = small_episode()
    kinds = {"hit": "Ellipsoids3D", "missed": "Ellipsoids3D", "redundant": "Boxes3D"}
    labels = {name: column(chunks, f"/world/verdict/{name}", f"{kind}:labels") for name, kind in kinds.items()}
    assert labels == {"hit": [["hit 0"], ["hit 5"]], "missed": [["missed 5"]], "redundant": [["redundant 3"]]}
    bars = {name: column(chunks, f"/scores/{name}", "BarChart:values")[0][0]["buffer"] for name in (*kinds, "other")}
    expected = {"hit": [0], "missed": [5], "redundant": [3], "other": [1, 2, 4, *range(6, UAVS)]}
    assert bars == {name: pytest.approx(episode.scores[0, who].tolist()) for name, who in expected.items()}
    places = {name: column(chunks, f"/scores/{name}", "BarChart:abscissa")[0][0]["buffer"] for name in expected}
    ranked = sorted(pair for name, who in expected.items() for pair in zip(places[name], who, strict=True))
    assert [uav for _, uav in ranked] == np.argsort(-episode.scores[0]).tolist()


def test_links_of_large_swarms_are_off_at_first(tmp_path, monkeypatch):
    import rerun.blueprint as rrb

    shown, view = [], rrb.Spatial3DView
    monkeypatch.setattr(rrb, "Spatial3DView", lambda **made: shown.append(made["overrides"]) or view(**made))
    for most in (UAVS, UAVS - 1):
        monkeypatch.setattr(rerun, "MOST_LINKED", most)
        write_recording(small_episode(), tmp_path / "e.rrd")
    assert [sum(path.endswith("links") for path in each) for each in shown] == [0, 0, 2, 2]


def test_attention_is_that_of_the_record_in_the_order_of_its_groups(chunks):
    episode = small_episode()
    first, second = attention_sheet(episode, 0), attention_sheet(episode, 1)
    assert (first.shape, second.shape) == ((UAVS, UAVS), (UAVS - 2, UAVS - 2))
    np.testing.assert_array_equal(first[:, 0], [255] * 5 + [0] * 7)  # the first group follows UAV 0
    assert len(column(chunks, "/mind/attention", "Image:buffer")) == ROUNDS
    assert find_groups(episode, 0).tolist() == [0] * 5 + [1] * 6 + [-1]
    assert find_groups(small_episode(clusters=None), 0).tolist() == [0, 0, 0, 1, 0, 2, 2, 2, 2, 2, 2, 3]


def test_the_game_is_told_and_counted(chunks):
    texts = [text for (text,) in column(chunks, "/this_round", "TextDocument:text")]
    assert len(texts) == 2 * ROUNDS
    assert "1 candidate (1 head hit, 0 redundant), 0 heads left" in texts[-1]
    ((about,),) = column(chunks, "/about", "TextDocument:text")
    assert "**by hand:** 2 of 2 heads found in 2 rounds" in about
    drawn = column(chunks, "/game/J", "SeriesLines:interpolation_mode")
    assert {mode for (mode,) in drawn} == {rr.components.InterpolationMode.StepAfter.value}
    curves = {name: [x for (x,) in column(chunks, f"/game/{name}", "Scalars:scalars")] for name in ("heads_left", "J")}
    assert {name for chunk in chunks for name in chunk.timeline_names} == {"round", "time"}
    assert curves == {"heads_left": [2.0, 1.0, 0.0], "J": pytest.approx([0.0, 1 + 1 / UAVS, 2 + 1 / UAVS])}


def test_observers_and_intruders_are_shown(tmp_path):
    flown = np.random.default_rng(0).normal(0, 50, (ROUNDS, SAMPLES, 2, 3)).astype(np.float32)
    record = small_episode(observers=[[0, 0, 0, 300.0], [400, 0, 0, 200.0]], intruders=flown)
    found = read(write_recording(record, tmp_path / "e.rrd"))
    assert column(found, "/world/observers", "LineStrips3D:labels")[0][0] == "observer 0, range 300 m"
    ((ring, _),) = column(found, "/world/observers", "LineStrips3D:strips")
    np.testing.assert_allclose(np.linalg.norm(ring, axis=1), 300.0, rtol=1e-5)
    places = column(found, "/world/observers/intruders", "Points3D:positions")
    np.testing.assert_array_equal(places, flown.reshape(-1, 2, 3))
    tracks = column(found, "/world/observers/flown", "LineStrips3D:strips")
    np.testing.assert_array_equal(tracks[SAMPLES - 1], flown[0].swapaxes(0, 1))


@pytest.mark.parametrize("drift", [0, -5000])
def test_every_round_is_moved_to_the_middle_of_the_view(tmp_path, drift):
    small = small_episode()
    position = (small.position + np.array([0, drift], np.float32)[:, None, None, None]) * small.seen[..., None]
    found = read(write_recording(small_episode(position=position), tmp_path / "e.rrd"))
    shift = np.array(column(found, "/world", "Transform3D:translation")).reshape(ROUNDS, 3)
    for r in range(ROUNDS):
        places = position[r][small.seen[r]] + shift[r]
        np.testing.assert_allclose(places.min(axis=0), -places.max(axis=0), atol=1e-2)


def test_records_without_a_mind_or_a_sighting_can_be_written(tmp_path):
    unseen = small_episode(seen=np.zeros((ROUNDS, SAMPLES, UAVS), bool))
    assert write_recording(unseen, tmp_path / "unseen.rrd").stat().st_size > 0
    bare = large_episode(candidates=np.ones((1, 60), bool))
    found = read(write_recording(bare, tmp_path / "bare.rrd"))
    assert not any("attention" in chunk.entity_path for chunk in found)
    assert column(found, "/world/verdict/hit", "Ellipsoids3D:show_labels") == [[True]]
    assert column(found, "/world/verdict/redundant", "Boxes3D:show_labels") == [[False]]  # too many


def test_nothing_global_is_touched_and_a_place_that_cannot_be_written_is_named(tmp_path):
    write_recording(small_episode(), tmp_path / "e.rrd")
    assert rr.get_global_data_recording() is None
    assert rr.get_thread_local_data_recording() is None
    with pytest.raises(ArgumentError, match=r"^path must"):
        write_recording(small_episode(), tmp_path)


def test_a_replay_that_cannot_be_written_whole_leaves_the_old_one(tmp_path):
    path = tmp_path / "e.rrd"
    path.write_text("old")
    _, most = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (10_000, most))  # as on a full disk
    try:
        with pytest.raises(ArgumentError, match=r"^path must be a file that can be written, got .*e\.rrd"):
            write_recording(small_episode(), path)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (most, most))
    assert (path.read_text(), list(tmp_path.iterdir())) == ("old", [path])
