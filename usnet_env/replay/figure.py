"""One picture of an episode that explains itself."""

from __future__ import annotations

import os
from pathlib import Path
from textwrap import fill
from typing import TYPE_CHECKING, Any

import numpy as np

from usnet_env.drawing import HIT, REDUNDANT, draw_legend, draw_round, last_seen_position, new_figure, round_marks
from usnet_env.files import as_path, atomic_write
from usnet_env.replay.episode import EpisodeRecord, check_record
from usnet_env.replay.story import describe_outcome, describe_round, format_count, rank_scores

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["draw_episode", "write_picture"]

_MOST_PANELS = 3
_MAP, _LEGEND, _SCORES, _MARGIN, _LINE = 5.4, 2.6, 2.3, 0.6, 0.17  # inches
_HEAD_BAR, _OTHER_BAR = "#0072B2", "#C4C4C4"


def _choose_rounds(rounds: int) -> list[int]:
    """Choose the rounds to show: all of them, or the first ones and the last."""
    return list(range(1, rounds + 1)) if rounds <= _MOST_PANELS else [*range(1, _MOST_PANELS), rounds]


def _draw_scores(axes: Axes, record: EpisodeRecord) -> None:
    """Draw the highest scores of round 1 as bars, heads in blue; candidates have the same marks as on the map."""
    scores, alive, head = record.scores[0], record.alive[0], record.head
    bars = rank_scores(record, 1)
    rank = np.arange(1, len(bars) + 1)
    height = scores[bars]
    for who, color, label in ((head[bars], _HEAD_BAR, "a head"), (~head[bars], _OTHER_BAR, "not a head")):
        axes.bar(rank[who], height[who], width=0.8, color=color, label=label if who.any() else None)
    lift = 0.08 * max(float(np.ptp(np.append(height, 0))), 1e-12)
    for chosen, color, shape, label in (
        (record.candidates[0] & head, HIT, "o", "candidate: hit"),
        (record.candidates[0] & ~head, REDUNDANT, "s", "candidate: redundant"),
    ):
        who = chosen[bars]
        ring: dict[str, Any] = {"facecolors": "none", "edgecolors": color, "linewidths": 1.8}
        axes.scatter(
            rank[who], np.maximum(height[who], 0) + lift, s=42, marker=shape, label=label if who.any() else None, **ring
        )
    axes.axhline(0, color="#888888", linewidth=0.6)
    axes.margins(x=0.01, y=0.12)
    axes.set_xlabel("UAVs by score, highest first", fontsize=9)
    axes.set_ylabel("score", fontsize=9)
    axes.tick_params(labelsize=8, colors="#555555")
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    shown = f"the {len(bars)} highest of {alive.sum()}" if len(bars) < int(alive.sum()) else "all living UAVs"
    hidden = int((head & alive).sum() - head[bars].sum())
    below = f"; {format_count(hidden, 'head')} ranked lower" if hidden else ""
    axes.set_title(f"Scores of the detector in round 1: {shown}{below}", fontsize=11, loc="left")
    axes.legend(loc="upper right", frameon=False, fontsize=9, ncols=2)


def draw_episode(record: EpisodeRecord) -> Figure:
    """Draw an episode: a map of each round, the scores of round 1, and an explanation.

    Args:
        record: the episode.

    Returns:
        A matplotlib figure. If there are more than three rounds, it shows the first two and the last.

    Raises:
        ArgumentError: ``record`` is not an episode.
        MissingExtraError: matplotlib is not installed.
    """
    panels = _choose_rounds(check_record(record).rounds)
    width = max(len(panels) * (_MAP + _MARGIN) + _LEGEND, 9.0)
    sizes = f"{record.uavs} UAVs in {format_count(int(record.head.sum()), 'cluster')}"
    follow = f", follow strategy {record.config['follow']}" if "follow" in record.config else ""
    about = (
        f"{sizes}{follow}, seen from above. Every follower (dot) follows a head (star of its colour). The detector "
        "receives the flight paths of all UAVs, but not the stars, colours and links. In each round it names "
        "candidates. The candidates are destroyed, and followers without a head join the nearest head that is left."
    )
    played = f"{record.detector or 'a detector'} on {record.env_id or 'an episode'}, seed {record.seed}: "
    about, ending = fill(about, int(width * 12)), fill(played + describe_outcome(record), int(width * 10))
    header = 1.6 + _LINE * (about.count("\n") + ending.count("\n"))
    total = header + _MAP + _SCORES + 2 * _MARGIN + 0.3
    figure = new_figure(width, total)
    figure.text(0.5 / width, 1 - 0.25 / total, "Who leads this swarm?", fontsize=17, weight="bold", va="top")
    figure.text(0.5 / width, 1 - 0.65 / total, about, fontsize=10, va="top", color="#333333")
    below = (0.95 + _LINE * about.count("\n")) / total
    figure.text(0.5 / width, 1 - below, ending, fontsize=10.5, weight="bold", va="top")
    marks: set[str] = set()
    for place, number in enumerate(panels):
        r = number - 1
        left, bottom = 0.75 + place * (_MAP + _MARGIN), _SCORES + 2 * _MARGIN + 0.3
        axes = figure.add_axes((left / width, bottom / total, _MAP / width, _MAP / total))
        skipped = place > 0 and number > panels[place - 1] + 1
        note = f"(rounds {panels[place - 1] + 1} to {number - 1} are not shown)\n" if skipped else ""
        title = f"{note}Round {number}: {describe_round(record, number)}"
        truth = (record.alive[r], record.head, record.leader[r], record.decoy)
        gone = record.last_position(number)
        draw_round(
            record.position[r], record.seen[r], *truth, record.candidates[r],
            destroyed_at=gone, axes=axes, title=title, legend=False,
        )  # fmt: skip
        present = round_marks(
            last_seen_position(record.position[r], record.seen[r]), *truth, record.candidates[r], gone
        )
        marks |= {mark for mark, who in present.items() if who.any()}
    draw_legend(axes, {mark: mark for mark in present if mark in marks})
    axes = figure.add_axes((0.75 / width, 0.55 / total, (width - 1.1) / width, _SCORES / total))
    _draw_scores(axes, record)
    return figure


def write_picture(record: EpisodeRecord, path: str | os.PathLike[str]) -> Path:
    """Write the picture of :func:`draw_episode` as a PNG; the file appears whole.

    Args:
        record: the episode.
        path: the file to write; an existing file is replaced.

    Returns:
        The path.

    Raises:
        ArgumentError: the place can't be written to.
        MissingExtraError: matplotlib is not installed.
    """
    place = as_path("path", path)
    figure = draw_episode(record)
    with atomic_write(place) as aside:
        figure.savefig(aside, format="png")
    return place
