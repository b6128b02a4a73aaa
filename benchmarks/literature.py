"""Experiments of the literature on leaders, with the field models and the detectors of this project.

    python benchmarks/literature.py            # adds what is missing to benchmarks/results/literature.csv

``minority`` (Couzin et al., Nature 433, 2005): how well an informed minority steers its flock, by the informed share
and the size of the flock. The value is the cosine of the angle between the course of the flock in its last window and
the course that the minority prefers. ``vicsek`` (Mwaffo, Butail and Porfiri, Frontiers in Robotics and AI 4, 2017):
whether the leader of a Vicsek flock has the highest score of a detector, by the range of alignment and the noise.
``hierarchy`` (Nagy et al., Nature 464, 2010): Kendall's rank correlation of the delays behind the head, as directional
correlation with the head finds them, with the true delays, by the noise; and whether the head has the highest score.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray
from running import RESULTS, answer_help, play_games
from scipy.stats import kendalltau

from usnet_env import Window, make_detector
from usnet_env.swarm import ObservationBatch, SwarmConfig, SwarmState, advance, start
from usnet_env.swarm.field_follow import Pigeons
from usnet_env.swarm.field_kernels import DELAY
from usnet_env.swarm.flock_follow import Informed, Vicsek

SEED, GAMES = 60_613, 100
SHARES, SIZES = (0.0, 0.02, 0.05, 0.1, 0.2, 0.4), (10, 30, 100)
RANGES, NOISES = (10, 20, 40, 80, 160), (0.05, 0.2, 0.5)
DETECTORS = ("directional-delays", "lagged-network", "net-lag-regression", "lagged-correlation", "follow-mixture")
VALUES = ("value", "head_first")
Cell = dict[str, Any]


def list_cells() -> Iterator[Cell]:
    """All settings; what a setting does not use is empty."""
    empty = {"size": "", "share": "", "range": "", "noise": "", "detector": ""}
    for size in SIZES:
        for share in SHARES:
            if share == 0 or round(share * size) >= 1:
                yield {"experiment": "minority", **empty, "size": size, "share": share}
    for noise in NOISES:
        for detector in DETECTORS:
            for reach in RANGES:
                found = {"range": reach, "noise": noise, "detector": detector}
                yield {"experiment": "vicsek", **empty, **found}
            yield {"experiment": "hierarchy", **empty, "noise": noise, "detector": detector}


def fly(windows: int, seed: int, **arguments: Any) -> tuple[SwarmState, ObservationBatch]:
    """The last window of one cluster, and the state after it."""
    config = SwarmConfig(**{"clusters": 1, "memory": 12, "formation": "around", **arguments})
    rng = np.random.default_rng(seed)
    state = start(config, [rng])
    for _ in range(windows):
        state, observed = advance(config, state, [rng])
    return state.episode(), observed


def unit(vector: NDArray[Any]) -> NDArray[Any]:
    """Vectors of length 1 along the last axis."""
    return vector / np.maximum(np.linalg.norm(vector, axis=-1, keepdims=True), 1e-12)


def steer(cell: Mapping[str, Any], seed: int) -> dict[str, float]:
    """How well the minority steers; a share of 0 has one informed UAV with the weight 0."""
    weight = 0.5 if cell["share"] else 0.0
    follow = Informed(share=float(cell["share"]), preference=weight, alignment=60.0, attraction=60.0, attract=1.0)
    state, observed = fly(10, seed, follow=follow, uavs=int(cell["size"]), mobility="straight")
    course = state.reference_velocity[-1, 0]
    return {"value": float(unit(observed.velocity[0].mean(axis=(0, 1))) @ course)}


def rank_head(cell: Mapping[str, Any], seed: int, state: SwarmState, observed: ObservationBatch) -> float:
    """Whether the head has the highest score of a detector; ties count as their share."""
    detector = make_detector(cell["detector"])
    detector.reset(seed)
    window = Window(observed.position[0], observed.velocity[0], observed.seen[0], observed.alive[0])
    scores = detector.detect(window).scores
    best = scores == scores.max()
    return float(state.head[best].sum() / best.sum())


def find_leader(cell: Mapping[str, Any], seed: int) -> dict[str, float]:
    """Whether the leader of a Vicsek flock of 20 UAVs has the highest score."""
    follow = Vicsek(alignment=float(cell["range"]), noise=float(cell["noise"]))
    state, observed = fly(1, seed, follow=follow, uavs=20, mobility="smooth_turn")
    return {"value": rank_head(cell, seed, state, observed)}


def find_hierarchy(cell: Mapping[str, Any], seed: int) -> dict[str, float]:
    """How well delays behind the head are found in a flock of 10 UAVs, and whether the head has the highest score."""
    follow = Pigeons(noise=float(cell["noise"]))
    state, observed = fly(2, seed, follow=follow, uavs=10, mobility="smooth_turn")
    own = state.parameters.reshape(-1, 10)[DELAY]
    true = np.zeros(10)
    for i in range(10):
        above = i
        while state.source[above] != above:
            true[i] += own[above]
            above = state.source[above]
    course = unit(observed.velocity[0])
    head = int(np.flatnonzero(state.head)[0])
    lags = range(-12, 13)
    found = []
    for i in range(10):
        later, earlier = course[12:-12, i], course[:, head]
        found.append(lags[int(np.argmax([(later * earlier[12 - lag : len(course) - 12 - lag]).sum() for lag in lags]))])
    return {"value": float(kendalltau(found, true).statistic), "head_first": rank_head(cell, seed, state, observed)}


def play(cell: Mapping[str, Any], number: int) -> dict[str, Any]:
    """One game of a setting."""
    function = {"minority": steer, "vicsek": find_leader, "hierarchy": find_hierarchy}[cell["experiment"]]
    found = function(cell, SEED + number)
    return {name: f"{found[name]:.4f}" if name in found else "" for name in VALUES}


if __name__ == "__main__":
    answer_help(__doc__)
    games = [(cell, number) for cell in list_cells() for number in range(GAMES)]
    play_games(RESULTS / "literature.csv", games, play, VALUES, number="game")
