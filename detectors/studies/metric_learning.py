"""The paper's figures of metric learning: off-line and on-line losses by start, and the feature space."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from itertools import cycle
from pathlib import Path
from typing import TYPE_CHECKING, Any, Unpack

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student

from detectors.studies.common import FOLLOW, Reproduction, Running
from usnet_env.config import ArgumentError, quote
from usnet_env.drawing import CLUSTER_COLORS, caption_figure
from usnet_env.envs import MultiClusterEnv
from usnet_env.evaluation.episode import episode_seeds
from usnet_env.evaluation.report import add_legend, format_markdown, group_rows, keep_report, make_panels
from usnet_env.evaluation.suite import Game, Suite
from usnet_env.objectives import head_in_cluster, purity
from usnet_env.window import Window

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

STARTS = ("random", "joint", "meta")
PAPER_LOSS = 0.125  # the paper's meta loss settles near this value
_LAST = 10  # the final on-line loss is the mean over this many steps
_SMOOTH = 50  # a point of the off-line curve is the mean over this many episodes
_STEPS = 50  # steps of on-line training
_LOOKS = {  # colour, line and label of each start
    "random": ("#777777", ":", "random start"),
    "joint": ("#d55e00", "--", "joint training (the paper's pre-training)"),
    "meta": ("#0072b2", "-", "meta learning"),
}


@dataclass(frozen=True)
class Cell:
    """One training from one start; each training draws its own strategies, start and triplets."""

    training: int
    start: str  # of STARTS; "random" has no off-line rows, because it is not trained off line
    follow: str  # follow strategy of the on-line swarm; empty for off-line rows


@dataclass(frozen=True, kw_only=True)
class Row(Cell):
    """One loss."""

    step: int  # off line the episode, on line the gradient step, from 0
    loss: float  # triplet loss of this episode or step


def train_start(games: Sequence[Game[Cell]], seed: int, strategies: int, episodes: int, steps: int) -> list[Row]:
    """Train the start of all games off line (``random`` is not trained), then on line with every follow strategy."""
    from detectors.mc_gassl.train import MetaTraining, online_losses, start_of, trained

    number, start = games[0][0].training, games[0][0].start
    training = MetaTraining(
        seed=int(np.random.SeedSequence(seed, spawn_key=(number,)).generate_state(1)[0]),
        method="joint" if start == "joint" else "meta",
        strategies=strategies,
        episodes=episodes,
    )
    parameters, losses = (start_of(training), []) if start == "random" else trained(training)
    curves = {"": losses}
    for place, follow in enumerate(FOLLOW):
        window, labels, _ = _draw_swarm(MultiClusterEnv(follow=follow), seed, len(FOLLOW) * number + place)
        curves[follow] = online_losses(parameters, window, labels, steps, training)[1]
    return [
        Row(number, start, follow, step=step, loss=loss)
        for follow, curve in curves.items()
        for step, loss in enumerate(curve)
    ]


def _list_games(training: int, start: str, episodes: int, steps: int) -> list[Game[Cell]]:
    """List the games of one training, which one process plays."""
    counts = {"": 0 if start == "random" else episodes} | dict.fromkeys(FOLLOW, steps)
    return [(Cell(training, start, follow), step) for follow, count in counts.items() for step in range(count)]


def _draw_swarm(env: MultiClusterEnv, seed: int, episode: int) -> tuple[Window, NDArray[np.int64], Any]:
    """Draw an episode's swarm: its first window, the true cluster of every UAV, and the truth."""
    observation, _ = env.reset(seed=episode_seeds(seed, episode)[0])
    labels = np.unique(env.swarm.root, return_inverse=True)[1].astype(np.int64)
    return Window.from_observation(observation), labels, env.swarm


