"""The evaluator: it plays all detectors against the same swarms and reports each metric with a 95 % interval."""

from usnet_env.evaluation.errors import EvaluationError
from usnet_env.evaluation.frozen_suites import FrozenSuite, SuiteResult, evaluate_suite, list_suites, load_suite
from usnet_env.evaluation.games import evaluate_games
from usnet_env.evaluation.metrics import METRICS
from usnet_env.evaluation.result import Comparison, EvaluationResult, interquartile_means, performance_profiles
from usnet_env.evaluation.runner import TRIVIAL, evaluate

__all__ = [
    "METRICS",
    "TRIVIAL",
    "Comparison",
    "EvaluationError",
    "EvaluationResult",
    "FrozenSuite",
    "SuiteResult",
    "evaluate",
    "evaluate_games",
    "evaluate_suite",
    "interquartile_means",
    "list_suites",
    "load_suite",
    "performance_profiles",
]
