"""The first page of the results, and README.md's tables."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache

from detectors.studies import rounds, table2
from running import RESULTS
from usnet_env.evaluation.report import format_interval, group_rows, mean_over_episodes
from usnet_env.evaluation.suite import read_rows

from result_pages import p1
from result_pages.suites import read_suite
from result_pages.text import SAME_SEEDS, Row, exact_of, mean_of, page, share, table
from usnet_env.evaluation import load_suite

#: The suites of the table, and what is in them.
SUITES = {
    "paper": "the game of the paper",
    "controls": "the obvious answer is wrong",
    "sensing": "bad sensors",
    "field": "leaders are late, weak, indirect or hard to see",
}
#: The rows of README.md's table; the index has every detector.
DETECTORS = (
    "follow-mixture",
    "follow-mixture(policy='map')",
    "learned(policy='map')",
    "lagged-network",
    "lagged-regression",
    "destroy-all",
    "random",
    "none",
)
HEADER = (
    "detector",
    "`paper`: exact",
    "`controls`: exact",
    "`sensing`: exact",
    "`field`: exact",
    "`paper`: J_m",
    "`field`: J_m",
)


@cache
def _played() -> dict[str, dict[str, list[Row]]]:
    """The rows of each suite by detector."""
    return {name: group_rows(read_suite(load_suite(name)), lambda row: row["detector"]) for name in SUITES}


def _line(name: str) -> tuple[str, ...]:
    def say(suite: str, describe: Callable[[list[Row]], str]) -> str:
        rows, most = _played()[suite].get(name, []), max(map(len, _played()[suite].values()))
        if not rows:
            return "–"
        return describe(rows) + (f"; {len(rows)}" if len(rows) < most else "")

    return (
        f"`{name}`",
        *(say(suite, exact_of) for suite in SUITES),
        *(say(suite, lambda rows: mean_of(rows, "J", 2)) for suite in ("paper", "field")),
    )


def _list_detectors() -> list[str]:
    """All detectors of the suites, those that are exact most often in ``field`` first."""
    rows = _played()["field"]
    return sorted(rows, key=lambda name: -sum(int(row["exact"]) for row in rows[name]))


def _compare_best() -> str:
    """What each suite holds, and the detector that is exact most often in it."""
    lines = []
    for name, about in SUITES.items():
        rows, suite = _played()[name], load_suite(name)
        best = max(rows, key=lambda each: sum(int(row["exact"]) for row in rows[each]))  # of those that played most
        lines.append((f"`{name}`", about, f"{len(suite.cells)} × {suite.episodes}", f"`{best}`", exact_of(rows[best])))
    settings = [len(rows) for rows in _played().values()]
    detectors = [len({label.partition("(")[0] for label in rows}) for rows in _played().values()]
    title = f"best of {_range(settings)} settings of {_range(detectors)} detectors"
    return table(("suite", "swarms", "cells × episodes = n", title, "exact"), lines)


def _range(counts: Sequence[int]) -> str:
    """One count, or the least and the largest."""
    return " to ".join(map(str, sorted({min(counts), max(counts)})))


def _explain_columns(short: bool) -> str:
    """What the columns of the tables mean."""
    rules = (
        "Intervals are 95 %; at 0 % or 100 % they use the number of seeds as n, so they can be wider than those of "
        "other rates. The [results pages](docs/results/index.md) have all detectors, tables and figures."
        if short
        else "n is behind a semicolon where a slow detector played fewer episodes. Intervals are 95 %. "
        f"{SAME_SEEDS} A mean without an interval means that all values were equal, or that each cell has one episode."
    )
    return (
        "*Exact*: round 1 names all heads and no other UAV. J_m: the number of rounds, plus the redundant candidates "
        "divided by N; lower is better, 1 is best. A name without arguments means the default settings; –: not "
        f"played. {rules}"
    )


def _paper() -> str:
    """The paper's algorithms: its own numbers, and those of the printed algorithms here."""
    rates = [rate.mean for (_, followers), rate in table2.read_paper().items() if followers == 2]
    low, high = rounds.read_paper()["follow"].bounds("J", 82)
    single = f"{100 * sum(rates) / len(rates):.1f} %; 7,000"
    measured, guessed = [], []
    for name, sizes in (("episodes-seed2022.csv", (2,)), ("episodes-decoys1-seed2022.csv", (2, 15))):
        played = [
            row
            for row in read_rows(RESULTS / "table2" / name, table2.Row)
            if row.detector == "gassl" and row.followers in sizes
        ]
        count, rate = table2.rate_of(played)
        measured.append(f"{share(rate)}; {count}")
        guessed.append(f"{100 * p1.chance(played):.1f} %, computed")
    games = group_rows(
        (
            row
            for row in read_rows(RESULTS / "rounds" / "rounds-seed2022.csv", rounds.Row)
            if (row.clusters, row.uavs) == (5, 82)
        ),
        lambda row: row.detector,
    )

    def cost(name: str) -> str:
        return f"{format_interval(mean_over_episodes(games[name], 'J'), short=True)}; {len(games[name])}"

    lines = [
        ("the paper", single, "–", f"{low:.2f}–{high:.2f}; –"),
        ("`gassl` and `mc-gassl`, as printed", *measured, cost("mc-gassl")),
        ("`random`, one UAV a round", *guessed, cost("random")),
        ("`destroy-all`", "0 %, computed", "0 %, computed", cost("destroy-all")),
    ]
    header = (
        "the paper's algorithms",
        "P1, m = 2, no decoy: head alone named",
        "P1, m = 2 and 15, 1 decoy: head alone named",
        "P2, M = 5, N = 82: J_m",
    )
    return table(header, lines)


