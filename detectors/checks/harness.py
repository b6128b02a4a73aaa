"""What the checks share: copying a detector, calling it on windows, and comparing detections."""

from __future__ import annotations

import copy
import os
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
from sklearn.base import clone

from usnet_env.config import quote
from usnet_env.detection import Detection
from usnet_env.processes import limited
from usnet_env.window import Window

SEED = 5  # for the detectors' generators


class CheckError(AssertionError):
    """A detector failed a check; the message is one sentence."""


class CheckWarning(UserWarning):
    """A detector passes a check, but does something that its author should know; the message is one sentence."""


def warn(sentence: str) -> None:
    """Issue a :class:`CheckWarning`; the result of the check that runs reports it."""
    warnings.warn(sentence, CheckWarning, stacklevel=3)


@contextmanager
def calling(what: str) -> Iterator[None]:
    """Mark a call of the detector's own code, named ``what``: in a child process the limits apply to it."""
    process = os.getpid()
    try:
        with limited(what):
            yield
    finally:
        if os.getpid() != process:  # a copy of the process, made by os.fork, must not run the checks as well
            os._exit(1)


def require(holds: bool, sentence: str) -> None:
    """Raise :class:`CheckError` with ``sentence`` unless ``holds`` is true."""
    if not holds:
        raise CheckError(sentence)


def copy_detector(detector: Any) -> Any:
    """Copy the detector and its fitted attributes, so that no check affects another.

    ``deepcopy`` keeps what ``fit`` has learned; ``clone`` does not, and serves only where ``deepcopy`` fails.
    """
    try:
        with calling("its copy"):
            return copy.deepcopy(detector)
    except Exception as error:  # an attribute may refuse to be copied with any exception
        try:
            with calling("its clone"):
                return clone(detector)
        except Exception:
            raise CheckError(f"copy.deepcopy must copy the detector, got {type(error).__name__}: {error}") from error


def request_detection(detector: Any, window: Window) -> Detection:
    """Call ``detect`` and check that the result covers all N UAVs of the window."""
    with calling("detect"):
        answer = detector.detect(window)
    return validate_detection(answer, window)


def validate_detection(answer: Any, window: Window) -> Detection:
    """Return ``answer`` if it is a detection for all N UAVs of the window; raise :class:`CheckError` otherwise."""
    require(isinstance(answer, Detection), f"detect must return a usnet_env.Detection, got {quote(answer)}.")
    named = len(answer.candidates)
    require(named == window.uavs, f"detect must return candidates for all {window.uavs} UAVs, got {named}.")
    return answer


def play_windows(detector: Any, windows: Sequence[Window], seed: int | None = SEED) -> list[Detection]:
    """Play an episode: call ``reset(seed)``, then ``detect`` on each window in order."""
    with calling("reset"):
        detector.reset(seed)
    return [request_detection(detector, window) for window in windows]


def play_batch(detector: Any, windows: list[Window]) -> Any:
    """Call ``reset``, then ``detect_batch`` on the windows; the answer is not checked."""
    with calling("reset"):
        detector.reset(SEED)
    with calling("detect_batch"):
        return detector.detect_batch(windows)


def require_same(one: Detection, other: Detection, sentence: str) -> None:
    """Raise :class:`CheckError` unless two detections are bitwise equal; the names of fields end the sentence."""
    fields = ("candidates", "scores", "clusters", "leader", "attention")
    different = [
        name for name in fields if not np.array_equal(np.array(getattr(one, name)), np.array(getattr(other, name)))
    ]
    require(not different, f"{sentence} {', '.join(different)}.")
