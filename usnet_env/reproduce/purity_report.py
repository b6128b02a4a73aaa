"""Tables and picture of purity and head-in-cluster."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from usnet_env.evaluation.statistics import Interval, mean_interval
from usnet_env.reproduce.purity import CLUSTERERS, COUNTS, FEATURES, Method, Row
from usnet_env.reproduce.rows import episode_means

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["draw", "markdown"]

_METRICS = {"purity": "Purity", "head_in_cluster": "Head-in-cluster"}
_PAPER = (
    "The paper, in words: metric learning is at least 10 points purer than K-Means, symmetric NMF and spectral "
    "clustering on average. It does not say what these were given: raw metres and identically scaled inputs stand "
    "here."
)


def _methods(rows: Sequence[Row], count: str) -> list[Method]:
    """The methods of the rows with M given or estimated, clusterer by clusterer."""
    found = {row.method for row in rows if (row.count == "given") == (count == "given")}
    names = list(CLUSTERERS)
    return sorted(found, key=lambda one: (names.index(one.clusterer), one.count, FEATURES.index(one.features)))


def _label(method: Method) -> str:
    rule = f", {method.count}" if len(CLUSTERERS[method.clusterer]) > 1 and method.count != "given" else ""
    return f"{method.clusterer}{rule}, {method.features}"


def _text(interval: Interval) -> str:
    return f"{interval.mean:.2f} ({interval.low:.2f}–{interval.high:.2f})"


def _by_method(rows: Sequence[Row]) -> dict[Method, dict[str, list[Row]]]:
    """The rows by method, then follow strategy; ``"all"`` has them all."""
    found: dict[Method, dict[str, list[Row]]] = {}
    for row in rows:
        own = found.setdefault(row.method, {"all": []})
        own["all"].append(row)
        own.setdefault(row.follow, []).append(row)
    return found


def markdown(rows: Sequence[Row], title: str) -> str:
    """Four tables: purity and head-in-cluster, M given and estimated."""
    follows = sorted({row.follow for row in rows})
    own = _by_method(rows)
    lines = [
        f"# {title}",
        "",
        "Means with 95 % bootstrap intervals over episodes; n is the number of windows over all follow strategies. "
        "Purity hides the heads, which are few: head-in-cluster is the share of them that are with most of their own "
        "followers. Without any merit it is 1 where all UAVs are one cluster, as purity is where each is its own: look "
        "at the number of clusters found.",
        "",
        _PAPER,
    ]
    for count in COUNTS:
        for field, heading in _METRICS.items():
            methods = _methods(rows, count)
            if not methods:
                continue
            lines += ["", f"## {heading}, M {count}", ""]
            lines += ["| clusterer | M | features | n | all | " + " | ".join(follows) + " | found | s |"]
            lines += ["|---|---|---|---|---|" + "---|" * (len(follows) + 2)]
            for method in methods:
                values = [
                    _text(mean_interval(episode_means(own[method][name], field))) if name in own[method] else ""
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


def draw(rows: Sequence[Row], title: str) -> Figure:
    """Four panels, a line a method: the mean over all windows with its interval, and a dot a follow strategy."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    own = _by_method(rows)
    follows = sorted({row.follow for row in rows})
    counts = [count for count in COUNTS if _methods(rows, count)]
    heights = [len(_methods(rows, count)) + 3 for count in counts]
    figure = Figure(figsize=(14, 0.24 * sum(heights) + 1.2), layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.subplots(len(counts), 2, sharex=True, squeeze=False, height_ratios=heights)
    colours = dict(zip(CLUSTERERS, ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#e69f00"), strict=True))
    for axes_row, count in zip(grid, counts, strict=True):
        methods = _methods(rows, count)
        for axes, (field, heading) in zip(axes_row, _METRICS.items(), strict=True):
            for place, method in enumerate(methods):
                every = mean_interval(episode_means(own[method]["all"], field))
                ends = [[every.mean - every.low], [every.high - every.mean]]
                for name in follows:
                    if name in own[method]:
                        mean = mean_interval(episode_means(own[method][name], field)).mean
                        axes.plot([mean], [place], "o", ms=3, mfc="none", color="#999999", zorder=1)
                axes.errorbar([every.mean], [place], xerr=ends, fmt="s", ms=6, color=colours[method.clusterer])
            axes.set_title(f"{heading}, M {count}", fontsize=10)
            axes.set_yticks(range(len(methods)), [_label(method) for method in methods], fontsize=8)
            axes.set_ylim(len(methods) - 0.5, -0.5)
            axes.set_xlim(-0.03, 1.03)
            axes.grid(alpha=0.3)
    figure.suptitle(
        f"{title}\nsquares: all follow strategies, 95 % intervals; circles: one each ({', '.join(follows)})"
    )
    return figure
