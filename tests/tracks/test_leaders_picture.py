"""The picture of ``usnet detect``: titles, names and the legend."""

import numpy as np
import pytest
from test_track_tables import flying, stamp
from track_files import Answers, Sure, answer_of, example, rows_of, straight, write_csv

from usnet_env.tracks import find_leaders, read_tracks

pytest.importorskip("matplotlib")
from matplotlib.colors import to_hex


def draw(tracks, detector, **options):
    """The figure of all windows."""
    figure = find_leaders(tracks, detector, **options).plot_maps("tracks.csv")
    figure.draw_without_rendering()
    return figure


def legend_of(figure):
    return [each.get_text() for axes in figure.axes if axes.get_legend() for each in axes.get_legend().get_texts()]


def test_the_titles_of_a_picture_fit_their_maps(tmp_path):
    names = [f"a bird with a long name {k}" for k in range(3)]
    places = flying(lag=0)
    rows = [[names[k], stamp(t), *map(float, places[t, k])] for t in range(600) for k in range(3)]
    tracks = read_tracks(write_csv(tmp_path / "tracks.csv", rows)).resample(0.1)
    figure = draw(tracks, Sure(2))
    titles = [axes.title for axes in figure.axes] + [axes._left_title for axes in figure.axes]
    boxes = {each.get_text(): each.get_window_extent() for each in titles if "Z to 2010" in each.get_text()}
    assert next(iter(boxes)).startswith("2010-07-08T09:12:00Z to ")
    width = figure.axes[0].get_window_extent().width
    assert max(box.width for box in boxes.values()) < width + 0.5 * figure.dpi


def test_long_names_stay_apart_and_inside(tmp_path):
    """All ids are leaders, and their names are long."""
    names = [f"female {k} of a colony at the sea" for k in range(12)]
    rows = [[names[int(row[0][5:])], *row[1:4]] for row in example().flock()]
    tracks = read_tracks(write_csv(tmp_path / "tracks.csv", rows)).resample(0.5)
    figure = draw(tracks, "destroy-all", confirm=False)
    for axes in figure.axes:
        frame, boxes = axes.get_window_extent(), [each.get_window_extent() for each in axes.texts]
        assert len(boxes) == len({each.get_text() for each in axes.texts}) == 12
        for k, box in enumerate(boxes):
            assert frame.x0 <= box.x0 + 1
            assert box.x1 <= frame.x1 + 1
            assert frame.y0 <= box.y0 + 1
            assert box.y1 <= frame.y1 + 1
            assert not any(box.padded(-1).overlaps(other.padded(-1)) for other in boxes[:k])


def test_the_legend_names_what_is_shown(tmp_path):
    led = draw(
        read_tracks(write_csv(tmp_path / "led.csv", [row[:4] for row in example().flock()])), "lagged-regression"
    )
    assert legend_of(led) == ["leader", "other (colour = leader)", "link from follower to leader"]
    rows = [row[:4] for row in example().leaderless()]
    without = draw(read_tracks(write_csv(tmp_path / "none.csv", rows)), "none")
    assert legend_of(without) == ["other (no leader found)"]


def test_an_id_has_one_colour_in_all_pictures(tmp_path):
    """In the maps, the network, where it is one of few windows, and the timeline."""
    tracks = read_tracks(write_csv(tmp_path / "tracks.csv", rows_of(straight(steps=80)))).resample(0.5)
    answers = Answers(lambda uavs, number: answer_of(uavs, int(number == 0), np.full(uavs, int(number == 0))))
    found = find_leaders(tracks, answers, length=20, confirm=False)
    colors = [color.lower() for color in found.colors.values()]
    assert [*found.colors] == ["a", "b"]
    maps, network = found.plot_maps(), found.plot().axes[0]
    for axes, color in zip(maps.axes, (colors[1], colors[0]), strict=False):
        assert color in {to_hex(each) for part in axes.collections for each in part.get_facecolor()}
    patches = found.plot_timeline().axes[0].patches
    assert {to_hex(patch.get_facecolor()) for patch in patches} == set(colors)
    names = [each.get_text() for each in network.texts if each.get_text() in ("a", "b", "c")]
    shown = {name: to_hex(dot.get_facecolor()[0]) for name, dot in zip(names, network.collections, strict=True)}
    assert {name: shown[name].upper() for name in "ab"} == found.colors
