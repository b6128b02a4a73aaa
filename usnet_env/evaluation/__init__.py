"""The referee: detectors meet the same swarms, and every number stands with its interval."""

from usnet_env.evaluation.errors import EvaluationError
from usnet_env.evaluation.metrics import METRICS
from usnet_env.evaluation.result import EvaluationResult
from usnet_env.evaluation.runner import TRIVIAL, evaluate

__all__ = ["METRICS", "TRIVIAL", "EvaluationError", "EvaluationResult", "evaluate"]
