"""The result of an evaluation: rows, their summary, and what can be read off them."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from os import PathLike
from typing import TYPE_CHECKING, Any, overload

import numpy as np
from numpy.typing import NDArray

from usnet_env.config import ArgumentError, format_count, quote, unknown_name
from usnet_env.evaluation import statistics, tables
from usnet_env.evaluation.errors import UnknownLabelError
from usnet_env.evaluation.identity import differing_keys
from usnet_env.evaluation.metrics import LOWER_IS_BETTER, OPTIONAL_METRICS, RATES
from usnet_env.evaluation.statistics import CONFIDENCE, Interval, Profile, mean_interval
from usnet_env.evaluation.store import JOINING, KEYS, last_secret, load_run, order_rows
from usnet_env.evaluation.table import RowTable
from usnet_env.files import as_path

if TYPE_CHECKING:
    from pandas import DataFrame
    from rich.table import Table

Summary = list[dict[str, Any]]

_THRESHOLDS = 101  # of a profile by default


def summarise(rows: RowTable) -> Summary:
    """Summarise rows: one entry for each detector, in the order of their first rows.

    An entry is ``{"detector", "episodes", "metrics"}``. Each metric has its mean over all episodes, including those
    truncated at ``max_rounds``, and its 95 % interval; episodes of several cells with the same seed of the swarm are
    one group. A metric that an episode may lack uses only the episodes that have it, and is absent if there is none:
    those of clusters need an answer with clusters, and those of tracks a window with a group.
    """
    entries = []
    labels = rows.column("detector")
    for label in dict.fromkeys(labels):
        own = labels == label
        swarms, metrics = rows.column("swarm_seed")[own], {}
        for name in rows.columns:
            if name in KEYS:
                continue
            values, groups = rows.column(name)[own].astype(np.float64), swarms
            if rows.columns[name] == "float | None":
                values, groups = values[~np.isnan(values)], swarms[~np.isnan(values)]
                if not len(values):
                    continue
            interval = (statistics.rate_interval if name in RATES else mean_interval)(values, groups=groups)
            metrics[name] = interval._asdict()
        entries.append({"detector": label, "episodes": int(own.sum()), "metrics": metrics})
    return entries


@dataclass(frozen=True)
class Comparison:
    """The paired difference of two detectors, which have played against the same swarms.

    Args:
        a, b: labels of the two detectors.
        metric: what is compared.
        episodes: number of episodes that both have played, n.
        difference: the mean over them of a's value minus b's value.
        low, high: its simultaneous 95 % interval: a bootstrap interval of the level 1 - 0.05 / k (Bonferroni); of one
            episode, which has no interval, both are the difference.
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
        among = "" if self.comparisons == 1 else f", corrected for {self.comparisons} comparisons"
        value, low, high = (f"{number:+.4g}" for number in (self.difference, self.low, self.high))
        p = "p < 0.001" if self.p < 0.001 else f"p = {self.p:.2g}"
        interval = "" if self.low == self.high else f"95 % interval {low} to {high}, "
        return (
            f"{self.metric} of {self.a} minus {self.b}: {value} ({interval}{p}{among}) "
            f"over {format_count(self.episodes, 'episode')}"
        )


