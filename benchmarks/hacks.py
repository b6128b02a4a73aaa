"""What rules earn that look for no links: they name none, all, half, one at random or by its own track, in every game.

    OMP_NUM_THREADS=1 python benchmarks/hacks.py        # plays what the rows lack
    python benchmarks/hacks.py --draw                   # plays nothing: the table of the rows

A row is a game; all rules play the same swarms. In Probing rules name one UAV, by its track when the window is full, or
at once. Each of several observers votes by the rule.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import gymnasium as gym
import numpy as np
import pandas as pd
from evasion import GAME
from paper import shared
from pivot import across, mean, pivot
from probing import ALL, CELLS

import usnet_env.envs  # noqa: F401  # registers the environments
from usnet_env.arrays import Floats, Mask, Observation
from usnet_env.multiagent import usnet_evasion_v0, usnet_observers_v0

ROWS, EPISODES = shared.RESULTS / "hacks.csv.gz", 200
#: A batch of games: its first windows, and what names ``(B, ..., N)`` lead to: windows, rewards, and which are over.
Start = tuple[Observation, Callable[[Mask], tuple[Observation, Floats, Mask]]]


def find_turns(window: Observation) -> Floats:
    """The mean angle between two successive velocities of each UAV, radians."""
    heading = window["velocity"] / np.maximum(np.linalg.norm(window["velocity"], axis=-1, keepdims=True), 1e-9)
    return np.arccos((heading[..., 1:, :, :] * heading[..., :-1, :, :]).sum(axis=-1).clip(-1, 1)).mean(axis=-2)


def find_steadiness(window: Observation) -> Floats:
    """Minus the standard deviation of each UAV's speed."""
    return -np.linalg.norm(window["velocity"], axis=-1).std(axis=-2)


def name_by_track(score: Floats, window: Observation, alive: Mask) -> Mask:
    """The living UAV with the greatest score of its track; in Probing none before the window is full."""
    full = window["elapsed"] >= window["velocity"].shape[1] if "elapsed" in window else True
    return name_best(score, alive & full)


def name_best(score: Floats, alive: Mask) -> Mask:
    """The living UAV with the greatest score."""
    best = np.where(alive, score, -np.inf).argmax(axis=-1)
    return (np.arange(alive.shape[-1]) == best[..., None]) & alive


#: Which UAVs a rule names, from a window, the UAVs that may be named, and random numbers of them.
RULES: dict[str, Callable[[Observation, Mask, Floats], Mask]] = {
    "none": lambda window, alive, chance: np.zeros_like(alive),
    "all": lambda window, alive, chance: alive,
    "half": lambda window, alive, chance: alive & (chance < 0.5),
    "one at random": lambda window, alive, chance: name_best(chance, alive),
    "the first": lambda window, alive, chance: name_best(-np.arange(alive.shape[-1]) + 0 * chance, alive),
    "largest turns": lambda window, alive, chance: name_by_track(find_turns(window), window, alive),
    "smallest turns": lambda window, alive, chance: name_by_track(-find_turns(window), window, alive),
    "steadiest speed": lambda window, alive, chance: name_by_track(find_steadiness(window), window, alive),
}


def start_solo(id: str, **arguments: Any) -> Start:
    """Games of one agent."""
    envs = gym.make_vec(id, EPISODES, autoreset_mode="SameStep", **arguments).unwrapped

    def step(named: Mask) -> tuple[Observation, Floats, Mask]:
        seen, reward, terminated, truncated, _ = envs.step(named.astype(np.int8))
        return seen, reward, terminated | truncated

    return envs.reset(seed=shared.SEED)[0], step


def start_probing(cell: str) -> Start:
    """Games of Probing with an intruder that stays where it is."""
    envs = gym.make_vec("USNET/Probing-v1", EPISODES, autoreset_mode="SameStep", **ALL, **CELLS[cell]).unwrapped
    steer = np.zeros((EPISODES, 1, 3), np.float32)

    def step(named: Mask) -> tuple[Observation, Floats, Mask]:
        name = np.where(named.any(axis=1), named.argmax(axis=1), named.shape[1])
        return envs.step({"steer": steer, "name": name})[:3]

    return envs.reset(seed=shared.SEED)[0], step


def start_votes(module: Any, choose: bool = False, **arguments: Any) -> Start:
    """Games of several agents; each observer votes by the rule, and heads choose nothing, or at random."""
    games, rng = module.batch_env(EPISODES, **arguments), np.random.default_rng(shared.SEED)

    def step(named: Mask) -> tuple[Observation, Floats, Mask]:
        actions = {"observer": named.astype(np.int8)}
        if "head" in games.roles:
            most = games.action_spaces["head"].nvec if choose else 1
            actions["head"] = rng.integers(most, size=(EPISODES, games.roles["head"], 4))
        seen, reward, *_ = games.step(actions)
        over = ~games.active["observer"][:, 0]
        if over.any():
            seen, _ = games.reset(games=over)
        return seen["observer"], reward["observer"][:, 0], over

    return games.reset(seed=shared.SEED)[0]["observer"], step


P1, P2 = ("USNET/SingleCluster-{}-v0".format, "USNET/MultiCluster-{}-v0".format)
#: How to start each game.
GAMES: dict[str, Callable[[], Start]] = {
    "P1 Tiny": partial(start_solo, P1("Tiny")),
    "P1 Hard": partial(start_solo, P1("Hard")),
    "P1 Field": partial(start_solo, P1("Field")),
    "P2 Small": partial(start_solo, P2("Small")),
    "P2 Small, price 3": partial(start_solo, P2("Small"), redundancy_price=3),
    "Field-v1": partial(start_solo, "USNET/Field-v1"),
    "Field-v1, price 3": partial(start_solo, "USNET/Field-v1", redundancy_price=3),
    "Probing, noise 1 m": partial(start_probing, "the same, noise 1 m"),
    "observers": partial(start_votes, usnet_observers_v0, uavs=30, clusters=3, observation_steps=30, max_rounds=6),
    "evasion, heads choose nothing": partial(start_votes, usnet_evasion_v0, **GAME),
    "evasion, heads choose at random": partial(start_votes, usnet_evasion_v0, choose=True, **GAME),
}


def play(game: shared.Game) -> list[dict[str, Any]]:
    """Play all games of a kind by a rule."""
    rng, left, total = np.random.default_rng(shared.SEED), np.ones(EPISODES, bool), np.zeros(EPISODES)
    seen, step = GAMES[game["game"]]()
    while left.any():  # a game that is over begins again, but what follows doesn't count
        alive = seen["legal" if "legal" in seen else "alive"].astype(bool)
        seen, reward, over = step(RULES[game["rule"]](seen, alive, rng.random(alive.shape)))
        total[left] += reward[left]
        left &= ~over
    return [game | {"episode": episode, "reward": reward} for episode, reward in enumerate(total)]


def report(rows: pd.DataFrame) -> str:
    """A line for each game, in their order, and a column for each rule."""
    rows = rows.sort_values("game", key=lambda names: names.map(list(GAMES).index), kind="stable")
    return pivot(rows, {"game": "game"}, across("rule", RULES, mean("reward")))


def main(argv: list[str] | None = None) -> None:
    options = shared.make_parser(__doc__, ROWS).parse_args(argv)
    games = [{"game": game, "rule": rule} for game in GAMES for rule in RULES]
    print(report(shared.run_missing(options, games, play)))


if __name__ == "__main__":
    main()
