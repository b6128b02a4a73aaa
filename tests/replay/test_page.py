"""The page of an episode: what it says, and in a real browser that it loads without errors and its scrubber works."""

from __future__ import annotations

import html
import re
import shutil
import subprocess
from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest
from small_episode import MIND, small_episode

from usnet_env import make_detector
from usnet_env.replay import EpisodeRecord, record_episode
from usnet_env.replay.animation import scenes
from usnet_env.replay.page import write_episode_page, write_page
from usnet_env.replay.story import explain_replay, tell_round

pytest.importorskip("matplotlib")

BROWSER = next(
    (path for name in ("chromium", "chromium-browser", "google-chrome") if (path := shutil.which(name))), None
)
#: At the end of the page: move the scrubber, and write what is seen before and after into the page.
PROBE = """<script>
const slider = document.querySelector("input"), img = document.querySelector("img"), first = img.src;
const words = () => document.querySelector(".now").textContent;
const before = words();
slider.value = slider.max; slider.dispatchEvent(new Event("input"));
document.body.insertAdjacentHTML("beforeend", `<pre id="probe">${[window.failed || "no error", first !== img.src,
  before !== words(), img.naturalWidth > 100, document.documentElement.scrollWidth <= innerWidth].join()}</pre>`);
</script>"""
WATCH = "<script>window.onerror = (text) => { window.failed = text; };</script>"


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    return write_episode_page(small_episode(), tmp_path_factory.mktemp("page") / "report.html")


def test_the_page_holds_everything_and_loads_nothing(page):
    text = page.read_text()
    assert not re.search(r"""(src|href)=["'](?!data:image/png;base64,|episode\.npz)""", text)
    assert "http" not in re.sub("base64,[^'\"]*", "", text)
    words = read_words(text)
    assert "All 2 heads found in 2 rounds with 1 redundant candidate: J = 2.083" in words
    assert "redundant. Adds 2 nats." in words
    assert page.stat().st_size < 1_000_000
    assert "prefers-color-scheme: dark" in text


def test_without_reasons_the_page_says_how_much_attention_a_candidate_receives(tmp_path):
    episode = small_episode(reasons=None)
    text = html.unescape(write_episode_page(episode, tmp_path / "report.html").read_text())
    assert "receives attention 2 (sum over the other 11 UAVs)." in text  # of 4 followers, 0.5 each


def test_a_page_of_many_episodes_has_pictures_of_fewer_rounds(tmp_path, monkeypatch):
    monkeypatch.setattr("usnet_env.replay.page._MOST_ROUNDS", 2)
    monkeypatch.setattr("usnet_env.replay.page._LEAST_ROUNDS", 1)
    text = write_page("two", {"a": small_episode(), "b": small_episode()}, tmp_path / "two.html").read_text()
    assert text.count("The pictures show the first 1 round.") == 2
    assert "Round 1 of 2" in text
    assert "Round 2 of 2" not in text


def test_names_cannot_break_the_page(tmp_path):
    record = small_episode(detector="<b>&amp;</script>", **dict.fromkeys(MIND))
    text = write_page("a < b", {"x": record}, tmp_path / "e.html").read_text()
    assert "&lt;b&gt;&amp;amp;&lt;/script&gt;" in text
    assert "<title>a &lt; b</title>" in text


@pytest.fixture(scope="module")
def tracks(tmp_path_factory):
    """A file of four birds: bird-0 flies ahead, and the others fly its way later."""
    rng = np.random.default_rng(1)
    at = np.cumsum(np.cumsum(rng.normal(0, 0.1, (200, 2)), axis=0), axis=0)
    rows = [f"bird-{i},{t},{at[t - 2 * i, 0]},{at[t - 2 * i, 1] + i},bird-0" for i in range(4) for t in range(10, 200)]
    path = tmp_path_factory.mktemp("tracks") / "birds.csv"
    path.write_text("\n".join(["id,t,x,y,leader", *rows]))
    return path


def read_words(text):
    return html.unescape(re.sub("<[^>]*>", " ", re.sub("base64,[^'\"]*", "", text)))


def test_a_page_of_recorded_tracks_says_what_is_true_of_them(tracks, tmp_path):
    env = gym.make("USNET/Tracks-v0", path=tracks, step=1.0)
    records = {name: record_episode(env, make_detector(name), 0, 1) for name in ("none", "destroy-all")}
    loaded = {name: EpisodeRecord.load(each.save(tmp_path / f"{name}.npz")) for name, each in records.items()}
    text = read_words(write_page("tracks", loaded, tmp_path / "tracks.html").read_text())
    body = text[text.index("A detector looks") : text.index("const box")]
    assert "The truth is what the file says of the leaders." in body
    ending = "redundant candidates: F1 = {} (1 is best), group leaders 0.25."
    assert f"0 of 1 head found in 1 window with 0 {ending.format('0.000')}" in body
    assert f"1 of 1 head found in 1 window with 3 {ending.format('0.400')}" in body
    assert "Without candidates no head is hit. 1 head not found: F1 = 0.00 (1 is best)." in body
    assert "bird-0" in body
    assert not re.search(r"\bUAVs?\b|destroyed|\bJ\b|[Rr]ound", body)
    for record in loaded.values():
        assert not record.destroyed.any()
        told = [*tell_round(record, 1, list("abcd")), explain_replay(record), *(each.text for each in scenes(record))]
        assert not re.search(r"\bUAVs?\b|are destroyed|\bJ\b|[Rr]ound", " ".join(told))
    config = {name: value for name, value in loaded["none"].config.items() if name not in ("ids", "start", "end")}
    earlier = replace(loaded["none"], config=config)  # as an earlier version wrote it
    text = read_words(write_page("tracks", {"x": earlier}, tmp_path / "earlier.html").read_text())
    assert " track 0 " in text
    assert "F1 = 0.000 (1 is best)" in text


@pytest.mark.slow
@pytest.mark.skipif(BROWSER is None, reason="no Chromium is installed")
@pytest.mark.parametrize("size", ["1280,900", "500,900"])
def test_the_scrubber_changes_the_picture_in_a_browser(page, tmp_path, size):
    text = page.read_text()
    copy = tmp_path / "probe.html"
    copy.write_text(text.replace("<body>", f"<body>{WATCH}").replace("</body>", f"{PROBE}</body>"))
    words = [
        BROWSER,
        "--headless",
        "--no-sandbox",
        "--disable-gpu",
        f"--window-size={size}",
        "--dump-dom",
        copy.as_uri(),
    ]
    done = subprocess.run(words, capture_output=True, text=True, timeout=120, check=True)
    assert re.search('id="probe">(.*?)</pre>', done.stdout)[1] == "no error,true,true,true,true"
