"""The result of an evaluation: one table of rows, and what can be read off it."""

from __future__ import annotations

import warnings
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from os import PathLike
from typing import TYPE_CHECKING, Any

import numpy as np

from usnet_env.config import ArgumentError, format_count, instance_of, printable, quote, unknown_name
from usnet_env.evaluation import stats, tables
from usnet_env.evaluation.folder import column_types, read_run
from usnet_env.evaluation.play import KEYS, RATES
from usnet_env.evaluation.stats import CONFIDENCE, Interval, mean_interval
from usnet_env.evaluation.tasks import LONGEST_REASON
from usnet_env.files import as_path

if TYPE_CHECKING:
    import pandas as pd
    from rich.table import Table


@dataclass(frozen=True)
class Comparison:
    """The paired difference of two detectors, which have played against the same swarms.

    Args:
        a, b: labels of the two detectors.
        metric: what is compared.
        episodes: number of episodes that both have played.
        difference: the mean over them of a's value minus b's value.
        low, high: its bootstrap interval of the level 1 - 0.05 / k (Bonferroni); one episode has none.
        p: the p-value of the paired randomisation test, adjusted for k comparisons (Holm, 1979).
        comparisons: number of pairs that were asked for together, k.
    """

    a: str
    b: str
    metric: str
    episodes: int
    difference: float
    low: float
    high: float
    p: float
    comparisons: int = 1

    def __str__(self) -> str:
        correction = "" if self.comparisons == 1 else f", corrected for {self.comparisons} comparisons"
        p = "p < 0.001" if self.p < 0.001 else f"p = {self.p:.2g}"
        interval = "" if self.low == self.high else f"95 % interval {self.low:+.4g} to {self.high:+.4g}, "
        difference = f"{self.metric} of {self.a} minus {self.b}: {self.difference:+.4g}"
        return f"{difference} ({interval}{p}{correction}) over {format_count(self.episodes, 'episode')}"


