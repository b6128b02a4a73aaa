"""usnet_observers_v0 with observers that fly: scripted patrols, IPPO and MAPPO, which learn where to fly.

    OMP_NUM_THREADS=1 python benchmarks/observers.py --trainings 3    # goes on after those that the rows have
    python benchmarks/observers.py --draw                             # trains nothing: the table of the rows

Only the flight differs: in all rows each observer names what the detector names in its own window, and its message says
where it is going to be. IPPO and MAPPO (Yu et al. 2022) are PPO with the same weights for all observers, whose flights
are level and at top speed. Their actors get what an observer knows (:meth:`Search.look`); the critic of MAPPO gets the
true state, too. The reward is that of the game, and ``PER_HIT`` for each head that is hit. In training no detector
runs: a head is hit if an observer saw it and two of its followers for half a window.
"""

from __future__ import annotations

from functools import partial
from itertools import product
from typing import Any

import numpy as np
import pandas as pd
from learners import follow_policy, make_network, train_by_ppo
from paper import shared
from patrols import FLIGHTS, PATROLS, Search, play
from pivot import mean, pivot, rate, size

ROWS = shared.RESULTS / "observers.csv.gz"
CELLS: dict[str, dict[str, Any]] = {"clusters gathered, range 200 m": {}}
DETECTOR, FRESH = "reader", 1_000_000  # no training reaches the seeds from FRESH on
BATCH, DECISIONS = 64, 2_000_000  # games at once, and decisions, of a training


def measure(game: shared.Game, episodes: int, decisions: int) -> list[dict[str, Any]]:
    """The rows of a patrol, of which one that learns is trained first."""
    cell, flight, training = game.values()
    if flight in PATROLS:
        patrol = PATROLS[flight]
    else:
        with shared.isolate_torch(training):
            search = Search(BATCH, **CELLS[cell])
            search.reset(training * BATCH)
            actor = make_network(search.look().shape[2], len(FLIGHTS))
            train_by_ppo(search, actor, flight == "MAPPO", decisions)
        patrol = follow_policy(actor, np.random.default_rng(training))
    rows = play(Search(episodes, DETECTOR, **CELLS[cell]), patrol, FRESH)
    return [{**game, **row} for row in rows]


def report(rows: pd.DataFrame) -> str:
    """A line for each patrol in each cell. All play the same swarms, which are the unit of the intervals."""
    swept = rows[rows.flight == "sweep"].set_index(["cell", "episode"]).J
    rows = rows.assign(more=rows.J - swept.reindex(pd.MultiIndex.from_frame(rows[["cell", "episode"]])).to_numpy())

    def each(part: pd.DataFrame) -> str:
        means = part.groupby("training").J.mean()
        return ", ".join(f"{value:.2f}" for value in means) if len(means) > 1 else "–"

    columns = {"n": size, "J": mean("J"), "J of each training": each, "J minus that of `sweep`": mean("more")}
    columns |= {"all heads hit": rate("success"), "coverage": mean("coverage")}
    rows = rows.assign(mean=rows.groupby(["cell", "flight"]).J.transform("mean"))  # the best flight of a cell is last
    rows = rows.sort_values(["cell", "mean"], ascending=[True, False], kind="stable")
    return pivot(rows, {"cell": "cell", "flight": "flight"}, columns)


def main(argv: list[str] | None = None) -> None:
    parser = shared.make_parser(__doc__, ROWS)
    parser.add_argument("--trainings", type=int, default=3, help="number of seeds")
    parser.add_argument("--episodes", type=int, default=100, help="games of a training")
    parser.add_argument("--decisions", type=int, default=DECISIONS, help="of a training")
    options = parser.parse_args(argv)
    flights = [(name, seed) for seed, name in product(range(options.trainings), ("IPPO", "MAPPO"))]
    flights += [(name, 0) for name in PATROLS]
    games = [{"cell": cell, "flight": name, "training": seed} for cell in CELLS for name, seed in flights]
    play_all = partial(measure, episodes=options.episodes, decisions=options.decisions)
    print(report(shared.run_missing(options, games, play_all)))


if __name__ == "__main__":
    main()
