"""Tianshou's PPO trains, and its actor plays beside the detectors."""

import gymnasium as gym
import numpy as np
import pytest

pytest.importorskip("tianshou")

import tianshou_ppo as example
import torch
from comparison import compare_detectors
from copied_network import Bits, CopiedNetwork
from how_copied import how_copied
from tianshou.algorithm.modelfree.reinforce import ProbabilisticActorPolicy
from tianshou.data import Collector, VectorReplayBuffer
from tianshou.env import DummyVectorEnv, PettingZooEnv

from detectors.policy_detector import PolicyDetector
from usnet_env.multiagent import usnet_observers_v0

WORDS = ("--epochs", "1", "--episodes", "2", "--seed", "3")


def test_it_trains(trained):
    actor, result = trained
    assert result.train_step == example.BATCH
    assert result.train_episode > 0
    torch.manual_seed(3)
    pairs = zip(actor.parameters(), example.Actor(example.UAVS).parameters(), strict=True)
    assert all(bool((after != before).any() and after.isfinite().all()) for after, before in pairs)


def test_the_same_seed_trains_the_same_actor(trained):
    first, again = (actor.state_dict() for actor, _ in (trained, example.train(1, seed=3)))
    assert all(torch.equal(first[name], again[name]) for name in first)


@pytest.mark.slow
def test_it_learns():
    actor, _ = example.train(4)
    detectors = {"PPO": PolicyDetector(actor.layers, observe=how_copied), "random": "random(count=2)"}
    scores = compare_detectors(example.ENV, example.ARGUMENTS, detectors, episodes=30)
    assert scores["PPO"]["J"]["mean"] < 2.0 < scores["random"]["J"]["mean"]


class RawActor(torch.nn.Module):
    """Looks at the windows as Tianshou batches them."""

    def __init__(self):
        super().__init__()
        self.network = CopiedNetwork()

    def forward(self, observation, state=None, info=None):
        return self.network(torch.as_tensor(observation.velocity), torch.as_tensor(observation.alive)), state


def test_raw_windows_and_infos_need_no_wrapper():
    envs = DummyVectorEnv([lambda: gym.make(example.ENV, **example.ARGUMENTS) for _ in range(2)])
    envs.seed(0)
    policy = ProbabilisticActorPolicy(
        actor=RawActor(),
        dist_fn=Bits,
        action_space=envs.action_space[0],
        action_scaling=False,
        action_bound_method=None,
    )
    buffer = VectorReplayBuffer(64, 2)
    collector = Collector(policy, envs, buffer)
    collector.reset()
    collector.collect(n_step=20)
    played, _ = buffer.sample(0)
    assert played.obs.velocity.shape == (20, 20, 12, 3)
    assert played.obs.alive.dtype == np.int8
    np.testing.assert_allclose(played.info.J[played.info.round == 1], -played.rew[played.info.round == 1])


def test_the_observers_game_in_turns_needs_no_wrapper():
    env = PettingZooEnv(usnet_observers_v0.env(clusters=2, uavs=8, observation_steps=12, max_rounds=2, observers=2))
    seen, _ = env.reset(seed=0)
    turns = 0
    over = False
    while not over:
        assert seen["agent_id"] == f"observer_{turns % 2}"
        seen, rewards, terminated, truncated, _ = env.step(np.zeros(8, np.int8))
        over = terminated or truncated
        turns += 1
    assert turns == 4
    assert rewards == [-1.0, -1.0]


def test_the_script_prints_a_comparison(script):
    assert [line.split()[0] for line in script[1]] == ["PPO", "lagged-regression", "random"]
