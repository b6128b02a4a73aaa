"""sb3-contrib: MaskablePPO learns to find all heads, and never names a destroyed UAV.

pip install -e '.[rl]'
python examples/frameworks/sb3_maskable_ppo.py
"""

from collections.abc import Sequence

import torch
from sb3_contrib import MaskablePPO
from small_ppo import SETTINGS, compare_with_detectors, make_envs, parse_arguments

ENV = "USNET/MultiCluster-v0"
ARGUMENTS = {"clusters": 2, "uavs": 12, "observation_steps": 20, "max_rounds": 5}
PRICE = 3.0  # of a redundant candidate; at the paper's 1, naming all UAVs is too good to learn anything better


def train(steps: int, seed: int = 0) -> MaskablePPO:
    """Train MaskablePPO on eight environments; it finds their ``action_masks()`` (2 N booleans) automatically."""
    envs = make_envs(ENV, {**ARGUMENTS, "redundancy_price": PRICE}, seed)
    return MaskablePPO("MlpPolicy", envs, gamma=1.0, seed=seed, **SETTINGS).learn(steps)


def main(arguments: Sequence[str] | None = None) -> None:
    """Train, and compare with detectors."""
    asked = parse_arguments(__doc__, 12_288, arguments)
    compare_with_detectors("MaskablePPO", train(asked.steps, asked.seed), ENV, ARGUMENTS, 2, asked.episodes)


if __name__ == "__main__":
    torch.set_num_threads(1)  # more threads make small networks slower
    main()
