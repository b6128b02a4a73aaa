"""The page and the pictures of found leaders: numbers, titles, names and the legend; the page works in a browser."""

import json
import re
import shutil
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.colors import to_hex
from test_track_tables import flying, stamp
from track_files import Answers, Sure, answer_of, example, rows_of, straight, tracks_of, write_csv

from usnet_env import Detection
from usnet_env.tracks import Tracks, find_leaders, read_tracks

BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
CLICK = """<script>
const [x, y] = place(3, instant, map.clientWidth, map.clientHeight), box = map.getBoundingClientRect();
map.dispatchEvent(new MouseEvent("click", {clientX: box.left + x, clientY: box.top + y}));
const clicked = find("about").textContent;
slider.value = 20; slider.oninput();
chooser.value = 0; chooser.onchange();
document.title = JSON.stringify([clicked, find("about").textContent, find("time").textContent]);
</script>"""


def find_in(rows, detector):
    ids, time, x, y, _ = zip(*rows, strict=True)
    return find_leaders(Tracks.from_samples(ids, time, np.stack([x, y], axis=1)), detector)


@pytest.fixture(scope="module")
def flock():
    return find_in(example().flock(), "lagged-correlation")


def read_data(path):
    page = path.read_text(encoding="utf-8")
    return page, json.JSONDecoder().raw_decode(page, page.index("const data = ") + len("const data = "))[0]


def test_the_map_has_the_places_times_links_and_curves_that_were_found(flock, tmp_path):
    flock.write(tmp_path, "<flock>")
    page, data = read_data(tmp_path / "page.html")
    assert "Leaders in &lt;flock&gt;" in page
    assert not re.findall(r"(?:src|href)=\"(?!data:)", page)  # nothing is fetched
    head, follower = data["ids"].index("bird-0"), data["ids"].index("bird-3")
    places = np.reshape([data["points"][follower], data["points"][head]], (2, -1, 2))
    distance = (places[1] - places[0]) / data["unit"]
    rows = {(name, time): np.array([x, y]) for name, time, x, y, _ in example().flock()}
    known = [rows["bird-0", float(time)] - rows["bird-3", float(time)] for time in data["times"]]
    np.testing.assert_allclose(distance, known, atol=2 / data["unit"])
    (link,) = (link for link in data["windows"][0]["links"] if link["follower"] == follower)
    (found,) = (link for link in flock.windows[0].links if link.follower == "bird-3")
    assert (link["head"], link["delay"], link["direct"]) == (head, round(found.delay, 3), found.direct)
    curves = data["curves"][str(head)]
    at = curves["lags"][int(np.argmax(curves["of"][str(follower)]))]
    assert at == pytest.approx(found.behind_head, abs=0.5)
    assert max(curves["of"][str(follower)]) > 0.9 > curves["chance"]


def test_ids_that_are_away_and_a_page_without_a_leader(tmp_path):
    rows = [row for row in example().flock() if row[0] != "bird-2" or row[1] > 60]
    found = find_in(rows, Answers(lambda uavs, _: answer_of(uavs, -1)))
    found.write(tmp_path)
    page, data = read_data(tmp_path / "page.html")
    assert "No leader was found." in page
    assert "<img" not in page
    away = np.array(data["points"][data["ids"].index("bird-2")])[::2] < 0
    assert away.tolist() == [float(time) <= 60 for time in data["times"]]


@pytest.mark.filterwarnings("ignore:.*was not drawn")
def test_leaders_of_many_ids_share_the_map_and_the_network_names_only_them(tmp_path, monkeypatch):
    """The second id leads 50 of 120, of which the last isn't shown; a link through it begins at the head."""
    followed = np.append([0, 1], np.arange(118) >= 68)
    answers = Answers(lambda uavs, _: Detection(np.arange(uavs) < 2, np.ones(uavs), leader=followed))
    found = find_leaders(tracks_of(straight(40, 120)).resample(1.0), answers, length=39, confirm=False)
    names = [each.get_text() for each in found.plot().axes[0].texts]
    assert [name for name in names if name.startswith("a")] == ["a0", "a1"]
    (window,) = found.windows
    links = [replace(link, leader="a119", direct=True, behind_head=3.0) for link in window.links[:1]]
    found = replace(found, windows=(replace(window, links=(*links, *window.links[1:])),))
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)  # without pictures
    found.write(tmp_path)
    _, data = read_data(tmp_path / "page.html")
    (shown,) = data["windows"]
    assert (shown["leaders"], shown["followers"]) == ([0, 1], [68, 50])
    assert [sum(link["head"] == head for link in shown["links"]) for head in (0, 1)] == [49, 49]
    link = next(link for link in shown["links"] if data["ids"][link["follower"]] == "a2")
    assert (link["leader"], link["direct"], link["delay"]) == (0, False, 3.0)


@pytest.mark.slow  # a browser starts
@pytest.mark.skipif(BROWSER is None, reason="no Chromium")
def test_a_click_on_the_map_and_the_slider(flock, tmp_path):
    flock.write(tmp_path)
    path = tmp_path / "page.html"
    path.write_text(path.read_text(encoding="utf-8").replace("</body>", f"{CLICK}</body>"), encoding="utf-8")
    how = ("--headless", "--no-sandbox", "--disable-gpu", "--virtual-time-budget=2000", "--dump-dom")
    shown = subprocess.run([str(BROWSER), *how, path.as_uri()], capture_output=True, text=True, check=True).stdout
    clicked, after, time = json.loads(re.findall("<title>(.*?)</title>", shown)[0])
    _, data = read_data(path)
    first = flock.windows[0]
    assert clicked.startswith(f"{data['ids'][3]} follows bird-0")
    assert clicked.endswith(f"from {first.start} to {first.end}.")
    assert after.startswith("bird-0 leads 11 ids")
    assert time == data["times"][20]


pytest.importorskip("matplotlib")


def draw(tracks, detector, **options):
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
            assert all(frame.padded(1).contains(*corner) for corner in box.corners())
            assert not any(box.padded(-1).overlaps(other.padded(-1)) for other in boxes[:k])


def test_the_legend_names_what_is_shown(tmp_path):
    rows = [row[:4] for row in example().flock()]
    led = draw(read_tracks(write_csv(tmp_path / "led.csv", rows)), "lagged-regression")
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
