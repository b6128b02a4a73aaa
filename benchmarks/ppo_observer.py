"""An observer trained by PPO in a small P2 (M=3, N=20), scored beside the detectors.

    OMP_NUM_THREADS=1 python benchmarks/ppo_observer.py        # writes benchmarks/results/ppo_observer*

It is trained with seeds below 1000, iid heads and follow strategies drawn by random_follow_strategy, from the reward
of the game alone (-1 for each round, -1/N for each redundant candidate). It is scored with seeds from 2022 on f1 to f7,
which it was not trained on. Its weights are kept as safetensors; if they exist, they are scored and not trained again.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import gymnasium as gym
import numpy as np
import torch
from detectors.studies.common import FOLLOW
from gymnasium import spaces
from learned import DETECTORS, KEPT
from ppo_curve import Curve
from running import RESULTS, SEED, make_parser, play_games, write_csv
from stable_baselines3 import PPO
from stable_baselines3.common.policies import MultiInputActorCriticPolicy
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from torch import Tensor, nn
from usnet_env.evaluation.episode import episode_seeds, play_episode

from detectors.learned.features import PAIR_FEATURES, pair_features
from detectors.policy_detector import PolicyDetector
from detectors.weights import read_arrays, write_weights
from usnet_env import Window
from usnet_env.envs import MultiClusterEnv
from usnet_env.evaluation.agents import as_agent
from usnet_env.plugins import make_detector
from usnet_env.swarm.random_follow import random_follow_strategy

SMALL = {"clusters": 3, "uavs": 20, "max_rounds": 10}
SWARMS: dict[str, dict[str, Any]] = {
    "iid": {},
    "iid, T_ob = 12": {"observation_steps": 12},
    "gauss_markov, jitter": {"mobility": "gauss_markov", "head_jitter": True},
}
WEIGHTS = RESULTS / "ppo_observer.safetensors"
STEPS, BATCH = 12_288, 512
GAMES = 20
WIDTH = 16


def observe(window: Window) -> dict[str, np.ndarray]:
    """The observation of the policy: statistics of all pairs of UAVs, 0 for destroyed ones, and which UAVs live."""
    living = np.flatnonzero(window.alive)
    pairs = np.zeros((window.uavs, window.uavs, PAIR_FEATURES), np.float32)
    pairs[np.ix_(living, living)] = pair_features(window, living)
    return {"pairs": pairs, "alive": window.alive.astype(np.float32)}


class SmallGame(gym.Env[Any, Any]):
    """P2 with another random follow strategy in every episode; the policy sees what :func:`observe` makes of it."""

    def __init__(self) -> None:
        uavs = SMALL["uavs"]
        self.observation_space = spaces.Dict(
            {
                "pairs": spaces.Box(-np.inf, np.inf, (uavs, uavs, PAIR_FEATURES), np.float32),
                "alive": spaces.Box(0, 1, (uavs,), np.float32),
            }
        )
        self.action_space = spaces.MultiBinary(uavs)
        self.draws = np.random.default_rng(0)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Start the next game: its swarm's seed is below 1000."""
        self.game = MultiClusterEnv(follow=random_follow_strategy(self.draws), **SMALL)
        seen, info = self.game.reset(seed=int(self.draws.integers(1000)))
        return self._observed(seen), info

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Name the living UAVs among the action's bits."""
        named = np.asarray(action).astype(bool) & self.alive
        seen, reward, ended, cut, info = self.game.step(named.astype(np.int8))
        return self._observed(seen), reward, ended, cut, info

    def _observed(self, seen: Mapping[str, Any]) -> dict[str, np.ndarray]:
        window = Window.from_observation(seen)
        self.alive = window.alive
        return observe(window)


class Attention(BaseFeaturesExtractor):
    """A vector for each UAV from the pairs, ``(B, N * (WIDTH + 1))``; its last number says whether the UAV lives."""

    def __init__(self, space: spaces.Dict) -> None:
        uavs = space["alive"].shape[0]
        super().__init__(space, uavs * (WIDTH + 1))
        self.pair = nn.Linear(2 * PAIR_FEATURES, WIDTH)
        self.mixed = nn.Linear(WIDTH, WIDTH)
        self.attention = nn.Linear(WIDTH, 1)
        self.uav = nn.Linear(2 * WIDTH, WIDTH)

    def forward(self, seen: dict[str, Tensor]) -> Tensor:
        """Attention of every UAV i over all j, summed once over i and once over j."""
        pairs, alive = seen["pairs"], seen["alive"]
        x = torch.tanh(self.mixed(torch.tanh(self.pair(torch.cat([pairs, pairs.transpose(1, 2)], dim=3)))))
        legal = alive[:, :, None] * alive[:, None, :] * (1 - torch.eye(alive.shape[1]))
        attention = torch.softmax(self.attention(x)[..., 0].masked_fill(legal == 0, -1e9), dim=2) * legal
        given = attention[..., None] * x
        uav = torch.tanh(self.uav(torch.cat([given.sum(dim=1), given.sum(dim=2)], dim=2)))
        return torch.cat([uav, alive[..., None]], dim=2).flatten(1)