def reproduce(
    folder: Path,
    *,
    trainings: int = 5,
    strategies: int = 30,
    episodes: int = 1000,
    steps: int = _STEPS,
    seed: int = 2022,
    formats: Sequence[str] = ("png",),
    **running: Unpack[Running],
) -> Reproduction[Row]:
    """Measure the off-line loss of meta and joint training, and the on-line loss from their results and a random start.

    The arguments are those of ``usnet reproduce meta``; the ``steps`` of on-line training on a swarm of each of f1 to
    f7, with its true clusters; and ``running``: see :class:`Running`. The folder gets ``losses-F…-E…-seed….csv``,
    ``.md`` and the picture.

    Raises:
        ArgumentError: there are fewer than 2 trainings.
    """
    if trainings < 2:
        raise ArgumentError(f"trainings must be at least 2, for intervals, got {quote(trainings)}.")
    tasks = [_list_games(number, start, episodes, steps) for number in range(trainings) for start in STARTS]
    path = folder / f"losses-F{strategies}-E{episodes}-seed{seed}.csv"
    play = partial(train_start, seed=seed, strategies=strategies, episodes=episodes, steps=steps)
    suite = Suite(Cell, Row, play, number="step", order=("training", "start", "follow", "step"), digits=4)
    rows = suite.run(tasks, path, **running)
    text = report_losses(rows)
    keep_report(path, text, draw_losses(rows), formats)
    return Reproduction(rows, text)


def collect_curves(rows: Sequence[Row], start: str, online: bool) -> NDArray[np.float64]:
    """Collect the losses of one start, ``(trainings, steps)``; on line, the means over the follow strategies."""
    chosen = (row for row in rows if row.start == start and bool(row.follow) == online)
    groups = group_rows(chosen, lambda row: (row.training, row.step))
    trainings, steps = (sorted({key[k] for key in groups}) for k in (0, 1))
    return np.array([[np.mean([row.loss for row in groups[a, b]]) for b in steps] for a in trainings])


