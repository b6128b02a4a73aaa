"""What a picture shows depends on what happened, and drawing leaves matplotlib as it was."""

from __future__ import annotations

import sys
import warnings
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from usnet_env import ArgumentError, drawing
from usnet_env.replay.scribe import lighten

matplotlib = pytest.importorskip("matplotlib")

UAVS, HEADS = 9, (0, 4)


def scene(**changes):
    """Two clusters; UAV 8 is a decoy, UAV 3 was destroyed before, UAV 6 is never seen."""
    rng = np.random.default_rng(1)
    alive = np.arange(UAVS) != 3
    seen = np.repeat(alive[None], 30, axis=0)
    seen[:, 6] = False
    seen[-1, 5] = False
    position = rng.uniform(0, 300, (1, UAVS, 3)) + np.cumsum(rng.normal(size=(30, UAVS, 3)), axis=0)
    values = {
        "position": (position * seen[..., None]).astype(np.float32),
        "seen": seen,
        "alive": alive,
        "head": np.isin(np.arange(UAVS), HEADS),
        "root": np.array([0, 0, 0, 0, 4, 4, 4, 4, 8]),
        "decoy": np.arange(UAVS) == 8,
    }
    return values | changes


def named(*uavs):
    return np.isin(np.arange(UAVS), uavs)


def painted(frame, color):
    """Number of pixels in exactly that colour."""
    rgb = [int(color[i : i + 2], 16) for i in (1, 3, 5)]
    return int((frame == rgb).all(axis=-1).sum())


@pytest.mark.parametrize("size", [(960, 720), (480, 400), (640, 640)])
def test_frames_have_the_size_asked_for(size):
    frame = drawing.round_frame(**scene(), size=size)
    assert frame.shape == (size[1], size[0], 3)
    assert frame.dtype == np.uint8
    assert frame.std() > 5


def test_marks_tell_what_was_named():
    no_candidate = drawing.round_frame(**scene())
    hit = drawing.round_frame(**scene(), candidates=named(0, 4))
    wrong = drawing.round_frame(**scene(), candidates=named(0, 4, 1))
    assert painted(no_candidate, drawing.HIT) == painted(no_candidate, drawing.REDUNDANT) == 0
    assert painted(hit, drawing.HIT) > 100
    assert painted(hit, drawing.REDUNDANT) == 0
    assert painted(wrong, drawing.REDUNDANT) > 50


def test_equal_calls_draw_equal_frames():
    np.testing.assert_array_equal(drawing.round_frame(**scene()), drawing.round_frame(**scene()))


def test_round_marks():
    values = scene()
    position, seen = values.pop("position"), values.pop("seen")
    place = drawing.last_seen_position(position, seen)
    np.testing.assert_array_equal(place[5], position[-2, 5])
    assert np.isnan(place[[3, 6]]).all()
    marks = drawing.round_marks(place, **values, candidates=named(0, 1, 3, 8), destroyed_at=np.ones((UAVS, 3)))
    who = {mark: np.flatnonzero(mask).tolist() for mark, mask in marks.items()}
    assert who == {
        drawing.maps.HEAD_MARK: [0, 4],
        drawing.maps.FOLLOWER_MARK: [1, 2, 5, 7],
        drawing.maps.LINK_MARK: [1, 2, 5, 7],
        drawing.maps.DECOY_MARK: [8],
        drawing.maps.HIT_MARK: [0],
        drawing.maps.REDUNDANT_MARK: [1, 3, 8],
        drawing.maps.MISSED_MARK: [4],
        drawing.maps.DESTROYED_MARK: [3],
    }


def test_the_legend_explains_what_is_there_and_no_more():
    figure = drawing.draw_round(**scene(), candidates=named(0, 1), title="round 7")
    (axes,) = figure.axes
    texts = [text.get_text() for text in axes.get_legend().get_texts()]
    assert f"{drawing.maps.HIT_MARK} (1)" in texts
    assert f"{drawing.maps.MISSED_MARK} (1)" in texts
    assert not any(text.startswith(drawing.maps.DESTROYED_MARK) for text in texts)
    assert axes.get_title(loc="left") == "round 7"
    assert drawing.draw_round(**scene(), legend=False).axes[0].get_legend() is None


def test_clusters_keep_their_colour_when_followers_change_sides():
    values = scene()
    colors, _ = drawing.cluster_colors(values["head"], values["root"])
    later, _ = drawing.cluster_colors(values["head"], np.where(values["root"] == 0, 4, values["root"]))
    assert later[1] == colors[4] == later[4]
    assert colors[0] != colors[4]
    numbered, _ = drawing.cluster_colors(values["head"], values["root"], np.full(UAVS, 7))
    assert set(numbered) == {drawing.CLUSTER_COLORS[7]} | set(colors) & {drawing.NO_CLUSTER_COLOR}
    assert drawing.cluster_colors(values["head"], np.full(UAVS, -1))[0].tolist() == [drawing.NO_CLUSTER_COLOR] * UAVS


