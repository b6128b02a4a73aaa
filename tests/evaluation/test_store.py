"""The folder of a run: atomic files, interruption, resuming, and refusal of another run's folder."""

from __future__ import annotations

import json
import os
import platform
import shutil
from functools import partial

import gymnasium as gym
import numpy as np
import pytest
from sample_detectors import AllAlive, Base, Failing, Followed, Policy, RandomThird

from usnet_env import ArgumentError, Detection, evaluate
from usnet_env.envs import FieldEnv
from usnet_env.evaluation import EvaluationError, EvaluationResult
from usnet_env.evaluation.store import COLUMNS, write_text
from usnet_env.swarm.follow import StayInRange

MULTI = "USNET/MultiCluster-v0"
SMALL = {"clusters": 3, "uavs": 20, "observation_steps": 20, "max_rounds": 5}


class Counted(Base):
    """Answers like RandomThird; counts the episodes that it has begun, and can be interrupted in one of them."""

    def __init__(self):
        self.begun = 0
        self.interrupt_at = None

    def reset(self, seed=None):
        super().reset(seed)
        self.begun += 1

    def detect(self, window):
        if self.begun == self.interrupt_at:
            raise KeyboardInterrupt
        scores = self.rng.random(window.uavs)
        return Detection((scores > 0.67) & window.alive, scores)

    def __deepcopy__(self, memo):
        return Counted()


def untimed(rows):
    return [{name: value for name, value in row.items() if name != "seconds_per_round"} for row in rows]


def files(folder):
    return {path.name for path in folder.iterdir()}


def test_a_run_leaves_its_rows_summary_and_config(tmp_path):
    out = tmp_path / "runs" / "first"
    result = evaluate(MULTI, [RandomThird(), Followed()], episodes=3, seed=5, env_kwargs=SMALL, out=out)
    assert files(out) == {"run.json", "episodes.csv", "summary.json"}
    assert json.loads((out / "summary.json").read_text()) == result.summary
    lines = (out / "episodes.csv").read_text().splitlines()
    assert lines[0] == ",".join(COLUMNS)
    assert len(lines) == 7
    run = json.loads((out / "run.json").read_text())
    assert run["config"] == result.config
    assert run["config"]["seed"] == 5
    assert run["config"]["environment"]["config"]["uavs"] == 20
    assert {"python", "usnet", "numpy", "gymnasium"} <= set(run["versions"])
    assert set(run["machine"]) == {"cpu", "cores", "platform"}
    text = (out / "run.json").read_text()
    assert platform.node() not in text
    assert str(tmp_path) not in text


def test_a_finished_run_is_read_and_not_repeated(tmp_path):
    detector = Counted()
    first = evaluate(MULTI, detector, episodes=3, env_kwargs=SMALL, out=tmp_path)
    again = evaluate(MULTI, detector, episodes=3, env_kwargs=SMALL, out=tmp_path)
    assert again.rows == first.rows  # including the seconds, which are those of the first run
    assert again.summary == first.summary
    assert detector.begun == 3


def test_an_interrupted_run_resumes_where_it_stopped(tmp_path):
    whole = evaluate(MULTI, [Counted(), AllAlive()], episodes=5, env_kwargs=SMALL)
    detector = Counted()
    detector.interrupt_at = 3
    with pytest.raises(KeyboardInterrupt):
        evaluate(MULTI, [detector, AllAlive()], episodes=5, env_kwargs=SMALL, out=tmp_path)
    assert files(tmp_path) == {"run.json", "episodes.csv"}
    assert len((tmp_path / "episodes.csv").read_text().splitlines()) == 1 + 2 * 2
    detector.interrupt_at = None
    resumed = evaluate(MULTI, [detector, AllAlive()], episodes=5, env_kwargs=SMALL, out=tmp_path)
    assert untimed(resumed.rows) == untimed(whole.rows)
    assert detector.begun == 3 + 3  # two whole episodes and the broken one, then the three that were missing


