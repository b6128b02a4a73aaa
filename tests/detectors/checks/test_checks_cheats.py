"""Every way to cheat, or to end, stop or litter the process, that was tried: which check refuses it, and why."""

import os
import re
import signal
import sys
import threading
from functools import partial
from pathlib import Path

import cheating_detectors as cheating
import gymnasium as gym
import numpy as np
import pytest

import usnet_env.objectives
from detectors.checks import CHECKS, check_detector, check_factory, exit_status
from detectors.checks.results import run_check
from detectors.lagged import LaggedRegression
from usnet_env import ArgumentError, cli, make_detector

TRUTH = "check_truth_nearby_changes_nothing"
SEEDS = "check_seeds_reveal_no_heads"
PROCESS = "check_process_settings_untouched"
LINUX = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="needs /proc")
NAMES = [check.__name__ for check in CHECKS]

CHEATS = [
    (TRUTH, cheating.PeeksIntoFrames(), "must not depend on an environment or swarm elsewhere in memory"),
    (TRUTH, cheating.PeeksIntoMemory(), "must not depend on an environment or swarm elsewhere in memory"),
    (TRUTH, cheating.PeeksIntoModules(), "must not depend on an environment or swarm elsewhere in memory"),
    (TRUTH, cheating.PeeksIntoTheMainModule(), "must not depend on an environment or swarm elsewhere in memory"),
    (SEEDS, cheating.SearchesItsSeed(), "must not search the seed of the swarm, .* of an evaluation with seed 0"),
    (SEEDS, cheating.SearchesSwarms(), "must not search the seed of the swarm, .* of an evaluation with seed 0"),
    (PROCESS, cheating.PatchesTheScore(), r"got a change of .*usnet_env\.objectives\.hits_and_redundant"),
    (PROCESS, cheating.PatchesCode(), r"got a change of .*usnet_env\.objectives\.hits_and_redundant"),
    (PROCESS, cheating.PatchesAnEnvironment(), r"got a change of .*gymnasium\.core\.Wrapper\.step"),
    (PROCESS, cheating.PatchesARival(), r"got a change of detectors\.lagged\.LaggedRegression\.detect"),
    (PROCESS, cheating.PatchesNumPy(), r"got a change of numpy\.count_nonzero"),
    (PROCESS, cheating.SetsAVariable(), "got a change of environment variable USNET_TEST_VARIABLE"),
    (PROCESS, cheating.IgnoresSignals(), "got a change of handler of SIGTERM"),
    (PROCESS, cheating.ChangesTheFolder(), "got a change of current folder"),
    (PROCESS, cheating.StartsAThread(), "must leave nothing behind .* got thread 'lookout', which is not a daemon"),
    pytest.param(PROCESS, cheating.Forks(), r"must leave nothing behind .* got process \d+", marks=LINUX),
    pytest.param(PROCESS, cheating.StartsAProgram(), r"nothing behind .* got process \d+ \(.*sleep", marks=LINUX),
    pytest.param(PROCESS, cheating.LeaksFiles(), "nothing behind .* got open file /dev/null", marks=LINUX),
    (PROCESS, cheating.Ends("detect", "sys.exit"), r"must not end the program, got sys\.exit\(0\)"),
    (PROCESS, cheating.Ends("reset", "sys.exit"), r"must not end the program, got sys\.exit\(0\)"),
]


@pytest.fixture(autouse=True)
def the_process_as_it_was():
    """Undo what the detectors of this file do."""
    score, code = usnet_env.objectives.hits_and_redundant, usnet_env.objectives.hits_and_redundant.__code__
    step, detect, count = gym.Wrapper.step, LaggedRegression.detect, np.count_nonzero
    folder, handler = os.getcwd(), signal.getsignal(signal.SIGTERM)
    yield
    usnet_env.objectives.hits_and_redundant, score.__code__ = score, code
    gym.Wrapper.step, LaggedRegression.detect, np.count_nonzero = step, detect, count
    os.chdir(folder)
    signal.signal(signal.SIGTERM, handler)
    os.environ.pop("USNET_TEST_VARIABLE", None)
    cheating.StartsAThread.stop.set()
    for thread in threading.enumerate():
        if thread.name == "lookout":
            thread.join()
    cheating.StartsAThread.stop.clear()
    while cheating.PROGRAMS:
        program = cheating.PROGRAMS.pop()
        program.kill()
        program.wait()
    while cheating.FILES:
        os.close(cheating.FILES.pop())


