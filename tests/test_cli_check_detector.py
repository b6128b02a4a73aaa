"""``usnet check-detector``: its table, and an exit status for scripts."""

from pathlib import Path

import pytest

from detectors.checks import CHECKS
from usnet_env import cli

BROKEN = Path(__file__).parent / "detectors" / "checks"
PERMUTING = "check_permuting_uavs_permutes_the_answer"


@pytest.fixture
def run(capsys, monkeypatch):
    monkeypatch.syspath_prepend(BROKEN)

    def runner(*words):
        status = cli.main(["check-detector", *words])
        output = capsys.readouterr()
        return status, output.out, output.err

    return runner


def test_a_good_detector_has_a_table_and_status_0(run):
    status, out, err = run("lagged-regression(clusters=2)")
    assert (status, err) == (0, "")
    assert all(check.__name__ in out for check in CHECKS)
    assert f"{len(CHECKS)} checks: {len(CHECKS)} passed" in out


def test_a_broken_one_has_status_1_and_a_reason(run):
    status, out, err = run("broken_detectors:FavoursLowIndices(count=3)")
    assert (status, err) == (1, "")
    assert "permuting the UAVs must permute the detection" in out
    assert f"{len(CHECKS) - 1} passed, 1 failed" in out


def test_an_expected_failure_has_its_reason_and_status_0(run):
    status, out, _ = run(
        "broken_detectors:FavoursLowIndices", "--expect", f"{PERMUTING}=it goes by the index = by habit"
    )
    assert status == 0
    assert "it goes by the index = by habit (permuting" in out
    assert "1 expected failure" in out


def test_the_time_budget_is_an_argument(run):
    status, out, _ = run("broken_detectors:Slow", "--seconds", "0.05")
    assert status == 1
    assert "detect must take at most 0.05 s for 82 UAVs" in out


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (("no-such-detector",), "detector must be one of"),
        (("no_such_module:X",), "can't be loaded: ModuleNotFoundError"),
        (("random", "--expect", PERMUTING), "--expect must be written check=reason"),
        (("random", "--expect", "check_all=x"), "must be one of"),
        (("random", "--expect", f"{PERMUTING}="), "must give a reason"),
        (("random", "--seconds", "0"), "seconds must be a number above 0"),
        (("random", "--seconds", "x"), "--seconds"),
        ((), "NAME"),
    ],
)
def test_what_is_refused_is_one_sentence(run, words, expected):
    status, out, err = run(*words)
    assert (status, out) == (2, "")
    assert expected in err
    assert err.startswith("usnet: ")
    assert err.count("\n") == 1
