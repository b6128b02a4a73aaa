"""The detector ``learned`` beside the others on follow strategies that it was not trained on. Resumable.

    OMP_NUM_THREADS=1 python benchmarks/learned.py                      # writes benchmarks/results/learned.csv
    OMP_NUM_THREADS=1 python benchmarks/learned.py --limits --games 10  # harder cells: learned_limits.csv

``learned`` was trained on random follow strategies, none of which is f1 to f7 or one of
``follow_mixture_strategies.py``. All detectors meet the same swarms, M=5 and N=82, and none is given M.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from itertools import product
from typing import Any

from follow_mixture import Cell, label_of
from follow_mixture import cells as all_cells
from follow_mixture import play as play_cell
from follow_mixture_strategies import FIRST_EIGHT
from running import RESULTS, SEED, make_parser, play_games
from usnet_env.evaluation.metrics import episode_metrics
from usnet_env.evaluation.suite import play_detector

from usnet_env.envs import MultiClusterEnv

DETECTORS = ("learned", "follow-mixture", "lagged-regression", "one-per-round", "destroy-all", "random")
SWARMS: dict[str, dict[str, Any]] = {
    "iid": {"mobility": "iid"},
    "gauss_markov, jitter": {"mobility": "gauss_markov", "head_jitter": True},
}
FOLLOW = ("f1", "f2", "f3", "f4", "f5", "f6", "f7", *FIRST_EIGHT)
GAMES = 20
LIMITS = {  # which detectors play, where the right answer is empty and elsewhere; silence.csv has both policies
    True: ("learned(policy='map')", "random", "destroy-all"),
    False: ("learned", "lagged-regression", "one-per-round", "random", "destroy-all"),
}
TIERS = ("short", "noise", "missed", "straight", "decoys", "bare", "silence", "shifted")
KEPT = ("J", "rounds", "success", "exact", "ap_first", "seconds_per_round")
KEPT_OF_LIMITS = ("J", "exact", "named", "decoys_named")


def play(cell: Mapping[str, Any], seed: int) -> dict[str, Any]:
    """One episode of the evaluation with seed 2022."""
    env = MultiClusterEnv(follow=cell["follow"], **SWARMS[cell["swarm"]])
    metrics = episode_metrics(env.problem, play_detector(env, cell["detector"], SEED, seed - SEED, isolate=False))
    return {name: round(metrics[name], 5) for name in KEPT}


def strategy_cells() -> list[dict[str, str]]:
    """The cells of the follow strategies, and the detectors that play them."""
    games = product(DETECTORS, SWARMS, FOLLOW)
    return [{"swarm": swarm, "follow": follow, "detector": detector} for detector, swarm, follow in games]


BARE = [  # heads and decoys without the followers' jitter
    Cell("bare", f"{follow}-{mobility}-5", {"follow": follow, "mobility": mobility, "decoys": 5, "uavs": 87})
    for follow in ("f1", "f4", "f7")
    for mobility in ("straight", "waypoint")
]
CELLS = {f"{cell.tier} {cell.name}": cell for cell in [*all_cells(), *BARE] if cell.tier in TIERS}


def limit_cells() -> list[dict[str, str]]:
    """The cells of the harder swarms, and the detectors that play them."""
    return [
        {"tier": cell.tier, "cell": cell.name, "detector": detector}
        for cell in CELLS.values()
        for detector in LIMITS[cell.empty]
    ]


def play_limit(cell: Mapping[str, Any], seed: int) -> dict[str, Any]:
    """One episode of a cell of follow_mixture.py."""
    row = play_cell(CELLS[f"{cell['tier']} {cell['cell']}"], cell["detector"], SEED, seed - SEED)
    return {column: row[column] for column in KEPT_OF_LIMITS}


def parser() -> argparse.ArgumentParser:
    made = make_parser(__doc__)
    made.add_argument("--games", type=int, default=GAMES, help="of each cell and detector")
    made.add_argument("--detectors", nargs="*", help="by default all of the measurement")
    made.add_argument("--limits", action="store_true", help="short, noisy and empty windows and decoys instead")
    return made


def chosen(arguments: argparse.Namespace) -> list[dict[str, str]]:
    """The cells that the command line asks for."""
    cells = limit_cells() if arguments.limits else strategy_cells()
    wanted = {label_of(name) for name in arguments.detectors} if arguments.detectors else None
    return [cell for cell in cells if wanted is None or cell["detector"] in wanted]


def main() -> None:
    arguments = parser().parse_args()
    games = [(cell, SEED + number) for cell in chosen(arguments) for number in range(arguments.games)]
    if arguments.limits:
        play_games(RESULTS / "learned_limits.csv", games, play_limit, KEPT_OF_LIMITS)
    else:
        play_games(RESULTS / "learned.csv", games, play, KEPT)


if __name__ == "__main__":
    main()
