"""Conformance checks: does a detector of one's own keep the contract that every user of detectors relies on?

``check_detector(detector)`` runs them all, ``@parametrize_with_checks([detector])`` makes one pytest case of each, and
``usnet check-detector module:Class`` prints them as a table. They are to detectors what scikit-learn's
``check_estimator`` is to estimators.
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
