"""Stable-Baselines3: PPO learns to name the head of one cluster.

pip install -e '.[rl]'
python examples/frameworks/sb3_ppo.py
"""

import argparse
from collections.abc import Sequence

import torch
from comparison import compare_detectors
from how_copied import HowCopied, how_copied
from stable_baselines3 import PPO
from stable_baselines3.common.env_util import make_vec_env

from detectors.policy_detector import PolicyDetector

ENV, ARGUMENTS = "USNET/SingleCluster-v0", {"followers": 9, "observation_steps": 20}


def train(steps: int, seed: int = 0) -> PPO:
    """Train PPO on eight environments in parallel."""
    model = PPO(
        "MlpPolicy",
        make_vec_env(ENV, n_envs=8, seed=seed, env_kwargs=ARGUMENTS, wrapper_class=HowCopied),
        learning_rate=1e-2,
        n_steps=64,
        batch_size=128,
        policy_kwargs={"net_arch": [32]},
        seed=seed,
        device="cpu",
    )
    return model.learn(steps)


def main(arguments: Sequence[str] | None = None) -> None:
    """Train, and compare with detectors."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--steps", type=int, default=8192, help="environment steps to train for")
    parser.add_argument("--episodes", type=int, default=50, help="episodes to score")
    parser.add_argument("--seed", type=int, default=0)
    asked = parser.parse_args(arguments)
    model = train(asked.steps, asked.seed)
    # Pass the policy, because the model holds its environments; `observe` computes what it saw in training.
    trained = PolicyDetector(model.policy, observe=how_copied)
    others = {"lagged-regression": "lagged-regression(clusters=1)", "random": "random(count=1)"}
    compare_detectors(ENV, ARGUMENTS, {"PPO": trained, **others}, asked.episodes)


if __name__ == "__main__":
    torch.set_num_threads(1)  # more threads make small networks slower
    main()
