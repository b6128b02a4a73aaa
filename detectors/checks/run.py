"""Runs the checks: as a list of results or as pytest cases, in this process or in a child process."""

from __future__ import annotations

import functools
import os
import pickle
import signal
from collections.abc import Callable, Generator, Iterable, Mapping, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Literal

from detectors.checks import answers, global_state, repeatability
from detectors.checks.arguments import check_constructor_only_stores, check_parameters_and_clone, check_pickling
from detectors.checks.harness import calling
from detectors.checks.leakage import (
    check_no_reach_for_truth,
    check_seeds_reveal_no_heads,
    check_truth_nearby_changes_nothing,
)
from detectors.checks.results import Check, CheckResult, DetectorChecksError, get_name, make_failure, run_check
from usnet_env.config import ArgumentError, quote, unknown_name
from usnet_env.parts import describe_error
from usnet_env.processes import Limits, ProcessDied, ProcessPool

if TYPE_CHECKING:
    import pytest

#: All checks in the order in which they run. The first two come first because a detector may change the process in its
#: first call only. Checks that explain failures of others follow; the slow checks come last.
CHECKS: tuple[Check, ...] = (
    global_state.check_process_settings_untouched,
    global_state.check_global_generators_untouched,
    check_constructor_only_stores,
    check_parameters_and_clone,
    answers.check_answers_with_a_detection,
    answers.check_smallest_swarm,
    answers.check_single_cluster,
    answers.check_masked_uavs_are_never_candidates,
    answers.check_missing_samples,
    answers.check_scores_are_finite,
    answers.check_batch,
    global_state.check_input_unchanged,
    repeatability.check_same_seed_same_answer,
    repeatability.check_episodes_start_afresh,
    repeatability.check_permuting_uavs_permutes_the_answer,
    check_pickling,
    check_no_reach_for_truth,
    check_truth_nearby_changes_nothing,
    check_seeds_reveal_no_heads,
    answers.check_large_swarm,
    global_state.check_time_budget,
)
_NAMES = tuple(check.__name__ for check in CHECKS)
_MOST_ENDS = 2  # processes that a detector may end one after the other; the checks that follow are then not run


def check_detector(
    detector: Any,
    *,
    expected_failed_checks: Mapping[str, str] | None = None,
    seconds: float = global_state.SECONDS,
    on_fail: Literal["raise"] | None = "raise",
    callback: Callable[[CheckResult], None] | None = None,
    child_process: bool = False,
    time_limit: float | None = None,
    memory_limit: float | None = None,
) -> list[CheckResult]:
    """Run all conformance checks on a detector, as scikit-learn's ``check_estimator`` does on an estimator.

    In this process a detector that never answers stops the checks, and one that ends the process ends them. In a child
    process both fail the check that runs, with the reason, and the other checks go on. ``usnet check-detector`` always
    uses a child process.

    Args:
        detector: an object with ``detect`` and ``reset``. The checks use copies of it, with its fitted attributes.
        expected_failed_checks: names of checks that this detector can't pass, each with the reason.
        seconds: time budget of ``detect`` for 82 UAVs and T_ob = 100.
        on_fail: ``"raise"`` to raise an error after a failure, or ``None`` to only return the results.
        callback: function that is called with each result as soon as it exists.
        child_process: whether to run the checks in a child process, which receives the pickled detector. A script
            needs ``if __name__ == "__main__":`` for this. A limit implies a child process.
        time_limit: seconds for each call of the detector; ``None``: no limit.
        memory_limit: memory in 10^6 bytes that each call of the detector may allocate; ``None``: no limit. Linux only.

    Returns:
        One result per check, in the order of :data:`CHECKS`. A check that was expected to fail and doesn't counts as
        passed.

    Raises:
        DetectorChecksError: a check failed unexpectedly. It is raised after all checks have run.
        ArgumentError: an argument is refused: not a detector, an unknown check, an empty reason, a limit that is not a
            positive number, or a detector that can't be sent to a child process.
    """
    if on_fail not in ("raise", None):
        raise ArgumentError(f"on_fail must be 'raise' or None, got {quote(on_fail)}.")
    if not isinstance(child_process, bool):
        raise ArgumentError(f"child_process must be true or false, got {quote(child_process)}.")
    excuses = _validate_excuses(expected_failed_checks, type(_validate_detector(detector)).__name__)
    limits = _make_limits(time_limit, memory_limit)
    checks = _list_checks(seconds)
    if child_process or limits.any:
        try:
            content = pickle.dumps(detector)
        except Exception as error:
            raise ArgumentError(
                f"child_process must be false for a detector that cannot be pickled, got {describe_error(error)}."
            ) from None
        # The child makes the detector from bytes of this process, never of a file: a failure there is a result, too.
        found = _run_in_child(functools.partial(pickle.loads, content), checks, excuses, limits)
    else:
        found = (run_check(check, detector, excuses) for check in checks)
    results = _collect_results(found, callback)
    if on_fail == "raise" and any(result.status == "failed" for result in results):
        raise DetectorChecksError(detector, results)
    return results


