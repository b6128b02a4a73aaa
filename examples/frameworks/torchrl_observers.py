"""TorchRL: observers that share a network learn with REINFORCE to find the heads together.

pip install -e '.[torchrl]'
python examples/frameworks/torchrl_observers.py
"""

import argparse
from collections.abc import Sequence

import torch
from copied_network import Bits, CopiedNetwork
from observers_game import ARGUMENTS, PRICE, compare_detectors
from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from torchrl.envs import ExplorationType, PettingZooWrapper, set_exploration_type
from torchrl.modules import ProbabilisticActor
from wrappers import ParallelBoxMasks

from detectors.policy_detector import PolicyDetector
from usnet_env import make_detector
from usnet_env.multiagent import usnet_observers_v0

Key = str | tuple[str, ...]
GROUP = "observer"  # TorchRL stacks agents whose names differ by a number


def make_env() -> PettingZooWrapper:
    """The game in TorchRL: ``("observer", "observation", …)`` with an axis of K observers."""
    return PettingZooWrapper(ParallelBoxMasks(usnet_observers_v0.parallel_env(**ARGUMENTS, redundancy_price=PRICE)))


def make_actor(network: CopiedNetwork, seen: list[Key], before: tuple[str, ...] = ()) -> ProbabilisticActor:
    """Votes from the entries ``seen`` (velocities and legal UAVs). The keys of the results start with ``before``."""
    logits = (*before, "logits")
    return ProbabilisticActor(
        TensorDictModule(network, in_keys=seen, out_keys=[logits]),
        in_keys=[logits],
        out_keys=[(*before, "action")],
        distribution_class=Bits,
    )


def train(updates: int, games: int = 16, seed: int = 0) -> tuple[CopiedNetwork, list[float]]:
    """Return the network, and the mean return of the games of each update."""
    torch.manual_seed(seed)
    env = make_env()
    env.set_seed(seed)
    network = CopiedNetwork()
    actor = make_actor(network, [(GROUP, "observation", "velocity"), (GROUP, "observation", "legal")], (GROUP,))
    optimizer = torch.optim.Adam(network.parameters(), lr=5e-2)
    returns = []
    for _ in range(updates):
        with torch.no_grad(), set_exploration_type(ExplorationType.RANDOM):
            played = [env.rollout(ARGUMENTS["max_rounds"], actor) for _ in range(games)]
        to_go = torch.cat([_compute_reward_to_go(game) for game in played])
        steps = torch.cat([game.select((GROUP, "observation"), (GROUP, "action")) for game in played])
        log_prob = actor.get_dist(steps).log_prob(steps[GROUP, "action"].float()).sum(dim=-1)  # joint, of all votes
        optimizer.zero_grad()
        (-log_prob * (to_go - to_go.mean()) / to_go.std()).mean().backward()
        optimizer.step()
        returns.append(float(torch.stack([_compute_reward_to_go(game)[0] for game in played]).mean()))
    return network, returns


def _compute_reward_to_go(game: TensorDict) -> torch.Tensor:
    """``(rounds,)``: the sum of rewards from each round to the end, which is the same for all observers."""
    reward = game["next", GROUP, "reward"][:, 0, 0]
    return reward.flip(0).cumsum(0).flip(0)


def main(arguments: Sequence[str] | None = None) -> None:
    """Train, then let every observer use the network, and compare with detectors."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--updates", type=int, default=40)
    parser.add_argument("--games", type=int, default=20, help="games to score")
    parser.add_argument("--seed", type=int, default=0)
    asked = parser.parse_args(arguments)
    network, returns = train(asked.updates, seed=asked.seed)
    print("mean return, update by update:", *(f"{value:.2f}" for value in returns))
    trained = PolicyDetector(make_actor(network, ["velocity", "alive"]))
    others = {"lagged-regression": make_detector("lagged-regression"), "random": make_detector("random(count=2)")}
    compare_detectors({"REINFORCE": trained, **others}, asked.games)


if __name__ == "__main__":
    torch.set_num_threads(1)  # more threads make small networks slower
    main()