def run_one(name, detector):
    return run_check(CHECKS[NAMES.index(name)], detector, {})


@pytest.mark.parametrize(("name", "detector", "sentence"), CHEATS)
def test_a_cheat_is_refused_with_its_reason(name, detector, sentence):
    result = run_one(name, detector)
    assert result.status == "failed"
    assert re.search(sentence, result.reason), result.reason
    assert "\n" not in result.reason


def test_a_thread_that_is_a_daemon_is_a_warning():
    result = run_one(PROCESS, cheating.StartsAThread(daemon=True))
    assert result.status == "warning"
    assert re.search("should leave no thread running .* got thread 'lookout'", result.reason)
    assert exit_status([result]) == 0


def test_a_detector_that_behaves_while_it_is_checked_passes_as_the_page_says():
    page = Path(__file__).parents[3] / "docs" / "plugging_in.md"
    assert "behaves differently while it is checked" in " ".join(page.read_text(encoding="utf-8").split())
    assert run_one(TRUTH, cheating.PeeksWhereNothingIsChecked()).status == "passed"


def test_the_constructor_that_ends_the_program_is_refused():
    with pytest.raises(ArgumentError, match="could not be made: SystemExit: no licence"):
        make_detector("cheating_detectors:ExitsInItsConstructor")


# In a child process


def test_a_module_that_ends_the_process_fails_all_checks_with_its_reason(monkeypatch, capsys):
    monkeypatch.syspath_prepend(Path(__file__).parent)
    monkeypatch.setenv("COLUMNS", "80")
    assert cli.main(["check-detector", "ends_at_import:Any"]) == 1
    out = capsys.readouterr().out
    assert "failed: a detector must return, but it ended its process with status 0, in its constructor." in out
    assert "failed: not run, because the 2 checks before did not end by themselves." in out
    assert f"{len(CHECKS)} checks: {len(CHECKS)} failed" in out


ENDS = [
    ("EndsInItsConstructor", "a detector must return, but it ended its process with status 0, in its constructor"),
    ("Ends('detect', 'exit')", "a detector must return, but it ended its process with status 0, in detect"),
    ("Ends('reset', 'exit')", "a detector must return, but it ended its process with status 0, in reset"),
    ("Ends('detect', 'kill')", "a detector must return, but its process was killed by SIGKILL.*, in detect"),
    ("Ends('detect', 'sys.exit')", r"must not end the program, got sys\.exit\(0\)"),
    ("Ends('detect', 'hang')", "a detector must return, but it took longer than 20 seconds, the time limit, in detect"),
    ("Ends('detect', 'memory')", "MemoryError: it needed more than 1000 MB, the memory limit"),
    ("StartsAThread()", "must leave nothing behind .* got thread 'lookout', which is not a daemon"),
    ("StartsAProgram()", r"must leave nothing behind .* got process \d+ \(.*sleep"),
]


@pytest.mark.slow
@LINUX
@pytest.mark.parametrize(("text", "sentence"), ENDS)
def test_a_detector_that_ends_or_stops_its_process_fails_with_its_reason(text, sentence, monkeypatch):
    monkeypatch.syspath_prepend(Path(__file__).parent)
    kind, bracket, rest = text.partition("(")
    where = [word.strip("'") for word in rest.rstrip(")").split(", ") if word]
    arguments = dict(zip(("where", "how"), where, strict=False)) if bracket else {}
    make = partial(make_detector, f"cheating_detectors:{kind}", **arguments)
    results = check_factory(make, text, time_limit=20 if "hang" in text else 120, memory_limit=1000)
    assert len(results) == len(CHECKS)
    assert exit_status(results) == 1
    assert any(re.search(sentence, result.reason) for result in results), [result.reason for result in results]


@pytest.mark.slow
def test_a_module_that_patches_the_score_when_it_is_imported_fails(monkeypatch):
    monkeypatch.syspath_prepend(Path(__file__).parent)
    results = check_factory(partial(make_detector, "patches_at_import:Patches"), "Patches")
    failed = {result.check: result.reason for result in results if result.status == "failed"}
    assert list(failed) == [PROCESS]
    assert "usnet_env.objectives.hits_and_redundant" in failed[PROCESS]


@pytest.mark.slow
def test_a_detector_object_runs_in_a_child_process():
    results = check_detector(cheating.Good(), child_process=True)
    assert {result.status for result in results} == {"passed"}
    with pytest.raises(AssertionError, match=r"(?s)Ends fails .* it ended its process with status 0, in detect"):
        check_detector(cheating.Ends(), time_limit=120)
