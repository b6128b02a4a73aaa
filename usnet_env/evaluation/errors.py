"""The error of an evaluation whose arguments were correct."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING

from usnet_env.config import ArgumentError

if TYPE_CHECKING:
    from usnet_env.evaluation.result import EvaluationResult


class UnknownLabelError(ArgumentError, KeyError):
    """A result has no detector with this label; an error of an argument, and one of a mapping's key."""

    __str__ = Exception.__str__  # a KeyError quotes its text


class EvaluationError(RuntimeError):
    """A detector failed during an evaluation; the message names the detector, the episode and the cause.

    Attributes:
        result: the result of the detectors that did not fail; ``None`` if there is none.
        failures: the message of each detector that failed, by its label.
        started: whether all processes could start; otherwise no detector is to blame.
    """

    result: EvaluationResult | None = None
    failures: Mapping[str, str] = MappingProxyType({})
    started: bool = True


def not_started(error: Exception, hint: bool = True) -> EvaluationError:
    """The error of a process that did not start.

    Args:
        error: why.
        hint: name the most frequent reason, a script that has no guard.
    """
    guard = (
        " A worker process imports the script that started it, so a script must start a run, a suite or a training in "
        'a block that begins with `if __name__ == "__main__":`.'
    )
    found = EvaluationError(f"{error}.{guard if hint else ''}")
    found.started = False
    return found
