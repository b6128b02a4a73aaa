"""Runs the checks in a child process, which a detector may end, stop or fill without harm to this one."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any

from detectors.checks.global_state import check_process_settings_untouched
from detectors.checks.harness import calling
from detectors.checks.process import list_functions, list_processes
from detectors.checks.results import Check, CheckResult, get_name, make_failure, run_check
from usnet_env.processes import Limits, ProcessDied, ProcessPool

_MOST_ENDS = 2  # processes that a detector may end one after the other; the checks that follow are then not run


def run_in_child(
    make: Callable[[], Any], checks: Sequence[Check], excuses: Mapping[str, str], limits: Limits
) -> Generator[CheckResult, None, None]:
    """Yield the results of checks in a child process; a new one takes over if the detector ends it.

    Args:
        make: creates the detector in the child process; it is pickled.
        checks: the checks.
        excuses: reasons by the names of the checks that are expected to fail.
        limits: of each call of the detector.

    Raises:
        Exception: ``make`` raised it.
    """
    by_name = {get_name(check): check for check in checks}
    done = ends = 0
    with ProcessPool[str, CheckResult](_Checker(make, by_name, dict(excuses)), 1, limits) as pool:
        for outcome in pool.run(list(by_name)):
            if isinstance(outcome.error, ProcessDied):
                ends += 1
                yield make_failure(outcome.task, f"a detector must return, but {outcome.error}.", 0.0, excuses)
            elif outcome.error is not None:
                raise outcome.error
            elif outcome.result is not None:
                ends = 0
                yield outcome.result
            done += 1
            if ends == _MOST_ENDS:
                break
    for name in list(by_name)[done:]:
        yield make_failure(name, f"not run, because the {_MOST_ENDS} checks before did not end by themselves.", 0.0, {})


@dataclass
class _Checker:
    """Runs single checks in a child process; the first call creates the detector."""

    make: Callable[[], Any]
    checks: dict[str, Check]
    excuses: dict[str, str]

    @cached_property
    def _made(self) -> tuple[Any, dict[str, tuple[Any, ...]]]:
        """The detector, and the code as it was before the detector was imported."""
        functions = list_functions()
        with calling("its constructor"):
            return self.make(), functions

    def __call__(self, name: str) -> CheckResult:
        """Run the check of this name."""
        (detector, functions), check = self._made, self.checks[name]
        if check is check_process_settings_untouched:
            check = partial(check_process_settings_untouched, functions=functions)
        result = run_check(check, detector, self.excuses)
        for pid in list_processes():  # those that the detector has left behind
            with suppress(OSError):
                os.kill(pid, signal.SIGKILL)
                os.waitpid(pid, 0)
        return replace(result, error=None)  # an exception may refer to anything, and not everything can be sent
