"""Controls of every suite: what tells the heads of each cell to a rule that sees no pair of UAVs.

    OMP_NUM_THREADS=1 python benchmarks/leaks.py                     # all cells of all suites, to benchmarks/results/
    python benchmarks/leaks.py --suite field-v2 --cell couzin --swarms 20 --rows out/leaks.csv

* One track: a classifier sees the track of one UAV at a time.
* Positions: a classifier sees how far each UAV is from others, at the first instant of a window or at the last.
* Strangers: a window of tracks of as many swarms as UAVs, with the roles of a swarm of the cell; heads' tracks are of
  heads, so that no track follows another. `reader(policy='map')` is asked who leads.

A row is a swarm of the tuning seed and a window of strangers; only first windows count. `auc_*` is the area under the
ROC curve of a classifier in the swarm, 0.5 by chance, and `all_*` says whether its M highest UAVs are the M heads. A
classifier is trained on other swarms of the cell. `strange_*` is the share of strange tracks that the reader names.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from paper import shared
from paper.shared import Game
from pivot import CellFormatter, pivot, size
from scipy.spatial import KDTree
from sklearn.ensemble import HistGradientBoostingClassifier
from sklearn.metrics import roc_auc_score
from sklearn.model_selection import GroupKFold

from detectors.series.gaps import fill_gaps
from usnet_env import Window, make_detector
from usnet_env.arrays import Floats, Indices, Mask
from usnet_env.evaluation import list_suites, load_suite
from usnet_env.evaluation.play import episode_seeds

ROWS = shared.RESULTS / "leaks.csv.gz"
MIN_SWARMS, MIN_TRACKS, MAX_TRACKS = 48, 3000, 480_000  # of a cell
MAX_DISTINCT = 100  # up to so many UAVs, each strange track is of another swarm; else only of another cluster
FOLDS, MAX_LEARNED = 5, 20_000  # parts of the cross-validation; tracks that a classifier learns from, at most
LAGS, NEIGHBOURS = (1, 2, 3, 4, 6, 8, 12, 16), (1, 2, 3, 5, 8, 12, 20)
VIEWS = ("track", "first", "last")  # what a classifier sees: one track, positions at the first or last instant
AUCS, LEAK_AUC = [f"auc_{view}" for view in VIEWS], 0.7  # a cell with a higher mean AUC is given away
READER = "reader(policy='map')"
MODEL = {"max_iter": 60, "max_leaf_nodes": 12, "max_bins": 63, "random_state": 0}


class ObservedSwarms(NamedTuple):
    """The first windows of a cell's swarms, all with N UAVs, and what each UAV is.

    Args:
        windows: S windows.
        head: ``(S, N)``.
        role: ``(S, N)``, 0: follower, 1: head, 2: decoy, 3: bystander.
        cluster: ``(S, N)``, the index of the head or, of a UAV that no head leads, its own or -1.
    """

    windows: list[Window]
    head: Mask
    role: Indices
    cluster: Indices


def observe_swarms(env: Any, seed: int, swarms: int) -> ObservedSwarms:
    """Observe the first windows of so many swarms."""
    windows, states = [], []
    for swarm in range(swarms):
        windows.append(Window.from_observation(env.reset(seed=episode_seeds(seed, swarm)[0])[0]))
        states.append(env.swarm)
    roles = ("head", "decoy", "not_led", "root")
    head, decoy, not_led, root = (np.stack([getattr(state, name) for state in states]) for name in roles)
    return ObservedSwarms(windows, head, head + 2 * decoy + 3 * not_led, root)


def describe_tracks(window: Window) -> Floats:
    """Numbers of each track alone, ``(N, F)``: speed, course, position, shape, roughness, memory, share seen."""
    velocity, position = window.velocity.astype(float), window.position.astype(float)
    centred, speed = velocity - velocity.mean(axis=0), np.linalg.norm(velocity, axis=2)
    course = velocity / np.maximum(speed, 1e-9)[..., None]
    columns = [speed.mean(axis=0), speed.std(axis=0), np.linalg.norm(velocity.mean(axis=0), axis=1)]
    columns += [(velocity > 0).all(axis=2).mean(axis=0), *velocity.mean(axis=0).T, *velocity.std(axis=0).T]
    columns += [*position[0].T, *position[-1].T, *np.linalg.svd(centred.swapaxes(0, 1), compute_uv=False).T]
    columns += [(np.diff(velocity, order, axis=0) ** 2).sum(axis=2).mean(axis=0) for order in (1, 2, 3)]
    for lag in LAGS:
        columns.append((centred[lag:] * centred[:-lag]).sum(axis=2).mean(axis=0))
        columns.append((course[lag:] * course[:-lag]).sum(axis=2).std(axis=0))
    return np.stack(columns, axis=1)


def describe_positions(position: Floats) -> Floats:
    """Distances of each UAV ``(N, 3)`` to its k-th neighbour, to the middle of k neighbours, and of all, ``(N, F)``."""
    ranks = np.minimum(NEIGHBOURS, len(position) - 1)
    distance, nearest = KDTree(position).query(position, ranks.max() + 1)
    middles = [position[nearest[:, : k + 1]].mean(axis=1) for k in ranks] + [position.mean(axis=0)]
    return np.column_stack([distance[:, ranks], *(np.linalg.norm(position - middle, axis=1) for middle in middles)])


def describe_window(window: Window) -> dict[str, Floats]:
    """What each classifier sees of the UAVs, ``(N, F)``; samples that were missed are filled in."""
    filled = fill_gaps(window)
    tracks = np.column_stack([describe_tracks(filled), window.seen.mean(axis=0)])
    first, last = (describe_positions(filled.position[at].astype(float)) for at in (0, -1))
    return {"track": tracks, "first": first, "last": last}


def classify(numbers: Floats, head: Mask) -> Floats:
    """Scores ``(S, N)`` of ``(S, N, F)`` numbers, each by a classifier that learned from other swarms."""
    columns, truth, score = numbers.reshape(head.size, -1), head.ravel(), np.zeros(head.size)
    for train, test in GroupKFold(FOLDS).split(columns, groups=np.repeat(np.arange(len(head)), head.shape[1])):
        thinned = train[:: -(-len(train) // MAX_LEARNED)]
        model = HistGradientBoostingClassifier(**MODEL)
        score[test] = model.fit(columns[thinned], truth[thinned]).predict_proba(columns[test])[:, 1]
    return score.reshape(head.shape)


def classify_swarms(observed: ObservedSwarms) -> list[dict[str, Any]]:
    """What classifiers tell of each swarm; nothing where no UAV leads."""
    rows: list[dict[str, Any]] = [{} for _ in observed.windows]
    if not observed.head.any():
        return rows
    views = [describe_window(window) for window in observed.windows]
    for view in VIEWS:
        scores = classify(np.stack([numbers[view] for numbers in views]), observed.head)
        for row, head, score, role in zip(rows, observed.head, scores, observed.role, strict=True):
            if head.any():
                row[f"auc_{view}"] = roc_auc_score(head, score)
                row[f"all_{view}"] = int(head[np.argsort(-score)[: head.sum()]].all())
            if head.any() and view == "track" and (role == 2).any():
                row["auc_without_decoys"] = roc_auc_score(head[role != 2], score[role != 2])
    return rows


def meet_strangers(observed: ObservedSwarms, swarm: int) -> tuple[Window, Indices]:
    """A window of strange tracks with the roles of a swarm, and their roles ``(n,)``; n < N if too few are strange."""
    rng, size = np.random.default_rng(swarm), observed.role.shape
    origin = np.repeat(np.arange(size[0]), size[1])
    group = origin if size[0] >= size[1] else origin * (size[1] + 1) + observed.cluster.ravel() + 1
    chosen: list[int] = []
    for role in (1, 2, 3, 0):  # of the last there are enough
        tracks = np.flatnonzero((observed.role.ravel() == role) & ~np.isin(group, group[chosen]))
        tracks = rng.permutation(tracks)
        candidates = rng.permutation(tracks[np.unique(group[tracks], return_index=True)[1]])
        chosen += list(candidates[: (observed.role[swarm] == role).sum()])
    picks = [divmod(track, size[1]) for track in rng.permutation(chosen)]
    arrays = [
        np.stack([getattr(observed.windows[s], name)[:, i] for s, i in picks], axis=1)
        for name in ("position", "velocity", "seen")
    ]
    return Window(*arrays, np.ones(len(picks), bool)), np.array([observed.role[pick] for pick in picks])


def read_strangers(observed: ObservedSwarms) -> list[dict[str, Any]]:
    """Which shares of heads' and of followers' tracks the reader names in each window of strangers."""
    reader, rows = make_detector(READER), []
    for swarm in range(len(observed.windows)):
        window, role = meet_strangers(observed, swarm)
        reader.reset(swarm)
        named = reader.detect(window).candidates
        kinds = {"heads": named[role == 1], "followers": named[role == 0]}
        rows.append({f"strange_{kind}": part.mean() for kind, part in kinds.items() if len(part)})
    return rows


def play(game: Game, swarms: int | None = None) -> list[dict[str, Any]]:
    """Fly the swarms of a cell; one row a swarm, with a window of strangers."""
    suite, env = load_suite(game["suite"]), shared.open_cell(game["suite"], game["cell"])
    uavs = env.config.uavs
    default = max(MIN_SWARMS, MIN_TRACKS // uavs, uavs if uavs <= MAX_DISTINCT else 0)
    observed = observe_swarms(env, suite.tuning_seed, swarms or min(default, MAX_TRACKS // uavs))
    metrics = [*AUCS, *(f"all_{view}" for view in VIEWS), "auc_without_decoys", "strange_heads", "strange_followers"]
    rows = zip(observed.head, classify_swarms(observed), read_strangers(observed), strict=True)
    return [
        {**game, "episode": swarm, "uavs": uavs, "heads": head.sum(), **dict.fromkeys(metrics), **scores, **named}
        for swarm, (head, scores, named) in enumerate(rows)
    ]


def format_means(*metrics: str, scale: int = 1, digits: int = 2) -> CellFormatter:
    """Means of the metrics, – of those without values."""
    return lambda rows: "; ".join(f"{scale * rows[metric].mean():.{digits}f}" for metric in metrics).replace("nan", "–")


def find_leaks(rows: pd.DataFrame, views: Sequence[str] = VIEWS) -> list[str]:
    """By which of some views a cell is given away."""
    return [view for view in views if rows[f"auc_{view}"].mean() > LEAK_AUC]


#: What a table says of the rows of a cell.
CONTROLS: dict[str, CellFormatter] = {
    "swarms": size,
    "one track: AUC; without decoys": format_means("auc_track", "auc_without_decoys"),
    "positions, first; last: AUC": format_means("auc_first", "auc_last"),
    "all heads by one track, %": format_means("all_track", scale=100, digits=0),
    "strangers named, %: heads; followers": format_means("strange_heads", "strange_followers", scale=100, digits=0),
    "**given away** by": lambda rows: ", ".join(find_leaks(rows)) or "–",
}


def read_controls(suite: str) -> pd.DataFrame:
    """The rows of a suite's present version, cell by cell."""
    rows, cells = shared.read_rows(ROWS), list(list_suites()[suite].cells)
    rows = rows[(rows.suite == suite) & (rows.version == list_suites()[suite].version)]
    return rows.sort_values("cell", key=lambda names: names.map(cells.index), kind="stable")