class EvaluationResult:
    """The result of :func:`usnet_env.evaluate`, of a suite, or of games.

    Args:
        rows: one row for each cell, detector and episode: the columns ``cell, detector, episode, swarm_seed,
            detector_seed, uavs, heads``, the metrics, and ``error``: why the detector failed, or an empty text. A row
            with an error has no metrics. They are sorted by cell, detector and episode.
        config: the arguments of the evaluation as plain values, with ``cells``, ``detectors``, ``episodes``, ``seed``,
            and the ``unit`` of intervals, by default ``"swarm"``; with ``"cell"``, the rows of a cell are one group.

    Example:
        >>> from usnet_env import evaluate
        >>> result = evaluate("USNET/SingleCluster-Tiny-v0", ["none", "destroy-all"], episodes=2)
        >>> [(entry["detector"], entry["metrics"]["exact"]["mean"]) for entry in result.summary]
        [('none', 0.0), ('destroy-all', 0.0)]
    """

    def __init__(self, rows: pd.DataFrame, config: Mapping[str, Any]) -> None:
        import pandas as pd  # processes that only play do without it: it takes a third of a second

        self.config = dict(config)
        self.cells = list(dict.fromkeys([*self.config.get("cells", {}), *rows["cell"].unique()]))
        self.detectors = list(dict.fromkeys([*self.config.get("detectors", []), *rows["detector"].unique()]))
        orders = {"detector": self.detectors, "cell": self.cells}
        ranks = [pd.Index(order).get_indexer(rows[name]) for name, order in orders.items()]
        order = np.lexsort([rows["episode"].to_numpy(np.int64), *ranks])
        self.rows = rows.astype(column_types(rows.columns)).iloc[order].reset_index(drop=True)

    @classmethod
    def load(cls, folder: str | PathLike[str]) -> EvaluationResult:
        """Read the folder of a run, finished or not; what is no such folder is an :class:`ArgumentError`."""
        run, rows = read_run(as_path("folder", folder))
        return cls(rows, run["arguments"])

    @cached_property
    def summary(self) -> list[dict[str, Any]]:
        """One entry for each detector, with the keys ``detector``, ``episodes``, ``failed`` and ``metrics``.

        ``metrics`` has ``{"mean", "low", "high"}`` by the name of each metric: its mean over all episodes of all cells
        that have it, and its 95 % interval; episodes of several cells with the same seed of the swarm are one group,
        and all episodes of a cell that was drawn at random.
        """
        return self._summarise(self.metrics)

    @cached_property
    def _ranked(self) -> list[dict[str, Any]]:
        """The summary with the intervals that a ranking shows, and no others: resampling takes long."""
        return self._summarise(tables.RANKED)

    def _summarise(self, with_interval: Collection[str]) -> list[dict[str, Any]]:
        """The summary; the other metrics have their mean in place of the ends of the interval."""
        entries = []
        for label, rows in self._by_detector():
            intervals = {name: _make_interval(rows, name, self._unit, name in with_interval) for name in self.metrics}
            metrics = {name: interval._asdict() for name, interval in intervals.items() if interval is not None}
            failed = int((rows["error"] != "").sum())
            entries.append({"detector": label, "episodes": len(rows) - failed, "failed": failed, "metrics": metrics})
        return entries

    @property
    def _unit(self) -> str:
        """The column that names the group of a row, if intervals are those of several cells."""
        return "cell" if self.config.get("unit") == "cell" else "swarm_seed"

    def _by_detector(self) -> list[tuple[str, pd.DataFrame]]:
        """The label and the rows of each detector that has some."""
        groups = dict(list(self.rows.groupby("detector", sort=False)))
        return [(label, groups[label]) for label in self.detectors if label in groups]

    @property
    def metrics(self) -> list[str]:
        """The names of the columns that hold metrics."""
        return [name for name in self.rows.columns if name not in (*KEYS, "error")]

    @cached_property
    def failures(self) -> dict[str, str]:
        """For each detector that failed in an episode, one sentence that says how often, and why first."""
        sentences = {}
        for label, rows in self._by_detector():
            failed = rows[rows["error"] != ""]
            for cell, episode, error in failed[["cell", "episode", "error"]].head(1).itertuples(index=False):
                text = f"detector {label!r} failed in {len(failed)} of {len(rows)} episodes, first in {cell}, "
                text = printable(f"{text}episode {episode}, {error}")
                sentences[label] = f"{text if len(text) < LONGEST_REASON else text[:LONGEST_REASON] + '…'}."
        return sentences

    def __repr__(self) -> str:
        return f"<EvaluationResult of {self._title}>"

    def __str__(self) -> str:
        return self.to_markdown()

    @property
    def _title(self) -> str:
        """What was played, such as ``paper (version 1), 4 cells, 5 to 20 of 40 episodes of each detector``."""
        suite = self.config.get("suite")
        name = f"{suite}, {format_count(len(self.cells), 'cell')}" if suite else ", ".join(self.cells)
        counts = sorted(set((self.rows["error"] == "").groupby(self.rows["detector"]).sum())) or [0]
        planned = max(self.config.get("episodes", 0) * len(self.cells), counts[-1])
        numbers = " to ".join(str(number) for number in dict.fromkeys((counts[0], counts[-1])))
        total = f" of {planned}" if planned > counts[-1] else ""
        return f"{name}, {numbers}{total} episode{'s' * (planned != 1)} of each detector"

    def __getitem__(self, detector: str) -> dict[str, Any]:
        """Return the metrics of the detector with this label; empty if it failed in all episodes."""
        self._check_label(detector)
        return {entry["detector"]: entry["metrics"] for entry in self.summary}[detector]

    def __iter__(self) -> Iterator[str]:
        """The labels of the detectors."""
        return (label for label, _ in self._by_detector())

    def table(self, metrics: Sequence[str] | str | None = None) -> Table:
        """Create a table for a terminal: a column for each detector, a line for each metric, or cell for one name."""
        header, lines = self._grid(metrics, "{}\n{}–{}")
        if not isinstance(metrics, str):
            header, *lines = (list(column) for column in zip(header, *lines, strict=True))
        return tables.make_table(f"{self._title}: mean and 95 % interval", header, lines)

    def ranking(self) -> Table:
        """Create a table for a terminal of 80 columns: the detectors by J (in recorded tracks F1), best first."""
        return tables.make_table(f"{self._title}: means, best first", *tables.list_ranking(self._ranked))

    def to_markdown(self, metrics: Sequence[str] | str | None = None) -> str:
        """The means and 95 % intervals as a table in Markdown.

        Args:
            metrics: a list of metrics, or ``None`` for all: the table has a line for each detector and a column for
                each metric. A single name: it has a line for each cell and a column for each detector.
        """
        return tables.format_markdown(*self._grid(metrics))

    def _repr_html_(self) -> str:
        import pandas as pd

        header, lines = tables.list_ranking(self._ranked)
        return str(pd.DataFrame(lines, columns=header).to_html(index=False))

    def _grid(
        self, metrics: Sequence[str] | str | None, pattern: str = "{} ({} to {})"
    ) -> tuple[list[str], list[list[str]]]:
        """The heading and the lines of a table, as of :meth:`to_markdown`."""
        for name in [metrics] if isinstance(metrics, str) else metrics or ():
            self._check_metric(name, "metrics")
        if not isinstance(metrics, str):
            available = [name for name in self.metrics if any(name in entry["metrics"] for entry in self.summary)]
            chosen = available if metrics is None else [name for name in metrics if name in available]
            return tables.list_lines(self.summary, chosen, pattern)
        parts = [(cell, self.rows[self.rows["cell"] == cell], "swarm_seed") for cell in self.cells]
        lines = []
        for cell, rows, unit in [*parts, ("all cells", self.rows, self._unit)]:
            intervals = [_make_interval(rows[rows["detector"] == label], metrics, unit) for label in self]
            lines.append([cell, *(tables.format_interval(interval and interval._asdict()) for interval in intervals)])
        return [tables.heading(self._ranked, metrics), *map(printable, self)], lines

    def compare(self, a: str, b: str | Sequence[str] | None = None, metric: str = "J") -> Any:
        """Compare a detector with another one (a :class:`Comparison`) or several (a list of them), episode by episode.

        Cells whose swarms have the same seed depend on each other: their differences are one group, which is resampled,
        and changes its sign, as a whole; so are those of a cell that was drawn at random. With k others, the intervals
        have the level 1 - 0.05 / k and the p-values are adjusted by Holm's method, so that the chance of any false
        difference among them is at most 5 %.

        Args:
            a: label of a detector.
            b: label of another one, a list of labels, or ``None`` for all others that share an episode.
            metric: what is compared.

        Raises:
            ArgumentError: there is no such detector or metric, or two detectors share no episode.

        >>> from usnet_env import evaluate
        >>> result = evaluate("USNET/SingleCluster-v0", ["none", "destroy-all"], episodes=3)
        >>> result.compare("none", "destroy-all").difference
        14.0
        """
        self._check_metric(metric)
        labels = [b] if isinstance(b, str) else b
        opponents = [label for label in self if label != a] if labels is None else labels
        for label in (a, *opponents):
            self._check_label(label)
        values = self.rows.pivot(index=["cell", "swarm_seed"], columns="detector", values=metric)
        pairs = {opponent: (values[a] - values[opponent]).dropna() for opponent in opponents}
        for opponent in [opponent for opponent, pair in pairs.items() if pair.empty]:
            if labels is not None or all(pair.empty for pair in pairs.values()):
                raise ArgumentError(f"b must have episodes with {metric} in common with {a!r}, got {quote(opponent)}.")
            warnings.warn(f"{opponent} is left out: it has no episode with {metric} in common with {a}.", stacklevel=2)
            del pairs[opponent]
        adjusted = stats.holm([stats.paired_test(pair.groupby(self._unit).sum()) for pair in pairs.values()])
        level = 1 - (1 - CONFIDENCE) / max(1, len(pairs))
        comparisons = []
        for (opponent, pair), p in zip(pairs.items(), adjusted, strict=True):
            interval = mean_interval(pair, confidence=level, groups=pair.index.get_level_values(self._unit))
            comparisons.append(Comparison(a, opponent, metric, len(pair), *interval, p, len(pairs)))
        return comparisons[0] if isinstance(b, str) else comparisons

    def merge(self, other: EvaluationResult) -> EvaluationResult:
        """Join the result of other detectors, with the same suite, cells, seed and swarms, by the columns of both."""
        instance_of("other", other, EvaluationResult)
        shared = [label for label in self.detectors if label in other.detectors]
        differing = [name for name in ("suite", "cells", "seed") if self.config.get(name) != other.config.get(name)]
        import pandas as pd

        rows = pd.concat([self.rows, other.rows], join="inner")
        if (rows.groupby(["cell", "episode"]).swarm_seed.nunique() > 1).any():
            differing.append("swarm in the same episode")
        if shared or differing:
            got = f"{quote(shared[0])} in both" if shared else f"another {differing[0]}"
            raise ArgumentError(f"other must have other labels, and the same suite, cells, seed and swarms, got {got}.")
        episodes = max(result.config.get("episodes", 0) for result in (self, other))
        config = {"detectors": [*self.detectors, *other.detectors], "episodes": episodes}
        return EvaluationResult(rows, self.config | config)

    def _check_metric(self, metric: str, argument: str = "metric") -> None:
        if metric not in self.metrics:
            raise unknown_name(argument, metric, self.metrics)

    def _check_label(self, label: str) -> None:
        if label not in list(self):
            raise unknown_name("detector", label, self)


def _make_interval(rows: pd.DataFrame, metric: str, unit: str, with_interval: bool = True) -> Interval | None:
    """The mean of a metric with its interval, or the mean three times; ``None`` if no row has a value.

    Rows with the same value of the column ``unit`` are one group.
    """
    values = rows[[unit, metric]].dropna()
    if values.empty:
        return None
    if not with_interval:
        return Interval(*[float(values[metric].to_numpy().mean())] * 3)
    interval = stats.rate_interval if metric in RATES else mean_interval
    return interval(values[metric].to_numpy(), groups=values[unit].to_numpy())
