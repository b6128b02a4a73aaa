"""Stable-Baselines3's PPO trains, and its policy plays beside the detectors."""

import pickle

import gymnasium as gym
import numpy as np
import pytest

pytest.importorskip("stable_baselines3")

import sb3_ppo as example
from comparison import compare_detectors
from how_copied import HowCopied, how_copied
from stable_baselines3 import PPO

from detectors.policy_detector import PolicyDetector
from usnet_env import Window

WORDS = ("--steps", "512", "--episodes", "2")


def test_it_trains(untrained, trained):
    assert trained.num_timesteps == 512
    assert np.isfinite(trained.logger.name_to_value["train/loss"])
    before, after = untrained.get_parameters()["policy"], trained.get_parameters()["policy"]
    assert all(bool((before[name] != after[name]).any()) for name in before if name.endswith("weight"))


def test_the_success_of_episodes_is_counted_in_training(trained):
    assert len(trained.ep_success_buffer) == 100  # the last episodes; rollout/success_rate is their mean
    assert 0 < np.mean(trained.ep_success_buffer) <= 1


@pytest.mark.slow
def test_it_learns(untrained):
    models = {"untrained": untrained, "trained": example.train(2048)}
    detectors = {name: PolicyDetector(model.policy, observe=how_copied) for name, model in models.items()}
    scores = compare_detectors(example.ENV, example.ARGUMENTS, detectors, episodes=30)
    assert scores["untrained"]["J"]["mean"] < -3.0
    assert scores["trained"]["J"]["mean"] >= -1.1


def test_what_it_sees_in_training_is_what_the_detector_sees(trained):
    env = gym.make(example.ENV, **example.ARGUMENTS)
    raw, _ = env.reset(seed=5)
    seen, _ = HowCopied(env).reset(seed=5)
    np.testing.assert_array_equal(seen, how_copied(Window.from_observation(raw)))
    assert seen.sum() == pytest.approx(1.0)
    detection = PolicyDetector(trained.policy, observe=how_copied).detect(Window.from_observation(raw))
    np.testing.assert_array_equal(detection.candidates, trained.predict(seen, deterministic=True)[0].astype(bool))


def test_a_detector_with_a_policy_survives_pickling(trained):
    detector = PolicyDetector(trained.policy, observe=how_copied)
    window = Window.from_observation(gym.make(example.ENV, **example.ARGUMENTS).reset(seed=1)[0])
    again = pickle.loads(pickle.dumps(detector))
    np.testing.assert_array_equal(again.detect(window).scores, detector.detect(window).scores)


def test_raw_windows_need_no_wrapper():
    env = gym.make(example.ENV, **example.ARGUMENTS)
    model = PPO("MultiInputPolicy", env, n_steps=16, batch_size=16, n_epochs=1, seed=0, device="cpu").learn(32)
    scores = compare_detectors(example.ENV, example.ARGUMENTS, {"raw": PolicyDetector(model.policy)}, episodes=3)
    assert np.isfinite(scores["raw"]["J"]["mean"])


def test_the_script_prints_a_comparison(script):
    assert [line.split()[0] for line in script[1]] == ["PPO", "lagged-regression", "random"]
