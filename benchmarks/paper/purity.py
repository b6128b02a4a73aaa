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
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import shared
from shared import FOLLOW, Game

from detectors.clustering import make_clusterer
from usnet_env import Window
from usnet_env.envs import MultiClusterEnv
from usnet_env.evaluation.play import episode_seeds
from usnet_env.objectives import head_in_cluster, purity

#: The clusterers and their estimators of M: the gap statistic or the eigengap.
CLUSTERERS = {"snmf": "eigengap", "spectral": "eigengap", "kmeans": "gap"}
SWARM = ("follow", "clusters", "uavs", "mobility", "head_jitter")
FEATURES = ("raw", "scaled", "velocities", "gru-single")
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


@cache
def make_features(name: str) -> Any:
    """The argument ``features`` of a clusterer."""
    if name != "gru-single":
        return name
    from detectors.mc_gassl.gru import compute_gru_features, load_meta_weights  # they need PyTorch

    return partial(compute_gru_features, parameters=load_meta_weights())


def play(game: Game, seed: int) -> list[dict[str, Any]]:
    """Cluster the first window of an episode."""
    swarm_seed, detector_seed = episode_seeds(seed, game["episode"])
    env = MultiClusterEnv(**{name: game[name] for name in SWARM})
    observation, _ = env.reset(seed=swarm_seed)
    window, truth = Window.from_observation(observation), env.swarm
    count = game["clusters"] if game["count"] == "given" else game["count"]
    clusterer = make_clusterer(game["clusterer"], count=count, features=make_features(game["features"]))
    start = time.perf_counter()
    clustering = clusterer.cluster(window, np.random.default_rng(detector_seed))
    seconds = time.perf_counter() - start
    values = {
        "found": clustering.count,
        "purity": purity(truth.root, clustering.labels),
        "head_in_cluster": head_in_cluster(truth.head, truth.root, clustering.labels),
    }
    return [{**game, **values, "seconds": seconds}]


def draw(rows: pd.DataFrame, folder: Path) -> None:
    """Draw the paper's picture: purity of its four algorithms for each follow strategy, M given."""
    rows, styles = rows[rows["count"] == "given"], {}
    labels = {(clusterer, features): label for clusterer, features, label, _ in PICTURED}
    rows = rows.assign(detector=[labels.get(key, "") for key in zip(rows.clusterer, rows.features, strict=True)])
    for number, (_, features, label, marker) in enumerate(PICTURED):
        color = shared.COLORS[number // 2] if marker != "*" else shared.COLORS[-1]
        face = "white" if features == "raw" else color
        styles[label] = {"marker": marker, "mfc": face, "ms": 11 if marker == "*" else 6, "color": color}
    figure, ((axes,),) = shared.panels(11, 5.4)
    shared.draw_intervals(
        axes, pd.concat([rows, rows.assign(follow="all")]), "follow", [*FOLLOW, "all"], "purity", styles
    )
    axes.set(xlabel="follow strategy", ylabel="purity", xlim=(-0.5, len(FOLLOW) + 0.5), ylim=(0, 1.03))
    count = shared.describe_counts(rows, ["clusterer", "features", "follow"])
    caption = (
        f"Means of {count} windows a point; bars are 95 % intervals. M is given. The paper, in words: "
        "metric learning is at least 0.1 above each of the others on average."
    )
    shared.save_figure(figure, folder / "purity.png", "Purity of clustering, M = 5, N = 82", caption)


def main(argv: list[str] | None = None) -> None:
    parser = shared.make_parser(__doc__, shared.RESULTS / "paper" / "purity.csv.gz")
    parser.add_argument("--clusterer", nargs="+", choices=list(CLUSTERERS), default=list(CLUSTERERS))
    parser.add_argument("--features", nargs="+", choices=FEATURES, default=list(FEATURES))
    parser.add_argument("--count", nargs="+", choices=["given", "estimated"], default=["given", "estimated"])
    parser.add_argument("--follow", nargs="+", default=list(FOLLOW))
    parser.add_argument("--episodes", type=int, default=30)
    options = parser.parse_args(argv)
    games: list[Game] = [
        {"clusterer": clusterer, "features": features, "count": "given" if count == "given" else CLUSTERERS[clusterer]}
        | {"follow": follow, "clusters": 5, "uavs": 82, "mobility": "iid", "head_jitter": False, "episode": episode}
        for follow, clusterer, features, count in product(
            options.follow, options.clusterer, options.features, options.count
        )
        for episode in range(options.episodes)
    ]
    draw(shared.run_missing(options, games, partial(play, seed=options.seed)), options.images)


if __name__ == "__main__":
    main()
