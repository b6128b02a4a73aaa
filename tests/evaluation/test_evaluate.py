"""The evaluator with real environments and small real detectors."""

from __future__ import annotations

import json
import warnings

import gymnasium as gym
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sample_detectors import (
    AllAlive,
    Ending,
    Failing,
    FailingWithOne,
    Followed,
    MaskedPolicy,
    NoDetection,
    NoUav,
    Policy,
    RandomThird,
    Recorder,
    Staying,
    WrongLength,
    WrongPolicy,
)

import usnet_env
from usnet_env import ArgumentError, evaluate
from usnet_env.evaluation import METRICS, TRIVIAL, EvaluationError
from usnet_env.evaluation.episode import episode_seeds

MULTI, SINGLE = "USNET/MultiCluster-v0", "USNET/SingleCluster-v0"
SMALL = {"clusters": 3, "uavs": 20, "observation_steps": 20, "max_rounds": 5}
TIMED = ("seconds_per_round",)


def untimed(rows):
    return [{name: value for name, value in row.items() if name not in TIMED} for row in rows]


def test_destroying_everything_scores_its_formula_exactly():
    result = evaluate(MULTI, AllAlive(), episodes=7, env_kwargs=SMALL)
    assert result["AllAlive"]["J"] == dict.fromkeys(("mean", "low", "high"), 1 + 17 / 20)
    assert result["AllAlive"]["success"]["mean"] == 1
    assert result["AllAlive"]["exact"]["mean"] == 0
    assert result["AllAlive"]["precision_first"]["mean"] == 3 / 20
    assert result["AllAlive"]["recall_first"]["mean"] == 1


def test_episodes_without_candidates_are_truncated_and_counted():
    metrics = evaluate(MULTI, NoUav(), episodes=3, env_kwargs=SMALL)["NoUav"]
    expected = {"J": 5, "rounds": 5, "redundancy": 0, "success": 0, "exact": 0, "precision_first": 0, "f1_first": 0}
    assert {name: metrics[name]["mean"] for name in expected} == expected


def test_a_detector_that_finds_all_is_exact():
    metrics = evaluate(MULTI, Followed(3), episodes=5, env_kwargs=SMALL | {"observation_steps": 60})["Followed"]
    best = (
        "J",
        "rounds",
        "success",
        "exact",
        "precision_first",
        "recall_first",
        "f1_first",
        "ap_first",
        "purity_first",
    )
    assert {name: metrics[name]["mean"] for name in best} == dict.fromkeys(best, 1.0)
    assert metrics["head_in_cluster_first"]["mean"] == 1.0
    assert metrics["redundancy"]["mean"] == 0.0


def test_the_single_cluster_problem_reports_its_own_objective():
    result = evaluate(SINGLE, [NoUav(), AllAlive(), Followed(1)], episodes=4)
    assert [entry["metrics"]["J"]["mean"] for entry in result.summary] == [-1.0, -15.0, 0.0]
    assert [entry["metrics"]["success"]["mean"] for entry in result.summary] == [0.0, 1.0, 1.0]
    assert {row["rounds"] for row in result.rows} == {1}


@pytest.mark.parametrize("env_id", [MULTI, SINGLE])
def test_the_rows_agree_with_the_environment_s_own_count(env_id):
    rows = evaluate(env_id, RandomThird(), episodes=5, seed=3).rows
    env = gym.make(env_id)
    for row in rows:
        detector, over = RandomThird(), False
        detector.reset(row["detector_seed"])
        observation, info = env.reset(seed=row["swarm_seed"])
        while not over:
            detection = detector.detect(usnet_env.Window.from_observation(observation))
            observation, _, terminated, truncated, info = env.step(detection.candidates.astype(np.int8))
            over = terminated or truncated
        assert (row["J"], row["rounds"], row["success"]) == (info["J"], info["round"], info["success"])


def test_over_budget_counts_as_no_answer():
    metrics = evaluate(MULTI, AllAlive(), episodes=2, env_kwargs=SMALL | {"shot_budget": 4})["AllAlive"]
    assert metrics["J"]["mean"] == 5
    assert metrics["recall_first"]["mean"] == metrics["redundancy"]["mean"] == 0


def test_a_price_moves_the_reward_and_not_the_reported_objective():
    plain, priced = (
        evaluate(MULTI, RandomThird(), episodes=3, env_kwargs=SMALL | {"redundancy_price": price}) for price in (1, 9)
    )
    assert untimed(plain.rows) == untimed(priced.rows)