def test_every_cluster_of_a_large_swarm_looks_different():
    head = np.ones(72, bool)
    colors, markers = drawing.cluster_colors(head, np.arange(72))
    assert len(set(zip(colors.tolist(), markers.tolist(), strict=True))) == 72
    assert len(set(colors[:24])) == 24


# How the three kinds of colour blindness change linear RGB: Machado, Oliveira and Fernandes (2009), severity 1.
EYES = {
    "normal": np.eye(3),
    "protanopia": [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]],
    "deuteranopia": [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]],
    "tritanopia": [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.303900]],
}
TO_XYZ = np.array(
    [[0.4124564, 0.3575761, 0.1804375], [0.2126729, 0.7151522, 0.072175], [0.0193339, 0.119192, 0.9503041]]
)


def to_lab(rgb, eyes):
    """CIELAB of sRGB values ``(n, 3)`` from 0 to 1, as these eyes see them."""
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    xyz = np.clip(linear @ np.transpose(EYES[eyes]), 0, 1) @ TO_XYZ.T / TO_XYZ.sum(axis=1)
    f = np.where(xyz > 216 / 24389, np.cbrt(xyz), (24389 / 27 * xyz + 16) / 116)
    return np.stack([116 * f[:, 1] - 16, 500 * (f[:, 0] - f[:, 1]), 200 * (f[:, 1] - f[:, 2])], axis=1)


@pytest.mark.parametrize("eyes", EYES)
@pytest.mark.parametrize(
    ("colors", "view", "least"),
    [(drawing.CLUSTER_COLORS, "white", 12.0), (drawing.CLUSTER_COLORS, "dark", 8.0), (drawing.COLORS, "white", 12.0)],
)
def test_no_two_colours_look_alike(eyes, colors, view, least):
    """A difference of 2.3 in CIELAB is just noticeable; clusters and series differ by several times that."""
    rgb = np.array([[int(color[i : i + 2], 16) for i in (1, 3, 5)] for color in colors]) / 255
    if view == "dark":
        rgb = lighten(colors)[:, :3] / 255
    lab = to_lab(rgb, eyes)
    away = np.linalg.norm(lab[:, None] - lab, axis=2) + 1000 * np.eye(len(colors))
    assert len(colors) >= 7
    assert away.min() > least
    assert len(drawing.CLUSTER_COLORS) >= 20
    assert len(set(drawing.MARKERS)) == len(drawing.COLORS)  # beside the colour


def test_an_empty_window_can_be_drawn():
    """After a terminated episode nothing is seen any more."""
    blank = scene(seen=np.zeros((30, UAVS), bool), position=np.zeros((30, UAVS, 3), np.float32))
    assert drawing.round_frame(**blank).shape == (720, 960, 3)


@pytest.mark.parametrize("uavs", [200, pytest.param(1000, marks=pytest.mark.slow)])
def test_a_large_swarm_can_be_drawn(uavs):
    rng = np.random.default_rng(0)
    position = rng.uniform(0, 1000, (101, uavs, 3)).astype(np.float32)
    head = np.arange(uavs) < 40
    leader = np.where(head, np.arange(uavs), rng.integers(0, 40, uavs))
    everyone = np.ones(uavs, bool)
    frame = drawing.round_frame(position, np.ones((101, uavs), bool), everyone, head, leader, ~everyone, head)
    assert painted(frame, drawing.HIT) > 1000


def test_environments_render_with_it():
    with gym.make("USNET/MultiCluster-v0", render_mode="rgb_array", clusters=3, uavs=20) as env:
        env.reset(seed=0)
        before = env.render()
        env.step(env.unwrapped.swarm.head.astype(np.int8))
        after = env.render()
    assert before.shape == after.shape == (720, 960, 3)
    assert painted(before, drawing.HIT) == 0
    assert painted(after, drawing.HIT) > 100


def test_frames_keep_their_axes_and_mark_the_destroyed_of_earlier_rounds():
    values = scene()
    frames, shown = drawing.EpisodeFrames(), []
    for shift in (0, 30, 30, 900):
        moved = (values["position"] + np.float32(shift)) * values["seen"][..., None]
        frames.watch(moved, values["seen"])
        shown.append(frames._limits)
    assert shown[0] == shown[1] == shown[2]
    x, y, half = shown[3]
    place = drawing.last_seen_position(moved, values["seen"])
    assert np.nanmax(np.abs(place[:, :2] - (x, y))) < half  # only then they change, so that the swarm is in view

    early = scene(alive=np.ones(UAVS, bool), seen=np.ones((30, UAVS), bool))
    frames = drawing.EpisodeFrames()
    frames.watch(early["position"] + 1, early["seen"])
    frames.watch(values["position"], values["seen"])
    without = drawing.round_frame(**values, limits=frames._limits)
    assert painted(frames.render(**values), drawing.NO_CLUSTER_COLOR) > painted(without, drawing.NO_CLUSTER_COLOR) + 10


