"""Write the README's tables anew from the committed raw results; `--check` only says whether they are up to date.

python benchmarks/readme_table.py
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

from follow_mixture import SEED
from follow_mixture import rate_of as exact_rate
from follow_mixture import rows_of as tier_rows

from usnet_env.evaluation.statistics import mean_interval
from usnet_env.reproduce.detection_rate import Cell, Row, rate_of, read_rows
from usnet_env.reproduce.rounds import Row as Game
from usnet_env.reproduce.rows import read_rows as read_any
from usnet_env.reproduce.table2 import paper_rates

RESULTS = Path(__file__).parent / "results"
README = Path(__file__).parent.parent / "README.md"
FOLLOW = ("f1", "f2", "f3", "f4", "f5", "f6", "f7")
DETECTORS = (
    "lagged-regression(clusters=5)",
    "lagged-regression",
    "lagged-correlation",
    "one-per-round",
    "destroy-all",
    "random",
    "none",
)


def summaries() -> dict[str, dict[str, dict[str, dict[str, float]]]]:
    """Metrics by follow strategy and detector."""
    found = {}
    for follow in FOLLOW:
        entries = json.loads((RESULTS / "multi_cluster" / follow / "summary.json").read_text(encoding="utf-8"))
        found[follow] = {entry["detector"]: entry["metrics"] for entry in entries}
    return found


def cell(metric: dict[str, float], digits: int = 2) -> str:
    """A mean with its interval."""
    mean, low, high = (f"{metric[name]:.{digits}f}" for name in ("mean", "low", "high"))
    return mean if low == high else f"{mean} ({low}–{high})"


def multi_cluster() -> str:
    """J_m by follow strategy, and what stands beside it, over all strategies."""
    found = summaries()
    lines = ["| J_m (lower is better) | " + " | ".join(FOLLOW) + " |", "| --- |" + " --- |" * len(FOLLOW)]
    for name in DETECTORS:
        lines.append(f"| `{name}` | " + " | ".join(cell(found[follow][name]["J"]) for follow in FOLLOW) + " |")
    beside = (
        ("precision_first", "precision"),
        ("recall_first", "recall"),
        ("ap_first", "AP"),
        ("exact", "exact"),
        ("rounds", "rounds"),
        ("redundancy", "redundancy"),
        ("success", "all found"),
    )
    lines += [
        "",
        "| f1–f7, mean | " + " | ".join(title for _, title in beside) + " |",
        "| --- |" + " --- |" * len(beside),
    ]
    for name in DETECTORS:
        means = [sum(found[f][name][metric]["mean"] for f in FOLLOW) / len(FOLLOW) for metric, _ in beside]
        lines.append(f"| `{name}` | " + " | ".join(f"{mean:.2f}" for mean in means) + " |")
    return "\n".join(lines)


def detection_rates() -> str:
    """P1: rates of naming the head alone over the cells of the paper's table, with and without decoys."""
    lines = ["| P1, one cluster | heads | decoys | cells | episodes | head alone named | lowest cell |"]
    lines.append("| --- |" + " --- |" * 6)
    theirs = [rate.mean for rate in paper_rates().values()]
    mean, least = 100 * sum(theirs) / len(theirs), 100 * min(theirs)
    lines.append(f"| the paper's table | iid | 0 | 70 | 70,000 | {mean:.1f} % | {least:.1f} % |")
    for path in sorted((RESULTS / "table2").glob("episodes*.csv"), key=lambda path: (len(path.name), path.name)):
        rows = read_rows(path)
        for detector in dict.fromkeys(row.detector for row in rows):
            own = [row for row in rows if row.detector == detector]
            cells: dict[Cell, list[Row]] = {}
            for row in own:
                cells.setdefault(row.cell, []).append(row)
            rates = [sum(row.hit for row in some) / len(some) for some in cells.values()]
            heads = own[0].mobility + (" with jitter" if own[0].head_jitter else "")
            overall = rate_of(own)
            if overall is None:
                continue
            mean, low, high = (100 * value for value in overall[1])
            where = f"{heads} | {own[0].decoys} | {len(cells)}"
            lines.append(
                f"| `{detector}` | {where} | {len(own):,} | {mean:.1f} % ({low:.1f}–{high:.1f}) "
                f"| {100 * min(rates):.1f} % |"
            )
    return "\n".join(lines)


