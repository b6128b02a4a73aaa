"""The result of an evaluation: rows, their summary, and a table of the summary."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from usnet_env.config import unknown_name
from usnet_env.evaluation.metrics import CLUSTER_METRICS, METRICS, RATES
from usnet_env.evaluation.statistics import mean_interval, rate_interval
from usnet_env.evaluation.table import RowTable

if TYPE_CHECKING:
    from rich.table import Table

__all__ = ["HEADINGS", "RANKING", "EvaluationResult", "summarise"]

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


#: Columns of the ranked table after J, with the arrow that points to the better values.
RANKING = {
    "rounds": "rounds↓",
    "redundancy": "redundancy↓",
    "exact": "exact↑",
    "f1_first": "F1↑",
    "seconds_per_round": "s↓",
}


def summarise(rows: RowTable) -> Summary:
    """Summarise rows: one entry for each detector, in the order of their first rows.

    An entry is ``{"detector", "episodes", "metrics"}``. Each metric has its mean over all episodes, including those
    truncated at ``max_rounds``, and its 95 % interval. The cluster metrics use only the episodes whose first answer has
    clusters, and are absent if there is no such episode.
    """
    entries = []
    labels = rows.column("detector")
    for label in dict.fromkeys(labels):
        own = labels == label
        metrics = {}
        for name in METRICS:
            values = rows.column(name)[own].astype(np.float64)
            if name in CLUSTER_METRICS:
                values = values[~np.isnan(values)]
                if not len(values):
                    continue
            interval = rate_interval(values) if name in RATES else mean_interval(values)
            metrics[name] = interval._asdict()
        entries.append({"detector": label, "episodes": int(own.sum()), "metrics": metrics})
    return entries


def _format_number(value: float) -> str:
    """Format with three decimals, or with two significant digits below 0.001."""
    return f"{value:.3f}" if value == 0 or abs(value) >= 0.001 else f"{value:.2g}"


def _format_objective(value: float) -> str:
    """Format with three decimals, or with two from 10 on."""
    return f"{value:.3f}" if abs(value) < 10 else f"{value:.2f}"


def _format_short(name: str, value: float) -> str:
    if name == "seconds_per_round" and 0 < value < 0.01:
        return "<0.01"
    return f"{value:.1f}" if name == "rounds" or value >= 100 else f"{value:.2f}"


def _join(names: Sequence[str]) -> str:
    """``a``, ``a and b``, or ``a, b and c``."""
    return " and ".join(filter(None, [", ".join(names[:-1]), names[-1]]))


@dataclass(frozen=True)
class EvaluationResult:
    """The result of :func:`usnet_env.evaluate`.

    Args:
        rows: one mapping for each detector and episode, sorted by detector, then by episode: a sequence that stores
            one array for each column.
        summary: one entry for each detector, ``{"detector", "episodes", "metrics": {name: {"mean", "low", "high"}}}``.
        config: the arguments of the evaluation, as plain values.
    """

    rows: Sequence[Mapping[str, Any]]
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

    def _ranked(self) -> list[dict[str, Any]]:
        """The entries of the summary, best mean of J first, then the highest F1; equal ones in the order given."""

        def place(entry: dict[str, Any]) -> tuple[float, float]:
            metrics = entry["metrics"]
            return self._sign * metrics["J"]["mean"], -metrics["f1_first"]["mean"]

        return sorted(self.summary, key=place)

    @property
    def _sign(self) -> int:
        """1 for J_m, which is at least 1 and is to be low; -1 for J_s, which is at most 0 and is to be high."""
        return 1 if self.summary[0]["metrics"]["J"]["mean"] > 0 else -1

    @property
    def _objective(self) -> str:
        return "J_m" if self._sign == 1 else "J_s"

    def ranking(self) -> Table:
        """Create a table for a terminal of 80 columns: the detectors by their J, best first, and their main metrics.

        An arrow after a heading points to the better values. :meth:`table` has all metrics.
        """
        from rich.box import SIMPLE_HEAD
        from rich.table import Table
        from rich.text import Text

        episodes = sorted({entry["episodes"] for entry in self.summary})
        played = f"{episodes[0]}" if len(episodes) == 1 else f"{episodes[0]} to {episodes[-1]}"
        plural = "" if episodes == [1] else "s"
        title = f"{self.config['env']}, {played} episode{plural} of each detector: means, best first"
        table = Table(title=title, box=SIMPLE_HEAD, title_justify="left", show_edge=False, padding=(0, 1, 0, 0))
        table.add_column("detector", overflow="fold")
        arrow = "↓" if self._sign == 1 else "↑"
        for heading in (f"{self._objective}{arrow} (95 % int.)", *RANKING.values()):
            table.add_column(heading, justify="right", no_wrap=True)
        for entry in self._ranked():
            metrics = entry["metrics"]
            mean, low, high = (_format_objective(metrics["J"][name]) for name in ("mean", "low", "high"))
            cells = [f"{mean} (all equal)" if metrics["J"]["low"] == metrics["J"]["high"] else f"{mean} ({low}–{high})"]
            cells += [_format_short(name, metrics[name]["mean"]) for name in RANKING]
            table.add_row(Text(entry["detector"]), *cells)  # Text is not parsed as Rich markup
        return table

    def conclusion(self) -> str:
        """State in one sentence which detector has the best J, and which others these episodes do not separate from it.

        Others are not separated from it if their 95 % interval of J overlaps its interval.
        """
        first, *others = self._ranked()
        best = first["metrics"]["J"]
        mean, low, high = (_format_objective(best[name]) for name in ("mean", "low", "high"))
        if best["low"] == best["high"]:
            value = f"{mean} in {'every' if first['episodes'] > 1 else 'its only'} episode"
        else:
            value = f"{mean} (95 % interval {low}–{high})"
        if not others:
            return f"{first['detector']} has a {self._objective} of {value}."
        equal = [e["detector"] for e in others if e["metrics"]["J"] == best]
        near = [
            e["detector"]
            for e in others
            if e["metrics"]["J"] != best
            and e["metrics"]["J"]["low"] <= best["high"]
            and best["low"] <= e["metrics"]["J"]["high"]
        ]
        names = _join([first["detector"], *equal])
        extreme = "lowest" if self._sign == 1 else "highest"
        sentence = f"{names} {'have' if equal else 'has'} the {extreme} {self._objective}: {value}"
        if near:
            intervals = "interval of" if len(near) == 1 else "intervals of"
            return f"{sentence}, which overlaps with the {intervals} {_join(near)}."
        return f"{sentence}."
