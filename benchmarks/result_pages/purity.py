"""Purity and head-in-cluster of the clusterers, and the losses of metric learning."""

from __future__ import annotations

from collections.abc import Sequence

from detectors.studies import metric_learning
from detectors.studies.purity import Row, report_methods
from running import RESULTS
from usnet_env.evaluation.report import mean_over_episodes
from usnet_env.evaluation.suite import read_rows

from result_pages.text import demoted, number, page, picture, table


def trivial(rows: Sequence[Row]) -> str:
    """The two trivial clusterings, computed: where a clusterer found one cluster, its purity is that of one cluster."""
    single = {(row.follow, row.episode): row.purity for row in rows if row.found == 1}
    windows = {(row.follow, row.episode) for row in rows}
    if single.keys() != windows:
        raise ValueError("Purity of one cluster: in each window, one clusterer must find one cluster.")
    means = [{"episode": episode, "purity": value} for (_, episode), value in single.items()]
    lines = [
        ("each UAV is its own cluster", "1.00", "0.00"),
        ("all UAVs are one cluster", number(mean_over_episodes(means, "purity")), "1.00"),
    ]
    return table((f"trivial clustering, computed, n = {len(windows)}", "purity", "head-in-cluster"), lines)


def text() -> str:
    parts, made = [], []
    for path in sorted((RESULTS / "purity").glob("purity*.csv")):
        rows = read_rows(path, Row)
        about, heading, tables = demoted(report_methods(rows, ""), 0).partition("\n## ")
        parts += [about.strip(), trivial(rows), (heading + tables).strip()]
        parts.append(picture("Purity", f"purity/{path.stem}.png"))
        made.append(f"purity/{path.name}")
    losses = []
    for path in sorted((RESULTS / "metric_learning").glob("losses*.csv")):
        rows = read_rows(path, metric_learning.Row)
        report = metric_learning.report_losses(rows).strip()
        losses += [report, picture("Losses", f"metric_learning/{path.stem}.png")]
        made.append(f"metric_learning/{path.name}")
    return page(
        "Purity and metric learning",
        *parts,
        "## Metric learning",
        "Losses of the triplet network, off line and on line, from three starts; ± is a 95 % interval (Student's t) "
        "over trainings.",
        *losses,
        files=made,
    )
