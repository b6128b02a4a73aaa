"""The paper's figures of attention: heat maps of α and α_l, the hierarchy of one cluster, and α for six sizes.

    python benchmarks/paper/attention.py          # they are computed (a minute)

Nothing is measured: a picture shows one window, in which the head has the index of the paper's figure.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.collections import LineCollection
from shared import panels, parse, save_figure

from usnet_env import Window, make_detector
from usnet_env.detection import Detection
from usnet_env.envs import SingleClusterEnv

DETECTOR = "gassl"
SIZES = (2, 5, 10, 25, 40, 50)
ATTENTION, HIT, REDUNDANT, MISSED = "#0072b2", "#009e73", "#d55e00", "#cc79a7"
LEAST_WEIGHT = 0.02  # lines of a smaller attention weight are not drawn


class Scene(NamedTuple):
    """One window of one cluster, and the answer to it."""

    follow: str
    followers: int
    head: int  # index from 0; the paper's i_L - 1
    window: Window
    answer: Detection

    def describe(self) -> str:
        """The head and the candidates in a few words."""
        named = ", ".join(str(i + 1) for i in np.flatnonzero(self.answer.candidates)) or "none"
        return f"One window (n = 1). Head: UAV {self.head + 1}; candidate: {named}."


def find_scene(follow: str, followers: int, head: int, seed: int) -> Scene:
    """The first episode, from a seed on, whose head has an index; the detector gets the episode's seed."""
    env, detector = SingleClusterEnv(follow=follow, followers=followers), make_detector(DETECTOR)
    observation, _ = env.reset(seed=seed)
    while not env.swarm.head[head]:
        seed += 1
        observation, _ = env.reset(seed=seed)
    detector.reset(seed)
    window = Window.from_observation(observation)
    return Scene(follow, followers, head, window, detector.detect(window))


