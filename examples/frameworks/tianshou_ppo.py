"""Tianshou: PPO learns to find all heads.

pip install -e '.[tianshou]'
python examples/frameworks/tianshou_ppo.py
"""

import argparse
from collections.abc import Sequence
from typing import Any

import gymnasium as gym
import numpy as np
import torch
from comparison import compare_detectors
from copied_network import Bits
from how_copied import HowCopied, how_copied
from tianshou.algorithm import PPO
from tianshou.algorithm.modelfree.reinforce import ProbabilisticActorPolicy
from tianshou.algorithm.optim import AdamOptimizerFactory
from tianshou.data import Collector, VectorReplayBuffer
from tianshou.env import DummyVectorEnv
from tianshou.trainer import OnPolicyTrainerParams
from torch import Tensor, nn

from detectors.policy_detector import PolicyDetector

ENV = "USNET/MultiCluster-v0"
UAVS = 12
ARGUMENTS = {"clusters": 2, "uavs": UAVS, "observation_steps": 20, "max_rounds": 5}
PRICE = 3.0  # of a redundant candidate; at the paper's 1, naming all UAVs is too good to learn anything better
BATCH = 512


class Layers(nn.Module):
    """A small network."""

    def __init__(self, outputs: int) -> None:
        super().__init__()
        self.layers = nn.Sequential(nn.Linear(UAVS, 32), nn.Tanh(), nn.Linear(32, outputs))

    def forward(self, observation: Any) -> Tensor:
        """``(B, outputs)`` of ``(B, N)``."""
        return self.layers(torch.as_tensor(observation, dtype=torch.float32))


class Actor(Layers):
    """Returns logits and, as Tianshou expects, a hidden state."""

    def forward(self, observation: Any, state: Any = None, info: Any = None) -> tuple[Tensor, Any]:
        """One logit per UAV."""
        return super().forward(observation), state


def make_env() -> gym.Env:
    """Create an environment whose observation is one number per UAV."""
    return HowCopied(gym.make(ENV, **ARGUMENTS, redundancy_price=PRICE))


def train(epochs: int, seed: int = 0) -> tuple[Actor, Any]:
    """Return the actor and Tianshou's training statistics. One epoch is one batch of steps."""
    torch.manual_seed(seed)
    np.random.seed(seed)  # noqa: NPY002  Tianshou shuffles with NumPy's global generator
    envs = DummyVectorEnv([make_env for _ in range(8)])
    envs.seed(seed)
    actor = Actor(UAVS)
    policy = ProbabilisticActorPolicy(
        actor=actor,
        dist_fn=Bits,
        action_space=gym.spaces.MultiBinary(UAVS),
        action_scaling=False,
        action_bound_method=None,
    )
    algorithm = PPO(policy=policy, critic=Layers(1), optim=AdamOptimizerFactory(lr=1e-2), gamma=1.0, ent_coef=0.0)
    result = algorithm.run_training(
        OnPolicyTrainerParams(
            training_collector=Collector(algorithm, envs, VectorReplayBuffer(2 * BATCH, len(envs))),
            max_epochs=epochs,
            epoch_num_steps=BATCH,
            collection_step_num_env_steps=BATCH,
            update_step_num_repetitions=8,
            batch_size=128,
            verbose=False,
            show_progress=False,
        )
    )
    return actor, result


def main(arguments: Sequence[str] | None = None) -> None:
    """Train, and compare with detectors."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--epochs", type=int, default=16, help=f"of {BATCH} environment steps")
    parser.add_argument("--episodes", type=int, default=50, help="episodes to score")
    parser.add_argument("--seed", type=int, default=0)
    asked = parser.parse_args(arguments)
    actor, _ = train(asked.epochs, asked.seed)
    trained = PolicyDetector(actor.layers, observe=how_copied)  # a plain module: a logit above 0 makes a candidate
    others = {"lagged-regression": "lagged-regression(clusters=2)", "random": "random(count=2)"}
    compare_detectors(ENV, ARGUMENTS, {"PPO": trained, **others}, asked.episodes)


if __name__ == "__main__":
    torch.set_num_threads(1)  # more threads make small networks slower
    main()
