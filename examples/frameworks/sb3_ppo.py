"""Stable-Baselines3: PPO learns to name the head of one cluster.

pip install -e '.[rl]'
python examples/frameworks/sb3_ppo.py
"""

from collections.abc import Sequence

import torch
from small_ppo import SETTINGS, compare_with_detectors, make_envs, parse_arguments
from stable_baselines3 import PPO

ENV, ARGUMENTS = "USNET/SingleCluster-v0", {"followers": 9, "observation_steps": 20}


def train(steps: int, seed: int = 0) -> PPO:
    """Train PPO on eight environments in parallel."""
    return PPO("MlpPolicy", make_envs(ENV, ARGUMENTS, seed), seed=seed, **SETTINGS).learn(steps)


def main(arguments: Sequence[str] | None = None) -> None:
    """Train, and compare with detectors."""
    asked = parse_arguments(__doc__, 8192, arguments)
    compare_with_detectors("PPO", train(asked.steps, asked.seed), ENV, ARGUMENTS, 1, asked.episodes)


if __name__ == "__main__":
    torch.set_num_threads(1)  # more threads make small networks slower
    main()
