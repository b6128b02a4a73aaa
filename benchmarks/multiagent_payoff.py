"""Pay-offs of usnet_evasion_v0: every observer against every swarm policy, with the same seeds.

OMP_NUM_THREADS=1 python benchmarks/multiagent_payoff.py      # writes benchmarks/results/multiagent_payoff.csv
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import product
from typing import Any

from running import RESULTS, SEED, answer_help, play_games

from usnet_env import make_detector
from usnet_env.multiagent.play import play_game
from usnet_env.multiagent.policies import CamouflagedHead, DetectorObserver, Policy, RandomHead, TruthfulHead
from usnet_env.multiagent.usnet_evasion_v0 import parallel_env

MAX_ROUNDS = 10
FOLLOW = ("f1", "f3", "f6")
GAMES = 40
OBSERVERS = (
    "random", "destroy-all", "one-per-round", "lagged-regression", "lagged-regression(lags=8)", "follow-mixture",
)  # fmt: skip
SWARMS: dict[str, Policy] = {
    "truthful": TruthfulHead(),
    "late": CamouflagedHead(mobility=0, decoys=0),
    "camouflaged": CamouflagedHead(),
    "random": RandomHead(),
}

VALUES = ("J", "price", "swarm_payoff", "rounds", "success", "first_hits", "first_redundant", "redundant")


def play(cell: Mapping[str, Any], seed: int) -> dict[str, Any]:
    observer = DetectorObserver(make_detector(cell["observer"]))
    env = parallel_env(follow=cell["follow"], max_rounds=MAX_ROUNDS)
    game = play_game(env, {"observer": observer, "head": SWARMS[cell["swarm"]]}, seed)
    price = game.prices["observer_0"]
    return {
        **{name: getattr(game, name) for name in VALUES if hasattr(game, name)},
        "J": round(game.J, 6),
        "price": round(price, 6),
        "swarm_payoff": round(game.J - price, 6),
        "success": int(game.success),
    }


def games() -> list[tuple[dict[str, Any], int]]:
    """Every strategy, observer and swarm policy, with all seeds."""
    every = product(FOLLOW, OBSERVERS, SWARMS, range(SEED, SEED + GAMES))
    return [({"follow": follow, "observer": name, "swarm": swarm}, seed) for follow, name, swarm, seed in every]


if __name__ == "__main__":
    answer_help(__doc__)
    play_games(RESULTS / "multiagent_payoff.csv", games(), play, VALUES)
