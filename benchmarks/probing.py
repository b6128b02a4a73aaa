"""USNET/Probing-v0: how often, how soon and at what reward scripted probers name the head, in six cells.

    OMP_NUM_THREADS=1 python benchmarks/probing.py
    python benchmarks/probing.py --draw                      # plays nothing: the tables of the rows

A row is an episode; all probers play the same swarms. ``none`` watches and never moves an intruder.
"""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
import pandas as pd
from paper import shared
from pivot import mean, pivot, rate, size

import usnet_env.envs  # noqa: F401  # registers the environment
from usnet_env import make_detector
from usnet_env.envs.play import play_probe
from usnet_env.envs.probers import TARGETS, Prober

ROWS = shared.RESULTS / "probing.csv.gz"
#: The arguments of each cell, beside those of all.
ALL = {"followers": 9, "look_every": 5}
CELLS: dict[str, dict[str, Any]] = {
    "decoys that fly as the head": {"mobility": "alike", "decoys": 3},
    "the same, noise 1 m": {"mobility": "alike", "decoys": 3, "position_noise": 1.0},
    "25 steps, noise 1 m": {"observation_steps": 25, "position_noise": 1.0},
    "noise 2.5 m": {"position_noise": 2.5},
    "smooth head, jitter, noise 1 m": {"mobility": "gauss_markov", "head_jitter": True, "position_noise": 1.0},
    "no noise": {},
}


def play(game: shared.Game) -> list[dict[str, Any]]:
    """Play an episode."""
    env = gym.make("USNET/Probing-v0", **ALL, **CELLS[game["cell"]])
    seed = int(np.random.default_rng([shared.SEED, game["episode"]]).integers(2**31))
    played, total = play_probe(env, Prober(shared.remember(make_detector, game["detector"]), game["target"]), seed)
    elapsed, steps = played.observation["elapsed"][0], env.unwrapped.config.observation_steps
    measured = {"right": int(played.info["J"] == 0), "elapsed": int(elapsed), "early": int(elapsed < steps)}
    return [game | measured | {"belief": played.answer.scores.max(), "reward": total}]


def report(rows: pd.DataFrame) -> str:
    """A line for each cell and prober, in their order."""
    order = [(cell, target) for cell in CELLS for target in TARGETS]
    rows = pd.concat([rows[(rows.cell == cell) & (rows.target == target)] for cell, target in order])
    columns = {"n": size, "names the head": rate("right"), "steps until it names": mean("elapsed", 1)}
    return pivot(rows, {"cell": "cell", "target": "target"}, {**columns, "reward": mean("reward")})


def main(argv: list[str] | None = None) -> None:
    parser = shared.parse(__doc__, ROWS)
    parser.add_argument("--detector", default="reader(objective='P1')")
    parser.add_argument("--episodes", type=int, default=50)
    given = parser.parse_args(argv)
    games = [
        {"detector": given.detector, "cell": cell, "target": target, "episode": episode}
        for episode in range(given.episodes)
        for cell in CELLS
        for target in TARGETS
    ]
    print(report(shared.measure(given, games, play)))


if __name__ == "__main__":
    main()
