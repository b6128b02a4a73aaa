"""TorchRL: PPO with a custom network that reads raw windows and accepts swarms of any size.

pip install -e '.[torchrl]'
python examples/frameworks/torchrl_ppo.py
"""

import argparse
from collections.abc import Sequence

import gymnasium as gym
import torch
from comparison import compare_with_regression
from copied_network import Bits, CopiedNetwork, copied_share
from tensordict.nn import TensorDictModule
from torch import Tensor, nn
from torchrl.collectors import Collector
from torchrl.envs import GymWrapper, InitTracker, TransformedEnv
from torchrl.modules import ProbabilisticActor, ValueOperator
from torchrl.objectives import ClipPPOLoss
from torchrl.objectives.value import GAE

from detectors.policy_detector import PolicyDetector
from usnet_env.envs.wrappers import BoxMasks

ENV = "USNET/MultiCluster-v0"
ARGUMENTS = {"clusters": 2, "uavs": 12, "observation_steps": 20, "max_rounds": 5}
LARGER = {"clusters": 4, "uavs": 40}
PRICE = 3.0  # of a redundant candidate; at the paper's 1, naming all UAVs is too good to learn anything better
SEEN = ["velocity", "alive"]
BATCH = 512


class Critic(nn.Module):
    """The value of a round, from the sorted shares of how much each UAV is copied."""

    def __init__(self, uavs: int) -> None:
        super().__init__()
        self.layers = nn.Sequential(nn.Linear(uavs, 32), nn.Tanh(), nn.Linear(32, 1))

    def forward(self, velocity: Tensor, alive: Tensor) -> Tensor:
        """``(…, 1)``."""
        return self.layers(copied_share(velocity, alive).sort(dim=-1, descending=True).values)


def make_env() -> TransformedEnv:
    """The environment in TorchRL, with masks as boxes, because TorchRL cannot read other masks.

    ``InitTracker`` marks the first step of an episode, as the collector expects for an actor with random actions.
    """
    return TransformedEnv(GymWrapper(BoxMasks(gym.make(ENV, **ARGUMENTS, redundancy_price=PRICE))), InitTracker())


def make_actor(env: TransformedEnv) -> ProbabilisticActor:
    """The network gives logits; the action is sampled from them during training, and is the mode otherwise."""
    network = TensorDictModule(CopiedNetwork(), in_keys=SEEN, out_keys=["logits"])
    return ProbabilisticActor(
        network, in_keys=["logits"], spec=env.action_spec, distribution_class=Bits, return_log_prob=True
    )


def train(steps: int, seed: int = 0) -> tuple[ProbabilisticActor, list[float]]:
    """Return the actor, and the mean return of an episode in each batch."""
    torch.manual_seed(seed)
    env = make_env()
    env.set_seed(seed)
    actor, critic = make_actor(env), ValueOperator(Critic(ARGUMENTS["uavs"]), in_keys=SEEN)
    advantage = GAE(gamma=1.0, lmbda=0.95, value_network=critic)
    loss = ClipPPOLoss(actor, critic, entropy_bonus=False)
    optimizer = torch.optim.Adam(loss.parameters(), lr=2e-2)
    returns = []
    frames = {"frames_per_batch": BATCH, "total_frames": max(steps, BATCH)}
    for batch in Collector(env, actor, **frames):
        for _ in range(5):
            advantage(batch)
            for rows in torch.randperm(len(batch)).split(128):
                parts = loss(batch[rows])
                optimizer.zero_grad()
                (parts["loss_objective"] + parts["loss_critic"]).backward()
                optimizer.step()
        after = batch["next"]
        returns.append(float(after["reward"].sum() / after["done"].sum()))
    return actor, returns


def main(arguments: Sequence[str] | None = None) -> None:
    """Train, and compare with detectors, on larger swarms too."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--steps", type=int, default=12 * BATCH, help="environment steps to train for")
    parser.add_argument("--episodes", type=int, default=50, help="episodes to score")
    parser.add_argument("--seed", type=int, default=0)
    asked = parser.parse_args(arguments)
    actor, returns = train(asked.steps, asked.seed)
    print("mean return, batch by batch:", *(f"{value:.2f}" for value in returns))
    swarms = (ARGUMENTS, {**ARGUMENTS, **LARGER})
    compare_with_regression(ENV, swarms, ("PPO", "lagged-regression"), PolicyDetector(actor), asked.episodes)


if __name__ == "__main__":
    torch.set_num_threads(1)  # more threads make small networks slower
    main()
