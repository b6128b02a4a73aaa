"""The paper's figures of attention: heat maps of α and of α_l of each attention head, and the hierarchy graph."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from usnet_env.arrays import Floats, Indices, Mask
from usnet_env.config import ArgumentError
from usnet_env.detection import Detection
from usnet_env.drawing import HIT, MISSED, REDUNDANT, caption_figure
from usnet_env.envs import SingleClusterEnv
from usnet_env.evaluation.report import make_panels
from usnet_env.plugins import make_detector
from usnet_env.window import Window

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_SEEDS_TRIED = 10_000
_LEAST_WEIGHT = 0.02  # lines of a smaller attention weight are not drawn
_ATTENTION, _UAV = "#0072b2", "#555555"


@dataclass(frozen=True)
class Scene:
    """One window of one cluster, whose head has the index of the paper's figure."""

    follow: str
    followers: int
    head: int  # its index, from 0 (the paper's i_L - 1)
    seed: int  # of the environment
    window: Window


@cache
def find_scene(follow: str, followers: int, head: int, seed: int) -> Scene:
    """Find the first episode, from ``seed`` on, whose head has the wanted index.

    Raises:
        ArgumentError: no UAV has that index.
    """
    if not 0 <= head <= followers:
        raise ArgumentError(f"head must be an index from 0 to {followers}, got {head}.")
    env = SingleClusterEnv(follow=follow, followers=followers)
    for tried in range(seed, seed + _SEEDS_TRIED):
        observation, _ = env.reset(seed=tried)
        if env.swarm.head[head]:
            return Scene(follow, followers, head, tried, Window.from_observation(observation))
    raise ArgumentError(f"seed must lead to a head at index {head} within {_SEEDS_TRIED} episodes, got {seed}.")


@cache
def detect_head(scene: Scene, detector: str) -> Detection:
    """Let a detector answer the scene's window, with the scene's seed.

    Raises:
        ArgumentError: the answer holds no attention.
    """
    made = make_detector(detector)
    made.reset(scene.seed)
    found = made.detect(scene.window)
    if found.attention is None:
        raise ArgumentError(f"detector must answer with attention, got {detector!r}, which does not.")
    return found


