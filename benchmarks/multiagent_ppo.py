"""A swarm trained by PPO against a detector in usnet_evasion_v0: does it raise J_m above the truthful swarm's?

    OMP_NUM_THREADS=1 python benchmarks/multiagent_ppo.py      # writes benchmarks/results/multiagent_ppo*

All heads make the same choice. Trained with seeds below 1000, measured with seeds from 2022. Matches that the files
hold are not played again.
"""

from __future__ import annotations

import csv
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import torch
from gymnasium import spaces
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from multiagent_table import RESULTS, SEED
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback

from usnet_env import make_detector
from usnet_env.files import atomic_write
from usnet_env.multiagent.policies import DetectorObserver
from usnet_env.multiagent.usnet_evasion_v0 import OBSERVER, parallel_env

MATCHES = {  # detector and follow strategy: steps of training
    ("lagged-regression", "f1"): 12_288,
    ("lagged-regression(lags=8)", "f1"): 12_288,
    ("follow-mixture", "f1"): 6_144,
    ("follow-mixture", "f6"): 3_072,
}
MAX_ROUNDS = 10
BATCH = 512
GAMES = 40
CHOICES = ("mobility", "jitter", "decoys", "delay")


class SwarmAsOne(gym.Env[Any, Any]):
    """The swarm as one agent against a detector; an observation is what the swarm knows of the game."""

    def __init__(self, detector: str, follow: str, seeds: Iterable[int]) -> None:
        self.game = parallel_env(follow=follow, max_rounds=MAX_ROUNDS)
        self.observer = DetectorObserver(make_detector(detector))
        self.seeds = iter(seeds)
        self.choices = self.game.manoeuvres.choices
        self.action_space = spaces.MultiDiscrete(self.choices)
        self.observation_space = spaces.Box(0, 1, (4 + int(self.choices.sum()),), np.float32)
        self.paid = 0.0

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Start the next game; the seeds are those of the constructor."""
        game_seed = next(self.seeds)
        self.seen, infos = self.game.reset(seed=game_seed)
        own = int(np.random.SeedSequence(game_seed, spawn_key=(1,)).generate_state(1)[0])
        self.observer.reset(own, self.game.action_space(OBSERVER))
        self.paid = 0.0
        return self._known(infos[OBSERVER], np.zeros(4, np.int64)), {}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Make the same choice for every head; the reward is the swarm's."""
        actions = {agent: np.asarray(action) for agent in self.game.agents if agent != OBSERVER}
        actions[OBSERVER] = self.observer.act(self.seen[OBSERVER])
        self.seen, rewards, ended, cut, infos = self.game.step(actions)
        info = infos[OBSERVER]
        self.paid += info["price"]
        info = {**info, "paid": self.paid}
        return self._known(info, action), -rewards[OBSERVER] - info["price"], ended[OBSERVER], cut[OBSERVER], info

    def _known(self, info: Mapping[str, Any], action: Any) -> Any:
        heads = self.game.config.clusters
        left = int(self.game.swarm.heads_left)  # the swarm knows its own heads; the observer's info has no such number
        game = [info["round"] / MAX_ROUNDS, left / heads, info["hits"] / heads, info["redundant"] / 82]
        last = [np.arange(many) == value for many, value in zip(self.choices, action, strict=True)]
        return np.concatenate([game, *last]).astype(np.float32)


class Curve(BaseCallback):
    """A row for every batch of steps: the mean over the games that ended in it."""

    def __init__(self, detector: str, follow: str) -> None:
        super().__init__()
        self.match = {"detector": detector, "follow": follow}
        self.rows, self.ended = [], []

    def _on_step(self) -> bool:
        self.ended += [info for info, done in zip(self.locals["infos"], self.locals["dones"], strict=True) if done]
        return True

    def _on_rollout_end(self) -> None:
        objective = np.array([info["J"] for info in self.ended])
        paid = np.array([info["paid"] for info in self.ended])
        means = {"J": objective.mean(), "swarm_payoff": (objective - paid).mean()}
        self.rows.append(
            {
                **self.match,
                "steps": self.num_timesteps,
                "games": len(self.ended),
                **{name: round(float(value), 4) for name, value in means.items()},
            }
        )
        print(self.rows[-1], flush=True)
        self.ended = []