def test_every_detector_meets_the_same_swarms():
    first, second = Recorder(), Recorder()
    evaluate(MULTI, [first, RandomThird(), second], episodes=4, seed=0, env_kwargs=SMALL)
    alone = Recorder()
    evaluate(MULTI, alone, episodes=4, seed=0, env_kwargs=SMALL)
    assert len(alone.windows) == 4
    for other in (first, second):
        assert other.seeds == alone.seeds
        for ours, theirs in zip(alone.windows, other.windows, strict=True):
            assert np.array_equal(ours.position, theirs.position)
    assert len({window.position.tobytes() for window in alone.windows}) == 4


@pytest.mark.parametrize("seed", [0, 7, 2022])
def test_swarm_and_detector_seeds_come_from_two_branches(seed):
    """Against NumPy's own branches: published rows depend on these numbers."""
    recorder = Recorder()
    rows = evaluate(MULTI, recorder, episodes=3, seed=seed, env_kwargs=SMALL).rows
    for row, episode in zip(rows, np.random.SeedSequence(seed).spawn(3), strict=True):
        swarm, detector = episode.spawn(2)
        assert row["swarm_seed"] == int(swarm.generate_state(1, np.uint64)[0]) >> 1
        assert row["detector_seed"] == int(detector.generate_state(1)[0]) >> 1
    assert recorder.seeds == [row["detector_seed"] for row in rows]


def test_no_detector_seed_is_a_part_of_its_swarm_seed():
    """Of one branch, the 31 bits of the detector's seed would be among the 63 bits of the swarm's."""
    seeds = [episode_seeds(seed, episode) for seed in range(4) for episode in range(50)]
    assert len({number for pair in seeds for number in pair}) == 400
    for swarm, detector in seeds:
        assert detector not in {(swarm >> shift) % 2**31 for shift in range(33)}


def test_another_seed_is_another_evaluation_and_the_same_is_the_same():
    runs = [untimed(evaluate(MULTI, RandomThird(), episodes=3, seed=s, env_kwargs=SMALL).rows) for s in (0, 0, 1)]
    assert runs[0] == runs[1] != runs[2]


def test_the_warm_up_leaves_the_detector_alone():
    recorder = Recorder()
    evaluate(MULTI, recorder, episodes=2, env_kwargs=SMALL)
    assert len(recorder.windows) == len(recorder.seeds) == 2


def test_global_generators_are_untouched():
    before = np.random.get_state()[1].copy()  # noqa: NPY002  # the generator that must not change
    evaluate(MULTI, RandomThird(), episodes=2, env_kwargs=SMALL)
    assert np.array_equal(np.random.get_state()[1], before)  # noqa: NPY002


def test_workers_change_nothing_and_one_that_fails_there_stops_no_other():
    detectors = [RandomThird(), Followed(2), Policy()]
    here = evaluate(MULTI, detectors, episodes=4, seed=1, env_kwargs=SMALL)
    sentence = (
        r"'FailingWithOne' failed in its warm-up: ZeroDivisionError: no luck \(sample_detectors\.py, line \d+, in "
    )
    with pytest.raises(EvaluationError, match=sentence) as failed:
        evaluate(MULTI, [*detectors, FailingWithOne()], episodes=4, seed=1, env_kwargs=SMALL, workers=2)
    there = failed.value.result
    assert untimed(here.rows) == untimed(there.rows)
    for ours, theirs in zip(here.summary, there.summary, strict=True):
        assert {k: v for k, v in ours["metrics"].items() if k not in TIMED} == {
            k: v for k, v in theirs["metrics"].items() if k not in TIMED
        }


def test_a_policy_in_stable_baselines_form_is_evaluated():
    policy = Policy()
    result = evaluate(MULTI, policy, episodes=2, env_kwargs=SMALL | {"max_rounds": 20})
    assert result["Policy"]["success"]["mean"] == 1
    assert result["Policy"]["recall_first"]["mean"] <= 1 / 3
    assert "purity_first" not in result["Policy"]
    assert policy.starts == 3  # two episodes and the warm-up


def test_a_real_agent_is_evaluated():
    sb3 = pytest.importorskip("stable_baselines3")
    env = gym.make(MULTI, **SMALL)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        agent = sb3.PPO("MultiInputPolicy", env, n_steps=8, batch_size=8, device="cpu")
    rows = evaluate(MULTI, agent, episodes=2, env_kwargs=SMALL).rows
    assert [row["detector"] for row in rows] == ["PPO", "PPO"]
    assert untimed(rows) == untimed(evaluate(env, agent, episodes=2).rows)


