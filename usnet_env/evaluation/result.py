"""The result of an evaluation: rows, their summary, and a table of the summary."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from usnet_env.config import unknown_name
from usnet_env.evaluation.episode import Row
from usnet_env.evaluation.metrics import CLUSTER_METRICS, METRICS, RATES
from usnet_env.evaluation.statistics import mean_interval, rate_interval

if TYPE_CHECKING:
    from rich.table import Table

__all__ = ["HEADINGS", "EvaluationResult", "summarise"]

Summary = list[dict[str, Any]]

#: Headings of the metrics in tables.
HEADINGS = {
    "J": "J",
    "rounds": "rounds",
    "redundancy": "redundancy",
    "success": "success",
    "exact": "exact",
    "precision_first": "precision\nin round 1",
    "recall_first": "recall\nin round 1",
    "f1_first": "F1\nin round 1",
    "ap_first": "AP\nin round 1",
    "seconds_per_round": "seconds\nper round",
    "purity_first": "purity\nin round 1",
    "head_in_cluster_first": "head in cluster\nin round 1",
}


def summarise(rows: Sequence[Row]) -> Summary:
    """Summarise rows: one entry for each detector, in the order of their first rows.

    An entry is ``{"detector", "episodes", "metrics"}``. Each metric has its mean over all episodes, including those
    truncated at ``max_rounds``, and its 95 % interval. The cluster metrics use only the episodes whose first answer has
    clusters, and are absent if there is no such episode.
    """
    entries = []
    for label in dict.fromkeys(row["detector"] for row in rows):
        own = [row for row in rows if row["detector"] == label]
        metrics = {}
        for name in METRICS:
            values = [row[name] for row in own if row[name] is not None]
            if name in CLUSTER_METRICS and not values:
                continue
            interval = rate_interval(values) if name in RATES else mean_interval(values)
            metrics[name] = interval._asdict()
        entries.append({"detector": label, "episodes": len(own), "metrics": metrics})
    return entries


def _format_number(value: float) -> str:
    """Format with three decimals, or with two significant digits below 0.001."""
    return f"{value:.3f}" if value == 0 or abs(value) >= 0.001 else f"{value:.2g}"


@dataclass(frozen=True)
class EvaluationResult:
    """The result of :func:`usnet_env.evaluate`.

    Args:
        rows: one mapping for each detector and episode, sorted by detector, then by episode.
        summary: one entry for each detector, ``{"detector", "episodes", "metrics": {name: {"mean", "low", "high"}}}``.
        config: the arguments of the evaluation, as plain values.
    """

    rows: list[Row]
    summary: Summary
    config: Mapping[str, Any]

    def __getitem__(self, detector: str) -> dict[str, Any]:
        """Return the metrics of the detector with this label.

        Raises:
            ArgumentError: no row has that label.
        """
        for entry in self.summary:
            if entry["detector"] == detector:
                metrics: dict[str, Any] = entry["metrics"]
                return metrics
        raise unknown_name("detector", detector, [entry["detector"] for entry in self.summary])

    def table(self, metrics: Sequence[str] | None = None) -> Table:
        """Create a table for a terminal, with one row for each detector.

        Args:
            metrics: names of the columns; by default all metrics that at least one detector has.
        """
        from rich.box import SIMPLE_HEAD
        from rich.table import Table
        from rich.text import Text

        wanted = list(METRICS) if metrics is None else list(metrics)
        columns = [name for name in wanted if any(name in entry["metrics"] for entry in self.summary)]
        title = f"{self.config['env']}: mean and 95 % interval"
        table = Table(title=title, box=SIMPLE_HEAD, leading=1, title_justify="left")
        table.add_column("detector", overflow="fold")
        table.add_column("episodes", justify="right")
        for name in columns:
            table.add_column(HEADINGS[name], justify="right", no_wrap=True)
        for entry in self.summary:
            cells = [entry["metrics"].get(name) for name in columns]
            table.add_row(
                Text(entry["detector"]),  # not parsed as Rich markup, in which brackets have a meaning
                str(entry["episodes"]),
                *(
                    f"{_format_number(cell['mean'])}\n{_format_number(cell['low'])}–{_format_number(cell['high'])}"
                    if cell
                    else "–"
                    for cell in cells
                ),
            )
        return table
