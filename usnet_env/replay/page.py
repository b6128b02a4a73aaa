"""A page of one or several episodes that any browser opens: animation, table of rounds, scores. It needs no network."""

from __future__ import annotations

import base64
import html
import io
import json
import os
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from usnet_env.config import format_count
from usnet_env.files import as_path, atomic_write
from usnet_env.objectives import f1
from usnet_env.replay.animation import Painter, name_answer, reduce_colors, scenes
from usnet_env.replay.episode import EpisodeRecord, check_record
from usnet_env.replay.story import (
    OTHER,
    describe_outcome,
    describe_round,
    explain_uav,
    mark_words,
    name_game,
    name_kind,
    name_round,
    name_uav,
    rank_scores,
)

if TYPE_CHECKING:
    from PIL.Image import Image

_FRAMES = 6  # of a window; the answer, the destruction and the re-merge have one or two each
_MOST_ROUNDS, _LEAST_ROUNDS = 24, 4  # with pictures: of all episodes together, and of each; the tables have all of them
_MOST_BARS = 20
_COLORS = 128  # of the pictures

_STYLE = """
:root { color-scheme: light dark; --line: #d5d9de; --soft: #5d6670; --blue: #0072b2; --green: #009e73;
  --orange: #d55e00; --bar: #b4bac1; --page: light-dark(#fff, #14181d); }
@media (prefers-color-scheme: dark) {
  :root { --line: #3a414a; --soft: #a3adb8; --blue: #56b4e9; --green: #1ed9a0; --orange: #ff8a3d; --bar: #5a636d; }
  .maps img { filter: brightness(0.88); }
}
body { font: 16px/1.5 system-ui, sans-serif; max-width: 62rem; margin: 0 auto; padding: 1rem;
  background: var(--page); color: light-dark(#1a1f24, #e8ebee); }
h1 { font-size: 1.6rem; } h2 { margin-top: 2.5rem; border-top: 1px solid var(--line); padding-top: 1.2rem; }
.maps { display: flex; flex-wrap: wrap; gap: 1rem; margin: 0; }
.maps figure { flex: 1 1 18rem; margin: 0; } .maps img { width: 100%; border: 1px solid var(--line); }
figcaption, .soft { color: var(--soft); font-size: 0.9rem; }
.now { position: sticky; top: 0; padding-bottom: 0.5rem; background: var(--page); } .now b { font-size: 1.1rem; }
.now p { min-height: 3em; margin: 0.3rem 0; } .now div { display: flex; gap: 0.8rem; align-items: center; }
input[type=range] { width: 100%; accent-color: var(--blue); height: 2rem; }
button { font: inherit; padding: 0.3rem 1rem; }
.scroll { overflow-x: auto; } table { border-collapse: collapse; width: 100%; font-variant-numeric: tabular-nums; }
th, td { text-align: left; padding: 0.3rem 0.7rem 0.3rem 0; border-bottom: 1px solid var(--line); }
.bar { display: flex; gap: 0.5rem; align-items: center; font-size: 0.85rem; }
.bar i { display: inline-block; height: 0.75rem; background: var(--bar); }
.hit i { background: var(--green); } .redundant i { background: var(--orange); } .missed i { background: currentcolor; }
.key { display: flex; flex-wrap: wrap; gap: 0 1.1rem; }
.bar span:first-child { flex: none; min-width: 4rem; } summary { cursor: pointer; }
"""

# Moves through the frames of an episode; the page is complete without it, with the last frame and all tables.
_SCRIPT = """
for (const box of document.querySelectorAll("[data-frames]")) {
  const frames = JSON.parse(box.querySelector("script").textContent);
  const [seen, truth] = box.querySelectorAll("img"), now = box.querySelector(".now");
  const slider = box.querySelector("input"), button = box.querySelector("button");
  let timer = 0;
  const show = () => {
    const frame = frames[slider.value];
    seen.src = frame.seen; truth.src = frame.truth;
    now.querySelector("b").textContent = frame.title;
    now.querySelector("p").textContent = frame.text;
    now.querySelector("span").textContent = frame.score;
  };
  const stop = () => { clearTimeout(timer); timer = 0; button.textContent = "Play"; };
  const play = () => {
    if (+slider.value === frames.length - 1) { stop(); return; }
    slider.value = +slider.value + 1; show();
    timer = setTimeout(play, 1000 * frames[slider.value].seconds);
  };
  slider.addEventListener("input", () => { stop(); show(); });
  button.addEventListener("click", () => {
    if (timer) { stop(); return; }
    if (+slider.value === frames.length - 1) { slider.value = 0; show(); }
    button.textContent = "Pause"; timer = setTimeout(play, 300);
  });
  slider.value = 0; show();
}
"""