class Results(ABC):
    """What one result, or the results of several cells, tell of their detectors."""

    @abstractmethod
    def list_results(self) -> list[EvaluationResult]:
        """The result of each cell."""

    @overload
    def compare(self, a: str, b: str, metric: str = "J") -> Comparison: ...
    @overload
    def compare(self, a: str, b: list[str] | tuple[str, ...] | None = None, metric: str = "J") -> list[Comparison]: ...
    def compare(
        self, a: str, b: str | list[str] | tuple[str, ...] | None = None, metric: str = "J"
    ) -> Comparison | list[Comparison]:
        """Compare a detector with another one, or with several, episode by episode: all played against the same swarms.

        Of several cells, episodes are paired cell by cell. Cells whose swarms have the same seed depend on each other:
        their differences are one group, which is resampled, and changes its sign, as a whole.

        With k others, the intervals have the level 1 - 0.05 / k and the p-values are adjusted by Holm's method, so that
        the chance of any false difference among them is at most 5 %.

        Args:
            a: label of a detector.
            b: label of another one, a list of labels, or ``None`` for all others.
            metric: what is compared; an episode in which one of the two has no value is left out.

        Returns:
            One comparison, or a list of them.

        Raises:
            ArgumentError: there is no such detector or metric, or two detectors share no episode.
        """
        results = self.list_results()
        for result in results:
            result.check_metric(metric)
        labels = list(dict.fromkeys(entry["detector"] for result in results for entry in result.summary))
        if not isinstance(b, str | list | tuple | None):
            raise ArgumentError(f"b must be a label, a list of labels or None, got {quote(b)}.")
        others = [b] if isinstance(b, str) else [label for label in labels if label != a] if b is None else list(b)
        for label in (a, *others):
            if label not in labels:
                raise unknown_name("detector", label, labels)
        pairs = [_pair(results, a, other, metric) for other in others]
        adjusted = statistics.holm([statistics.paired_test(_sum_groups(*pair)) for pair in pairs])
        level, k = 1 - (1 - CONFIDENCE) / max(1, len(others)), len(others)
        found = []
        for other, (differences, swarms), p in zip(others, pairs, adjusted, strict=True):
            interval = mean_interval(differences, confidence=level, groups=swarms)
            found.append(Comparison(a, other, metric, len(differences), *interval, p, k))
        return found[0] if isinstance(b, str) else found

    def interquartile_means(self, metric: str = "J") -> dict[str, Interval]:
        """:func:`interquartile_means` of these results."""
        return interquartile_means(self.list_results(), metric)

    def performance_profiles(self, metric: str = "J", thresholds: Sequence[float] | None = None) -> dict[str, Profile]:
        """:func:`performance_profiles` of these results."""
        return performance_profiles(self.list_results(), metric, thresholds)


