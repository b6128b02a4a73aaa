"""The error of an evaluation whose arguments were correct."""

from __future__ import annotations

import traceback
from pathlib import Path
from sysconfig import get_paths

from usnet_env.config import ArgumentError

LONGEST_REASON = 300  # characters of a reason in a row, and of a sentence that is printed

_PACKAGE = str(Path(__file__).parents[1])
_INSTALLED = ("site-packages", "dist-packages", get_paths()["stdlib"])


class EvaluationError(RuntimeError):
    """A detector failed in an episode that was played alone, or a run could not go on.

    Args:
        sentence: what happened, as one sentence.
        reason: where the detector failed and why, as a row keeps it: ``"round 2: ZeroDivisionError: …"``.
    """

    def __init__(self, sentence: str, reason: str = "") -> None:
        super().__init__(sentence, reason)
        self.reason = reason

    def __str__(self) -> str:
        return str(self.args[0])


class ChildError(RuntimeError):
    """What ended an answer in a child process, as one sentence that names the cause and the line of code."""


def describe_failure(error: BaseException) -> str:
    """What a detector raised, and the line of its code: ``ZeroDivisionError: no luck (mine.py, line 3, in detect)``."""
    text = " ".join(str(error).split()).rstrip(".")
    if isinstance(error, ChildError):
        return text
    cause = text if isinstance(error, ArgumentError) else f"{type(error).__name__}: {text}".rstrip(": ")
    place = _find_place(error)
    room = LONGEST_REASON - len(place) - 40  # which leaves room for the round and the brackets
    return f"{cause if len(cause) <= room else cause[:room] + '…'}{f' ({place})' if place else ''}"


def _find_place(error: BaseException) -> str:
    """File, line and function of the last line outside this package and its libraries; empty if there is none."""
    frames = [
        frame
        for frame in traceback.extract_tb(error.__traceback__)
        if not frame.filename.startswith((_PACKAGE, "<")) and not any(part in frame.filename for part in _INSTALLED)
    ]
    return f"{Path(frames[-1].filename).name}, line {frames[-1].lineno}, in {frames[-1].name}" if frames else ""
