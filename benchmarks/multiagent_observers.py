"""usnet_observers_v0: fusion rules, numbers of observers and ranges, beside one observer that sees the whole swarm.

OMP_NUM_THREADS=1 python benchmarks/multiagent_observers.py      # writes benchmarks/results/multiagent_observers.csv
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import product
from typing import Any

from running import RESULTS, SEED, answer_help, play_games

from usnet_env import make_detector
from usnet_env.multiagent.play import play_game
from usnet_env.multiagent.policies import DetectorObserver
from usnet_env.multiagent.usnet_observers_v0 import parallel_env

GAMES = 40
DETECTOR, OTHERS = "lagged-regression", ("follow-mixture", "random", "destroy-all")  # the others with `union` alone
EVERYTHING = 10_000.0
RANGES = (250.0, 350.0, 500.0)
OBSERVERS = (1, 2, 4, 8)
FUSIONS = ("union", "majority", "scores")

VALUES = ("J", "rounds", "success", "first_hits", "first_redundant", "redundant", "seen_in_round_1")


def play(cell: Mapping[str, Any], seed: int) -> dict[str, Any]:
    env = parallel_env(observers=cell["observers"], sensing_range=cell["range"], fusion=cell["fusion"])
    game = play_game(env, {"observer": DetectorObserver(make_detector(cell["detector"]))}, seed)
    return {
        **{name: getattr(game, name) for name in VALUES if hasattr(game, name)},
        "J": round(game.J, 6),
        "success": int(game.success),
        "seen_in_round_1": int(game.record["seen"][0].any(axis=0).sum()),
    }


def games() -> list[tuple[dict[str, Any], int]]:
    """One observer that sees the whole swarm, and every range, number of observers and fusion rule; with seeds."""
    settings = [(EVERYTHING, 1, "union"), *product(RANGES, OBSERVERS, FUSIONS)]
    return [
        ({"detector": detector, "range": reach, "observers": observers, "fusion": fusion}, seed)
        for detector in (DETECTOR, *OTHERS)
        for reach, observers, fusion in settings
        if detector == DETECTOR or fusion == "union"
        for seed in range(SEED, SEED + GAMES)
    ]


if __name__ == "__main__":
    answer_help(__doc__)
    play_games(RESULTS / "multiagent_observers.csv", games(), play, VALUES)
