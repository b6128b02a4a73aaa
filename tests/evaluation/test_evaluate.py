"""The evaluator with real environments and small real detectors."""

from __future__ import annotations

import json
import sys
import warnings

import gymnasium as gym
import numpy as np
import pytest
from pandas.testing import assert_frame_equal
from sample_detectors import AllAlive, Followed, MaskedPolicy, NoUav, Policy, RandomThird, Recorder, untimed

import usnet_env
from usnet_env import ArgumentError, evaluate
from usnet_env.evaluation import METRICS, TRIVIAL
from usnet_env.evaluation.play import episode_seeds

MULTI, SINGLE = "USNET/MultiCluster-v0", "USNET/SingleCluster-v0"
SMALL = {"clusters": 3, "uavs": 20, "observation_steps": 20, "max_rounds": 5}


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
    best = set(METRICS) - {"redundancy", "seconds_per_round"}
    assert {name: metrics[name]["mean"] for name in best} == dict.fromkeys(best, 1.0)
    assert metrics["redundancy"]["mean"] == 0.0


def test_the_single_cluster_problem_reports_its_own_objective():
    result = evaluate(SINGLE, [NoUav(), AllAlive(), Followed(1)], episodes=4)
    assert [entry["metrics"]["J"]["mean"] for entry in result.summary] == [-1.0, -15.0, 0.0]
    assert [entry["metrics"]["success"]["mean"] for entry in result.summary] == [0.0, 1.0, 1.0]
    assert set(result.rows["rounds"]) == {1}


@pytest.mark.parametrize("env_id", [MULTI, SINGLE])
def test_the_rows_agree_with_the_environment_s_own_count(env_id):
    env = gym.make(env_id)
    for row in evaluate(env_id, RandomThird(), episodes=5, seed=3).rows.to_dict("records"):
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
    assert_frame_equal(untimed(plain), untimed(priced))


def test_every_detector_meets_the_same_swarms_and_the_warm_up_leaves_it_alone():
    first, second, alone = Recorder(), Recorder(), Recorder()
    evaluate(MULTI, [first, RandomThird(), second], episodes=4, env_kwargs=SMALL)
    evaluate(MULTI, alone, episodes=4, env_kwargs=SMALL)
    assert len(alone.windows) == 4
    for other in (first, second):
        assert other.seeds == alone.seeds
        for ours, theirs in zip(alone.windows, other.windows, strict=True):
            assert np.array_equal(ours.position, theirs.position)
    assert len({window.position.tobytes() for window in alone.windows}) == 4


@pytest.mark.parametrize("seed", [0, 2**192 - 1])
def test_swarm_and_detector_seeds_come_from_two_branches(seed):
    """Against NumPy's own branches: published rows depend on these numbers."""
    recorder = Recorder()
    rows = evaluate(MULTI, recorder, episodes=3, seed=seed, env_kwargs=SMALL).rows
    for row, episode in zip(rows.to_dict("records"), np.random.SeedSequence(seed).spawn(3), strict=True):
        swarm, detector = episode.spawn(2)
        assert row["swarm_seed"] == int(swarm.generate_state(1, np.uint64)[0]) >> 1
        assert row["detector_seed"] == int(detector.generate_state(1)[0]) >> 1
    assert recorder.seeds == list(rows["detector_seed"])


def test_no_detector_seed_is_a_part_of_its_swarm_seed():
    """Of one branch, the 31 bits of the detector's seed would be among the 63 bits of the swarm's."""
    seeds = [episode_seeds(seed, episode) for seed in range(4) for episode in range(50)]
    assert len({number for pair in seeds for number in pair}) == 400
    for swarm, detector in seeds:
        assert detector not in {(swarm >> shift) % 2**31 for shift in range(33)}


def test_another_seed_is_another_evaluation_and_the_same_is_the_same():
    one, same, other = (
        untimed(evaluate(MULTI, RandomThird(), episodes=3, seed=seed, env_kwargs=SMALL)) for seed in (0, 0, 1)
    )
    assert_frame_equal(one, same)
    assert not one["J"].equals(other["J"])


def test_global_generators_are_untouched():
    before = np.random.get_state()[1].copy()  # noqa: NPY002  # the generator that must not change
    evaluate(MULTI, RandomThird(), episodes=2, env_kwargs=SMALL)
    assert np.array_equal(np.random.get_state()[1], before)  # noqa: NPY002


@pytest.mark.parametrize("how", [{"workers": 2}, {"isolate": True}, {"backend": "serial"}])
def test_where_episodes_are_played_changes_no_row(how):
    detectors = [RandomThird(), Followed(2), Policy(), "lagged-correlation(clusters=3)"]
    here, there = (evaluate(MULTI, detectors, episodes=4, seed=1, env_kwargs=SMALL, **place) for place in ({}, how))
    assert_frame_equal(untimed(here), untimed(there))


def test_policies_in_stable_baselines_form_are_evaluated():
    policy = Policy()
    result = evaluate(MULTI, [policy, MaskedPolicy()], episodes=2, env_kwargs=SMALL | {"max_rounds": 20})
    assert result["Policy"]["success"]["mean"] == result["MaskedPolicy"]["success"]["mean"] == 1
    assert result["Policy"]["recall_first"]["mean"] <= 1 / 3
    assert "purity_first" not in result["Policy"]
    assert policy.starts == 3  # two episodes and the warm-up


def test_a_real_agent_is_evaluated():
    sb3 = pytest.importorskip("stable_baselines3")
    env = gym.make(MULTI, **SMALL)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        agent = sb3.PPO("MultiInputPolicy", env, n_steps=8, batch_size=8, device="cpu")
    result = evaluate(MULTI, agent, episodes=2, env_kwargs=SMALL)
    assert list(result.rows["detector"]) == ["PPO", "PPO"]
    assert_frame_equal(untimed(result), untimed(evaluate(env, agent, episodes=2)))