_PAPER = (
    "GASSL plays P1, MC-GASSL plays P2; iid heads, f1 to f7, seed 2022, n after the semicolon. A *decoy* flies like a "
    "head, and no UAV follows it. The paper's 98.0 % is the mean of its table over f1 to f7; its J_m follows from the "
    "rounds and redundant candidates that its text reports."
)


def summary(short: bool = False) -> str:
    """The tables of README.md; ``short``: for README.md, with fewer detectors."""
    names, suites = (DETECTORS, "docs/suites.md") if short else (_list_detectors(), "../suites.md")
    about = (
        f"In a [frozen suite]({suites}) all detectors meet the same swarms. They are not given the number of clusters."
    )
    parts = (about, _compare_best(), _explain_columns(short), table(HEADER, map(_line, names)), _PAPER, _paper())
    return "\n\n".join(parts)


PAGES = (
    ("paper_tier", "P2 on the paper's tier, with the trivial policies"),
    ("rounds", "P2 against strategy, M and N, beside the paper's words"),
    ("p1", "P1: detection rates, beside the paper's table"),
    ("decoys", "decoys, swarms without followers, and P1, with both policies of `follow-mixture` and `learned`"),
    ("follow_mixture", "`follow-mixture` by tier, both policies, calibration"),
    ("follow_mixture_cells", "every cell of the tiers"),
    ("follow_mixture_thresholds", "what each threshold of `follow-mixture` is worth"),
    ("follow_mixture_cores", "the former core of `follow-mixture` beside the present one"),
    ("strategies", "follow strategies beside f1 to f7"),
    ("learned", "`learned`, and an observer trained by PPO"),
    ("purity", "purity of the clusterers, metric learning"),
    ("multiagent", "games of several agents"),
    ("suites", "frozen suites: paper, controls, sensing, field and scale"),
    ("suites_cells", "every cell of the frozen suites"),
    ("literature", "experiments of the literature on leaders"),
    ("real_tracks", "recorded tracks with known leaders"),
    ("confirmation", "what each part of the test of leaders in recorded tracks is worth"),
    ("speed", "speed and memory"),
)


def text() -> str:
    return page(
        "Results",
        "All tables of these pages are made by `python benchmarks/tables.py` from the rows in `benchmarks/results/`; "
        "`benchmarks/README.md` lists the command of every file. The label of a row is the detector's full name with "
        "every argument that differs from its default. Intervals are 95 %: Wilson's for rates, the expanded "
        "percentile bootstrap for means. Episodes with the same seed are one group, which widens both.",
        "## One table",
        summary(),
        "Destroying all UAVs in round 1 costs J_m < 2, less than any detector that needs a second round. So J_m alone "
        "does not rank detectors: the share of exact episodes and the trivial policies stand beside it.",
        "## Pages",
        "\n".join(
            f"* [{words[0].upper()}{words[1:]}]({name}.md)" if words[0] != "`" else f"* [{words}]({name}.md)"
            for name, words in PAGES
        ),
        "\n".join(["```{toctree}", ":hidden:", "", *(name for name, _ in PAGES), "```"]),
    )
