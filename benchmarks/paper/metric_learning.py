"""The paper's figures of metric learning: losses from three starts, and the feature space. Needs PyTorch.

    python benchmarks/paper/metric_learning.py --workers 2           # the losses
    python benchmarks/paper/metric_learning.py --draw                # their picture
    python benchmarks/paper/metric_learning.py --feature-space       # the other picture; it is computed (a minute)

The rows are in benchmarks/results/paper/metric_learning.csv.gz; the same command goes on where it stopped. A row is the
triplet loss of a step: off line of an episode with random follow strategies (`follow` is `off-line`), and on line of a
gradient step on a swarm of f1 to f7 with its true clusters. A `random` start isn't trained off line.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pandas as pd
import torch
from attention import mark_uavs
from scipy.stats import t as student
from shared import COLORS, FOLLOW, RESULTS, Game, measure, panels, parse, save_figure
from sklearn.decomposition import PCA

from detectors.clustering import make_clusterer
from detectors.mc_gassl.features import gru_features, inputs_of
from detectors.mc_gassl.gru import GruParameters, draw_parameters, load_meta_weights, read_parameters
from detectors.mc_gassl.train import MetaTraining, train_meta
from detectors.mc_gassl.training_steps import OnlineTraining, train_online
from detectors.mc_gassl.triplet import Metric
from detectors.weights import read_arrays
from usnet_env import Window
from usnet_env.envs import MultiClusterEnv
from usnet_env.evaluation.play import episode_seeds
from usnet_env.objectives import head_in_cluster, purity

STARTS = {  # colour, line, label
    "random": ("#777777", ":", "random start"),
    "joint": ("#d55e00", "--", "joint training (the paper's pre-training)"),
    "meta": ("#0072b2", "-", "meta learning"),
}
PAPER_LOSS = 0.125  # the paper's meta loss settles near this value
ONLINE_RATE = 1.0  # beta'
SMOOTH = 50  # a point of the off-line curve is the mean over this many episodes


def draw_swarm(env: MultiClusterEnv, seed: int, episode: int) -> tuple[Window, np.ndarray, Any]:
    """An episode's first window, the true cluster of every UAV, and the truth."""
    observation, _ = env.reset(seed=episode_seeds(seed, episode)[0])
    labels = np.unique(env.swarm.root, return_inverse=True)[1].astype(np.int64)
    return Window.from_observation(observation), labels, env.swarm


def make_generator(seed: int, purpose: int) -> torch.Generator:
    """The random numbers of a training's random start (purpose 0), or of its on-line steps (5)."""
    return torch.Generator().manual_seed(int(np.random.default_rng([seed, purpose, 0]).integers(2**63)))


def train_further(
    parameters: GruParameters, window: Window, labels: np.ndarray, steps: int, seed: int
) -> tuple[GruParameters, list[float]]:
    """On-line training on the true clusters of a window: the new parameters, and the loss before each step."""
    settings = OnlineTraining(steps, ONLINE_RATE, Metric())
    return train_online(parameters, inputs_of(window), torch.from_numpy(labels), settings, make_generator(seed, 5))


def play(game: Game, seed: int, strategies: int, episodes: int, steps: int) -> list[dict[str, Any]]:
    """Train one start off line (``random`` is not trained), then on line with every follow strategy."""
    start, number = game["start"], game["training"]
    own = int(np.random.SeedSequence(seed, spawn_key=(number,)).generate_state(1)[0])
    parameters, curves = draw_parameters(make_generator(own, 0)), {}
    if start != "random":
        training = MetaTraining(seed=own, method=start, strategies=strategies, episodes=episodes)
        with TemporaryDirectory() as folder:
            parameters = read_parameters(read_arrays(train_meta(folder, training)))
            curves["off-line"] = pd.read_csv(Path(folder) / "losses.csv").loss
    for place, follow in enumerate(FOLLOW):
        window, labels, _ = draw_swarm(MultiClusterEnv(follow=follow), seed, len(FOLLOW) * number + place)
        curves[follow] = train_further(parameters, window, labels, steps, own)[1]
    return [
        {**game, "follow": follow, "step": step, "loss": float(loss)}
        for follow, curve in curves.items()
        for step, loss in enumerate(curve)
    ]


