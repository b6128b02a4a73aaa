"""Tables and pictures of purity and head-in-cluster."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from detectors.studies.purity import CLUSTERERS, COUNTS, FEATURES, Method, Row
from usnet_env.config import ArgumentError
from usnet_env.drawing import new_figure
from usnet_env.evaluation.statistics import Interval, mean_interval
from usnet_env.evaluation.suite import episode_means

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["draw_methods", "draw_strategies", "format_markdown"]

_METRICS = {"purity": "Purity", "head_in_cluster": "Head-in-cluster"}
_PAPER = (
    "The paper, in words: the purity of metric learning is on average at least 10 points above the purity of K-Means, "
    "symmetric NMF and spectral clustering. The paper does not say whether these received raw metres or scaled inputs; "
    "the tables have both."
)
_COLOURS = dict(zip(CLUSTERERS, ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#e69f00"), strict=True))
#: The four algorithms of the paper's picture: method, label, colour, marker. Metric learning is GRU and K-Means.
_PAPER_METHODS = (
    (Method("kmeans", "raw", "given"), "K-Means, raw metres", _COLOURS["kmeans"], "o"),
    (Method("kmeans", "scaled", "given"), "K-Means, scaled inputs", _COLOURS["kmeans"], "o"),
    (Method("snmf", "raw", "given"), "symmetric NMF, raw metres", _COLOURS["snmf"], "^"),
    (Method("snmf", "scaled", "given"), "symmetric NMF, scaled inputs", _COLOURS["snmf"], "^"),
    (Method("spectral", "raw", "given"), "spectral clustering, raw metres", _COLOURS["spectral"], "s"),
    (Method("spectral", "scaled", "given"), "spectral clustering, scaled inputs", _COLOURS["spectral"], "s"),
    (Method("kmeans", "gru-single", "given"), "metric learning (GRU and K-Means)", "black", "*"),
)


def _list_methods(rows: Sequence[Row], count: str) -> list[Method]:
    """List the methods of the rows with M given or estimated, clusterer by clusterer."""
    found = {row.method for row in rows if (row.count == "given") == (count == "given")}
    names = list(CLUSTERERS)
    return sorted(found, key=lambda one: (names.index(one.clusterer), one.count, FEATURES.index(one.features)))


def _format_label(method: Method) -> str:
    rule = f", {method.count}" if len(CLUSTERERS[method.clusterer]) > 1 and method.count != "given" else ""
    return f"{method.clusterer}{rule}, {method.features}"


def _format_interval(interval: Interval) -> str:
    return f"{interval.mean:.2f} ({interval.low:.2f}–{interval.high:.2f})"


def _group_rows(rows: Sequence[Row]) -> dict[Method, dict[str, list[Row]]]:
    """Group the rows by method, then by follow strategy; ``"all"`` has the rows of all strategies."""
    found: dict[Method, dict[str, list[Row]]] = {}
    for row in rows:
        own = found.setdefault(row.method, {"all": []})
        own["all"].append(row)
        own.setdefault(row.follow, []).append(row)
    return found


def format_markdown(rows: Sequence[Row], title: str) -> str:
    """Format four tables: purity and head-in-cluster, M given and estimated."""
    follows = sorted({row.follow for row in rows})
    own = _group_rows(rows)
    lines = [
        f"# {title}",
        "",
        "Means with 95 % bootstrap intervals over episodes; n is the number of windows over all follow strategies. "
        "Head-in-cluster is the share of heads that are in the cluster of most of their own followers. It stands "
        "beside purity because heads are few, and purity hardly depends on them. Purity is 1 if each UAV is its own "
        "cluster, and head-in-cluster is 1 if all UAVs are one cluster: both are of use only where the number of "
        "clusters found (column *found*) is near M.",
        "",
        _PAPER,
    ]
    for count in COUNTS:
        for field, heading in _METRICS.items():
            methods = _list_methods(rows, count)
            if not methods:
                continue
            lines += ["", f"## {heading}, M {count}", ""]
            lines += ["| clusterer | M | features | n | all | " + " | ".join(follows) + " | found | s |"]
            lines += ["|---|---|---|---|---|" + "---|" * (len(follows) + 2)]
            for method in methods:
                values = [
                    _format_interval(mean_interval(episode_means(own[method][name], field)))
                    if name in own[method]
                    else ""
                    for name in ("all", *follows)
                ]
                found, seconds = (
                    mean_interval(episode_means(own[method]["all"], name)) for name in ("found", "seconds")
                )
                name = f"{method.clusterer} | {method.count} | {method.features} | {len(own[method]['all'])}"
                means = " | ".join(values)
                number = f"{found.mean:.1f} ({found.low:.1f}–{found.high:.1f})"
                lines.append(f"| {name} | {means} | {number} | {seconds.mean:.3f} |")
    return "\n".join([*lines, ""])


def draw_methods(rows: Sequence[Row], title: str) -> Figure:
    """Draw all methods in four panels: the mean over all windows with its interval, and the mean of each strategy."""
    own = _group_rows(rows)
    follows = sorted({row.follow for row in rows})
    counts = [count for count in COUNTS if _list_methods(rows, count)]
    heights = [len(_list_methods(rows, count)) + 3 for count in counts]
    figure = new_figure(14, 0.24 * sum(heights) + 1.2)
    figure.set_layout_engine("constrained")
    grid = figure.subplots(len(counts), 2, sharex=True, squeeze=False, height_ratios=heights)
    for axes_row, count in zip(grid, counts, strict=True):
        methods = _list_methods(rows, count)
        for axes, (field, heading) in zip(axes_row, _METRICS.items(), strict=True):
            for place, method in enumerate(methods):
                every = mean_interval(episode_means(own[method]["all"], field))
                ends = [[every.mean - every.low], [every.high - every.mean]]
                for name in follows:
                    if name in own[method]:
                        mean = mean_interval(episode_means(own[method][name], field)).mean
                        axes.plot([mean], [place], "o", ms=3, mfc="none", color="#999999", zorder=1)
                axes.errorbar([every.mean], [place], xerr=ends, fmt="s", ms=6, color=_COLOURS[method.clusterer])
            axes.set_title(f"{heading}, M {count}", fontsize=10)
            axes.set_yticks(range(len(methods)), [_format_label(method) for method in methods], fontsize=8)
            axes.set_ylim(len(methods) - 0.5, -0.5)
            axes.set_xlim(-0.03, 1.03)
            axes.grid(alpha=0.3)
    figure.suptitle(
        f"{title}\nsquares: means over all follow strategies, with 95 % intervals; circles: means of one strategy each "
        f"({', '.join(follows)})"
    )
    return figure


def draw_strategies(rows: Sequence[Row], title: str) -> Figure:
    """Draw the paper's picture: purity of its four algorithms for each follow strategy, M given.

    The baselines appear twice, on positions in raw metres and on the same scaled inputs.

    Args:
        rows: rows with M given; those of other methods are left out.
        title: stands above the picture.

    Raises:
        ArgumentError: no row is of one of these methods.
    """
    own = _group_rows(rows)
    methods = [look for look in _PAPER_METHODS if look[0] in own]
    if not methods:
        raise ArgumentError("rows must hold a method of the paper's picture with M given, got none.")
    places = [*sorted({row.follow for row in rows}), "all"]
    figure = new_figure(11, 5.4)
    figure.set_layout_engine("constrained")
    axes = figure.subplots()
    for number, (method, label, color, marker) in enumerate(methods):
        shift = 0.8 * ((number + 0.5) / len(methods) - 0.5)
        known = [(place, own[method][name]) for place, name in enumerate(places) if name in own[method]]
        found = [mean_interval(episode_means(rows_there, "purity")) for _, rows_there in known]
        spread = [[one.mean - one.low for one in found], [one.high - one.mean for one in found]]
        axes.errorbar(
            [place + shift for place, _ in known],
            [one.mean for one in found],
            spread,
            fmt=marker,
            ms=11 if marker == "*" else 6,
            mfc="white" if method.features == "raw" else color,
            color=color,
            lw=1.2,
            label=label,
        )
    for edge in range(len(places) - 1):
        axes.axvline(edge + 0.5, color="#cccccc" if places[edge + 1] != "all" else "#777777", lw=0.8)
    axes.set_xticks(range(len(places)), places)
    axes.set(xlabel="follow strategy", ylabel="purity", xlim=(-0.5, len(places) - 0.5), ylim=(0, 1.03))
    axes.grid(axis="y", alpha=0.3)
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4, fontsize=9)
    windows = len(own[methods[0][0]]["all"])
    figure.suptitle(
        f"{title}\nmeans with 95 % intervals, {windows} windows a method; M is given\n"
        "the paper, in words: metric learning is at least 0.1 above each of the others on average",
        fontsize=11,
    )
    return figure
