"""Every check bites: a detector with one mistake fails the check that is about it, with a sentence that says so."""

import re

import broken_detectors as broken
import numpy as np
import pytest

from detectors.checks import CHECKS, DetectorChecksError, check_detector, parametrize_with_checks, results_table
from usnet_env import ArgumentError, Detection

MISTAKES = [
    ("check_constructor_only_stores", broken.StoresMore, "also got extra"),
    ("check_constructor_only_stores", broken.ChecksInConstructor, "TypeError"),
    ("check_constructor_only_stores", broken.ChangesItsArgument, "must leave the argument count unchanged, got 3"),
    ("check_answers_with_a_detection", broken.NoDetection, "must return a usnet_env.Detection"),
    ("check_answers_with_a_detection", broken.TooShort, "for all 14 UAVs, got 13"),
    ("check_same_seed_same_answer", broken.ClockAsSeed, "must give the same detection, got other scores"),
    ("check_same_seed_same_answer", broken.Remembers, "reset must clear the previous episode"),
    ("check_leaves_all_else_alone", broken.DrawsFromNumPy, r"a change of numpy\.random"),
    ("check_leaves_all_else_alone", broken.SeedsPython, "a change of random"),
    ("check_any_window", broken.NeedsEverySample, "not always seen"),
    ("check_any_window", broken.NeedsFour, r"too small a swarm.*broken_detectors\.py, line \d+"),
    ("check_order_of_uavs", broken.NamesTheFirst, "permuting the UAVs must permute the detection"),
    ("check_later_rounds", broken.NamesTheDead, "must not be a candidate"),
    ("check_label_and_pickle", broken.ForgetsWhenPickled, "must continue it, got other scores"),
]


def run(detector, **options):
    try:
        results = check_detector(detector, **options)
    except DetectorChecksError as error:
        results = error.results
    return {result.check: result for result in results}


def test_the_good_one_passes_and_every_check_has_a_mistake():
    assert {result.status for result in run(broken.Good()).values()} == {"passed"}
    assert {name for name, *_ in MISTAKES} == {check.__name__ for check in CHECKS}
    assert len(CHECKS) == 8


@pytest.mark.parametrize(("name", "kind", "sentence"), MISTAKES, ids=[kind.__name__ for _, kind, _ in MISTAKES])
def test_a_mistake_fails_its_check(name, kind, sentence):
    result = run(kind())[name]
    assert result.status == "failed"
    assert re.search(sentence, result.reason), result.reason
    assert "\n" not in result.reason


def test_a_failure_is_raised_at_the_end_or_expected():
    with pytest.raises(DetectorChecksError, match="NamesTheFirst fails 1 of 8 checks:\n  check_order") as raised:
        check_detector(broken.NamesTheFirst())
    assert len(raised.value.results) == 8
    reasons = {"check_order_of_uavs": "it goes by the index"}
    results = check_detector(broken.NamesTheFirst(), expected_failed_checks=reasons)
    assert "it goes by the index (permuting" in results_table(results)
    assert "8 checks: 7 passed, 1 expected failure" in results_table(results)


def test_what_is_no_detector_and_no_check_is_refused():
    for bad in (5, broken.Good, "no-such-detector"):
        with pytest.raises(ArgumentError, match="detector must be"):
            check_detector(bad)
    with pytest.raises(ArgumentError, match="expected_failed_checks"):
        check_detector(broken.Good(), expected_failed_checks={"check_all": "x"})


class Bare:
    """A detector without the base class: no parameters."""

    def reset(self, seed=None):
        self.rng = np.random.default_rng(seed)

    def detect(self, window):
        return Detection(window.alive, self.rng.random(window.uavs))


def test_a_detector_without_the_base_class_skips_the_rules_of_scikit_learn():
    statuses = {name: result.status for name, result in run(Bare()).items()}
    assert {name for name, status in statuses.items() if status == "skipped"} == {
        "check_constructor_only_stores",
        "check_label_and_pickle",
    }
    assert set(statuses.values()) == {"passed", "skipped"}


@parametrize_with_checks(
    [broken.NamesTheFirst(), "random(count=3)"],
    expected_failed_checks=lambda d: {"check_order_of_uavs": "by index"} if isinstance(d, broken.Good) else None,
)
def test_checks_are_cases_of_pytest(detector, check):
    check(detector)
