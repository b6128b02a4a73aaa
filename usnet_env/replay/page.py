"""A page of episodes that any browser opens without a network: animation, table of rounds, reasons."""

from __future__ import annotations

import html
import os
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

import pandas as pd

from usnet_env.config import format_count
from usnet_env.files import atomic_write
from usnet_env.objectives import f1
from usnet_env.replay.animate import Painter, list_scenes
from usnet_env.replay.episode import EpisodeRecord
from usnet_env.replay.story import describe_outcome, describe_round, list_marked, name_game, name_round, name_uav

_FRAMES, _RATE, _DPI = 4, 1, 75  # frames of a growing window, frames per second, pixels per inch
_MOST_ROUNDS, _LEAST_ROUNDS = 12, 2  # with pictures: of all episodes together, and of each; the tables have all of them
_STYLE = """
body { font: 16px/1.5 system-ui, sans-serif; max-width: 62rem; margin: 0 auto; padding: 1rem; }
h2 { margin-top: 2.5rem; border-top: 1px solid #d5d9de; padding-top: 1.2rem; }
img { max-width: 100%; } .scroll { overflow-x: auto; } summary { cursor: pointer; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; }
th, td { text-align: left; padding: 0.3rem 0.9rem 0.3rem 0; border: 0; border-bottom: 1px solid #d5d9de; }
"""
#: Characters in place of the icons of matplotlib's page, whose font would be fetched from the network.
_ICONS = {
    "minus": "−", "plus": "+", "fast-backward": "|◀", "fast-forward": "▶|", "step-backward": "◁", "step-forward": "▷",
    "play fa-flip-horizontal": "◀", "play": "▶", "pause": "||",
}  # fmt: skip


def _animate(record: EpisodeRecord, most: int) -> str:
    """The animation of the first ``most`` rounds with its controls, as matplotlib writes it."""
    from matplotlib.animation import HTMLWriter

    painter = Painter(record, _DPI)
    shown = [scene for scene in list_scenes(record, _FRAMES) if scene.round <= most]
    writer = HTMLWriter(fps=_RATE, embed_frames=True, default_mode="once", embed_limit=200)
    with TemporaryDirectory() as folder:
        path = Path(folder, "animation.html")
        with writer.saving(painter.figure, path, _DPI):
            for scene in shown:
                painter.draw(scene)
                writer.grab_frame()  # type: ignore[no-untyped-call]
        text = re.sub("<link[^>]*>", "", path.read_text(encoding="utf-8"))
    text = text.replace("<img id", '<img alt="animation of the episode" id')
    return re.sub(r'<i class="fa fa-([^"]*)"></i>', lambda icon: _ICONS[icon[1]], text)


def _write_rounds(record: EpisodeRecord) -> str:
    """The table of rounds; where the truth is unknown, there is none."""
    if not record.labelled:
        return ""
    last = ("heads not named", "F1") if record.recorded else ("heads left", "J so far")
    table = pd.DataFrame({
        name_round(record).lower(): range(1, record.rounds + 1),
        "candidates": record.candidates.sum(axis=1),
        "heads hit": record.hits,
        "redundant": record.redundant,
        last[0]: record.heads_left,
        last[1]: f1(record.head, record.candidates) if record.recorded else record.objective,
        "seconds": record.seconds.round(2),
    })  # fmt: skip
    return f"<div class='scroll'>{table.to_html(index=False, border=0, float_format='{:.3g}'.format)}</div>"


def _write_episode(name: str, link: str | None, record: EpisodeRecord, most: int) -> str:
    escape = html.escape
    more = f" The animation shows the first {format_count(most, name_round(record).lower())}."
    file = "" if link is None else f" Episode file: <a href='{escape(link)}'>{escape(link)}</a>."
    rounds = []
    for number in range(1, record.rounds + 1):
        marked = [(name_uav(record, i), word, why) for i, word, why in list_marked(record, number)]
        lines = "".join(f"<li><b>{escape(uav)}</b> {word}, {escape(why)}</li>" for uav, word, why in marked)
        title = escape(f"{name_round(record)} {number}: {describe_round(record, number)}")
        rounds.append(f"<details{' open' * (number == 1)}><summary>{title}</summary><ul>{lines}</ul></details>")
    return f"""<section><h2>{escape(name)}</h2>
<p>{escape(name_game(record))}. {escape(describe_outcome(record))}{more * (record.rounds > most)}{file}</p>
{_animate(record, most)}{_write_rounds(record)}{"".join(rounds)}</section>"""


def write_page(
    title: str,
    records: Mapping[str, EpisodeRecord],
    path: str | os.PathLike[str],
    *,
    links: Mapping[str, str] | None = None,
    tables: Sequence[str] = (),
) -> Path:
    """Write a page of episodes; the file appears whole.

    Args:
        title: of the page.
        records: the episodes by their headings.
        path: the file to write; an existing file is replaced.
        links: for a heading the link to its episode file, relative to the page.
        tables: HTML that comes before the episodes.

    Raises:
        ArgumentError: the place can't be written to.
        MissingExtraError: matplotlib is not installed.
    """
    most = max(_MOST_ROUNDS // max(len(records), 1), _LEAST_ROUNDS)
    sections = [_write_episode(name, (links or {}).get(name), record, most) for name, record in records.items()]
    page = f"""<!doctype html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">
<title>{html.escape(title)}</title><style>{_STYLE}</style></head><body>
<h1>{html.escape(title)}</h1>
{"".join(f'<div class="scroll">{table}</div>' for table in tables)}{"".join(sections)}
</body></html>
"""
    with atomic_write(path) as aside:
        aside.write_text(page, encoding="utf-8")
    return Path(path)
