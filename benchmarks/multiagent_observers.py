"""usnet_observers_v0: rules of fusion, numbers of observers and ranges, against one observer that sees all.

OMP_NUM_THREADS=1 python benchmarks/multiagent_observers.py      # writes benchmarks/results/multiagent_observers.*
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from multiagent_table import RESULTS, play_cells, table

from usnet_env import make_detector
from usnet_env.files import atomic_write
from usnet_env.multiagent.play import play_game
from usnet_env.multiagent.policies import DetectorObserver
from usnet_env.multiagent.usnet_observers_v0 import parallel_env

GAMES = 40
DETECTOR = "lagged-regression"
EVERYTHING = 10_000.0
RANGES = (250.0, 350.0, 500.0)
OBSERVERS = (1, 2, 4, 8)
FUSIONS = ("union", "majority", "scores")


def play(cell: Mapping[str, Any], seed: int) -> dict[str, Any]:
    env = parallel_env(observers=cell["observers"], sensing_range=cell["range"], fusion=cell["fusion"])
    game = play_game(env, {"observer": DetectorObserver(make_detector(DETECTOR))}, seed)
    return {
        "J": round(game.J, 6),
        "rounds": game.rounds,
        "success": int(game.success),
        "first_hits": game.first_hits,
        "first_redundant": game.first_redundant,
        "redundant": game.redundant,
        "seen_in_round_1": int(game.record["seen"][0].any(axis=0).sum()),
    }


def main() -> None:
    """Play and print."""
    cells = [{"range": EVERYTHING, "observers": 1, "fusion": "union"}]
    cells += [
        {"range": reach, "observers": observers, "fusion": fusion}
        for reach in RANGES
        for observers in OBSERVERS
        for fusion in FUSIONS
    ]
    rows = play_cells(RESULTS / "multiagent_observers.csv", cells, lambda cell: GAMES, play)
    columns = {
        "J": "J_m",
        "success": "all heads hit",
        "first_hits": "heads hit in round 1",
        "first_redundant": "redundant in round 1",
        "seen_in_round_1": "UAVs seen in round 1",
    }
    text = table(rows, ["range", "observers", "fusion"], columns)
    with atomic_write(RESULTS / "multiagent_observers.md") as aside:
        aside.write_text(text + "\n", encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main()
