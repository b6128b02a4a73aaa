"""The observers' game through SuperSuit: Stable-Baselines3's PPO trains a policy that all observers share."""

import numpy as np
import pytest

pytest.importorskip("supersuit")
pytest.importorskip("stable_baselines3")

import supersuit
import supersuit_ppo as example
from how_copied import how_copied
from observers_game import ARGUMENTS, compare_detectors

from detectors.policy_detector import PolicyDetector
from usnet_env.multiagent import usnet_observers_v0
from usnet_env.multiagent.wrappers import MultiDiscreteVotes

WORDS = ("--steps", "768", "--games", "2")


def test_it_trains(untrained, trained):
    assert trained.n_envs == 4 * ARGUMENTS["observers"]
    assert np.isfinite(trained.logger.name_to_value["train/loss"])
    before, after = untrained.get_parameters()["policy"], trained.get_parameters()["policy"]
    assert all(bool((before[name] != after[name]).any()) for name in before if name.endswith("weight"))


@pytest.mark.slow
def test_it_learns_and_plays_games_as_a_detector(untrained):
    detector = PolicyDetector(example.train(4096, games=4).policy, observe=how_copied)
    untrained = PolicyDetector(untrained.policy, observe=how_copied)
    scores = compare_detectors({"PPO": detector, "untrained": untrained}, games=10)
    assert scores["PPO"] < scores["untrained"]


def test_games_are_seeded_each_by_its_own():
    first, again, other = (example.make_envs(2, seed).reset() for seed in (0, 0, 1))
    np.testing.assert_array_equal(first, again)
    assert not np.array_equal(first, other)
    assert not np.array_equal(first[: ARGUMENTS["observers"]], first[ARGUMENTS["observers"] :])


def test_raw_windows_need_only_the_wrapper_of_the_votes():
    game = MultiDiscreteVotes(usnet_observers_v0.parallel_env(**ARGUMENTS))
    envs = supersuit.concat_vec_envs_v1(supersuit.pettingzoo_env_to_vec_env_v1(game), 2, base_class="stable_baselines3")
    seen = envs.reset()
    assert seen["velocity"].shape == (2 * ARGUMENTS["observers"], 20, 12, 3)
    votes = np.zeros((2 * ARGUMENTS["observers"], 12), np.int64)
    _, rewards, over, infos = envs.step(votes)
    assert rewards.tolist() == [-1.0] * 6
    assert not over.any()
    assert {info["redundant"] for info in infos} == {0}


def test_the_script_prints_a_comparison(script):
    assert [line.split()[0] for line in script[1]] == ["PPO", "lagged-regression", "random"]
