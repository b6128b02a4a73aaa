"""Conformance checks: does a detector follow the rules of :class:`detectors.Detector`?

``check_detector(detector)`` runs all checks, ``@parametrize_with_checks([detector])`` makes one pytest case of each
check, and ``usnet check-detector module:Class`` prints the results as a table. They correspond to scikit-learn's
``check_estimator``.
"""

from detectors.checks.harness import CheckError, CheckWarning
from detectors.checks.results import CheckResult, DetectorChecksError, exit_status, results_table
from detectors.checks.run import CHECKS, check_detector, check_factory, parametrize_with_checks

__all__ = [
    "CHECKS",
    "CheckError",
    "CheckResult",
    "CheckWarning",
    "DetectorChecksError",
    "check_detector",
    "check_factory",
    "exit_status",
    "parametrize_with_checks",
    "results_table",
]
