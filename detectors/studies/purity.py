"""The paper's figure of purity, with head-in-cluster: all clusterers on raw and scaled inputs, M given or estimated."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass
from functools import cache, partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from detectors.clustering import make_clusterer
from detectors.studies.rounds import Cell
from usnet_env.config import ArgumentError, unknown_name
from usnet_env.envs import MultiClusterEnv
from usnet_env.evaluation.episode import episode_seeds
from usnet_env.evaluation.suite import Measurement, counter, flight_suffix, keep_report, measure, read_rows
from usnet_env.objectives import head_in_cluster, purity
from usnet_env.window import Window

__all__ = [
    "CLUSTERERS",
    "COUNTS",
    "FEATURES",
    "FOLLOW",
    "Method",
    "Row",
    "Task",
    "cluster_windows",
    "list_methods",
    "reproduce",
]

FOLLOW = ("f1", "f2", "f3", "f4", "f5", "f6", "f7")
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
class Row:
    """One window clustered by one method.

    Args:
        clusterer, features, count: the method.
        follow, clusters, uavs, mobility, head_jitter: the cell; ``clusters`` is M.
        episode: number of the episode.
        found: number of clusters in the answer.
        purity, head_in_cluster: as in :mod:`usnet_env.objectives`.
        seconds: wall time of clustering, features included.
    """

    clusterer: str
    features: str
    count: str
    follow: str
    clusters: int
    uavs: int
    mobility: str
    head_jitter: bool
    episode: int
    found: int
    purity: float
    head_in_cluster: float
    seconds: float

    @property
    def method(self) -> Method:
        """Its method."""
        return Method(self.clusterer, self.features, self.count)

    @property
    def cell(self) -> Cell:
        """Its cell."""
        return Cell(self.follow, self.clusters, self.uavs, self.mobility, self.head_jitter)


@dataclass(frozen=True)
class Task:
    """Some consecutive episodes of one method in one cell."""

    method: Method
    cell: Cell
    first: int
    count: int


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
    for name in wanted:
        if name not in FEATURES:
            raise unknown_name("features", name, FEATURES)
        if name.startswith("gru-") and not _has_gru():
            raise ArgumentError(f"features must be {', '.join(FEATURES[:3])} without PyTorch, got {name!r}.")
    found = []
    for clusterer in clusterers:
        if clusterer not in CLUSTERERS:
            raise unknown_name("clusterer", clusterer, CLUSTERERS)
        for count in counts:
            if count not in COUNTS:
                raise unknown_name("count", count, COUNTS)
            if (clusterer, count) != ("hdbscan", "given"):
                own = ("velocities",) if clusterer == "lead-votes" else wanted
                rules = CLUSTERERS[clusterer] if count == "estimated" else ("given",)
                found += [Method(clusterer, name, rule) for rule in rules for name in own]
    return found


def _make_features(name: str) -> Any:
    """Make the ``features`` argument of a clusterer."""
    return _make_gru_features(name.removeprefix("gru-")) if name.startswith("gru-") else name


@cache
def _make_gru_features(mode: str) -> Callable[[Window], Any]:
    from detectors.mc_gassl.features import gru_features  # they need PyTorch
    from detectors.mc_gassl.weights import load_meta_weights

    return partial(gru_features, parameters=load_meta_weights(), mode=mode)


def cluster_windows(task: Task, seed: int) -> list[Row]:
    """Cluster the first windows of the task's episodes, which are those of ``usnet evaluate`` with the same seed."""
    env, method = MultiClusterEnv(**asdict(task.cell)), task.method
    count = task.cell.clusters if method.count == "given" else method.count
    clusterer = make_clusterer(method.clusterer, count=count, features=_make_features(method.features))
    made = []
    for episode in range(task.first, task.first + task.count):
        swarm_seed, own_seed = episode_seeds(seed, episode)
        observation, _ = env.reset(seed=swarm_seed)
        window, truth = Window.from_observation(observation), env.swarm
        begun = time.perf_counter()
        clustering = clusterer.cluster(window, np.random.default_rng(own_seed))
        seconds = time.perf_counter() - begun
        made.append(
            Row(
                **asdict(method),
                **asdict(task.cell),
                episode=episode,
                found=clustering.count,
                purity=purity(truth.leader, clustering.labels),
                head_in_cluster=head_in_cluster(truth.head, truth.leader, clustering.labels),
                seconds=seconds,
            )
        )
    return made


def _list_keys(task: Task) -> list[tuple[Method, Cell, int]]:
    return [(task.method, task.cell, episode) for episode in range(task.first, task.first + task.count)]


def _sort_key(row: Row) -> tuple[str, int, int, str, str, str, int]:
    return row.follow, row.clusters, row.uavs, row.clusterer, row.features, row.count, row.episode


def reproduce(
    folder: Path,
    *,
    follow: Sequence[str] = FOLLOW,
    methods: Sequence[Method] | None = None,
    clusters: int = 5,
    uavs: int = 82,
    episodes: int = 30,
    mobility: str = "iid",
    head_jitter: bool = False,
    seed: int = 2022,
    workers: int = 1,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> list[Row]:
    """Measure purity and head-in-cluster; after an interruption, the same call continues with the missing rows.

    Args:
        folder: gets ``purity[-MmNn][-mobility][-jitter]-seedS.csv``, ``.md`` and ``.png``; table and picture are of
            all rows in the file, rows of earlier measurements included.
        follow: follow strategies.
        methods: from :func:`list_methods`; ``None``: all.
        clusters: M.
        uavs: N.
        episodes: number of episodes for each method and follow strategy.
        mobility: motion of the heads.
        head_jitter: whether the heads have the noise of the followers.
        seed: seed of the episodes. Nothing was tuned with the default seed, which the reports use.
        workers: number of processes.
        progress: called with the number of windows that are done, and of all windows.

    Returns:
        The rows of these methods, cells and episodes.

    Raises:
        ArgumentError: an argument is refused.
    """
    from detectors.studies import purity_report

    cells = [Cell(name, clusters, uavs, mobility, head_jitter) for name in dict.fromkeys(follow)]
    for cell in cells:
        MultiClusterEnv(**asdict(cell))
    chosen = list(dict.fromkeys(list_methods() if methods is None else methods))
    if not cells or not chosen or episodes < 1:
        raise ArgumentError("follow, methods and episodes must not be empty or 0, got none of one of them.")
    tasks = [
        Task(method, cell, first, min(_EPISODES_A_TASK, episodes - first))
        for first in range(0, episodes, _EPISODES_A_TASK)
        for cell in cells
        for method in chosen
    ]
    size = "" if (clusters, uavs) == (5, 82) else f"-M{clusters}N{uavs}"
    suffix = size + flight_suffix(mobility, head_jitter)
    path = folder / f"purity{suffix}-seed{seed}.csv"
    what = Measurement(
        Row, partial(cluster_windows, seed=seed), _list_keys, lambda row: (row.method, row.cell, row.episode), _sort_key
    )
    rows = measure(what, tasks, path, workers, counter(sum(task.count for task in tasks), progress))
    title = (
        f"Purity and head-in-cluster, M={clusters}, N={uavs}, {mobility} heads{' with jitter' if head_jitter else ''}"
    )
    kept = read_rows(path, Row)
    keep_report(path, purity_report.format_markdown(kept, title), purity_report.draw_methods(kept, title))
    return rows