def compute_interval(values: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Compute the mean over trainings (the first axis) and the half width of its 95 % interval (Student's t)."""
    count = len(values)
    half = student.ppf(0.975, count - 1) * values.std(axis=0, ddof=1) / np.sqrt(count)
    return values.mean(axis=0), half


def report_losses(rows: Sequence[Row]) -> str:
    """Report the first and last losses of every start in a table, with 95 % intervals over the trainings."""
    lines = []
    for start in STARTS:
        online, offline = (collect_curves(rows, start, there) for there in (True, False))
        last = [offline[:, -_SMOOTH:].mean(axis=1)] if len(offline) else []
        means = [compute_interval(part) for part in (*last, online[:, 0], online[:, -_LAST:].mean(axis=1))]
        words = [f"{mean:.3f} ± {half:.3f}" for mean, half in means]
        lines.append((start, str(len(online)), *([] if last else ["–"]), *words))
    header = ("start", "trainings", "off-line loss at the end", "on-line loss, step 0", "on-line loss at the end")
    differences = (collect_curves(rows, "meta", True) - collect_curves(rows, "joint", True))[:, -_LAST:].mean(axis=1)
    mean, half = compute_interval(differences)
    conclusion = (
        f"Meta minus joint at the end of on-line training, by training: {mean:+.4f} ± {half:.4f}. The paper's "
        f"meta loss settles near {PAPER_LOSS}; the value of a loss depends on margin, scaling and batches."
    )
    return "\n".join([*format_markdown(header, lines, " --- "), "", conclusion, ""])


def draw_losses(rows: Sequence[Row]) -> Figure:
    """Draw the off-line loss (left) and the on-line loss (right): means over trainings, with 95 % intervals."""
    figure, (axes,) = make_panels(11.5, 4.4, 1, 2, sharey=True)
    for panel, online in zip(axes, (False, True), strict=True):
        for start in STARTS:
            values = collect_curves(rows, start, online)
            if not len(values):
                continue
            if not online:
                width = min(_SMOOTH, values.shape[1])
                whole = values[:, : values.shape[1] // width * width]
                values = whole.reshape(len(whole), -1, width).mean(axis=2)
            mean, half = compute_interval(values)
            place = np.arange(len(mean)) if online else (np.arange(len(mean)) + 0.5) * width
            color, line, label = _LOOKS[start]
            panel.plot(place, mean, color=color, ls=line, label=label, zorder=3 if line != "-" else 2)
            panel.fill_between(place, mean - half, mean + half, color=color, alpha=0.2, lw=0)
    axes[0].axhline(PAPER_LOSS, color="black", lw=0.9, ls="-.", label=f"the paper's meta loss, about {PAPER_LOSS}")
    axes[0].set_ylim(bottom=0)
    axes[0].set(xlabel="episode", ylabel="triplet loss", title="Off line, on random follow strategies")
    axes[1].set(xlabel="gradient step", title="On line, mean over f1 to f7, true clusters")
    add_legend(figure, axes)
    trainings = len({row.training for row in rows})
    caption = f"Means over n = {trainings} trainings; bands are 95 % intervals (Student's t). "
    caption += (
        "Off line, a point is the mean of 50 episodes. Joint training and meta learning give nearly equal curves."
    )
    caption_figure(figure, "Loss of metric learning", caption)
    return figure


def draw_feature_spaces(
    seed: int = 2022, follow: str = "f1", clusters: int = 5, uavs: int = 237, steps: int = 500
) -> Figure:
    """Draw the GRU network's features of one swarm before and after on-line training on its true clusters.

    The upper panels begin with a random start, the lower ones with the meta-learned weights of the package. Each panel
    shows the two principal components of the features of the newest T_0 samples; purity and head-in-cluster are those
    of K-Means with M given. The steps are gradient steps, the paper's metric learning episodes.
    """
    from detectors.clustering import make_clusterer
    from detectors.mc_gassl.features import gru_features
    from detectors.mc_gassl.gru import load_meta_weights
    from detectors.mc_gassl.train import MetaTraining, online_losses, start_of

    window, labels, truth = _draw_swarm(MultiClusterEnv(follow=follow, clusters=clusters, uavs=uavs), seed, 0)
    training = MetaTraining(seed=seed)
    figure, grid = make_panels(10.5, 9.6, 2, 2)
    starts = {"random start": start_of(training), "meta-learned start": load_meta_weights()}
    for row, (name, before) in zip(grid, starts.items(), strict=True):
        after, _ = online_losses(before, window, labels, steps, training)
        for panel, when, parameters in zip(row, ("before", f"after {steps} episodes"), (before, after), strict=True):
            features = partial(gru_features, parameters=parameters)
            found = make_clusterer("kmeans", features=features, count=clusters).cluster(
                window, np.random.default_rng(seed)
            )
            assert found.features is not None
            share = purity(truth.root, found.labels)
            placed = head_in_cluster(truth.head, truth.root, found.labels)
            _draw_feature_space(panel, found.features, labels, truth.head)
            panel.set_title(f"{name}, {when}\nK-Means: purity {share:.2f}, head-in-cluster {placed:.2f}", fontsize=10)
    add_legend(figure, [panel], clusters + 1)
    caption = f"One swarm and one training of each start (n = 1): {follow}, M = {clusters}, N = {uavs}. "
    caption += "A point is the GRU feature of a UAV, in the plane of the two principal components of its panel."
    caption_figure(figure, "Feature space of metric learning", caption)
    return figure


def _draw_feature_space(
    panel: Axes, features: NDArray[np.float64], labels: NDArray[np.int64], head: NDArray[np.bool_]
) -> None:
    """Draw the two principal components of ``(N, w)`` features; colours are true clusters, stars are heads."""
    centred = features - features.mean(axis=0)
    _, spread, axes = np.linalg.svd(centred, full_matrices=False)
    place = centred @ axes[:2].T
    shares = 100 * spread**2 / max(float((spread**2).sum()), 1e-300)
    colors, markers = (cycle(values) for values in (CLUSTER_COLORS, "os^Dv"))
    for label in range(int(labels.max()) + 1):
        color, mark = next(colors), next(markers)
        followers, heads = place[(labels == label) & ~head], place[(labels == label) & head]
        look: dict[str, Any] = {"marker": mark, "edgecolor": "white", "label": f"cluster {label + 1}"}
        panel.scatter(followers[:, 0], followers[:, 1], color=color, s=22, lw=0.4, **look)
        panel.scatter(heads[:, 0], heads[:, 1], color=color, marker="*", s=190, edgecolor="black", zorder=3)
    panel.scatter([], [], color="white", marker="*", s=190, edgecolor="black", label="head")
    panel.set_xlabel(f"principal component 1 ({shares[0]:.0f} % of the variance)", fontsize=9)
    panel.set_ylabel(f"principal component 2 ({shares[1]:.0f} %)", fontsize=9)
    panel.tick_params(labelsize=8)
