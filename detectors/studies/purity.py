"""The paper's figure of purity, with head-in-cluster: all clusterers on raw and scaled inputs, M given or estimated."""

from __future__ import annotations

import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cache, partial
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any, Unpack

import numpy as np

from detectors.clustering import make_clusterer
from detectors.studies import common
from usnet_env.config import ArgumentError
from usnet_env.drawing import COLORS, caption_figure
from usnet_env.envs import MultiClusterEnv
from usnet_env.evaluation import report
from usnet_env.evaluation.episode import episode_seeds
from usnet_env.evaluation.suite import Game, Suite, read_rows, split_games
from usnet_env.objectives import head_in_cluster, purity
from usnet_env.window import Window

if TYPE_CHECKING:
    from matplotlib.figure import Figure

#: The clusterers and their estimators of M: the gap statistic (the paper's rule, and ours), the eigengap, or their own.
CLUSTERERS = {
    "kmeans": ("gap-one-se", "gap"),
    "snmf": ("eigengap",),
    "spectral": ("eigengap",),
    "agglomerative": ("eigengap",),
    "hdbscan": ("own",),
    "lead-votes": ("own",),
}
#: The paper's one window of T_0 steps in metres and standardised, the series of all velocities, and GRU features.
FEATURES = ("raw", "scaled", "velocities", "gru-single", "gru-mean", "gru-series")
COUNTS = ("given", "estimated")
_EPISODES_A_TASK = 10


@dataclass(frozen=True)
class Method:
    """A clusterer, its features, and how it knows M: ``count`` is ``"given"`` or the estimator of M.

    ``lead-votes`` uses velocities only.
    """

    clusterer: str
    features: str
    count: str


@dataclass(frozen=True)
class Cell(Method):
    """One method in one kind of swarm; ``clusters`` is M."""

    follow: str = "f1"
    clusters: int = 5
    uavs: int = 82
    mobility: str = "iid"
    head_jitter: bool = False

    @property
    def method(self) -> Method:
        """Its method."""
        return Method(self.clusterer, self.features, self.count)

    def make_env(self) -> MultiClusterEnv:
        """Make its environment."""
        return MultiClusterEnv(**common.swarm_arguments(self, Cell, 3))


@dataclass(frozen=True, kw_only=True)
class Row(Cell):
    """One window clustered by one method.

    Args:
        episode: number of the episode.
        found: number of clusters in the answer.
        purity, head_in_cluster: as in :mod:`usnet_env.objectives`.
        seconds: wall time of clustering, features included.
    """

    episode: int
    found: int
    purity: float
    head_in_cluster: float
    seconds: float


def _has_gru() -> bool:
    """Whether the GRU network can be used: it needs PyTorch, which is an extra."""
    return find_spec("torch") is not None


def list_methods(
    clusterers: Iterable[str] = tuple(CLUSTERERS), features: Iterable[str] | None = None, counts: Iterable[str] = COUNTS
) -> list[Method]:
    """List all possible combinations: HDBSCAN takes no M, and ``lead-votes`` has its own features.

    Args:
        clusterers: names of :data:`CLUSTERERS`.
        features: names of :data:`FEATURES`; ``None``: all that can be used; those of the GRU need PyTorch.
        counts: names of :data:`COUNTS`.

    Raises:
        ArgumentError: a name is unknown, or needs PyTorch, which is not installed.
    """
    wanted = tuple(features) if features is not None else FEATURES if _has_gru() else FEATURES[:3]
    clusterers, counts = tuple(clusterers), tuple(counts)
    common.check_names("features", wanted, FEATURES)
    common.check_names("clusterer", clusterers, CLUSTERERS)
    common.check_names("count", counts, COUNTS)
    for name in wanted:
        if name.startswith("gru-") and not _has_gru():
            raise ArgumentError(f"features must be {', '.join(FEATURES[:3])} without PyTorch, got {name!r}.")
    found = []
    for clusterer in clusterers:
        for count in counts:
            if (clusterer, count) != ("hdbscan", "given"):
                own = ("velocities",) if clusterer == "lead-votes" else wanted
                rules = CLUSTERERS[clusterer] if count == "estimated" else ("given",)
                found += [Method(clusterer, name, rule) for rule in rules for name in own]
    return found


@cache
def _make_features(name: str) -> Any:
    """Make the ``features`` argument of a clusterer."""
    if not name.startswith("gru-"):
        return name
    from detectors.mc_gassl.features import gru_features  # they need PyTorch
    from detectors.mc_gassl.gru import load_meta_weights

    mode: Any = name.removeprefix("gru-")
    return partial(gru_features, parameters=load_meta_weights(), mode=mode)