def test_an_environment_object_is_used_and_stays_open():
    env = gym.make(MULTI, **SMALL)
    ours = evaluate(env, RandomThird(), episodes=2)
    assert untimed(ours.rows) == untimed(
        evaluate(f"usnet_env:{MULTI}", RandomThird(), episodes=2, env_kwargs=SMALL).rows
    )
    env.reset(seed=0)


def test_equal_detectors_get_different_labels():
    result = evaluate(MULTI, [NoUav(), NoUav(), Followed(2), Followed(3)], episodes=1, env_kwargs=SMALL)
    labels = [entry["detector"] for entry in result.summary]
    assert labels == ["NoUav", "NoUav #2", "Followed(clusters=2)", "Followed"]


def test_a_mapping_names_the_detectors():
    result = evaluate(MULTI, {"my third": RandomThird(), "all": AllAlive()}, episodes=1, env_kwargs=SMALL, trivial=True)
    labels = [entry["detector"] for entry in result.summary]
    assert labels == ["my third", "all", *TRIVIAL]
    with pytest.raises(ArgumentError, match=r"^label must be a text of printable characters, got 'a\\nb'"):
        evaluate(MULTI, {"a\nb": AllAlive()}, episodes=1)


def test_a_label_of_a_trivial_policy_is_refused_for_another_detector():
    with pytest.raises(
        ArgumentError, match=r"^label must be another one than 'random', .* got it for 'destroy-all'\.$"
    ):
        evaluate(MULTI, {"random": "destroy-all"}, episodes=1, env_kwargs=SMALL, trivial=True)
    assert len(evaluate(MULTI, {"random": "random"}, episodes=1, env_kwargs=SMALL, trivial=True).summary) == 4


def test_names_are_labels_and_the_trivial_policies_join():
    result = evaluate(MULTI, ["random", NoUav()], episodes=2, env_kwargs=SMALL, trivial=True)
    labels = [entry["detector"] for entry in result.summary]
    assert labels == ["random", "NoUav", *(name for name in TRIVIAL if name != "random")]
    assert result["destroy-all"]["J"]["mean"] == 1 + 17 / 20
    assert untimed([row for row in result.rows if row["detector"] == "none"]) == [
        row | {"detector": "none"} for row in untimed(result.rows) if row["detector"] == "NoUav"
    ]


def test_the_label_holds_the_arguments():
    result = evaluate(MULTI, "lagged-correlation(clusters=3)", episodes=1, env_kwargs=SMALL)
    assert result.summary[0]["detector"] == "lagged-correlation(clusters=3)"


def test_the_summary_is_plain_json_of_the_promised_form():
    result = evaluate(MULTI, [RandomThird(), Followed()], episodes=3, env_kwargs=SMALL)
    read = json.loads(json.dumps(result.summary, allow_nan=False))
    assert read == result.summary
    for entry in read:
        assert set(entry) == {"detector", "episodes", "metrics"}
        assert entry["episodes"] == 3
        for cell in entry["metrics"].values():
            assert set(cell) == {"mean", "low", "high"}
            assert cell["low"] <= cell["mean"] <= cell["high"]
    assert set(read[1]["metrics"]) == set(METRICS)
    assert set(METRICS) - set(read[0]["metrics"]) == {"purity_first", "head_in_cluster_first"}
    means = {name: np.mean([row[name] for row in result.rows[:3]]) for name in read[0]["metrics"]}
    assert {name: cell["mean"] for name, cell in read[0]["metrics"].items()} == pytest.approx(means)


def test_seconds_are_of_the_answer():
    row = evaluate(MULTI, AllAlive(), episodes=1, env_kwargs=SMALL).rows[0]
    assert 0 < row["seconds_per_round"] < 0.1


def test_the_table_shows_every_row():
    from io import StringIO

    from rich.console import Console

    text = StringIO()
    result = evaluate(MULTI, [RandomThird(), Followed()], episodes=2, env_kwargs=SMALL)
    Console(file=text, width=220).print(result.table())
    assert "RandomThird" in text.getvalue()
    assert "Followed" in text.getvalue()
    assert "head in cluster" in text.getvalue()
    with pytest.raises(ArgumentError, match=r"^detector must be one of"):
        result["unknown"]


