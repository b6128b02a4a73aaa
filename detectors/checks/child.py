"""Runs the checks in a child process, which a detector may end, stop or fill without harm to this one."""

from __future__ import annotations

import functools
import os
import signal
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import Any

from detectors.checks.global_state import check_process_settings_untouched
from detectors.checks.harness import calling
from detectors.checks.process import list_functions, list_processes
from detectors.checks.results import Check, CheckResult, get_name, make_failure, run_check
from usnet_env.processes import Limits, ProcessDied, ProcessPool

_MOST_ENDS = 2  # processes that a detector may end one after the other; the checks that follow are then not run


def run_in_child(
    make: Callable[[], Any],
    checks: Sequence[Check],
    excuses: Mapping[str, str],
    limits: Limits,
    callback: Callable[[CheckResult], None] | None = None,
) -> list[CheckResult]:
    """Run checks in a child process; a new one takes over if the detector ends it.

    Args:
        make: creates the detector in the child process; it is pickled.
        checks: the checks.
        excuses: reasons by the names of the checks that are expected to fail.
        limits: of each call of the detector.
        callback: function that is called with each result as soon as it exists.

    Raises:
        Exception: ``make`` raised it.
    """
    results: list[CheckResult] = []

    def add(result: CheckResult) -> None:
        results.append(result)
        if callback is not None:
            callback(result)

    names = [get_name(check) for check in checks]
    ends = 0
    with ProcessPool[str, CheckResult](_Checker(make, tuple(checks), dict(excuses)), 1, limits) as pool:
        for outcome in pool.run(names):
            if isinstance(outcome.error, ProcessDied):
                ends += 1
                add(make_failure(outcome.task, f"a detector must return, but {outcome.error}.", 0.0, excuses))
            elif outcome.error is not None:
                raise outcome.error
            elif outcome.result is not None:
                ends = 0
                add(outcome.result)
            if ends == _MOST_ENDS:
                break
    for name in names[len(results) :]:
        add(make_failure(name, f"not run, because the {_MOST_ENDS} checks before did not end by themselves.", 0.0, {}))
    return results


@dataclass
class _Checker:
    """Runs single checks in a child process; the first call creates the detector."""

    make: Callable[[], Any]
    checks: tuple[Check, ...]
    excuses: dict[str, str]
    _made: list[Any] = field(default_factory=list)

    def __call__(self, name: str) -> CheckResult:
        """Run the check of this name."""
        if not self._made:
            functions = list_functions()  # before the detector is imported
            with calling("its constructor"):
                detector = self.make()
            self._made = [detector, functions]
        detector, functions = self._made
        (check,) = [check for check in self.checks if get_name(check) == name]
        if check is check_process_settings_untouched:
            check = functools.partial(check_process_settings_untouched, functions=functions)
        result = run_check(check, detector, self.excuses)
        for key in list_processes():  # those that the detector has left behind
            with suppress(OSError):
                pid = int(key.rpartition(" ")[2])
                os.kill(pid, signal.SIGKILL)
                os.waitpid(pid, 0)
        return replace(result, error=None)  # an exception may refer to anything, and not everything can be sent
