"""What an evaluation gives back: rows, their summary, and a table of it."""

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

#: Short headings of the metrics in tables.
HEADINGS = {
    "J": "J",
    "rounds": "rounds",
    "redundancy": "redundancy",
    "success": "success",
    "exact": "exact",
    "precision_first": "precision 1",
    "recall_first": "recall 1",
    "f1_first": "F1 1",
    "ap_first": "AP 1",
    "seconds_per_round": "s / round",
    "purity_first": "purity 1",
    "head_in_cluster_first": "head in cl. 1",
}


def summarise(rows: Sequence[Row]) -> Summary:
    """One entry a detector, in the order of their first rows: ``{"detector", "episodes", "metrics"}``.

    Every metric has its mean over all episodes, those cut off at ``max_rounds`` included, and its 95 % interval. The
    cluster metrics are over the episodes whose first answer held clusters, and absent if none did.
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


def _number(value: float) -> str:
    """Three decimals, or three digits where that would be 0."""
    return f"{value:.3f}" if value == 0 or abs(value) >= 0.001 else f"{value:.2g}"


@dataclass(frozen=True)
class EvaluationResult:
    """The outcome of :func:`usnet_env.evaluate`.

    Args:
        rows: one mapping for each detector and episode, sorted by detector, then episode.
        summary: one entry a detector, ``{"detector", "episodes", "metrics": {name: {"mean", "low", "high"}}}``.
        config: what was evaluated, as plain values.
    """

    rows: list[Row]
    summary: Summary
    config: Mapping[str, Any]

    def __getitem__(self, detector: str) -> dict[str, Any]:
        """The metrics of one detector by its label.

        Raises:
            ArgumentError: no row has that label.
        """
        for entry in self.summary:
            if entry["detector"] == detector:
                metrics: dict[str, Any] = entry["metrics"]
                return metrics
        raise unknown_name("detector", detector, [entry["detector"] for entry in self.summary])

    def table(self, metrics: Sequence[str] | None = None) -> Table:
        """A table for a terminal, with a row a detector.

        Args:
            metrics: the columns; by default all that some detector has.
        """
        from rich.box import SIMPLE_HEAD
        from rich.table import Table
        from rich.text import Text

        wanted = list(METRICS) if metrics is None else list(metrics)
        columns = [name for name in wanted if any(name in entry["metrics"] for entry in self.summary)]
        title = f"{self.config['env']}, mean and 95 % interval"
        table = Table(title=title, box=SIMPLE_HEAD, leading=1, title_justify="left")
        table.add_column("detector", overflow="fold")
        table.add_column("n", justify="right")
        for name in columns:
            table.add_column(HEADINGS[name], justify="right", no_wrap=True)
        for entry in self.summary:
            cells = [entry["metrics"].get(name) for name in columns]
            table.add_row(
                Text(entry["detector"]),  # brackets in a label are no markup
                str(entry["episodes"]),
                *(
                    f"{_number(cell['mean'])}\n{_number(cell['low'])}–{_number(cell['high'])}" if cell else "–"
                    for cell in cells
                ),
            )
        return table
