"""Labelled windows: train a network on windows whose heads are known, without rewards.

pip install -e '.[torch]'
python examples/frameworks/supervised.py
"""

import argparse
from collections.abc import Iterator, Sequence
from itertools import count, islice

import gymnasium as gym
import torch
from torch import Tensor, nn
from torch.utils.data import DataLoader, IterableDataset, get_worker_info

from detectors.policy_detector import PolicyDetector
from detectors.rl import PairNetwork
from usnet_env import evaluate

ENV, GAMES, RATE = "USNET/SingleCluster-Field-v0", 64, 5e-3  # GAMES: windows of a batch


class LabelledWindows(IterableDataset):
    """The first windows of new games, batch after batch without end.

    A batch of B games has ``velocity`` ``(B, T_ob, N, 3)`` and ``alive`` ``(B, N)``, and as labels ``head`` ``(B, N)``,
    the heads, and ``leader`` ``(B, N)``, the UAV that each one follows (its own index: none). Each worker of a loader
    draws other games.
    """

    def __init__(self, env: str, seed: int = 0, **arguments: object) -> None:
        self.env, self.seed, self.arguments = env, seed, arguments

    def __iter__(self) -> Iterator[dict[str, Tensor]]:
        how = {"observe": ("velocity", "alive"), "reveal_truth": True, "autoreset_mode": "Disabled"}
        envs, worker = gym.make_vec(self.env, GAMES, **how, **self.arguments), get_worker_info()
        number, workers = (worker.id, worker.num_workers) if worker else (0, 1)
        for batch in count(number, workers):
            seen, truth = envs.reset(seed=self.seed + GAMES * batch)
            arrays = {**seen, "head": truth["head"], "leader": truth["leader"]}
            yield {name: torch.from_numpy(array) for name, array in arrays.items()}


class Answer(nn.Module):
    """The logits of the network, as :class:`PolicyDetector` takes them."""

    def __init__(self, network: PairNetwork) -> None:
        super().__init__()
        self.network = network

    def forward(self, observation: dict[str, Tensor]) -> Tensor:
        """``(B, N)``."""
        return self.network(observation["velocity"], observation["alive"])[0]


def train(windows: int, seed: int = 0, workers: int = 0, **arguments: object) -> tuple[PairNetwork, list[float]]:
    """Return the network, and the loss of each batch: the cross-entropy of the heads among the UAVs of a swarm."""
    torch.manual_seed(seed)  # a script may seed PyTorch's global generator, from which layers draw their weights
    network, batches = PairNetwork(), max(1, windows // GAMES)
    optimizer = torch.optim.Adam(network.parameters(), lr=RATE)
    decay, losses = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, batches), list[float]()
    loader = DataLoader(LabelledWindows(ENV, seed, **arguments), batch_size=None, num_workers=workers)
    for batch in islice(loader, batches):
        head = batch["head"] / batch["head"].sum(dim=1, keepdim=True).clamp(min=1)  # 0 where no UAV leads
        logits, _ = network(batch["velocity"], batch["alive"])
        loss = -(head * logits.log_softmax(dim=1)).sum(dim=1).mean()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        decay.step()
        losses.append(loss.item())
    return network, losses


class Likeliest(Answer):
    """Names the likeliest UAV: its logit is 1, those of the others are -1."""

    def forward(self, observation: dict[str, Tensor]) -> Tensor:
        """``(B, N)``."""
        logits = super().forward(observation)
        return torch.where(logits == logits.amax(dim=1, keepdim=True), 1.0, -1.0)


def main(arguments: Sequence[str] | None = None) -> None:
    """Train, and compare with detectors."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--windows", type=int, default=16_384, help="windows to train on")
    parser.add_argument("--episodes", type=int, default=200, help="episodes to score")
    parser.add_argument("--workers", type=int, default=0, help="processes that draw windows")
    parser.add_argument("--seed", type=int, default=0)
    asked = parser.parse_args(arguments)
    network, losses = train(asked.windows, asked.seed, asked.workers)
    print(f"loss, first and last: {losses[0]:.2f} {losses[-1]:.2f}")
    detectors = {
        "supervised": PolicyDetector(Likeliest(network)),
        "untrained": PolicyDetector(Likeliest(PairNetwork())),
    }
    detectors |= {name: name for name in ("reader(policy='map')", "lagged-regression(clusters=1)", "random")}
    result = evaluate(ENV, detectors, episodes=asked.episodes, seed=2**40)
    print(result.to_markdown(["f1_first", "J"]))


if __name__ == "__main__":
    torch.set_num_threads(1)  # more threads make small networks slower
    main()
