"""What a user reads when a detector fails or is none: one sentence, with the line of the detector's code."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from sample_detectors import AllAlive, Failing, FailingWithOne, interrupt

from usnet_env import ArgumentError, Detection, Window, evaluate, make_detector
from usnet_env.evaluation import EvaluationError, EvaluationResult
from usnet_env.evaluation.store import RunStore

MULTI = "USNET/MultiCluster-v0"
SMALL = {"clusters": 3, "uavs": 20, "observation_steps": 20, "max_rounds": 5}


@pytest.mark.parametrize("how", [{}, {"workers": 2}, {"time_limit": 60}, {"isolate": True}])
@pytest.mark.parametrize("detector", [FailingWithOne(), "sample_detectors:FailingWithOne"])
def test_a_failure_names_the_line_of_the_detector_and_no_folder(detector, how):
    with pytest.raises(EvaluationError) as failed:
        evaluate(MULTI, detector, episodes=2, env_kwargs=SMALL, **how)
    source = Path(__file__).with_name("sample_detectors.py").read_text().splitlines()
    (line,) = (number for number, text in enumerate(source, 1) if "no luck" in text)
    assert str(failed.value).endswith(
        f"failed in its warm-up: ZeroDivisionError: no luck (sample_detectors.py, line {line}, in detect)."
    )
    assert failed.value.__cause__ is not None
    assert list(failed.value.failures) == [str(failed.value).split("'")[1]]


class WrongCandidates(AllAlive):
    def detect(self, window):
        return Detection(np.array([1, 2]), np.zeros(window.uavs))


@pytest.mark.parametrize("how", [{}, {"workers": 2}, {"isolate": True}])
def test_a_detection_that_is_refused_is_found_at_the_line_that_makes_it(how):
    """Not in the ``__init__`` that Python generates for a dataclass, which has no file."""
    with pytest.raises(EvaluationError, match=r"got array\(\[1, 2\]\) \(test_failures\.py, line \d+, in detect\)\.$"):
        evaluate(MULTI, WrongCandidates(), episodes=2, env_kwargs=SMALL, **how)


class OutOfRange(AllAlive):
    def detect(self, window):
        return make_detector("random").detect(window).candidates.reshape(3, -1)[:, [99]]


def test_an_error_in_a_library_is_found_at_the_line_that_calls_it():
    with pytest.raises(EvaluationError, match=r"IndexError: .* \(test_failures\.py, line \d+, in detect\)\.$"):
        evaluate(MULTI, OutOfRange(), episodes=1, env_kwargs=SMALL | {"uavs": 21})


class WithoutReset:
    def detect(self, window):
        raise NotImplementedError


class Answering:
    """A policy without a state."""

    def __init__(self, answer):
        self.answer = answer

    def predict(self, observation, state=None, episode_start=None, deterministic=False):
        return self.answer


@pytest.mark.parametrize(
    ("detector", "message"),
    [
        (AllAlive, r"^detector must be an object, got the class AllAlive; AllAlive\(\) makes an object of it\.$"),
        (Answering, r"^detector must be an object, got the class Answering; Answering\(\) makes an object of it\.$"),
        (WithoutReset(), r"^detector must have the method reset\(seed\) beside detect, got <"),
        (
            int,
            r"^detector must be a name, an object with detect and reset, or an object with predict, got <class 'int'",
        ),
        (Answering(np.zeros(20)), r"failed in its warm-up: predict must return an action and a state, got array"),
        (Answering(None), r"failed in its warm-up: predict must return an action and a state, got None\.$"),
    ],
)
def test_what_is_no_detector_is_refused_in_one_sentence(detector, message):
    with pytest.raises((ArgumentError, EvaluationError), match=message):
        evaluate(MULTI, {"mine": detector}, episodes=1, env_kwargs=SMALL)


@pytest.mark.parametrize("name", ["random", "lagged-regression", "follow-mixture"])
def test_a_detector_that_gets_an_observation_says_how_to_make_a_window_of_it(name):
    import gymnasium as gym

    observation, _ = gym.make(MULTI, **SMALL).reset(seed=0)
    detector = make_detector(name)
    detector.reset(0)
    with pytest.raises(ArgumentError, match=r"^window must be a usnet_env\.Window, .* Window\.from_observation\("):
        detector.detect(observation)
    assert len(detector.detect(Window.from_observation(observation)).candidates) == 20


def play_with_a_failure(folder, **how):
    with pytest.raises(EvaluationError) as failed:
        evaluate(MULTI, ["none", "random", Failing()], episodes=6, env_kwargs=SMALL, out=folder, **how)
    return failed.value


@pytest.mark.parametrize("isolate", [False, True])
def test_a_folder_is_loaded_without_the_episodes_that_a_failed_detector_survived(tmp_path, isolate):
    error = play_with_a_failure(tmp_path, isolate=isolate)
    loaded = EvaluationResult.load(tmp_path)
    assert loaded.summary == error.result.summary == json.loads((tmp_path / "summary.json").read_text())
    assert [entry["detector"] for entry in loaded.summary] == ["none", "random"]
    assert list(loaded.rows) == list(error.result.rows)
    assert dict(loaded.failures) == dict(error.failures) == dict(error.result.failures)
    assert "Failing" not in loaded.conclusion()
    assert "1 failed" in repr(loaded)
    assert "nothing to divide by" in loaded._repr_html_()
    assert "Failing" in (tmp_path / "episodes.csv").read_text()  # what it played is kept


class Mended(AllAlive):
    """Another detector under the label of :class:`Failing`."""


def test_a_detector_that_has_failed_may_come_back_with_other_code(tmp_path):
    play_with_a_failure(tmp_path)
    others = [row for row in EvaluationResult.load(tmp_path).rows if row["detector"] != "Failing"]
    result = evaluate(
        MULTI, {"none": "none", "random": "random", "Failing": Mended()}, episodes=6, env_kwargs=SMALL, out=tmp_path
    )
    assert [row for row in result.rows if row["detector"] != "Failing"] == others
    assert not result.failures
    loaded = EvaluationResult.load(tmp_path)
    assert loaded.summary == result.summary
    own = [row["episode"] for row in loaded.rows if row["detector"] == "Failing"]
    assert own == list(range(6))
    assert np.isclose(loaded["Failing"]["redundancy"]["mean"], (20 - 3) / 20)
    with pytest.raises(ArgumentError, match=r"^out must be a new folder .* in which detector 'random'"):
        evaluate(MULTI, {"random": Mended()}, episodes=6, env_kwargs=SMALL, out=tmp_path)


def test_a_detector_that_failed_by_accident_plays_the_rest_when_it_is_asked_again(tmp_path):
    play_with_a_failure(tmp_path)
    (tmp_path / "episodes.csv").write_bytes((tmp_path / "episodes.csv").read_bytes().replace(b"\n", b"\r\n"))
    assert EvaluationResult.load(tmp_path).failures
    result = evaluate(MULTI, ["none"], episodes=6, env_kwargs=SMALL, out=tmp_path)
    assert [entry["detector"] for entry in result.summary] == ["none", "random"]
    assert list(result.failures) == ["Failing"]


def test_a_detector_that_fails_before_its_first_row_leaves_the_folder_usable(tmp_path):
    evaluate(MULTI, ["none"], episodes=2, env_kwargs=SMALL, out=tmp_path)
    with pytest.raises(EvaluationError):
        evaluate(MULTI, ["none", FailingWithOne()], episodes=2, env_kwargs=SMALL, out=tmp_path)
    result = evaluate(MULTI, ["none"], episodes=2, env_kwargs=SMALL, out=tmp_path)
    assert [entry["detector"] for entry in result.summary] == ["none"]
    assert list(result.failures) == ["FailingWithOne"]


def test_rows_of_the_old_code_are_gone_before_the_new_code_is_described(tmp_path, monkeypatch):
    """A kill between the two writes leaves a folder in which the detector still has failed."""
    play_with_a_failure(tmp_path)
    mended = {"none": "none", "random": "random", "Failing": Mended()}
    with monkeypatch.context() as killed:
        killed.setattr(RunStore, "_describe", lambda *_: interrupt())
        with pytest.raises(KeyboardInterrupt):
            evaluate(MULTI, mended, episodes=6, env_kwargs=SMALL, out=tmp_path)
    assert EvaluationResult.load(tmp_path).failures
    result = evaluate(MULTI, mended, episodes=6, env_kwargs=SMALL, out=tmp_path)
    assert np.isclose(result["Failing"]["redundancy"]["mean"], (20 - 3) / 20)


def test_a_failure_is_kept_while_the_others_still_play(tmp_path):
    seen = []

    class Watching(AllAlive):
        def reset(self, seed=None):
            if (tmp_path / "run.json").exists():
                seen.append("failures" in json.loads((tmp_path / "run.json").read_text()))

    with pytest.raises(EvaluationError):
        evaluate(MULTI, {"a": Failing(), "b": Watching()}, episodes=6, env_kwargs=SMALL, out=tmp_path)
    assert seen[-1]


def test_results_with_failures_can_be_merged(tmp_path):
    ours = play_with_a_failure(tmp_path).result
    other = evaluate(MULTI, {"Failing": Mended()}, episodes=6, env_kwargs=SMALL)
    for joined in (ours.merge(other), other.merge(ours)):
        assert {entry["detector"] for entry in joined.summary} == {"none", "random", "Failing"}
        assert not joined.failures
    more = evaluate(MULTI, "destroy-all", episodes=6, env_kwargs=SMALL)
    assert list(ours.merge(more).failures) == ["Failing"]
