"""learned, the detector that was trained with labels, and an observer trained by PPO."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache

from detectors.studies.common import FOLLOW
from follow_mixture_strategies import FIRST_EIGHT
from running import RESULTS, read_csv
from usnet_env.evaluation.report import group_rows

from result_pages.text import Row, exact_of, mean_of, page, share_of, table

Cell = Callable[[Sequence[Row]], str]


def compare(rows: Sequence[Row], strategies: Callable[[Row], str], header: tuple[str, str], cell: Cell) -> str:
    """A line for each swarm and group of strategies, a column for each detector; ``header``: a group, and a cell."""
    names = list(dict.fromkeys(row["detector"] for row in rows))
    lines = []
    for key, own in group_rows(rows, lambda row: (row["swarm"], strategies(row))).items():
        by_name = [[row for row in own if row["detector"] == name] for name in names]
        counts = "–".join(map(str, sorted({len(some) for some in by_name})))
        lines.append((*key, counts, *(cell(some) if some else "" for some in by_name)))
    return table(("swarm", header[0], "n", *(f"`{name}`: {header[1]}" for name in names)), lines)


def two_tables(file: str, episode: str) -> str:
    """J_m by strategy, and the share of exact episodes over f1 to f7 and over the other strategies."""
    rows = read_csv(RESULTS / file)
    costs = compare(rows, lambda row: row["follow"], ("strategy", "J_m"), lambda own: mean_of(own, "J", 2, episode))
    groups = {**dict.fromkeys(FOLLOW, "f1–f7"), **dict.fromkeys(FIRST_EIGHT, "eight others")}
    exact = compare(
        rows, lambda row: groups[row["follow"]], ("strategies", "exact"), lambda own: exact_of(own, episode)
    )
    return f"{costs}\n\n{exact}"


def limits() -> str:
    """A line for each variant and detector, over f1 to f7."""
    rows = read_csv(RESULTS / "learned_limits.csv")
    lines = []
    for (tier, variant, name), own in group_rows(rows, _variant).items():
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
    return two_tables("learned.csv", "seed")


@cache
def trained() -> str:
    return two_tables("ppo_observer.csv", "episode")


def text() -> str:
    return page(
        "learned, and an observer trained by PPO",
        "`learned` was trained with labels on random follow strategies; it shows what labels are worth. M = 5, N = "
        "82; no detector is given M. Episodes end after 20 rounds; destroying all UAVs costs J_m = 1.94. n is that of "
        "each detector in the line.",
        "The seed is 2022, with the episodes 0 to 19; the column `seed` of `learned.csv` is 2022 plus the number of "
        "the episode. `learned` was not tuned on this seed. But `products` is no unseen strategy: an earlier network "
        "failed on it with tuning seeds, and features were added for that reason. `follow-mixture` was developed "
        "further after rows of an earlier build had been published for this seed, so these swarms are not new to it. "
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