def cluster_windows(games: Sequence[Game[Cell]], seed: int) -> list[Row]:
    """Cluster the first windows of the games, which are those of ``usnet evaluate`` with the same seed."""
    made = []
    for cell, episode in games:
        env = cell.make_env()
        count = cell.clusters if cell.count == "given" else cell.count
        clusterer = make_clusterer(cell.clusterer, count=count, features=_make_features(cell.features))
        swarm_seed, own_seed = episode_seeds(seed, episode)
        observation, _ = env.reset(seed=swarm_seed)
        window, truth = Window.from_observation(observation), env.swarm
        begun = time.perf_counter()
        clustering = clusterer.cluster(window, np.random.default_rng(own_seed))
        values: dict[str, Any] = {
            "seconds": time.perf_counter() - begun,
            "found": clustering.count,
            "purity": purity(truth.root, clustering.labels),
            "head_in_cluster": head_in_cluster(truth.head, truth.root, clustering.labels),
        }
        made.append(Row(**vars(cell), episode=episode, **values))
    return made


def reproduce(
    folder: Path,
    *,
    follow: Sequence[str] = common.FOLLOW,
    methods: Sequence[Method] | None = None,
    clusters: int = 5,
    uavs: int = 82,
    episodes: int = 30,
    mobility: str = "iid",
    head_jitter: bool = False,
    seed: int = 2022,
    formats: Sequence[str] = ("png",),
    **running: Unpack[common.Running],
) -> common.Reproduction[Row]:
    """Measure purity and head-in-cluster; after an interruption, the same call continues with the missing rows.

    The arguments are those of ``usnet reproduce purity``, with methods of :func:`list_methods`, and ``running``: see
    :class:`~detectors.studies.common.Running`. The folder gets ``purity[-MmNn][-mobility][-jitter]-seedS.csv``, ``.md``
    and the picture; they are of all rows in the file, rows of earlier measurements included. Nothing was tuned with the
    default seed, which the reports use.

    Raises:
        ArgumentError: an argument is refused.
    """
    chosen = list(dict.fromkeys(list_methods() if methods is None else methods))
    cells = [
        Cell(**vars(method), follow=name, clusters=clusters, uavs=uavs, mobility=mobility, head_jitter=head_jitter)
        for name in dict.fromkeys(follow)
        for method in chosen
    ]
    if not cells or episodes < 1:
        raise ArgumentError("follow, methods and episodes must not be empty or 0, got none of one of them.")
    for cell in cells:
        cell.make_env()
    size = "" if (clusters, uavs) == (5, 82) else f"-M{clusters}N{uavs}"
    path = folder / f"purity{size}{common.name_flight(cells[0])}-seed{seed}.csv"
    order = ("follow", "clusters", "uavs", "clusterer", "features", "count", "episode")
    suite = Suite(Cell, Row, partial(cluster_windows, seed=seed), order=order, digits=4)
    rows = suite.run(split_games(cells, episodes, _EPISODES_A_TASK), path, **running)
    title = f"Purity and head-in-cluster, M={clusters}, N={uavs}, {common.describe_flight(cells[0])}"
    kept = read_rows(path, Row)
    report.keep_report(path, report_methods(kept, title), draw_methods(kept, title), formats)
    return common.Reproduction(rows, report_methods(rows, "Purity and head-in-cluster"))


_METRICS = {"purity": "Purity", "head_in_cluster": "Head-in-cluster"}
_PAPER = (
    "The paper, in words: the purity of metric learning is on average at least 10 points above the purity of K-Means, "
    "symmetric NMF and spectral clustering. The paper does not say whether these received raw metres or scaled inputs; "
    "the tables have both."
)
_COLOURS = dict(zip(CLUSTERERS, COLORS, strict=False))
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


def _group_methods(rows: Sequence[Row]) -> dict[Method, dict[str, list[Row]]]:
    """Group the rows by method, then by follow strategy; ``"all"`` has the rows of all strategies."""
    methods = report.group_rows(rows, lambda row: row.method)
    return {method: {"all": own, **report.group_rows(own, lambda row: row.follow)} for method, own in methods.items()}


def _format_mean(rows: Sequence[Row], field: str) -> str:
    return report.format_interval(report.mean_over_episodes(rows, field)) if rows else ""


