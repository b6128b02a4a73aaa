"""One picture of an episode that explains itself."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from usnet_env.config import ArgumentError, format_count, quote
from usnet_env.drawing import (
    TRACK_WORDS,
    caption_figure,
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
from usnet_env.replay.episode import EpisodeRecord
from usnet_env.replay.story import describe_outcome, describe_round, name_game, name_round

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_MOST_PANELS, _MOST_COLUMNS = 6, 3
_ABOUT = (
    "Seen from above. Every follower (dot) follows a head (star of its colour). The detector receives the paths of all "
    "UAVs, but not the stars, colours and links, and names candidates for the heads."
)
_ABOUT_UNKNOWN = (
    "Recorded tracks, seen from above. Stars are the leaders that were found in the window, and dots are the others, "
    "in the colour of the leader that they follow. The truth is unknown."
)


def describe_scene(record: EpisodeRecord, number: int) -> dict[str, Any]:
    """The window and the truth of a round (from 1), or what was found, as arguments of ``draw_round``."""
    r = number - 1
    return {
        "position": record.position[r],
        "seen": record.seen[r],
        "alive": record.alive[r],
        "head": record.head if record.labelled else record.candidates[r],
        "root": record.root[r],
        "decoy": record.decoys[r] if record.labelled else record.decoy,
        "destroyed_at": record.last_position(number),
    }


def find_least_side(record: EpisodeRecord) -> float:
    """The least side of a map in metres; recorded animals may be small."""
    return 1e-6 if record.recorded else 1.0


def check_ending(path: str | os.PathLike[str], *endings: str) -> Path:
    """The argument ``path``, which must have one of these endings."""
    place = as_path("path", path)
    if place.suffix.lower() not in endings:
        raise ArgumentError(f"path must end in {' or '.join(endings)}, got {quote(str(place))}.")
    return place


def _choose_rounds(record: EpisodeRecord) -> list[int]:
    """Choose the rounds to show: all of them, or six: the first, the last, and first of all those with hits."""
    numbers = np.arange(1, record.rounds + 1)
    outer = (numbers == 1) | (numbers == record.rounds)
    order = np.lexsort((numbers, record.hits == 0, ~outer))
    return sorted(numbers[order[:_MOST_PANELS]].tolist())


def draw_episode(record: EpisodeRecord) -> Figure:
    """Draw an episode: a map for each round, and an explanation.

    Returns:
        A matplotlib figure. If there are more than six rounds, it shows six of them: the first, the last, and first of
        all those with hits. All maps have the same scale.

    Raises:
        MissingExtraError: matplotlib is not installed.
    """
    numbers = _choose_rounds(record)
    columns = min(len(numbers), _MOST_COLUMNS)
    rows = -(-len(numbers) // columns)
    figure = new_figure(max(5.4 * columns + 2.8, 9.0), 5.8 * rows + 1.2)
    figure.set_layout_engine("constrained")
    hidden = f" The picture shows {len(numbers)} of {format_count(record.rounds, name_round(record).lower())}."
    about = escape_math(f"{describe_outcome(record)} {_ABOUT if record.labelled else _ABOUT_UNKNOWN}")
    caption_figure(figure, escape_math(name_game(record)), about + hidden * (len(numbers) < record.rounds))
    grid = figure.subplots(rows, columns, squeeze=False).ravel()
    scenes = [describe_scene(record, number) for number in numbers]
    least = find_least_side(record)
    limits = [limits_around(scene["position"][scene["seen"] & scene["alive"]], least=least) for scene in scenes]
    marks: dict[str, Any] = {}
    for axes, number, scene, (x, y, _) in zip(grid, numbers, scenes, limits, strict=False):
        title = escape_math(f"{name_round(record)} {number}: {describe_round(record, number)}")
        scene["candidates"] = record.candidates[number - 1] if record.labelled else None
        draw_round(**scene, axes=axes, title=title, legend=False, limits=(x, y, max(half for *_, half in limits)))
        place = last_seen_position(scene.pop("position"), scene.pop("seen"))
        marks |= {mark: mark for mark, who in round_marks(place, **scene).items() if who.any()}
    for axes in grid[len(numbers) :]:
        axes.remove()
    words = {} if record.labelled else TRACK_WORDS
    draw_legend(grid[columns - 1], {mark: words.get(mark, mark) for mark in marks})
    return figure


def write_picture(record: EpisodeRecord, path: str | os.PathLike[str]) -> Path:
    """Write the picture of :func:`draw_episode`, ``.png`` or ``.pdf``; the file appears whole.

    Raises:
        ArgumentError: the name has another ending, or the place can't be written to.
        MissingExtraError: matplotlib is not installed.
    """
    place = check_ending(path, ".png", ".pdf")
    return write_figure(draw_episode(record), place, [place.suffix.lower()[1:]])[0]
