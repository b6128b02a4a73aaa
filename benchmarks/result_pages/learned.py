"""learned, the detector that was trained with labels, and an observer trained by PPO."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

from running import RESULTS, read_csv

from result_pages.text import Row, exact_of, mean_of, page, share_of, table
from usnet_env.evaluation.report import group_rows

EIGHT = "eight others"


def pivot(rows: Sequence[Row], episode: str) -> str:
    """A line for each swarm, strategy and metric; a column for each detector."""
    names = list(dict.fromkeys(row["detector"] for row in rows))
    lines = []
    for key, own in group_rows(rows, lambda row: (row["swarm"], row["follow"])).items():
        swarm, follow = key
        by_name = {name: [row for row in own if row["detector"] == name] for name in names}
        counts = "–".join(map(str, sorted({len(some) for some in by_name.values()})))
        costs = [mean_of(some, "J", 2, episode) if some else "" for some in by_name.values()]
        lines.append((swarm, follow, counts, *costs))
    return table(("swarm", "strategy", "n", *(f"`{name}`: J_m" for name in names)), lines)


def exact(rows: Sequence[Row], episode: str) -> str:
    """The share of exact episodes by swarm, over f1 to f7 and over the other strategies."""
    names = list(dict.fromkeys(row["detector"] for row in rows))
    lines = []
    groups = group_rows(rows, lambda row: (row["swarm"], "f1–f7" if row["follow"] in _SEVEN else EIGHT))
    for key, own in groups.items():
        swarm, strategies = key
        by_name = [[row for row in own if row["detector"] == name] for name in names]
        counts = "–".join(map(str, sorted({len(some) for some in by_name})))
        lines.append((swarm, strategies, counts, *(exact_of(some, episode) for some in by_name)))
    return table(("swarm", "strategies", "n", *(f"`{name}`: exact" for name in names)), lines)


_SEVEN = tuple(f"f{number}" for number in range(1, 8))


def limits() -> str:
    """A line for each variant and detector, over f1 to f7."""
    rows = read_csv(RESULTS / "learned_limits.csv")
    lines = []
    for key, own in group_rows(rows, _variant).items():
        tier, variant, name = key
        empty = tier in ("silence", "shifted")
        lines.append(
            (
                tier,
                variant,
                f"`{name}`",
                str(len(own)),
                "" if empty else mean_of(own, "J", 2, "seed"),
                share_of(own, lambda row: int(row["named"]) == 0, "seed") + " empty"
                if empty
                else exact_of(own, "seed"),
                mean_of(own, "named", 2, "seed"),
                mean_of(own, "decoys_named", 2, "seed") if tier in ("decoys", "bare") else "",
            )
        )
    return table(("tier", "variant", "detector", "n", "J_m", "exact", "UAVs named", "decoys named"), lines)


def _variant(row: Row) -> tuple[str, str, str]:
    """Tier, variant and detector; the six mobilities of ``silence`` and ``shifted`` count together."""
    _, _, variant = row["cell"].partition("-")
    if row["tier"] == "silence":
        variant = "with jitter" if variant.endswith("-jitter") else "without jitter"
    return row["tier"], "" if row["tier"] == "shifted" else variant, row["detector"]


@cache
def games() -> str:
    """The tables of learned.csv."""
    rows = read_csv(RESULTS / "learned.csv")
    return f"{pivot(rows, 'seed')}\n\n{exact(rows, 'seed')}"


@cache
def trained() -> str:
    """The tables of ppo_observer.csv."""
    rows = read_csv(RESULTS / "ppo_observer.csv")
    return f"{pivot(rows, 'episode')}\n\n{exact(rows, 'episode')}"


def text() -> str:
    """The page."""
    return page(
        "learned, and an observer trained by PPO",
        "`learned` was trained with labels on random follow strategies; it shows what labels are worth. M = 5, N = "
        "82; no detector is given M. Episodes end after 20 rounds; destroying all UAVs costs J_m = 1.94. n is that of "
        "each detector in the line.",
        "Seeds 2022 to 2041. `learned` was not tuned on them, with one exception: an earlier network failed on "
        "`products` with tuning seeds, and features were added for that reason. `follow-mixture` was developed "
        "further after rows of an earlier build had been published for these seeds, so they are not new to it. "
        "Half of the eight other strategies lie inside its [feature classes](strategies.md).",
        games(),
        "## Harder swarms",
        "The cells of `benchmarks/follow_mixture.py`, from seed 2022: short windows (T: steps), position noise in "
        "metres, missed samples, straight heads, decoys (the last number), and windows in which no UAV follows "
        "another. `bare`: straight or waypoint heads without the followers' jitter, and 5 decoys. A name without "
        "arguments is the default policy, `cost`.",
        limits(),
        "Tables with both policies, on other seeds and with more detectors, are on the page of [decoys](decoys.md).",
        "## An observer trained by PPO",
        "A small P2, M = 3 and N = 20, at most 10 rounds; destroying all UAVs costs J_m = 1.85. The observer `ppo` was "
        "trained from the reward alone, on random follow strategies with iid heads.",
        trained(),
        files=["learned.csv", "learned_limits.csv", "learned_losses.csv", "ppo_observer.csv", "ppo_observer_curve.csv"],
    )
