"""The page of found leaders: its numbers are those of the tracks, and it can be used in a browser."""

import json
import re
import shutil
import subprocess

import numpy as np
import pytest
from track_files import Answers, answer_of, example

from usnet_env.tracks import Tracks, find_leaders

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
    distance = (
        np.diff(np.reshape([data["points"][follower], data["points"][head]], (2, -1, 2)), axis=0)[0] / data["unit"]
    )
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
