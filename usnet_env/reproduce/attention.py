"""The paper's figures of attention: heat maps of alpha and of every head's alpha_l, and the hierarchy graph."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from usnet_env.config import ArgumentError
from usnet_env.detection import Detection
from usnet_env.envs import SingleClusterEnv
from usnet_env.files import atomic_write
from usnet_env.plugins import make_detector
from usnet_env.window import Window

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["Scene", "heads_figure", "hierarchy_figure", "reproduce", "scene_of", "sizes_figure"]

#: Detectors whose attention is shown side by side, and what they are called.
SHOWN = {"gassl(preset='paper')": "the paper's network (input pooling)", "gassl": "default (prediction pooling)"}
SIZES = (2, 5, 10, 25, 40, 50)  # m of the paper's f7 heat maps
_SEEDS_TRIED = 10_000


@dataclass(frozen=True)
class Scene:
    """One window of one cluster, whose head sits at the index that the paper's figure has.

    Args:
        follow: follow strategy.
        followers: m.
        head: index of the head, from 0 (the paper's i_L - 1).
        seed: of the environment.
        window: what was seen.
    """

    follow: str
    followers: int
    head: int
    seed: int
    window: Window


def scene_of(follow: str, followers: int, head: int, seed: int) -> Scene:
    """The first episode from ``seed`` on whose head has the wanted index.

    Raises:
        ArgumentError: no such index.
    """
    if not 0 <= head <= followers:
        raise ArgumentError(f"head must be an index from 0 to {followers}, got {head}.")
    env = SingleClusterEnv(follow=follow, followers=followers)
    for tried in range(seed, seed + _SEEDS_TRIED):
        observation, _ = env.reset(seed=tried)
        if env.swarm.head[head]:
            return Scene(follow, followers, head, tried, Window.from_observation(observation))
    raise ArgumentError(f"seed must lead to a head at index {head} soon, got {seed}.")


def detect(scene: Scene, detector: str) -> Detection:
    """The detector's answer to the scene."""
    made = make_detector(detector)
    made.reset(scene.seed)
    return made.detect(scene.window)


def _canvas(width: float, height: float) -> Figure:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def _heat(axes: Axes, alpha: NDArray[np.float64], head: int, title: str) -> Any:
    """One heat map: row i is whom UAV i attends to; the head's column is marked below it."""
    image = axes.imshow(alpha, cmap="viridis", vmin=0.0, vmax=max(float(alpha.max()), 1e-9), aspect="equal")
    axes.plot([head], [len(alpha) - 0.1], marker="^", color="#d55e00", ms=7, clip_on=False)
    axes.set_title(title, fontsize=9)
    step = max(1, len(alpha) // 8)
    axes.set_xticks(range(0, len(alpha), step), [str(i + 1) for i in range(0, len(alpha), step)], fontsize=7)
    axes.set_yticks(range(0, len(alpha), step), [str(i + 1) for i in range(0, len(alpha), step)], fontsize=7)
    return image


def heads_figure(scene: Scene, answers: dict[str, Detection]) -> Figure:
    """Attention alpha of both poolings and alpha_l of every attention head of the paper's network."""
    figure = _canvas(14, 7.5)
    grid = figure.subplots(2, 4).ravel()
    paper, ours = (answers[name] for name in SHOWN)
    if paper.attention is None or ours.attention is None:
        raise ArgumentError("answers must hold attention, got a detection without.")
    heads = paper.extras["attention_heads"]
    panels = [("α, the paper's network", paper.attention), ("α, prediction pooling", ours.attention)]
    panels += [
        (f"α_{number + 1}: v at t−{number}" if number < len(heads) - 1 else f"α_{number + 1}: position", alpha)
        for number, alpha in enumerate(heads)
    ]
    for axes, (title, alpha) in zip(grid, panels, strict=False):
        figure.colorbar(_heat(axes, alpha, scene.head, title), ax=axes, shrink=0.8)
    for axes in grid[len(panels) :]:
        axes.set_visible(False)
    figure.suptitle(
        f"Whom every UAV attends to ({scene.follow}, m={scene.followers}); row: who attends, column: to whom; "
        f"▲ the head, UAV {scene.head + 1}"
    )
    return figure


def sizes_figure(scenes: list[Scene], answers: list[dict[str, Detection]]) -> Figure:
    """Attention alpha of both poolings at several sizes."""
    figure = _canvas(3.1 * len(scenes), 6.8)
    grid = figure.subplots(2, len(scenes), squeeze=False)
    for column, (scene, found) in enumerate(zip(scenes, answers, strict=True)):
        for row, (name, label) in enumerate(SHOWN.items()):
            hit = "found" if found[name].candidates[scene.head] else "missed"
            title = f"m={scene.followers}, {label}\nhead {hit}"
            attention = found[name].attention
            if attention is not None:
                _heat(grid[row, column], attention, scene.head, title)
    figure.suptitle(f"Attention α at several sizes ({scenes[0].follow}); ▲ the head, UAV {scenes[0].head + 1}")
    return figure


def hierarchy_figure(scene: Scene, answers: dict[str, Detection]) -> Figure:
    """The hierarchy graph: UAVs from above, lines from each to the others, as wide as its attention to them."""
    figure = _canvas(13, 6.5)
    place = scene.window.position[-1, :, :2]
    for axes, (name, label) in zip(figure.subplots(1, 2), SHOWN.items(), strict=True):
        attention = answers[name].attention
        if attention is None:
            continue
        for i, row in enumerate(attention):
            for j, weight in enumerate(row):
                if i != j and weight > 0.02:
                    ends = place[[i, j]]
                    axes.plot(ends[:, 0], ends[:, 1], color="#0072b2", lw=4.0 * float(weight), alpha=0.5, zorder=1)
        axes.scatter(place[:, 0], place[:, 1], s=40, color="#555555", zorder=2, label="UAV")
        axes.scatter(*place[scene.head], s=260, marker="*", color="#d55e00", edgecolor="black", zorder=3, label="head")
        named = place[answers[name].candidates]
        axes.scatter(named[:, 0], named[:, 1], s=420, facecolor="none", edgecolor="#009e73", lw=2.5, label="named")
        for i, (x, y) in enumerate(place):
            axes.annotate(str(i + 1), (x, y), textcoords="offset points", xytext=(6, 5), fontsize=8)
        axes.set_title(label)
        axes.set_xlabel("x in m")
        axes.set_ylabel("y in m")
        axes.set_aspect("equal")
        axes.legend(loc="best", fontsize=8, labelspacing=1.2, borderpad=1.0)
    figure.suptitle(f"Hierarchy graph ({scene.follow}, m={scene.followers}): lines as wide as attention")
    return figure


def reproduce(
    folder: Path, seed: int = 2022, progress: Callable[[int, int], None] = lambda done, total: None
) -> list[Path]:
    """Make the three pictures.

    Args:
        folder: gets ``heads-f1.png``, ``hierarchy-f1.png`` and ``sizes-f7.png``.
        seed: where the search for scenes begins.
        progress: called with the fits done and to do.

    Returns:
        The files.
    """
    scenes = [scene_of("f1", 15, 6, seed), *(scene_of("f7", size, 1, seed) for size in SIZES)]
    answers: list[dict[str, Detection]] = []
    for number, scene in enumerate(scenes):
        progress(number, len(scenes))
        answers.append({name: detect(scene, name) for name in SHOWN})
    progress(len(scenes), len(scenes))
    figures = {
        "heads-f1.png": heads_figure(scenes[0], answers[0]),
        "hierarchy-f1.png": hierarchy_figure(scenes[0], answers[0]),
        "sizes-f7.png": sizes_figure(scenes[1:], answers[1:]),
    }
    for name, figure in figures.items():
        with atomic_write(folder / name) as aside:
            figure.savefig(aside, format="png", dpi=100)
    return [folder / name for name in figures]
