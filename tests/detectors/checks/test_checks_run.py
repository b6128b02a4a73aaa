"""How checks are run: results, expected failures, pytest cases, a table with an exit status."""

import functools
import io
from collections import deque
from types import MappingProxyType

import broken_detectors as broken
import gymnasium as gym
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console
from sklearn.base import clone

from detectors import Detector
from detectors.checks import (
    CHECKS,
    DetectorChecksError,
    check_detector,
    exit_status,
    parametrize_with_checks,
    results_table,
)
from detectors.checks.leakage import find_truth
from detectors.checks.windows import make_hovering_window, permute_uavs, simulate_missing_samples, simulate_window
from usnet_env import ArgumentError, Detection, Window
from usnet_env.detection import Tags
from usnet_env.swarm import SwarmConfig

NAMES = [check.__name__ for check in CHECKS]
PERMUTING = "check_permuting_uavs_permutes_the_answer"
REASON = "it always names the first UAVs"


def by_check(results):
    assert [result.check for result in results] == NAMES
    return {result.check: result for result in results}


def test_a_good_detector_has_a_result_for_every_check():
    seen = []
    results = check_detector(broken.Good(), callback=seen.append)
    assert seen == results
    assert {result.status for result in by_check(results).values()} == {"passed"}
    assert all(result.seconds > 0 and result.reason == "" and result.error is None for result in results)
    assert exit_status(results) == 0


def test_a_broken_one_raises_after_all_checks_and_says_what_failed():
    with pytest.raises(DetectorChecksError, match=rf"^NamesTheFirst fails 1 of {len(CHECKS)} checks:\n  {PERMUTING}: "):
        check_detector(broken.NamesTheFirst())
    results = check_detector(broken.NamesTheFirst(), on_fail=None)
    failed = by_check(results)[PERMUTING]
    assert failed.status == "failed"
    assert isinstance(failed.error, AssertionError)
    assert failed.error.__traceback__ is not None
    assert exit_status(results) == 1


def test_an_expected_failure_carries_its_reason():
    results = check_detector(broken.NamesTheFirst(), expected_failed_checks={PERMUTING: REASON})
    expected = by_check(results)[PERMUTING]
    assert expected.status == "expected failure"
    assert expected.reason.startswith(f"{REASON} (permuting the UAVs must permute")
    assert exit_status(results) == 0


def test_an_expected_failure_that_passes_says_so():
    results = check_detector(broken.Good(), expected_failed_checks={PERMUTING: REASON})
    assert by_check(results)[PERMUTING].status == "passed"
    assert by_check(results)[PERMUTING].reason == f"passed, but was expected to fail: {REASON}"


def test_no_base_class_is_needed():
    results = by_check(check_detector(broken.NoBase()))
    skipped = {name for name, result in results.items() if result.status == "skipped"}
    assert skipped == {"check_constructor_only_stores", "check_parameters_and_clone", "check_batch"}
    assert all(results[name].reason.startswith("it has no ") for name in skipped)


def test_what_was_fitted_is_kept_and_the_detector_left_alone():
    with pytest.raises(AttributeError, match="weights_"):
        clone(broken.Fitted().fit()).scores(simulate_window())
    detector = broken.Fitted().fit()
    before = dict(vars(detector))
    check_detector(detector)
    assert vars(detector) == before


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ({"detector": broken.Good}, r"detector must be an object with detect\(window\) and reset\(seed\), got <class"),
        ({"detector": "random"}, r"detector must be an object .*, got 'random'"),
        ({"expected_failed_checks": {"check_pickle": "x"}}, r"must be one of .*did you mean 'check_pickling'\?"),
        ({"expected_failed_checks": {PERMUTING: " "}}, "must give a reason for check_permuting"),
        ({"expected_failed_checks": {PERMUTING: None}}, "must give a reason for check_permuting.*got None"),
        ({"seconds": 0}, "seconds must be a number above 0, got 0"),
        ({"seconds": "1"}, "seconds must be a number above 0, got '1'"),
        ({"seconds": float("nan")}, "seconds must be a number above 0, got nan"),
        ({"on_fail": "warn"}, "on_fail must be 'raise' or None, got 'warn'"),
    ],
)
def test_bad_input_is_answered_in_one_sentence(arguments, sentence):
    with pytest.raises(ArgumentError, match=sentence):
        check_detector(**{"detector": broken.Good(), **arguments})


