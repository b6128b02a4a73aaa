"""What a picture shows depends on what happened, and drawing leaves matplotlib as it was."""

import random
import sys

import gymnasium as gym
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from usnet_env import drawing

matplotlib = pytest.importorskip("matplotlib")
collections = pytest.importorskip("matplotlib.collections")

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
    rgb = [int(color[i : i + 2], 16) for i in (1, 3, 5)]
    return int((frame == rgb).all(axis=-1).sum())


def frame_of(*window, **look):
    return drawing.pixels_of(drawing.draw_round(*window, **look))


def test_marks_tell_what_was_named():
    no_candidate = frame_of(**scene())
    hit = frame_of(**scene(), candidates=named(0, 4))
    wrong = frame_of(**scene(), candidates=named(0, 4, 1))
    assert painted(no_candidate, drawing.HIT) == painted(no_candidate, drawing.REDUNDANT) == 0
    assert painted(hit, drawing.HIT) > 100
    assert painted(hit, drawing.REDUNDANT) == 0
    assert painted(wrong, drawing.REDUNDANT) > 50


def test_round_marks_and_no_links_of_a_large_swarm():
    values = scene()
    position, seen = values.pop("position"), values.pop("seen")
    place = drawing.last_seen_position(position, seen)
    np.testing.assert_array_equal(place[5], position[-2, 5])
    assert np.isnan(place[[3, 6]]).all()
    marks = drawing.round_marks(place, **values, candidates=named(0, 1, 3, 8), destroyed_at=np.ones((UAVS, 3)))
    who = {mark: np.flatnonzero(mask).tolist() for mark, mask in marks.items()}
    assert who == {
        drawing.HEAD_MARK: [0, 4],
        drawing.FOLLOWER_MARK: [1, 2, 5, 7],
        drawing.UNLED_MARK: [],
        drawing.LINK_MARK: [1, 2, 5, 7],
        drawing.DECOY_MARK: [8],
        drawing.HIT_MARK: [0],
        drawing.REDUNDANT_MARK: [1, 3, 8],
        drawing.MISSED_MARK: [4],
        drawing.DESTROYED_MARK: [3],
    }
    uavs, place = np.arange(301), np.zeros((301, 3), np.float32)
    for count, links in ((300, 299), (301, 0)):
        none = np.zeros(count, bool)
        marks = drawing.round_marks(place[:count], ~none, uavs[:count] == 0, 0 * uavs[:count], none)
        assert marks[drawing.LINK_MARK].sum() == links


def test_the_legend_explains_what_is_there_and_no_more():
    figure = drawing.draw_round(**scene(), candidates=named(0, 1), title="round 7")
    (axes,) = figure.axes
    texts = [text.get_text() for text in axes.get_legend().get_texts()]
    assert f"{drawing.HIT_MARK} (1)" in texts
    assert f"{drawing.MISSED_MARK} (1)" in texts
    assert not any(text.startswith(drawing.DESTROYED_MARK) for text in texts)
    assert axes.get_title(loc="left") == "round 7"
    assert drawing.draw_round(**scene(), legend=False).axes[0].get_legend() is None


def test_clusters_keep_their_colour_when_followers_change_sides():
    values = scene()
    colors = drawing.cluster_colors(values["head"], values["root"])
    later = drawing.cluster_colors(values["head"], np.where(values["root"] == 0, 4, values["root"]))
    assert later[1] == colors[4] == later[4]
    assert colors[0] != colors[4]
    numbered = drawing.cluster_colors(values["head"], values["root"], np.full(UAVS, 7))
    assert set(numbered) == {drawing.CLUSTER_COLORS[7]} | set(colors) & {drawing.NO_CLUSTER_COLOR}
    assert set(drawing.cluster_colors(values["head"], np.full(UAVS, -1))) == {drawing.NO_CLUSTER_COLOR}
    assert len(set(drawing.cluster_colors(np.ones(24, bool), np.arange(24)))) == 24