def test_a_run_may_resume_with_another_number_of_workers(tmp_path):
    detector = RandomThird()
    whole = evaluate(MULTI, [detector, AllAlive()], episodes=4, env_kwargs=SMALL, out=tmp_path)
    lines = (tmp_path / "episodes.csv").read_text().splitlines(keepends=True)
    (tmp_path / "episodes.csv").write_text("".join(lines[:3]))
    resumed = evaluate(MULTI, [detector, AllAlive()], episodes=4, env_kwargs=SMALL, out=tmp_path, workers=2)
    assert untimed(resumed.rows) == untimed(whole.rows)
    assert resumed.rows[:2] == whole.rows[:2]


def test_a_row_that_a_killed_run_has_torn_is_played_again_and_the_rows_are_sorted(tmp_path):
    detectors = [Counted(), AllAlive()]
    whole = evaluate(MULTI, detectors, episodes=3, env_kwargs=SMALL, out=tmp_path)
    header, *lines = (tmp_path / "episodes.csv").read_text().splitlines(keepends=True)
    played = [lines[3], lines[0], lines[4], lines[1][:-3]]  # in the order in which a run appends them
    (tmp_path / "episodes.csv").write_text("".join([header, *played]))
    detectors[0].begun = 0
    resumed = evaluate(MULTI, detectors, episodes=3, env_kwargs=SMALL, out=tmp_path)
    assert untimed(resumed.rows) == untimed(whole.rows)
    assert detectors[0].begun == 2
    kept = (tmp_path / "episodes.csv").read_text().splitlines(keepends=True)
    assert [kept[1], kept[4], kept[5]] == [lines[0], lines[3], lines[4]]


def test_more_episodes_and_detectors_join_a_run_and_its_rows_stay(tmp_path):
    first = Counted()
    asked = {"env_kwargs": SMALL, "seed": 4, "out": tmp_path}
    evaluate(MULTI, first, episodes=2, **asked)
    kept = (tmp_path / "episodes.csv").read_text().splitlines()
    more = evaluate(MULTI, first, episodes=3, **asked)
    assert first.begun == 3
    assert [entry["episodes"] for entry in more.summary] == [3]
    other = AllAlive()
    both = evaluate(MULTI, other, episodes=3, **asked)
    assert first.begun == 3
    assert (tmp_path / "episodes.csv").read_text().splitlines()[:3] == kept
    assert untimed(both.rows) == untimed(evaluate(MULTI, [first, other], episodes=3, seed=4, env_kwargs=SMALL).rows)
    assert both.config["detectors"] == ["Counted", "AllAlive"]
    assert json.loads((tmp_path / "run.json").read_text())["config"] == both.config
    assert json.loads((tmp_path / "summary.json").read_text()) == both.summary
    longer = evaluate(MULTI, AllAlive(), episodes=5, **asked)
    assert [entry["episodes"] for entry in longer.summary] == [3, 5]


def test_a_run_that_others_are_joining_has_no_summary_until_they_have_played(tmp_path):
    asked = {"env_kwargs": SMALL, "episodes": 3, "out": tmp_path}
    evaluate(MULTI, AllAlive(), **asked)
    broken = Counted()
    broken.interrupt_at = 2
    with pytest.raises(KeyboardInterrupt):
        evaluate(MULTI, broken, **asked)
    assert files(tmp_path) == {"run.json", "episodes.csv"}
    assert [entry["episodes"] for entry in EvaluationResult.load(tmp_path).summary] == [3, 1]


@pytest.mark.parametrize("isolate", [False, True])
def test_a_folder_is_loaded_as_its_run_returned_it(tmp_path, isolate):
    result = evaluate(MULTI, [AllAlive(), RandomThird()], episodes=2, env_kwargs=SMALL, out=tmp_path, isolate=isolate)
    loaded = EvaluationResult.load(tmp_path)
    assert loaded.rows == result.rows
    assert loaded.summary == result.summary
    assert loaded.config == result.config
    with pytest.raises(ArgumentError, match=r"^folder must be the folder of a run, .* without run\.json"):
        EvaluationResult.load(tmp_path / "other")


