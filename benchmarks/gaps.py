"""Three rules for missed samples, in every detector that needs tracks without gaps. Resumable.

    OMP_NUM_THREADS=1 python benchmarks/gaps.py  # writes benchmarks/results/gaps.csv, prints the table

The seeds are below 1000: the rule of :func:`detectors.series.gaps.fill_gaps` was chosen by these games. Every rule
meets the same games, in small swarms, half of them with iid heads, half with Gauss-Markov heads and jitter.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from typing import Any
from unittest.mock import patch

import numpy as np
from detectors.studies.common import FOLLOW
from running import RESULTS, answer_help, play_games
from usnet_env.evaluation.episode import episode_seeds, play_episode
from usnet_env.evaluation.report import group_rows, mean_over_episodes

from detectors.clustering import make_clusterer
from usnet_env import Window
from usnet_env.envs import MultiClusterEnv, SingleClusterEnv
from usnet_env.evaluation.agents import as_agent
from usnet_env.objectives import purity

SEED = 100
RATES = (0.1, 0.3)
SMOOTH = {"mobility": "gauss_markov", "head_jitter": True}
P1 = {"neural-granger": {"followers": 8}, "gassl": {"followers": 4}}
P2 = {"clusters": 2, "uavs": 16}
#: Games of each follow strategy. Clusterers are measured by purity, P1 by the share of games in which the head alone is
#: named, P2 by J_m.
GAMES = {"neural-granger": 4, "gassl": 4, "lead-votes": 1, "mc-gassl": 2, "kmeans": 10, "spectral": 10}
CLUSTERERS = ("kmeans", "spectral")
USERS = (
    "detectors.gassl.topology_matrix",
    "detectors.neural_granger.inputs",
    "detectors.mc_gassl.features",
    "detectors.clustering.features",
)


def fill(window: Window, place: str, motion: str) -> Window:
    """Fill the gaps of a window.

    Args:
        window: the window.
        place: of a missed position: ``"linear"`` or ``"nearest"`` in time.
        motion: of a missed velocity: ``"difference"`` of the filled positions, ``"zero"``, or the ``"mean"`` of the
            UAV's seen velocities.
    """
    position, velocity = window.position.copy(), window.velocity.copy()
    instants, there = np.arange(len(position)), window.velocity_seen
    for uav in np.flatnonzero(window.alive & window.seen.any(axis=0)):
        known = np.flatnonzero(window.seen[:, uav])
        if place == "nearest":
            position[:, uav] = position[known[np.abs(instants[:, None] - known).argmin(axis=1)], uav]
        else:
            for axis in range(3):
                position[:, uav, axis] = np.interp(instants, known, position[known, uav, axis])
        missed = ~there[:, uav]
        if motion == "difference":
            velocity[missed, uav] = np.diff(position[:, uav], axis=0)[missed]
        elif motion == "mean" and there[:, uav].any():
            velocity[missed, uav] = velocity[~missed, uav].mean(axis=0)
    return Window(position, velocity, np.broadcast_to(window.alive, window.seen.shape), window.alive, window.round)


RULES = {
    "linear, difference": ("linear", "difference"),
    "nearest, zero": ("nearest", "zero"),
    "linear, mean": ("linear", "mean"),
}


@contextmanager
def using(rule: str) -> Iterator[None]:
    """Let all detectors fill gaps by a rule of ``RULES``."""
    with ExitStack() as stack:
        for user in USERS:
            stack.enter_context(patch(f"{user}.fill_gaps", lambda window: fill(window, *RULES[rule])))
        yield


def play(cell: Mapping[str, Any], seed: int) -> dict[str, Any]:
    """One game of a detector, or one window of a clusterer."""
    game = seed - SEED
    follow = FOLLOW[game // 2 % len(FOLLOW)]
    swarm: dict[str, Any] = {"follow": follow, "miss_rate": cell["miss_rate"], **(SMOOTH if game % 2 else {})}
    name = cell["detector"]
    with using(cell["rule"]):
        if name in CLUSTERERS:
            env = MultiClusterEnv(**P2, **swarm)
            window = Window.from_observation(env.reset(seed=episode_seeds(SEED, game)[0])[0])
            labels = make_clusterer(name, count=2).cluster(window, np.random.default_rng(game)).labels
            value = purity(env.swarm.root, labels)
        else:
            env = SingleClusterEnv(**P1[name], **swarm) if name in P1 else MultiClusterEnv(**P2, **swarm)
            row = play_episode(env, as_agent(name), name, game, episode_seeds(SEED, game))
            value = float(row["exact"] if name in P1 else row["J"])
    return {"follow": follow, "mobility": swarm.get("mobility", "iid"), "value": round(value, 5)}


def games() -> list[tuple[dict[str, Any], int]]:
    """All cells, the rules side by side, with the seeds of their games."""
    return [
        ({"detector": detector, "rule": rule, "miss_rate": rate}, SEED + number)
        for detector, count in GAMES.items()
        for rate in (RATES if count > 1 else RATES[1:])
        for rule in RULES
        for number in range(len(FOLLOW) * count)
    ]


def main() -> None:
    """Play the games that the file lacks, and print the means."""
    rows = play_games(RESULTS / "gaps.csv", games(), play, ("follow", "mobility", "value"))
    for cell, own in group_rows(rows, lambda row: (row["detector"], row["rule"], row["miss_rate"])).items():
        mean, low, high = mean_over_episodes(own, "value", "seed")
        what = "purity" if cell[0] in CLUSTERERS else "rate" if cell[0] in P1 else "J_m"
        print(*cell, f"{what} {mean:.3f} ({low:.3f}-{high:.3f}), n={len(own)}", sep=", ")


if __name__ == "__main__":
    answer_help(__doc__)
    main()
