"""Plays follow-mixture, learned, lagged-regression and the trivial policies in groups of swarms, the tiers. Resumable.

    OMP_NUM_THREADS=1 python benchmarks/follow_mixture.py --tier paper --episodes 300 --detectors follow-mixture
    python benchmarks/follow_mixture.py --list            # the cells of every tier
    python benchmarks/follow_mixture.py --results out --pack rows.csv.gz    # the rows of all tiers in one file

Each episode is one row of ``benchmarks/results/follow_mixture/<tier>.csv``, written when it ends. Episodes that the
file holds are not played again. The column ``detector`` is the detector's full name with every argument that differs
from its default. The seeds of swarm and detector come from ``--seed`` (7077 by default) and the number of the episode,
so that all detectors meet the same swarms. ``benchmarks/tables.py`` makes the tables; ``benchmarks/README.md`` lists
the exact command of every file.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from follow_mixture_strategies import STRATEGIES
from numpy.typing import NDArray
from running import RESULTS, make_parser, play_games, write_csv
from usnet_env.evaluation.episode import episode_seeds
from usnet_env.evaluation.report import group_rows
from usnet_env.evaluation.table import read_table

from usnet_env import Detection, Window
from usnet_env.envs import MultiClusterEnv, SingleClusterEnv
from usnet_env.envs.play import play_rounds
from usnet_env.objectives import average_precision, multi_cluster_objective, single_cluster_objective
from usnet_env.plugins import detector_label, make_detector

FOLDER = RESULTS / "follow_mixture"
DETECTORS = ("follow-mixture", "lagged-regression", "granger", "factions", "destroy-all", "random", "none")
SEED = 7077  # of the published rows; seeds below 1000 are for tuning
PAPER = ("f1", "f2", "f3", "f4", "f5", "f6", "f7")
SMOOTH = ("gauss_markov", "smooth_turn", "local_waypoint")
JITTERED = {"mobility": "gauss_markov", "head_jitter": True}
LONG = {"clusters": 3, "uavs": 30, "observation_steps": 900}  # 30 samples a UAV: five autocorrelation times
#: Edges of the bins of probability: fine where a swarm has most of its UAVs.
EDGES = (0, 0.001, 0.003, 0.01, 0.03, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.97, 0.99, 1)
EVERY_MOBILITY = ("iid", "gauss_markov", "smooth_turn", "waypoint", "local_waypoint", "straight")


@dataclass(frozen=True)
class Cell:
    """One kind of episode.

    Args:
        tier: name of the group, and of the file.
        name: within the tier; it begins with the follow strategy.
        env: arguments of the environment.
        kind: ``P2`` (a game of several rounds), ``P1``, ``silence`` (no UAV follows another: the right answer is empty)
            or ``shifted`` (every track is shifted in time by a different amount: the right answer is empty). Of the
            last two kinds one window is played.
        episodes: the default number of episodes.
    """

    tier: str
    name: str
    env: dict[str, Any] = field(default_factory=dict)
    kind: str = "P2"
    episodes: int = 50

    @property
    def empty(self) -> bool:
        """Whether the right answer names no UAV."""
        return self.kind in ("silence", "shifted")

    def make_env(self) -> MultiClusterEnv | SingleClusterEnv:
        """Make its environment."""
        return (SingleClusterEnv if self.kind == "P1" else MultiClusterEnv)(**self.env)


def cells() -> list[Cell]:
    """All cells, tier by tier."""
    found: list[Cell] = []

    def add(tier: str, name: str, episodes: int = 50, kind: str = "P2", **env: Any) -> None:
        """Add a cell for each strategy of the paper."""
        for follow in PAPER:
            found.append(Cell(tier, f"{follow}-{name}", {"follow": follow, **env}, kind, episodes))

    found += [Cell("paper", f, {"follow": f}, episodes=300) for f in PAPER]
    sizes = ((2, 20), (3, 45), (5, 50), (8, 185), (10, 120), (20, 237))
    found += [Cell("sizes", f"{f}-M{m}-N{n}", {"follow": f, "clusters": m, "uavs": n}) for f in PAPER for m, n in sizes]
    for mobility in SMOOTH:
        add("smooth", mobility, mobility=mobility, head_jitter=True)
    add("straight", "jitter", mobility="straight", head_jitter=True)
    add("straight", "bare", mobility="straight", head_jitter=False)
    for steps in (8, 12, 20, 50):
        add("short", f"T{steps}", observation_steps=steps)
    for sigma in (0.1, 0.3, 0.5, 1.0):
        add("noise", f"{sigma}", position_noise=sigma)
    for sigma in (0.1, 0.3, 0.5):
        add("noise", f"gauss_markov-{sigma}", **JITTERED, position_noise=sigma)
    for rate in (0.1, 0.3):
        add("missed", f"{rate}", miss_rate=rate)
    add("sampled", "2", 20, sample_every=2)
    for mobility in EVERY_MOBILITY:
        for name, jitter in (("jitter", True), ("bare", False)):
            env = {"follow": "none", "mobility": mobility, "head_jitter": jitter}
            found.append(Cell("silence", f"none-{mobility}-{name}", env, "silence", 100))
        add("shifted", mobility, 30, "shifted", mobility=mobility, head_jitter=True, **LONG)
    for decoys in (1, 3, 10):
        for mobility in ("iid", "gauss_markov"):
            env = {"mobility": mobility, "head_jitter": mobility != "iid", "decoys": decoys, "uavs": 82 + decoys}
            add("decoys", f"{mobility}-{decoys}", **env)
    found += [
        Cell("P1", f"{f}-m{m}-d{d}", {"follow": f, "followers": m, "decoys": d}, "P1", 100)
        for f in PAPER
        for m, d in ((2, 1), (2, 0), (15, 1))
    ]
    found += [Cell("strategies", f, {"follow": f}) for f in STRATEGIES]
    found += [Cell("strategies", f"{f}-gauss_markov", {"follow": f, **JITTERED}) for f in STRATEGIES]
    return found


VALUES = (
    "uavs", "heads", "J", "rounds", "exact", "named", "false_first", "missed_first", "decoys_named", "ap", "brier",
    "reliability", "seconds",
)  # fmt: skip
COLUMNS = ("tier", "cell", "detector", "seed", "episode", *VALUES)


def shifted_tracks(window: Window, seed: int) -> Window:
    """The window with every UAV's velocities shifted circularly by a different amount, and positions integrated anew.

    The shifts of any two UAVs differ by at least T_ob / N samples: two followers of one head whose shifts differ by
    less than the memory would look like a head and its follower.
    """
    steps, uavs = window.observation_steps, window.uavs
    velocity = window.velocity.copy()
    for uav, order in enumerate(np.random.default_rng(seed).permutation(uavs)):
        velocity[:, uav] = np.roll(velocity[:, uav], order * (steps // uavs), axis=0)
    position = np.concatenate([window.position[:1], window.position[:1] + np.cumsum(velocity, axis=0)])
    return Window(position, velocity, window.seen, window.alive, window.round)


def binned(probability: NDArray[np.float64], head: NDArray[np.bool_]) -> str:
    """``bin:UAVs:heads`` for every non-empty bin between :data:`EDGES`, separated by spaces."""
    bins = np.digitize(probability, EDGES[1:-1])
    uavs, heads = (np.bincount(part, minlength=len(EDGES) - 1) for part in (bins, bins[head]))
    return " ".join(f"{number}:{uavs[number]}:{heads[number]}" for number in np.flatnonzero(uavs))


@cache
def detector_of(label: str) -> Any:
    """This process's detector of that name."""
    return make_detector(label)


