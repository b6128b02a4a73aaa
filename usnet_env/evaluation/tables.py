"""Tables of a summary, and the sentence that it supports: for a terminal, and as Markdown and LaTeX."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

from usnet_env.config import format_count
from usnet_env.evaluation.play import TRACK_METRICS

if TYPE_CHECKING:
    from rich.table import Table

Summary = Sequence[Mapping[str, Any]]
Lines = list[list[str]]

#: Headings of the metrics in tables, with the arrow that points to the better values; that of J depends on the problem.
HEADINGS = {
    "rounds": "rounds↓",
    "redundancy": "redundancy↓",
    "success": "success↑",
    "exact": "exact↑",
    "precision_first": "precision↑",
    "recall_first": "recall↑",
    "f1_first": "F1↑",
    "ap_first": "AP↑",
    "seconds_per_round": "s↓",
    "purity_first": "purity↑",
    "head_in_cluster_first": "head in cluster↑",
    "group_leader_first": "group leaders↑",
}
#: Columns of the ranked table after J; and after F1, in recorded tracks, which have one round.
RANKING = ("rounds", "redundancy", "exact", "f1_first", "seconds_per_round")
TRACK_RANKING = ("redundancy", "exact", "group_leader_first", "seconds_per_round")

_LATEX = str.maketrans(
    {"\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}", "|": r"\textbar{}"}
    | {"↓": r"$\downarrow$", "↑": r"$\uparrow$", "<": r"\textless{}", ">": r"\textgreater{}", "–": "--"}
    | {sign: f"\\{sign}" for sign in "&%$#_{}"}
)


class FirstMetric(NamedTuple):
    """The metric by which detectors are ranked: its column, its name, and 1 if low values are good, otherwise -1."""

    column: str
    name: str
    sign: int


def printable(text: str) -> str:
    """The text without characters that would control a terminal."""
    return "".join(sign if sign.isprintable() else "�" for sign in text)


def objective(summary: Summary) -> FirstMetric:
    """J_m of P2, which is at least 1 and is to be low; or J_s of P1, which is at most 0 and is to be high."""
    values = [entry["metrics"]["J"]["mean"] for entry in summary if entry["metrics"]]
    return FirstMetric("J", "J_s", -1) if values and max(values) <= 0 else FirstMetric("J", "J_m", 1)


def _is_of_tracks(summary: Summary) -> bool:
    """Whether recorded tracks were played."""
    return any(name in entry["metrics"] for entry in summary for name in TRACK_METRICS)


def first_metric(summary: Summary) -> FirstMetric:
    """J; in recorded tracks F1, since J of their one round does not count the heads that are missed."""
    return FirstMetric("f1_first", "F1", -1) if _is_of_tracks(summary) else objective(summary)


def rank(summary: Summary) -> list[Mapping[str, Any]]:
    """The entries of the summary: those without a failure first, then by the first metric, then by F1."""
    best = first_metric(summary)

    def place(entry: Mapping[str, Any]) -> tuple[bool, bool, float, float]:
        metrics = entry["metrics"] or {name: {"mean": 0.0} for name in (best.column, "f1_first")}
        key = best.sign * metrics[best.column]["mean"], -metrics["f1_first"]["mean"]
        return not entry["metrics"], entry["failed"] > 0, *key

    return sorted(summary, key=place)


def _format(value: float) -> str:
    """Format with three decimals, two from 10 on, or two significant digits below 0.001."""
    if 0 < abs(value) < 0.001:
        return f"{value:.2g}"
    return f"{value:.3f}" if abs(value) < 10 else f"{value:.2f}"


def format_interval(interval: Mapping[str, float] | None, pattern: str = "{} ({}–{})") -> str:
    """A mean with its interval; alone if all values were equal, and ``–`` if there is none."""
    if interval is None:
        return "–"
    mean, low, high = (_format(interval[name]) for name in ("mean", "low", "high"))
    return mean if interval["low"] == interval["high"] else pattern.format(mean, low, high)


def heading(summary: Summary, metric: str) -> str:
    """The heading of a metric."""
    best = objective(summary)
    return f"{best.name}{'↓' if best.sign == 1 else '↑'}" if metric == "J" else HEADINGS.get(metric, metric)


def list_lines(
    summary: Summary, metrics: Iterable[str], pattern: str, means: Collection[str] = ()
) -> tuple[list[str], Lines]:
    """The heading and the lines of a table with a line for each detector and a column for each metric.

    Args:
        summary: the entries, in the order of the lines.
        metrics: the columns.
        pattern: how a mean and its interval are written.
        means: metrics whose interval is left out; then the number of episodes is, too.
    """
    counts = [*["episodes"] * (not means), *["failed"] * any(entry["failed"] for entry in summary)]
    columns = {name: "{}" if name in means else pattern for name in metrics}
    lines = [
        [
            printable(entry["detector"]),
            *(str(entry[name]) for name in counts),
            *(format_interval(entry["metrics"].get(name), form) for name, form in columns.items()),
        ]
        for entry in summary
    ]
    return ["detector", *counts, *(heading(summary, name) for name in columns)], lines


def list_ranking(summary: Summary) -> tuple[list[str], Lines]:
    """The heading and the lines of a table with the best detector first, which fits into 80 columns."""
    names = TRACK_RANKING if _is_of_tracks(summary) else RANKING
    return list_lines(rank(summary), [first_metric(summary).column, *names], "{} ({}–{})", names)


def format_markdown(header: Sequence[str], lines: Lines) -> str:
    """A table in Markdown, whose first column is left-aligned."""
    rule = ["---", *["---:"] * (len(header) - 1)]
    cells = ([text.replace("|", r"\|") for text in line] for line in (header, rule, *lines))
    return "".join(f"| {' | '.join(line)} |\n" for line in cells)


def format_latex(header: Sequence[str], lines: Lines) -> str:
    """A ``tabular`` for LaTeX with the rules of the package ``booktabs``."""
    first, *others = (" & ".join(text.translate(_LATEX) for text in line) + r" \\" for line in (header, *lines))
    begin = rf"\begin{{tabular}}{{l{'r' * (len(header) - 1)}}}"
    return "\n".join([begin, r"\toprule", first, r"\midrule", *others, r"\bottomrule", r"\end{tabular}", ""])


def make_table(title: str, header: Sequence[str], lines: Lines) -> Table:
    """A table for a terminal."""
    from rich.box import SIMPLE_HEAD
    from rich.table import Table
    from rich.text import Text

    # Text is not parsed as markup of rich, in which brackets have a meaning.
    table = Table(title=Text(printable(title)), box=SIMPLE_HEAD, title_justify="left", show_edge=False, padding=0)
    for number, name in enumerate(header):
        table.add_column(Text(name), justify="right" if number else "left", overflow="fold")
    for line in lines:
        table.add_row(*map(Text, line))
    return table


def describe_episodes(summary: Summary, asked: int) -> str:
    """The number of episodes of each detector: ``20 episodes``, or ``5 to 20 episodes``, ``5 of 20 episodes``."""
    episodes = sorted({entry["episodes"] for entry in summary}) or [0]
    most = format_count(episodes[-1], "episode")
    if episodes[-1] < asked:
        most = f"{episodes[-1]} of {format_count(asked, 'episode')}"
    return most if len(episodes) == 1 else f"{episodes[0]} to {most}"


def conclude(summary: Summary) -> str:
    """State which detector has the best J (in recorded tracks F1), and which others are not separated from it.

    Others are not separated from it if their 95 % interval overlaps its interval. Detectors that failed in an episode
    are left out, and named in a second sentence.
    """
    ranked = [entry for entry in rank(summary) if not entry["failed"]]
    failed = [
        f"{entry['detector']} failed in {entry['failed']} of {entry['failed'] + entry['episodes']} episodes"
        for entry in summary
        if entry["failed"]
    ]
    first = _name_best(ranked, first_metric(summary)) if ranked else "No detector has played all episodes."
    return printable(f"{first} {'; '.join(failed)}." if failed else first)


def _name_best(ranked: Sequence[Mapping[str, Any]], metric: FirstMetric) -> str:
    """The first sentence of a conclusion."""
    found = {entry["detector"]: entry["metrics"][metric.column] for entry in ranked}
    (name, best), *others = found.items()
    value = format_interval(best, "{} (95 % interval {}–{})")
    if best["low"] == best["high"]:
        value += " in every episode" if ranked[0]["episodes"] > 1 else " in its only episode"
    if not others:
        return f"{name} has a {metric.name} of {value}."
    extreme = "lowest" if metric.sign == 1 else "highest"
    equal = [label for label, interval in others if interval == best]
    near = [
        label
        for label, interval in others
        if interval != best and interval["low"] <= best["high"] and best["low"] <= interval["high"]
    ]
    overlap = f", which overlaps with that of {', '.join(near)}" if near else ""
    verb = "have" if equal else "has"
    return f"{' and '.join([name, *equal])} {verb} the {extreme} {metric.name}: {value}{overlap}."
