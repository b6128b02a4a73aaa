"""How the checks treat a detector: each works with a copy of its own, asks it for detections and compares them."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from typing import Any

import numpy as np
from sklearn.base import clone

from usnet_env.config import quote
from usnet_env.detection import Detection
from usnet_env.window import Window

__all__ = ["CheckError", "compare_detections", "copy_detector", "play_windows", "request_detection", "require"]

SEED = 5  # of the detectors' own generators


class CheckError(AssertionError):
    """A detector did not pass a check; the message is one sentence."""


def require(holds: bool, sentence: str) -> None:
    """Raise :class:`CheckError` with that sentence unless it holds."""
    if not holds:
        raise CheckError(sentence)


def copy_detector(detector: Any) -> Any:
    """A copy of the detector, with what it has been fitted to, for one check alone.

    ``deepcopy``, as ``clone`` forgets what ``fit`` has learned. ``clone`` where a copy is impossible.
    """
    try:
        return copy.deepcopy(detector)
    except Exception as error:  # a stranger's attribute may refuse to be copied in any way
        try:
            return clone(detector)
        except Exception:
            raise CheckError(f"copy.deepcopy must copy the detector, got {type(error).__name__}: {error}") from error


def request_detection(detector: Any, window: Window) -> Detection:
    """One answer, for all N UAVs of the window."""
    return validate_detection(detector.detect(window), window)


def validate_detection(answer: Any, window: Window) -> Detection:
    """``answer`` if it is a detection for all N UAVs of the window."""
    if not isinstance(answer, Detection):
        raise CheckError(f"detect must return a usnet_env.Detection, got {quote(answer)}.")
    named = len(answer.candidates)
    require(named == window.uavs, f"detect must answer for all {window.uavs} UAVs, got candidates for {named}.")
    return answer


def play_windows(detector: Any, windows: Sequence[Window], seed: int | None = SEED) -> list[Detection]:
    """An episode: ``reset(seed)``, then the answers to the windows in turn."""
    detector.reset(seed)
    return [request_detection(detector, window) for window in windows]


def compare_detections(one: Detection, other: Detection) -> str:
    """Names of the fields in which two detections differ, by bits; an empty text where none does."""
    fields = ("candidates", "scores", "clusters", "leader", "attention")
    pairs = [(name, getattr(one, name), getattr(other, name)) for name in fields]
    return ", ".join(
        name
        for name, this, that in pairs
        if (this is None) != (that is None) or (this is not None and not np.array_equal(this, that))
    )
