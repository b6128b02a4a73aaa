"""TorchRL reads the environments, its PPO trains, and its actor plays beside the detectors."""

import warnings

import gymnasium as gym
import numpy as np
import pytest

pytest.importorskip("torchrl")

with warnings.catch_warnings():  # TorchRL's own, of its own import
    warnings.filterwarnings("ignore", "Creating .* which inherits from WeightUpdaterBase", DeprecationWarning)
    import torchrl.collectors  # noqa: F401

import torch
import torchrl_ppo as example
from comparison import compare_detectors
from torchrl.envs import ExplorationType, GymWrapper, check_env_specs, set_exploration_type

from detectors.policy_detector import PolicyDetector
from usnet_env.envs import ENVIRONMENTS, MultiDiscreteCandidates
from usnet_env.envs.wrappers import BoxMasks

SMALL = {"observation_steps": 12}
WORDS = ("--steps", str(example.BATCH), "--episodes", "2")


@pytest.fixture(scope="module")
def begun(script):
    return script[0]


@pytest.fixture(scope="module")
def trained():
    return example.train(4 * example.BATCH)


@pytest.mark.parametrize("name", sorted(ENVIRONMENTS))
def test_the_specs_hold(name):
    check_env_specs(GymWrapper(BoxMasks(gym.make(name, **SMALL))), seed=0)


def test_the_specs_hold_for_other_forms_of_the_action():
    env = gym.make(example.ENV, **example.ARGUMENTS)
    check_env_specs(GymWrapper(MultiDiscreteCandidates(BoxMasks(env))), seed=0)
    check_env_specs(GymWrapper(gym.wrappers.FlattenObservation(env)), seed=0)


def test_an_episode_comes_through():
    played = example.make_env().rollout(example.ARGUMENTS["max_rounds"])
    assert played["next", "done"][-1]
    assert played["action"].dtype == torch.int8
    assert (played["next", "reward"] <= -1.0).all()


def test_it_trains(begun):
    actor, returns = begun
    assert np.isfinite(returns).all()
    torch.manual_seed(0)
    fresh = example.make_actor(example.make_env())
    pairs = zip(actor.parameters(), fresh.parameters(), strict=True)
    assert all(bool((after != before).any()) for after, before in pairs)


@pytest.mark.slow
def test_it_learns(trained):
    _, returns = trained
    assert np.isfinite(returns).all()
    assert returns[-1] > returns[0] + 0.3


def test_the_actor_draws_in_training_and_decides_in_play(begun):
    actor, _ = begun
    window = example.make_env().reset(seed=3)
    decided = [actor(window.clone())["action"] for _ in range(20)]
    assert all(torch.equal(one, decided[0]) for one in decided)
    with set_exploration_type(ExplorationType.RANDOM):
        drawn = [actor(window.clone())["action"] for _ in range(20)]
    assert not all(torch.equal(one, drawn[0]) for one in drawn)


@pytest.mark.slow
@pytest.mark.parametrize("swarm", [example.ARGUMENTS, {**example.ARGUMENTS, **example.LARGER}])
def test_the_actor_plays_beside_detectors_with_swarms_of_any_size(trained, swarm):
    scores = compare_detectors(
        example.ENV, swarm, {"PPO": PolicyDetector(trained[0]), "random": "random(count=2)"}, episodes=10
    )
    assert scores["PPO"]["J"]["mean"] < scores["random"]["J"]["mean"]


def test_permuting_the_uavs_permutes_the_logits(begun):
    window = example.make_env().reset(seed=1).unsqueeze(0)
    order = torch.randperm(example.ARGUMENTS["uavs"], generator=torch.Generator().manual_seed(0))
    other = window.clone()
    other["velocity"], other["alive"] = window["velocity"][..., order, :], window["alive"][..., order]
    torch.testing.assert_close(begun[0](other)["logits"], begun[0](window)["logits"][..., order])


def test_the_script_prints_a_comparison(script):
    assert [line.split()[0] for line in script[1][1:]] == [
        "12",
        "PPO",
        "lagged-regression",
        "40",
        "PPO",
        "lagged-regression",
    ]
