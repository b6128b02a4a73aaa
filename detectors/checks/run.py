"""Runs the checks: as a list of results, as a table, or as pytest cases."""

from __future__ import annotations

import time
import traceback
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal
from unittest import SkipTest

from detectors.checks.contract import CHECKS, CheckError
from usnet_env.config import ArgumentError, quote, unknown_name
from usnet_env.plugins import make_detector


@dataclass(frozen=True)
class CheckResult:
    """The result of one check: its name, status, ``reason`` (empty if it passed), duration and the exception raised."""

    check: str
    status: Literal["passed", "failed", "expected failure", "skipped"]
    reason: str
    seconds: float
    error: BaseException | None = None


class DetectorChecksError(AssertionError):
    """A detector failed at least one check; ``results`` holds the results of all checks."""

    def __init__(self, detector: Any, results: Sequence[CheckResult]) -> None:
        self.results = list(results)
        failed = [f"\n  {result.check}: {result.reason}" for result in results if result.status == "failed"]
        super().__init__(f"{type(detector).__name__} fails {len(failed)} of {len(results)} checks:{''.join(failed)}")


def check_detector(
    detector: Any,
    *,
    expected_failed_checks: Mapping[str, str] | None = None,
    on_fail: Literal["raise"] | None = "raise",
    callback: Callable[[CheckResult], None] | None = None,
) -> list[CheckResult]:
    """Run all conformance checks on a detector, as scikit-learn's ``check_estimator`` does on an estimator.

    Args:
        detector: an object with ``detect`` and ``reset``, or a name as :func:`usnet_env.make_detector` takes it. The
            checks use copies of it.
        expected_failed_checks: names of checks that this detector can't pass, each with the reason.
        on_fail: ``"raise"`` to raise an error after a failure, or ``None`` to only return the results.
        callback: function that is called with each result as soon as it exists.

    Returns:
        One result per check, in the order of :data:`CHECKS`. A check that was expected to fail and doesn't counts as
        passed.

    Raises:
        DetectorChecksError: a check failed unexpectedly. It is raised after all checks have run.
        ArgumentError: not a detector, or an unknown check.
    """
    detector, excuses = _find_detector(detector), _check_names(expected_failed_checks or {})
    results = []
    for check in CHECKS:
        results.append(_run_check(check, detector, excuses))
        if callback is not None:
            callback(results[-1])
    if on_fail == "raise" and exit_status(results):
        raise DetectorChecksError(detector, results)
    return results


def _find_detector(detector: Any) -> Any:
    found = make_detector(detector) if isinstance(detector, str) else detector
    if isinstance(found, type) or not all(callable(getattr(found, name, None)) for name in ("detect", "reset")):
        raise ArgumentError(f"detector must be an object with detect(window) and reset(seed), got {quote(detector)}.")
    return found


def _check_names(excuses: Mapping[str, str]) -> Mapping[str, str]:
    known = [check.__name__ for check in CHECKS]
    for name in set(excuses) - set(known):
        raise unknown_name("expected_failed_checks", name, known)
    return excuses


def _run_check(check: Callable[[Any], None], detector: Any, excuses: Mapping[str, str]) -> CheckResult:
    begin, name = time.perf_counter(), check.__name__
    try:
        check(detector)
    except SkipTest as skip:
        return CheckResult(name, "skipped", str(skip), time.perf_counter() - begin)
    except (Exception, SystemExit) as failure:
        reason, seconds = _describe(failure), time.perf_counter() - begin
        if name in excuses:
            return CheckResult(name, "expected failure", f"{excuses[name]} ({reason})", seconds, failure)
        return CheckResult(name, "failed", reason, seconds, failure)
    return CheckResult(name, "passed", "", time.perf_counter() - begin)


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
    """Make a pytest decorator with one case per detector and check.

    The decorated function takes the arguments ``detector`` and ``check`` and calls ``check(detector)``.

    Args:
        detectors: as of :func:`check_detector`.
        expected_failed_checks: function that takes a detector and returns the names of the checks that it can't pass,
            each with the reason; these cases are marked ``xfail``.
    """
    import pytest  # pytest is no dependency of the other functions

    cases = []
    for detector in map(_find_detector, detectors):
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


def exit_status(results: Sequence[CheckResult]) -> int:
    """Exit status of a command that ran the checks: 1 if a check failed unexpectedly, 0 otherwise."""
    return int(any(result.status == "failed" for result in results))