def split_features(features: Tensor) -> tuple[Tensor, Tensor]:
    """What :class:`Attention` gives: the UAVs' vectors, ``(B, N, WIDTH)``, and whether they live, ``(B, N, 1)``."""
    uav = features.unflatten(1, (-1, WIDTH + 1))
    return uav[..., :-1], uav[..., -1:]


class PerUav(nn.Module):
    """One logit for each UAV by the same weights; the most probable living UAV is always named."""

    def __init__(self) -> None:
        super().__init__()
        self.logit = nn.Linear(WIDTH, 1)

    def forward(self, features: Tensor) -> Tensor:
        """``(B, N)`` logits."""
        uav, alive = split_features(features)
        logits = self.logit(uav)[..., 0].masked_fill(alive[..., 0] == 0, -20.0)
        return logits + torch.relu(0.1 - logits.max(dim=1, keepdim=True).values)


class Whole(nn.Module):
    """The value of a swarm: the mean over the living."""

    def __init__(self) -> None:
        super().__init__()
        self.value = nn.Linear(WIDTH, 1)

    def forward(self, features: Tensor) -> Tensor:
        """``(B, 1)``."""
        uav, alive = split_features(features)
        return self.value((uav * alive).sum(dim=1) / alive.sum(dim=1).clamp(min=1))


class EquivariantPolicy(MultiInputActorCriticPolicy):
    """Permuting the UAVs permutes the action's bits in the same way."""

    def _build(self, lr_schedule: Any) -> None:
        super()._build(lr_schedule)
        self.action_net, self.value_net = PerUav(), Whole()
        self.optimizer = self.optimizer_class(self.parameters(), lr=lr_schedule(1), **self.optimizer_kwargs)


def untrained() -> PPO:
    return PPO(
        EquivariantPolicy,
        SmallGame(),
        learning_rate=2e-3,
        n_steps=BATCH,
        batch_size=128,
        n_epochs=8,
        gamma=1.0,
        ent_coef=0.0,
        policy_kwargs={"net_arch": [], "features_extractor_class": Attention},
        seed=0,
        device="cpu",
    )


def trained() -> EquivariantPolicy:
    """The policy of the weights file, which is trained first if there is none."""
    agent = untrained()
    if WEIGHTS.exists():
        agent.policy.load_state_dict(read_arrays(WEIGHTS), strict=False)  # shared layers are in the file once
        return agent.policy
    curve = Curve({}, lambda info: {name: info[name] for name in ("J", "success")})
    agent.learn(STEPS, callback=curve)
    write_csv(RESULTS / "ppo_observer_curve.csv", curve.rows)
    arrays = dict(agent.policy.named_parameters())
    write_weights(WEIGHTS, arrays, {"algorithm": "PPO", "steps": STEPS, **SMALL}, curve.rows[-1])
    return agent.policy


def main() -> None:
    parser = make_parser(__doc__)
    parser.add_argument("--games", type=int, default=GAMES, help="for each detector and follow strategy")
    games = parser.parse_args().games
    torch.set_num_threads(1)  # a program of its own, not the library: small networks wait for each other on more
    detectors = {"ppo": PolicyDetector(trained(), observe=observe)}
    detectors |= {name: make_detector(name) for name in DETECTORS}

    def play(cell: Mapping[str, Any], episode: int) -> dict[str, Any]:
        env = MultiClusterEnv(follow=cell["follow"], **SMALL, **SWARMS[cell["swarm"]])
        agent = as_agent(detectors[cell["detector"]])
        row = play_episode(env, agent, cell["detector"], episode, episode_seeds(SEED, episode))
        return {name: round(row[name], 5) for name in KEPT}

    cells = [{"swarm": s, "follow": f, "detector": name} for s in SWARMS for f in FOLLOW for name in detectors]
    every = [(cell, episode) for cell in cells for episode in range(games)]
    play_games(RESULTS / "ppo_observer.csv", every, play, KEPT, "episode")


if __name__ == "__main__":
    main()
