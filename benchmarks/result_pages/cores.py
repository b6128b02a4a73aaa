"""The former and the present core of follow-mixture on the same swarms."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from statistics import fmean, median

import numpy as np
from follow_mixture import cells
from running import RESULTS, read_csv
from usnet_env.evaluation.report import group_rows
from usnet_env.evaluation.statistics import mean_interval

from result_pages.text import Row, cost_of, exact_of, page, table

FILES = ("former_core/rows.csv.gz", "former_core/present.csv.gz")
_SAME = ("tier", "cell", "detector", "seed", "episode")
_COSTS = {"P1": -1.0}  # J_s is better when higher
Pair = tuple[Row, Row]
Key = tuple[str, ...]


def paired(former: Iterable[Row], present: Iterable[Row]) -> list[Pair]:
    """The rows of the episodes that both cores played, in the order of the tiers."""
    found = {tuple(row[column] for column in _SAME): row for row in present}
    order = {(cell.tier, cell.name): place for place, cell in enumerate(cells())}
    both = [(row, found[key]) for row in former if (key := tuple(row[column] for column in _SAME)) in found]
    return sorted(both, key=lambda pair: (order[pair[0]["tier"], pair[0]["cell"]], int(pair[0]["episode"])))


def worst_cell(pairs: Iterable[Pair]) -> str:
    """The cell in which mean J is worse by most with the present core, and its change."""
    change = {}
    for (tier, cell), own in group_rows(pairs, lambda pair: (pair[0]["tier"], pair[0]["cell"])).items():
        change[cell] = _COSTS.get(tier, 1.0) * fmean(_rise(pair) for pair in own)
    worst = max(change, key=lambda cell: change[cell])
    return f"{worst}: {change[worst]:.3f}" if change[worst] > 0 else "none"


def _rise(pair: Pair) -> float:
    """J of the present core less that of the former one."""
    return float(pair[1]["J"]) - float(pair[0]["J"])


def _cost_of_all(row: Row) -> float:
    """J of `destroy-all` in the episode of a row, which follows from the numbers of UAVs and heads."""
    uavs, heads = int(row["uavs"]), int(row["heads"])
    if row["tier"] == "P1":
        return float(heads - uavs)
    return 1 + (uavs - heads) / uavs if heads else float(uavs)


def compare(pairs: Iterable[Pair], key: Callable[[Row], Key]) -> str:
    """A line for each value of the key."""
    lines = []
    for name, own in group_rows(pairs, lambda pair: key(pair[0])).items():
        cores = list(zip(*own, strict=True))
        episodes = group_rows(own, lambda pair: pair[0]["episode"]).values()
        change = mean_interval(np.array([fmean(_rise(pair) for pair in some) for some in episodes]))
        lines.append(
            (
                " ".join(filter(None, name)),
                f"{len(own):,}",
                *(made(rows) for made in (exact_of, cost_of) for rows in cores),
                f"{fmean(_cost_of_all(row) for row in cores[0]):.3f}",
                f"{change.mean:+.3f} ({change.low:+.3f} to {change.high:+.3f})",
                *(f"{median(float(row['seconds']) for row in rows):.3f}" for rows in cores),
                worst_cell(own),
            )
        )
    header = (
        "swarms", "n", "exact: former", "present", "J: former", "present",
        "J: `destroy-all`, computed", "J: present less former", "seconds: former", "present",
        "cell that is worse by most",
    )  # fmt: skip
    return table(header, lines)


def text() -> str:
    pairs = paired(*(read_csv(RESULTS / name) for name in FILES))
    return page(
        "Former and present core of follow-mixture",
        "[follow-mixture](../follow_mixture.md) has 2,200 lines; with its former core it had 4,800 (all Python files "
        "of `detectors/follow_mixture`). Both cores played the same swarms, and the rows are of the episodes that "
        "both played. No rule was tuned on the seeds 9191 and 31415. But the scores of the present core on 9191 were "
        "known before three later changes: individual delays, fewer effective rows where innovations are slow, and "
        "the question about the heads found, which single UAVs are asked first. The "
        "interval of the 350 games with straight heads was wide, so six times as many were played with the seed "
        "31415. *Exact* is the share of episodes in which round 1 names all heads and no other UAV. J is J_m (lower "
        "is better), J_s in the tier P1 (0 is best), and the number of UAVs named in the tier silence (0 is right), "
        "which was played with `policy='map'`; the tier P1 with `objective='P1'`. J of `destroy-all`, which names all "
        "UAVs, follows from the numbers of UAVs and heads; it is exact in no episode. Seconds are the median of one "
        "window; both cores were measured on a shared machine. The last column is the cell whose mean J is worse by "
        "most with the present core, and by how much.",
        "## By tier",
        compare(pairs, lambda row: (row["tier"], f"(seed {row['seed']})")),
        "## By variant",
        "A variant is what the name of a cell says after the follow strategy.",
        compare(pairs, lambda row: (row["tier"], row["cell"].partition("-")[2], f"(seed {row['seed']})")),
        "`benchmarks/results/former_core/ablation.md` shows what each rule of the former core was worth.",
        files=FILES,
    )
