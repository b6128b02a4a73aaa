"""Tables of a summary: for a terminal, and as Markdown."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from usnet_env.config import printable
from usnet_env.evaluation.play import LOWER_IS_BETTER, METRICS, TRACK_METRICS

if TYPE_CHECKING:
    from rich.table import Table

Summary = Sequence[Mapping[str, Any]]
Lines = list[list[str]]

RANKED = ("J", "f1_first")  # the metrics that a ranking may show with intervals
_NAMES = {"f1_first": "F1", "ap_first": "AP", "seconds_per_round": "s"}  # in headings


def objective(summary: Summary) -> tuple[str, str, int]:
    """J_m of P2, which is at least 1 and is to be low; or J_s of P1, which is at most 0 and is to be high."""
    values = [entry["metrics"]["J"]["mean"] for entry in summary if entry["metrics"]]
    return ("J", "J_s", -1) if values and max(values) <= 0 else ("J", "J_m", 1)


def first_metric(summary: Summary) -> tuple[str, str, int]:
    """The metric by which detectors are ranked: its column, its name, and 1 if low values are good, otherwise -1.

    In recorded tracks it is F1, since J of their one round does not count the heads that are missed.
    """
    is_tracks = any(name in entry["metrics"] for entry in summary for name in TRACK_METRICS)
    return ("f1_first", "F1", -1) if is_tracks else objective(summary)


def rank(summary: Summary) -> list[Mapping[str, Any]]:
    """The entries of the summary: those without a failure first, then by the first metric, then by F1."""
    column, _, sign = first_metric(summary)

    def sort_key(entry: Mapping[str, Any]) -> tuple[float, ...]:
        if not entry["metrics"]:
            return (2.0,)
        means = {name: interval["mean"] for name, interval in entry["metrics"].items()}
        return float(entry["failed"] > 0), sign * means[column], -means["f1_first"]

    return sorted(summary, key=sort_key)


def format_interval(interval: Mapping[str, float] | None, pattern: str = "{} ({}–{})") -> str:
    """A mean with its interval; alone if all values were equal, and ``–`` if there is none.

    Numbers have three decimals, two from 10 on, and two significant digits below 0.001.
    """
    if interval is None:
        return "–"
    mean, low, high = (
        f"{value:.2g}" if 0 < abs(value) < 0.001 else f"{value:.3f}" if abs(value) < 10 else f"{value:.2f}"
        for value in (interval["mean"], interval["low"], interval["high"])
    )
    return mean if interval["low"] == interval["high"] else pattern.format(mean, low, high)


def heading(summary: Summary, metric: str) -> str:
    """The heading of a metric, with the arrow that points to the better values."""
    if metric == "J":
        _, name, sign = objective(summary)
        return f"{name}{'↓' if sign == 1 else '↑'}"
    if metric not in METRICS and metric not in TRACK_METRICS:
        return metric
    name = _NAMES.get(metric, metric.removesuffix("_first").replace("_", " "))
    return f"{name}{'↓' if metric in LOWER_IS_BETTER else '↑'}"


def list_lines(
    summary: Summary, metrics: Iterable[str], pattern: str, means: Collection[str] = ()
) -> tuple[list[str], Lines]:
    """The heading and the lines of a table with a line for each detector and a column for each metric.

    A mean and its interval are written in the pattern, those of ``means`` without the interval.
    """
    counts = [*["episodes"] * (not means), *["failed"] * any(entry["failed"] for entry in summary)]
    columns = {name: "{}" if name in means else pattern for name in metrics}
    lines = []
    for entry in summary:
        intervals = [format_interval(entry["metrics"].get(name), form) for name, form in columns.items()]
        lines.append([printable(entry["detector"]), *(str(entry[name]) for name in counts), *intervals])
    return ["detector", *counts, *(heading(summary, name) for name in columns)], lines


def list_ranking(summary: Summary) -> tuple[list[str], Lines]:
    """The heading and the lines of a table with the best detector first, which fits into 80 columns."""
    first, *_ = first_metric(summary)
    names = ["redundancy", "exact", "seconds_per_round"]
    names[2:2] = TRACK_METRICS if first != "J" else ["f1_first"]  # recorded tracks have one round
    return list_lines(rank(summary), [first, *["rounds"] * (first == "J"), *names], "{} ({}–{})", ["rounds", *names])


def format_markdown(header: Sequence[str], lines: Lines, numbers: bool = True) -> str:
    """A table in Markdown: its first column is left-aligned, and the others are unless they hold ``numbers``."""
    rule = ["---", *["---:" if numbers else "---"] * (len(header) - 1)]
    cells = ([text.replace("|", r"\|") for text in line] for line in (header, rule, *lines))
    return "".join(f"| {' | '.join(line)} |\n" for line in cells)


def make_table(title: str, header: Sequence[str], lines: Iterable[Iterable[object]], words: bool = False) -> Table:
    """A table for a terminal: of numbers, or of ``words``, which are aligned on the left."""
    from rich.box import SIMPLE_HEAD
    from rich.table import Table
    from rich.text import Text

    # Text is not parsed as markup of rich, in which brackets have a meaning.
    table = Table(title=Text(printable(title)), box=SIMPLE_HEAD, title_justify="left", show_edge=False)
    table.padding = (0, int(words))
    for number, name in enumerate(header):
        table.add_column(Text(name), justify="right" if number and not words else "left", overflow="fold")
    for line in lines:
        table.add_row(*(Text(printable(cell)) for cell in line))
    return table
