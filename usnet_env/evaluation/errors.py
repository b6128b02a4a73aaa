"""What goes wrong in an evaluation through no fault of its arguments."""

from __future__ import annotations

__all__ = ["EvaluationError"]


class EvaluationError(RuntimeError):
    """A detector failed in the middle of an evaluation; one sentence names it, the episode and the cause."""
