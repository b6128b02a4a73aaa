"""``usnet check-detector``: its table, and an exit status for scripts."""

from pathlib import Path

import pytest

from detectors.checks import CHECKS

BROKEN = Path(__file__).parent / "detectors" / "checks"
PERMUTING = "check_permuting_uavs_permutes_the_answer"


@pytest.fixture
def check(run, monkeypatch):
    """Runs ``usnet check-detector``."""
    monkeypatch.syspath_prepend(BROKEN)
    return lambda *words: run("check-detector", *words)


@pytest.mark.slow
def test_a_good_detector_has_a_table_and_status_0(check):
    status, out, err = check("lagged-regression(clusters=2)")
    assert (status, err) == (0, "")
    assert all(check.__name__ in out for check in CHECKS)
    assert f"{len(CHECKS)} checks: {len(CHECKS)} passed" in out


@pytest.mark.slow
def test_a_broken_one_has_status_1_and_a_reason(check):
    status, out, err = check("broken_detectors:NamesTheFirst(count=3)")
    assert (status, err) == (1, "")
    assert "permuting the UAVs must permute the detection" in out
    assert f"{len(CHECKS) - 1} passed, 1 failed" in out


def test_an_expected_failure_has_its_reason_and_status_0(check):
    status, out, _ = check("broken_detectors:NamesTheFirst", "--expect", f"{PERMUTING}=it goes by the index = by habit")
    assert status == 0
    assert "it goes by the index = by habit (permuting" in out
    assert f"{len(CHECKS) - 1} passed, 1 expected failure" in out


@pytest.mark.slow
def test_a_warning_does_not_change_the_status(check):
    status, out, _ = check("broken_detectors:FavoursLowIndices")
    assert status == 0
    assert "warning: ties are broken by the index" in out
    assert f"{len(CHECKS) - 1} passed, 1 warning" in out


@pytest.mark.slow
def test_the_time_budget_and_the_limits_are_arguments(check):
    status, out, _ = check("broken_detectors:Slow", "--seconds", "0.05", "--time-limit", "60", "--memory-limit", "4000")
    assert status == 1
    assert "detect must take at most 0.05 s for 82 UAVs" in out


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (("no-such-detector",), "detector must be one of"),
        pytest.param(("no_such_module:X",), "can't be loaded: ModuleNotFoundError", marks=pytest.mark.slow),
        (("random", "--expect", PERMUTING), "--expect must be written check=reason"),
        (("random", "--expect", "check_all=x"), "must be one of"),
        (("random", "--expect", f"{PERMUTING}="), "must give a reason"),
        (("random", "--seconds", "0"), "seconds must be a number above 0"),
        (("random", "--seconds", "x"), "--seconds"),
        (("random", "--time-limit", "0"), "time_limit must be a number above 0"),
        (("random", "--memory-limit", "nan"), "memory_limit must be a number above 0"),
        ((), "NAME"),
    ],
)
def test_what_is_refused_is_one_sentence(check, words, expected):
    status, out, err = check(*words)
    assert (status, out) == (2, "")
    assert expected in err
    assert err.startswith("usnet: ")
    assert err.count("\n") == 1