@pytest.mark.parametrize(
    ("detector", "words"),
    [
        (Failing(), ["'Failing'", "episode 2, round 1", "ZeroDivisionError: nothing to divide by (sample_"]),
        (WrongLength(), ["'WrongLength'", "all 20 UAVs", "19"]),
        (NoDetection(), ["'NoDetection'", "usnet_env.Detection"]),
        (WrongPolicy(), ["'WrongPolicy'", "0 and 1"]),
    ],
)
def test_a_failing_detector_ends_it_in_one_sentence(detector, words):
    with pytest.raises(EvaluationError) as failed:
        evaluate(MULTI, detector, episodes=5, env_kwargs=SMALL)
    sentence = str(failed.value)
    assert all(word in sentence for word in words)
    assert "\n" not in sentence


def test_detectors_that_end_hang_or_eat_memory_fail_and_the_others_play_on(tmp_path):
    """The process of the first two dies, so that four processes start in all."""
    ways = ["os._exit", "hang", "sys.exit", "interrupt", "memory"]
    detectors = [*(Ending(how) for how in ways), AllAlive()]
    with pytest.raises(EvaluationError) as failed:
        evaluate(
            MULTI, detectors, episodes=2, env_kwargs=SMALL, workers=2, out=tmp_path, time_limit=4, memory_limit=1000
        )
    sentence = str(failed.value)
    for how, reason in (
        ("os._exit", "round 2: it ended its process with status 0."),
        ("hang", "round 2: it took longer than 4 seconds, the time limit."),
        ("sys.exit", "round 2: SystemExit: 0 (sample_detectors.py, line "),
        ("interrupt", ": KeyboardInterrupt."),
        ("memory", "round 2: MemoryError: it needed more than 1000 MB, the memory limit."),
    ):
        label = "Ending" if how == "os._exit" else f"Ending(how={how!r})"
        start = sentence.index(f"detector {label!r} failed in episode ")
        assert reason in sentence[start:], sentence
    assert [entry["detector"] for entry in failed.value.result.summary] == ["AllAlive"]
    rows = (tmp_path / "episodes.csv").read_text().splitlines()[1:]
    assert [row.split(",")[0] for row in rows] == ["AllAlive"] * 2
    assert [entry["detector"] for entry in json.loads((tmp_path / "summary.json").read_text())] == ["AllAlive"]


def test_here_too_a_detector_that_leaves_the_program_has_failed_and_the_others_play_on():
    with pytest.raises(
        EvaluationError, match=r"^detector \"Ending.*\" failed in its warm-up: SystemExit: 0 \("
    ) as failed:
        evaluate(MULTI, [Ending("sys.exit", first=True), AllAlive()], episodes=2, env_kwargs=SMALL)
    assert [row["detector"] for row in failed.value.result.rows] == ["AllAlive"] * 2


def test_threads_that_stay_are_named():
    try:
        with pytest.warns(RuntimeWarning, match=r"^detector 'Staying' left 2 threads running, no daemons: staying\.$"):
            evaluate(MULTI, Staying(), episodes=1, env_kwargs=SMALL)
    finally:
        Staying.release.set()


def test_a_policy_that_takes_masks_receives_them():
    result = evaluate(MULTI, MaskedPolicy(), episodes=1, env_kwargs=SMALL | {"max_rounds": 20})
    assert result["MaskedPolicy"]["success"]["mean"] == 1


def train(env, **options):
    sb3 = pytest.importorskip("stable_baselines3")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return sb3.PPO("MultiInputPolicy", env, n_steps=8, batch_size=8, n_epochs=1, device="cpu", **options).learn(8)


def test_a_model_trained_behind_vecnormalize_receives_normalised_windows(monkeypatch):
    vec_env = pytest.importorskip("stable_baselines3.common.vec_env")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        behind = vec_env.VecNormalize(
            vec_env.DummyVecEnv([lambda: gym.make(MULTI, **SMALL)]), norm_obs_keys=["position", "velocity"]
        )
    model = train(behind)
    received = []
    monkeypatch.setattr(
        model, "predict", lambda window, **_: (received.append(window), (np.ones(20, np.int8), None))[1]
    )
    recorder = Recorder()
    evaluate(MULTI, [model, recorder], episodes=1, env_kwargs=SMALL)
    plain = {"position": recorder.windows[0].position, "velocity": recorder.windows[0].velocity}
    for key, values in plain.items():
        mean, var = behind.obs_rms[key].mean, behind.obs_rms[key].var
        expected = np.clip((values - mean) / np.sqrt(var + behind.epsilon), -10, 10)
        assert np.allclose(received[-1][key], expected, atol=1e-5)
    assert not np.allclose(received[-1]["position"], plain["position"])


