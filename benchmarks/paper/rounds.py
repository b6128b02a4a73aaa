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
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pandas as pd
from shared import (
    COLORS,
    FOLLOW,
    MARKERS,
    RESULTS,
    Game,
    add_legend,
    describe_counts,
    draw_intervals,
    interval,
    measure,
    panels,
    parse,
    read_rows,
    save_figure,
)

import usnet_env.envs  # noqa: F401  registers the environments
from usnet_env import make_detector
from usnet_env.evaluation import TRIVIAL
from usnet_env.evaluation.play import episode_seeds, record_metrics
from usnet_env.replay import record_episode

DETECTORS = ("mc-gassl", "lagged-regression")
WORDS = Path(__file__).parent / "data" / "multi_cluster_in_words.csv"  # what the paper says of each study
#: The swarms of each study: follow strategy, M, N.
STUDIES = {
    "follow": [(follow, 5, 82) for follow in FOLLOW],
    "clusters": [("f1", clusters, 82) for clusters in (2, 3, 5, 8, 10)],
    "uavs": [("f3", 5, uavs) for uavs in (40, 60, 82, 120, 160, 200)],
    "example": [("f1", 8, 185)],
}
TITLES = {
    "follow": "Against the follow strategy (M = 5, N = 82)",
    "clusters": "Against the number of clusters (f1, N = 82)",
    "uavs": "Against the number of UAVs (f3, M = 5)",
    "example": "The example (f1, M = 8, N = 185)",
}
SWARM = ("follow", "clusters", "uavs")
PANELS = {"rounds": ("rounds R", 1), "redundancy": ("redundant UAVs, % of N", 100), "J": ("J_m", 1)}


def play(task: list[Game], seed: int) -> list[dict[str, Any]]:
    """Play one episode."""
    (game,) = task
    swarm = {name: value for name, value in game.items() if name not in ("detector", "episode")}
    env, detector = gym.make("USNET/MultiCluster-v0", **swarm), make_detector(str(game["detector"]))
    record = record_episode(env, detector, *episode_seeds(seed, int(game["episode"])), label=str(game["detector"]))
    hits, redundant = np.asarray(record.hits), np.asarray(record.redundant)
    named, found = (" ".join(map(str, counts)) for counts in (hits + redundant, hits))
    return [{**game, **record_metrics(record), "redundant": int(redundant.sum()), "named": named, "hits": found}]


def place_of(study: str) -> str:
    """The column in which the swarms of a study differ."""
    return {"clusters": "clusters", "uavs": "uavs"}.get(study, "follow")


def select(rows: pd.DataFrame, study: str) -> pd.DataFrame:
    """The rows of a study with the paper's heads, swarm by swarm."""
    rows = rows[(rows.mobility == "iid") & ~rows.head_jitter]
    swarms = STUDIES[study]
    place = [
        swarms.index(swarm) if swarm in swarms else -1 for swarm in zip(*(rows[name] for name in SWARM), strict=True)
    ]
    return rows.assign(place=place)[np.array(place) >= 0].sort_values("place", kind="stable")


def said(metric: str, words: pd.Series, uavs: int) -> tuple[float, float]:
    """The least and the largest value of a metric that the paper's words allow."""
    fewest, most = (0.0 if np.isnan(words.redundant_low) else words.redundant_low) / uavs, words.redundant_high / uavs
    rounds = 1.0 if np.isnan(words.rounds_low) else words.rounds_low, words.rounds_high
    return {"rounds": rounds, "redundancy": (fewest, most), "J": (rounds[0] + fewest, rounds[1] + most)}[metric]


def draw(rows: pd.DataFrame, path: Path) -> None:
    """Draw R, redundancy and J_m of each study, beside what the paper says."""
    words = pd.read_csv(WORDS, index_col="study")
    figure, grid = panels(15, 3.6 * len(STUDIES) + 0.8, len(STUDIES), len(PANELS))
    detectors = sorted(set(rows.detector), key=lambda name: (name in TRIVIAL, name))
    for line, study in zip(grid, STUDIES, strict=True):
        chosen = select(rows, study)
        for axes, (metric, (label, scale)) in zip(line, PANELS.items(), strict=True):
            bounds = scale * np.array([said(metric, words.loc[study], swarm[2]) for swarm in STUDIES[study]])
            edges = np.repeat(np.arange(len(bounds)), 2) + np.tile([-0.5, 0.5], len(bounds))
            axes.fill_between(edges, *np.repeat(bounds, 2, axis=0).T, color="#cccccc", label="the paper, in words")
            for number, name in enumerate(detectors):
                shift = 0.7 * ((number + 0.5) / len(detectors) - 0.5)
                cells = chosen[chosen.detector == name].groupby("place")
                means = {place + shift: interval(cell, metric) for place, cell in cells}
                color = "#777777" if name in TRIVIAL else COLORS[number]
                draw_intervals(axes, means, scale, color=color, marker=MARKERS[number], ms=5, label=name)
            names = [str(dict(zip(SWARM, swarm, strict=True))[place_of(study)]) for swarm in STUDIES[study]]
            axes.set_xticks(range(len(names)), names)
            axes.set_ylabel(label)
            _scale_axis(axes, metric)
        line[0].set_title(TITLES[study], loc="left", fontsize=10)
    add_legend(figure, [grid[0, 0]])
    count = describe_counts(rows, ["detector", *SWARM])
    caption = f"Means of {count} episodes a point; bars are 95 % intervals. Grey marks: "
    save_figure(figure, path, "P2: rounds, redundancy and J_m", f"{caption}trivial policies.")


def _scale_axis(axes: Any, metric: str) -> None:
    if metric == "redundancy":
        axes.set_yscale("symlog", linthresh=1)
        axes.set(ylim=(-0.2, 150))
    else:
        axes.set_yscale("log")
    ticks = [0, 1, 10, 100] if metric == "redundancy" else [1, 2, 3, 5, 10, 20]
    axes.set_yticks(ticks, [str(tick) for tick in ticks])
    axes.minorticks_off()


def main(argv: list[str] | None = None) -> None:
    parser = parse(__doc__, RESULTS / "paper" / "rounds.csv.gz")
    parser.add_argument("--study", action="append", choices=list(STUDIES), help="may repeat; by default all")
    parser.add_argument("--detector", action="append", help="may repeat; by default mc-gassl and baselines")
    parser.add_argument("--episodes", type=int, default=10)
    parser.add_argument("--mobility", default="iid")
    parser.add_argument("--head-jitter", action="store_true")
    given = parser.parse_args(argv)
    if not given.draw:
        swarms = dict.fromkeys(swarm for study in given.study or STUDIES for swarm in STUDIES[study])
        tasks: list[list[Game]] = [
            [
                {
                    "detector": detector,
                    **dict(zip(SWARM, swarm, strict=True)),
                    "mobility": given.mobility,
                    "head_jitter": given.head_jitter,
                    "episode": episode,
                }
            ]
            for detector in given.detector or (*DETECTORS, *TRIVIAL)
            for swarm in swarms
            for episode in range(given.episodes)
        ]
        measure(given.rows, tasks, partial(play, seed=given.seed), given.workers)
    draw(read_rows(given.rows), given.images / "rounds.png")


if __name__ == "__main__":
    main()
