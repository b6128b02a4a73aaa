"""A swarm trained by PPO against a detector in usnet_evasion_v0: does it raise J_m above the truthful swarm's?

    OMP_NUM_THREADS=1 python benchmarks/multiagent_ppo.py      # writes benchmarks/results/multiagent_ppo*

All heads make the same choice. Trained with seeds below 1000, measured with seeds from 2022. Matches that the files
hold are not played again; a swarm is trained when a game of it is missing.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from functools import cache
from typing import Any

import gymnasium as gym
import numpy as np
import torch
from gymnasium import spaces
from matplotlib.figure import Figure
from ppo_curve import Curve
from running import RESULTS, SEED, answer_help, play_games, read_csv
from stable_baselines3 import PPO
from usnet_env.evaluation.report import add_legend, group_rows, make_panels
from usnet_env.evaluation.store import RowFile

from usnet_env import make_detector
from usnet_env.drawing import COLORS, caption_figure, write_figure
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
CURVES = RESULTS / "multiagent_ppo_curve.csv"
CURVE = {"detector": "str", "follow": "str", "steps": "int", "games": "int", "J": "float", "swarm_payoff": "float"}


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


def training_seeds() -> Iterable[int]:
    rng = np.random.default_rng(0)
    while True:
        yield int(rng.integers(1000))


@cache
def trained(detector: str, follow: str) -> PPO:
    """A swarm that is trained in a match; its curve is appended to the file of curves."""
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
    match = {"detector": detector, "follow": follow}
    curve = Curve(match, lambda info: {"J": info["J"], "swarm_payoff": info["J"] - info["paid"]})
    agent.learn(MATCHES[detector, follow], callback=curve)
    with RowFile(CURVES, CURVE) as file:
        file.append(curve.rows)
    return agent


def play(cell: Mapping[str, Any], seed: int) -> dict[str, Any]:
    """One game of the truthful swarm, or of the trained one."""
    match = cell["detector"], cell["follow"]
    agent = trained(*match) if cell["swarm"] == "ppo" else None
    env = SwarmAsOne(*match, [seed])
    known, _ = env.reset()
    over, chosen = False, []
    while not over:
        chosen.append(np.zeros(4, np.int64) if agent is None else agent.predict(known, deterministic=True)[0])
        known, _, ended, cut, info = env.step(chosen[-1])
        over = ended or cut
    means = {name: round(float(value), 4) for name, value in zip(CHOICES, np.mean(chosen, axis=0), strict=True)}
    payoff = {"J": round(info["J"], 6), "swarm_payoff": round(info["J"] - info["paid"], 6)}
    return {**payoff, "success": info["success"], **means}


def draw(curves: list[dict[str, Any]]) -> Figure:
    """One panel for each match: J_m and the swarm's payoff, means over the games of a batch; 1 is truthful."""
    matches = group_rows(curves, lambda row: (row["detector"], row["follow"]))
    figure, (panels,) = make_panels(3.2 * len(matches), 3.6, 1, len(matches))
    for axes, (match, own) in zip(panels, matches.items(), strict=True):
        steps = [int(row["steps"]) for row in own]
        axes.plot(steps, [float(row["J"]) for row in own], color=COLORS[0], label="J_m")
        axes.plot(
            steps, [float(row["swarm_payoff"]) for row in own], color=COLORS[1], ls="--", label="J_m less the price"
        )
        axes.axhline(1.0, color="black", lw=0.8, ls=":", label="truthful swarm")
        axes.set_title(f"{match[0]}, {match[1]}", fontsize=9)
        axes.set_ylim(bottom=0)
        axes.set_xlabel("steps")
    panels[0].set_ylabel("mean over a batch")
    add_legend(figure, panels)
    caption = (
        "One training against each detector (n = 1, so without intervals). A point is the mean over the games that "
    )
    caption += "ended in a batch of steps. Higher is better for the swarm. The scales differ."
    caption_figure(figure, "Swarms trained by PPO against a detector", caption)
    return figure


def main() -> None:
    torch.set_num_threads(1)  # a program of its own, not the library: small networks wait for each other on more
    cells = [{"detector": name, "follow": f, "swarm": swarm} for name, f in MATCHES for swarm in ("truthful", "ppo")]
    games = [(cell, SEED + number) for cell in cells for number in range(GAMES)]
    play_games(RESULTS / "multiagent_ppo.csv", games, play, ("J", "swarm_payoff", "success", *CHOICES))
    write_figure(draw(read_csv(CURVES)), RESULTS / "multiagent_ppo.png")


if __name__ == "__main__":
    answer_help(__doc__)
    main()