def play(cell: Cell, label: str, seed: int, episode: int) -> dict[str, Any]:
    """Play one episode. ``J`` is J_m (P2), J_s (P1), or the number of candidates (other kinds)."""
    swarm_seed, detector_seed = episode_seeds(seed, episode)
    detector = detector_of(label)
    detector.reset(detector_seed)

    def answer(observation: Any, truth: Any) -> Detection:
        window = Window.from_observation(observation)
        return detector.detect(shifted_tracks(window, detector_seed) if cell.kind == "shifted" else window)

    env = cell.make_env()
    begun = time.perf_counter()
    played = list(islice(play_rounds(env, answer, swarm_seed), 1 if cell.empty else None))
    seconds = (time.perf_counter() - begun) / len(played)
    truth, first = played[0].truth, played[0].answer
    alive, head = truth.alive, truth.head & (not cell.empty)
    rounds = np.array([each.answer.candidates for each in played])
    if cell.kind == "P2":
        value = multi_cluster_objective(truth.head, rounds)
    elif cell.kind == "P1":
        value = float(single_cluster_objective(truth.head, rounds[0]))
    else:
        value = float(rounds[0].sum())
    probability = first.extras.get("probability")
    return {
        "uavs": len(head),
        "heads": int(head.sum()),
        "J": round(value, 5),
        "rounds": len(played),
        "exact": int(np.array_equal(rounds[0], head)),
        "named": int(rounds[0].sum()),
        "false_first": int((rounds[0] & ~head).sum()),
        "missed_first": int((head & ~rounds[0]).sum()),
        "decoys_named": int((rounds[0] & truth.decoy).sum()),
        "ap": round(average_precision(head, first.scores), 4),
        "brier": "" if probability is None else round(float(((probability - head) ** 2).mean()), 6),
        "reliability": "" if probability is None else binned(probability[alive], head[alive]),
        "seconds": round(seconds, 5),
    }


