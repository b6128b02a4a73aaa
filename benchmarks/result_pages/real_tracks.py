"""Recorded tracks with known leaders."""

from __future__ import annotations

from collections.abc import Sequence

from running import RESULTS, read_csv

from result_pages.text import Row, mean_of, page, source, table
from usnet_env.evaluation.report import group_rows

SETS = {
    "ants": "Ants: tandem runs, a leader and a follower",
    "cars": "Cars: platoons of five, each following the one before it",
}
HEADER = ("detector", "n", "leader has the highest score", "named", "of them right", "confirmed", "of them right", "s")


def _right(rows: Sequence[Row], heads: str, named: str) -> str:
    all_named = sum(int(row[named]) for row in rows)
    return f"{sum(int(row[heads]) for row in rows) / all_named:.0%}" if all_named else "–"


def lines_of(rows: Sequence[Row]) -> str:
    """A line for each detector."""
    lines = []
    for name, own in group_rows(rows, lambda row: row["detector"]).items():
        lines.append(
            (
                f"`{name}`",
                f"{len(own)}; {len({row['recording'] for row in own})}",
                mean_of(own, "group_leader", 2, "recording"),
                mean_of(own, "named", 2, "recording"),
                _right(own, "named_heads", "named"),
                mean_of(own, "confirmed", 2, "recording"),
                _right(own, "confirmed_heads", "confirmed"),
                f"{sum(float(row['seconds']) for row in own) / len(own):.3f}",
            )
        )
    return table(HEADER, lines)


def text() -> str:
    """The page."""
    rows = read_csv(RESULTS / "real_tracks.csv")
    parts = []
    for (name, chosen), own in group_rows(rows, lambda row: (row["set"], row["chosen"])).items():
        steps = sorted({float(row["step"]) for row in own})
        step = (
            "step of 0.5 s given" if chosen == "0" else f"step chosen from each file, {steps[0]:g} to {steps[-1]:g} s"
        )
        parts += [f"## {SETS[name]}; {step}", lines_of(own)]
    return page(
        "Recorded tracks",
        "Windows of 100 steps, at most 12 from each recording. The leaders are known: of the ants from the observers, "
        "of the cars from their order. n: windows; recordings. *Leader has the highest score*: the group is known, and "
        "its leader is sought by the scores, with ties shared; by chance it is 0.50 for ants and 0.20 for cars. "
        "*Named*: candidates in a window, without knowledge of groups. *Confirmed*: those that "
        "[the test of `usnet detect`](../tracks.md#confirmed-leaders) leaves. Intervals are bootstrapped over the "
        "recordings: windows of one recording depend on each other. s: seconds for a window on a busy core.",
        *parts,
        source(("real_tracks.csv",)),
        "The data are fetched by `examples/fetch_tracks.py`, which cites them.",
    )
