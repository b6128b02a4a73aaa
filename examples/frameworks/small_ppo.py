"""PPO of Stable-Baselines3 as the examples train it: on one number per UAV, with a small network."""

import argparse
from collections.abc import Sequence
from typing import Any

from comparison import compare_detectors
from how_copied import HowCopied, how_copied
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.on_policy_algorithm import OnPolicyAlgorithm
from stable_baselines3.common.vec_env import VecEnv

from detectors.policy_detector import PolicyDetector

#: Arguments of PPO and MaskablePPO.
SETTINGS: dict[str, Any] = {
    "learning_rate": 1e-2,
    "n_steps": 64,
    "batch_size": 128,
    "policy_kwargs": {"net_arch": [32]},
    "device": "cpu",
}


def make_envs(env: str, arguments: dict[str, Any], seed: int) -> VecEnv:
    """Eight environments whose observation is one number per UAV."""
    return make_vec_env(env, n_envs=8, seed=seed, env_kwargs=arguments, wrapper_class=HowCopied)


def parse_arguments(description: str, steps: int, arguments: Sequence[str] | None) -> argparse.Namespace:
    """Read the command line of an example: ``steps``, by default as given, ``episodes`` and ``seed``."""
    parser = argparse.ArgumentParser(description=description.partition("\n")[0])
    parser.add_argument("--steps", type=int, default=steps, help="environment steps to train for")
    parser.add_argument("--episodes", type=int, default=50, help="episodes to score")
    parser.add_argument("--seed", type=int, default=0)
    return parser.parse_args(arguments)


def compare_with_detectors(
    name: str, model: OnPolicyAlgorithm, env: str, arguments: dict[str, Any], heads: int, episodes: int
) -> None:
    """Compare a trained model with detectors that are given the number of heads."""
    # Pass the policy, because the model holds its environments; `observe` computes what it saw in training.
    # PolicyDetector passes the mask of the living UAVs to a policy that takes one.
    trained = PolicyDetector(model.policy, observe=how_copied)
    others = {"lagged-regression": f"lagged-regression(clusters={heads})", "random": f"random(count={heads})"}
    compare_detectors(env, arguments, {name: trained, **others}, episodes)
