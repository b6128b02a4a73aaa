"""``usnet check-detector``: its table, and an exit status for scripts."""

from pathlib import Path

import pytest

BROKEN = Path(__file__).parent / "detectors" / "checks"


@pytest.fixture
def check(run, monkeypatch):
    """Runs ``usnet check-detector``."""
    monkeypatch.syspath_prepend(BROKEN)
    return lambda *words: run("check-detector", *words)


def test_a_good_detector_has_a_table_and_status_0(check):
    status, out, err = check("lagged-regression(clusters=2)")
    assert (status, err) == (0, "")
    assert "8 checks: 8 passed" in out


def test_a_broken_one_has_status_1_and_a_reason_unless_it_is_expected(check):
    status, out, err = check("broken_detectors:NamesTheFirst(count=3)")
    assert (status, err) == (1, "")
    assert "permuting the UAVs must permute the detection" in out
    assert "7 passed, 1 failed" in out
    words = ("--expect", "check_order_of_uavs=it goes by the index = by habit")
    status, out, _ = check("broken_detectors:NamesTheFirst", *words)
    assert status == 0
    assert "it goes by the index = by habit (permuting" in out


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (("no-such-detector",), "detector must be one of"),
        (("random", "--expect", "check_all=x"), "must be one of"),
        ((), "NAME"),
    ],
)
def test_what_is_refused_is_one_sentence(check, words, expected):
    status, out, err = check(*words)
    assert (status, out) == (2, "")
    assert expected in err
    assert err.count("\n") == 1