@dataclass(frozen=True, repr=False)
class EvaluationResult(Results):
    """The result of :func:`usnet_env.evaluate`.

    Args:
        rows: one mapping for each detector and episode, sorted by detector, then by episode: a sequence that stores
            one array for each column.
        summary: one entry for each detector, ``{"detector", "episodes", "metrics": {name: {"mean", "low", "high"}}}``.
        config: the arguments of the evaluation, as plain values.
    """

    rows: RowTable
    summary: Summary
    config: Mapping[str, Any]

    @classmethod
    def load(cls, folder: str | PathLike[str]) -> EvaluationResult:
        """Read the folder of a run; of a run that is not finished, the rows that there are.

        The rows of detectors that have failed are left out; :attr:`failures` says why.

        Raises:
            ArgumentError: it is no folder of a run, or a file in it is broken.
        """
        description, table = load_run(as_path("folder", folder))
        return make_result(table, description["config"], last_secret(description), description.get("failures", {}))

    @property
    def failures(self) -> dict[str, str]:
        """Why detectors have no rows, by label: they failed in an episode."""
        return dict(self.config.get("failures", {}))

    def __repr__(self) -> str:
        return f"<EvaluationResult of {self._title()}>"

    def _repr_html_(self) -> str:
        """The ranking, which episodes are missing, and the failures, for a notebook."""
        notes = [tables.describe_gap(self.summary, self.config), *self.failures.values()]
        return tables.html_table(self.summary, self._title()) + tables.html_notes(notes)

    def list_results(self) -> list[EvaluationResult]:
        """This result alone."""
        return [self]

    def _title(self) -> str:
        played = tables.describe_episodes(self.summary, self.config.get("episodes"))
        failed = f"; {len(self.failures)} failed" if self.failures else ""
        return f"{self.config['env']}: {format_count(len(self.summary), 'detector')}, {played} each{failed}"

    def __getitem__(self, detector: str) -> dict[str, Any]:
        """Return the metrics of the detector with this label.

        Raises:
            UnknownLabelError: no row has that label; it is an ArgumentError and a KeyError.
        """
        for entry in self.summary:
            if entry["detector"] == detector:
                metrics: dict[str, Any] = entry["metrics"]
                return metrics
        raise UnknownLabelError(str(unknown_name("detector", detector, self)))

    def __iter__(self) -> Iterator[str]:
        """The labels of the detectors."""
        return (entry["detector"] for entry in self.summary)

    def __len__(self) -> int:
        return len(self.summary)

    def table(self, metrics: Sequence[str] | None = None) -> Table:
        """Create a table for a terminal, with one row for each detector.

        If it is too wide for the terminal, it is printed as several with some of the metrics each.

        Args:
            metrics: names of the columns; by default all metrics that at least one detector has.
        """
        return tables.full_table(self.summary, self.config["env"], metrics)

    def ranking(self) -> Table:
        """Create a table for a terminal of 80 columns: the detectors by their J, best first, and their main metrics.

        An arrow after a heading points to the better values; where all values are equal, a mean has no interval.
        :meth:`table` has all metrics.
        """
        return tables.ranking_table(self.summary, self.config["env"], self.config.get("episodes"))

    def conclusion(self) -> str:
        """State in one sentence which detector has the best J, and which others these episodes do not separate from it.

        Others are not separated from it if their 95 % interval of J overlaps its interval. :meth:`compare` is sharper.
        """
        return tables.conclude(self.summary)

    def to_markdown(self, metrics: Sequence[str] | None = None) -> str:
        """The means and 95 % intervals as a table in Markdown; ``metrics`` as of :meth:`table`."""
        return tables.markdown_table(self.summary, metrics)

    def to_latex(self, metrics: Sequence[str] | None = None) -> str:
        """The means and 95 % intervals as a ``tabular`` for LaTeX's booktabs; ``metrics`` as of :meth:`table`."""
        return tables.latex_table(self.summary, metrics)

    def to_frame(self) -> DataFrame:
        """The rows as a data frame of pandas, one row for each detector and episode.

        Raises:
            ArgumentError: pandas is not installed.
        """
        try:
            from pandas import DataFrame
        except ImportError as error:
            raise ArgumentError(
                f"to_frame must find pandas, which cannot be imported ({error}); `pip install pandas` installs it."
            ) from None
        return DataFrame({name: self.rows.column(name) for name in self.rows.columns})

    def merge(self, other: EvaluationResult) -> EvaluationResult:
        """Join the result of other detectors that have met the same swarms, such as one of another folder.

        Args:
            other: a result with the same environment, arguments and seed; its labels must differ from those of this
                one.

        Returns:
            A result with all rows, whose tables and comparisons hold the detectors of both.

        Raises:
            ArgumentError: the two have other arguments, other swarms or a label in common.
        """
        if not isinstance(other, EvaluationResult):
            raise ArgumentError(f"other must be an EvaluationResult, got {quote(other)}.")
        own, theirs = ({entry["detector"] for entry in each.summary} for each in (self, other))
        if shared := sorted(own & theirs):
            raise ArgumentError(f"other must have other labels than this result, got {quote(shared[0])} in both.")
        ours, added = (
            {key: value for key, value in each.config.items() if key not in (*JOINING, "isolate", "secret", "failures")}
            for each in (self, other)
        )
        if different := differing_keys(ours, added):
            raise ArgumentError(
                f"other must have the arguments of this result, got different values of {', '.join(different)}."
            )
        swarms = dict(zip(*(self.rows.column(name).tolist() for name in ("episode", "swarm_seed")), strict=True))
        for row in other.rows:
            if swarms.get(row["episode"], row["swarm_seed"]) != row["swarm_seed"]:
                raise ArgumentError(
                    f"other must have met the same swarms, got another one in episode {row['episode']}."
                )
        rows = RowTable(self.rows.columns, [*self.rows, *other.rows])
        joined = {key: [*self.config.get(key, []), *other.config.get(key, [])] for key in ("detectors", "identities")}
        failures = {label: why for label, why in (other.failures | self.failures).items() if label not in own | theirs}
        episodes = max(each.config.get("episodes", 0) for each in (self, other))
        config = {**self.config, **joined, "episodes": episodes, "failures": failures}
        return EvaluationResult(rows, summarise(rows), config)

    def check_metric(self, metric: str) -> None:
        """Refuse a metric that the rows do not have.

        Raises:
            ArgumentError: there is no such metric.
        """
        names = [name for name in self.rows.columns if name not in KEYS]
        if metric not in names:
            raise unknown_name("metric", metric, names)

    def _values(self, label: str, metric: str) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """The swarms' seeds and the values of a detector's episodes that have one, in their order."""
        values = self.rows.column(metric).astype(np.float64)
        own = (self.rows.column("detector") == label) & ~np.isnan(values)
        return self.rows.column("swarm_seed")[own], values[own]

    def _lower_is_better(self, metric: str) -> bool:
        if metric == "J":
            return tables.objective(self.summary).name == "J_m"
        return metric in LOWER_IS_BETTER or metric.startswith("price")