def _new_grid(panels: int) -> tuple[Figure, list[Axes]]:
    """Make a figure with three panels a row; those that are not needed are hidden."""
    rows = -(-panels // 3)
    figure, grid = make_panels(4.3 * 3, 3.9 * rows + 0.6, rows, 3)
    for axes in grid.ravel()[panels:]:
        axes.set_visible(False)
    return figure, list(grid.ravel()[:panels])


def _draw_heat_map(axes: Axes, alpha: Floats, head: int, title: str) -> None:
    """Draw one matrix of attention with its own colour bar; a triangle marks the column of the head."""
    image = axes.imshow(alpha, cmap="viridis", vmin=0.0, vmax=max(float(alpha.max()), 1e-9), aspect="equal")
    axes.grid(visible=False)
    axes.plot([head], [1.03], marker="v", color="#d55e00", ms=8, clip_on=False, transform=axes.get_xaxis_transform())
    axes.set_title(title, fontsize=10, pad=14)
    ticks = range(0, len(alpha), max(1, -(-len(alpha) // 10)))
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_ticks(list(ticks), [str(place + 1) for place in ticks], fontsize=7)
    axes.set_xlabel("UAV i′", fontsize=8)
    axes.set_ylabel("UAV i", fontsize=8)
    figure: Any = axes.get_figure()
    bar = figure.colorbar(image, ax=axes, shrink=0.85)
    bar.ax.tick_params(labelsize=7)


def _describe_answer(scene: Scene, found: Detection) -> str:
    """Describe the candidates of P1 in a few words."""
    named = ", ".join(str(i + 1) for i in np.flatnonzero(found.candidates)) or "none"
    return f"Head: UAV {scene.head + 1}; candidate: {named}"


def draw_attention_heads(scene: Scene, found: Detection, label: str) -> Figure:
    """Draw the attention weights α and the attention values α_l of every attention head, as heat maps.

    Args:
        scene: what the detector saw.
        found: its answer, with ``attention`` ``(N, N)`` and ``extras["attention_heads"]`` ``(T_0 + 1, N, N)``.
        label: the detector's name.

    Raises:
        ArgumentError: the answer lacks one of them.
    """
    if found.attention is None or "attention_heads" not in found.extras:
        raise ArgumentError(f"detector must answer with attention and attention heads, got {label!r}.")
    values = np.asarray(found.extras["attention_heads"])
    panels = [("attention weights α", found.attention)]
    for number, alpha in enumerate(values[:-1]):
        panels.append((f"attention head {number + 1}: velocity at t{f' − {number}' if number else ''}", alpha))
    panels.append((f"attention head {len(values)}: position at t − {len(values) - 2}", values[-1]))
    figure, grid = _new_grid(len(panels))
    for axes, (title, alpha) in zip(grid, panels, strict=True):
        _draw_heat_map(axes, alpha, scene.head, title)
    caption_figure(
        figure,
        f"Attention of UAV i (row) to UAV i′ (column): {label}, {scene.follow}, m = {scene.followers}",
        f"One window (n = 1). {_describe_answer(scene, found)}. ▼ marks the column of the head. Each panel has a "
        "colour scale of its own.",
    )
    return figure


def draw_attention_sizes(scenes: Sequence[Scene], answers: Sequence[Detection], label: str) -> Figure:
    """Draw the attention weights α for clusters of several sizes, as heat maps; each scene is one size."""
    figure, grid = _new_grid(len(scenes))
    for axes, scene, found in zip(grid, scenes, answers, strict=True):
        verdict = "found" if found.candidates[scene.head] else "missed"
        if found.attention is not None:
            _draw_heat_map(axes, found.attention, scene.head, f"m = {scene.followers}: head {verdict}")
    caption_figure(
        figure,
        f"Attention weights α of UAV i (row) to UAV i′ (column): {label}, {scenes[0].follow}",
        f"One window for each m (n = 1). ▼ marks the column of the head, UAV {scenes[0].head + 1}. Each panel has a "
        "colour scale of its own.",
    )
    return figure


def list_leaders(attention: Floats) -> Indices:
    """List, for each UAV ``(N,)``, the other UAV with the largest weight ``(N, N)``; -1 where all weights are 0."""
    others = np.where(np.eye(len(attention), dtype=bool), 0.0, attention)
    return np.where(others.max(axis=1) > 0, others.argmax(axis=1), -1).astype(np.int64)


def draw_hierarchy(scene: Scene, found: Detection, label: str) -> Figure:
    """Draw the attention graph, and the hierarchy graph derived from it.

    On the left the UAVs are seen from above; lines are as wide as the attention weights. On the right the candidates
    are the upper level; every other UAV is linked to the UAV with its largest attention weight.
    """
    assert found.attention is not None
    figure, ((graph, tree),) = make_panels(14.0, 6.8, 1, 2)
    place = np.asarray(scene.window.position[-1, :, :2], np.float64)
    draw_links(graph, place, found.attention, _LEAST_WEIGHT, 5.0, colors=_ATTENTION, alpha=0.55)
    graph.set(xlabel="x in m", ylabel="y in m", title="Attention graph: lines as wide as the attention weight")
    graph.set_aspect("equal", adjustable="datalim")
    leaders = list_leaders(found.attention)
    levels, wrong = _place_levels(found.candidates), 0
    for i in np.flatnonzero(~found.candidates & (leaders >= 0)):
        ends = levels[[i, leaders[i]]]
        if found.candidates[leaders[i]]:
            tree.plot(*ends.T, color=_ATTENTION, lw=1.5, zorder=1)
        else:
            wrong += 1
            arrow = {"arrowstyle": "-", "connectionstyle": "arc3,rad=0.5", "ls": "--", "color": REDUNDANT, "lw": 1.3}
            tree.annotate("", ends[1], ends[0], arrowprops=arrow)
    tree.set_title("Hierarchy graph: candidate (top), and the largest attention of each other UAV")
    tree.set(xticks=[], yticks=[], ylim=(-0.6, 1.2))
    tree.spines[:].set_visible(False)
    for axes, points in ((graph, place), (tree, levels)):
        _mark_uavs(axes, points, scene.head, found.candidates)
    handles, labels = graph.get_legend_handles_labels()
    lines = [("link to the candidate", "-", _ATTENTION)] + [("link to another UAV", "--", REDUNDANT)] * bool(wrong)
    handles += [tree.plot([], [], color=color, ls=style)[0] for _, style, color in lines]
    figure.legend(
        handles, labels + [text for text, _, _ in lines], loc="outside lower center", ncols=6, fontsize=9, frameon=False
    )
    title = f"Attention and hierarchy: {label}, {scene.follow}, m = {scene.followers}"
    caption_figure(figure, title, f"One window (n = 1). {_describe_answer(scene, found)}.")
    return figure


def draw_links(axes: Axes, place: NDArray[Any], attention: Floats, least: float, width: float, **look: Any) -> None:
    """Draw a line for every attention weight ``(N, N)`` above the ``least`` between the UAVs at places ``(N, 2)``.

    A line of weight 1 is ``width`` points wide; ``look`` has further arguments of ``LineCollection``.
    """
    from matplotlib.collections import LineCollection

    rows, columns = np.nonzero((attention > least) & ~np.eye(len(attention), dtype=bool))
    ends = np.stack([place[rows], place[columns]], axis=1)
    axes.add_collection(LineCollection(list(ends), linewidths=width * attention[rows, columns], zorder=1, **look))


def _place_levels(candidates: Mask) -> Floats:
    """Place the UAVs on two levels, ``(N, 2)``: candidates at height 1, the others on a shallow arc around 0."""
    levels = np.zeros((len(candidates), 2))
    for level, members in ((1.0, np.flatnonzero(candidates)), (0.0, np.flatnonzero(~candidates))):
        across = (np.arange(len(members)) + 0.5) / max(len(members), 1) - 0.5
        levels[members, 0] = across
        levels[members, 1] = level - (0.0 if level else 0.5) * (0.25 - across**2)
    return levels


def _mark_uavs(axes: Axes, place: Floats, head: int, candidates: Mask) -> None:
    """Mark the UAVs, the head and the candidates, and write their numbers beside them."""
    axes.scatter(place[:, 0], place[:, 1], s=40, color=_UAV, zorder=2, label="UAV")
    star: dict[str, Any] = {"marker": "*", "color": "#e69f00", "edgecolor": "black", "label": "head (the truth)"}
    axes.scatter(place[head, 0], place[head, 1], s=230, zorder=3, **star)
    hit = np.arange(len(place)) == head
    for chosen, color, shape, text in (
        (candidates & hit, HIT, "o", "candidate: hit"),
        (candidates & ~hit, REDUNDANT, "s", "candidate: redundant"),
        (~candidates & hit, MISSED, "o", "missed head"),
    ):
        if chosen.any():
            style = "--" if color == MISSED else "-"
            ring: dict[str, Any] = {"facecolor": "none", "edgecolor": color, "lw": 2.2, "ls": style}
            axes.scatter(place[chosen, 0], place[chosen, 1], s=420, marker=shape, zorder=4, label=text, **ring)
    for i, (x, y) in enumerate(place):
        beside = (15, -15) if candidates[i] or i == head else (9, -11)
        axes.annotate(str(i + 1), (x, y), textcoords="offset points", xytext=beside, fontsize=8, zorder=5)
