"""The paper's figures of P2: rounds and redundant UAVs against the follow strategy, M and N, and in one example.

    python benchmarks/paper/rounds.py --workers 2                     # all studies and detectors
    python benchmarks/paper/rounds.py --study follow --detector lagged-regression --episodes 10
    python benchmarks/paper/rounds.py --draw                          # the picture of the rows

The rows are in benchmarks/results/paper/rounds.csv.gz; the same command goes on where it stopped. A row is an episode
with the metrics of `usnet evaluate`, which plays the same episodes with the same seed; `named` and `hits` are the
candidates of each round, and how many of them were heads.
"""

from __future__ import annotations

from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pandas as pd
import shared
from shared import Game

import usnet_env.envs  # noqa: F401  registers the environments
from usnet_env import make_detector
from usnet_env.evaluation import TRIVIAL
from usnet_env.evaluation.play import episode_seeds, record_metrics
from usnet_env.replay import record_episode

DETECTORS = ("mc-gassl", "mc-gassl(gassl={'steps': 0})", "reader", "lagged-regression", "central-most", "track-outlier")
WORDS = Path(__file__).parent / "data" / "multi_cluster_in_words.csv"  # what the paper says of each study
PANELS = {"rounds": ("rounds R", 1), "redundancy": ("redundant UAVs, % of N", 100), "J": ("J_m", 1)}


def play(game: Game, seed: int) -> list[dict[str, Any]]:
    """Play one episode."""
    swarm, name = {key: value for key, value in game.items() if key not in ("detector", "episode")}, game["detector"]
    env = gym.make("USNET/MultiCluster-v0", **swarm)
    record = record_episode(env, make_detector(name), *episode_seeds(seed, game["episode"]), label=name)
    hits, redundant = np.asarray(record.hits), np.asarray(record.redundant)
    rounds = {name: " ".join(map(str, counts)) for name, counts in (("named", hits + redundant), ("hits", hits))}
    return [{**game, **record_metrics(record), "redundant": int(redundant.sum()), **rounds}]


def find_bounds(metric: str, words: pd.Series, uavs: int) -> tuple[float, float]:
    """The least and the largest value of a metric that the paper's words allow."""
    low, high = (0.0 if np.isnan(words.redundant_low) else words.redundant_low) / uavs, words.redundant_high / uavs
    rounds = 1.0 if np.isnan(words.rounds_low) else words.rounds_low, words.rounds_high
    return {"rounds": rounds, "redundancy": (low, high), "J": (rounds[0] + low, rounds[1] + high)}[metric]


def draw(rows: pd.DataFrame, folder: Path) -> None:
    """Draw R, redundancy and J_m of each study, beside what the paper says."""
    words = pd.read_csv(WORDS, index_col="study")
    figure, grid = shared.panels(15, 3.6 * len(shared.STUDIES) + 0.8, len(shared.STUDIES), len(PANELS))
    names = sorted(set(rows.detector), key=lambda name: (name in TRIVIAL, name))
    styles = shared.make_styles(names, 5)
    styles |= {name: {**styles[name], "color": "#777777"} for name in names if name in TRIVIAL}
    for line, (study, swarms) in zip(grid, shared.STUDIES.items(), strict=True):
        chosen, x = rows[rows[list(swarms)].isin(swarms).all(axis=1)], study if study in swarms else "follow"
        sizes = np.broadcast_to(swarms["uavs"], len(swarms[x]))
        for axes, (metric, (label, scale)) in zip(line, PANELS.items(), strict=True):
            bounds = scale * np.array([find_bounds(metric, words.loc[study], uavs) for uavs in sizes])
            edges = np.repeat(np.arange(len(bounds)), 2) + np.tile([-0.5, 0.5], len(bounds))
            axes.fill_between(edges, *np.repeat(bounds, 2, axis=0).T, color="#cccccc", label="the paper, in words")
            shared.draw_intervals(axes, chosen, x, swarms[x], metric, styles, scale)
            axes.set_ylabel(label)
            if metric == "redundancy":
                axes.set_yscale("symlog", linthresh=1)
                axes.set_ylim(-0.2, 150)
            else:
                axes.set_yscale("log")
            ticks = [0, 1, 10, 100] if metric == "redundancy" else [1, 2, 3, 5, 10, 20]
            axes.set_yticks(ticks, [str(tick) for tick in ticks])
            axes.minorticks_off()
        line[0].set_title(shared.TITLES[study], loc="left", fontsize=10)
    count = shared.describe_counts(rows, ["detector", "follow", "clusters", "uavs"])
    caption = f"Means of {count} episodes a point; bars are 95 % intervals. Grey marks: trivial policies."
    shared.save_figure(figure, folder / "rounds.png", "P2: rounds, redundancy and J_m", caption)


def main(argv: list[str] | None = None) -> None:
    parser = shared.make_parser(__doc__, shared.RESULTS / "paper" / "rounds.csv.gz")
    parser.add_argument("--study", action="append", choices=list(shared.STUDIES), help="may repeat; by default all")
    parser.add_argument("--detector", action="append", help="may repeat; by default mc-gassl and baselines")
    parser.add_argument("--episodes", type=int, default=10)
    options = parser.parse_args(argv)
    swarms = dict.fromkeys(
        swarm for study in options.study or shared.STUDIES for swarm in product(*shared.STUDIES[study].values())
    )
    games: list[Game] = [
        {"detector": detector, "follow": follow, "clusters": clusters, "uavs": uavs}
        | {"mobility": "iid", "head_jitter": False, "episode": episode}
        for detector in options.detector or (*DETECTORS, *TRIVIAL)
        for follow, clusters, uavs in swarms
        for episode in range(options.episodes)
    ]
    draw(shared.run_missing(options, games, partial(play, seed=options.seed)), options.images)


if __name__ == "__main__":
    main()