def check_factory(
    make: Callable[[], Any],
    name: str,
    *,
    expected_failed_checks: Mapping[str, str] | None = None,
    seconds: float = global_state.SECONDS,
    callback: Callable[[CheckResult], None] | None = None,
    time_limit: float | None = None,
    memory_limit: float | None = None,
) -> list[CheckResult]:
    """Run all checks on a detector that only a child process creates, so that its import can't harm this process.

    ``make`` imports and creates the detector; it takes no arguments, and is pickled. Errors call the detector ``name``.
    The other arguments are those of :func:`check_detector`; the limits also apply to ``make``.

    Raises:
        ArgumentError: an argument is refused, or ``make`` raised it.
    """
    excuses = _validate_excuses(expected_failed_checks, name)
    found = _run_in_child(make, _list_checks(seconds), excuses, _make_limits(time_limit, memory_limit))
    return _collect_results(found, callback)


def _collect_results(
    found: Generator[CheckResult, None, None], callback: Callable[[CheckResult], None] | None
) -> list[CheckResult]:
    """Run the checks, and report each result as soon as it exists."""
    results = []
    with closing(found):  # a child process ends with it, also if the callback raises
        for result in found:
            results.append(result)
            if callback is not None:
                callback(result)
    return results


def _make_limits(time_limit: float | None, memory_limit: float | None) -> Limits:
    for name, value in (("time_limit", time_limit), ("memory_limit", memory_limit)):
        number = isinstance(value, int | float) and not isinstance(value, bool)
        if value is not None and not (number and 0 < value < float("inf")):
            raise ArgumentError(f"{name} must be a number above 0 or None, got {quote(value)}.")
    return Limits(seconds=time_limit, megabytes=memory_limit)


def parametrize_with_checks(
    detectors: Iterable[Any],
    *,
    expected_failed_checks: Callable[[Any], Mapping[str, str] | None] | None = None,
    seconds: float = global_state.SECONDS,
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
        excuses = _validate_excuses(found, type(_validate_detector(detector)).__name__)
        for check in _list_checks(seconds):
            name = get_name(check)
            marks = [pytest.mark.xfail(reason=excuses[name], strict=False)] if name in excuses else []
            # The default representation holds an address, which differs between the workers of pytest-xdist.
            plain = type(detector).__repr__ is object.__repr__  # type: ignore[comparison-overlap]
            label = type(detector).__name__ if plain else " ".join(repr(detector).split())[:60]
            cases.append(pytest.param(detector, check, marks=marks, id=f"{label}-{name}"))
    return pytest.mark.parametrize(("detector", "check"), cases)


def _list_checks(seconds: float) -> list[Check]:
    """All checks, with the time budget bound to :func:`detectors.checks.global_state.check_time_budget`."""
    if isinstance(seconds, bool) or not isinstance(seconds, int | float) or not seconds > 0:
        raise ArgumentError(f"seconds must be a number above 0, got {quote(seconds)}.")
    budget = functools.partial(global_state.check_time_budget, seconds=float(seconds))
    return [budget if check is global_state.check_time_budget else check for check in CHECKS]


def _validate_detector(detector: Any) -> Any:
    methods = all(callable(getattr(detector, method, None)) for method in ("detect", "reset"))
    if isinstance(detector, type) or not methods:
        raise ArgumentError(f"detector must be an object with detect(window) and reset(seed), got {quote(detector)}.")
    return detector


def _validate_excuses(excuses: Mapping[str, str] | None, detector: str) -> Mapping[str, str]:
    for name, reason in (excuses or {}).items():
        if name not in _NAMES:
            raise unknown_name("expected_failed_checks", name, _NAMES)
        if not isinstance(reason, str) or not reason.strip():
            raise ArgumentError(
                f"expected_failed_checks must give a reason for {name} of {detector}, got {quote(reason)}."
            )
    return excuses or {}


def _run_in_child(
    make: Callable[[], Any], checks: Sequence[Check], excuses: Mapping[str, str], limits: Limits
) -> Generator[CheckResult, None, None]:
    """Yield the results of checks in a child process; a new one takes over if the detector ends it.

    ``make`` is pickled, and creates the detector in the child process; what it raises is raised here, too.
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

    @functools.cached_property
    def _made(self) -> tuple[Any, dict[str, tuple[Any, ...]]]:
        """The detector, and the code as it was before the detector was imported."""
        functions = global_state.list_functions()
        with calling("its constructor"):
            return self.make(), functions

    def __call__(self, name: str) -> CheckResult:
        """Run the check of this name."""
        (detector, functions), check = self._made, self.checks[name]
        if check is global_state.check_process_settings_untouched:
            check = functools.partial(global_state.check_process_settings_untouched, functions=functions)
        result = run_check(check, detector, self.excuses)
        for pid in global_state.list_processes():  # those that the detector has left behind
            with suppress(OSError):
                os.kill(pid, signal.SIGKILL)
                os.waitpid(pid, 0)
        return replace(result, error=None)  # an exception may refer to anything, and not everything can be sent
