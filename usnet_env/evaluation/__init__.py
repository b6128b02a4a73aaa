"""The evaluator: it plays all detectors against the same swarms and reports each metric with a 95 % interval."""

from usnet_env.evaluation.errors import EvaluationError
from usnet_env.evaluation.metrics import METRICS
from usnet_env.evaluation.result import EvaluationResult
from usnet_env.evaluation.runner import TRIVIAL, evaluate

__all__ = ["METRICS", "TRIVIAL", "EvaluationError", "EvaluationResult", "evaluate"]
