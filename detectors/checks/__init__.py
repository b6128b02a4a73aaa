"""Conformance checks: does a detector follow the rules of :class:`detectors.Detector`?

``check_detector(detector)`` runs the eight checks, ``@parametrize_with_checks([detector])`` makes one pytest case of
each check, and ``usnet check-detector module:Class`` prints the results as a table. They correspond to scikit-learn's
``check_estimator``.
"""

from detectors.checks.contract import CHECKS, CheckError
from detectors.checks.run import (
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
