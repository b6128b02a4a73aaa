"""The paper's figures of metric learning: off-line and on-line losses by start, and feature spaces."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student

from usnet_env.config import ArgumentError, quote
from usnet_env.envs import MultiClusterEnv
from usnet_env.evaluation.episode import episode_seeds
from usnet_env.files import atomic_write
from usnet_env.objectives import head_in_cluster, purity
from usnet_env.reproduce.rows import Measurement, counter, keep_report, measure
from usnet_env.window import Window

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["FOLLOW", "PAPER_LOSS", "STARTS", "Row", "Task", "features", "losses", "markdown"]

FOLLOW = ("f1", "f2", "f3", "f4", "f5", "f6", "f7")
STARTS = ("random", "joint", "meta")
PAPER_LOSS = 0.125  # near which the paper says that its meta loss settles
_LAST = 10  # on-line steps that the final loss is the mean of
_SMOOTH = 50  # off-line episodes that a point of the curve is the mean of
_STEPS = 50  # of on-line training


@dataclass(frozen=True)
class Row:
    """One loss.

    Args:
        training: number of the training; each has strategies, a start and draws of its own.
        start: one of :data:`STARTS`; off line ``random`` has no row, as it is not trained.
        follow: follow strategy of the on-line swarm; empty off line.
        step: the episode off line, the gradient step on line, from 0.
        loss: of the triplets drawn there.
    """

    training: int
    start: str
    follow: str
    step: int
    loss: float


@dataclass(frozen=True)
class Task:
    """One training of one start, and its on-line training on a swarm of every follow strategy."""

    training: int
    start: str
    strategies: int
    episodes: int
    steps: int


def play(task: Task, seed: int) -> list[Row]:
    """Train one start off line (the random one not), and on line from there."""
    from detectors.mc_gassl.train import MetaTraining, online_losses, start_of, trained

    training = MetaTraining(
        seed=int(np.random.SeedSequence(seed, spawn_key=(task.training,)).generate_state(1)[0]),
        method="joint" if task.start == "joint" else "meta",
        strategies=task.strategies,
        episodes=task.episodes,
    )
    offline: list[float] = []
    if task.start == "random":
        parameters = start_of(training)
    else:
        parameters, offline = trained(training)
    rows = [Row(task.training, task.start, "", step, loss) for step, loss in enumerate(offline)]
    for number, follow in enumerate(FOLLOW):
        window, labels, _ = _swarm(follow, seed, len(FOLLOW) * task.training + number)
        _, online = online_losses(parameters, window, labels, task.steps, training)
        rows += [Row(task.training, task.start, follow, step, loss) for step, loss in enumerate(online)]
    return rows


def _swarm(follow: str, seed: int, episode: int) -> tuple[Window, NDArray[np.int64], Any]:
    """The first window of an episode, the true cluster of every UAV, and the truth."""
    env = MultiClusterEnv(follow=follow)
    observation, _ = env.reset(seed=episode_seeds(seed, episode)[0])
    labels = np.unique(env.swarm.leader, return_inverse=True)[1].astype(np.int64)
    return Window.from_observation(observation), labels, env.swarm


def _keys(task: Task) -> list[tuple[int, str, str, int]]:
    offline = 0 if task.start == "random" else task.episodes
    return [(task.training, task.start, "", step) for step in range(offline)] + [
        (task.training, task.start, follow, step) for follow in FOLLOW for step in range(task.steps)
    ]


def losses(
    folder: Path,
    *,
    trainings: int = 5,
    strategies: int = 30,
    episodes: int = 1000,
    steps: int = _STEPS,
    seed: int = 2022,
    workers: int = 1,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> list[Row]:
    """Off-line loss of meta and joint training, and on-line loss from the starts that they give and from a random one.

    Args:
        folder: gets ``losses-F…-E…-seed….csv``, ``.md`` and ``.png``.
        trainings: how many times all is done from new strategies and a new start; at least 2, for the bands.
        strategies: F of each training, drawn by ``random_follow_strategy``.
        episodes: E of each training.
        steps: of on-line training on a swarm of each of f1 to f7, with its true clusters.
        seed: of the measurement.
        workers: processes.
        progress: called with the losses done and to do.
    """
    if trainings < 2:
        raise ArgumentError(f"trainings must be at least 2, for bands, got {quote(trainings)}.")
    tasks = [Task(number, start, strategies, episodes, steps) for number in range(trainings) for start in STARTS]
    path = folder / f"losses-F{strategies}-E{episodes}-seed{seed}.csv"
    rows = measure(
        Measurement(Row, partial(play, seed=seed), _keys, _key, _key),
        tasks,
        path,
        workers,
        counter(sum(len(_keys(task)) for task in tasks), progress),
    )
    keep_report(path, markdown(rows), draw(rows))
    return rows


def _key(row: Row) -> tuple[int, str, str, int]:
    return row.training, row.start, row.follow, row.step


def curves(rows: Sequence[Row], start: str, online: bool) -> NDArray[np.float64]:
    """``(trainings, steps)`` losses of one start, on line the mean over the follow strategies."""
    chosen = [row for row in rows if row.start == start and bool(row.follow) == online]
    total: dict[tuple[int, int], list[float]] = {}
    for row in chosen:
        total.setdefault((row.training, row.step), []).append(row.loss)
    trainings, steps = ({key[k] for key in total} for k in (0, 1))
    return np.array([[np.mean(total[a, b]) for b in sorted(steps)] for a in sorted(trainings)])


def band(values: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Mean over trainings (the first axis) and the half width of its 95 % interval (Student's t)."""
    count = len(values)
    half = student.ppf(0.975, count - 1) * values.std(axis=0, ddof=1) / np.sqrt(count)
    return values.mean(axis=0), half