_ABOUT = (
    "A swarm of UAVs flies in clusters, in which followers follow a head. A detector watches equal dots, and names the "
    "heads. The UAVs that it names are destroyed, and followers without a head join another one."
)
_ABOUT_TRACKS = "A detector looks for leaders and their followers in windows of recorded tracks."
_TRUTH, _NO_TRUTH = "The truth is what the file says of the leaders.", "The truth is unknown."
_KEY = (
    "<p class='soft key'><span>blue ring: candidate</span><span>star: head</span><span>dot: follower, in the colour of "
    "its head</span><span>green ring: hit</span><span>orange square: redundant</span><span>dashed ring: head that was "
    "not named</span>{more}</p>"
)
_GAME_KEY, _KNOWN_KEY = _KEY.format(more="<span>cross: destroyed</span>"), _KEY.format(more="")
_FOUND_KEY = (
    "<p class='soft key'><span>star: leader that was found</span><span>dot: follower, in the colour of its leader"
    "</span><span>grey dot: no leader was found</span></p>"
)


def _encode(picture: Image) -> str:
    """A picture as the text of a ``src`` attribute."""
    file = io.BytesIO()
    picture.save(file, format="PNG")
    return f"data:image/png;base64,{base64.b64encode(file.getvalue()).decode()}"


def _list_frames(record: EpisodeRecord, most: int) -> list[dict[str, object]]:
    """The frames of the first ``most`` rounds of an episode, with their pictures and words."""
    painter, frames = Painter(record), []
    shown = [
        scene for scene in scenes(record, _FRAMES) if scene.round <= most and (scene.phase != 3 or scene.turn in (0, 1))
    ]
    maps = [painter.maps(scene) for scene in shown]
    samples = [each for pair, scene in zip(maps, shown, strict=True) if scene.phase for each in pair]
    pictures = iter(reduce_colors([each for pair in maps for each in pair], samples, _COLORS))
    for scene in shown:
        seen, truth = _encode(next(pictures)), _encode(next(pictures))
        title = f"{name_round(record)} {scene.round} of {record.rounds}"
        words = {"title": title, "text": scene.text, "score": re.sub(" {2,}", " · ", scene.score)}
        frames.append({"seen": seen, "truth": truth, "seconds": max(scene.seconds, 0.35), **words})
    return frames


def _write_rounds(record: EpisodeRecord) -> str:
    if not record.labelled:
        return ""
    scores = f1(record.head, record.candidates) if record.recorded else record.objective
    rows = "".join(
        f"<tr><td>{r + 1}</td><td>{record.candidates[r].sum()}</td><td>{record.hits[r]}</td>"
        f"<td>{record.redundant[r]}</td><td>{record.heads_left[r]}</td><td>{scores[r]:.3f}</td>"
        f"<td>{record.seconds[r]:.2f}</td></tr>"
        for r in range(record.rounds)
    )
    part, last = name_round(record), ("heads not named", "F1") if record.recorded else ("heads left", "J so far")
    names = (part.lower(), "candidates", "heads hit", "redundant", *last, "seconds")
    heading = "".join(f"<th>{name}</th>" for name in names)
    made = f"<table><thead><tr>{heading}</tr></thead><tbody>{rows}</tbody></table>"
    return f"<h3>{part}s</h3><div class='scroll'>{made}</div>"


