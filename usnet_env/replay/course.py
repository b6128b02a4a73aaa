"""The course of the game in a recording: the text of each round, curves over the rounds, and a lane for each head."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from usnet_env.replay.scribe import HIT_COLOR, Scribe, parse_color
from usnet_env.replay.story import explain_replay, tell_round

ABOUT, ROUND, GAME, LANES = "about", "this_round", "game", "lanes"
#: Names of the curves, with their colours.
CURVES = {
    "heads_left": ("heads left", "#56B4E9"),
    "precision": ("precision so far", "#56B4E9"),
    "recall": ("recall so far", "#F0C04A"),
    "J": ("J so far", HIT_COLOR),
    "leaders": ("leaders named", HIT_COLOR),
}
_MOST_LANES = 12  # heads
_STATES = {
    "watched": "#4A5560",
    "named: hit": "#0F9D74",
    "not named": "#8A6D1F",
    "destroyed": "#7A2E2E",
    "the detector watches": "#4A5560",
    "it answers": "#1F78C8",
    "the candidates are destroyed": "#7A2E2E",
    "followers join other heads": "#6B4FA0",
    "end": "#222222",
}


def write_course(scribe: Scribe) -> None:
    """Write all of it."""
    record, rr, clock = scribe.record, scribe.rr, scribe.clock
    about = rr.TextDocument(explain_replay(record), media_type=rr.MediaType.MARKDOWN)
    scribe.stream.log(scribe.root + ABOUT, about, static=True)
    texts = [text for number in range(1, record.rounds + 1) for text in tell_round(record, number, scribe.names)]
    rows = clock.list_rows([0, clock.answer, clock.destroy, clock.remerge])
    scribe.send(ROUND, rr.TextDocument, rows, 1, text=texts, media_type=["text/markdown"] * len(texts))
    if record.recorded:
        _write_curve(scribe, "leaders", np.append([0.0], record.candidates.sum(axis=1)))
        return
    heads, hits = max(int(record.head.sum()), 1), np.cumsum(record.hits)
    shots = hits + np.cumsum(record.redundant)
    _write_curve(scribe, "heads_left", np.append([heads], record.heads_left))
    _write_curve(scribe, "precision", np.where(shots, hits / np.maximum(shots, 1), 1.0))
    _write_curve(scribe, "recall", np.append([0.0], hits / heads))
    _write_curve(scribe, "J", np.append([0.0], record.objective))
    _write_lanes(scribe)


def _write_curve(scribe: Scribe, name: str, values: NDArray[np.float64]) -> None:
    """Write a number after each round, ``(R,)``, or also before the first one, ``(R + 1,)``."""
    rr, (label, color) = scribe.rr, CURVES[name]
    record, clock = scribe.record, scribe.clock
    rows = [(0, 0)] * (len(values) > record.rounds) + clock.list_rows([clock.destroy])
    rows.append((record.rounds - 1, clock.remerge))  # so that the last value is a line, too
    values = np.append(values, values[-1])
    path = f"{GAME}/{name}"
    scribe.send(path, rr.Scalars, rows, 1, scalars=values)
    shown = {"colors": parse_color(scribe.color or color), "names": label}
    line = rr.SeriesLines(widths=2, interpolation_mode="StepAfter", **shown)
    scribe.stream.log(scribe.root + path, line, rr.SeriesPoints(markers="circle", marker_sizes=5, **shown), static=True)


def _write_lanes(scribe: Scribe) -> None:
    """Write what happens to each head, and the phases of the game, as states."""
    record, clock = scribe.record, scribe.clock
    phases: list[tuple[int, int, str]] = []
    for r in range(record.rounds):
        words = ("the detector watches", "it answers", "the candidates are destroyed")
        phases += [(r, i, word) for i, word in zip((0, clock.answer, clock.destroy), words, strict=True)]
        phases.append((r, clock.remerge, "end" if r + 1 == record.rounds else "followers join other heads"))
    _write_lane(scribe, "game", phases)
    for head in np.flatnonzero(record.head)[:_MOST_LANES].tolist():
        states = []
        for r in np.flatnonzero(record.alive[:, head]).tolist():
            answer = "named: hit" if record.candidates[r, head] else "not named"
            states += [(r, 0, "watched"), (r, clock.answer, answer)]
            if record.destroyed[r, head]:
                states.append((r, clock.destroy, "destroyed"))
        _write_lane(scribe, f"head_{scribe.names[head]}", states)


def _write_lane(scribe: Scribe, name: str, states: list[tuple[int, int, str]]) -> None:
    rr, path = scribe.rr, f"{LANES}/{name}"
    rows = [(r, i) for r, i, _ in states]
    scribe.send(path, rr.StateChange, rows, 1, state=[word for *_, word in states])
    colors = np.array([parse_color(color) for color in _STATES.values()], np.uint8)
    scribe.stream.log(scribe.root + path, rr.StateConfiguration(values=list(_STATES), colors=colors), static=True)
