"""Stable-Baselines3: PPO learns from raw windows to name the head of one cluster.

pip install -e '.[rl]'
python examples/frameworks/sb3_ppo.py
"""

import argparse
from collections.abc import Sequence

import torch
from comparison import compare_detectors
from stable_baselines3 import PPO

from detectors.policy_detector import PolicyDetector
from detectors.rl.sb3 import PairPolicy
from usnet_env.frameworks.sb3 import SwarmVecEnv

ENV, ARGUMENTS = "USNET/SingleCluster-v0", {"followers": 7, "observation_steps": 20}
SETTINGS = {"n_steps": 16, "batch_size": 256, "n_epochs": 4, "learning_rate": 5e-3, "device": "cpu"}


def train(steps: int, seed: int = 0) -> PPO:
    """Train PPO on 64 games at once; the other parts of the observation would only fill its buffer."""
    envs = SwarmVecEnv(ENV, 64, observe=("velocity", "alive"), **ARGUMENTS)
    return PPO(PairPolicy, envs, seed=seed, **SETTINGS).learn(steps)


def main(arguments: Sequence[str] | None = None) -> None:
    """Train, and compare with detectors."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--steps", type=int, default=16_384, help="environment steps to train for")
    parser.add_argument("--episodes", type=int, default=50, help="episodes to score")
    parser.add_argument("--seed", type=int, default=0)
    asked = parser.parse_args(arguments)
    # Pass the policy, because the model holds its environments.
    trained = PolicyDetector(train(asked.steps, asked.seed).policy)
    others = {"lagged-regression": "lagged-regression(clusters=1)", "random": "random(count=1)"}
    compare_detectors(ENV, ARGUMENTS, {"PPO": trained, **others}, asked.episodes)


if __name__ == "__main__":
    torch.set_num_threads(1)  # more threads make small networks slower
    main()