def report_methods(rows: Sequence[Row], title: str) -> str:
    """Report four tables: purity and head-in-cluster, M given and estimated."""
    follows = sorted({row.follow for row in rows})
    grouped = _group_methods(rows)
    parts = [
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
            lines = []
            for method in _list_methods(rows, count):
                own = grouped[method]
                means = [_format_mean(own.get(name, ()), field) for name in ("all", *follows)]
                found, seconds = (report.mean_over_episodes(own["all"], name) for name in ("found", "seconds"))
                name = (method.clusterer, method.count, method.features, str(len(own["all"])))
                lines.append((*name, *means, report.format_interval(found, ".1f"), f"{seconds.mean:.3f}"))
            header = ("clusterer", "M", "features", "n", "all", *follows, "found", "s")
            parts += ["", f"## {heading}, M {count}", "", *report.format_markdown(header, lines)] if lines else []
    return "\n".join([*parts, ""])


def draw_methods(rows: Sequence[Row], title: str) -> Figure:
    """Draw all methods in four panels: the mean over all windows with its interval, and the mean of each strategy."""
    own = _group_methods(rows)
    follows = sorted({row.follow for row in rows})
    counts = [count for count in COUNTS if _list_methods(rows, count)]
    heights = [len(_list_methods(rows, count)) + 3 for count in counts]
    height = 0.24 * sum(heights) + 1.2
    figure, grid = report.make_panels(14, height, len(counts), 2, sharex=True, height_ratios=heights)
    for axes_row, count in zip(grid, counts, strict=True):
        methods = _list_methods(rows, count)
        for axes, (field, heading) in zip(axes_row, _METRICS.items(), strict=True):
            for place, method in enumerate(methods):
                for name in follows:
                    if name in own[method]:
                        mean = report.mean_over_episodes(own[method][name], field).mean
                        axes.plot([mean], [place], "o", ms=3, mfc="none", color="#999999", zorder=1)
                every = report.mean_over_episodes(own[method]["all"], field)
                ends = [[every.mean - every.low], [every.high - every.mean]]
                axes.errorbar([every.mean], [place], xerr=ends, fmt="s", ms=6, color=_COLOURS[method.clusterer])
            axes.set_title(f"{heading}, M {count}", fontsize=10)
            axes.set_yticks(range(len(methods)), [_format_label(method) for method in methods], fontsize=8)
            axes.set_ylim(len(methods) - 0.5, -0.5)
            axes.set_xlim(-0.03, 1.03)
    windows = report.format_counts((len(each["all"]) for each in own.values()), "windows")
    caption_figure(
        figure,
        title,
        f"Squares: means over all follow strategies; {windows.replace('point', 'square')}. Bars are 95 % bootstrap "
        f"intervals over episodes. Circles: means of one strategy each ({', '.join(follows)}).",
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
    own = _group_methods(rows)
    methods = [look for look in _PAPER_METHODS if look[0] in own]
    if not methods:
        raise ArgumentError("rows must hold a method of the paper's picture with M given, got none.")
    places = [*sorted({row.follow for row in rows}), "all"]
    figure, ((axes,),) = report.make_panels(11, 5.4)
    for number, (method, label, color, marker) in enumerate(methods):
        shift = 0.8 * ((number + 0.5) / len(methods) - 0.5)
        means = {
            place + shift: report.mean_over_episodes(own[method][name], "purity")
            for place, name in enumerate(places)
            if name in own[method]
        }
        fill, size = "white" if method.features == "raw" else color, 11 if marker == "*" else 6
        report.draw_intervals(axes, means, fmt=marker, ms=size, mfc=fill, color=color, lw=1.2, label=label)
    for edge in range(len(places) - 1):
        axes.axvline(edge + 0.5, color="#cccccc" if places[edge + 1] != "all" else "#777777", lw=0.8)
    axes.set_xticks(range(len(places)), places)
    axes.set(xlabel="follow strategy", ylabel="purity", xlim=(-0.5, len(places) - 0.5), ylim=(0, 1.03))
    axes.grid(visible=False, axis="x")
    report.add_legend(figure, [axes])
    windows = report.format_counts(
        (len(own[method][name]) for method, *_ in methods for name in places[:-1]), "windows"
    )
    caption_figure(
        figure,
        title,
        f"Means; {windows} (all: {len(own[methods[0][0]]['all'])}). Bars are 95 % bootstrap intervals over episodes. "
        "M is given. The paper, in words: metric learning is at least 0.1 above each of the others on average.",
    )
    return figure
