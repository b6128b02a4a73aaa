"""What can be done with found leaders: events, a frame, pictures, and short texts."""

import json

import numpy as np
import pandas as pd
import pytest
from track_files import Answers, answer_of, example, rows_of, straight, tracks_of, write_csv

import usnet_env
from usnet_env import ArgumentError, Detection, plot_detection
from usnet_env.tracks import DetectedWindow, FoundLeaders, Leader, Link, Tracks, find_leaders, read_tracks

pytest.importorskip("matplotlib")


def window_of(start, heads):
    """A window from a text of heads with their followers, such as ``"a: b c, d: e"``; links have a delay of 2 s."""
    leaders, links = [], []
    for group, part in enumerate(filter(None, heads.split(", ")), start=1):
        head, _, behind = part.partition(": ")
        leaders.append(Leader(head, 0.9, tuple(behind.split()), "", group, 1.0))
        links += [Link(name, head, head, 2.0) for name in behind.split()]
    return DetectedWindow(start, start + 10, tuple(leaders), links=tuple(links))


def found_in(*texts):
    return FoundLeaders(tuple(window_of(10 * k, text) for k, text in enumerate(texts)), (), "test", tuple("abcdef"))


@pytest.mark.parametrize(
    ("before", "after", "sentences"),
    [
        ("", "a: b c", ["a leads b, c."]),
        ("a: b c", "", ["a leads no more."]),
        ("a: b", "a: b c", ["c follows a."]),
        ("a: b c d", "a: b", ["c, d no longer follow a."]),
        ("a: b c", "a: b", ["c no longer follows a."]),
        ("a: b c, d: e f", "a: b c d e f", ["d and its 2 followers follow a."]),
        ("a: b c d e", "a: b c, d: e", ["d, which followed a, leads e."]),
        ("a: b c", "b: a c", ["b leads c instead of a."]),
        ("a: b c, d: e", "a: b, d: c e", ["c follows d instead of a."]),
        ("a: b c", "a: b c", []),
    ],
)
def test_events_say_who_follows_whom_from_when_on(before, after, sentences):
    events = [event for event in found_in(before, after).events if event.time == 10]
    assert [str(event).removeprefix("From 10: ") for event in events] == sentences


def test_a_frame_has_a_row_for_each_id_with_a_role():
    frame = found_in("a: b c, d: e", "", "a: b").to_frame()
    assert frame[["start", "id", "head"]].to_numpy().tolist() == [
        *([0, name, head] for name, head in (("a", "a"), ("d", "d"), ("b", "a"), ("c", "a"), ("e", "d"))),
        *([20, name, "a"] for name in "ab"),
    ]
    assert frame["leader"].isna().tolist() == [True, True, False, False, False, True, False]
    assert (frame["delay"].max(), len(found_in("", "").to_frame())) == (2.0, 0)


def test_pictures_show_links_delays_and_heads():
    found = found_in("a: b c, d: e", "a: b c", "a: b")
    draws = (found.plot, found.plot_delays, found.plot_timeline)
    (network,), (delays, _), (timeline,) = (draw().axes for draw in draws)
    widths = [each.arrow_patch.get_linewidth() for each in network.texts if getattr(each, "arrow_patch", None)]
    assert widths == pytest.approx([0.5 + 3.5 * share for share in (1, 2 / 3, 1 / 3)])
    assert sum(each.get_text() == "2 s" for each in network.texts) == 3
    assert sorted(text for each in network.texts if len(text := each.get_text()) == 1) == [*"abcde"]
    assert [each.get_text() for each in delays.texts] == ["2"] * 3
    assert sum(bar.get_width() > 0 for bar in timeline.patches) == 5 + 3 + 2
    assert len(timeline.lines) == 4  # stars
    with pytest.raises(ArgumentError, match=r"^tracks must be given for maps and episodes, got "):
        found.plot_maps()
    empty = found_in("")
    titles = [draw().axes[0].get_title() for draw in (empty.plot, empty.plot_delays, empty.plot_timeline)]
    assert titles == ["No window has a leader.", "No window has a leader.", "No leader was found."]


def test_a_data_frame_is_read_like_a_file():
    frame = pd.DataFrame(rows_of(straight()), columns=["uid", "time_ms", "x", "y"])
    tracks = read_tracks(frame.set_index("uid"), columns={"z": ""})
    assert (tracks.ids, tracks.samples, tracks.duration) == (("a", "b", "c"), 60, 0.0095)
    assert repr(tracks) == "<Tracks: 3 ids, 60 samples, 0.0095 s, 2-D>"
    with pytest.raises(ArgumentError, match="which column of the frame is id"):
        read_tracks(frame.drop(columns="uid"))
    places = straight()[..., :2].reshape(20, 6).T
    wide = pd.DataFrame(dict(zip(["a_x", "a_y", "b_x", "b_y", "c_x", "c_y"], places, strict=True)))
    tracks = read_tracks(wide.assign(timestamp=pd.to_timedelta(np.arange(20) / 2, unit="s")))
    assert (tracks.ids, tracks.samples, tracks.duration) == (("a", "b", "c"), 60, 9.5)


