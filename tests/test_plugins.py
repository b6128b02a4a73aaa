"""Detectors by name: built in, installed, registered, or a class of a module."""

import numpy as np
import pytest

from usnet_env import ArgumentError, Detection
from usnet_env.cli import main
from usnet_env.detection import Tags
from usnet_env.plugins import DETECTORS, detector_label, make_detector, register_detector

BUILT_IN = ["destroy-all", "lagged-correlation", "lagged-regression", "none", "one-per-round", "random"]


class Mine:
    """Names the first few.

    More about it.
    """

    tags = Tags(uses_positions=False)

    def __init__(self, count=2, *, table=()):
        self.count = count
        self.table = table

    def reset(self, seed=None):
        pass

    def detect(self, window):
        candidates = np.arange(window.uavs) < self.count
        return Detection(candidates, candidates)


class NeedsOne(Mine):
    def __init__(self, count):
        super().__init__(count)


class Lacking:
    def detect(self, window):
        return None


@pytest.fixture(autouse=True)
def no_registrations(monkeypatch):
    monkeypatch.setattr(DETECTORS, "registered", {})


@pytest.fixture
def stranger(monkeypatch, declare):
    """Installs a package with a good and a broken detector."""
    monkeypatch.setattr(DETECTORS, "_loaded", {})
    broken = ("broken_stranger", "raise OSError('no\\nlicence')\n")
    mine = f"{__name__}:Mine"
    declare(DETECTORS.group, broken, stranger=mine, random=mine, broken="broken_stranger:X")


def list_lines(capsys):
    assert main(["list", "detectors"]) == 0
    *lines, hint = capsys.readouterr().out.splitlines()
    assert hint.startswith("Start with reader")
    return {line.split()[0]: line.partition(" ")[2].strip() for line in lines}


def test_every_detector_has_a_line_and_its_tags(capsys):
    register_detector("mine", Mine)
    lines = list_lines(capsys)
    assert list(lines) == ["reader", *sorted(set(DETECTORS) - {"reader"})]  # the recommended one first
    assert all(". (" in lines[name] for name in BUILT_IN)
    assert "made for 1 m per step" in lines["one-per-round"]
    assert lines["mine"] == "Names the first few. (velocities only)"


def test_arguments_in_brackets_and_beside_them():
    for detector in (
        make_detector("lagged-regression(clusters=5, ridge=-1e-3)"),
        make_detector("lagged-regression", clusters=5, ridge=-1e-3),
        make_detector(" lagged-regression ( ridge = -1e-3 )", clusters=5),
    ):
        assert detector.get_params() == {"clusters": 5, "lags": 4, "squares": True, "ridge": -1e-3}
    made = make_detector(f"{__name__}:Mine(count=3, table={{'a': [1, (2, None)]}})")
    assert type(made).__name__ == "Mine"
    assert (made.count, made.table) == (3, {"a": [1, (2, None)]})


@pytest.mark.parametrize(
    ("name", "arguments", "sentence"),
    [
        ("lagged-regresion", {}, r"detector must be one of .* \(did you mean 'lagged-regression'\?\)\."),
        ("lagged-regression", {"cluster": 5}, "cluster is not an argument of detector 'lagged-regression' .*'clusters"),
        ("none(x=1)", {}, r"x is not an argument of detector 'none'; it takes none\."),
        (".relative:X", {}, r"detector '\.relative:X' can't be loaded: .*\."),
        ("math:pi", {}, r"detector 'math:pi' must be a class or a function, got 3\.14.*\."),
        (f"{__name__}:Lacking", {}, r"detector '.*:Lacking' must have the methods detect\(window\) and reset\(seed\)"),
        (f"{__name__}:NeedsOne", {}, r"detector '.*:NeedsOne' is missing a required argument: 'count'"),
    ],
)
def test_each_mistake_has_its_sentence(name, arguments, sentence):
    with pytest.raises(ArgumentError, match=rf"^{sentence}"):
        make_detector(name, **arguments)


def test_a_detector_is_registered_by_a_class_or_a_function():
    register_detector("mine", Mine)
    register_detector("five", lambda extra=0: Mine(count=5))
    assert {"mine", "five"} <= set(DETECTORS)
    assert make_detector("mine(count=4)").count == 4
    assert make_detector("five(extra=1)").count == 5
    with pytest.raises(ArgumentError, match=r"^detector must be a class or a function"):
        register_detector("other", Mine())


def test_labels():
    register_detector("mine", Mine)
    assert detector_label("lagged-regression( ridge=0.1,clusters=5 )") == "lagged-regression(clusters=5, ridge=0.1)"
    assert detector_label(make_detector("lagged-regression", clusters=5, lags=4)) == "lagged-regression(clusters=5)"
    assert detector_label(make_detector("detectors.lagged:OnePerRound")) == "one-per-round"
    assert detector_label(Mine(count=3)) == "mine(count=3)"
    assert detector_label(Mine(table=np.arange(3))) == "mine(table=array([0, 1, 2]))"
    assert detector_label(NeedsOne(7)) == "NeedsOne(count=7)"


def test_an_installed_detector_is_found_and_a_broken_one_does_not_affect_others(stranger, capsys):
    assert detector_label(make_detector("stranger(count=9)")) == "stranger(count=9)"
    assert type(make_detector("random")).__name__ == "RandomDetector"
    lines = list_lines(capsys)
    assert lines["stranger"].startswith("Names the first few.")
    assert lines["broken"] == "not available: detector 'broken' can't be loaded: OSError: no licence."
    with pytest.raises(ArgumentError, match=r"^detector 'broken' can't be loaded: OSError: no licence\.$"):
        make_detector("broken")
    with pytest.raises(ArgumentError, match="the name of an installed detector"):
        register_detector("stranger", NeedsOne)
