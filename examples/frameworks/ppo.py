"""PPO in one file, without a framework: a network learns from raw windows to name the head of one cluster.

pip install -e '.[torch]'
python examples/frameworks/ppo.py
"""

import argparse
from collections.abc import Sequence

import gymnasium as gym
import numpy as np
import torch
from torch import Tensor, nn
from torch.distributions import Bernoulli, Independent

from detectors.policy_detector import PolicyDetector
from detectors.rl import PairNetwork
from usnet_env import evaluate

ENV, ARGUMENTS = "USNET/SingleCluster-v0", {"followers": 7, "observation_steps": 20}
GAMES, ROUNDS = 64, 16  # games in the batch, rounds in a rollout
RATE, EPOCHS, BATCH, CLIP, DISCOUNT, SMOOTH = 5e-3, 4, 256, 0.2, 1.0, 0.95
Rollout = dict[str, Tensor]


class Actor(nn.Module):
    """The logits of the network, as :class:`PolicyDetector` takes them."""

    def __init__(self, network: PairNetwork) -> None:
        super().__init__()
        self.network = network

    def forward(self, observation: dict[str, Tensor]) -> Tensor:
        """``(B, N)``."""
        return self.network(observation["velocity"], observation["alive"])[0]


def act(network: PairNetwork, velocity: Tensor, alive: Tensor) -> tuple[Independent, Tensor]:
    """The distribution of the candidates ``(B, N)``, and the values ``(B,)``."""
    logits, value = network(velocity, alive)
    return Independent(Bernoulli(logits=logits), 1), value


@torch.no_grad()
def play(envs: gym.vector.VectorEnv, network: PairNetwork, seen: dict[str, np.ndarray]) -> tuple[Rollout, dict]:
    """Play rounds of all games; every entry of the rollout is ``(ROUNDS, GAMES, ...)``."""
    steps = []
    for _ in range(ROUNDS):
        velocity, alive = torch.from_numpy(seen["velocity"]), torch.from_numpy(seen["alive"])
        policy, value = act(network, velocity, alive)
        action = policy.sample()
        seen, reward, terminated, truncated, info = envs.step(action.numpy().astype(np.int8))
        over, rest = torch.from_numpy(terminated | truncated), torch.zeros(GAMES)
        if truncated.any():  # the game would have gone on: the value of its last window stands for the rest
            last = info["final_obs"][truncated]
            windows = (torch.from_numpy(np.stack([one[name] for one in last])) for name in ("velocity", "alive"))
            rest[torch.from_numpy(truncated)] = act(network, *windows)[1]
        step = {"velocity": velocity, "alive": alive, "action": action, "value": value, "over": over, "rest": rest}
        steps.append({**step, "log_prob": policy.log_prob(action), "reward": torch.from_numpy(reward).float()})
    rollout = {name: torch.stack([step[name] for step in steps]) for name in steps[0]}
    after = act(network, torch.from_numpy(seen["velocity"]), torch.from_numpy(seen["alive"]))[1]
    return {**rollout, "advantage": find_advantages(rollout, after)}, seen


def find_advantages(rollout: Rollout, after: Tensor) -> Tensor:
    """Generalised advantages; ``after`` ``(GAMES,)`` are the values of the windows after the rollout."""
    advantage, last = torch.zeros_like(rollout["reward"]), torch.zeros(GAMES)
    for t in reversed(range(ROUNDS)):
        goes_on = 1.0 - rollout["over"][t].float()
        surprise = rollout["reward"][t] + DISCOUNT * (after * goes_on + rollout["rest"][t]) - rollout["value"][t]
        last = surprise + DISCOUNT * SMOOTH * goes_on * last
        advantage[t], after = last, rollout["value"][t]
    return advantage


def learn(network: PairNetwork, optimizer: torch.optim.Optimizer, rollout: Rollout) -> None:
    """Improve the network by one rollout."""
    flat = {name: values.flatten(0, 1) for name, values in rollout.items()}
    target = flat["advantage"] + flat["value"]
    for _ in range(EPOCHS):
        for rows in torch.randperm(GAMES * ROUNDS).split(BATCH):
            policy, value = act(network, flat["velocity"][rows], flat["alive"][rows])
            advantage = flat["advantage"][rows]
            advantage = (advantage - advantage.mean()) / (advantage.std() + 1e-8)
            ratio = (policy.log_prob(flat["action"][rows]) - flat["log_prob"][rows]).exp()
            gain = torch.minimum(ratio * advantage, ratio.clamp(1 - CLIP, 1 + CLIP) * advantage).mean()
            loss = 0.5 * (value - target[rows]).square().mean() - gain
            optimizer.zero_grad()
            loss.backward()
            nn.utils.clip_grad_norm_(network.parameters(), 0.5)
            optimizer.step()


def train(steps: int, seed: int = 0) -> tuple[PairNetwork, list[float]]:
    """Return the network, and the mean reward of a round in each rollout."""
    torch.manual_seed(seed)  # a script may seed PyTorch's global generator, from which layers draw their weights
    envs = gym.make_vec(ENV, GAMES, autoreset_mode="SameStep", observe=("velocity", "alive"), **ARGUMENTS)
    seen, rewards, network = envs.reset(seed=seed)[0], [], PairNetwork()
    optimizer = torch.optim.Adam(network.parameters(), lr=RATE, eps=1e-5)
    for _ in range(max(1, steps // (GAMES * ROUNDS))):
        rollout, seen = play(envs, network, seen)
        learn(network, optimizer, rollout)
        rewards.append(float(rollout["reward"].mean()))
    return network, rewards


def main(arguments: Sequence[str] | None = None) -> None:
    """Train, and compare with detectors."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--steps", type=int, default=16_384, help="environment steps to train for")
    parser.add_argument("--episodes", type=int, default=50, help="episodes to score")
    parser.add_argument("--seed", type=int, default=0)
    asked = parser.parse_args(arguments)
    network, rewards = train(asked.steps, asked.seed)
    print("mean reward, rollout by rollout:", *(f"{value:.2f}" for value in rewards))
    detectors = {
        "PPO": PolicyDetector(Actor(network)),
        "regression": "lagged-regression(clusters=1)",
        "random": "random",
    }
    result = evaluate(ENV, detectors, episodes=asked.episodes, seed=2022, env_kwargs=ARGUMENTS)
    print(result.to_markdown(["f1_first", "J"]))


if __name__ == "__main__":
    torch.set_num_threads(1)  # more threads make small networks slower
    main()
