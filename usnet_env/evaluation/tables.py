"""Tables of a result: for a terminal, and as Markdown, LaTeX and HTML."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from html import escape
from typing import TYPE_CHECKING, Any, NamedTuple

from usnet_env.config import format_count, unknown_name
from usnet_env.evaluation.metrics import METRICS, TRACK_METRICS
from usnet_env.evaluation.report import format_latex

if TYPE_CHECKING:
    from rich.table import Table

Summary = Sequence[Mapping[str, Any]]

#: Headings of the metrics in tables, with the arrow that points to the better values; that of J depends on the problem.
HEADINGS = {
    "rounds": "rounds↓",
    "redundancy": "redundancy↓",
    "success": "success↑",
    "exact": "exact↑",
    "precision_first": "precision↑\nin round 1",
    "recall_first": "recall↑\nin round 1",
    "f1_first": "F1↑\nin round 1",
    "ap_first": "AP↑\nin round 1",
    "seconds_per_round": "seconds↓\nper round",
    "purity_first": "purity↑\nin round 1",
    "head_in_cluster_first": "head in cluster↑\nin round 1",
    "group_leader_first": "group leaders↑\nin round 1",
}

#: Columns of the ranked table after J; and after F1, in recorded tracks, which have one round.
RANKING = ("rounds", "redundancy", "exact", "f1_first", "seconds_per_round")
TRACK_RANKING = ("redundancy", "exact", "group_leader_first", "seconds_per_round")


def _format_number(value: float) -> str:
    """Format with three decimals, or with two significant digits below 0.001."""
    return f"{value:.3f}" if value == 0 or abs(value) >= 0.001 else f"{value:.2g}"


def _format_latex_number(value: float) -> str:
    r"""Format as :func:`_format_number` does, with ``\cdot 10^{-5}`` for ``e-05``."""
    return re.sub(r"e([+-]\d+)$", lambda power: rf" \cdot 10^{{{int(power[1])}}}", _format_number(value))


def _format_objective(value: float) -> str:
    """Format with three decimals, or with two from 10 on."""
    return f"{value:.3f}" if abs(value) < 10 else f"{value:.2f}"


def _format_short(entry: Mapping[str, Any], name: str) -> str:
    """A detector's mean of a metric with few digits; ``–`` where it has none."""
    if name not in entry["metrics"]:
        return "–"
    value = entry["metrics"][name]["mean"]
    if name == "seconds_per_round" and 0 < value < 0.01:
        return "<0.01"
    return f"{value:.1f}" if name == "rounds" or value >= 100 else f"{value:.2f}"


def _join(names: Sequence[str]) -> str:
    """``a``, ``a and b``, or ``a, b and c``."""
    return " and ".join(filter(None, [", ".join(names[:-1]), names[-1]]))


class FirstMetric(NamedTuple):
    """The metric by which detectors are ranked: its column, its name, and 1 if low values are good, otherwise -1."""

    column: str
    name: str
    sign: int

    @property
    def heading(self) -> str:
        """The name with the arrow that points to the better values."""
        return f"{self.name}{'↓' if self.sign == 1 else '↑'}"


def _is_of_tracks(summary: Summary) -> bool:
    """Whether recorded tracks were played."""
    return any(name in entry["metrics"] for entry in summary for name in TRACK_METRICS)


def first_metric(summary: Summary) -> FirstMetric:
    """J; in recorded tracks F1, since J of their one round does not count the heads that are missed."""
    return FirstMetric("f1_first", "F1", -1) if _is_of_tracks(summary) else objective(summary)


def _ranking_columns(summary: Summary) -> dict[str, str]:
    """The columns of the ranked table after the first metric, with their short headings."""
    names = TRACK_RANKING if _is_of_tracks(summary) else RANKING
    return {name: HEADINGS[name].partition("\n")[0].replace("seconds", "s") for name in names}


def objective(summary: Summary) -> FirstMetric:
    """J_m of P2, which is at least 1 and is to be low; or J_s of P1, which is at most 0 and is to be high."""
    if not summary or summary[0]["metrics"]["J"]["mean"] > 0:
        return FirstMetric("J", "J_m", 1)
    return FirstMetric("J", "J_s", -1)


