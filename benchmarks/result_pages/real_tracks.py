"""Recorded tracks with known leaders."""

from __future__ import annotations

from collections.abc import Sequence

from running import RESULTS, read_csv
from usnet_env.evaluation.report import group_rows

from result_pages.text import Row, mean_of, page, source, table

SETS = {
    "ants": "Ants: tandem runs, a leader and a follower",
    "cars": "Cars: platoons of five, each following the one before it",
}
HEADER = ("detector", "n", "leader has the highest score", "named", "of them right", "confirmed", "of them right", "s")


def _right(rows: Sequence[Row], heads: str, named: str) -> str:
    all_named = sum(int(row[named]) for row in rows)
    return f"{sum(int(row[heads]) for row in rows) / all_named:.0%}" if all_named else "–"


def _computed(rows: Sequence[Row]) -> list[tuple[str, ...]]:
    """The trivial policies whose answers are known without playing; ``rows`` are those of one detector."""
    count = f"{len(rows)}; {len({row['recording'] for row in rows})}"
    chance = f"{sum(1 / float(row['uavs']) for row in rows) / len(rows):.2f}"
    right = f"{sum(int(row['heads']) for row in rows) / sum(int(row['uavs']) for row in rows):.0%}"
    return [
        ("`none`, computed", count, chance, "0.00", "–", "0.00", "–", ""),
        ("`destroy-all`, computed", count, chance, mean_of(rows, "uavs", 2, "recording"), right, "", "", ""),
    ]


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
        if name == "random":
            lines += _computed(own)
    return table(HEADER, lines)


def text() -> str:
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
        "[the test of `usnet detect`](../tracks.md#confirmed-leaders) leaves. These three columns are means over the "
        "recordings of the mean of each recording, so a short recording counts as much as a long one. *Of them right* "
        "is pooled: the right ids of all windows, divided by all ids that were named or confirmed there. The rows of "
        "`none` and `destroy-all` are computed from the numbers of ids and leaders; `destroy-all` was not put to the "
        "test. Intervals are bootstrapped over the "
        "recordings: windows of one recording depend on each other. s: seconds for a window on a busy core.",
        "These recordings were used in the development, so they are no unseen test: a parameter of the "
        "[choice of the step](../tracks.md#the-step) was chosen on them, `follow-mixture` counts the axes along which "
        "ids move because of what was found on them, and its direction uses changes of velocities because "
        "that finds more of these leaders.",
        *parts,
        source(("real_tracks.csv",)),
        "The data are fetched by `examples/fetch_tracks.py`, which cites them.",
    )
