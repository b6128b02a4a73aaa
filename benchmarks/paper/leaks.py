"""What a suite gives away: how well single tracks, and untrained attention, tell its heads, cell by cell.

    python benchmarks/paper/leaks.py                           # the suite paper-hard
    python benchmarks/paper/leaks.py --suite field-v2 --rows out/leaks.csv

A classifier sees the track of one UAV at a time. It is trained on some swarms of a cell and asked about others; `auc`
is the area under its ROC curve in one swarm, 0.5 by chance. `hit` says whether the one UAV that `gassl(steps=0)` names
is a head, and `chance` how often a UAV at random is one. Only the first window counts, of swarms of the tuning seed.
Of small swarms, more are flown. The rows are in benchmarks/results/paper/leaks.csv.gz.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import shared
from shared import Game
from sklearn.ensemble import HistGradientBoostingClassifier
from sklearn.metrics import roc_auc_score
from sklearn.model_selection import GroupKFold

from usnet_env import Window, make_detector
from usnet_env.arrays import Floats
from usnet_env.evaluation import load_suite
from usnet_env.evaluation.play import episode_seeds

TRACKS, FEWEST, FOLDS = 3200, 40, 5  # about so many tracks of a cell, of at least so many swarms
LAGS = (1, 2, 3, 4, 6, 8, 12, 16)


def describe_tracks(window: Window) -> Floats:
    """Numbers of each track alone, ``(N, F)``: speed, course, place, shape, roughness and memory."""
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


def play(game: Game) -> list[dict[str, Any]]:
    """Fly the swarms of a cell, and train and ask the classifier by cross-validation; one row a swarm."""
    suite, env = load_suite(game["suite"]), shared.open_cell(game["suite"], game["cell"])
    tracks, heads, named = [], [], []
    swarms = max(FEWEST, TRACKS // env.config.uavs)
    for swarm in range(swarms):
        seed, other = episode_seeds(suite.tuning_seed, swarm)
        window = Window.from_observation(env.reset(seed=seed)[0])
        untrained = make_detector("gassl(steps=0)")
        untrained.reset(other)
        tracks.append(describe_tracks(window))
        heads.append(env.swarm.head)
        named.append(heads[-1][untrained.detect(window).candidates].all())
    group, truth = np.repeat(np.arange(swarms), [len(each) for each in heads]), np.concatenate(heads)
    numbers, score = np.concatenate(tracks), np.zeros(len(truth))
    for learn, ask in GroupKFold(FOLDS).split(numbers, truth, group):
        model = HistGradientBoostingClassifier(max_iter=60, max_leaf_nodes=12, class_weight="balanced", random_state=0)
        score[ask] = model.fit(numbers[learn], truth[learn]).predict_proba(numbers[ask])[:, 1]
    return [
        {**game, "episode": swarm, "hit": int(named[swarm]), "chance": heads[swarm].mean()}
        | {"auc": roc_auc_score(heads[swarm], score[group == swarm])}
        for swarm in range(swarms)
    ]


def main(argv: list[str] | None = None) -> None:
    parser = shared.parse(__doc__, shared.RESULTS / "paper" / "leaks.csv.gz")
    parser.add_argument("--suite", nargs="+", default=["paper-hard"])
    parser.add_argument("--cell", action="append", help="may repeat; by default all")
    given = parser.parse_args(argv)
    games: list[Game] = [
        {"suite": name, "cell": cell} for name in given.suite for cell in given.cell or load_suite(name).cells
    ]
    shared.measure(given, games, play)


if __name__ == "__main__":
    main()
