"""Ceilings: how often an oracle that knows the law of a cell and its constants, but no head, names all heads exactly.

    OMP_NUM_THREADS=1 python benchmarks/ceilings.py --rows out/ceilings.csv
    python benchmarks/ceilings.py --rows out/ceilings.csv --draw            # plays nothing: the table of the rows

The oracle flies the follow strategy itself one step ahead from the observed past, under each hypothesis "i follows j".
So it has each UAV's delay, gain and noise, and the likelihood of what i did next. A UAV that its own past explains
better is a head or alone. The oracle follows each chain to its end, and names an end that has two followers.

Nothing is assumed of how heads fly, so this is less than the exact likelihood, and a detector may beat it. Flocks,
hierarchies in which UAVs copy several others, other kinematics than ``unit``, noise of positions, missed or exchanged
samples, and slower observers have no oracle here.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any
from zlib import crc32

import numpy as np
import pandas as pd
from paper.shared import Game, measure, open_cell, parse
from pivot import pivot, rate, size

from usnet_env import Window
from usnet_env.evaluation import load_suite
from usnet_env.objectives import find_roots
from usnet_env.swarm import SwarmConfig, kernels
from usnet_env.swarm.flock_follow import Flock
from usnet_env.swarm.state import SwarmState
from usnet_env.swarm.strategy import TrajectoryBatch

LEAST = 2  # followers of a head
PAST = 2  # steps of a UAV's own past that explain the next


def has_oracle(config: SwarmConfig) -> bool:
    """Whether a swarm of this kind can be computed."""
    strategy = config.follow_strategy
    followed = strategy is not None and strategy.has_followers and not strategy.shifts_tracks
    followed = followed and not isinstance(strategy, Flock) and getattr(strategy, "links", 1) == 1
    faults = (config.position_noise, config.miss_rate, config.partial_tracks, config.swap_rate, config.clutter)
    return followed and config.kinematics == "unit" and config.sample_every == 1 and not any(faults)


def predict(
    config: SwarmConfig, state: SwarmState, position: np.ndarray, velocity: np.ndarray, source: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """What each UAV does next if it copies ``source`` ``(N,)``; those with source -1 are free.

    Returns, for the steps L to T - 1, the velocities without noise ``(T - L, N, 3)``, and the scale ``(T - L, N)`` of
    the noise on each axis across them.
    """
    strategy, (steps, uavs, _) = config.follow_strategy, velocity.shape
    lags = max(strategy.lags, 1)
    count = steps - lags
    when = np.arange(count)[:, None]
    places, moves = position[when + np.arange(lags + 2)], velocity[when + np.arange(lags + 1)]
    motion = np.where(source >= 0, kernels.FOLLOWS, kernels.FREE).astype(np.int8)
    motion, root, parameters, bystander = (
        np.repeat(values[None], count, axis=0) for values in (motion, source, state.parameters, state.bystander)
    )
    clock = state.clock - steps + lags + np.arange(count)
    pushes = np.zeros((4, count, 1, uavs, 3), np.float32)
    for axis in range(3):
        pushes[1 + axis, ..., axis] = 0.05
    flown = []
    for push in pushes:
        batch = places.copy(), moves.copy(), push, motion, root, parameters, root, bystander, clock
        strategy.fly(TrajectoryBatch(*batch))
        flown.append(batch[1][:, lags].astype(np.float64))
    response = (np.stack(flown[1:]) - flown[0]) / 0.05
    return flown[0], np.sqrt(np.square(response).sum(axis=(0, 3)) / 2)  # no noise along the course


def explain_alone(velocity: np.ndarray) -> np.ndarray:
    """``(N,)`` log-likelihood of velocities ``(T, N, 3)``, given the own ones before, at the best coefficients."""
    steps, uavs, _ = velocity.shape
    found = np.empty(uavs)
    for i in range(uavs):
        own = np.stack([velocity[PAST - k - 1 : steps - k - 1, i].ravel() for k in range(PAST)], axis=1)
        target = velocity[PAST:, i].ravel()
        rest = target - own @ np.linalg.lstsq(own, target, rcond=None)[0]
        found[i] = -0.5 * len(rest) * (np.log(np.mean(rest**2) + 1e-12) + 1) - 0.5 * PAST * np.log(len(rest))
    return found


def explain_by(config: SwarmConfig, state: SwarmState, window: Window) -> np.ndarray:
    """``(N, N)`` log-likelihood of UAV i if it copies j."""
    uavs, found = window.uavs, np.full((window.uavs, window.uavs), -np.inf)
    for j in range(uavs):
        others = np.arange(uavs) != j
        guess, scale = predict(config, state, window.position, window.velocity, np.where(others, j, -1))
        rest, variance = window.velocity[-len(guess) :].astype(np.float64) - guess, scale[:, others] ** 2
        likelihood = -0.5 * np.square(rest[:, others]).sum(axis=2) / variance - 1.5 * np.log(variance)
        found[others, j] = likelihood.sum(axis=0)
    return found


def name_leaders(config: SwarmConfig, state: SwarmState, window: Window) -> np.ndarray:
    """``(N,)`` bool: the heads of a swarm in which UAVs copy others."""
    lags = max(config.follow_strategy.lags, 1)
    alone = explain_alone(window.velocity[max(lags - PAST, 0) :].astype(np.float64))
    gain = explain_by(config, state, window) - alone[:, None] - np.log(window.uavs)
    above = np.where(gain.max(axis=1) > 0, gain.argmax(axis=1), -1)
    while (circle := np.flatnonzero(find_roots(above) < 0)).size:  # the weakest link of a circle is none
        above[circle[gain[circle, above[circle]].argmin()]] = -1
    roots = find_roots(above)
    return np.bincount(roots[roots != np.arange(len(roots))], minlength=len(roots)) >= LEAST


def play(game: Game, seed: int) -> list[dict[str, Any]]:
    """Let the oracle answer the first round of an episode."""
    env = open_cell(game["suite"], game["cell"])
    number = [seed, crc32(f"{game['suite']}/{game['cell']}".encode()), game["episode"]]
    observation, _ = env.reset(seed=int(np.random.default_rng(number).integers(2**63)))
    state, window = env.swarm, Window.from_observation(observation)
    named = name_leaders(env.config, state, window)
    right = {"exact": int((named == state.head).all()), "missed": (state.head & ~named).sum()}
    return [{**game, **right, "false": (named & ~state.head).sum()}]


def report(rows: pd.DataFrame) -> str:
    """A line for each cell."""
    columns = {"n": size, "the oracle is exact": rate("exact")}
    columns |= {name: lambda part, name=name: f"{part[name].mean():.2f}" for name in ("missed", "false")}
    return pivot(rows, {"suite": "suite", "cell": "cell"}, columns)


def main(argv: list[str] | None = None) -> None:
    parser = parse(__doc__, Path("out/ceilings.csv"))
    parser.add_argument("--suite", nargs="+", default=["limit"])
    parser.add_argument("--cell", nargs="+", help="by default all that have an oracle")
    parser.add_argument("--episodes", type=int, default=50)
    given = parser.parse_args(argv)
    cells = [
        (suite, cell) for suite in given.suite for cell in load_suite(suite).cells if cell in (given.cell or [cell])
    ]
    cells = [(suite, cell) for suite, cell in cells if load_suite(suite).cells[cell].env == "USNET/MultiCluster-v0"]
    cells = [names for names in cells if has_oracle(open_cell(*names).config)]
    games = [{"suite": suite, "cell": cell, "episode": k} for suite, cell in cells for k in range(given.episodes)]
    print(report(measure(given, games, partial(play, seed=given.seed))))


if __name__ == "__main__":
    main()
