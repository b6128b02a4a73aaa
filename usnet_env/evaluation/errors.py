"""The error of an evaluation whose arguments were correct."""

from __future__ import annotations

__all__ = ["EvaluationError"]


class EvaluationError(RuntimeError):
    """A detector failed during an evaluation; the message names the detector, the episode and the cause."""