def test_a_failing_detector_loses_no_finished_episode(tmp_path):
    with pytest.raises(EvaluationError):
        evaluate(MULTI, Failing(), episodes=5, env_kwargs=SMALL, out=tmp_path)
    assert len((tmp_path / "episodes.csv").read_text().splitlines()) == 1 + 2


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"seed": 1}, r"out must be .* with a run that has different values of seed\."),
        ({"episodes": 1}, r"episodes must be at least 2, those of the run in '.*', got 1\."),
        (
            {"detector": {"RandomThird": Followed(2)}},
            r"out must be .* with a run in which detector 'RandomThird' is 'sample_detectors:RandomThird' instead of "
            r"'sample_detectors:Followed'\.",
        ),
        ({"env_kwargs": SMALL | {"follow": "f2"}}, r"out must be .* different values of env_kwargs, environment\."),
        ({"env": "USNET/MultiCluster-Smooth-v0"}, r"out must be .* different values of env, environment\."),
    ],
)
def test_another_run_s_folder_is_refused(tmp_path, changes, message):
    asked = {"env": MULTI, "detector": RandomThird(), "episodes": 2, "env_kwargs": SMALL, "out": tmp_path}
    evaluate(**asked)
    before = (tmp_path / "episodes.csv").read_bytes()
    with pytest.raises(ArgumentError, match=f"^{message}$"):
        evaluate(**(asked | changes))
    assert (tmp_path / "episodes.csv").read_bytes() == before


LONG = "x" * 200


class Described(RandomThird):
    """Takes any argument; ``reset`` refuses a number below 0."""

    def __init__(self, what=None):
        self.what = what

    def reset(self, seed=None):
        if isinstance(self.what, int) and self.what < 0:
            raise ArgumentError(f"what must be at least 0, got {self.what}.")
        super().reset(seed)


@pytest.mark.parametrize(
    ("first", "second"),
    [
        (LONG + "a", LONG + "b"),
        (list(range(200)), list(range(201))),
        (np.arange(500.0), np.arange(500.0) + 1),
        (lambda window: window, lambda window: None),
        (partial(max, 1), partial(max, 2)),
        (AllAlive(), RandomThird()),
        (Followed(2), Followed(3)),
    ],
)
def test_detectors_whose_arguments_differ_anywhere_do_not_share_rows(tmp_path, first, second):
    asked = {"episodes": 1, "env_kwargs": SMALL, "out": tmp_path}
    evaluate(MULTI, {"mine": Described(first)}, **asked)
    evaluate(MULTI, {"mine": Described(first)}, **asked)
    with pytest.raises(ArgumentError, match=r"in which detector 'mine' has what = .* instead of "):
        evaluate(MULTI, {"mine": Described(second)}, **asked)


def test_policies_with_other_weights_do_not_share_rows(tmp_path):
    class Network(Policy):
        def __init__(self, weight):
            super().__init__()
            self.weight = weight

        def state_dict(self):
            return {"weight": np.array(self.weight)}

    asked = {"episodes": 1, "env_kwargs": SMALL, "out": tmp_path}
    evaluate(MULTI, Network(1.0), **asked)
    evaluate(MULTI, Network(1.0), **asked)
    with pytest.raises(ArgumentError, match="in which detector 'Network' has other weights"):
        evaluate(MULTI, Network(1.5), **asked)


class Trained:
    """A policy without ``state_dict``, which gets its numbers after its constructor."""

    def __init__(self):
        self.calls = 0
        self.layers = {"first": [np.zeros(20)], "bias": 0.0}

    def predict(self, observation, state=None, episode_start=None, deterministic=False):
        self.calls += 1
        return (self.layers["first"][0] > 0).astype(np.int8), state


def test_policies_that_were_trained_otherwise_do_not_share_rows(tmp_path):
    asked = {"episodes": 2, "env_kwargs": SMALL, "out": tmp_path}
    policy, other, third = Trained(), Trained(), Trained()
    evaluate(MULTI, policy, **asked)
    evaluate(MULTI, policy, **asked)  # what it has counted since does not matter
    other.layers["first"][0] = np.ones(20)
    third.layers["bias"] = 0.5
    for each in (other, third):
        with pytest.raises(ArgumentError, match="in which detector 'Trained' has other weights"):
            evaluate(MULTI, each, **asked)


