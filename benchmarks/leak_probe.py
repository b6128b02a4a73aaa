"""What the track of one UAV alone tells: whether it is a head can be read off without comparing any two UAVs.

    python benchmarks/leak_probe.py --suite paper controls field    # adds to benchmarks/results/leak_probe.csv

A classifier sees numbers of one track at a time: speeds, turns, and how long a direction lasts. It is trained on some
swarms of a cell and tested on others (cross-validation by swarm). The area under the curve (AUC) of a swarm is 0.5 by
chance, and 1 if every head can be recognised by its own track. A detector that beats others in a cell with a high AUC
may have learned how heads fly and not who leads. The swarms are those of the suite's tuning seed.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray
from running import RESULTS, make_parser, play_games
from sklearn.ensemble import HistGradientBoostingClassifier
from sklearn.metrics import roc_auc_score
from sklearn.model_selection import GroupKFold
from usnet_env.evaluation.episode import episode_seeds

import usnet_env  # noqa: F401  # registers the environments
from usnet_env.evaluation import FrozenSuite, load_suite

SWARMS, FOLDS, LAGS = 40, 5, (1, 2, 4, 8)


def describe_tracks(velocity: NDArray[np.float32], seen: NDArray[Any]) -> NDArray[np.float64]:
    """Numbers of each track by itself: ``(N, F)`` from velocities ``(T, N, 3)`` and their mask ``(T, N)``."""
    speed = np.linalg.norm(velocity, axis=-1)
    direction = velocity / np.maximum(speed, 1e-9)[..., None]
    count = np.maximum(seen.sum(axis=0), 1)

    def mean(values: NDArray[Any], known: NDArray[Any]) -> NDArray[np.float64]:
        return (values * known).sum(axis=0) / np.maximum(known.sum(axis=0), 1)

    columns = [mean(speed, seen), np.sqrt(mean((speed - mean(speed, seen)) ** 2, seen))]
    columns.append(np.linalg.norm((velocity * seen[..., None]).sum(axis=0), axis=-1) / count)
    columns += list((((velocity - velocity.mean(axis=0)) ** 2) * seen[..., None]).sum(axis=0).T / count)
    for lag in LAGS:
        known = seen[lag:] & seen[:-lag]
        cosine = (direction[lag:] * direction[:-lag]).sum(axis=-1)
        columns += [mean(cosine, known), mean(cosine**2, known)]
    return np.stack(columns, axis=1)


def measure(suite: FrozenSuite, name: str) -> Iterator[float]:
    """The AUC of each swarm of a cell that has both heads and other UAVs."""
    cell = suite.cells[name]
    env: Any = gym.make(cell.env, **cell.arguments)
    tracks, heads, swarms = [], [], []
    for episode in range(SWARMS):
        observation, _ = env.reset(seed=episode_seeds(suite.tuning_seed, episode)[0])
        seen = observation["seen"].astype(bool)
        tracks.append(describe_tracks(observation["velocity"], seen[1:] & seen[:-1]))
        heads.append(env.unwrapped.swarm.head)
        swarms.append(np.full(len(heads[-1]), episode))
    x, y, group = np.concatenate(tracks), np.concatenate(heads), np.concatenate(swarms)
    if not y.any():
        return
    for train, test in GroupKFold(FOLDS).split(x, y, group):
        model = HistGradientBoostingClassifier(max_iter=100, random_state=0).fit(x[train], y[train])
        score = model.predict_proba(x[test])[:, 1]
        for swarm in np.unique(group[test]):
            own = group[test] == swarm
            if 0 < y[test][own].sum() < own.sum():
                yield float(roc_auc_score(y[test][own], score[own]))


def play(cell: Mapping[str, Any], number: int) -> dict[str, Any]:
    """The mean AUC of a cell, and its standard error over swarms; ``number`` is the suite's version."""
    values = list(measure(load_suite(cell["suite"]), cell["cell"]))
    if not values:
        return {"swarms": 0, "auc": "", "error": ""}
    return {
        "swarms": len(values),
        "auc": f"{np.mean(values):.4f}",
        "error": f"{np.std(values) / np.sqrt(len(values)):.4f}",
    }


def main() -> None:
    parser = make_parser(__doc__)
    parser.add_argument("--suite", nargs="+", default=["paper"])
    suites = [load_suite(name) for name in parser.parse_args().suite]
    games = [({"suite": suite.name, "cell": cell}, suite.version) for suite in suites for cell in suite.cells]
    play_games(RESULTS / "leak_probe.csv", games, play, ("swarms", "auc", "error"), number="version")


if __name__ == "__main__":
    main()
