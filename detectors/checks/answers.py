"""Checks of the detections: every swarm gets one, and no destroyed UAV is a candidate."""

from __future__ import annotations

from typing import Any
from unittest import SkipTest

import numpy as np

from detectors.checks.harness import (
    SEED,
    calling,
    copy_detector,
    play_batch,
    play_windows,
    request_detection,
    require,
    validate_detection,
)
from detectors.checks.windows import draw_two_rounds, draw_window, make_hovering_window, simulate_missing_samples
from usnet_env.config import quote
from usnet_env.window import Window

SMALLEST, LARGE = 3, 237  # N
LARGE_STEPS = 20  # T_ob for the large swarm: memory and time that grow with N show in a short window, too


def check_answers_with_a_detection(detector: Any) -> None:
    """``detect`` returns a ``Detection`` for all N UAVs after ``reset(seed)``, ``reset(None)`` and ``reset()``."""
    own, window = copy_detector(detector), draw_window(detector)
    play_windows(own, draw_two_rounds(detector))
    play_windows(own, [window], seed=None)
    with calling("reset"):
        own.reset()
    request_detection(own, window)


def check_smallest_swarm(detector: Any) -> None:
    """``detect`` works for N = 3: a head and two followers."""
    play_windows(copy_detector(detector), [draw_window(detector, clusters=1, uavs=SMALLEST)])


def check_large_swarm(detector: Any) -> None:
    """``detect`` works for N = 237 in 11 clusters of unequal size."""
    window = draw_window(detector, clusters=11, uavs=LARGE, observation_steps=LARGE_STEPS)
    play_windows(copy_detector(detector), [window])


def check_single_cluster(detector: Any) -> None:
    """``detect`` works for M = 1, also if the detector was constructed for another M."""
    play_windows(copy_detector(detector), [draw_window(detector, clusters=1, uavs=16)])


def check_masked_uavs_are_never_candidates(detector: Any) -> None:
    """A destroyed UAV is never a candidate, whether a few or nearly all UAVs are destroyed."""
    for destroyed in (4, 17):
        window = draw_window(detector, uavs=20, destroyed=destroyed, round=2)
        for seed in (SEED, SEED + 1, SEED + 2):
            _require_living_candidates(detector, window, seed)


def _require_living_candidates(detector: Any, window: Window, seed: int) -> None:
    (answer,) = play_windows(copy_detector(detector), [window], seed)
    dead = np.flatnonzero(answer.candidates & ~window.alive)
    require(not len(dead), f"a destroyed UAV must not be a candidate, got UAVs {quote(dead.tolist())}.")


def check_missing_samples(detector: Any) -> None:
    """``detect`` works where samples are missing: 30 %, all of one UAV, and all UAVs at some steps."""
    _require_living_candidates(detector, simulate_missing_samples(detector), SEED)


def check_scores_are_finite(detector: Any) -> None:
    """Scores are finite, and ``extras["probability"]`` lies in [0, 1], for moving and for hovering UAVs."""
    for window in (draw_window(detector), make_hovering_window(detector), simulate_missing_samples(detector, seed=1)):
        (answer,) = play_windows(copy_detector(detector), [window])
        require(bool(np.isfinite(answer.scores).all()), "scores must be finite, got NaN or infinity.")
        if (probability := answer.extras.get("probability")) is not None:
            value = np.asarray(probability)
            require(
                value.shape == (window.uavs,) and bool(((value >= 0) & (value <= 1)).all()),
                f"extras['probability'] must hold {window.uavs} numbers from 0 to 1, got {quote(value)}.",
            )


def check_batch(detector: Any) -> None:
    """``detect_batch`` returns one detection per window, in order, and leaves the list of windows unchanged."""
    own = copy_detector(detector)
    if not callable(getattr(own, "detect_batch", None)):
        raise SkipTest("it has no method detect_batch.")
    windows = [draw_window(detector, uavs=uavs, seed=uavs) for uavs in (14, 11, 14, 9)]
    given = list(windows)
    batch = play_batch(own, given)
    require(isinstance(batch, list), f"detect_batch must return a list, got {quote(batch)}.")
    require(len(batch) == len(windows), f"detect_batch must return {len(windows)} detections, got {len(batch)}.")
    for answer, window in zip(batch, windows, strict=True):
        validate_detection(answer, window)
    unchanged = len(given) == len(windows) and all(a is b for a, b in zip(given, windows, strict=True))
    require(unchanged, "detect_batch must leave the list of windows unchanged.")