def test_follow_strategies_given_as_objects_do_not_share_rows(tmp_path):
    def run(pull):
        evaluate(MULTI, "none", episodes=1, env_kwargs=SMALL | {"follow": StayInRange(pull=pull)}, out=tmp_path)

    run(1.0)
    run(1.0)
    with pytest.raises(ArgumentError, match="different values of env_kwargs, environment"):
        run(2.0)


def test_a_field_is_identified_by_its_arguments_and_never_by_what_it_drew(tmp_path):
    arguments = {"observation_steps": 4, "max_rounds": 1}
    drawing, fixed = (lambda: FieldEnv(**arguments)), (lambda: FieldEnv(**arguments, clusters=6))
    assert drawing().config == fixed().config  # six is the most that can be drawn
    evaluate(fixed(), "none", episodes=1, out=tmp_path / "fixed")
    with pytest.raises(ArgumentError, match=r"with a run that has different values of env_kwargs\."):
        evaluate(drawing(), "none", episodes=2, out=tmp_path / "fixed")
    env = drawing()
    evaluate(env, "none", episodes=2, out=tmp_path / "drawn")
    resumed = evaluate(env, "none", episodes=3, out=tmp_path / "drawn")
    assert untimed(resumed.rows) == untimed(evaluate(drawing(), "none", episodes=3).rows)


def test_an_object_and_the_id_of_a_field_share_a_folder(tmp_path):
    delays = "USNET/Field-Delays-v0"
    for env_id, arguments in ((delays, {}), ("USNET/Field-v0", {"clusters": 3})):
        evaluate(env_id, "none", episodes=1, env_kwargs=arguments, out=tmp_path / env_id)
        assert len(evaluate(gym.make(env_id, **arguments), "none", episodes=2, out=tmp_path / env_id).rows) == 2
    with pytest.raises(ArgumentError, match="different values of env_kwargs"):
        evaluate(gym.make(delays, follow=None), "none", episodes=2, out=tmp_path / delays)


def test_rows_of_another_seed_are_refused(tmp_path):
    asked = {"env": MULTI, "detector": RandomThird(), "episodes": 2, "env_kwargs": SMALL, "out": tmp_path}
    evaluate(**asked, seed=1)
    foreign = (tmp_path / "episodes.csv").read_text()
    evaluate(**asked | {"out": tmp_path / "other"}, seed=2)
    (tmp_path / "other" / "episodes.csv").write_text(foreign)
    with pytest.raises(ArgumentError, match=r"^out must hold only rows of this run, got rows of another seed\."):
        evaluate(**asked | {"out": tmp_path / "other"}, seed=2)


class Nested(RandomThird):
    """Evaluates into the folder in which it is being evaluated, as a second run at the same time would."""

    def __init__(self, out):
        self.out = out

    def detect(self, window):
        evaluate(MULTI, RandomThird(), episodes=1, env_kwargs=SMALL, out=self.out)


def test_two_runs_at_once_do_not_share_a_folder(tmp_path):
    with pytest.raises(
        EvaluationError, match=rf"out must be a folder that no other run uses, .* which process {os.getpid()} uses \("
    ):
        evaluate(MULTI, Nested(tmp_path / "run"), episodes=1, env_kwargs=SMALL, out=tmp_path / "run")
    assert files(tmp_path) == set()


def test_the_lock_of_a_killed_run_is_no_obstacle(tmp_path):
    (tmp_path / ".run.json.lock").write_text("4000000\n")
    evaluate(MULTI, RandomThird(), episodes=1, env_kwargs=SMALL, out=tmp_path)
    assert files(tmp_path) == {"run.json", "episodes.csv", "summary.json"}


def test_a_refused_run_leaves_nothing_and_the_corrected_one_is_accepted(tmp_path):
    asked = {"episodes": 1, "env_kwargs": SMALL, "out": tmp_path / "new" / "run"}
    with pytest.raises(ArgumentError, match=r"^detector 'Described.*' refuses an argument: what must be at least 0"):
        evaluate(MULTI, [RandomThird(), Described(-1)], **asked)
    assert files(tmp_path) == set()
    evaluate(MULTI, [RandomThird(), Described(1)], **asked)


