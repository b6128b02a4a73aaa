"""Say what may be the reason where no leader is found, and which windows were read."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np

from usnet_env.config import format_count, format_seconds
from usnet_env.detection import Detection
from usnet_env.tracks.confirm import LEAST_STEPS
from usnet_env.tracks.found import CONFOUNDS, DetectedWindow
from usnet_env.tracks.resample import LAGS
from usnet_env.tracks.tracks import TrackWindow

_MAX_NAMES = 3


def describe_windows(track_windows: Sequence[TrackWindow]) -> str:
    """How many windows were read, and how long they are."""
    steps = [each.window.observation_steps for each in track_windows]
    halves = sum(count < max(steps) for count in steps)
    length = f"{format_count(max(steps), 'step')} ({format_seconds(max(steps) * track_windows[0].step)})"
    split = f", of which {halves} are parts of one" * bool(halves)
    return f"{format_count(len(steps), 'window')} of {length} read{split}."


def explain_silence(
    windows: Sequence[DetectedWindow], track_windows: Sequence[TrackWindow], answers: Sequence[Detection]
) -> list[str]:
    """Sentences about the windows without a leader, if they are half of all: what ids do, and why none may be found.

    Tracks can't tell that no id leads, so each reason that fits is named, and the id with the largest probability.
    """
    leaderless = [k for k, window in enumerate(windows) if not window.leaders]
    sentences, of_all = [], f"of {format_count(len(windows), 'window')}"
    if 2 * len(leaderless) < len(windows):
        return []
    for kind, words in CONFOUNDS.items():
        counts = [len(windows[k].alike) for k in leaderless if windows[k].confound == kind]
        if 2 * len(counts) >= len(windows):
            ids = format_count(round(np.mean(counts)), "id")
            sentences.append(f"In {len(counts)} {of_all} no leader is found, and {ids} {words}.")
    if not track_windows:
        return sentences
    reasons = []
    if any(windows[k].confound == "one signal" for k in leaderless):
        longest = format_seconds(LAGS * track_windows[0].step)
        reasons += ["the leader changes within a window", "followers mirror it", f"delays are longer than {longest}"]
    left_out = Counter(name for k in leaderless for name in windows[k].left_out).most_common(_MAX_NAMES)
    if left_out:
        names = ", ".join(str(name) for name, _ in left_out)
        reasons.append(f"an id leads that is left out, as it is seen too little ({names})")
    if (steps := min(track_windows[k].window.observation_steps for k in leaderless)) < 2 * LEAST_STEPS:
        reasons.append(f"windows of {format_count(steps, 'step')} are short (--window)")
    if reasons:
        sentences.append(f"A leader may be missed because {', or '.join(reasons)}.")
    sums: Counter[str | int] = Counter()
    for k in leaderless:
        if "probability" in answers[k].extras:
            sums.update(dict(zip(track_windows[k].ids, map(float, answers[k].extras["probability"]), strict=True)))
    for name, total in sums.most_common(1):
        sentences.append(f"The nearest candidate is {name}, p {total / len(leaderless):.2f}, not confirmed.")
    return sentences
