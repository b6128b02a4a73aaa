"""Runs the checks: as a list of results, as a table, or as pytest cases."""

from __future__ import annotations

import time
import traceback
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, NamedTuple
from unittest import SkipTest

from detectors.checks.contract import CHECKS, CheckError
from usnet_env.config import unknown_name
from usnet_env.plugins import find_detector


class CheckResult(NamedTuple):
    """The result of one check; its status is ``"passed"``, ``"failed"``, ``"expected failure"`` or ``"skipped"``."""

    check: str
    status: str
    reason: str  #: empty if it passed
    seconds: float
    error: BaseException | None = None


class DetectorChecksError(AssertionError):
    """A detector failed at least one check; ``results`` holds the results of all checks."""

    def __init__(self, detector: Any, results: Sequence[CheckResult]) -> None:
        self.results = list(results)
        failed = [f"\n  {result.check}: {result.reason}" for result in results if result.status == "failed"]
        super().__init__(f"{type(detector).__name__} fails {len(failed)} of {len(results)} checks:{''.join(failed)}")


def check_detector(detector: Any, *, expected_failed_checks: Mapping[str, str] | None = None) -> list[CheckResult]:
    """Run all conformance checks on copies of a detector; one result per check, in the order of :data:`CHECKS`.

    Args:
        detector: an object with ``detect`` and ``reset``, or a name as :func:`usnet_env.make_detector` takes it.
        expected_failed_checks: names of checks that this detector can't pass, each with the reason.

    Raises:
        DetectorChecksError: a check failed unexpectedly. It is raised after all checks have run.
        ArgumentError: not a detector, or an unknown check.

    Example:
        >>> {result.status for result in check_detector("random")}
        {'passed'}
    """
    detector, excuses = find_detector(detector), _check_names(expected_failed_checks or {})
    results = [_run_check(check, detector, excuses) for check in CHECKS]
    if any(result.status == "failed" for result in results):
        raise DetectorChecksError(detector, results)
    return results


def _check_names(excuses: Mapping[str, str]) -> Mapping[str, str]:
    known = [check.__name__ for check in CHECKS]
    for name in set(excuses) - set(known):
        raise unknown_name("expected_failed_checks", name, known)
    return excuses


def _run_check(check: Callable[[Any], None], detector: Any, excuses: Mapping[str, str]) -> CheckResult:
    begin, name = time.perf_counter(), check.__name__
    status, reason, error = "passed", "", None
    try:
        check(detector)
    except SkipTest as skip:
        status, reason = "skipped", str(skip)
    except (Exception, SystemExit) as failure:
        status, reason, error = "failed", _describe(failure), failure
        if name in excuses:
            status, reason = "expected failure", f"{excuses[name]} ({reason})"
    return CheckResult(name, status, reason, time.perf_counter() - begin, error)


def _describe(failure: BaseException) -> str:
    """A failure on one line: the sentence of a check, or the exception and where the detector raised it."""
    if isinstance(failure, CheckError):
        return str(failure)
    frames = traceback.extract_tb(failure.__traceback__)
    frame = [frame for frame in frames if "site-packages" not in frame.filename][-1]
    return f"{type(failure).__name__}: {' '.join(str(failure).split())[:200]} ({frame.filename}, line {frame.lineno})"


def parametrize_with_checks(
    detectors: Iterable[Any], *, expected_failed_checks: Callable[[Any], Mapping[str, str] | None] = lambda _: None
) -> Any:
    """Make a pytest decorator with one case per detector and check, for a function that calls ``check(detector)``.

    Args:
        detectors: as of :func:`check_detector`.
        expected_failed_checks: function of a detector, which returns the names of the checks that it can't pass, each
            with the reason; these cases are marked ``xfail``.
    """
    import pytest  # only here

    cases = []
    for detector in map(find_detector, detectors):
        excuses = _check_names(expected_failed_checks(detector) or {})
        for check in CHECKS:
            name = check.__name__
            marks = [pytest.mark.xfail(reason=excuses[name], strict=False)] if name in excuses else []
            cases.append(pytest.param(detector, check, marks=marks, id=f"{type(detector).__name__}-{name}"))
    return pytest.mark.parametrize(("detector", "check"), cases)


def results_table(results: Sequence[CheckResult]) -> str:
    """A table in text, with one line per check, each reason, and the counts."""
    lines = [f"{'check':<32} {'result':<17} {'s':>6}", "-" * 57]
    for result in results:
        lines.append(f"{result.check:<32} {result.status:<17} {result.seconds:>6.2f}")
        lines += [f"    {result.reason}"] * bool(result.reason)
    counts = Counter(result.status for result in results)
    return "\n".join([*lines, f"{len(results)} checks: " + ", ".join(f"{n} {status}" for status, n in counts.items())])