def markdown(rows: Sequence[Row]) -> str:
    """First and last losses of every start, with intervals over the trainings."""
    lines = [
        "| start | trainings | off-line loss at the end | on-line loss, step 0 | on-line loss at the end |",
        "| --- | --- | --- | --- | --- |",
    ]
    for start in STARTS:
        online = curves(rows, start, True)
        offline = curves(rows, start, False)
        cells = [online[:, 0], online[:, -_LAST:].mean(axis=1)]
        words = [f"{mean:.3f} ± {half:.3f}" for mean, half in map(band, cells)]
        end = "–" if not len(offline) else "{:.3f} ± {:.3f}".format(*band(offline[:, -_SMOOTH:].mean(axis=1)))
        lines.append(f"| {start} | {len(online)} | {end} | {words[0]} | {words[1]} |")
    differences = (curves(rows, "meta", True) - curves(rows, "joint", True))[:, -_LAST:].mean(axis=1)
    mean, half = band(differences)
    lines += [
        "",
        f"Meta less joint at the end of on-line training, by training: {mean:+.4f} ± {half:.4f}. The paper "
        f"says that its meta loss settles near {PAPER_LOSS}; a loss depends on margin, scaling and batches.",
        "",
    ]
    return "\n".join(lines)


def draw(rows: Sequence[Row]) -> Figure:
    """Off-line loss on the left, on-line loss on the right; lines are means, bands 95 % intervals over trainings."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.5, 3.6), layout="constrained")
    axes = figure.subplots(1, 2)
    colours = {"random": "tab:gray", "joint": "tab:orange", "meta": "tab:blue"}
    for panel, online in zip(axes, (False, True), strict=True):
        for start in STARTS:
            values = curves(rows, start, online)
            if not len(values):
                continue
            if not online:
                width = min(_SMOOTH, values.shape[1])
                whole = values[:, : values.shape[1] // width * width]
                values = whole.reshape(len(whole), -1, width).mean(axis=2)
            mean, half = band(values)
            place = np.arange(len(mean)) if online else (np.arange(len(mean)) + 0.5) * width
            panel.plot(place, mean, color=colours[start], label=start)
            panel.fill_between(place, mean - half, mean + half, color=colours[start], alpha=0.2, lw=0)
        panel.grid(alpha=0.3)
        panel.set_ylim(bottom=0)
    axes[0].axhline(PAPER_LOSS, color="black", lw=0.8, ls=":", label="the paper's meta loss")
    axes[0].set(xlabel="episode of off-line training", ylabel="triplet loss", title="off line, random strategies")
    axes[1].set(xlabel="gradient step on line", title="on line, f1 to f7 and true clusters")
    for panel in axes:
        panel.legend(fontsize=8)
    return figure


def features(folder: Path, seed: int = 2022, follow: str = "f1", steps: int = 200) -> Path:
    """The feature space of one swarm (M = 5, N = 82) before and after training, two principal axes, a panel each.

    Panels: the paper's inputs at one time, as K-Means on metres would see them; the features of the GRU network with a
    random start, with the weights that ship, and after on-line training from there on the true clusters. Purity and
    head-in-cluster are K-Means' with M given.

    Args:
        folder: gets ``features-….png``.
        seed: of the swarm.
        follow: its follow strategy.
        steps: of on-line training.

    Returns:
        The picture's path.
    """
    from matplotlib.figure import Figure

    from detectors.clustering import make_clusterer
    from detectors.mc_gassl.features import gru_features
    from detectors.mc_gassl.train import MetaTraining, online_losses, start_of
    from detectors.mc_gassl.weights import load_meta_weights

    window, labels, truth = _swarm(follow, seed, 0)
    training = MetaTraining(seed=seed)
    shipped = load_meta_weights()
    adapted, _ = online_losses(shipped, window, labels, steps, training)
    spaces: dict[str, Any] = {
        "inputs of one time, metres": "raw",
        "GRU, random start": partial(gru_features, parameters=start_of(training)),
        "GRU, meta-learned": partial(gru_features, parameters=shipped),
        f"GRU, and {steps} on-line steps": partial(gru_features, parameters=adapted),
    }
    figure = Figure(figsize=(13, 3.7), layout="constrained")
    for panel, (name, space) in zip(figure.subplots(1, len(spaces)), spaces.items(), strict=True):
        clusterer = make_clusterer("kmeans", features=space, count=int(labels.max()) + 1)
        found = clusterer.cluster(window, np.random.default_rng(seed))
        assert found.features is not None
        centred = found.features - found.features.mean(axis=0)
        place = centred @ np.linalg.svd(centred, full_matrices=False)[2][:2].T
        panel.scatter(*place[~truth.head].T, c=labels[~truth.head], cmap="tab10", vmin=0, vmax=9, s=18)
        panel.scatter(
            *place[truth.head].T, c=labels[truth.head], cmap="tab10", vmin=0, vmax=9, s=110, marker="*", edgecolor="k"
        )
        share = purity(truth.leader, found.labels)
        heads = head_in_cluster(truth.head, truth.leader, found.labels)
        panel.set_title(f"{name}\npurity {share:.2f}, head in cluster {heads:.2f}", fontsize=9)
        panel.set(xticks=[], yticks=[])
    figure.suptitle(f"{follow}, M = {labels.max() + 1}, N = {len(labels)}: colours are the true clusters, stars heads")
    path = folder / f"features-{follow}-seed{seed}.png"
    with atomic_write(path) as aside:
        figure.savefig(aside, format="png", dpi=110)
    return path