def rank(summary: Summary) -> list[Mapping[str, Any]]:
    """The entries of the summary, best mean of the first metric first, then the highest F1, then in the order given."""
    best = first_metric(summary)

    def place(entry: Mapping[str, Any]) -> tuple[float, float]:
        metrics = entry["metrics"]
        return best.sign * metrics[best.column]["mean"], -metrics["f1_first"]["mean"]

    return sorted(summary, key=place)


def _choose_metrics(summary: Summary, metrics: Sequence[str] | None) -> list[str]:
    """The metrics that are asked for, or all, if at least one detector has them.

    Raises:
        ArgumentError: there is no such metric.
    """
    known = list(dict.fromkeys(name for entry in summary for name in entry["metrics"]))
    for name in metrics or ():
        if name not in known and name not in METRICS:
            raise unknown_name("metrics", name, known)
    return known if metrics is None else [name for name in metrics if name in known]


def _cells(
    entry: Mapping[str, Any],
    metrics: Sequence[str],
    pattern: str,
    alone: str = "{}",
    form: Callable[[float], str] = _format_number,
) -> list[str]:
    """A detector's mean and interval of each metric in a ``pattern``; ``–`` where it has none.

    Where all values are equal, or there is one, a mean has no interval and stands ``alone``.
    """

    def show(cell: Mapping[str, float]) -> str:
        equal = cell["low"] == cell["high"]
        return (alone if equal else pattern).format(*(form(cell[part]) for part in ("mean", "low", "high")))

    return [show(cell) if (cell := entry["metrics"].get(name)) else "–" for name in metrics]


def _heading(summary: Summary, metric: str) -> str:
    """The heading of a metric, in one or two lines."""
    return objective(summary).heading if metric == "J" else HEADINGS.get(metric, metric)


def _headings(summary: Summary, metrics: Sequence[str]) -> list[str]:
    return ["detector", "episodes", *(_heading(summary, name).replace("\n", " ") for name in metrics)]


def markdown_table(summary: Summary, metrics: Sequence[str] | None) -> str:
    """The means and intervals of all detectors as a table in Markdown."""
    chosen = _choose_metrics(summary, metrics)
    lines = [_headings(summary, chosen), ["---", *["---:"] * (len(chosen) + 1)]]
    for entry in summary:
        label = entry["detector"].replace("|", r"\|")
        lines.append([label, str(entry["episodes"]), *_cells(entry, chosen, "{} ({} to {})")])
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def latex_table(summary: Summary, metrics: Sequence[str] | None) -> str:
    """The means and intervals of all detectors as a ``tabular`` of LaTeX with the rules of the package booktabs."""
    chosen = _choose_metrics(summary, metrics)
    body = [
        [
            entry["detector"],
            str(entry["episodes"]),
            *_cells(entry, chosen, "${}$ (${}$ to ${}$)", "${}$", _format_latex_number),
        ]
        for entry in summary
    ]
    return "\n".join([*format_latex(_headings(summary, chosen), body, text_columns=1), ""])


def html_table(summary: Summary, title: str) -> str:
    """The ranking as a table in HTML, with the sentence about the best detector."""
    if not summary:
        return f"<p>{escape(title)}</p>"
    best, columns = first_metric(summary), _ranking_columns(summary)
    header = ["detector", "episodes", f"{best.heading} (95 % interval)", *columns.values()]
    lines = []
    for entry in rank(summary):
        means = _cells(entry, [best.column], "{} ({} to {})")
        shown = (_format_short(entry, name) for name in columns)
        lines.append([entry["detector"], str(entry["episodes"]), *means, *shown])
    table = html_cells(header, lines, f"<caption>{escape(title)}</caption>")
    return f"{table}<p>{escape(conclude(summary))}</p>"


def html_cells(header: Sequence[str], lines: Sequence[Sequence[str]], caption: str = "") -> str:
    """A table of texts in HTML."""
    rows = [(tag, line) for tag, own in (("th", [header]), ("td", lines)) for line in own]
    body = "".join(f"<tr>{''.join(f'<{tag}>{escape(text)}</{tag}>' for text in line)}</tr>" for tag, line in rows)
    return f"<table>{caption}{body}</table>"


def html_notes(notes: Iterable[str]) -> str:
    """Sentences below a table in HTML; empty ones are left out."""
    return "".join(f"<p>{escape(note)}</p>" for note in notes if note)


