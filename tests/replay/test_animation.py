"""The animation of a game: what its scenes say, what its frames show, and what is refused."""

from __future__ import annotations

import sys

import numpy as np
import pytest
from small_episode import MIND, ROUNDS, SAMPLES, UAVS, small_episode

from usnet_env import ArgumentError
from usnet_env.replay import animation
from usnet_env.replay.animation import animate, scenes

pytest.importorskip("matplotlib")
Image = pytest.importorskip("PIL.Image")

FRAMES = 3
REDUNDANT = np.array([0xD5, 0x5E, 0x00])
HIT = np.array([0x00, 0x9E, 0x73])


def frames_of(path):
    with Image.open(path) as image:
        shown = []
        for number in range(image.n_frames):
            image.seek(number)
            shown.append((np.asarray(image.convert("RGB")).astype(int), image.info["duration"]))
    return shown


def pixels_near(frame, color):
    return int((np.abs(frame - color).max(axis=-1) < 24).sum())


def halves(frame):
    """The map of the detector and the map of the truth, without header and key."""
    height, width = frame.shape[:2]
    maps = frame[height // 6 : -height // 8]
    return maps[:, : width // 2], maps[:, width // 2 :]


@pytest.fixture(scope="module")
def game(tmp_path_factory):
    return animate(small_episode(), tmp_path_factory.mktemp("animation") / "game.gif", frames=FRAMES)


@pytest.fixture(scope="module")
def frames(game):
    return frames_of(game)


def test_scenes_tell_the_game_in_order():
    told = list(scenes(small_episode(), FRAMES))
    assert [scene.phase for scene in told if scene.round == 1] == [0, 0, 0, 1, 2, 3, 3, 3, 3, 3]
    assert [scene.phase for scene in told if scene.round == ROUNDS] == [0, 0, 0, 1, 2, 4]
    assert [scene.samples for scene in told[:FRAMES]] == [1, 11, SAMPLES]


def test_scenes_count_what_happened_so_far():
    told = {(scene.round, scene.phase): scene for scene in scenes(small_episode(), FRAMES)}
    assert " ".join(told[1, 0].score.split()) == "hits 0 of 2 redundant 0 J –"
    assert told[1, 1].score == told[1, 0].score  # the verdict is not shown before the UAVs are destroyed
    assert " ".join(told[1, 2].score.split()) == "hits 1 of 2 redundant 1 J 1.08"
    assert " ".join(told[2, 4].score.split()) == "hits 2 of 2 redundant 1 J 2.08"
    assert told[1, 1].text == "It names 2 UAVs as heads."
    assert told[1, 2].text == "1 is a head (hit), 1 is not (redundant). All 2 are destroyed."
    assert told[1, 3].text == "3 followers without a head join the nearest remaining head."
    assert told[2, 2].text == "1 is a head (hit). It is destroyed."
    assert told[2, 4].text == "All heads are destroyed after 2 rounds: J = 2.08 (1 is best)."


def test_scenes_of_a_round_over_the_shot_budget():
    over = small_episode(over_budget=[True, False], alive=np.ones((ROUNDS, UAVS), bool))
    told = {(scene.round, scene.phase): scene for scene in scenes(over, FRAMES)}
    assert told[1, 2].text == "2 candidates exceed the shot budget: no UAV is destroyed."
    assert (1, 3) not in told  # no follower has lost its head
    assert told[2, 4].text == "1 head not found after 2 rounds: J = 2.08 (1 is best)."


def test_a_frame_for_each_scene_with_its_duration(frames):
    told = list(scenes(small_episode(), FRAMES))
    assert len(frames) == len(told)
    assert [duration for _, duration in frames] == [round(1000 * scene.seconds) for scene in told]


def test_the_detector_is_not_shown_the_truth(frames):
    """Until the verdict, both maps have no green and no orange; afterwards only the map of the truth has."""
    for (frame, _), scene in zip(frames, scenes(small_episode(), FRAMES), strict=True):
        observed, truth = halves(frame)
        assert pixels_near(observed, REDUNDANT) == pixels_near(observed, HIT) == 0
        if scene.round == 1:
            assert (pixels_near(truth, REDUNDANT) > 20) == (scene.phase == 2)
            assert (pixels_near(truth, HIT) > 20) == (scene.phase == 2)


def test_tracks_grow(frames):
    def ink(frame):
        return sum(int((half.sum(axis=-1) < 700).sum()) for half in halves(frame))

    first, second, third = (ink(frame) for frame, _ in frames[:FRAMES])
    assert first < second < third


@pytest.mark.slow
def test_the_same_record_gives_the_same_file(game, tmp_path):
    assert animate(small_episode(), tmp_path / "again.gif", frames=FRAMES).read_bytes() == game.read_bytes()


def test_a_uav_that_was_never_seen_and_a_single_round(tmp_path):
    small = small_episode()
    seen = small.seen.copy()
    seen[:, :, 2] = False
    values = {name: getattr(small, name)[:1] for name in ("position", "velocity", "alive", "root", "candidates")}
    values |= {name: getattr(small, name)[:1] for name in ("scores", "objective", "over_budget", "seconds")}
    values |= {name: getattr(small, name)[:1] for name in MIND}
    path = animate(small_episode(**values, seen=seen[:1]), tmp_path / "one.gif", frames=2)
    assert len(frames_of(path)) == 5


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"path": "game.png"}, "path must end in .gif or .mp4, got 'game.png'"),
        ({"path": 5}, "path must be"),
        ({"record": "game.npz", "path": "game.gif"}, "record must be an EpisodeRecord, got 'game.npz'"),
        ({"path": "game.gif", "frames": 1}, "frames must be a whole number from 2, got 1"),
        ({"path": "game.gif", "frames": 2.5}, "frames must be a whole number from 2, got 2.5"),
    ],
)
def test_bad_arguments_are_refused_before_anything_is_written(tmp_path, monkeypatch, arguments, message):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ArgumentError, match=message):
        animate(**{"record": small_episode()} | arguments)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("rate", [1, pytest.param(animation._MP4_RATE, marks=pytest.mark.slow)])
def test_an_mp4_is_written(tmp_path, monkeypatch, rate):
    pytest.importorskip("imageio_ffmpeg")  # of the extra render, which brings ffmpeg
    monkeypatch.setattr(animation, "_MP4_RATE", rate)  # frames of a second, each of which is drawn
    assert animate(small_episode(), tmp_path / "game.mp4", frames=2).stat().st_size > 1000


def test_an_mp4_without_ffmpeg_says_what_is_missing(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    monkeypatch.setenv("PATH", str(tmp_path))
    path = tmp_path / "game.mp4"
    with pytest.raises(ArgumentError, match="ffmpeg is not installed"):
        animate(small_episode(), path, frames=2)
    assert not path.exists()