def _write_scores(record: EpisodeRecord, number: int) -> str:
    """The scores of a round as bars, and the reasons of the candidates and missed heads."""
    r, words = number - 1, mark_words(record, number)
    order = rank_scores(record, number)[:_MOST_BARS]
    top = max(float(record.scores[r][order].max(initial=0)), np.finfo(float).tiny)
    bars = []
    for i in order.tolist():
        width = 60 * max(float(record.scores[r, i]), 0) / top
        why = "" if words[i] == OTHER else f" – {html.escape(words[i])}. {html.escape(explain_uav(record, number, i))}"
        name = html.escape(name_uav(record, i))
        bars.append(f"<div class='bar {words[i]}'><span>{name}</span><i style='width:{width:.1f}%'></i>"
                    f"<span>{record.scores[r, i]:.3g}{why}</span></div>")  # fmt: skip
    title = html.escape(f"{name_round(record)} {number}: {describe_round(record, number)}")
    return f"<details{' open' if number == 1 else ''}><summary>{title}</summary>{''.join(bars)}</details>"


def _write_episode(name: str, link: str | None, record: EpisodeRecord, most: int) -> str:
    frames = _list_frames(record, most)
    last = frames[-1]
    data = json.dumps(frames).replace("<", "\\u003c")
    by, part, kind = html.escape(name_game(record)), name_round(record).lower(), name_kind(record)
    more = f" The pictures show the first {format_count(most, part)}." if record.rounds > most else ""
    file = "" if link is None else f" Episode file: <a href='{html.escape(link, quote=True)}'>{html.escape(link)}</a>."
    maps = "".join(
        f"<figure><img alt='{alt}' src='{last[side]}'><figcaption>{alt}</figcaption></figure>"
        for side, alt in (("seen", "What the detector sees"), ("truth", name_answer(record)))
    )
    scores = "".join(_write_scores(record, number) for number in range(1, min(record.rounds, most) + 1))
    key = _FOUND_KEY if not record.labelled else _KNOWN_KEY if record.recorded else _GAME_KEY
    return f"""<section><h2>{html.escape(name)}</h2>
<p>{by}. {html.escape(describe_outcome(record))}{more}{file}</p>
<div data-frames="{len(frames)}"><script type="application/json">{data}</script>
<div class="now"><b>{last["title"]}</b> <span class="soft">{last["score"]}</span><p>{last["text"]}</p>
<div><button>Play</button><input type="range" min="0" max="{len(frames) - 1}" value="{len(frames) - 1}"
aria-label="frame"></div></div>
<div class="maps">{maps}</div></div>{key}
{_write_rounds(record)}
<h3>Scores</h3>
<p class="soft">Highest first; each with the mark of the {kind} and the reason of the detector.</p>{scores}
</section>"""


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

    Returns:
        The path.

    Raises:
        ArgumentError: the place can't be written to.
        MissingExtraError: matplotlib is not installed.
    """
    most = max(_MOST_ROUNDS // max(len(records), 1), _LEAST_ROUNDS)
    sections = [
        _write_episode(name, (links or {}).get(name), check_record(each), most) for name, each in records.items()
    ]
    about = _ABOUT
    if any(each.recorded for each in records.values()):
        about = f"{_ABOUT_TRACKS} {_TRUTH if all(each.labelled for each in records.values()) else _NO_TRUTH}"
    shown = f"<p>{about} This page has {format_count(len(records), 'recorded episode')}.</p>" if records else ""
    page = f"""<!doctype html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">
<title>{html.escape(title)}</title><style>{_STYLE}</style></head><body>
<h1>{html.escape(title)}</h1>
{shown}
{"".join(f'<div class="scroll">{table}</div>' for table in tables)}{"".join(sections)}
<script>{_SCRIPT}</script></body></html>
"""
    with atomic_write(as_path("path", path)) as aside:
        aside.write_text(page, encoding="utf-8")
    return as_path("path", path)


def write_episode_page(record: EpisodeRecord, path: str | os.PathLike[str]) -> Path:
    """Write a page of one episode, which links to ``episode.npz`` beside it; see :func:`write_page`."""
    return write_page("Who leads this swarm?", {"The game": record}, path, links={"The game": "episode.npz"})
