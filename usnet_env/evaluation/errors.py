"""The error of an evaluation whose arguments were correct."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from usnet_env.evaluation.result import EvaluationResult


class EvaluationError(RuntimeError):
    """A detector failed during an evaluation; the message names the detector, the episode and the cause.

    Attributes:
        result: the result of the detectors that did not fail; ``None`` if there is none.
        failures: the message of each detector that failed, by its label.
    """

    result: EvaluationResult | None = None
    failures: Mapping[str, str] = MappingProxyType({})
