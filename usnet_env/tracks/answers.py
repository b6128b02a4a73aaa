"""Ask a detector for a window of tracks, at the chosen step and at shorter ones."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from usnet_env.detection import Detection, ask
from usnet_env.plugins import DetectorLike
from usnet_env.tracks.tracks import Tracks, TrackWindow


class Answer(NamedTuple):
    """A detector's answer to a window, and the window with the shortest step that it was asked for."""

    detection: Detection
    shortest_step_window: TrackWindow


def answer_window(player: DetectorLike, resampled: Tracks, track_window: TrackWindow, seed: int) -> Answer:
    """Ask a detector for a window.

    If it tells the probability that nobody leads, it is also asked at :attr:`Tracks.other_steps`. A step that doesn't
    show who follows hides a leader, so only those count at which somebody probably leads. Of their answers, the one
    that names most nearly what all of them name is returned, or of several the one that is surest that somebody leads.
    """

    def answer(each: TrackWindow) -> Detection:
        player.reset(seed)
        return ask(player, each.window)[0]

    def tell_silence(each: Detection) -> float:
        return float(each.extras.get("silent", 0.0))

    track_windows, answers = [track_window], [answer(track_window)]
    if "silent" in answers[0].extras:
        others = (other.cut_like(track_window) for other in resampled.other_steps)
        track_windows += filter(None, others)
        answers += map(answer, track_windows[1:])
    answers.sort(key=tell_silence)
    answers = [each for each in answers if tell_silence(each) < 0.5] or answers[:1]
    usual = np.mean([each.candidates for each in answers], axis=0)
    detection = min(answers, key=lambda each: round(float(np.abs(each.candidates - usual).sum()), 6))
    return Answer(detection, min(track_windows, key=lambda each: each.step))
