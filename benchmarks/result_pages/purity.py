"""Purity and head-in-cluster of the clusterers, and the losses of metric learning."""

from __future__ import annotations

from running import RESULTS

from detectors.studies import metric_learning
from detectors.studies.purity import Row, report_methods
from result_pages.text import demoted, page, picture
from usnet_env.evaluation.suite import read_rows


def text() -> str:
    """The page."""
    parts, made = [], []
    for path in sorted((RESULTS / "purity").glob("purity*.csv")):
        rows = read_rows(path, Row)
        parts += [demoted(report_methods(rows, ""), 0), picture("Purity", f"purity/{path.stem}.png")]
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