def test_leaders_are_found_in_whatever_holds_tracks(tmp_path):
    path = write_csv(tmp_path / "tracks.csv", rows_of(straight(steps=80)))
    found = find_leaders(read_tracks(path), "one-per-round", confirm=False).to_frame()
    for given in (str(path), pd.read_csv(path)):
        assert find_leaders(given, "one-per-round", confirm=False).to_frame().equals(found)
    assert len(find_leaders(path, "one-per-round", step=1.0, window=13, confirm=False).windows) == 3
    frame = pd.read_csv(path).assign(id=lambda rows: pd.factorize(rows.id)[0])
    frame["t"] = pd.Timestamp("2024-05-01 12:00", tz="Europe/Berlin") + pd.to_timedelta(frame.t, unit="s")
    dated = find_leaders(frame, "one-per-round", confirm=False)
    typed = dated.to_frame()
    assert typed["start"][0] == frame["t"][0]
    assert len(dated.plot_timeline().axes[0].lines)  # the stars of heads
    assert [*map(str, typed.dtypes[:5])] == [*["datetime64[ns, Europe/Berlin]"] * 2, *["Int64"] * 3]
    for wrong in (3, [], straight()):
        with pytest.raises(ArgumentError, match=r"^path must be a file of tracks, .* or an xarray.Dataset"):
            find_leaders(wrong)
    with pytest.raises(ArgumentError, match=r"^detector must be a name, "):
        find_leaders(path, 3)
    alone = Tracks.from_samples([*"aabb"], [0, 1, 8, 9], np.zeros((4, 2)))
    with pytest.raises(ArgumentError, match=r"^tracks must hold a window in which 2 ids are seen in half of the steps"):
        find_leaders(alone.resample(1.0), "none", length=4)


def test_texts_are_short_and_names_are_listed():
    tracks = read_tracks(pd.DataFrame(example().flock(), columns=["id", "t", "x", "y", "leader"]))
    found = find_leaders(tracks, Answers(lambda uavs, k: answer_of(uavs, 0, [0] * uavs)), length=100, confirm=False)
    assert repr(found).startswith("<FoundLeaders in 6 windows by ")
    assert str(found).splitlines()[0] == "bird-0 leads 11 ids in 100% of the windows."
    assert "bird-0" in found._repr_html_()
    cut = next(tracks.resample(0.5).windows(100))
    assert repr(cut) == "<TrackWindow of 12 ids from 0 s to 50 s, <Window of 12 UAVs, 100 steps of 0.5 s, round 1>>"
    detection = Detection([True, False, *[False] * 10], [1.0] * 12, leader=[0] * 12)
    assert repr(detection) == "<Detection for 12 UAVs, 1 named: 0>"
    assert len(plot_detection(detection, cut.window).axes) == 1
    with pytest.raises(ArgumentError, match=r"^window must be an object of Window, got "):
        plot_detection(detection, cut)
    assert {"read_tracks", "find_leaders", "Tracks", "evaluate"} <= set(dir(usnet_env))
    assert usnet_env.read_tracks is read_tracks


def test_a_change_of_the_leader_is_dated_within_a_window():
    """All follow id 0 up to 88 s and id 5 from then on; one window holds all of it."""
    rng = np.random.default_rng(4)
    heading = np.cumsum(rng.normal(0, 0.3, (200, 2)), axis=0)
    free = np.stack([np.cos(heading), np.sin(heading)], axis=2)
    velocity = rng.normal(0, 0.1, (200, 6, 2))
    for t in range(200):
        lead, own = (0, 0) if t < 88 else (5, 1)
        velocity[t] += velocity[max(0, t - 2), lead] - (t < 2) * velocity[0, lead]
        velocity[t, lead] = free[t, own]
    place = np.cumsum(velocity, axis=0) + 20 * rng.normal(size=(6, 2))
    first, change = find_leaders(tracks_of(place, names=range(6)).resample(1.0), "reader(policy='map')").events
    assert (first.time, first.kind, first.new) == (0.0, "leads", 0)
    assert (change.kind, change.old, change.new, change.ids) == ("takes over", 0, 5, (1, 2, 3, 4))
    assert abs(change.time - 88) <= 2
    assert change.low < change.time < change.high
    assert change.probability > 0.9


def test_evidence_has_the_delay_and_the_correlation_of_each_follower():
    frame = pd.DataFrame(example().flock(), columns=["id", "t", "x", "y", "leader"])
    found = find_leaders(read_tracks(frame), Answers(lambda uavs, k: answer_of(uavs, 0, [0] * uavs)), length=100)
    evidence = found.evidence("bird-0").set_index("follower")
    assert len(evidence) == 11
    assert (evidence["windows"] == 6).all()
    assert np.abs(evidence["behind_head"] % 0.5 - 0.25).min() > 0.2  # true delays are 0.5, 1 and 1.5 s
    assert (evidence["correlation"] > 0.9).all()
    assert (evidence["by_chance"] < 0.6).all()
    axes = found.plot().add_axes((0, 0, 1, 1))
    for draw in (found.plot, found.plot_delays, found.plot_timeline, found.plot_probabilities):
        assert draw(ax=axes) is axes.get_figure()
    found.plot_evidence("bird-0", ax=axes)
    assert "bird-0" in axes.get_title()
    with pytest.raises(ArgumentError, match=r"^leader must be an id that leads in a window, got 'bird-1'"):
        found.evidence("bird-1")
    collars = read_tracks(frame.assign(t=1800 * frame["t"]))  # a fix every 15 min: too rare to compare places
    sparse = find_leaders(collars, Answers(lambda uavs, k: answer_of(uavs, 0, [0] * uavs)), length=100)
    assert sparse.evidence("bird-0")["path"].isna().all()
    assert "repeat its velocity 15 to 46 min later" in sparse.leaders[0].reason
    json.dumps(sparse.as_dict(), allow_nan=False)