def training_seeds() -> Iterable[int]:
    rng = np.random.default_rng(0)
    while True:
        yield int(rng.integers(1000))


def measured(detector: str, follow: str, swarm: str, choose: Any) -> list[dict[str, Any]]:
    """One row for each game, with seeds from 2022."""
    env = SwarmAsOne(detector, follow, range(SEED, SEED + GAMES))
    rows = []
    for seed in range(SEED, SEED + GAMES):
        known, _ = env.reset()
        over, chosen = False, []
        while not over:
            action = choose(known)
            known, _, ended, cut, info = env.step(action)
            over = ended or cut
            chosen.append(action)
        means = {name: round(float(value), 4) for name, value in zip(CHOICES, np.mean(chosen, axis=0), strict=True)}
        payoff = {"J": round(info["J"], 6), "swarm_payoff": round(info["J"] - info["paid"], 6)}
        cell = {"detector": detector, "follow": follow, "swarm": swarm, "seed": seed}
        rows.append({**cell, **payoff, "success": info["success"], **means})
    return rows


def earlier(path: Path) -> list[dict[str, Any]]:
    """Rows of an earlier run."""
    if not path.exists():
        return []
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def write(path: Path, rows: list[dict[str, Any]]) -> None:
    with atomic_write(path) as aside, aside.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(rows[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)


def draw(curves: list[dict[str, Any]]) -> Figure:
    """One panel for each match: J_m and the swarm's payoff, means over the games of a batch; 1 is truthful."""
    matches = list(dict.fromkeys((row["detector"], row["follow"]) for row in curves))
    figure = Figure(figsize=(3.2 * len(matches), 3.2), layout="constrained")
    FigureCanvasAgg(figure)
    for axes, match in zip(figure.subplots(1, len(matches), squeeze=False)[0], matches, strict=True):
        own = [row for row in curves if (row["detector"], row["follow"]) == match]
        steps = [int(row["steps"]) for row in own]
        axes.plot(steps, [float(row["J"]) for row in own], color="#0072b2", label="J_m")
        axes.plot(steps, [float(row["swarm_payoff"]) for row in own], color="#d55e00", label="J_m minus the price")
        axes.axhline(1.0, color="black", lw=0.8, ls=":", label="truthful")
        axes.set_title(f"{match[0]}, {match[1]}", fontsize=9)
        axes.set_ylim(bottom=0)
        axes.set_xlabel("steps")
        axes.grid(alpha=0.3)
    axes.legend(fontsize=8)
    figure.suptitle("PPO swarms while they train")
    return figure


def main() -> None:
    """Train, measure and draw."""
    torch.set_num_threads(1)  # a program of its own, not the library: small networks wait for each other on more
    curves, rows = earlier(RESULTS / "multiagent_ppo_curve.csv"), earlier(RESULTS / "multiagent_ppo.csv")
    for (detector, follow), steps in MATCHES.items():
        if any((row["detector"], row["follow"]) == (detector, follow) for row in rows):
            continue
        agent = PPO(
            "MlpPolicy",
            SwarmAsOne(detector, follow, training_seeds()),
            learning_rate=3e-3,
            n_steps=BATCH,
            batch_size=128,
            gamma=1.0,
            ent_coef=0.01,
            policy_kwargs={"net_arch": [32, 32]},
            seed=0,
            device="cpu",
        )
        curve = Curve(detector, follow)
        agent.learn(steps, callback=curve)
        curves += curve.rows
        rows += measured(detector, follow, "truthful", lambda _: np.zeros(4, np.int64))
        rows += measured(
            detector, follow, "ppo", lambda known, agent=agent: agent.predict(known, deterministic=True)[0]
        )
        write(RESULTS / "multiagent_ppo_curve.csv", curves)
        write(RESULTS / "multiagent_ppo.csv", rows)
    with atomic_write(RESULTS / "multiagent_ppo.png") as aside:
        draw(curves).savefig(aside, format="png", dpi=100)


if __name__ == "__main__":
    main()
