"""``find_leaders`` and ``usnet detect``: known leaders, groups that are followed, files, and refusals."""

import json
import sys

import numpy as np
import pandas as pd
import pytest
from track_files import Answers, Sure, answer_of, example, tracks_of, write_csv

from usnet_env import ArgumentError
from usnet_env.replay import EpisodeRecord
from usnet_env.tracks import find_leaders, read_tracks

QUICK = ["--detector", "directional-delays"]
CHAIN = Answers(lambda uavs, _: answer_of(uavs, 0, np.maximum(np.arange(uavs) - 1, 0)))  # each follows the one before


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    place = tmp_path_factory.mktemp("tracks")
    script = example()
    for make in (script.flock, script.merging, script.leaderless, script.shepherd):
        write_csv(place / f"{make.__name__}.csv", make(), ["id", "t", "x", "y", "leader"])
    return place


def leaders_by_window(found):
    return [[leader.id for leader in window.leaders] for window in found.windows]


def test_the_leader_of_a_flock_is_found_with_its_followers(folder):
    found = find_leaders(read_tracks(folder / "flock.csv"))
    assert leaders_by_window(found) == [["bird-0"]] * 5
    for window in found.windows:
        (leader,) = window.leaders
        assert sorted(leader.followers) == sorted(f"bird-{k}" for k in range(1, 12))
        assert leader.probability > 0.9
        assert leader.reason
    (leader,) = found.leaders
    assert (leader.id, len(leader.followers)) == ("bird-0", 11)
    assert "in 5 of 5 windows" in leader.reason


def test_groups_that_merge_are_followed_and_no_id_leads_a_leaderless_flock(folder):
    found = find_leaders(read_tracks(folder / "merging.csv"), length=100)
    assert [set(ids) for ids in leaders_by_window(found)] == [{"bird-0", "bird-1"}] * 4 + [{"bird-0"}] * 4
    groups = {(leader.id, leader.group) for window in found.windows for leader in window.leaders}
    assert sorted(groups) in ([("bird-0", 1), ("bird-1", 2)], [("bird-0", 2), ("bird-1", 1)])
    found = find_leaders(read_tracks(folder / "leaderless.csv"))
    assert not any(leaders_by_window(found))
    assert found.leaders == ()
    assert found.tables()["windows"]["id"].isna().all()


def test_a_leader_is_confirmed_by_followers_that_move_like_it_later(folder):
    """A detector that is always sure of the wrong one: the dog of a herd, or any bird of a leaderless flock."""
    for file, head, named in (("shepherd", 0, 1), ("leaderless", 3, 1), ("flock", 0, 6)):
        tracks = read_tracks(folder / f"{file}.csv").resample(0.5)
        found = find_leaders(tracks, Sure(head), length=100)
        assert sum(map(bool, leaders_by_window(found))) <= named
        assert sum(map(bool, leaders_by_window(found))) >= named - 1
        for window in found.windows:
            assert len(window.leaders) + len(window.not_confirmed) == 1
        all_named = find_leaders(tracks, Sure(head), length=100, confirm=False)
        assert leaders_by_window(all_named) == [[tracks.ids[head]]] * 6


def test_the_same_seed_gives_the_same_answer(folder):
    tracks = read_tracks(folder / "leaderless.csv")
    one, other = (find_leaders(tracks, "random(count=2)", seed=3).as_dict() for _ in range(2))
    assert one == other
    assert one != find_leaders(tracks, "random(count=2)", seed=4).as_dict()


def test_a_group_keeps_its_number_when_another_leads_it(folder):
    found = find_leaders(
        read_tracks(folder / "flock.csv"),
        Answers(lambda uavs, k: answer_of(uavs, k % 2, np.full(uavs, k % 2))),
        confirm=False,
    )
    assert {leader.group for leader in found.leaders} == {1}
    assert [leader.id for leader in found.leaders] == ["bird-0", "bird-1"]
    assert "3 of 5 windows" in found.leaders[0].reason
    assert found.leaders[0].probability is None


def test_a_detector_that_fails_is_named_with_the_window(folder):
    with pytest.raises(ArgumentError, match=r"^detector must .*division by zero.*0\.0 to 59\.5"):
        find_leaders(read_tracks(folder / "flock.csv"), Answers(lambda uavs, k: 1 / 0))
    with pytest.raises(ArgumentError, match=r"^detector must .* for all 12 UAVs"):
        find_leaders(read_tracks(folder / "flock.csv"), Answers(lambda uavs, k: answer_of(3, 0)))