def format_controls(suite: str) -> dict[str, CellFormatter]:
    """The columns of :data:`CONTROLS` for a table of other rows of a suite, a line for each cell."""
    cells = dict(iter(read_controls(suite).groupby("cell")))

    def look_up(format_cell: CellFormatter) -> CellFormatter:
        return lambda part: format_cell(cells[part["cell"].iloc[0]]) if part["cell"].iloc[0] in cells else "–"

    return {heading: look_up(format_cell) for heading, format_cell in CONTROLS.items()}


def report(rows: pd.DataFrame) -> str:
    """A line for each suite: how many of its cells are given away, and by what."""

    def count_leaks(*views: str) -> CellFormatter:
        return lambda part: str(sum(bool(find_leaks(cell, views)) for _, cell in part.groupby("cell")))

    def format_highest(*metrics: str) -> CellFormatter:
        return lambda part: f"{part.groupby('cell')[list(metrics)].mean().max().max():.2f}"

    rows = rows[rows.heads > 0]
    columns = {"cells with leaders": lambda part: str(part["cell"].nunique()), "given away": count_leaks(*VIEWS)}
    columns |= {"by one track": count_leaks("track"), "highest AUC of one track": format_highest("auc_track")}
    columns["by positions"] = count_leaks("first", "last")
    columns["highest AUC of positions"] = format_highest("auc_first", "auc_last")
    columns["highest share of strange heads named"] = format_highest("strange_heads")
    widest = 1.96 * rows.groupby(["suite", "cell"])[AUCS].sem().max().max()
    return f"{pivot(rows, {'suite': 'suite'}, columns)}\n\nThe 95 % interval of a cell's AUC is ±{widest:.2f} at most."


def main(argv: list[str] | None = None) -> None:
    parser = shared.make_parser(__doc__, ROWS)
    parser.add_argument("--suite", nargs="+", default=list(list_suites()), help="names or files; by default all")
    parser.add_argument("--cell", action="append", help="may repeat; by default all")
    parser.add_argument("--swarms", type=int, help="of each cell; by default 48 or more")
    options = parser.parse_args(argv)
    games: list[Game] = [
        {"suite": name, "version": suite.version, "cell": cell}
        for name, suite in ((name, load_suite(name)) for name in options.suite)
        for cell in options.cell or suite.cells
    ]
    print(report(shared.run_missing(options, games, partial(play, swarms=options.swarms))))


if __name__ == "__main__":
    main()