def draw_heat_maps(maps: dict[str, np.ndarray], heads: list[int], path: Path, title: str, caption: str) -> None:
    """Draw six matrices of attention ``(N, N)`` by title; a triangle marks the column of the head of each."""
    figure, grid = panels(12.9, 8.4, 2, 3)
    for axes, (words, alpha), head in zip(grid.ravel(), maps.items(), heads, strict=True):
        image = axes.imshow(alpha, cmap="viridis", vmin=0.0, vmax=max(float(alpha.max()), 1e-9), aspect="equal")
        axes.grid(visible=False)
        axes.plot(
            [head], [1.03], marker="v", color=REDUNDANT, ms=8, clip_on=False, transform=axes.get_xaxis_transform()
        )
        axes.set_title(words, fontsize=10, pad=14)
        ticks = range(0, len(alpha), max(1, -(-len(alpha) // 10)))
        for axis, label in ((axes.xaxis, "UAV i′"), (axes.yaxis, "UAV i")):
            axis.set_ticks(list(ticks), [str(place + 1) for place in ticks], fontsize=7)
            axis.set_label_text(label, fontsize=8)
        figure.colorbar(image, ax=axes, shrink=0.85).ax.tick_params(labelsize=7)
    caption += " ▼ marks the column of the head. Each panel has a colour scale of its own."
    save_figure(figure, path, f"{title}: {DETECTOR}", caption)


def draw_heads(scene: Scene, path: Path) -> None:
    """Draw the attention weights α and the attention values α_l of every attention head."""
    values = np.asarray(scene.answer.extras["attention_heads"])  # (T_0 + 1, N, N): velocities, then positions
    maps = {"attention weights α": np.asarray(scene.answer.attention)}
    for k, alpha in enumerate(values[:-1]):
        maps[f"attention head {k + 1}: velocity at t{f' − {k}' if k else ''}"] = alpha
    maps[f"attention head {len(values)}: position at t − {len(values) - 2}"] = values[-1]
    title = f"Attention of UAV i (row) to UAV i′ (column), {scene.follow}, m = {scene.followers}"
    draw_heat_maps(maps, [scene.head] * len(maps), path, title, scene.describe())


def draw_sizes(scenes: list[Scene], path: Path) -> None:
    """Draw the attention weights α of clusters of several sizes."""
    maps = {}
    for scene in scenes:
        verdict = "found" if scene.answer.candidates[scene.head] else "missed"
        maps[f"m = {scene.followers}: head {verdict}"] = np.asarray(scene.answer.attention)
    title = f"Attention weights α of UAV i (row) to UAV i′ (column), {scenes[0].follow}"
    draw_heat_maps(maps, [scene.head for scene in scenes], path, title, "One window for each m (n = 1).")


def list_leaders(attention: np.ndarray) -> np.ndarray:
    """For each UAV ``(N,)`` the other UAV with the largest weight ``(N, N)``; -1 where all weights are 0."""
    others = np.where(np.eye(len(attention), dtype=bool), 0.0, attention)
    return np.where(others.max(axis=1) > 0, others.argmax(axis=1), -1)


def draw_links(axes: Any, place: np.ndarray, attention: np.ndarray, least: float, width: float, color: str) -> None:
    """Draw a line for every attention weight above the ``least``; that of the largest is ``width`` points wide."""
    rows, columns = np.nonzero((attention > least) & ~np.eye(len(attention), dtype=bool))
    ends = np.stack([place[rows], place[columns]], axis=1)
    widths = width * attention[rows, columns] / attention[rows, columns].max(initial=1e-12)
    axes.add_collection(LineCollection(list(ends), linewidths=widths, colors=color, alpha=0.5, zorder=1))


def place_levels(candidates: np.ndarray) -> np.ndarray:
    """Places ``(N, 2)`` on two levels: candidates at height 1, the others on a shallow arc around 0."""
    levels = np.zeros((len(candidates), 2))
    for height, members in ((1.0, np.flatnonzero(candidates)), (0.0, np.flatnonzero(~candidates))):
        across = (np.arange(len(members)) + 0.5) / max(len(members), 1) - 0.5
        levels[members] = np.column_stack([across, height - (0.0 if height else 0.5) * (0.25 - across**2)])
    return levels


def draw_hierarchy(scene: Scene, path: Path) -> None:
    """Draw the attention graph, seen from above, and the hierarchy: each UAV below the one it attends to most."""
    attention, candidates = np.asarray(scene.answer.attention), scene.answer.candidates
    figure, ((graph, tree),) = panels(14.0, 6.8, 1, 2)
    place, levels = np.asarray(scene.window.position[-1, :, :2]), place_levels(candidates)
    draw_links(graph, place, attention, LEAST_WEIGHT, 5.0, ATTENTION)
    graph.set(xlabel="x in m", ylabel="y in m", title="Attention graph: lines as wide as the attention weight")
    graph.set_aspect("equal", adjustable="datalim")
    leaders = list_leaders(attention)
    for i in np.flatnonzero(~candidates & (leaders >= 0)):
        hit = candidates[leaders[i]]
        look = {"color": ATTENTION, "lw": 1.5} if hit else {"color": REDUNDANT, "lw": 1.3, "ls": "--"}
        tree.plot(*levels[[i, leaders[i]]].T, zorder=1, **look)
    tree.set(title="Hierarchy graph: candidate (top), and the largest attention of each other UAV")
    tree.set(xticks=[], yticks=[], ylim=(-0.6, 1.2))
    is_head = np.arange(len(place)) == scene.head
    for axes, points in ((graph, place), (tree, levels)):
        mark_uavs(axes, points, is_head, np.where(is_head, "#e69f00", "#555555"), 40)
        mark_candidates(axes, points, is_head, candidates, 400)
        for i, point in enumerate(points):
            beside = (15, -15) if candidates[i] or is_head[i] else (9, -11)
            axes.annotate(str(i + 1), point, textcoords="offset points", xytext=beside, fontsize=8, zorder=5)
    tree.plot([], [], color=ATTENTION, label="link to the candidate")
    tree.plot([], [], color=REDUNDANT, ls="--", label="link to another UAV")
    title = f"Attention and hierarchy: {DETECTOR}, {scene.follow}, m = {scene.followers}"
    save_figure(figure, path, title, scene.describe())


def mark_uavs(axes: Any, place: np.ndarray, head: np.ndarray, colors: np.ndarray, size: float) -> None:
    """Mark followers and, by stars, heads."""
    axes.scatter(*place[~head].T, s=size, c=colors[~head], lw=0.3, edgecolors="white", zorder=2, label="follower")
    star: Any = {"marker": "*", "edgecolors": "black", "lw": 0.8, "label": "head (the truth)"}
    axes.scatter(*place[head].T, s=7 * size, c=colors[head], zorder=3, **star)


def mark_candidates(axes: Any, place: np.ndarray, head: np.ndarray, candidates: np.ndarray, size: float) -> None:
    """Mark candidates and missed heads by rings."""
    rings = {
        "candidate: hit": (candidates & head, HIT, "o"),
        "candidate: redundant": (candidates & ~head, REDUNDANT, "s"),
        "missed head": (~candidates & head, MISSED, "o"),
    }
    for label, (chosen, color, marker) in rings.items():
        if chosen.any():
            ring: Any = {"facecolors": "none", "edgecolors": color, "lw": 2.2, "marker": marker, "label": label}
            axes.scatter(*place[chosen].T, s=size, zorder=4, **ring)


def main(argv: list[str] | None = None) -> None:
    given = parse(__doc__).parse_args(argv)
    scene = find_scene("f1", 15, 6, given.seed)
    draw_heads(scene, given.images / "attention-heads-f1-m15.png")
    draw_hierarchy(scene, given.images / "hierarchy-f1-m15.png")
    draw_sizes([find_scene("f7", size, 1, given.seed) for size in SIZES], given.images / "attention-sizes-f7.png")


if __name__ == "__main__":
    main()