def test_out_and_record_write_all_files(run, folder, tmp_path):
    pytest.importorskip("rerun")
    out = tmp_path / "found"
    status, _, err = run("detect", folder / "merging.csv", "--out", out, "--record")
    assert status == 0
    assert "replay.rrd" in err
    names = {"windows.csv", "leaders.csv", "leaders.json", "picture.png", "page.html", "episode.npz", "replay.rrd"}
    assert names <= {path.name for path in out.iterdir()}
    rows = pd.read_csv(out / "windows.csv")
    assert (rows.start[0], rows.end[0]) == (0.0, 57.0)
    assert {*rows.id} == {"bird-0", "bird-1"}
    assert "bird-2" in rows.set_index("id").followers["bird-0"].iloc[0].split(";")
    assert json.loads((out / "leaders.json").read_text())["leaders"][0]["id"] == "bird-0"
    page = (out / "page.html").read_text(encoding="utf-8")
    assert "<li>bird-0 leads " in page
    assert "<li>From 0.0: bird-0 leads bird-2, " in page
    assert page.count('src="data:image/png;base64,') == 3
    assert "<link" not in page
    record = EpisodeRecord.load(out / "episode.npz")
    assert (record.rounds, record.uavs, record.labelled) == (7, 14, False)
    ids = record.config["ids"]
    assert {ids[i] for i in np.flatnonzero(record.head)} == {"bird-0", "bird-1"}
    behind = record.root[0] == ids.index("bird-0")
    assert {ids[i] for i in np.flatnonzero(behind)} == {"bird-0", *(f"bird-{k}" for k in range(2, 14, 2))}
    tracks = read_tracks(folder / "merging.csv")
    np.testing.assert_allclose(record.position[1, 0, 0], tracks.position[114], atol=1e-3)
    files = find_leaders(folder / "leaderless.csv", "lagged-correlation").write(out, "leaderless.csv")
    assert " ids are present throughout.</li>" in (out / "page.html").read_text(encoding="utf-8")
    assert set(files) == set(out.iterdir())
    names = names - {"episode.npz", "replay.rrd"} | {"links.csv", "network.png", "delays.png", "timeline.png"}
    assert {path.name for path in out.iterdir()} == names


def test_missing_extras_leave_out_a_file_and_say_so(run, folder, tmp_path, monkeypatch):
    for name in ("matplotlib.figure", "matplotlib.backends.backend_agg", "rerun"):
        monkeypatch.setitem(sys.modules, name, None)
    sure = ("--detector", "track_files:Sure(head=0)")
    status, _, err = run("detect", folder / "flock.csv", *sure, "--out", tmp_path, "--record")
    assert status == 0
    assert "[render]" in err
    assert "[replay]" in err
    written = {path.name for path in tmp_path.iterdir()}
    tables = {f"{name}.csv" for name in ("leaders", "links", "windows", "probabilities")}
    assert written == {"episode.npz", "leaders.json", "page.html", *tables}
    assert EpisodeRecord.load(tmp_path / "episode.npz").probability[:, 0].tolist() == [1.0] * 5


def test_links_have_the_direct_leader_and_the_delay_in_seconds():
    """b follows a after 1 s, and c follows b after 1.5 s: b is a relay, also if the detector says that c follows a."""
    rng = np.random.default_rng(3)
    turn = np.convolve(rng.normal(0, 1, 600), np.ones(4) / 4, "same")
    path = 4 * np.stack([np.cos(np.cumsum(turn)), np.sin(np.cumsum(turn))], axis=1)
    relay = np.roll(path, 2, axis=0) + rng.normal(0, 0.5, path.shape)
    place = np.cumsum(np.stack([path, relay, np.roll(relay, 3, axis=0)], axis=1), axis=0)
    tracks = tracks_of(place + rng.normal(0, 0.1, place.shape), 0.5, names="abc").resample(0.5)
    for window in (*find_leaders(tracks, CHAIN).windows[1:], *find_leaders(tracks, Sure(0)).windows[1:]):
        assert [(link.follower, link.leader, link.head) for link in window.links] == [("b", "a", "a"), ("c", "b", "a")]
        assert all(link.direct for link in window.links)
        for link, delay in zip(window.links, (1.0, 1.5), strict=True):
            assert link.delay == pytest.approx(delay, abs=0.1)
            assert link.delay_low < delay < link.delay_high


