"""sb3-contrib: MaskablePPO learns to find all heads, and never names a destroyed UAV.

pip install -e '.[rl]'
python examples/frameworks/sb3_maskable_ppo.py
"""

import argparse
from collections.abc import Sequence

import torch
from comparison import compare_detectors
from how_copied import HowCopied, how_copied
from sb3_contrib import MaskablePPO
from stable_baselines3.common.env_util import make_vec_env

from detectors.policy_detector import PolicyDetector

ENV = "USNET/MultiCluster-v0"
ARGUMENTS = {"clusters": 2, "uavs": 12, "observation_steps": 20, "max_rounds": 5}
PRICE = 3.0  # of a redundant candidate; at the paper's 1, naming all UAVs is too good to learn anything better


def train(steps: int, seed: int = 0) -> MaskablePPO:
    """Train MaskablePPO on eight environments; it finds their ``action_masks()`` (2 N booleans) automatically."""
    arguments = {**ARGUMENTS, "redundancy_price": PRICE}
    model = MaskablePPO(
        "MlpPolicy",
        make_vec_env(ENV, n_envs=8, seed=seed, env_kwargs=arguments, wrapper_class=HowCopied),
        learning_rate=1e-2,
        n_steps=64,
        batch_size=128,
        gamma=1.0,
        policy_kwargs={"net_arch": [32]},
        seed=seed,
        device="cpu",
    )
    return model.learn(steps)


def main(arguments: Sequence[str] | None = None) -> None:
    """Train, and compare with detectors."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--steps", type=int, default=12_288, help="environment steps to train for")
    parser.add_argument("--episodes", type=int, default=50, help="episodes to score")
    parser.add_argument("--seed", type=int, default=0)
    asked = parser.parse_args(arguments)
    model = train(asked.steps, asked.seed)
    # PolicyDetector passes the mask of the living UAVs to the policy.
    trained = PolicyDetector(model.policy, observe=how_copied)
    others = {"lagged-regression": "lagged-regression(clusters=2)", "random": "random(count=2)"}
    compare_detectors(ENV, ARGUMENTS, {"MaskablePPO": trained, **others}, asked.episodes)


if __name__ == "__main__":
    torch.set_num_threads(1)  # more threads make small networks slower
    main()