def test_the_decorator_refuses_the_same():
    with pytest.raises(ArgumentError, match="detector must be an object"):
        parametrize_with_checks([broken.Good])
    with pytest.raises(ArgumentError, match="must give a reason"):
        parametrize_with_checks([broken.Good()], expected_failed_checks=lambda detector: {PERMUTING: ""})


@parametrize_with_checks(
    [broken.Good(), broken.NamesTheFirst(count=3), broken.NoBase()],
    expected_failed_checks=lambda detector: {PERMUTING: REASON} if isinstance(detector, broken.NamesTheFirst) else None,
)
def test_as_pytest_cases(detector, check):
    check(detector)


def test_a_case_has_a_name_and_a_mark():
    mark = parametrize_with_checks(
        [broken.Good(count=3)], expected_failed_checks=lambda detector: {PERMUTING: REASON}, seconds=3
    ).mark
    names, cases = mark.args
    assert names == ("detector", "check")
    assert [case.id for case in cases] == [f"Good(count=3)-{name}" for name in NAMES]
    marked = [case for case in cases if case.marks]
    assert [(case.id, case.marks[0].kwargs["reason"]) for case in marked] == [(f"Good(count=3)-{PERMUTING}", REASON)]
    budget = cases[-1].values[1]
    assert isinstance(budget, functools.partial)
    assert budget.keywords == {"seconds": 3.0}


def test_the_table_has_a_row_a_check():
    console = Console(width=300, file=io.StringIO())
    results = check_detector(broken.NoBase(), expected_failed_checks={"check_pickling": "[b]no[/b]"})
    console.print(results_table(results))
    text = console.file.getvalue()
    assert all(name in text for name in NAMES)
    assert text.count(" skipped ") == 3
    assert text.count("skipped: it has no method get_params") == 1  # of two checks
    assert f"{len(NAMES)} checks: {len(NAMES) - 3} passed, 3 skipped" in text
    assert "expected to fail: [b]no[/b]" in text


class RaisesAlways(broken.Good):
    def detect(self, window):
        return self.boom(window)

    def boom(self, window):
        raise RuntimeError("boom")


def test_equal_reasons_are_printed_once_with_file_and_line_in_80_columns():
    results = check_detector(RaisesAlways(), on_fail=None)
    failed = [result.check for result in results if result.status == "failed"]
    assert len(failed) > 15
    line = RaisesAlways.boom.__code__.co_firstlineno + 1
    assert {result.location for result in results if result.status == "failed"} == {
        f"tests/detectors/checks/test_checks_run.py, line {line}, in boom"
    }
    console = Console(width=80, file=io.StringIO())
    console.print(results_table(results))
    text = console.file.getvalue()
    assert text.count("RuntimeError: boom") == 1
    assert text.count(f"line {line}, in boom") == 1
    assert all(text.count(f" {name} ") == 2 for name in failed)  # in the table, and below the reason; never broken
    with pytest.raises(DetectorChecksError, match=r"(?s)boom.*line \d+, in boom") as error:
        check_detector(RaisesAlways())
    assert str(error.value).count("boom (") == 1
    assert "in boom" in results[0].traceback


def test_an_error_of_a_library_is_located_in_the_detector():
    class Misshapen(broken.Good):
        def scores(self, window):
            return clone(window)

    results = by_check(check_detector(Misshapen(), on_fail=None))
    assert results["check_smallest_swarm"].location.endswith(", in scores")


def test_an_error_of_usnet_is_located_in_the_detector():
    class WrongLength(broken.Good):
        def detect(self, window):
            return Detection(np.zeros(window.uavs, bool), np.zeros(window.uavs + 1))

    results = by_check(check_detector(WrongLength(), on_fail=None))
    place = results["check_smallest_swarm"].location
    assert place.startswith("tests/detectors/checks/test_checks_run.py")
    assert place.endswith(", in detect")


@pytest.mark.parametrize("name", ["time_limit", "memory_limit"])
@pytest.mark.parametrize("value", [0, -1, "1", True, float("nan"), float("inf")])
def test_a_limit_is_a_positive_number(name, value):
    with pytest.raises(ArgumentError, match=rf"^{name} must be a number above 0 or None, got "):
        check_detector(broken.Good(), **{name: value})


