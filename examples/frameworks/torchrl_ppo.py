"""TorchRL: PPO with a network that reads raw windows and accepts swarms of any size.

pip install -e '.[torchrl]'
python examples/frameworks/torchrl_ppo.py
"""

import argparse
from collections.abc import Sequence

import torch
from tensordict.nn import TensorDictModule
from torch.distributions import Bernoulli, Independent
from torchrl.collectors import Collector
from torchrl.envs import InitTracker, TransformedEnv
from torchrl.modules import ProbabilisticActor
from torchrl.objectives import ClipPPOLoss
from torchrl.objectives.value import GAE

from detectors.policy_detector import PolicyDetector
from detectors.rl import PairNetwork
from usnet_env import evaluate
from usnet_env.frameworks.torchrl import SwarmEnv

ENV, ARGUMENTS = "USNET/SingleCluster-v0", {"followers": 7, "observation_steps": 20}
LARGER = {"followers": 15, "observation_steps": 20}
GAMES, BATCH = 64, 1024


class Bits(Independent):
    """The distribution of an action: N independent bits with one joint log-probability."""

    def __init__(self, logits: torch.Tensor) -> None:
        super().__init__(Bernoulli(logits=logits), 1)


class Critic(torch.nn.Module):
    """The value of a round, from a network of its own."""

    def __init__(self) -> None:
        super().__init__()
        self.network = PairNetwork()

    def forward(self, velocity: torch.Tensor, alive: torch.Tensor) -> torch.Tensor:
        """``(…, 1)``, whatever the leading axes."""
        value = self.network(velocity.flatten(0, -4), alive.flatten(0, -2))[1]
        return value.reshape(*alive.shape[:-1], 1)


def make_actor(env: TransformedEnv) -> ProbabilisticActor:
    """The network gives logits; the action is sampled from them during training, and is the mode otherwise."""
    network = TensorDictModule(PairNetwork(), in_keys=["velocity", "alive"], out_keys=["logits", "_value"])
    return ProbabilisticActor(
        network, in_keys=["logits"], spec=env.action_spec, distribution_class=Bits, return_log_prob=True
    )


def train(steps: int, seed: int = 0) -> tuple[ProbabilisticActor, list[float]]:
    """Return the actor, and the mean reward of a round in each batch."""
    torch.manual_seed(seed)
    # InitTracker marks the first step of an episode, as the collector expects for an actor with random actions.
    env = TransformedEnv(SwarmEnv(ENV, GAMES, observe=("velocity", "alive"), **ARGUMENTS), InitTracker())
    env.set_seed(seed)
    actor = make_actor(env)
    critic = TensorDictModule(Critic(), in_keys=["velocity", "alive"], out_keys=["state_value"])
    advantage = GAE(gamma=1.0, lmbda=0.95, value_network=critic)
    loss = ClipPPOLoss(actor, critic, entropy_bonus=False, normalize_advantage=True)
    optimizer = torch.optim.Adam(loss.parameters(), lr=5e-3)
    rewards = []
    for batch in Collector(env, actor, frames_per_batch=BATCH, total_frames=max(steps, BATCH)):
        with torch.no_grad():
            advantage(batch)
        flat = batch.reshape(-1)
        for _ in range(4):
            for rows in torch.randperm(len(flat)).split(256):
                parts = loss(flat[rows])
                optimizer.zero_grad()
                (parts["loss_objective"] + parts["loss_critic"]).backward()
                optimizer.step()
        rewards.append(float(batch["next", "reward"].mean()))
    return actor, rewards


def main(arguments: Sequence[str] | None = None) -> None:
    """Train, and compare with detectors, on larger swarms too."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--steps", type=int, default=16 * BATCH, help="environment steps to train for")
    parser.add_argument("--episodes", type=int, default=50, help="episodes to score")
    parser.add_argument("--seed", type=int, default=0)
    asked = parser.parse_args(arguments)
    actor, rewards = train(asked.steps, asked.seed)
    print("mean reward, batch by batch:", *(f"{value:.2f}" for value in rewards))
    for swarm in (ARGUMENTS, LARGER):
        print(f"{swarm['followers']} followers")
        detectors = {"PPO": PolicyDetector(actor), "regression": "lagged-regression(clusters=1)"}
        result = evaluate(ENV, detectors, episodes=asked.episodes, seed=2022, env_kwargs=swarm)
        print(result.to_markdown(["f1_first", "J"]))


if __name__ == "__main__":
    torch.set_num_threads(1)  # more threads make small networks slower
    main()