def test_lines_of_the_palest_clusters_have_a_contrast_of_three_on_white():
    values = scene()
    for number in range(len(drawing.CLUSTER_COLORS)):
        axes = drawing.draw_round(**values, number=np.full(UAVS, number), legend=False).axes[0]
        lines = [each.get_colors() for each in axes.collections if isinstance(each, collections.LineCollection)]
        colors = np.concatenate(lines)
        strong = colors[colors[:, 3] == 1, :3]  # where the tracks end
        linear = np.where(strong <= 0.04, strong / 12.92, ((strong + 0.055) / 1.055) ** 2.4)
        assert (1.05 / (linear @ (0.2126, 0.7152, 0.0722) + 0.05) >= 3).all()


def test_an_empty_window_can_be_drawn_and_a_notebook_shows_it():
    """After a terminated episode nothing is seen any more."""
    blank = scene(seen=np.zeros((30, UAVS), bool), position=np.zeros((30, UAVS, 3), np.float32))
    assert frame_of(**blank).shape == (720, 960, 3)
    assert drawing.draw_round(**blank)._repr_png_().startswith(b"\x89PNG")


def test_frames_keep_their_axes_and_mark_the_destroyed_of_earlier_rounds():
    values = scene()
    frames, shown = drawing.EpisodeFrames(), []
    for shift in (0, 30, 30, 900):
        moved = (values["position"] + np.float32(shift)) * values["seen"][..., None]
        frames.watch(moved, values["seen"])
        shown.append(frames.limits)
    assert shown[0] == shown[1] == shown[2]
    x, y, half = shown[3]
    place = drawing.last_seen_position(moved, values["seen"])
    assert np.nanmax(np.abs(place[:, :2] - (x, y))) < half  # only then they change, so that the swarm is in view

    early = scene(alive=np.ones(UAVS, bool), seen=np.ones((30, UAVS), bool))
    frames = drawing.EpisodeFrames()
    frames.watch(early["position"] + 1, early["seen"])
    frames.watch(values["position"], values["seen"])
    without = frame_of(**values, limits=frames.limits)
    assert painted(frames.render(**values), drawing.NO_CLUSTER_COLOR) > painted(without, drawing.NO_CLUSTER_COLOR) + 10


def test_the_title_of_a_frame_has_the_result_of_the_round(monkeypatch):
    titles = []
    monkeypatch.setattr(drawing, "draw_round", lambda *_, title, **__: titles.append(title))
    monkeypatch.setattr(drawing, "pixels_of", lambda figure: np.zeros((1, 1, 3), np.uint8))
    with gym.make("USNET/MultiCluster-v0", render_mode="rgb_array", clusters=3, uavs=20) as env:
        env.reset(seed=0)
        env.render()
        named = np.zeros(20, np.int8)
        named[np.flatnonzero(env.unwrapped.swarm.head)[0]] = named[np.flatnonzero(~env.unwrapped.swarm.head)[0]] = 1
        env.step(named)
        env.render()
    assert titles == ["round 1: observed, no answer yet", "round 1: 1 head hit, 1 redundant   J 1.050   reward -1.050"]


def test_nothing_global_is_touched(monkeypatch):
    """No pyplot, no change of rcParams or of the backend, no global random numbers drawn."""

    def world():
        return dict(matplotlib.rcParams.copy()), random.getstate(), str(np.random.get_state())  # noqa: NPY002

    monkeypatch.setitem(sys.modules, "matplotlib.pyplot", None)
    before = world()
    drawing.pixels_of(drawing.draw_round(**scene(), candidates=named(0)))
    assert world() == before


def test_figures_are_written_at_200_pixels_an_inch_or_as_pdf(tmp_path):
    from PIL import Image

    figure = drawing.new_figure(2, 1)
    files = [drawing.write_figure(figure, tmp_path / name) for name in ("figure.png", "figure.pdf")]
    assert files[1].read_bytes().startswith(b"%PDF")
    with Image.open(files[0]) as picture:
        assert picture.size == (400, 200)
    again = drawing.write_figure(figure, tmp_path / "again.png")
    assert again.read_bytes() == files[0].read_bytes()


@given(st.sets(st.text("ab1-", max_size=30)), st.text("ab1", max_size=15), st.integers(5, 20))
def test_different_names_stay_different(names, start, longest):
    full = [start + name + start for name in sorted(names)]
    short = drawing.abbreviate(full, longest)
    assert len(set(short)) == len(full)
    for one, other in zip(full, short, strict=True):
        assert len(one) > longest or one == other
