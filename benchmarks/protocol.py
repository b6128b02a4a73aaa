"""Train observers that fly on drawn swarms, and test them in frozen scenarios, some with team mates of another kind.

    OMP_NUM_THREADS=1 python benchmarks/protocol.py           # goes on after the trainings that the rows have
    OMP_NUM_THREADS=1 python benchmarks/protocol.py --draw    # trains nothing: the table of the rows

As in Melting Pot (Leibo et al. 2021), no scenario but the first is of a kind that is met in training. PPO trains one
observer alone, IPPO and MAPPO three with the same weights, MAPPO with a critic that gets the true positions, QMIX three
with a mixture of their values by the true positions. All have the same network, which gives a number to each flight by
what is known about where it leads (:meth:`Team.look`). The rest is as in observers.py, but the detector of the tests.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from itertools import product
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import torch
from learners import fly_greedily, make_network, train_by_ppo, train_by_qmix
from paper import shared
from patrols import FLIGHTS, PATROLS, Patrol, Search, play
from pivot import markdown
from scipy.stats import trim_mean
from teams import Drawn, Team

ROWS = shared.RESULTS / "protocol.csv.gz"
DETECTOR, FRESH = "factions", 2_000_000  # no training reaches the seeds from FRESH on
LEARNERS = "PPO", "IPPO", "MAPPO", "QMIX", "untrained"
MORE = "IPPO, 5 times"  # the decisions of the others, in half as many trainings
DECISIONS = 120_000  # of a training


class Scenario(NamedTuple):
    """The arguments of a game that differ, and what all observers but the first ``learned`` fly."""

    arguments: dict[str, Any]
    mates: str = "sweep"
    learned: int | None = None


SCENARIOS = {
    "as drawn": Scenario({"follow": "random"}),
    "f3, to waypoints": Scenario({"follow": "f3", "mobility": "waypoint"}),
    "couzin flocks": Scenario({"follow": "couzin"}),
    "decoys and jitter": Scenario({"follow": "f1", "decoys": 6, "head_jitter": True}),
    "6 clusters of 48": Scenario({"follow": "f1", "clusters": 6, "uavs": 48}),
    "range 120 m": Scenario({"follow": "f1", "sensing_range": 120.0}),
    "2 observers": Scenario({"follow": "f1", "observers": 2}),
    "6 observers": Scenario({"follow": "f1", "observers": 6, "sensing_range": 150.0}),
    "2 mates sweep": Scenario({"follow": "f1"}, "sweep", 1),
    "1 mate stays": Scenario({"follow": "f1"}, "stay", 2),
}


def train(learner: str, seed: int, decisions: int) -> Patrol:
    """The patrol that a learner has learned."""
    with shared.isolate_torch(seed):
        games: Any = Drawn(1 if learner == "PPO" else 3, seed)
        actor = torch.nn.Sequential(make_network(games.look().shape[3], 1, 32), torch.nn.Flatten(-2))
        if learner == "QMIX":
            train_by_qmix(games, actor, decisions)
        elif learner != "untrained":
            times = 5 if learner == MORE else 1
            train_by_ppo(games, actor, learner == "MAPPO", times * decisions, rate=3e-3)
    return fly_greedily(actor)


def fly_at_random(search: Search) -> np.ndarray:
    """One of the flights for each observer."""
    rng = np.random.default_rng(int(search.seen["round"][0, 0, 0]))
    return FLIGHTS[rng.integers(len(FLIGHTS), size=search.places.shape[:2])]


SCRIPTED: dict[str, Patrol] = {**PATROLS, "random": fly_at_random}


def fly_with_mates(patrol: Patrol, mates: str, learned: int | None) -> Patrol:
    """The patrol in which all observers but the first ``learned`` fly another one."""

    def fly(search: Search) -> np.ndarray:
        flight = patrol(search).copy()
        if learned is not None:
            flight[:, learned:] = PATROLS[mates](search)[:, learned:]
        return flight

    return fly


def play_scenario(name: str, patrol: Patrol, alone: bool, episodes: int) -> list[dict[str, Any]]:
    """The rows of a patrol in a scenario."""
    arguments, *mates = SCENARIOS[name]
    search = Team(episodes, DETECTOR, **arguments)
    search.alone = alone
    rows = play(search, fly_with_mates(patrol, *mates), FRESH)
    return [{"scenario": name, **{key: row[key] for key in ("episode", "J", "success")}} for row in rows]


def measure(game: shared.Game, episodes: int, decisions: int) -> list[dict[str, Any]]:
    """The rows of a patrol in all scenarios; one that learns is trained first."""
    flight, training = game.values()
    patrol = SCRIPTED[flight] if flight in SCRIPTED else train(flight, training, decisions)
    tests = [play_scenario(name, patrol, flight == "PPO", episodes) for name in SCENARIOS]
    return [{**game, **row} for rows in tests for row in rows]


Means = dict[str, np.ndarray]  # of J for each flight, (samples, trainings, scenarios)


def score(means: Means, flight: str) -> np.ndarray:
    """The interquartile mean, over trainings and scenarios, of the way from random flights, 0, to the oracle, 1."""
    worst, best = means["random"], means["oracle of heads"]
    way = (worst - means[flight]) / (worst - best)
    return trim_mean(way.reshape(len(way), -1), 0.25, axis=1)


def gain(means: Means, flight: str, patrols: Sequence[str]) -> np.ndarray:
    """The rounds, a mean over scenarios, that a flight needs fewer than the best of some patrols in each scenario."""
    best = np.concatenate([means[name] for name in patrols], axis=1).min(axis=1)
    return (best - trim_mean(means[flight], 0.25, axis=1)).mean(axis=1)


def resample(games: Means, count: int) -> Means:
    """Draw trainings and, for all flights alike, swarms anew; the first sample is what was measured."""
    rng, (scenarios, swarms) = np.random.default_rng(0), games["random"].shape[1:]
    weights = rng.multinomial(swarms, np.full(swarms, 1 / swarms), size=(count, scenarios)) / swarms
    weights[0] = 1 / swarms
    means = {}
    for flight, played in games.items():
        drawn = rng.integers(len(played), size=(count, len(played)))
        drawn[0] = np.arange(len(played))
        means[flight] = np.take_along_axis(np.einsum("tse,rse->rts", played, weights), drawn[:, :, None], axis=1)
    return means


def report(rows: pd.DataFrame) -> str:
    """The board, and J in each scenario; the intervals draw trainings and swarms anew."""
    names = list(dict.fromkeys(rows.scenario))
    games = {
        flight: part.pivot_table(index="training", columns=["scenario", "episode"], values="J")[names].to_numpy()
        for flight, part in rows.groupby("flight")
    }
    means = resample({flight: array.reshape(len(array), len(names), -1) for flight, array in games.items()}, 1000)

    def show(values: np.ndarray) -> str:
        low, high = np.quantile(values, [0.025, 0.975])
        return f"{values[0]:.2f} ({low:.2f}–{high:.2f})"

    board = sorted(means, key=lambda flight: -score(means, flight)[0])
    rivals = ("frontier",), ("stay", "sweep", "follow", "frontier")
    lines = [
        [name, str(means[name].shape[1]), show(score(means, name)), *(show(gain(means, name, each)) for each in rivals)]
        for name in board
    ]
    middle = {name: trim_mean(means[name][0], 0.25, axis=0) for name in board}
    each = [[name, *(f"{middle[flight][place]:.1f}" for flight in board)] for place, name in enumerate(names)]
    header = ("flight", "trainings", "score", "rounds fewer than `frontier`", "than the best patrol of each scenario")
    return f"{markdown(header, lines)}\n\n{markdown(('J', *board), each)}"


def main(argv: list[str] | None = None) -> None:
    parser = shared.make_parser(__doc__, ROWS)
    parser.add_argument("--trainings", type=int, default=10, help="number of seeds")
    parser.add_argument("--episodes", type=int, default=100, help="swarms of a scenario")
    parser.add_argument("--decisions", type=int, default=DECISIONS, help="of a training")
    options = parser.parse_args(argv)
    flights = [(name, 0) for name in SCRIPTED]
    flights += [(name, seed) for seed, name in product(range(options.trainings), LEARNERS)]
    flights += [(MORE, seed) for seed in range(options.trainings // 2)]
    games = [{"flight": name, "training": seed} for name, seed in flights]
    play_all = partial(measure, episodes=options.episodes, decisions=options.decisions)
    print(report(shared.run_missing(options, games, play_all)))


if __name__ == "__main__":
    main()
