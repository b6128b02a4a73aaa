"""What each threshold of follow-mixture is worth: rows of ``threshold_ablation.py``."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np
from running import RESULTS, read_csv
from threshold_ablation import CHANGES
from usnet_env.evaluation.statistics import mean_interval

from result_pages.text import page, table

FILE, DIRECTION = "follow_mixture_thresholds.csv", "follow_mixture_direction.csv"
_LEAST = 0.005  # half a point
Key = tuple[str, str, int]


def read_windows(name: str) -> dict[str, dict[Key, tuple[float, float]]]:
    """By change and window of a file: whether the answer is exact, and J."""
    found: dict[str, dict[Key, tuple[float, float]]] = {key: {} for key in CHANGES}
    for row in read_csv(RESULTS / name):
        found[row["change"]][row["tier"], row["cell"], int(row["game"])] = (float(row["exact"]), float(row["J"]))
    return found


def compare(windows: dict[str, dict[Key, tuple[float, float]]], tiers: Collection[str]) -> str:
    """A line for each change: the change of the exact share and of J by it, over the windows and by tier."""
    whole, lines = windows[""], []
    for key, change in CHANGES.items():
        common = [window for window in whole if window in windows[key]]
        if not key or not common:
            continue
        losses = np.array([np.subtract(windows[key][window], whole[window]) for window in common]) * (-1, 1)
        exact, cost = (mean_interval(losses[:, column]) for column in (0, 1))
        by_tier = {
            tier: [mean_interval(own[:, column], confidence=1 - 0.05 / len(tiers)) for column in (0, 1)]
            for tier in tiers
            if len(own := losses[[window[0] == tier for window in common]])
        }
        worst = max(by_tier, key=lambda tier: by_tier[tier][1].mean)
        there = by_tier[worst][1]
        shown = max(exact.low, cost.low, *(each.low for pair in by_tier.values() for each in pair)) > 0
        suspected = max(cost.mean, exact.mean, *(each.mean for pair in by_tier.values() for each in pair)) > _LEAST
        lines.append(
            (
                f"`{key}`",
                change.what,
                f"{len(common):,}",
                f"{-100 * exact.mean:+.1f} ({-100 * exact.high:+.1f} to {-100 * exact.low:+.1f})",
                f"{cost.mean:+.3f} ({cost.low:+.3f} to {cost.high:+.3f})",
                f"{worst}: {there.mean:+.3f} ({there.low:+.3f} to {there.high:+.3f})",
                "yes" if shown else "not shown" if suspected else "no",
            )
        )
    return table(("change", "what changes", "windows", "exact, points", "J", "worst tier: J", "earns"), lines)


def text() -> str:
    windows, direction = read_windows(FILE), read_windows(DIRECTION)
    tiers = dict.fromkeys(window[0] for window in windows[""])
    counts = ", ".join(f"{tier} {sum(window[0] == tier for window in windows[''])}" for tier in tiers)
    return page(
        "Thresholds of follow-mixture",
        "Each threshold of [follow-mixture](../follow_mixture.md) is moved or switched off alone, and the same "
        "windows are answered again: first windows of games of a tuning seed, windows of the frozen suite `field` "
        "with its tuning seed, and random swarms of the calibration's grammar, which fly in a constant wind in the "
        "tier `drift`. The calibration is not estimated again. Differences are paired, with 95 % bootstrap intervals "
        "over windows; the change is worse where points are negative or J is positive. J is the least J_m that the "
        "answer allows; in swarms in which no UAV follows another it is the share of UAVs named with `policy='map'`. "
        "A threshold *earns* its place if the change is worse in all windows or in one tier, and the interval shows "
        f"it: 95 % over all windows, and {100 * (1 - 0.05 / len(tiers)):.1f} % in each of the {len(tiers)} tiers "
        "(corrected for their number). *Not shown*: worse by more than half a point, or by more than 0.005 of J, in "
        "all windows or in one tier, but the interval holds 0. `certain-never` and `heads-never` move parts that are "
        "there for speed: they end the search where it would find the same heads.",
        f"Windows by tier: {counts}.",
        "These rows are of the detector before the comparison of directions was added to it (commit 2baf9cf), which is "
        "the present detector with the change `direction-never`:",
        compare(windows, tiers),
        "The present detector with `policy='map'`, which names no UAV where none seems to lead. Windows of "
        f"{', '.join(dict.fromkeys(window[0] for window in direction['']))}:",
        compare(direction, dict.fromkeys(window[0] for window in direction[""])),
        files=(FILE, DIRECTION),
    )