def pack_rows(results: Path, path: Path) -> None:
    """Write the complete rows of all tiers in a folder to one compressed file."""
    tiers = dict.fromkeys(cell.tier for cell in cells())
    texts = dict.fromkeys(COLUMNS, "str")
    write_csv(path, [row for tier in tiers for row in read_table(results / f"{tier}.csv", texts)], COLUMNS)


@cache
def label_of(name: str) -> str:
    """The label of a detector's rows: its name with the arguments that differ from their defaults."""
    return detector_label(make_detector(name))


def measure(wanted: list[Cell], detectors: list[str], episodes: int | None, seed: int, results: Path) -> None:
    """Play the episodes that the files lack, and append their rows."""
    for tier, own in group_rows(wanted, lambda cell: cell.tier).items():
        by_name = {cell.name: cell for cell in own}
        games = [
            ({"tier": tier, "cell": cell.name, "detector": label_of(name), "seed": seed}, episode)
            for cell in own
            for name in detectors
            for episode in range(cell.episodes if episodes is None else episodes)
        ]

        def play_one(game: Mapping[str, Any], episode: int, by_name: Mapping[str, Cell] = by_name) -> dict[str, Any]:
            return play(by_name[game["cell"]], game["detector"], seed, episode)

        if games:
            play_games(results / f"{tier}.csv", games, play_one, VALUES, "episode")


def parser() -> argparse.ArgumentParser:
    """The command line."""
    made = make_parser(__doc__)
    made.add_argument("--tier", nargs="*", help="only these tiers")
    made.add_argument("--cell", nargs="*", help="only cells whose names contain one of these")
    made.add_argument("--episodes", type=int, help="of each cell; by default the cell's own number")
    made.add_argument("--seed", type=int, default=SEED)
    made.add_argument("--detectors", nargs="*", default=list(DETECTORS))
    made.add_argument("--results", type=Path, default=FOLDER)
    made.add_argument("--pack", type=Path, help="write the rows of all tiers to this file and play nothing")
    made.add_argument("--list", action="store_true", help="list the cells and play nothing")
    return made


def chosen(arguments: argparse.Namespace) -> list[Cell]:
    """The cells that the command line asks for."""
    return [
        cell
        for cell in cells()
        if (not arguments.tier or cell.tier in arguments.tier)
        and (not arguments.cell or any(part in cell.name for part in arguments.cell))
    ]


def main() -> None:
    """List the cells, or play."""
    arguments = parser().parse_args()
    wanted = chosen(arguments)
    if arguments.list:
        for cell in wanted:
            print(cell.tier, cell.name, cell.kind, cell.episodes, cell.env)
        return
    if arguments.pack is not None:
        pack_rows(arguments.results, arguments.pack)
        return
    measure(wanted, arguments.detectors, arguments.episodes, arguments.seed, arguments.results)


if __name__ == "__main__":
    main()