class Removing(RandomThird):
    """Removes the folder of the run in the second episode, as an impatient user would."""

    def __init__(self, out):
        self.out = out
        self.begun = 0

    def reset(self, seed=None):
        super().reset(seed)
        self.begun += 1
        if self.begun == 2:
            shutil.rmtree(self.out)

    def __deepcopy__(self, memo):
        return RandomThird()


def test_a_folder_that_is_removed_during_the_run_is_an_error(tmp_path):
    with pytest.raises(ArgumentError, match=r"^out must stay as it is during a run, .* was removed"):
        evaluate(MULTI, Removing(tmp_path / "run"), episodes=3, env_kwargs=SMALL, out=tmp_path / "run")


def test_the_rows_of_the_other_detectors_are_kept_and_the_run_can_be_completed(tmp_path):
    failing, steady = Failing(), Counted()
    asked = {"episodes": 5, "env_kwargs": SMALL, "out": tmp_path}
    with pytest.raises(EvaluationError, match="'Failing' failed in episode 2"):
        evaluate(MULTI, [failing, steady], **asked)
    assert len((tmp_path / "episodes.csv").read_text().splitlines()) == 1 + 2 + 5
    failing.episodes = 10  # it never fails again
    assert len(evaluate(MULTI, [failing, steady], **asked).rows) == 10
    assert steady.begun == 5


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("run.json", "{"),
        ("run.json", "[]"),
        ("run.json", "{}"),
        ("episodes.csv", ""),
        ("episodes.csv", "a,b\n1,2\n"),
        ("episodes.csv", ",".join(COLUMNS) + "\nRandomThird,x" + "," * (len(COLUMNS) - 2) + "\n"),
        ("episodes.csv", ",".join(COLUMNS) + "\nRandomThird,0\n"),
        ("episodes.csv", ",".join(COLUMNS) + "\nRandomThird,99" + ",0" * (len(COLUMNS) - 2) + "\n"),
    ],
)
def test_an_edited_folder_is_refused(tmp_path, name, text):
    asked = {"env": MULTI, "detector": RandomThird(), "episodes": 2, "env_kwargs": SMALL, "out": tmp_path}
    evaluate(**asked)
    (tmp_path / name).write_text(text)
    with pytest.raises(ArgumentError, match=r"^out must ") as refused:
        evaluate(**asked)
    assert "\n" not in str(refused.value)
    assert (tmp_path / name).read_text() == text


def test_a_row_that_is_there_twice_is_refused(tmp_path):
    asked = {"env": MULTI, "detector": RandomThird(), "episodes": 2, "env_kwargs": SMALL, "out": tmp_path}
    evaluate(**asked)
    lines = (tmp_path / "episodes.csv").read_text().splitlines(keepends=True)
    (tmp_path / "episodes.csv").write_text("".join([*lines, lines[2]]))
    for read in (lambda: EvaluationResult.load(tmp_path), lambda: evaluate(**asked)):
        with pytest.raises(ArgumentError, match=r"each episode of a detector once, got episode 1 of 'RandomThird' tw"):
            read()


def test_a_file_and_rows_without_a_run_are_refused(tmp_path):
    (tmp_path / "file").write_text("mine")
    with pytest.raises(ArgumentError, match=r"^out must be a folder"):
        evaluate(MULTI, RandomThird(), episodes=1, env_kwargs=SMALL, out=tmp_path / "file")
    (tmp_path / "episodes.csv").write_text("mine")
    with pytest.raises(ArgumentError, match=r"^out must be .*no run\.json"):
        evaluate(MULTI, RandomThird(), episodes=1, env_kwargs=SMALL, out=tmp_path)
    assert (tmp_path / "episodes.csv").read_text() == "mine"


def test_a_file_is_written_whole_or_not_at_all(tmp_path):
    path = tmp_path / "text"
    write_text(path, "first\n")
    with pytest.raises(UnicodeEncodeError):
        write_text(path, "second \ud800\n")
    assert path.read_text() == "first\n"
    assert files(tmp_path) == {"text"}
