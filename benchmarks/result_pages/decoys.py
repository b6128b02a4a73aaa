"""Decoys, swarms in which no UAV follows another, and P1: every policy under its own label."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from result_pages.text import Row, cost_of, exact_of, mean_of, page, share_of, table
from result_pages.tiers import of, tier_rows
from usnet_env.config import format_count

DETECTORS = (
    "follow-mixture",
    "follow-mixture(policy='map')",
    "follow-mixture(objective='P1')",
    "learned",
    "learned(policy='map')",
    "lagged-regression",
    "destroy-all",
    "random",
    "none",
)


COLUMNS: dict[str, Callable[[Sequence[Row]], str]] = {
    "exact": exact_of,
    "J": cost_of,
    "decoys": lambda rows: mean_of(rows, "decoys_named"),
    "named": lambda rows: mean_of(rows, "named"),
    "silent": lambda rows: share_of(rows, lambda row: int(row["named"]) == 0),
}


def lines_of(setting: str, rows: Sequence[Row], columns: Sequence[str]) -> list[tuple[str, ...]]:
    """A line for each detector that played a setting."""
    return [
        (setting, f"`{name}`", f"{len(own):,}", *(COLUMNS[column](own) for column in columns))
        for name in DETECTORS
        if (own := of(rows, name))
    ]


def decoys() -> str:
    """By number of decoys and mobility."""
    lines = []
    for count in (1, 3, 10):
        for mobility, words in (("iid", "iid heads"), ("gauss_markov", "Gauss–Markov heads with jitter")):
            rows = [row for row in tier_rows("decoys") if row["variant"] == f"{mobility}-{count}"]
            lines += lines_of(f"{format_count(count, 'decoy')}, {words}", rows, ("exact", "J", "decoys", "named"))
    return table(("swarms, f1–f7", "detector", "n", "exact", "J_m", "decoys named", "UAVs named"), lines)


def silence() -> str:
    """All mobilities together, with and without jitter."""
    lines = []
    for jitter, words in (("jitter", "with jitter"), ("bare", "without jitter")):
        rows = [row for row in tier_rows("silence") if row["variant"].endswith(jitter)]
        lines += lines_of(f"no UAV follows another, six mobilities {words}", rows, ("silent", "named"))
    lines += lines_of("tracks shifted in time, six mobilities", tier_rows("shifted"), ("silent", "named"))
    return table(("swarms", "detector", "n", "no UAV named", "UAVs named"), lines)


def single_cluster() -> str:
    """P1 by size and decoys."""
    lines = []
    for variant, words in (("m2-d0", "m = 2, no decoy"), ("m2-d1", "m = 2, 1 decoy"), ("m15-d1", "m = 15, 1 decoy")):
        rows = [row for row in tier_rows("P1") if row["variant"] == variant]
        lines += lines_of(words, rows, ("exact", "J", "named"))
    return table(("one cluster, f1–f7", "detector", "n", "head alone named", "J_s", "UAVs named"), lines)


def text() -> str:
    files = [f"follow_mixture/{tier}.csv" for tier in ("decoys", "silence", "shifted", "P1")]
    return page(
        "Decoys, swarms without followers, and P1",
        "A *decoy* flies like a head and no UAV follows it. Each row is labelled with the arguments that were played; "
        "a name without arguments is the detector as it comes. The policies `cost` (the default) and `map` differ "
        "most here: `cost` names at least one UAV and adds doubtful UAVs, because a missed head costs a whole round; "
        "`map` names only UAVs that are more probably heads than not, and may name none. No detector is given M, the "
        "strategy or the number of decoys.",
        "Seed 7077, the same episodes for all detectors: a row with a smaller n has the first episodes of each cell.",
        "## Decoys",
        "P2 with M = 5, and 82 UAVs plus the decoys.",
        decoys(),
        "## No UAV follows another",
        "82 independent UAVs, one window; and windows of 900 steps of 30 UAVs in which every track was shifted in "
        "time by a different amount, so that following is destroyed and each flight stays as it was. The right answer "
        "is empty.",
        silence(),
        "## P1",
        "One head, m followers, one round. J_s is 0 when the head alone is named, -1 for an empty answer, and lower "
        "for redundant candidates. With `objective='P1'` `follow-mixture` is given that there is one head; no other "
        "row is given the number of clusters.",
        single_cluster(),
        files=files,
    )
