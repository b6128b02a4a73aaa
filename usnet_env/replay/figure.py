"""One picture of an episode that explains itself."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from usnet_env import drawing
from usnet_env.config import ArgumentError, instance_of, quote
from usnet_env.files import as_path
from usnet_env.replay.episode import EpisodeRecord
from usnet_env.replay.story import describe_outcome, describe_round, name_game, name_round

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_MAX_PANELS, _MAX_COLUMNS = 6, 3
_CAPTION = "Seen from above. The detector sees the paths, but not the stars, colours and links."
_UNLABELLED_CAPTION = "Recorded tracks, seen from above, and what was found in each window."


def describe_scene(record: EpisodeRecord, number: int) -> dict[str, Any]:
    """The window and the truth of a round (from 1), or what was found, as arguments of ``draw_round``."""
    r = number - 1
    return {
        "position": record.position[r],
        "seen": record.seen[r],
        "alive": record.alive[r],
        "head": record.head if record.labelled else record.candidates[r],
        "root": record.root[r],
        "number": np.cumsum(record.head) - 1,  # a head keeps its colour in all rounds
        "decoy": record.decoys[r] if record.labelled else record.decoy,
        "destroyed_at": record.last_position(number),
        "intruders": None if record.intruders is None else record.intruders[r],
    }


def find_least_side(record: EpisodeRecord) -> float:
    """The least side of a map in metres; recorded animals may be small."""
    return 1e-6 if record.recorded else 1.0


def check_ending(path: str | os.PathLike[str], *endings: str) -> Path:
    """The argument ``path``, which must have one of these endings."""
    file = as_path("path", path)
    if file.suffix.lower() not in endings:
        raise ArgumentError(f"path must end in {' or '.join(endings)}, got {quote(str(file))}.")
    return file


def draw_episode(record: EpisodeRecord) -> Figure:
    """Draw an episode: maps with the same scale of all rounds, or of more than six the first five and the last.

    Raises:
        MissingExtraError: matplotlib is not installed.
    """
    instance_of("record", record, EpisodeRecord)
    numbers = [*range(1, min(record.rounds, _MAX_PANELS)), record.rounds]
    columns = min(len(numbers), _MAX_COLUMNS)
    rows = -(-len(numbers) // columns)
    figure = drawing.new_figure(max(5.4 * columns + 2.8, 9.0), 5.8 * rows + 1.2)
    figure.set_layout_engine("constrained")
    caption = f"{describe_outcome(record)} {_CAPTION if record.labelled else _UNLABELLED_CAPTION}"
    if len(numbers) < record.rounds:
        caption += f" The picture shows {len(numbers)} of {record.rounds} {name_round(record).lower()}s."
    drawing.caption_figure(figure, drawing.escape_math(name_game(record)), drawing.escape_math(caption))
    grid = figure.subplots(rows, columns, squeeze=False).ravel()
    scenes = [describe_scene(record, number) for number in numbers]
    positions = [scene["position"][scene["seen"] & scene["alive"]] for scene in scenes]
    squares = [drawing.limits_around(position, least=find_least_side(record)) for position in positions]
    marks: dict[str, Any] = {}
    for axes, number, scene, (x, y, _) in zip(grid, numbers, scenes, squares, strict=False):
        title = drawing.escape_math(f"{name_round(record)} {number}: {describe_round(record, number)}")
        scene["candidates"] = record.candidates[number - 1] if record.labelled else None
        limits = x, y, max(half for *_, half in squares)
        drawing.draw_round(**scene, axes=axes, title=title, legend=False, limits=limits)
        position = drawing.last_seen_position(scene.pop("position"), scene.pop("seen"))
        marks |= {drawing.INTRUDER_MARK: drawing.INTRUDER_MARK} if scene.pop("intruders") is not None else {}
        del scene["number"]
        marks |= {mark: mark for mark, uavs in drawing.round_marks(position, **scene).items() if uavs.any()}
    for axes in grid[len(numbers) :]:
        axes.remove()
    words = {} if record.labelled else drawing.TRACK_WORDS
    drawing.draw_legend(grid[columns - 1], {mark: words.get(mark, mark) for mark in marks})
    return figure


def write_picture(record: EpisodeRecord, path: str | os.PathLike[str]) -> Path:
    """Write the picture of :func:`draw_episode`; the file appears whole.

    Args:
        record: the episode.
        path: where to; the suffix ``.png`` or ``.pdf`` chooses the format. An existing file is replaced.

    Raises:
        ArgumentError: the name has another ending, or the place can't be written to.
        MissingExtraError: matplotlib is not installed.
    """
    return drawing.write_figure(draw_episode(record), check_ending(path, ".png", ".pdf"))
