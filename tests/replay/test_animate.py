"""Animations and pages: what their scenes say, what the frames show, and that a page needs nothing but itself."""

from __future__ import annotations

import html
import json
import re
import sys

import gymnasium as gym
import numpy as np
import pytest
from small_episode import MIND, ROUNDS, SAMPLES, UAVS, large_episode, small_episode

from usnet_env import ArgumentError, make_detector
from usnet_env.drawing import HIT, REDUNDANT, pixels_of
from usnet_env.replay import animate, record_episode
from usnet_env.replay.animate import NAME, REMERGE, VERDICT, WATCH, Painter, list_scenes
from usnet_env.replay.page import write_page

pytest.importorskip("matplotlib")
Image = pytest.importorskip("PIL.Image")


def painted(frame, color):
    """Whether each half of a frame, the map of the detector and that of the truth, has pixels of a colour."""
    rgb = [int(color[i : i + 2], 16) for i in (1, 3, 5)]
    height, width = frame.shape[:2]
    maps = np.abs(frame[: int(0.88 * height)].astype(int) - rgb).max(axis=-1) < 24  # without the legend
    return bool(maps[:, : width // 2].sum() > 20), bool(maps[:, width // 2 :].sum() > 20)


@pytest.fixture(scope="module")
def scenes():
    return list(list_scenes(small_episode(), 3))


def test_scenes_tell_the_game_in_order(scenes):
    first = [scene.phase for scene in scenes if scene.round == 1]
    assert first == [WATCH, WATCH, WATCH, NAME, VERDICT, REMERGE]
    assert [scene.phase for scene in scenes if scene.round == ROUNDS] == [WATCH, WATCH, WATCH, NAME, VERDICT, VERDICT]
    assert [scene.samples for scene in scenes[:3]] == [1, 11, SAMPLES]
    assert scenes[4].text == "2 candidates (1 head hit, 1 redundant), 1 head left"
    assert scenes[5].text.endswith(": 3")  # followers without a head
    assert "J = 2.083" in scenes[-1].text
    over = small_episode(over_budget=[True, False], alive=np.ones((ROUNDS, UAVS), bool))
    assert REMERGE not in {scene.phase for scene in list_scenes(over, 3)}  # no follower has lost its head


def test_the_detector_is_not_shown_the_truth(scenes):
    """Hits are green and redundant candidates orange on the map of the truth, once the verdict is given."""
    painter = Painter(small_episode())
    for scene in scenes[2:6]:
        painter.draw(scene)
        frame = pixels_of(painter.figure)
        given = scene.phase == VERDICT
        assert painted(frame, HIT) == painted(frame, REDUNDANT) == (False, given)
        assert painted(frame, "#0072B2")[0] == (scene.phase in (NAME, VERDICT))


def test_where_the_truth_is_unknown_no_verdict_is_given():
    record = small_episode(labelled=False, over_budget=[True, True], alive=np.ones((ROUNDS, UAVS), bool))
    shown = list(list_scenes(record, 2))
    assert [scene.phase for scene in shown] == [WATCH, WATCH, NAME] * ROUNDS + [NAME]
    assert shown[2].text == "it names 2 leaders"
    painter = Painter(record)
    for scene in shown[1:3]:
        painter.draw(scene)
        assert painted(pixels_of(painter.figure), "#332288") == (False, scene.phase == NAME)  # of the first leader


@pytest.mark.slow
def test_a_gif_has_each_scene_with_its_duration(tmp_path, scenes):
    path = animate(small_episode(), tmp_path / "game.gif", frames=3)
    with Image.open(path) as image:
        durations = []
        for number in range(image.n_frames):
            image.seek(number)
            durations.append(image.info["duration"])
    assert sum(durations) == pytest.approx(1000 * sum((0.5, 2.0, 2.5, 2.0)[scene.phase] for scene in scenes))
    assert len(durations) >= 8
    assert [file.name for file in tmp_path.iterdir()] == ["game.gif"]


@pytest.mark.slow
def test_an_mp4_is_written(tmp_path):
    pytest.importorskip("imageio_ffmpeg")  # of the extra render, which brings ffmpeg
    assert animate(large_episode(), tmp_path / "game.mp4", frames=2).read_bytes()[4:8] == b"ftyp"


def test_what_cannot_be_written_is_refused_before(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    monkeypatch.setenv("PATH", str(tmp_path))
    for name in ("game.png", "game.mp4"):  # without ffmpeg
        with pytest.raises(ArgumentError, match=r"path must end in \.gif"):
            animate(small_episode(), tmp_path / name)
    with pytest.raises(ArgumentError, match="frames must be"):
        animate(small_episode(), tmp_path / "game.gif", frames=1)
    assert list(tmp_path.iterdir()) == []


# --- the page --------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    path = tmp_path_factory.mktemp("page") / "report.html"
    return write_page(small_episode(), path)


def read_words(text):
    return html.unescape(
        re.sub("<[^>]*>", " ", re.sub("<script.*?</script>|<style.*?</style>", "", text, flags=re.DOTALL))
    )


def test_the_page_holds_everything_and_loads_nothing(page):
    text = page.read_text()
    assert not re.findall(r"""(?:src|href)=""", text)
    assert "http" not in re.sub("base64,[^'\"]*", "", text)
    assert len(re.findall("data:image/png;base64", text)) == 12
    words = " ".join(read_words(text).split())
    assert "2 of 2 heads found in 2 rounds with 1 redundant candidate: J = 2.083" in words
    assert "UAV 3 redundant, p 0.10, score" in words
    assert "Adds 2 nats." in words
    assert "Round 2: 1 candidate (1 head hit, 0 redundant), 0 heads left" in words
    assert "<title>by hand on USNET/MultiCluster-v0, seed 0</title>" in text
    assert page.stat().st_size < 2_000_000


def test_a_button_of_each_round_goes_to_its_first_frame(page):
    found = re.findall(r"(anim\w+)\.set_frame\((\d+)\); return", page.read_text())
    assert [number for _, number in found] == ["0", "6"]
    assert f"{found[0][0]} = new Animation" in page.read_text()


def test_a_uav_is_named_where_it_is_drawn(page, scenes):
    names, frames = re.search("const names = (.*), frames = (.*);", page.read_text()).groups()
    assert json.loads(names) == [f"UAV {i}" for i in range(UAVS)]
    painter = Painter(small_episode())
    painter.draw(scenes[0])
    picture = pixels_of(painter.figure)
    place = np.array(json.loads(frames)[0])
    column, up = (place[np.isfinite(place[:, 0])] * (picture.shape[1], picture.shape[0])).astype(int).T
    assert len(column) > 0
    assert (picture[len(picture) - 1 - up, column] < 200).all()  # a grey dot


def test_a_page_of_many_windows_animates_the_first_and_names_cannot_break_it(tmp_path, monkeypatch):
    monkeypatch.setattr("usnet_env.replay.page._MAX_ROUNDS", 1)
    about = {"detector": "<b>&amp;</script>", "config": {"ids": ["<!--<script>"] * UAVS}}
    record = small_episode(**about, **dict.fromkeys(MIND))
    text = write_page(record, tmp_path / "x.html").read_text()
    assert "<!--" not in text
    assert json.loads(re.search("const names = (.*), frames", text)[1]) == ["<!--<script>"] * UAVS
    assert "<title>&lt;b&gt;&amp;amp;&lt;/script&gt; on" in text
    assert "The animation shows the first 1 window." in text


def test_a_page_of_recorded_tracks_says_what_is_true_of_them(tmp_path):
    """bird-0 flies ahead, and three others fly its way later."""
    at = np.cumsum(np.cumsum(np.random.default_rng(1).normal(0, 0.1, (200, 2)), axis=0), axis=0)
    rows = [f"bird-{i},{t},{at[t - 2 * i, 0]},{at[t - 2 * i, 1] + i},bird-0" for i in range(4) for t in range(10, 100)]
    (tmp_path / "birds.csv").write_text("\n".join(["id,t,x,y,leader", *rows]))
    env = gym.make("USNET/Tracks-v0", path=tmp_path / "birds.csv", step=1.0, window=40)
    record = record_episode(env, make_detector("destroy-all"), 0, 1)
    words = read_words(write_page(record, tmp_path / "birds.html").read_text())
    assert "1 of 1 head found in 1 window with 3 redundant candidates: F1 = 0.400 (1 is best)" in words
    assert "bird-0" in words
    assert not re.search(r"\bUAVs?\b|destroyed|\bJ\b|[Rr]ound", words)