def test_copies_of_copies_have_no_direct_leader():
    """Exact copies with different delays: a chain and a star look the same, so only the head is known."""
    heading = np.cumsum(np.random.default_rng(3).normal(0, 0.3, 650))
    path = np.cumsum(np.stack([np.cos(heading), np.sin(heading)], axis=1), axis=0)
    place = np.stack([path[20:620], path[18:618], path[15:615]], axis=1) + 30 * np.eye(3)[:, :2]
    for window in find_leaders(tracks_of(place, 0.5, names="abc").resample(0.5), Sure(0)).windows:
        assert [(link.leader, link.direct) for link in window.links] == [("a", False)] * 2
        assert [link.delay for link in window.links] == pytest.approx([1.0, 2.5], abs=0.05)


def test_an_id_that_copies_two_has_no_direct_leader():
    """c follows b and d, which have motions of their own and follow a; more of b, so that b alone predicts it best."""
    rng = np.random.default_rng(3)
    heading, own = np.cumsum(rng.normal(0, 0.3, 650)), rng.normal(0, 0.4, (3, 650, 2))
    path = 4 * np.stack([np.cos(heading), np.sin(heading)], axis=1)
    b, d = np.roll(path, 2, axis=0) + own[0], np.roll(path, 3, axis=0) + own[1]
    c = np.roll(0.6 * b + 0.4 * d, 2, axis=0) + own[2] / 4
    place = np.cumsum(np.stack([path, b, c, d], axis=1), axis=0)
    for window in find_leaders(tracks_of(place, 0.5, names="abcd").resample(0.5), Sure(0)).windows:
        direct = {link.follower: link.direct for link in window.links}
        assert direct == {"b": True, "c": False, "d": True}


def test_ids_that_are_seen_too_little_are_named(folder, run, tmp_path):
    lines = (folder / "flock.csv").read_text().splitlines()
    kept = [line for line in lines if not (line.startswith("bird-3,") and 60 < float(line.split(",")[1]) < 140)]
    kept = [line for line in kept if not (line.startswith("bird-4,") and float(line.split(",")[1]) > 118)]
    (tmp_path / "gap.csv").write_text("\n".join(kept))
    found = find_leaders(read_tracks(tmp_path / "gap.csv").resample(0.5), "lagged-regression")
    assert [window.left_out for window in found.windows] == [(), ("bird-3",), (), (), ()]
    assert len(found.leaders[0].followers) == 11  # bird-4 follows in both windows in which it is seen
    _, out, err = run("detect", tmp_path / "gap.csv", *QUICK, "--window", "250")
    for words in ("12 ids", "The step is 0.5 s", "bird-0", "Over the file"):
        assert words in out
    assert err.startswith("usnet: warning: 1 gap longer")


def test_the_leaders_that_chance_would_give_are_told_once_for_the_file(folder):
    def leads_in(windows):
        return Answers(lambda uavs, k: answer_of(uavs, 0 if k in windows else -1, np.zeros(uavs, np.int64)))

    tracks = read_tracks(folder / "flock.csv").resample(0.5)
    found = find_leaders(tracks, leads_in([0]), length=60)  # windows that are too short to be read in halves
    reason = "Leads group 1 in 1 of 10 windows. 11 followers repeat its velocity 0.49 to "
    assert found.leaders[0].reason.startswith(reason)
    assert found.facts[-1] == "Confirmed in all windows: 1 of 1 candidate; about 0.05 expected by chance."
    assert "5 of 5 candidates; about 0.25 " in find_leaders(tracks, leads_in(range(5))).facts[-1]


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["none.csv"], "none.csv: no such file"),
        (["bad.csv"], "in column 'x'"),
        (["flock.csv", "--window", "100000"], "--window"),
        (["flock.csv", "--detector", "unknown"], "detector must be one of"),
        (["flock.csv", "--detector", "granger"], "--unconfirmed"),
        (["flock.csv", "--column", "id"], "--column"),
        (["flock.csv", "--column", "id=who"], "--column"),
        (["flock.csv", "--column", "animal=id"], "columns must"),
        (["flock.csv", "--step", "0"], "--step"),
        (["flock.csv", "--record"], "--out"),
    ],
)
def test_a_refusal_is_one_sentence_and_nothing_is_written(refused, folder, tmp_path, monkeypatch, words, expected):
    monkeypatch.chdir(folder)
    (folder / "bad.csv").write_text("id,t,x,y\na,0,1,2\nb,0,north,2\n")
    out = [] if "--record" in words else ["--out", str(tmp_path / "out")]
    assert expected in refused("detect", *words, *QUICK * ("--detector" not in words), *out)
    assert not list(tmp_path.glob("out/*"))
