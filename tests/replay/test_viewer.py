"""Pictures of recordings, taken by a real viewer without a screen."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from small_episode import ROUNDS, SAMPLES, small_episode

from usnet_env import ArgumentError
from usnet_env.replay import write_recording
from usnet_env.replay.viewer import find_time, take_screenshot

pytest.importorskip("rerun")


def test_a_step_of_a_round_has_its_time():
    episode = small_episode()  # two steps between samples
    assert find_time(episode, 1, 0) == 0.0
    assert find_time(episode, 1, 2 * (SAMPLES - 1)) == find_time(episode, 1, 2 * (SAMPLES - 1) - 1) + 6.0 / (
        SAMPLES - 1
    )
    assert find_time(episode, 1) > find_time(episode, 1, 2 * (SAMPLES - 1))
    assert find_time(episode, 2, 0) > find_time(episode, 1)
    with pytest.raises(ArgumentError, match=rf"^round must be .* from 1 to {ROUNDS}, got 3"):
        find_time(episode, 3)
    with pytest.raises(ArgumentError, match=r"^step must be a whole number from 0 to 40, got 41"):
        find_time(episode, 1, 41)


@pytest.mark.slow
def test_pictures_of_two_rounds_differ_and_are_not_blank(tmp_path):
    image = pytest.importorskip("PIL.Image")
    path = write_recording(small_episode(), tmp_path / "e.rrd")
    pixels = []
    for number in (1, 2):
        try:
            picture = take_screenshot([path], tmp_path / f"{number}.png", find_time(small_episode(), number))
        except ArgumentError as error:
            pytest.skip(str(error))
        pixels.append(np.asarray(image.open(picture).convert("RGB")).astype(int))
    commands = [path.read_bytes() for path in Path("/proc").glob("[0-9]*/cmdline")]
    assert not any(str(path).encode() in words for words in commands)  # no viewer is left
    height, width = pixels[0].shape[:2]
    for frame in pixels:
        swarm = frame[height // 20 : height // 2, : width // 3]
        assert len(np.unique(swarm.reshape(-1, 3), axis=0)) > 50
        blue = (np.abs(swarm - [0x35, 0xA7, 0xFF]).max(axis=-1) < 30).sum()  # the rings around candidates
        assert blue > 20
    assert (np.abs(pixels[0] - pixels[1]).max(axis=-1) > 30).mean() > 0.01