def curve_of(rows: pd.DataFrame, start: str, online: bool) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Steps, mean loss over the trainings, and half the width of its 95 % interval (Student's t)."""
    rows = rows[(rows.start == start) & ((rows.follow != "off-line") == online)]
    step = rows.step if online else (rows.step // SMOOTH + 0.5) * SMOOTH
    losses = rows.groupby([step, "training"]).loss.mean().unstack()
    half = losses.sem(axis=1) * student.ppf(0.975, losses.shape[1] - 1)
    return losses.index.to_numpy(), losses.mean(axis=1).to_numpy(), half.to_numpy()


def draw(rows: pd.DataFrame, folder: Path) -> None:
    """Draw the off-line loss (left) and the on-line loss (right)."""
    figure, ((left, right),) = panels(11.5, 4.4, 1, 2, sharey=True)
    for start, (color, line, label) in STARTS.items():
        for axes in (right,) if start == "random" else (left, right):
            place, mean, half = curve_of(rows, start, online=axes is right)
            axes.plot(place, mean, color=color, ls=line, label=label, zorder=3 if line != "-" else 2)
            axes.fill_between(place, mean - half, mean + half, color=color, alpha=0.2, lw=0)
    left.axhline(PAPER_LOSS, color="black", lw=0.9, ls="-.", label=f"the paper's meta loss, about {PAPER_LOSS}")
    left.set_ylim(bottom=0)
    left.set(xlabel="episode", ylabel="triplet loss", title="Off line, on random follow strategies")
    right.set(xlabel="gradient step", title="On line, mean over f1 to f7, true clusters")
    caption = f"Means of n = {rows.training.nunique()} trainings; bands are 95 % intervals (Student's t)."
    save_figure(figure, folder / "meta-loss.png", "Loss of metric learning", caption)


def draw_feature_space(path: Path, seed: int, uavs: int = 237, steps: int = 500) -> None:
    """Draw the GRU features of one swarm (f1, M = 5) before and after on-line training on its true clusters.

    The upper panels begin with a random start, the lower ones with the meta-learned weights of the package.
    """
    window, labels, truth = draw_swarm(MultiClusterEnv(uavs=uavs), seed, 0)
    clusters = int(labels.max()) + 1
    figure, grid = panels(10.5, 9.6, 2, 2)
    starts = {"random start": draw_parameters(make_generator(seed, 0)), "meta-learned start": load_meta_weights()}
    for line, (start, before) in zip(grid, starts.items(), strict=True):
        after, _ = train_further(before, window, labels, steps, seed)
        for axes, when, parameters in zip(line, ("before", f"after {steps} episodes"), (before, after), strict=True):
            clusterer = make_clusterer("kmeans", features=partial(gru_features, parameters=parameters), count=clusters)
            found = clusterer.cluster(window, np.random.default_rng(seed))
            share, placed = purity(truth.root, found.labels), head_in_cluster(truth.head, truth.root, found.labels)
            _draw_components(axes, np.asarray(found.features), labels, truth.head)
            axes.set_title(f"{start}, {when}\nK-Means: purity {share:.2f}, head-in-cluster {placed:.2f}", fontsize=10)
    caption = (
        f"One swarm and one training of each start (n = 1): f1, M = {clusters}, N = {uavs}. A point is the GRU feature "
        "of a UAV, in the plane of the two principal components of its panel; colours are true clusters."
    )
    save_figure(figure, path, "Feature space of metric learning", caption)


def _draw_components(axes: Any, features: np.ndarray, labels: np.ndarray, head: np.ndarray) -> None:
    """Draw the two principal components of ``(N, w)`` features, true clusters in colours."""
    analysis = PCA(2)
    mark_uavs(axes, analysis.fit_transform(features), head, np.array(COLORS)[labels % len(COLORS)], 22)
    first, second = 100 * analysis.explained_variance_ratio_
    axes.set_xlabel(f"principal component 1 ({first:.0f} % of the variance)", fontsize=9)
    axes.set_ylabel(f"principal component 2 ({second:.0f} %)", fontsize=9)


def main(argv: list[str] | None = None) -> None:
    parser = parse(__doc__, RESULTS / "paper" / "metric_learning.csv.gz")
    parser.add_argument("--trainings", type=int, default=5, help="of each start, at least 2")
    parser.add_argument("--strategies", type=int, default=30, help="F, follow strategies of each training")
    parser.add_argument("--episodes", type=int, default=1000, help="E, episodes of each training")
    parser.add_argument("--steps", type=int, default=50, help="gradient steps on line")
    parser.add_argument("--feature-space", action="store_true", help="draw the feature space, and nothing else")
    given = parser.parse_args(argv)
    if given.feature_space:
        draw_feature_space(given.images / "feature-space.png", given.seed)
        return
    how = {name: getattr(given, name) for name in ("seed", "strategies", "episodes", "steps")}
    games: list[Game] = [{"training": k, "start": start} for k in range(given.trainings) for start in STARTS]
    draw(measure(given, games, partial(play, **how)), given.images)


if __name__ == "__main__":
    main()