def describe_gap(summary: Summary, config: Mapping[str, Any]) -> str:
    """State in one sentence which detectors of a run have not played all episodes; an empty text if all have.

    Detectors that have failed are left out.
    """
    played, asked = {entry["detector"]: entry["episodes"] for entry in summary}, config.get("episodes", 0)
    labels = [label for label in config.get("detectors", ()) if label not in config.get("failures", {})]
    missing = [f"{label} has {played.get(label, 0)}" for label in labels if played.get(label, 0) < asked]
    return f"Episodes are missing: {_join(missing)} of {asked}." if missing else ""


def _make_table(
    title: str, headings: Iterable[str], lines: Iterable[Sequence[str]], repeated: int, **look: Any
) -> Table:
    """A table for a terminal: a detector and other texts in each line; a split one repeats its first columns."""
    from rich.box import SIMPLE_HEAD
    from rich.text import Text

    from usnet_env.evaluation.split_table import SplitTable

    table = SplitTable(title=title, box=SIMPLE_HEAD, title_justify="left", **look)
    table.repeated = repeated
    table.add_column("detector", overflow="fold")
    for heading in headings:
        table.add_column(heading, justify="right", no_wrap=True)
    for name, *texts in lines:
        table.add_row(Text(name), *texts)  # Text is not parsed as Rich markup, in which brackets have a meaning
    return table


def full_table(summary: Summary, env: str, metrics: Sequence[str] | None) -> Table:
    """All metrics with their intervals, one row for each detector, for a terminal."""
    columns = _choose_metrics(summary, metrics)
    headings = ["episodes", *(_heading(summary, name) for name in columns)]
    lines = [[entry["detector"], str(entry["episodes"]), *_cells(entry, columns, "{}\n{}–{}")] for entry in summary]
    return _make_table(f"{env}: mean and 95 % interval", headings, lines, 2, leading=1)


def describe_episodes(summary: Summary, asked: int | None = None) -> str:
    """The number of episodes of each detector: ``20 episodes``, or ``5 to 20 episodes``, ``5 of 20 episodes``."""
    episodes = sorted({entry["episodes"] for entry in summary}) or [0]
    most = format_count(episodes[-1], "episode")
    if asked is not None and episodes[-1] < asked:
        most = f"{episodes[-1]} of {format_count(asked, 'episode')}"
    return most if len(episodes) == 1 else f"{episodes[0]} to {most}"


def ranking_table(summary: Summary, env: str, asked: int | None = None) -> Table:
    """The detectors by their J, best first, and their main metrics, for a terminal of 80 columns.

    The title has what was played, and how many of the episodes that were ``asked`` for, if that is known.
    """
    title = f"{env}, {describe_episodes(summary, asked)} of each detector: means, best first"
    best, columns = first_metric(summary), _ranking_columns(summary)
    lines = []
    for entry in rank(summary):
        means = _cells(entry, [best.column], "{} ({}–{})", form=_format_objective)
        lines.append([entry["detector"], *means, *(_format_short(entry, name) for name in columns)])
    headings = (f"{best.heading} (95 % int.)", *columns.values())
    return _make_table(title, headings, lines, 1, show_edge=False, padding=0)


def conclude(summary: Summary) -> str:
    """State in one sentence which detector has the best J, and which others these episodes do not separate from it.

    Others are not separated from it if their 95 % interval of J overlaps its interval. In recorded tracks it is F1.
    """
    if not summary:
        return "No detector has played all episodes."
    first, *others = rank(summary)
    column, what, sign = first_metric(summary)
    best = first["metrics"][column]
    mean, low, high = (_format_objective(best[name]) for name in ("mean", "low", "high"))
    if best["low"] == best["high"]:
        value = f"{mean} in {'every' if first['episodes'] > 1 else 'its only'} episode"
    else:
        value = f"{mean} (95 % interval {low}–{high})"
    if not others:
        return f"{first['detector']} has a {what} of {value}."
    found = {entry["detector"]: entry["metrics"][column] for entry in others}
    equal = [label for label, own in found.items() if own == best]
    overlapping = [label for label, own in found.items() if own["low"] <= best["high"] and best["low"] <= own["high"]]
    near = [label for label in overlapping if label not in equal]
    names = _join([first["detector"], *equal])
    extreme = "lowest" if sign == 1 else "highest"
    sentence = f"{names} {'have' if equal else 'has'} the {extreme} {what}: {value}"
    if near:
        intervals = "interval of" if len(near) == 1 else "intervals of"
        return f"{sentence}, which overlaps with the {intervals} {_join(near)}."
    return f"{sentence}."
