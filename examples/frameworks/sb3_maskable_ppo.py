"""sb3-contrib: MaskablePPO learns to find all heads, and never names a UAV that is destroyed already.

pip install 'usnet[rl]'
python examples/frameworks/sb3_maskable_ppo.py
"""

import argparse
from collections.abc import Sequence

import torch
from comparison import compared
from how_copied import HowCopied, how_copied
from sb3_contrib import MaskablePPO
from stable_baselines3.common.env_util import make_vec_env

from detectors.policy_detector import PolicyDetector

ENV = "USNET/MultiCluster-v0"
ARGUMENTS = {"clusters": 2, "uavs": 12, "observation_steps": 20, "max_rounds": 5}
PRICE = 3.0  # of a redundant candidate: at the paper's 1, naming everybody is too good to learn anything better


def train(steps: int, seed: int = 0) -> MaskablePPO:
    """MaskablePPO on eight environments; it finds ``action_masks()``, 2 N booleans, behind the wrappers by itself."""
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
    """Train, and score beside detectors."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--steps", type=int, default=12_288, help="environment steps to train for")
    parser.add_argument("--episodes", type=int, default=50, help="episodes to score")
    parser.add_argument("--seed", type=int, default=0)
    asked = parser.parse_args(arguments)
    model = train(asked.steps, asked.seed)
    # PolicyDetector hands the policy its masks: those who live.
    trained = PolicyDetector(model.policy, observe=how_copied)
    others = {"lagged-regression": "lagged-regression(clusters=2)", "random": "random(count=2)"}
    compared(ENV, ARGUMENTS, {"MaskablePPO": trained, **others}, asked.episodes)


if __name__ == "__main__":
    torch.set_num_threads(1)  # small networks wait for each other on more
    main()