def make_result(
    rows: RowTable, config: Mapping[str, Any], secret: str | None, failures: Mapping[str, str]
) -> EvaluationResult:
    """The result of a run.

    Args:
        rows: those of detectors that have failed are left out, because they are of the episodes that these survived.
        config: the arguments of the run.
        secret: of its last part, if it is isolated.
        failures: why detectors have failed, by label.
    """
    table = rows.take(order_rows(rows, config["detectors"]))
    if failures:
        table = table.take(np.flatnonzero(~np.isin(table.column("detector"), list(failures))))
    more = {"secret": secret, "failures": failures}
    return EvaluationResult(table, summarise(table), {**config, **{name: each for name, each in more.items() if each}})


def _pair(
    results: Sequence[EvaluationResult], a: str, b: str, metric: str
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """The differences of two detectors in the episodes that both have played, and the seeds of their swarms."""
    differences, swarms = [np.empty(0)], [np.empty(0, np.int64)]
    for result in results:
        (ours, first), (theirs, second) = result._values(a, metric), result._values(b, metric)
        seeds, here, there = np.intersect1d(ours, theirs, return_indices=True)
        differences.append(first[here] - second[there])
        swarms.append(seeds)
    found = np.concatenate(differences)
    if not len(found):
        raise ArgumentError(f"b must have episodes with {metric} in common with {quote(a)}, got {quote(b)}.")
    return found, np.concatenate(swarms)


def _sum_groups(values: NDArray[np.float64], groups: NDArray[np.int64]) -> NDArray[np.float64]:
    """The sum of each group's values: what changes its sign as a whole."""
    sums: NDArray[np.float64] = np.bincount(np.unique(groups, return_inverse=True)[1], values)  # type: ignore[assignment]
    return sums


def _strata(results: Sequence[EvaluationResult], metric: str) -> dict[str, list[NDArray[np.float64]]]:
    """The values of each detector of the first result in each result."""
    if not isinstance(results, Sequence) or not all(isinstance(each, EvaluationResult) for each in results):
        raise ArgumentError(f"results must be a list of results, got {quote(results)}.")
    if not results:
        raise ArgumentError("results must hold at least one result, got none.")
    for result in results:
        result.check_metric(metric)
    found = {}
    for entry in results[0].summary:
        label = entry["detector"]
        found[label] = [result._values(label, metric)[1] for result in results]
        if not all(map(len, found[label])):
            if metric in OPTIONAL_METRICS and not any(map(len, found[label])):
                del found[label]  # it returns no clusters
                continue
            raise ArgumentError(f"results must hold {metric} of the same detectors, got one without {quote(label)}.")
    return found


def interquartile_means(results: Sequence[EvaluationResult], metric: str = "J") -> dict[str, Interval]:
    """The mean of the middle half of all episodes of each detector, with its 95 % interval.

    It is less sensitive to a few bad episodes than the mean, and more efficient than the median (Agarwal et al., Deep
    Reinforcement Learning at the Edge of the Statistical Precipice, NeurIPS 2021, whose package is rliable). Values are
    not normalised: pool only results whose metric has the same scale.

    Args:
        results: evaluations of the same detectors on different environments: the tasks. Episodes are resampled within
            each of them.
        metric: which one.

    Returns:
        An interval for each label.

    Raises:
        ArgumentError: there is no such metric, or a result lacks a detector of the first one.
    """
    return {label: statistics.interquartile_mean(strata) for label, strata in _strata(results, metric).items()}


def performance_profiles(
    results: Sequence[EvaluationResult], metric: str = "J", thresholds: Sequence[float] | None = None
) -> dict[str, Profile]:
    """The share of episodes in which each detector is better than each threshold, averaged over the results.

    The run-score distribution of Agarwal et al. (2021), see :func:`interquartile_means`. Better means below the
    threshold for metrics of which lower values are better.

    Args:
        results: evaluations of the same detectors on different environments.
        metric: which one.
        thresholds: ``(t,)``; by default 101 from the lowest to the highest value.

    Returns:
        A profile for each label.

    Raises:
        ArgumentError: there is no such metric, a result lacks a detector of the first one, or the thresholds are no
            numbers.
    """
    strata = _strata(results, metric)
    if thresholds is None:
        pooled = np.concatenate([values for own in strata.values() for values in own])
        thresholds = np.linspace(pooled.min(), pooled.max(), _THRESHOLDS).tolist()
    elif not statistics.are_finite_numbers(thresholds):
        raise ArgumentError(f"thresholds must be a list of at least one finite number, got {quote(thresholds)}.")
    lower = results[0]._lower_is_better(metric)
    return {label: statistics.performance_profile(own, thresholds, lower) for label, own in strata.items()}
