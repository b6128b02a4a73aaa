"""sb3-contrib's MaskablePPO trains and keeps to its masks; RecurrentPPO trains behind the wrapper it needs."""

import gymnasium as gym
import numpy as np
import pytest

pytest.importorskip("sb3_contrib")

import sb3_maskable_ppo as example
from comparison import compare_detectors
from how_copied import HowCopied, how_copied
from sb3_contrib import RecurrentPPO
from sb3_contrib.common.maskable.utils import get_action_masks

from detectors.policy_detector import PolicyDetector
from usnet_env.envs import MultiDiscreteCandidates

WORDS = ("--steps", "512", "--episodes", "2")


def test_it_trains(trained):
    assert np.isfinite(trained.logger.name_to_value["train/loss"])
    before, after = example.train(0).get_parameters()["policy"], trained.get_parameters()["policy"]
    assert all(bool((before[name] != after[name]).any()) for name in before if name.endswith("weight"))


def test_masks_are_found_behind_the_wrappers(trained):
    trained.env.reset()
    masks = get_action_masks(trained.env)
    assert masks.shape == (8, 2 * example.ARGUMENTS["uavs"])
    assert masks.dtype == bool


def test_no_destroyed_uav_is_ever_drawn(trained):
    env = HowCopied(gym.make(example.ENV, **{**example.ARGUMENTS, "clusters": 3, "max_rounds": 12}))
    dead_uavs = 0
    for seed in range(8):
        seen, _ = env.reset(seed=seed)
        over = False
        while not over:
            alive = env.unwrapped.swarm.alive
            action, _ = trained.predict(seen, action_masks=env.unwrapped.action_masks())
            action[np.flatnonzero(action)[1:]] = 0  # one a round, so that games last
            assert not action[~alive].any()
            dead_uavs += int((~alive).sum())
            seen, _, terminated, truncated, _ = env.step(action)
            over = terminated or truncated
    assert dead_uavs > 20


@pytest.mark.slow
def test_it_learns():
    detectors = {"trained": PolicyDetector(example.train(2048).policy, observe=how_copied), "random": "random(count=2)"}
    scores = compare_detectors(example.ENV, example.ARGUMENTS, detectors, episodes=30)
    assert scores["trained"]["J"]["mean"] < 2.0 < scores["random"]["J"]["mean"]


def test_recurrent_ppo_trains_behind_its_wrapper():
    env = MultiDiscreteCandidates(gym.make(example.ENV, **example.ARGUMENTS))
    model = RecurrentPPO("MultiInputLstmPolicy", env, n_steps=16, batch_size=16, n_epochs=1, seed=0, device="cpu")
    model.learn(32)
    assert np.isfinite(model.logger.name_to_value["train/loss"])
    scores = compare_detectors(example.ENV, example.ARGUMENTS, {"recurrent": model.policy}, episodes=3)
    assert np.isfinite(scores["recurrent"]["J"]["mean"])


def test_the_script_prints_a_comparison(script):
    assert [line.split()[0] for line in script[1]] == ["MaskablePPO", "lagged-regression", "random"]
