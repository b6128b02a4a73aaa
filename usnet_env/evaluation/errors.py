"""The error of an evaluation whose arguments were correct."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from usnet_env.evaluation.result import EvaluationResult


class EvaluationError(RuntimeError):
    """A detector failed during an evaluation; the message names the detector, the episode and the cause.

    Attributes:
        result: the result of the detectors that did not fail; ``None`` if there is none.
    """

    result: EvaluationResult | None = None
