"""The paper's figure of purity: clusterers on several features, with M given and estimated.

    python benchmarks/paper/purity.py --workers 2
    python benchmarks/paper/purity.py --clusterer kmeans --features raw gru-single --count given --episodes 5
    python benchmarks/paper/purity.py --draw                # the picture of the rows

The rows are in benchmarks/results/paper/purity.csv.gz; the same command goes on where it stopped. A row is the first
window of an episode, which `usnet evaluate` plays with the same seed: `found` clusters, their purity and
head-in-cluster (see `usnet_env.objectives`), and the seconds of clustering, features included. `raw` and `scaled` are
the paper's one window of T_0 steps in metres and standardised, `velocities` the series of all velocities; the features
of the GRU network need PyTorch.
"""

from __future__ import annotations

import time
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from shared import (
    COLORS,
    FOLLOW,
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

from detectors.clustering import make_clusterer
from usnet_env import Window
from usnet_env.envs import MultiClusterEnv
from usnet_env.evaluation.play import episode_seeds
from usnet_env.objectives import head_in_cluster, purity

#: The clusterers and their estimators of M: the gap statistic (the paper's rule, and ours), the eigengap, or their own.
CLUSTERERS = {
    "kmeans": ("gap-one-se", "gap"),
    "snmf": ("eigengap",),
    "spectral": ("eigengap",),
    "agglomerative": ("eigengap",),
    "hdbscan": ("own",),
}
FEATURES = ("raw", "scaled", "velocities", "gru-single", "gru-mean", "gru-series")
EPISODES_A_TASK = 10
#: The algorithms of the paper's picture: clusterer, features, label, marker. Metric learning is GRU and K-Means.
PICTURED = (
    ("kmeans", "raw", "K-Means, raw metres", "o"),
    ("kmeans", "scaled", "K-Means, scaled inputs", "o"),
    ("snmf", "raw", "symmetric NMF, raw metres", "^"),
    ("snmf", "scaled", "symmetric NMF, scaled inputs", "^"),
    ("spectral", "raw", "spectral clustering, raw metres", "s"),
    ("spectral", "scaled", "spectral clustering, scaled inputs", "s"),
    ("kmeans", "gru-single", "metric learning (GRU and K-Means)", "*"),
)


def list_methods(clusterers: list[str], features: list[str], counts: list[str]) -> list[Game]:
    """All combinations; HDBSCAN takes no M."""
    return [
        {"clusterer": name, "features": feature, "count": rule}
        for name in clusterers
        for count in counts
        if (name, count) != ("hdbscan", "given")
        for rule in (CLUSTERERS[name] if count == "estimated" else ("given",))
        for feature in features
    ]


@cache
def make_features(name: str) -> Any:
    """The argument ``features`` of a clusterer."""
    if not name.startswith("gru-"):
        return name
    from detectors.mc_gassl.features import gru_features  # they need PyTorch
    from detectors.mc_gassl.gru import load_meta_weights

    mode: Any = name.removeprefix("gru-")
    return partial(gru_features, parameters=load_meta_weights(), mode=mode)


def play(task: list[Game], seed: int) -> list[dict[str, Any]]:
    """Cluster the first windows of some episodes by one method."""
    method = {name: str(task[0][name]) for name in ("clusterer", "features", "count")}
    swarm = {name: value for name, value in task[0].items() if name not in (*method, "episode")}
    env, rows = MultiClusterEnv(**swarm), []
    count: Any = swarm["clusters"] if method["count"] == "given" else method["count"]
    clusterer = make_clusterer(method["clusterer"], count=count, features=make_features(method["features"]))
    for game in task:
        swarm_seed, detector_seed = episode_seeds(seed, int(game["episode"]))
        observation, _ = env.reset(seed=swarm_seed)
        window, truth = Window.from_observation(observation), env.swarm
        begun = time.perf_counter()
        found = clusterer.cluster(window, np.random.default_rng(detector_seed))
        seconds = time.perf_counter() - begun
        values = {
            "found": found.count,
            "purity": purity(truth.root, found.labels),
            "head_in_cluster": head_in_cluster(truth.head, truth.root, found.labels),
        }
        rows.append({**game, **values, "seconds": seconds})
    return rows


def draw(rows: pd.DataFrame, path: Path) -> None:
    """Draw the paper's picture: purity of its four algorithms for each follow strategy, M given."""
    rows = rows[rows["count"] == "given"]
    figure, ((axes,),) = panels(11, 5.4)
    places = [*FOLLOW, "all"]
    for number, (clusterer, features, label, marker) in enumerate(PICTURED):
        chosen = rows[(rows.clusterer == clusterer) & (rows.features == features)]
        shift = 0.8 * ((number + 0.5) / len(PICTURED) - 0.5)
        parts = {place: chosen if place == "all" else chosen[chosen.follow == place] for place in places}
        means = {places.index(place) + shift: interval(part, "purity") for place, part in parts.items() if len(part)}
        color = COLORS[number // 2] if marker != "*" else COLORS[-1]
        look = {"mfc": "white" if features == "raw" else color, "ms": 11 if marker == "*" else 6, "color": color}
        draw_intervals(axes, means, marker=marker, label=label, **look)
    for edge in range(len(FOLLOW)):
        axes.axvline(edge + 0.5, color="#cccccc" if edge < len(FOLLOW) - 1 else "#777777", lw=0.8)
    axes.set_xticks(range(len(places)), places)
    axes.set(xlabel="follow strategy", ylabel="purity", xlim=(-0.5, len(places) - 0.5), ylim=(0, 1.03))
    axes.grid(visible=False, axis="x")
    add_legend(figure, [axes])
    count = describe_counts(rows, ["clusterer", "features", "follow"])
    caption = (
        f"Means of {count} windows a point; bars are 95 % intervals. M is given. The "
        "paper, in words: metric learning is at least 0.1 above each of the others on average."
    )
    save_figure(figure, path, "Purity of clustering, M = 5, N = 82", caption)


def main(argv: list[str] | None = None) -> None:
    parser = parse(__doc__, RESULTS / "paper" / "purity.csv.gz")
    parser.add_argument("--clusterer", nargs="+", choices=list(CLUSTERERS), default=list(CLUSTERERS))
    parser.add_argument("--features", nargs="+", choices=FEATURES, default=list(FEATURES))
    parser.add_argument("--count", nargs="+", choices=["given", "estimated"], default=["given", "estimated"])
    parser.add_argument("--follow", nargs="+", default=list(FOLLOW))
    parser.add_argument("--episodes", type=int, default=30)
    given = parser.parse_args(argv)
    flight: Game = {"clusters": 5, "uavs": 82, "mobility": "iid", "head_jitter": False}
    tasks: list[list[Game]] = [
        [
            {**method, "follow": follow, **flight, "episode": episode}
            for episode in range(first, min(first + EPISODES_A_TASK, given.episodes))
        ]
        for follow in given.follow
        for method in list_methods(given.clusterer, given.features, given.count)
        for first in range(0, given.episodes, EPISODES_A_TASK)
    ]
    if not given.draw:
        measure(given.rows, tasks, partial(play, seed=given.seed), given.workers)
    draw(read_rows(given.rows), given.images / "purity.png")


if __name__ == "__main__":
    main()