def test_an_environment_object_is_used_and_stays_open(tmp_path):
    env = gym.make(MULTI, **SMALL)
    ours = evaluate(env, RandomThird(), episodes=2, out=tmp_path)
    theirs = evaluate(f"usnet_env:{MULTI}", RandomThird(), episodes=2, env_kwargs=SMALL)
    assert_frame_equal(untimed(ours).drop(columns="cell"), untimed(theirs).drop(columns="cell"))
    env.reset(seed=0)
    evaluate(env, RandomThird(), episodes=2, out=tmp_path)  # the same arguments
    with pytest.raises(ArgumentError, match=r"^env_kwargs must be empty and workers 1"):
        evaluate(env, NoUav(), workers=2)
    with pytest.raises(ArgumentError, match=r"^env must be"):
        evaluate(gym.make("CartPole-v1"), NoUav())


def test_a_module_in_front_of_the_id_is_imported_in_other_processes(tmp_path, monkeypatch):
    (tmp_path / "mirrored_swarm.py").write_text(
        "from usnet_env import register_follow_strategy\n"
        "register_follow_strategy('test-mirror', lambda inputs: -inputs.head_velocity[:, 0], lags=1)\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    settings = {"follow": "test-mirror", "clusters": 2, "uavs": 12, "observation_steps": 60}
    one, two = (
        evaluate(f"mirrored_swarm:{MULTI}", "lagged-regression(clusters=2)", episodes=4, env_kwargs=settings, **how)
        for how in ({}, {"workers": 2})
    )
    assert "mirrored_swarm" in sys.modules
    assert_frame_equal(untimed(one), untimed(two))
    assert one["lagged-regression(clusters=2)"]["recall_first"]["mean"] == 1.0


def test_equal_detectors_get_different_labels_and_a_mapping_gives_its_own():
    result = evaluate(MULTI, [NoUav(), NoUav(), Followed(2), Followed(3)], episodes=1, env_kwargs=SMALL)
    assert list(result) == ["NoUav", "NoUav #2", "Followed(clusters=2)", "Followed"]
    named = {"my third": RandomThird(), "all": AllAlive()}
    result = evaluate(MULTI, named, episodes=1, env_kwargs=SMALL, trivial=True)
    assert list(result) == ["my third", "all", *TRIVIAL]


def test_names_are_labels_and_the_trivial_policies_join():
    names = ["random", "lagged-correlation(clusters=3)"]
    result = evaluate(MULTI, [*names, NoUav()], episodes=2, env_kwargs=SMALL, trivial=True)
    assert list(result) == [*names, "NoUav", *(name for name in TRIVIAL if name != "random")]
    rows = untimed(result).set_index("detector")
    assert_frame_equal(rows.loc["none"].reset_index(drop=True), rows.loc["NoUav"].reset_index(drop=True))


def test_the_summary_is_plain_json_of_the_promised_form():
    result = evaluate(MULTI, [RandomThird(), Followed()], episodes=3, env_kwargs=SMALL)
    read = json.loads(json.dumps(result.summary, allow_nan=False))
    assert read == result.summary
    for entry in read:
        assert set(entry) == {"detector", "episodes", "failed", "metrics"}
        assert (entry["episodes"], entry["failed"]) == (3, 0)
        for cell in entry["metrics"].values():
            assert set(cell) == {"mean", "low", "high"}
            assert cell["low"] <= cell["mean"] <= cell["high"]
    assert set(read[1]["metrics"]) == set(METRICS)
    assert set(METRICS) - set(read[0]["metrics"]) == {"purity_first", "head_in_cluster_first"}
    means = result.rows.groupby("detector")[list(METRICS)].mean().loc["RandomThird"].dropna().to_dict()
    assert {name: cell["mean"] for name, cell in read[0]["metrics"].items()} == pytest.approx(means)
    assert (result.rows["seconds_per_round"] > 0).all()


@pytest.mark.parametrize(
    ("changes", "name"),
    [
        ({"episodes": 0}, "episodes"),
        ({"episodes": "many"}, "episodes"),
        ({"seed": -1}, "seed"),
        ({"seed": 2**192}, "seed"),
        ({"workers": 0}, "workers"),
        ({"backend": "dask"}, "backend"),
        ({"time_limit": 0}, "time_limit"),
        ({"memory_limit": -1}, "memory_limit"),
        ({"isolate": "yes"}, "isolate"),
        ({"env_kwargs": 3}, "env_kwargs"),
        ({"env_kwargs": {"folow": "f1"}}, "folow"),
        ({"env": "USNET/Multi"}, "env"),
        ({"env": "nowhere:X-v0"}, "env"),
        ({"env": 3}, "env"),
        ({"out": ""}, "out"),
        ({"detector": []}, "detector"),
        ({"detector": {"a\nb": NoUav()}}, "detector"),
        ({"detector": {3: NoUav()}}, "detector"),
        ({"detector": ["none", "none"]}, "detector"),
        ({"detector": "lagged-regresion"}, "detector"),
        ({"detector": "random(seeed=1)"}, "seeed"),
        ({"detector": "nowhere:Missing"}, "nowhere"),
        ({"detector": NoUav}, "detector"),
        ({"detector": object()}, "detector"),
    ],
)
def test_a_wrong_argument_is_named_and_leaves_nothing(tmp_path, changes, name):
    asked = {"env": MULTI, "detector": "none", "episodes": 1, "env_kwargs": SMALL, "out": tmp_path / "run"}
    with pytest.raises(ArgumentError, match=name):
        evaluate(**(asked | changes))
    assert list(tmp_path.iterdir()) == []
