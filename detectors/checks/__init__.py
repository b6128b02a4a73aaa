"""Conformance checks: does a detector follow the rules of :class:`detectors.Detector`?"""

from detectors.checks.contract import CHECKS, CheckError
from detectors.checks.run import (
    CheckResult,
    DetectorChecksError,
    check_detector,
    parametrize_with_checks,
    results_table,
)

__all__ = ["check_detector", "parametrize_with_checks", "results_table"]
__all__ += ["CHECKS", "CheckError", "CheckResult", "DetectorChecksError"]
