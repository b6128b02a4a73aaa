"""The first page of the results, and README.md's table."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache

from detectors.studies import rounds, table2
from result_pages.suites import read_suite
from result_pages.text import RESULTS, Row, mean_of, page, share, table
from result_pages.tiers import of, tier_rows
from usnet_env.evaluation import load_suite
from usnet_env.evaluation.report import format_interval, mean_over_episodes
from usnet_env.evaluation.statistics import rate_interval
from usnet_env.evaluation.suite import read_rows

DETECTORS = (
    "follow-mixture",
    "follow-mixture(policy='map')",
    "learned",
    "lagged-regression",
    "lagged-network",
    "destroy-all",
)
HEADER = (
    "detector",
    "P1, no decoy, m = 2: head alone named",
    "P1, 1 decoy, m = 2, 15: head alone named",
    "P2, no decoy: J_m",
    "P2, 10 decoys: J_m",
    "no UAV follows another: UAVs named",
    "the field: heads alone named in round 1",
)


def _with_n(rows: Sequence[Row], made: Callable[[Sequence[Row]], str]) -> str:
    """A number and its n; nothing without rows."""
    return f"{made(rows)}; {len(rows)}" if rows else "–"


def _named_alone(rows: Sequence[Row]) -> str:
    return share(rate_interval([float(row["exact"]) for row in rows]))


def _paper() -> tuple[str, ...]:
    """The paper's own numbers."""
    rates = [rate.mean for (_, followers), rate in table2.read_paper().items() if followers == 2]
    low, high = rounds.read_paper()["follow"].bounds("J", 82)
    single = f"{100 * sum(rates) / len(rates):.1f} %; 7,000"
    return ("the paper (GASSL, MC-GASSL), in its own words", single, "–", f"{low:.2f}–{high:.2f}", "–", "–", "–")


def _algorithms() -> tuple[str, ...]:
    """`gassl` in P1 and `mc-gassl` in P2."""
    rates = []
    for name, sizes in (("episodes-seed2022.csv", (2,)), ("episodes-decoys1-seed2022.csv", (2, 15))):
        hits = [
            float(row.hit)
            for row in read_rows(RESULTS / "table2" / name, table2.Row)
            if row.detector == "gassl" and row.followers in sizes
        ]
        rates.append(f"{share(rate_interval(hits))}; {len(hits)}" if hits else "–")
    played = [
        row
        for row in read_rows(RESULTS / "rounds" / "rounds-seed2022.csv", rounds.Row)
        if row.detector == "mc-gassl" and (row.clusters, row.uavs) == (5, 82)
    ]
    cost = "–"
    if played:
        cost = f"{format_interval(mean_over_episodes(played, 'J'), short=True)}; {len(played)}"
    return ("`gassl` (P1), `mc-gassl` (P2)", *rates, cost, "–", "–", _field("mc-gassl"))


@cache
def _field_rows() -> list[Row]:
    return read_suite(load_suite("field"))


def _field(name: str) -> str:
    return _with_n([row for row in _field_rows() if row["detector"] == name], _named_alone)


def _line(name: str) -> tuple[str, ...]:
    single, decoys = of(tier_rows("P1"), name), of(tier_rows("decoys"), name)
    with_decoy = [row for row in single if row["variant"].endswith("-d1")]
    return (
        f"`{name}`",
        _with_n([row for row in single if row["variant"] == "m2-d0"], _named_alone),
        _with_n(with_decoy, _named_alone),
        _with_n(of(tier_rows("paper"), name), lambda rows: mean_of(rows, "J", 2)),
        _with_n([row for row in decoys if row["variant"].endswith("-10")], lambda rows: mean_of(rows, "J", 2)),
        _with_n(of(tier_rows("silence"), name), lambda rows: mean_of(rows, "named", 1)),
        _field(name),
    )


@cache
def _lines() -> list[Sequence[str]]:
    return [_paper(), _algorithms(), *(_line(name) for name in DETECTORS)]


def summary(short: bool = False) -> str:
    """The table of README.md, at most eight rows; ``short`` leaves out what the index says around it."""
    lines = _lines()
    caption = (
        "Means over f1–f7 with 95 % intervals, and n after the semicolon; a mean alone: all episodes were equal. "
        "*Head alone named*: higher is better. J_m: rounds plus redundant candidates divided by N; lower is better, "
        "the best value is 1. *UAVs named*: 0 is right. P2 has M = 5 clusters and N = 82 UAVs plus the decoys; M "
        "is not given. No decoy: iid heads; decoys: half of the episodes with iid, half with Gauss–Markov heads. *The "
        "field* is the frozen suite `field`, whose leaders are late, weak, indirect or hard to see. A name without "
        "arguments is the detector as it comes."
    )
    trivial = [
        f"`{name}`: J_m {_with_n(of(tier_rows('paper'), name), lambda rows: mean_of(rows, 'J', 2))}"
        for name in ("random", "none")
    ]
    ends = f"The other trivial policies in P2 without decoys, which ends after 20 rounds: {', '.join(trivial)}."
    return f"{table(HEADER, lines)}\n\n{caption} {ends}" if short else f"{caption} {ends}\n\n{table(HEADER, lines)}"


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
    ("suites", "frozen suites: paper, controls, field and sensing"),
    ("suites_cells", "every cell of the frozen suites"),
    ("literature", "experiments of the literature on leaders"),
    ("real_tracks", "recorded tracks with known leaders"),
    ("speed", "speed and memory"),
)


def text() -> str:
    """The page."""
    return page(
        "Results",
        "All tables of these pages are made by `python benchmarks/tables.py` from the rows in `benchmarks/results/`; "
        "`benchmarks/README.md` lists the command of every file. The label of a row is the detector's full name with "
        "every argument that differs from its default. Intervals are 95 %: Wilson's for rates, the percentile "
        "bootstrap over episodes for means.",
        "## One table",
        summary(),
        "J alone is won by policies that no observer would want: destroying all UAVs in round 1 costs less than 2, "
        "and beats every detector that needs a second round. So precision, recall, the share of exact episodes and "
        "the trivial policies stand beside it on the pages.",
        "## Pages",
        "\n".join(
            f"* [{words[0].upper()}{words[1:]}]({name}.md)" if words[0] != "`" else f"* [{words}]({name}.md)"
            for name, words in PAGES
        ),
        "\n".join(["```{toctree}", ":hidden:", "", *(name for name, _ in PAGES), "```"]),
    )
