"""The paper's example with M = 8 and N = 185: the truth, the attention of every round, and the heads found."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

import usnet_env.envs  # noqa: F401  # registers the environments
from detectors.studies.attention import draw_links
from usnet_env.config import format_count
from usnet_env.drawing import (
    HIT,
    MISSED,
    REDUNDANT,
    caption_figure,
    cluster_colors,
    draw_round,
    last_seen_position,
)
from usnet_env.evaluation.episode import episode_seeds
from usnet_env.evaluation.report import make_panels
from usnet_env.plugins import make_detector
from usnet_env.replay import EpisodeRecord, record_episode

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_LEAST_WEIGHT = 0.1  # lines of a smaller attention weight are not drawn
_MOST_ROUNDS = 4
_ATTENTION, _GONE = "#56789a", "#9a9a9a"
_PAPER_RATES = {1: 75.0, 2: 100.0}  # percent of the heads that the paper's example has found after each round
_PAPER_SIZE = (8, 185)


def play_example(detector: str, seed: int, *, clusters: int = 8, uavs: int = 185) -> EpisodeRecord:
    """Play the episode that ``usnet reproduce rounds --seed`` plays as episode 0 of the study ``example``."""
    env = gym.make("USNET/MultiCluster-v0", clusters=clusters, uavs=uavs, follow="f1")
    swarm_seed, detector_seed = episode_seeds(seed, 0)
    record = record_episode(env, make_detector(detector), swarm_seed, detector_seed, label=detector)
    env.close()
    return record


def draw_example(record: EpisodeRecord) -> Figure:
    """Draw an episode: the true clusters, the attention and candidates of its rounds, and the share of heads found.

    Args:
        record: the episode; rounds without attention have no lines.
    """
    rounds = [*range(1, min(record.rounds, _MOST_ROUNDS)), record.rounds]  # the first ones and the last
    panels = len(rounds) + 2
    columns = 2 if panels <= 4 else 3
    lines = -(-panels // columns)
    figure, panels_by_line = make_panels(5.6 * columns, 5.3 * lines + 1.1, lines, columns)
    grid: list[Axes] = list(panels_by_line.ravel())
    truth = (record.alive[0], record.head, record.root[0], record.decoy)
    clusters = int(record.head.sum())
    title = f"Truth: {clusters} clusters, {record.uavs} UAVs"
    draw_round(record.position[0], record.seen[0], *truth, axes=grid[0], title=title, legend=False)
    previous = 0
    for axes, number in zip(grid[1:], rounds, strict=False):
        _draw_attention_round(axes, record, number, skipped=number - previous - 1)
        previous = number
    _draw_rates(grid[len(rounds) + 1], record)
    for axes in grid[panels:]:
        axes.set_visible(False)
    handles, labels = _list_marks()
    figure.legend(handles, labels, loc="outside lower center", ncols=4, fontsize=9, frameon=False)
    follow = f", {record.config['follow']}" if "follow" in record.config else ""
    caption = f"One game (n = 1), {clusters} clusters, {record.uavs} UAVs{follow}, seen from above. "
    caption += f"Lines of a round are as wide as the attention weights above {_LEAST_WEIGHT}."
    caption_figure(figure, f"Round by round: {record.detector}", caption)
    return figure


def _draw_attention_round(axes: Axes, record: EpisodeRecord, number: int, skipped: int) -> None:
    """Draw the UAVs of a round from above, lines as wide as the attention weights, and the candidates."""
    r = number - 1
    alive, head, candidates = record.alive[r], record.head, record.candidates[r]
    place = last_seen_position(record.position[r], record.seen[r] & alive)[:, :2]
    shown = np.isfinite(place[:, 0])
    if record.attention is not None:
        weight = record.attention[r] * (shown & shown[:, None])
        draw_links(axes, place, weight, _LEAST_WEIGHT, 3.0, colors=_ATTENTION, alpha=0.45)
    colors, _ = cluster_colors(head, record.root[r])
    followers, heads = shown & ~head, shown & head
    axes.scatter(
        place[followers, 0], place[followers, 1], s=16, c=colors[followers], lw=0.3, edgecolors="white", zorder=2
    )
    stars: dict[str, Any] = {"marker": "*", "c": colors[heads], "edgecolors": "black", "lw": 0.8}
    axes.scatter(place[heads, 0], place[heads, 1], s=150, zorder=3, **stars)
    gone = record.last_position(number)[~alive, :2]
    axes.scatter(gone[:, 0], gone[:, 1], s=40, marker="x", color=_GONE, lw=1.5, zorder=2)
    target = head & alive
    marks: tuple[tuple[NDArray[np.bool_], int, dict[str, Any]], ...] = (
        (candidates & target, 330, {"edgecolors": HIT, "marker": "o", "lw": 2.4}),
        (candidates & ~target, 130, {"edgecolors": REDUNDANT, "marker": "s", "lw": 2.2}),
        (~candidates & target, 330, {"edgecolors": MISSED, "marker": "o", "lw": 1.5, "ls": "--"}),
    )
    for chosen, size, style in marks:
        axes.scatter(place[chosen, 0], place[chosen, 1], s=size, facecolors="none", zorder=4, **style)
    hits, redundant = int(record.hits[r]), int(record.redundant[r])
    note = f"  ({skipped} rounds before it are not shown)" if skipped else ""
    axes.set_title(f"Round {number}: {hits} hit, {redundant} redundant{note}", fontsize=11, loc="left")
    axes.set_xlabel("x in m", fontsize=9)
    axes.set_ylabel("y in m", fontsize=9)
    axes.tick_params(labelsize=8)
    axes.set_aspect("equal", adjustable="datalim")


def _draw_rates(axes: Axes, record: EpisodeRecord) -> None:
    """Draw, after each round, the heads found in percent of M, and the destroyed UAVs in percent of N."""
    heads, uavs = int(record.head.sum()), record.uavs
    rounds = np.arange(record.rounds + 1)

    def accumulate(counts: NDArray[np.int64], whole: int) -> NDArray[np.float64]:
        return 100.0 * np.append(0, np.cumsum(counts)) / whole

    found, hit = accumulate(record.hits, heads), accumulate(record.hits, uavs)
    redundant = accumulate(record.redundant, uavs)
    axes.plot(rounds, found, "o-", color=HIT, label=f"heads found, % of {heads}")
    axes.plot(rounds, redundant, "s-", color=REDUNDANT, label=f"redundant candidates, % of {uavs}")
    if (heads, uavs) == _PAPER_SIZE:
        axes.plot(
            list(_PAPER_RATES), list(_PAPER_RATES.values()), "o", mfc="none", mec="black", ms=11, label="the paper"
        )
    axes.set_title(
        f"After {format_count(record.rounds, 'round')}: {found[-1]:.0f} % of the heads found;\n"
        f"destroyed: {hit[-1]:.2f} % of all UAVs as hits, {redundant[-1]:.2f} % redundant",
        fontsize=11,
        loc="left",
    )
    axes.set(xlabel="round", ylabel="percent", ylim=(-3, 106))
    last = max(record.rounds, *_PAPER_RATES)
    axes.set_xticks(range(0, last + 1, max(1, last // 10)))
    axes.legend(fontsize=9, loc="center right")


def _list_marks() -> tuple[list[Any], list[str]]:
    """List the marks of the rounds and their labels, for the legend."""
    from matplotlib.lines import Line2D

    def point(**style: Any) -> Line2D:
        return Line2D([], [], ls="none", **style)

    marks = {
        "head (colour: its cluster)": point(marker="*", color="#777777", mec="black", ms=13),
        "follower (colour: its head)": point(marker="o", color="#777777", ms=5),
        "attention of one UAV to another": Line2D([], [], color=_ATTENTION, lw=3, alpha=0.6),
        "candidate: hit": point(marker="o", mfc="none", mec=HIT, mew=2.4, ms=13),
        "candidate: redundant": point(marker="s", mfc="none", mec=REDUNDANT, mew=2.2, ms=10),
        "missed head": Line2D([], [], color=MISSED, ls="--", lw=1.5),
        "destroyed in an earlier round": point(marker="x", color=_GONE, mew=1.5, ms=7),
    }
    return list(marks.values()), list(marks)