def multi_cluster_gassl() -> str:
    """P2 with MC-GASSL: J_m by follow strategy, R and redundancy over all, the paper's words and `destroy-all`."""
    lines = [f"| P2, M=5, N=82: J_m | heads | n | {' | '.join(FOLLOW)} | R | redundancy |", "| --- |" + " --- |" * 11]
    lines.append("| the paper, in words | iid | | " + "3.06–4.06 | " * len(FOLLOW) + "3–4 | 6.1 % |")
    for path in sorted((RESULTS / "rounds").glob("rounds*.csv"), key=lambda path: (len(path.name), path.name)):
        rows = [row for row in read_any(path, Game) if (row.clusters, row.uavs) == (5, 82)]
        for detector in ("mc-gassl", "mc-gassl(preset='paper')", "lagged-regression", "destroy-all"):
            own = [row for row in rows if row.detector == detector]
            if {row.follow for row in own} != set(FOLLOW):
                continue
            counts = {sum(row.follow == follow for row in own) for follow in FOLLOW}
            heads = own[0].mobility + (" with jitter" if own[0].head_jitter else "")
            costs = []
            for follow in FOLLOW:
                mean, low, high = mean_interval([row.J for row in own if row.follow == follow])
                costs.append(f"{mean:.2f}" if low == high else f"{mean:.2f} ({low:.2f}–{high:.2f})")
            beside = [sum(getattr(row, name) for row in own) / len(own) for name in ("rounds", "redundancy")]
            n = "–".join(map(str, sorted({min(counts), max(counts)})))
            lines.append(
                f"| `{detector}` | {heads} | {n} | {' | '.join(costs)} | {beside[0]:.2f} | {100 * beside[1]:.1f} % |"
            )
    return "\n".join(lines)


#: Tier, variants (all of it where there are none), strategies and words of every line of :func:`mixture`.
_TIERS = (
    ("paper", (), "f1-f7", "iid heads, M=5, N=82"),
    ("sizes", (), "f1-f7", "M = 2 to 20, N = 20 to 237"),
    ("smooth", (), "f1-f7", "smooth heads with jitter"),
    ("straight", ("jitter",), "f1-f7", "straight heads with jitter"),
    ("straight", ("bare",), "f1-f7", "straight heads without"),
    ("short", ("T20",), "f1-f6", "20 steps"),
    ("missed", ("0.3",), "f1-f7", "30 % of the samples missed"),
    ("noise", ("0.3",), "f1-f7", "positions with 0.3 m of noise"),
    ("noise", ("gauss_markov-0.3",), "f1-f3", "the same, smooth heads"),
    ("noise", ("gauss_markov-0.3",), "f4-f7", "the same, smooth heads"),
    ("decoys", (), "f1-f7", "1, 3 or 10 decoys"),
    ("unlisted", (), "14 others", "strategies of no list, iid and smooth heads"),
    ("silence", (), "nobody follows", "six mobilities, with jitter and without"),
)
_BESIDE = ("lagged-regression", "destroy-all")


def mixture() -> str:
    """follow-mixture over its tiers: how often round 1 is exact (or rightly silent), and J_m beside others."""
    lines = [f"| `follow-mixture` | strategies | episodes | exact | J_m | {' | '.join(f'`{n}`' for n in _BESIDE)} |"]
    lines.append("| --- |" + " --- |" * (4 + len(_BESIDE)))
    for tier, variants, strategies, words in _TIERS:
        kind = "silence" if tier == "silence" else "P2"
        rows = []
        for row in tier_rows(RESULTS / "follow_mixture" / f"{tier}.csv"):
            follow, _, variant = row["cell"].partition("-")
            wanted = not strategies.startswith("f") or strategies[:2] <= follow <= strategies[-2:]
            if int(row["seed"]) == SEED and wanted and (not variants or variant in variants):
                rows.append(row)
        ours = [row for row in rows if row["detector"] == "follow-mixture"]
        beside = []
        for name in _BESIDE:
            costs = [float(row["J"]) for row in rows if row["detector"] == name]
            beside.append(f"{sum(costs) / len(costs):.2f}" if costs and kind == "P2" else "")
        cost = f"{sum(float(row['J']) for row in ours) / len(ours):.3f}" if kind == "P2" else "silent"
        lines.append(
            f"| {words} | {strategies} | {len(ours):,} | {exact_rate(ours, kind)} | {cost} | {' | '.join(beside)} |"
        )
    return "\n".join(lines)


def filled(text: str) -> str:
    """The README with its tables between the markers replaced."""
    tables = (
        ("mixture", mixture()),
        ("table", multi_cluster()),
        ("rates", detection_rates()),
        ("rounds", multi_cluster_gassl()),
    )
    for name, table in tables:
        begin, end = f"<!-- {name}:begin -->\n", f"<!-- {name}:end -->"
        before, rest = text.split(begin)
        text = f"{before}{begin}{table}\n{end}{rest.split(end)[1]}"
    return text


def main() -> int:
    """Write or check."""
    old = README.read_text(encoding="utf-8")
    new = filled(old)
    if "--check" in sys.argv[1:]:
        return int(old != new)
    README.write_text(new, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
