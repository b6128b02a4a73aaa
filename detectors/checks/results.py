"""The result of a check, and how results are shown: in an error, or as a table with an exit status."""

from __future__ import annotations

import os
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal
from unittest import SkipTest

from detectors.checks.harness import CheckError, CheckWarning
from usnet_env.processes import find_frame, limits

if TYPE_CHECKING:
    from rich.console import RenderableType

Check = Callable[[Any], None]
Status = Literal["passed", "warning", "failed", "expected failure", "skipped"]

_NOT_SHOWN = (Path(__file__).parent, Path(limits.__file__).parents[1])  # a detector's own line is shown instead
_COLOURS: dict[Status, str] = {
    "passed": "green",
    "warning": "yellow",
    "failed": "bold red",
    "expected failure": "yellow",
    "skipped": "dim",
}


@dataclass(frozen=True)
class CheckResult:
    """The result of one check.

    Args:
        check: the name of the check.
        status: ``"passed"``, ``"warning"``, ``"failed"``, ``"expected failure"`` or ``"skipped"``. A check with a
            warning has passed.
        reason: why the check failed, was expected to fail or was skipped, or the warning; empty if it passed as
            expected.
        seconds: the duration.
        error: the exception that the check raised, with its traceback; ``None`` in a child process.
        location: file, line and function of the detector in which the exception was raised; empty if a check found
            the failure itself.
        traceback: the traceback of the exception as text.
    """

    check: str
    status: Status
    reason: str
    seconds: float
    error: BaseException | None = None
    location: str = ""
    traceback: str = ""


class DetectorChecksError(AssertionError):
    """A detector failed at least one check; ``results`` holds the results of all checks."""

    def __init__(self, detector: Any, results: Sequence[CheckResult]) -> None:
        self.results = list(results)
        failed = [result for result in results if result.status == "failed"]
        lines = ""
        for first, names in _group_reasons(failed):
            lines += f"\n  {', '.join(names)}: {first.reason}" + (f" ({first.location})" if first.location else "")
        super().__init__(f"{type(detector).__name__} fails {len(failed)} of {len(results)} checks:{lines}")


def get_name(check: Check) -> str:
    """Return the name of a check, also of one with bound arguments."""
    return (check.func if isinstance(check, partial) else check).__name__


def run_check(check: Check, detector: Any, excuses: Mapping[str, str]) -> CheckResult:
    """Run one check, whatever the detector raises except ``KeyboardInterrupt``.

    ``excuses`` are reasons by the names of the checks that are expected to fail.
    """
    name = get_name(check)
    begin = time.perf_counter()
    status: Status = "passed"
    reason = f"passed, but was expected to fail: {excuses[name]}" if name in excuses else ""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", CheckWarning)
        try:
            check(detector)
        except SkipTest as skip:
            status, reason = "skipped", str(skip)
        except KeyboardInterrupt:
            raise
        except BaseException as failure:  # sys.exit in a detector raises SystemExit, which is no Exception
            return make_failure(name, _format_failure(failure), time.perf_counter() - begin, excuses, failure)
    for message in caught:
        if issubclass(message.category, CheckWarning):
            status, reason = "warning", str(message.message)
        else:
            warnings.warn_explicit(message.message, message.category, message.filename, message.lineno)
    return CheckResult(name, status, reason, time.perf_counter() - begin)


def make_failure(
    name: str, reason: str, seconds: float, excuses: Mapping[str, str], error: BaseException | None = None
) -> CheckResult:
    """Make the result of a check that failed, whether expected or not."""
    status: Status = "failed"
    if name in excuses:
        status, reason = "expected failure", f"{excuses[name]} ({reason})"
    trace = "".join(traceback.format_exception(error)) if error is not None else ""
    return CheckResult(name, status, reason, seconds, error, _find_location(error), trace)


def _format_failure(failure: BaseException) -> str:
    """Format a failure on one line: the message of a check, or the exception that the detector raised."""
    if isinstance(failure, SystemExit):
        return f"the detector must not end the program, got sys.exit({'' if failure.code is None else failure.code!r})."
    text = " ".join(str(failure).split())
    return text if isinstance(failure, CheckError) else f"{type(failure).__name__}: {text}".rstrip(": ")


def _find_location(failure: BaseException | None) -> str:
    """Find the last line of the traceback that is not in an installed library; empty if the checks raised it."""
    if failure is None or isinstance(failure, CheckError) or (frame := find_frame(failure, _NOT_SHOWN)) is None:
        return ""
    path = os.path.relpath(frame.filename)
    shown = frame.filename if path.startswith(os.pardir) else path
    return f"{shown}, line {frame.lineno}, in {frame.name}"


def _group_reasons(results: Sequence[CheckResult]) -> list[tuple[CheckResult, list[str]]]:
    """Group results of the same status and reason: the first of each group, and the names of all its checks."""
    groups: dict[tuple[str, str], tuple[CheckResult, list[str]]] = {}
    for result in results:
        if result.reason:
            groups.setdefault((result.status, result.reason), (result, []))[1].append(result.check)
    return list(groups.values())


def results_table(results: Sequence[CheckResult]) -> RenderableType:
    """Make a table for the terminal, with one row per check, the counts, and each reason with its checks."""
    from rich.box import SIMPLE_HEAD
    from rich.console import Group
    from rich.padding import Padding
    from rich.table import Table
    from rich.text import Text

    counts: Counter[str] = Counter(result.status for result in results)
    table = Table(box=SIMPLE_HEAD)
    for heading in ("check", "result", "s"):
        table.add_column(heading, justify="right" if heading == "s" else "left", no_wrap=True)
    for result in results:
        verdict = Text(result.status, style=_COLOURS[result.status])
        table.add_row(Text(result.check), verdict, f"{result.seconds:.2f}")
    parts: list[RenderableType] = [table]
    for first, names in _group_reasons(results):
        title = Text.assemble((f"{first.status}: ", _COLOURS[first.status]), first.reason)
        lines = [*filter(None, [first.location]), *names]
        parts += [title, Padding(Text("\n".join(lines)), (0, 0, 1, 4))]
    caption = ", ".join(f"{counts[status]} {status}" for status in _COLOURS if counts[status])
    return Group(*parts, Text(f"{len(results)} checks: {caption}"))


def exit_status(results: Sequence[CheckResult]) -> int:
    """Exit status of a command that ran the checks: 1 if a check failed unexpectedly, 0 otherwise."""
    return int(any(result.status == "failed" for result in results))
