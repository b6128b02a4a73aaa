"""One picture of an episode that explains itself."""

from __future__ import annotations

import os
from pathlib import Path
from textwrap import fill
from typing import TYPE_CHECKING, Any

import numpy as np

from usnet_env.config import ArgumentError, format_count, quote
from usnet_env.drawing import (
    HIT,
    HIT_MARK,
    MISSED,
    REDUNDANT,
    TRACK_WORDS,
    dashed_ring,
    draw_legend,
    draw_round,
    escape_math,
    last_seen_position,
    limits_around,
    new_figure,
    round_marks,
    write_figure,
)
from usnet_env.files import as_path
from usnet_env.replay.episode import EpisodeRecord, check_record
from usnet_env.replay.story import (
    describe_outcome,
    describe_round,
    name_game,
    name_round,
    name_uav,
    rank_scores,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_MOST_PANELS, _MOST_COLUMNS = 6, 3
_MAP, _SCORES, _LEGEND, _GAP, _LINE = 5.4, 1.5, 2.6, 0.6, 0.17  # inches
_CELL = _MAP + _SCORES + 1.35  # inches: a map, its scores, and the words above and below them
_BARS_WITH_LEVEL_NUMBERS = 20
_OTHER_BAR = "#C4C4C4"


def _choose_rounds(record: EpisodeRecord) -> list[int]:
    """Choose the rounds to show: all of them, or six: the first, the last, and first of all those with hits."""
    numbers = np.arange(1, record.rounds + 1)
    outer = (numbers == 1) | (numbers == record.rounds)
    order = np.lexsort((numbers, record.hits == 0, ~outer))
    return sorted(numbers[order[:_MOST_PANELS]].tolist())


def _draw_scores(axes: Axes, record: EpisodeRecord, number: int) -> None:
    """Draw the scores of a round as bars, in the colours of the marks on the map, with the number of each UAV."""
    r = number - 1
    bars = rank_scores(record, number)
    rank, height = np.arange(len(bars)), record.scores[r][bars]
    named = record.candidates[r][bars]
    head = record.head[bars] if record.labelled else named
    lift = 0.12 * max(float(np.ptp(np.append(height, 0))), 1e-12)
    ring: dict[str, Any] = {"facecolors": "none", "linewidths": 1.6, "s": 42}
    for who, color, label, shape in (
        (named & head, HIT, "hit", "o"),
        (named & ~head, REDUNDANT, "redundant", "s"),
        (~named & head, MISSED, "head, not a candidate", dashed_ring()),
        (~named & ~head, _OTHER_BAR, "other", None),
    ):
        axes.bar(rank[who], height[who], width=0.8, color=color, label=label)
        if shape is not None:  # the marks show the UAVs whose score is 0, too
            axes.scatter(rank[who], np.maximum(height[who], 0) + lift, marker=shape, edgecolors=color, **ring)
    axes.axhline(0, color="#888888", linewidth=0.6)
    axes.margins(y=0.18)
    axes.set_xlim(-0.7, len(bars) - 0.3)
    if not height.any():
        axes.set_ylim(0, 1)
        axes.text(0.5, 0.6, "All scores are 0.", transform=axes.transAxes, ha="center", color="#555555")
    rotation = 0 if len(bars) <= _BARS_WITH_LEVEL_NUMBERS else 90
    names = [escape_math(name_uav(record, i)) if record.recorded else str(i) for i in bars]
    axes.set_xticks(rank, names, fontsize=7.5, rotation=rotation)
    axes.tick_params(axis="y", labelsize=8, colors="#555555")
    axes.yaxis.set_major_formatter("{x:.3g}")  # a common exponent above the axis would push the title away
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    living = int(record.alive[r].sum())
    noun, tick = ("ids", "id") if record.recorded else ("living UAVs", "UAV's number")
    shown = f"{len(bars)} of {living}" if len(bars) < living else "all"
    axes.set_title(f"Scores: {shown} {noun}, highest first, with the {tick}", fontsize=9.5, loc="left")


def draw_episode(record: EpisodeRecord) -> Figure:
    """Draw an episode: for each round a map and the scores, and an explanation.

    Args:
        record: the episode.

    Returns:
        A matplotlib figure. If there are more than six rounds, it shows six of them: the first, the last, and first of
        all those with hits. All maps have the same scale.

    Raises:
        ArgumentError: ``record`` is not an episode.
        MissingExtraError: matplotlib is not installed.
    """
    panels = _choose_rounds(check_record(record))
    columns = min(len(panels), _MOST_COLUMNS)
    rows = -(-len(panels) // columns)
    width = max(columns * (_MAP + _GAP) + _LEGEND, 9.0)
    sizes = f"{record.uavs} UAVs in {format_count(int(record.head.sum()), 'cluster')}"
    follow = f", follow strategy {record.config['follow']}" if "follow" in record.config else ""
    about = (
        f"{sizes}{follow}, seen from above. Every follower (dot) follows a head (star of its colour). The detector "
        "receives the flight paths of all UAVs, but not the stars, colours and links. In each round it names "
        "candidates. The candidates are destroyed, and followers without a head join the nearest head that is left."
    )
    if not record.labelled:
        about = (
            f"{record.uavs} recorded tracks, seen from above. Stars are the leaders that were found in the window, and "
            "dots are the others, in the colour of the leader that they follow. The truth is unknown."
        )
    elif record.recorded:
        about = (
            f"{record.uavs} recorded tracks, seen from above. As the file says, every follower (dot) follows a head "
            "(star of its colour). The detector receives the tracks, but not the stars, colours and links, and names "
            "candidates for the heads."
        )
    played, part = f"{name_game(record)}: ", name_round(record)
    left_out = (
        f" The picture shows {len(panels)} of {record.rounds} {part.lower()}s." if len(panels) < record.rounds else ""
    )
    about = fill(about, int(width * 12))
    ending = fill(played + describe_outcome(record) + left_out, int(width * 10))
    header = 1.3 + _LINE * (about.count("\n") + ending.count("\n"))
    total = header + rows * _CELL
    figure = new_figure(width, total)
    figure.text(0.5 / width, 1 - 0.25 / total, "Who leads this swarm?", fontsize=17, weight="bold", va="top")
    figure.text(0.5 / width, 1 - 0.65 / total, about, fontsize=10, va="top", color="#333333")
    below = (0.95 + _LINE * about.count("\n")) / total
    figure.text(0.5 / width, 1 - below, escape_math(ending), fontsize=10.5, weight="bold", va="top")

    places = [last_seen_position(record.position[n - 1], record.seen[n - 1]) for n in panels]
    shown = [
        record.position[n - 1][record.seen[n - 1]] if record.recorded else place
        for place, n in zip(places, panels, strict=True)
    ]
    least = 1e-6 if record.recorded else 1.0  # metres; recorded animals may be smaller
    limits = [limits_around(place, least=least) for place in shown]
    half = max(each[2] for each in limits)
    marks: set[str] = set()
    for place, number in enumerate(panels):
        r = number - 1
        left = 0.75 + place % columns * (_MAP + _GAP)
        top = header + place // columns * _CELL + 0.35
        axes = figure.add_axes((left / width, 1 - (top + _MAP) / total, _MAP / width, _MAP / total))
        head = record.head if record.labelled else record.candidates[r]
        candidates = record.candidates[r] if record.labelled else None
        truth = (record.alive[r], head, record.root[r], record.decoy)
        gone = record.last_position(number)
        title = escape_math(f"{part} {number}: {describe_round(record, number)}")
        draw_round(
            record.position[r], record.seen[r], *truth, candidates,
            destroyed_at=gone, axes=axes, title=title, legend=False,
            limits=(*limits[place][:2], half),
        )  # fmt: skip
        if place % columns:
            axes.set_ylabel("")
        if place == columns - 1:
            beside = axes
        present = round_marks(places[place], *truth, candidates, gone)
        marks |= {mark for mark, who in present.items() if who.any()}
        bottom = top + _MAP + 0.7 + _SCORES
        scores = figure.add_axes((left / width, 1 - bottom / total, _MAP / width, _SCORES / total))
        _draw_scores(scores, record, number)
    words = {} if record.labelled else TRACK_WORDS
    labels = {mark: words.get(mark, mark) for mark in present if mark in marks}
    if not record.labelled and record.candidates.any():
        labels[HIT_MARK] = "score of a leader"
    draw_legend(beside, labels)
    return figure


def write_picture(record: EpisodeRecord, path: str | os.PathLike[str]) -> Path:
    """Write the picture of :func:`draw_episode`; the file appears whole.

    Args:
        record: the episode.
        path: the file to write, ``.png`` or ``.pdf``; an existing file is replaced.

    Returns:
        The path.

    Raises:
        ArgumentError: the name has another ending, or the place can't be written to.
        MissingExtraError: matplotlib is not installed.
    """
    place = as_path("path", path)
    if place.suffix not in (".png", ".pdf"):
        raise ArgumentError(f"path must end in .png or .pdf, got {quote(str(place))}.")
    return write_figure(draw_episode(record), place, [place.suffix[1:]])[0]
