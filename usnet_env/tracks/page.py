"""A page of found leaders that any browser opens without a network: a map with a slider, lag curves, tables."""

from __future__ import annotations

import json
from base64 import b64encode
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from html import escape
from importlib.resources import files
from itertools import chain, zip_longest
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from usnet_env.arrays import Floats, Indices
from usnet_env.config import printable
from usnet_env.files import write_html
from usnet_env.tracks.found import DetectedWindow, Leader, Link, Name
from usnet_env.tracks.tracks import Tracks, TrackWindow

_MAX_IDS, _MAX_INSTANTS = 100, 600  # of the map
_MAX_CURVES = 12  # leaders whose lag curves the page has
_GRID = 9999  # coordinates are whole numbers up to this one
_PICTURES = {
    "network.png": "The network of links: an arrow points from a follower to its leader",
    "timeline.png": "Which id each id follows in each window",
    "delays.png": "The delay of each follower",
}
_HINT = """Click an id to see which one it follows. Dots have the colour of the leader that they follow; a large dot
leads. A dashed line means: in the group of, directly or not."""


def write_page(
    path: Path, title: str, sentences: Iterable[str], data: Mapping[str, Any] | None, table: str, facts: Iterable[str]
) -> None:
    """Write the page of found leaders; pictures of links beside it become parts of it, if a leader was found.

    ``sentences`` say what was found, and ``facts`` tell of the tracks and the settings. ``data`` is what
    :func:`collect_data` returns, or ``None``: without a map. ``table`` is HTML.
    """
    parts = [_list_sentences(sentences)]
    has_leader = data is not None and any(window["leaders"] for window in data["windows"])
    if data is not None:
        values = json.dumps(data, allow_nan=False, separators=(",", ":")).replace("<", r"\u003c")
        here = files("usnet_env.tracks")
        frame, script = (here.joinpath(f"page.{kind}").read_text(encoding="utf-8") for kind in ("html", "js"))
        parts += [frame.rstrip(), f"<p>{_HINT * has_leader}</p>", f"<script>const data = {values};{script}</script>"]
    parts.append(table if has_leader or data is None else "")
    for name, words in _PICTURES.items() if has_leader else ():
        if (image := path.with_name(name)).exists():
            encoded = b64encode(image.read_bytes()).decode()
            parts.append(f'<figure><img alt="{words}" src="data:image/png;base64,{encoded}"></figure>')
    write_html(path, f"Leaders in {title}", "".join([*parts, "<h2>The tracks</h2>", _list_sentences(facts)]))


def _list_sentences(sentences: Iterable[str]) -> str:
    items = "".join(f"<li>{escape(printable(sentence))}</li>" for sentence in sentences)
    return f"<ul>{items}</ul>"


def collect_data(
    tracks: Tracks,
    windows: Sequence[DetectedWindow],
    track_windows: Sequence[TrackWindow],
    leaders: Sequence[Leader],
    colors: Mapping[Name, str],
    chances: Sequence[Mapping[Name | None, float]],
    curves: Callable[[Name], tuple[pd.DataFrame | None, float]],
) -> dict[str, Any]:
    """What ``page.js`` draws, as plain values; ids are numbers of rows of ``ids``, the first of those that are shown.

    ``points`` has for each id x and y at each instant, whole numbers from 0, or -1 where it is not seen; ``size`` is
    that of the map, ``spread`` the largest extent of all ids at an instant, ``middles`` their middle at each instant,
    and ``unit`` how many of these numbers are a unit of length.

    ``tracks`` are resampled. ``chances`` are the probabilities to lead of each id in each window, under ``None`` that
    none does. ``curves`` gives the lag curves of the followers of a leader, and the largest correlation by chance.
    """
    rows = _choose_rows(tracks, leaders)
    names = [tracks.ids[row] for row in rows]
    row_of = {name: k for k, name in enumerate(names)}
    numbers = np.unique(tracks.step_numbers)
    numbers = numbers[np.unique(np.linspace(0, len(numbers) - 1, min(len(numbers), _MAX_INSTANTS)).astype(int))]
    instants = np.asarray(numbers * float(tracks.step or 1.0), np.float64)
    window_of = _number_windows(track_windows, instants)
    curves_of = {leader.id: curves(leader.id) for leader in leaders[:_MAX_CURVES] if leader.id in row_of}
    return {
        "ids": [printable(name) for name in names],
        "all": len(tracks.ids),
        "colors": [colors.get(name) for name in names],
        "times": [str(tracks.clock.file_time(second)) for second in instants.tolist()],
        "window_of": window_of,
        "windows": [_collect_window(window, row_of) for window in windows],
        **_scale(_locate(tracks, rows, numbers)),
        "length_unit": tracks.length_unit,
        "chances": [[_round(each.get(name)) for each in chances] for name in names] if any(chances) else None,
        "no_leader": [_round(each.get(None)) for each in chances],
        "curves": {
            row_of[name]: _collect_curves(table, chance, row_of)
            for name, (table, chance) in curves_of.items()
            if table is not None
        },
        "first": next((row_of[leader.id] for leader in leaders if leader.id in row_of), 0),
        "begin": next((k for k, number in enumerate(window_of) if number >= 0), 0),
    }


