"""The evaluator: it plays all detectors against the same swarms and reports each metric with a 95 % interval."""

from usnet_env.evaluation.play import METRICS
from usnet_env.evaluation.published import results
from usnet_env.evaluation.result import Comparison, EvaluationResult
from usnet_env.evaluation.run import TRIVIAL, evaluate, evaluate_suite
from usnet_env.evaluation.suites import Cell, Suite, list_suites, load_suite
from usnet_env.evaluation.tasks import EvaluationError

__all__ = ["evaluate", "evaluate_suite", "list_suites", "load_suite", "results"]
__all__ += ["METRICS", "TRIVIAL", "Cell", "Comparison", "EvaluationError", "EvaluationResult", "Suite"]
