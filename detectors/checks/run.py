"""Runs the checks: as a list of results, as pytest cases, or as a table with an exit status."""

from __future__ import annotations

import functools
import time
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal
from unittest import SkipTest

from detectors.checks.answers import (
    check_answers_with_a_detection,
    check_batch,
    check_large_swarm,
    check_masked_uavs_are_never_candidates,
    check_missing_samples,
    check_scores_are_finite,
    check_single_cluster,
    check_smallest_swarm,
)
from detectors.checks.arguments import check_constructor_only_stores, check_parameters_and_clone, check_pickling
from detectors.checks.global_state import (
    SECONDS,
    check_global_generators_untouched,
    check_input_unchanged,
    check_process_settings_untouched,
    check_time_budget,
)
from detectors.checks.harness import CheckError
from detectors.checks.leakage import check_no_reach_for_truth, check_truth_nearby_changes_nothing
from detectors.checks.repeatability import (
    check_episodes_start_afresh,
    check_permuting_uavs_permutes_the_answer,
    check_same_seed_same_answer,
)
from usnet_env.config import ArgumentError, quote, unknown_name

if TYPE_CHECKING:
    import pytest
    from rich.table import Table

__all__ = [
    "CHECKS",
    "CheckResult",
    "DetectorChecksError",
    "check_detector",
    "exit_status",
    "parametrize_with_checks",
    "results_table",
]

Check = Callable[[Any], None]
Status = Literal["passed", "failed", "expected failure", "skipped"]

#: All checks in the order in which they run. The first two come first because a detector may change the process in its
#: first call only. Checks that explain failures of others follow; the slow checks come last.
CHECKS: tuple[Check, ...] = (
    check_process_settings_untouched,
    check_global_generators_untouched,
    check_constructor_only_stores,
    check_parameters_and_clone,
    check_answers_with_a_detection,
    check_smallest_swarm,
    check_single_cluster,
    check_masked_uavs_are_never_candidates,
    check_missing_samples,
    check_scores_are_finite,
    check_batch,
    check_input_unchanged,
    check_same_seed_same_answer,
    check_episodes_start_afresh,
    check_permuting_uavs_permutes_the_answer,
    check_pickling,
    check_no_reach_for_truth,
    check_truth_nearby_changes_nothing,
    check_large_swarm,
    check_time_budget,
)
_NAMES = tuple(check.__name__ for check in CHECKS)


@dataclass(frozen=True)
class CheckResult:
    """The result of one check.

    Args:
        check: the name of the check.
        status: ``"passed"``, ``"failed"``, ``"expected failure"`` or ``"skipped"``.
        reason: why the check failed, was expected to fail or was skipped; empty if it passed as expected.
        seconds: the duration.
        error: the exception that the check raised, with its traceback.
    """

    check: str
    status: Status
    reason: str
    seconds: float
    error: Exception | None = None


class DetectorChecksError(AssertionError):
    """A detector failed at least one check; ``results`` holds the results of all checks."""

    def __init__(self, detector: Any, results: Sequence[CheckResult]) -> None:
        self.results = list(results)
        failed = [result for result in results if result.status == "failed"]
        lines = "".join(f"\n  {result.check}: {result.reason}" for result in failed)
        super().__init__(f"{type(detector).__name__} fails {len(failed)} of {len(results)} checks:{lines}")


def check_detector(
    detector: Any,
    *,
    expected_failed_checks: Mapping[str, str] | None = None,
    seconds: float = SECONDS,
    on_fail: Literal["raise"] | None = "raise",
    callback: Callable[[CheckResult], None] | None = None,
) -> list[CheckResult]:
    """Run all conformance checks on a detector, as scikit-learn's ``check_estimator`` does on an estimator.

    Args:
        detector: an object with ``detect`` and ``reset``. The checks use copies of it, with its fitted attributes.
        expected_failed_checks: names of checks that this detector can't pass, each with the reason.
        seconds: time budget of ``detect`` for 82 UAVs and T_ob = 100.
        on_fail: ``"raise"`` to raise an error after a failure, or ``None`` to only return the results.
        callback: function that is called with each result as soon as it exists.

    Returns:
        One result per check, in the order of :data:`CHECKS`. A check that was expected to fail and doesn't counts as
        passed.

    Raises:
        DetectorChecksError: a check failed unexpectedly. It is raised after all checks have run.
        ArgumentError: an argument is refused: not a detector, an unknown check, or an empty reason.
    """
    if on_fail not in ("raise", None):
        raise ArgumentError(f"on_fail must be 'raise' or None, got {quote(on_fail)}.")
    excuses = _validate_excuses(_validate_detector(detector), expected_failed_checks)
    results = []
    for check in _list_checks(seconds):
        results.append(_run_check(check, detector, excuses))
        if callback is not None:
            callback(results[-1])
    if on_fail == "raise" and any(result.status == "failed" for result in results):
        raise DetectorChecksError(detector, results)
    return results


