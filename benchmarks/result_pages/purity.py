"""Purity and head-in-cluster of the clusterers, and the losses of metric learning."""

from __future__ import annotations

from running import RESULTS

from detectors.studies import metric_learning
from detectors.studies.purity import Row, report_methods
from result_pages.text import demoted, page
from usnet_env.evaluation.suite import read_rows


def text() -> str:
    """The page."""
    parts, made = [], []
    for path in sorted((RESULTS / "purity").glob("purity*.csv")):
        rows = read_rows(path, Row)
        picture = f"../../benchmarks/results/purity/{path.with_suffix('.png').name}"
        parts += [demoted(report_methods(rows, ""), 0), f"![Purity]({picture})"]
        made.append(f"purity/{path.name}")
    losses = []
    for path in sorted((RESULTS / "metric_learning").glob("losses*.csv")):
        rows = read_rows(path, metric_learning.Row)
        picture = f"../../benchmarks/results/metric_learning/{path.with_suffix('.png').name}"
        losses += [metric_learning.report_losses(rows).strip(), f"![Losses]({picture})"]
        made.append(f"metric_learning/{path.name}")
    spaces = []
    for path in sorted((RESULTS / "metric_learning").glob("features*.png")):
        spaces.append(f"![Feature space, {path.stem}](../../benchmarks/results/metric_learning/{path.name})")
        made.append(f"metric_learning/{path.name}")
    return page(
        "Purity and metric learning",
        *parts,
        "## Metric learning",
        "Losses of the triplet network, off line and on line, from three starts; ± is a 95 % interval (Student's t) "
        "over trainings.",
        *losses,
        *spaces,
        files=made,
    )
