"""P2 on the paper's tier."""

from __future__ import annotations

import json

from running import RESULTS, read_csv

from detectors.studies.common import FOLLOW
from result_pages.text import Row, exact_of, mean_of, page, share_of, source, table

DETECTORS = (
    "lagged-regression(clusters=5)",
    "lagged-regression",
    "lagged-correlation",
    "one-per-round",
    "destroy-all",
    "random",
    "none",
)
MEANS = ("precision_first", "recall_first", "ap_first", "rounds", "redundancy")
FOLDER = RESULTS / "multi_cluster"


def rows_of(follow: str) -> list[Row]:
    """The rows of one follow strategy, and a check that the folder's configuration says the same."""
    config = json.loads((FOLDER / follow / "run.json").read_text(encoding="utf-8"))["config"]
    if config["env_kwargs"] != {"follow": follow}:
        raise ValueError(f"{follow}/run.json must be of {follow}, got {config['env_kwargs']}")
    return [{**row, "follow": follow} for row in read_csv(FOLDER / follow / "episodes.csv")]


def text() -> str:
    rows = [row for follow in FOLLOW for row in rows_of(follow)]
    own = {name: [row for row in rows if row["detector"] == name] for name in DETECTORS}
    cells = {(name, f): [row for row in own[name] if row["follow"] == f] for name in DETECTORS for f in FOLLOW}
    counts = sorted({len(some) for some in cells.values()})
    by_strategy = table(
        ("J_m", *FOLLOW),
        [(f"`{name}`", *(mean_of(cells[name, f], "J") for f in FOLLOW)) for name in DETECTORS],
    )
    header = ("f1–f7", "n", "J_m", "exact", "precision", "recall", "AP", "rounds", "redundancy", "all heads found")
    together = table(
        header,
        [
            (
                f"`{name}`",
                f"{len(own[name]):,}",
                mean_of(own[name], "J"),
                exact_of(own[name]),
                *(mean_of(own[name], column) for column in MEANS),
                share_of(own[name], lambda row: float(row["success"]) > 0),
            )
            for name in DETECTORS
        ],
    )
    return page(
        "P2 on the paper's tier",
        f"iid heads, M = 5 clusters, N = 82 UAVs, n = {'–'.join(map(str, counts))} episodes for each follow strategy "
        "and detector; all detectors meet the same swarms (seed 2022). `lagged-regression(clusters=5)` is given M; no "
        "other row is. J_m is better when lower. The trivial policies (`one-per-round`, `destroy-all`, `random`, "
        "`none`) show what J_m alone is worth: destroying all UAVs in round 1 costs 1.94.",
        by_strategy,
        "Precision, recall and AP (average precision) are those of round 1. *Exact* is the share of episodes in which "
        "round 1 names all heads and no other UAV.",
        together,
        source(["multi_cluster/"]),
    )
