"""What each part of the test that confirms leaders is worth: rows of ``confirmation_ablation.py``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from confirmation_ablation import CHANGES
from numpy.typing import NDArray
from running import RESULTS, read_csv
from usnet_env.evaluation.report import group_rows
from usnet_env.evaluation.statistics import mean_interval

from result_pages.text import page, table

FILE = "confirmation_ablation.csv"
_COLUMNS = ("named", "right", "confirmed", "confirmed_right", "followers", "followers_right")
Window = tuple[str, str, str, int]


def read_windows() -> dict[str, dict[Window, NDArray[np.float64]]]:
    """By change and window: wrong ids confirmed, right ids lost, wrong followers and right followers."""
    found: dict[str, dict[Window, NDArray[np.float64]]] = {key: {} for key in CHANGES}
    for row in read_csv(RESULTS / FILE):
        named = {column: float(row[column]) for column in _COLUMNS}
        window = row["set"], row["recording"], row["detector"], int(row["window"])
        found[row["change"]][window] = np.array(
            [
                named["confirmed"] - named["confirmed_right"],
                named["right"] - named["confirmed_right"],
                named["followers"] - named["followers_right"],
                named["followers_right"],
            ]
        )
    return found


def whole(windows: Mapping[Window, NDArray[np.float64]]) -> str:
    """A line for each set and detector: what the whole test leaves, for a window."""
    lines = [
        (name, f"`{detector}`", f"{len(own)}; {len({window[1] for window in own})}", *(f"{mean:.2f}" for mean in means))
        for (name, detector), own in group_rows(list(windows), lambda window: (window[0], window[2])).items()
        if len(means := np.mean([windows[window] for window in own], axis=0))
    ]
    header = "wrong leaders", "right ones rejected", "wrong followers", "right followers"
    return table(("set", "detector", "windows; files", *header), lines)


def compare(windows: Mapping[str, Mapping[Window, NDArray[np.float64]]]) -> str:
    """A line for each change and set in which it moves a number: the differences for 100 windows."""
    lines = []
    for key, change in CHANGES.items():
        if not key:
            continue
        moved = []
        for name, own in group_rows(list(windows[""]), lambda window: window[0]).items():
            loss = np.array([windows[key][window] - windows[""][window] for window in own])
            if loss.any():
                moved.append((name, *map(_differ, (loss[:, 0], loss[:, 1], loss[:, 2], loss[:, 3]))))
        shown: Sequence[tuple[str, ...]] = moved or [("all", "0", "0", "0", "0")]
        lines += [(f"`{key}`" if not n else "", change.what if not n else "", *row) for n, row in enumerate(shown)]
    header = "wrong leaders", "right ones rejected", "wrong followers", "right followers"
    return table(("change", "what changes", "set", *header), lines)


def _differ(values: NDArray[np.float64]) -> str:
    """The mean difference for 100 windows, with its interval."""
    found = mean_interval(100 * values)
    return f"{found.mean:+.1f} ({found.low:+.1f} to {found.high:+.1f})" if values.any() else "0"


def text() -> str:
    windows = read_windows()
    return page(
        "The test of leaders in recorded tracks",
        "Each part of the [test that confirms leaders](../tracks.md#confirmed-leaders) is left out or moved alone, and "
        "applied to the same answers of detectors. *Wrong leaders*: confirmed ids that lead no other id in the window. "
        "*Right ones rejected*: named ids that lead and are not confirmed. *Followers*: of the confirmed leaders; they "
        "are right if they follow this leader for more than half of the window. The sets `large` and `small` are "
        "simulated files with 500 and 60 ids, in which groups change; in `leaderless` and `shepherd` no id leads; "
        "`ants` and `cars` are recordings. All were used in the development of the test.",
        "## The whole test",
        "Means for a window:",
        whole(windows[""]),
        "## Changes",
        "Differences from the whole test, for 100 windows, with 95 % bootstrap intervals over windows; sets in which "
        "nothing changes are left out. Windows of one file depend on each other, so the intervals are rather narrow.",
        compare(windows),
        files=(FILE,),
    )