def test_the_title_of_a_frame_has_the_result_of_the_round(monkeypatch):
    titles = []
    monkeypatch.setattr(
        drawing.frames, "round_frame", lambda *_, title, **__: titles.append(title) or np.zeros((1, 1, 3), np.uint8)
    )
    with gym.make("USNET/MultiCluster-v0", render_mode="rgb_array", clusters=3, uavs=20) as env:
        env.reset(seed=0)
        env.render()
        named = np.zeros(20, np.int8)
        named[np.flatnonzero(env.unwrapped.swarm.head)[0]] = named[np.flatnonzero(~env.unwrapped.swarm.head)[0]] = 1
        env.step(named)
        env.render()
    assert titles == [
        "round 1: observed, no answer yet",
        "round 1: 1 head hit, 1 redundant   J 1.050   reward -1.050",
    ]


def test_nothing_global_is_touched(fresh_process):
    """In a fresh process: no pyplot, no change of rcParams or of the backend, no global random numbers drawn."""
    code = """
import random, sys
import matplotlib, numpy as np
before = dict(matplotlib.rcParams.copy()), random.getstate(), str(np.random.get_state())
from test_drawing import named, scene
from usnet_env import ArgumentError, drawing
drawing.round_frame(**scene(), candidates=named(0))
assert before == (dict(matplotlib.rcParams.copy()), random.getstate(), str(np.random.get_state()))
assert "matplotlib.pyplot" not in sys.modules
"""
    fresh_process.run(code, Path(__file__).parent)


def test_without_matplotlib_one_sentence_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    with pytest.raises(drawing.MissingExtraError, match=r"`pip install 'usnet\[render\]'` installs it"):
        drawing.round_frame(**scene())


def test_figures_are_written_at_200_pixels_an_inch_or_as_pdf(tmp_path):
    from PIL import Image

    figure = drawing.new_figure(2, 1)
    drawing.style_axes(figure.add_axes((0.1, 0.1, 0.8, 0.8)))
    files = drawing.write_figure(figure, tmp_path / "figure.any", ("png", "pdf"))
    assert [file.name for file in files] == ["figure.png", "figure.pdf"]
    with Image.open(files[0]) as picture:
        assert picture.size == (400, 200)
    with pytest.raises(ArgumentError, match=r"^formats must be one of pdf, png, got"):
        drawing.write_figure(figure, tmp_path / "figure", ("svg",))


@pytest.mark.slow
def test_a_video_has_a_frame_for_each_step(tmp_path):
    pytest.importorskip("moviepy")
    from gymnasium.wrappers import RecordVideo

    env = gym.make("USNET/MultiCluster-v0", render_mode="rgb_array", clusters=2, uavs=12, max_rounds=3)
    with RecordVideo(env, str(tmp_path / "videos"), disable_logger=True) as recorder:
        recorder.reset(seed=0)
        for _ in range(3):
            recorder.step(np.zeros(12, np.int8))
        assert len(recorder.recorded_frames) in (0, 4)  # none after the last step: the video is written
    (video,) = (tmp_path / "videos").iterdir()
    assert video.suffix == ".mp4"
    assert video.stat().st_size > 1000


def test_long_names_keep_their_ends_and_what_tells_them_apart():
    names = [f"zzz_female_collar-{k}-leader-of-the-pack" for k in (1, 10, 11)]
    assert drawing.abbreviate(names, 18) == ["zzz_fe…1…e-pack", "zzz_fe…10…e-pack", "zzz_fe…11…e-pack"]
    assert drawing.abbreviate(["short", "a name that is much too long"], 13) == ["short", "a name…o long"]
    assert drawing.abbreviate([], 9) == []


@given(st.sets(st.text("ab1-", max_size=30)), st.text("ab1", max_size=15), st.integers(5, 20))
def test_different_names_stay_different(names, start, longest):
    full = [start + name + start for name in sorted(names)]
    short = drawing.abbreviate(full, longest)
    assert len(set(short)) == len(full)
    for one, other in zip(full, short, strict=True):
        assert len(one) > longest or one == other


def test_characters_that_the_font_lacks_are_drawn_in_another_one(tmp_path):
    """Matplotlib's DejaVu Sans Mono has U+2312, its DejaVu Sans lacks it; no font has U+0378."""
    figure = drawing.new_figure(2, 1)
    figure.add_subplot().set_xticks([0.5], ["\u2312"])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        (path,) = drawing.write_figure(figure, tmp_path / "figure.png")
        again = drawing.write_figure(figure, tmp_path / "again.png")[0]
    assert path.read_bytes() == again.read_bytes()
    figure.suptitle("\u0378")
    with pytest.warns(UserWarning, match="The fonts of this machine lack some characters"):
        drawing.write_figure(figure, tmp_path / "figure.png")
