"""Conformance checks: does a detector follow the rules of :class:`detectors.Detector`?

``check_detector(detector)`` runs all checks, ``@parametrize_with_checks([detector])`` makes one pytest case of each
check, and ``usnet check-detector module:Class`` prints the results as a table. They correspond to scikit-learn's
``check_estimator``.
"""

from detectors.checks.harness import CheckError
from detectors.checks.run import (
    CHECKS,
    CheckResult,
    DetectorChecksError,
    check_detector,
    exit_status,
    parametrize_with_checks,
    results_table,
)

__all__ = [
    "CHECKS",
    "CheckError",
    "CheckResult",
    "DetectorChecksError",
    "check_detector",
    "exit_status",
    "parametrize_with_checks",
    "results_table",
]