def _round(value: float | None) -> float | None:
    return None if value is None or not np.isfinite(value) else round(float(value), 3)


def _choose_rows(tracks: Tracks, leaders: Sequence[Leader]) -> list[int]:
    """The rows of the ids on the map: leaders first, then followers of each leader in turn, then the others."""
    row_of = {name: row for row, name in enumerate(tracks.ids)}
    followers = chain(*zip_longest(*(leader.followers for leader in leaders)))
    order = dict.fromkeys([*(leader.id for leader in leaders), *followers, *tracks.ids])
    return [row_of[name] for name in order if name in row_of][:_MAX_IDS]


def _locate(tracks: Tracks, rows: list[int], numbers: Indices) -> Floats:
    """Where some ids are at some steps, ``(n, T, 2)``; not a number where they are not seen."""
    position = np.full((len(tracks.ids), len(numbers), 2), np.nan)
    is_shown = np.isin(tracks.step_numbers, numbers)
    columns = np.searchsorted(numbers, tracks.step_numbers[is_shown])
    position[tracks.owner[is_shown], columns] = tracks.position[is_shown, :2]
    return position[rows]


def _scale(position: Floats) -> dict[str, Any]:
    """The places ``(n, T, 2)`` as whole numbers, and what the map needs to know of them."""
    low, high = np.nanmin(position, axis=(0, 1)), np.nanmax(position, axis=(0, 1))
    unit = _GRID / max(float((high - low).max()), 1e-9)
    scaled = (position - low) * unit
    first, last = np.fmin.reduce(scaled, axis=0), np.fmax.reduce(scaled, axis=0)  # (T, 2) of all ids
    middles = np.nan_to_num((first + last) / 2).round().astype(int)
    return {
        "points": np.where(np.isnan(scaled), -1, scaled).round().astype(int).reshape(len(position), -1).tolist(),
        "size": ((high - low) * unit).clip(1).round().astype(int).tolist(),
        "spread": np.nanmax(last - first, axis=0).clip(1).round().astype(int).tolist(),
        "middles": middles.tolist(),
        "unit": unit,
    }


def _number_windows(track_windows: Sequence[TrackWindow], seconds: Floats) -> list[int]:
    """The last window that holds each instant, or -1."""
    numbers = np.full(len(seconds), -1)
    for number, window in enumerate(track_windows):
        numbers[(seconds >= window.start - 1e-6) & (seconds <= window.end + 1e-6)] = number
    return numbers.tolist()


def _collect_window(window: DetectedWindow, row_of: Mapping[Name, int]) -> dict[str, Any]:
    """The leaders of a window, the numbers of all their followers, and the links, among the ids that are shown."""
    links = [
        {"follower": row_of[link.follower], "leader": row_of[link.leader], "head": row_of[link.head]}
        | {"direct": link.direct, "delay": _round(link.delay)}
        | {"low": _round(link.delay_low), "high": _round(link.delay_high)}
        for link in (_join_ends(link, row_of) for link in window.links)
        if {link.follower, link.head} <= row_of.keys()
    ]
    behind = Counter(link.head for link in window.links)
    leaders = {row_of[leader.id]: behind[leader.id] for leader in window.leaders if leader.id in row_of}
    numbers = {"leaders": [*leaders], "followers": [*leaders.values()]}
    return {"start": str(window.start), "end": str(window.end), **numbers, "links": links}


def _join_ends(link: Link, row_of: Mapping[Name, int]) -> Link:
    """The link, or one to the head where the id that is followed isn't shown."""
    to_head: Any = {"direct": False, "delay_low": None, "delay_high": None}
    return link if link.leader in row_of else replace(link, leader=link.head, delay=link.behind_head, **to_head)


def _collect_curves(table: pd.DataFrame, chance: float, row_of: Mapping[Name, int]) -> dict[str, Any]:
    """The lag curves of the followers that are shown, and what is reached by chance."""
    curves = {row_of[name]: [_round(value) for value in table[name]] for name in table.columns if name in row_of}
    return {"lags": [round(float(lag), 6) for lag in table.index], "chance": _round(chance), "of": curves}