def test_a_child_process_needs_a_detector_that_can_be_pickled():
    detector = broken.CannotBePickled()
    detector.reset(0)
    with pytest.raises(
        ArgumentError, match=r"^child_process must be false for a detector that cannot be pickled, got "
    ):
        check_detector(detector, child_process=True)
    with pytest.raises(ArgumentError, match=r"^child_process must be true or false, got 1"):
        check_detector(detector, child_process=1)


# The windows


def test_the_windows_are_what_they_are_called():
    window = simulate_window(clusters=2, uavs=20, destroyed=50, round=3, miss_rate=0.2)
    assert (window.uavs, window.alive.sum(), window.round) == (20, 3, 3)
    partly = simulate_missing_samples()
    assert not partly.seen[20].any()
    assert not partly.velocity[~partly.velocity_seen].any()
    assert not partly.position[~partly.seen].any()
    assert (~partly.seen.any(axis=0) & partly.alive).sum() == 1
    assert not np.diff(make_hovering_window().position, axis=0).any()
    assert not np.ptp(make_hovering_window(together=True).position, axis=1).any()


def test_a_permuted_window_is_the_same_swarm_in_another_order():
    window = simulate_missing_samples()
    order = np.random.default_rng(0).permutation(window.uavs)
    turned = permute_uavs(window, order)
    for name in ("position", "velocity", "seen"):
        np.testing.assert_array_equal(getattr(turned, name), getattr(window, name)[:, order])
    np.testing.assert_array_equal(turned.alive, window.alive[order])


# What can be reached


class Holder:
    def __init__(self, held):
        self.held = held

    def method(self):
        return self.held


class Slotted:
    __slots__ = ("held",)

    def __init__(self, held):
        self.held = held


def closure(held):
    return lambda: held


def default(held):
    return lambda x=held: x


def generator(held):
    made = (held for _ in range(2))
    next(made)
    return made


def array_of(held):
    array = np.empty(2, object)
    array[1] = held
    return array[::-1]


WRAPPERS = {
    "list": lambda held: [0, held],
    "tuple": lambda held: (held,),
    "dict": lambda held: {"key": held},
    "mapping": lambda held: MappingProxyType({"key": held}),
    "deque": lambda held: deque([held]),
    "iterator": lambda held: iter([held]),
    "closure": closure,
    "default": default,
    "generator": generator,
    "partial": lambda held: functools.partial(max, held),
    "object": Holder,
    "slots": Slotted,
    "method": lambda held: Holder(held).method,
    "array": array_of,
}


@given(st.lists(st.sampled_from(sorted(WRAPPERS)), max_size=6))
def test_truth_is_found_however_it_is_wrapped(names):
    config = SwarmConfig()
    held, innocent = config, "config"
    for name in names:
        held, innocent = WRAPPERS[name](held), WRAPPERS[name](innocent)
    assert find_truth(held, "it").endswith(", a usnet_env.swarm.config.SwarmConfig")
    assert find_truth(held, "it").startswith("it")
    assert find_truth(innocent, "it") == ""


def test_a_ring_is_walked_once():
    ring = [0]
    ring.append({"ring": ring})
    assert find_truth(ring, "it") == ""
    ring.append(SwarmConfig())
    assert find_truth(ring[1], "it").startswith("it['ring'][2], a ")


def test_nothing_is_in_reach_of_a_window_from_an_environment():
    env = gym.make("USNET/MultiCluster-v0")
    observation, _ = env.reset(seed=0)
    assert find_truth(Window.from_observation(observation), "window") == ""
    assert find_truth(env.reset, "it").endswith(", a gymnasium.wrappers.common.OrderEnforcing")
    for held in (env, env.unwrapped, env.unwrapped.swarm, functools.partial(env.step)):
        assert find_truth(held, "it")


class Limited(Detector):
    """Takes long windows of few UAVs only."""

    tags = Tags(most_uavs=12, least_steps=40)

    def detect(self, window):
        """Name the living UAVs."""
        if window.uavs > 12 or window.observation_steps < 40:
            raise ArgumentError("window must hold at most 12 UAVs and at least 40 velocities.")
        return Detection(window.alive, window.alive)


def test_the_windows_respect_the_tags():
    results = check_detector(Limited())
    assert {result.status for result in results} == {"passed"}
