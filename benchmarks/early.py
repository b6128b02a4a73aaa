"""How many steps of a window detectors need: J_m against T_ob, in games of three clusters.

    OMP_NUM_THREADS=1 python benchmarks/early.py
    python benchmarks/early.py --draw                        # plays nothing: the picture of the rows

A row is an episode.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
from paper import shared

from usnet_env import evaluate

ROWS = shared.RESULTS / "early.csv.gz"
PICTURE = shared.IMAGES.parent / "early.png"
STEPS = (6, 8, 12, 20, 40, 80)
DETECTORS = (
    "reader(policy='map')", "reader", "lagged-network", "net-lag-regression", "lagged-regression", "factions",
    "directional-delays", "destroy-all",
)  # fmt: skip
SWARM: dict[str, Any] = {"clusters": 3, "uavs": 24, "max_rounds": 10}
EPISODES, GRADES = 50, (1, 2, 5, 10)


def play(game: shared.Game) -> list[dict[str, Any]]:
    """Play all episodes of a detector at a T_ob."""
    swarm = SWARM | {"observation_steps": game["steps"]}
    found = evaluate("USNET/MultiCluster-v0", game["detector"], episodes=EPISODES, seed=shared.SEED, env_kwargs=swarm)
    return [game | row for row in found.rows[["episode", "J", "exact"]].to_dict("records")]


def draw(rows: pd.DataFrame) -> None:
    """A curve for each detector."""
    figure, ((axes,),) = shared.panels(7.5, 4)
    for name, look in shared.make_looks(DETECTORS, 4).items():
        found = [shared.interval(rows[(rows.detector == name) & (rows.steps == steps)], "J") for steps in STEPS]
        middle, low, high = np.transpose(found)
        axes.errorbar(STEPS, middle, [middle - low, high - middle], lw=1.2, label=name, **look)
    axes.set(xlabel="T_ob, steps that are observed", ylabel="J_m", xscale="log", yscale="log")
    axes.minorticks_off()
    axes.set_xticks(STEPS, STEPS)
    axes.set_yticks(GRADES, GRADES)
    caption = f"Three clusters, 24 UAVs, f1; means of {EPISODES} games with 95 % intervals."
    shared.save_figure(figure, PICTURE, "How many steps detectors need", caption)


def main(argv: list[str] | None = None) -> None:
    given = shared.parse(__doc__, ROWS).parse_args(argv)
    games = [{"detector": name, "steps": steps} for name in DETECTORS for steps in STEPS]
    draw(shared.measure(given, games, play))


if __name__ == "__main__":
    main()