def parametrize_with_checks(
    detectors: Iterable[Any],
    *,
    expected_failed_checks: Callable[[Any], Mapping[str, str] | None] | None = None,
    seconds: float = SECONDS,
) -> pytest.MarkDecorator:
    """Make a pytest decorator with one case per detector and check.

    The decorated function takes the arguments ``detector`` and ``check`` and calls ``check(detector)``.

    Args:
        detectors: objects with ``detect`` and ``reset``.
        expected_failed_checks: function that takes a detector and returns the names of the checks that it can't pass,
            each with the reason; these cases are marked ``xfail``.
        seconds: time budget of ``detect`` for 82 UAVs and T_ob = 100.

    Raises:
        ArgumentError: as :func:`check_detector`.
    """
    import pytest  # pytest is no dependency of the other functions

    cases = []
    for detector in detectors:
        found = expected_failed_checks(detector) if expected_failed_checks is not None else None
        excuses = _validate_excuses(_validate_detector(detector), found)
        for check in _list_checks(seconds):
            name = _get_name(check)
            marks = [pytest.mark.xfail(reason=excuses[name], strict=False)] if name in excuses else []
            # The default representation holds an address, which differs between the workers of pytest-xdist.
            plain = "__repr__" not in {name for kind in type(detector).__mro__[:-1] for name in vars(kind)}
            label = type(detector).__name__ if plain else " ".join(repr(detector).split())[:60]
            cases.append(pytest.param(detector, check, marks=marks, id=f"{label}-{name}"))
    return pytest.mark.parametrize(("detector", "check"), cases)


def results_table(results: Sequence[CheckResult]) -> Table:
    """Make a table for the terminal, with one row per check and a caption with the counts."""
    from rich.box import SIMPLE_HEAD
    from rich.table import Table
    from rich.text import Text

    colours = {"passed": "green", "failed": "bold red", "expected failure": "yellow", "skipped": "dim"}
    counts: Counter[str] = Counter(result.status for result in results)
    caption = ", ".join(f"{counts[status]} {status}" for status in colours if counts[status])
    table = Table(box=SIMPLE_HEAD, caption=f"{len(results)} checks: {caption}", caption_justify="left")
    for heading in ("check", "result", "s", "reason"):
        table.add_column(heading, justify="right" if heading == "s" else "left", overflow="fold")
    for result in results:
        verdict = Text(result.status, style=colours[result.status])
        table.add_row(Text(result.check), verdict, f"{result.seconds:.2f}", Text(result.reason))
    return table


def exit_status(results: Sequence[CheckResult]) -> int:
    """Exit status of a command that ran the checks: 1 if a check failed unexpectedly, 0 otherwise."""
    return int(any(result.status == "failed" for result in results))


def _list_checks(seconds: float) -> list[Check]:
    """All checks, with the time budget bound to :func:`check_time_budget`."""
    if isinstance(seconds, bool) or not isinstance(seconds, int | float) or not seconds > 0:
        raise ArgumentError(f"seconds must be a number above 0, got {quote(seconds)}.")
    budget = functools.partial(check_time_budget, seconds=float(seconds))
    return [budget if check is check_time_budget else check for check in CHECKS]


def _get_name(check: Check) -> str:
    name: str = (check.func if isinstance(check, functools.partial) else check).__name__
    return name


def _validate_detector(detector: Any) -> Any:
    methods = all(callable(getattr(detector, method, None)) for method in ("detect", "reset"))
    if isinstance(detector, type) or not methods:
        raise ArgumentError(f"detector must be an object with detect(window) and reset(seed), got {quote(detector)}.")
    return detector


def _validate_excuses(detector: Any, excuses: Mapping[str, str] | None) -> Mapping[str, str]:
    for name, reason in (excuses or {}).items():
        if name not in _NAMES:
            raise unknown_name("expected_failed_checks", name, _NAMES)
        if not isinstance(reason, str) or not reason.strip():
            raise ArgumentError(
                f"expected_failed_checks must give a reason for {name} of {type(detector).__name__}, "
                f"got {quote(reason)}."
            )
    return excuses or {}


def _run_check(check: Check, detector: Any, excuses: Mapping[str, str]) -> CheckResult:
    name = _get_name(check)
    begin = time.perf_counter()
    error: Exception | None = None
    status: Status = "passed"
    reason = f"passed, but was expected to fail: {excuses[name]}" if name in excuses else ""
    try:
        check(detector)
    except SkipTest as skip:
        status, reason = "skipped", str(skip)
    except Exception as failure:
        error = failure
        status, reason = "failed", _format_failure(failure)
        if name in excuses:
            status, reason = "expected failure", f"{excuses[name]} ({reason})"
    return CheckResult(name, status, reason, time.perf_counter() - begin, error)


def _format_failure(failure: Exception) -> str:
    """Format a failure on one line: the message of a check, or the exception that the detector raised."""
    text = " ".join(str(failure).split())
    return text if isinstance(failure, CheckError) else f"{type(failure).__name__}: {text}".rstrip(": ")