@pytest.mark.slow
def test_a_model_that_was_just_trained_plays_in_worker_processes():
    """PyTorch refuses to send tensors that hold gradients to another process in its own way."""
    from detectors.policy_detector import PolicyDetector

    model = train(gym.make(MULTI, **SMALL))
    here, there = (
        evaluate(MULTI, [model, PolicyDetector(model.policy)], episodes=2, env_kwargs=SMALL, workers=workers)
        for workers in (1, 2)
    )
    assert untimed(here.rows) == untimed(there.rows)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"env": "USNET/MultiClutser-v0"}, ["env ", "USNET/MultiCluster-v0"]),
        ({"env": "no_such_module:USNET/MultiCluster-v0"}, ["env ", "no_such_module"]),
        ({"env": "CartPole-v1"}, ["env ", "USNET environment"]),
        ({"env": 7}, ["env ", "7"]),
        ({"detector": "lagged-regresion"}, ["lagged-regression"]),
        ({"detector": ["none", "none"]}, ["detector ", "twice"]),
        ({"detector": []}, ["detector ", "empty"]),
        ({"detector": {}}, ["detector ", "empty"]),
        ({"detector": {3: "none"}}, ["label", "3"]),
        ({"detector": AllAlive}, ["detector ", "AllAlive"]),
        ({"detector": 3.5}, ["detector ", "3.5"]),
        ({"env_kwargs": {"folow": "f1"}}, ["folow", "'follow'", "miss_rate"]),
        ({"env_kwargs": {"render_mode": "human"}}, ["render_mode"]),
        ({"env_kwargs": {"uavs": 3}}, ["uavs"]),
        ({"env_kwargs": {"miss_rate": float("nan")}}, ["miss_rate"]),
        ({"env_kwargs": [1]}, ["env_kwargs"]),
        ({"episodes": 0}, ["episodes", "0"]),
        ({"episodes": 2.5}, ["episodes", "2.5"]),
        ({"episodes": True}, ["episodes", "True"]),
        ({"episodes": 10**9}, ["episodes"]),
        ({"seed": -1}, ["seed", "-1"]),
        ({"seed": None}, ["seed", "None"]),
        ({"workers": 0}, ["workers", "0"]),
        ({"workers": 10**6}, ["workers"]),
        ({"trivial": "yes"}, ["trivial", "yes"]),
        ({"time_limit": 0}, ["time_limit", "0"]),
        ({"time_limit": "long"}, ["time_limit", "'long'"]),
        ({"memory_limit": float("inf")}, ["memory_limit", "inf"]),
    ],
)
def test_bad_input_is_one_sentence_with_the_name(changes, words):
    with pytest.raises(ArgumentError) as refused:
        evaluate(**({"env": MULTI, "detector": "none", "episodes": 1, "env_kwargs": SMALL} | changes))
    sentence = str(refused.value)
    assert all(word in sentence for word in words), sentence
    assert "\n" not in sentence


@settings(max_examples=30, deadline=None)
@given(
    st.sampled_from(["episodes", "seed", "workers"]),
    st.one_of(st.floats(), st.text(max_size=5), st.integers(max_value=-1), st.integers(min_value=2**63), st.none()),
)
def test_the_error_names_the_wrong_number(name, value):
    with pytest.raises(ArgumentError, match=rf"^{name} must be "):
        evaluate(MULTI, NoUav(), **{name: value})


def test_an_environment_object_takes_no_arguments_and_one_worker():
    env = gym.make(MULTI, **SMALL)
    with pytest.raises(ArgumentError, match=r"^workers must be 1"):
        evaluate(env, NoUav(), workers=2)
    with pytest.raises(ArgumentError, match=r"^time_limit and memory_limit must be None"):
        evaluate(env, NoUav(), time_limit=1)
    with pytest.raises(ArgumentError, match=r"^env_kwargs must be empty"):
        evaluate(env, NoUav(), env_kwargs={"follow": "f2"})
    with pytest.raises(ArgumentError, match=r"^env must be"):
        evaluate(gym.make("CartPole-v1"), NoUav())
