"""How fast PPO learns raw windows, over ten seeds: curves, and greedy scores on swarms that it did not train on.

    OMP_NUM_THREADS=1 python benchmarks/learning.py --seeds 10
    python benchmarks/learning.py --draw                     # trains nothing: the table and the picture of the rows

A row is a rollout of 1,024 rounds, whose episodes it averages, or a test of the trained agent, which has a name.
"""

from __future__ import annotations

import importlib
import sys
import time
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from paper import shared
from pivot import Say, median, pivot, size
from scipy import stats

import usnet_env

ROWS = shared.RESULTS / "learning.csv.gz"
PICTURE = shared.IMAGES.parent / "learning.png"
ROLLOUT, EPISODES = 1024, 100  # rounds of a rollout, episodes of a test
SB3, TORCHRL = "Stable-Baselines3", "TorchRL"
TINY, SWARM = "USNET/SingleCluster-Tiny-v0", "USNET/MultiCluster-v0"
SETTINGS: dict[str, Any] = {"n_steps": 16, "batch_size": 256, "n_epochs": 4, "learning_rate": 5e-3, "device": "cpu"}
P2 = {"uavs": 30, "observation_steps": 20, "max_rounds": 5}


class Study(NamedTuple):
    """What PPO trains on and for how many rounds, the arguments of each test, and settings beside those of all."""

    env: str
    arguments: dict[str, Any]
    rounds: int
    tests: dict[str, dict[str, Any]]
    settings: dict[str, Any]
    frameworks: tuple[str, ...] = (SB3,)


FALLING = {"learning_rate": lambda left: 5e-3 * left}
LAWS = {law: {"follow": law} for law in shared.FOLLOW}
STUDIES = {
    "P1, f1, N = 8": Study(TINY, {}, 12 * ROLLOUT, {"f1": {}}, {}, (SB3, TORCHRL)),
    # The few laws that square velocities are learned last; so the rate falls to 0.
    "P1, random laws": Study(TINY, {"follow": "random"}, 32 * ROLLOUT, LAWS, FALLING),
    # Where one cluster is left, the first right answer ends the game: so the agent learns to name heads. Who names one
    # of 30 UAVs hits too seldom to learn from it.
    "P2, N = 30": Study(
        SWARM,
        {**P2, "clusters": [1, 3]},
        20 * ROLLOUT,
        {"M = 3": {**P2, "clusters": 3}},
        {"policy_kwargs": {"network": {"named": 6}}},
    ),
}


def train(study: Study, framework: str, seed: int) -> tuple[Any, list[float]]:
    """The trained policy, and the mean J of the episodes that ended in each rollout."""
    if framework == TORCHRL:
        sys.path.insert(0, str(shared.ROOT / "examples" / "frameworks"))
        return importlib.import_module("torchrl_ppo").train(study.rounds, seed)  # its environment is that of P1
    from stable_baselines3 import PPO

    from detectors.rl.sb3 import PairPolicy
    from usnet_env.frameworks.sb3 import SwarmVecEnv

    envs = SwarmVecEnv(study.env, 64, observe=("velocity", "alive"), **study.arguments)
    ended: list[list[float]] = [[] for _ in range(study.rounds // ROLLOUT)]

    def watch(now: dict[str, Any], _: Any) -> bool:
        played = now["self"].num_timesteps - 1
        ended[played // ROLLOUT].extend(info["J"] for info in now["infos"] if info)
        return True

    model = PPO(PairPolicy, envs, seed=seed, gamma=1.0, **SETTINGS | study.settings).learn(study.rounds, callback=watch)
    return model.policy, [float(np.mean(found)) for found in ended]


def play(game: shared.Game) -> list[dict[str, Any]]:
    """Train one agent, and test it."""
    from detectors.policy_detector import PolicyDetector

    study, began = STUDIES[game["study"]], time.process_time()
    policy, curve = train(study, game["framework"], 1000 * game["seed"])  # 64 games have 64 seeds
    seconds = time.process_time() - began
    rows = [{**game, "test": "", "rounds": ROLLOUT * k, "J": J, "exact": np.nan} for k, J in enumerate(curve, 1)]
    for test, arguments in study.tests.items():
        result = usnet_env.evaluate(
            study.env, PolicyDetector(policy), episodes=EPISODES, seed=shared.SEED, env_kwargs=arguments
        )
        scores = {name: result.summary[0]["metrics"][name]["mean"] for name in ("J", "exact")}
        rows.append({**game, "test": test, "rounds": study.rounds, **scores})
    return [row | {"seconds": seconds} for row in rows]


def describe(values: pd.Series) -> tuple[float, float, float]:
    """The mean of the middle half of the seeds, and its 95 % interval."""
    middle = float(stats.trim_mean(values, 0.25))
    if values.nunique() == 1:
        return middle, middle, middle
    how: dict[str, Any] = {"method": "percentile", "random_state": np.random.default_rng(0)}
    drawn = stats.bootstrap((values.to_numpy(),), lambda one, axis: stats.trim_mean(one, 0.25, axis), **how)
    return middle, *drawn.confidence_interval


def say(column: str, digits: int) -> Say:
    """The mean of the middle half with its interval, alone if all seeds have it."""

    def tell(rows: pd.DataFrame) -> str:
        middle, low, high = (f"{value:.{digits}f}" for value in describe(rows[column]))
        return middle if rows[column].nunique() == 1 else f"{middle} ({low}–{high})"

    return tell


def report(rows: pd.DataFrame) -> str:
    """A line for each test."""
    tests, lines = rows[rows.test.notna()], {"trained on": "study", "by PPO of": "framework", "tested on": "test"}
    columns = {"seeds": size, "rounds": median("rounds", ",.0f"), "CPU seconds": median("seconds", ".0f")}
    return pivot(tests, lines, {**columns, "exact": say("exact", 3), "J": say("J", 2)})


def draw(rows: pd.DataFrame) -> None:
    """The curves: J of the rounds of training, the mean of the middle half of the seeds with its interval."""
    rows = rows[rows.test.isna()]
    figure, grid = shared.panels(10, 2.8, 1, rows.study.nunique())
    for axes, (study, part) in zip(grid[0], rows.groupby("study", sort=False), strict=True):
        for (framework, curve), color in zip(part.groupby("framework"), shared.COLORS, strict=False):
            middle, low, high = np.transpose([describe(seeds.J) for _, seeds in curve.groupby("rounds")])
            rounds = curve.rounds.unique()
            axes.plot(rounds, middle, color=color, label=framework)
            axes.fill_between(rounds, low, high, color=color, alpha=0.2, lw=0)
        axes.set(xlabel="rounds of training", ylabel="J", title=study)
    caption = "J of sampled actions; interquartile mean over the seeds, with its 95 % interval."
    shared.save_figure(figure, PICTURE, "PPO with the pair network learns from raw windows", caption)


def main(argv: list[str] | None = None) -> None:
    parser = shared.parse(__doc__, ROWS)
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--studies", nargs="+", choices=list(STUDIES), default=list(STUDIES))
    given = parser.parse_args(argv)
    games = [
        {"study": name, "framework": framework, "seed": seed}
        for name in given.studies
        for seed in range(given.seeds)
        for framework in STUDIES[name].frameworks
    ]
    rows = shared.measure(given, games, play)
    draw(rows)
    print(report(rows))


if __name__ == "__main__":
    main()
