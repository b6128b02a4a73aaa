"""What every threshold of follow-mixture is worth: each is switched off or moved alone, on the same windows. Resumable.

    OMP_NUM_THREADS=1 python benchmarks/threshold_ablation.py --games 4
    python benchmarks/threshold_ablation.py --list     # the changes

The windows are the first ones of ``--games`` games of every cell of ``follow_mixture.py``, on a tuning seed; of the
cells of the frozen suites ``field``, ``controls`` and ``sensing``, on their tuning seeds; and of ``--random`` swarms of
the calibration's grammar (``detectors.follow_mixture.train``), which are played a second time in the tier ``drift``, in
a constant wind. The calibration is that of the whole detector. Each row of ``results/follow_mixture_thresholds.csv`` is
one window under one change; the rows without a change are the whole detector.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal
from unittest.mock import patch

import numpy as np
from follow_mixture import cells, shifted_tracks
from numpy.typing import NDArray
from running import RESULTS, make_parser, parse_or_list, play_games
from scipy.special import expit
from usnet_env.evaluation.episode import episode_seeds

from detectors.follow_mixture import FollowMixture, delays, detector, evidence, fit, motion, pooling
from detectors.follow_mixture.motion import lagged
from detectors.follow_mixture.train import CalibrationTraining
from detectors.random_swarms import draw_calibration_swarm, draw_calibration_window
from detectors.series import direction
from detectors.series.features import LEVELS
from usnet_env import Window
from usnet_env.envs import MultiClusterEnv
from usnet_env.evaluation import load_suite
from usnet_env.swarm import SwarmConfig

FILE = RESULTS / "follow_mixture_thresholds.csv"
SEED = 61  # seeds below 1000 are for tuning
SUITES = {name: load_suite(name) for name in ("field", "controls", "sensing")}
WIND = np.array([20.0, 10.0, 0.0], np.float32)  # metres per step; a UAV flies 1
INFINITE = 1e9
SWARMS = CalibrationTraining()


@dataclass(frozen=True)
class Change:
    """One threshold or part of the detector that is switched off or moved.

    Args:
        what: it, and its new value.
        patches: module, attribute and new value.
    """

    what: str
    patches: tuple[tuple[Any, str, Any], ...]


def _no_pool(targets: Any, pairs: Any, some: Any, follows: Any, groups: int) -> NDArray[np.float64]:
    """In place of the evidence by the law of the other followers: none."""
    return np.full(len(follows) - groups, -np.inf)


def _share_strictly(search: Any, some: Any, assignment: Any, own: NDArray[np.float64]) -> Any:
    """In place of a shared law from which groups may deviate: one from which they may not."""
    return share_law(search, some, assignment, np.full(len(own), -np.inf))


def _share_free(search: Any, some: Any, assignment: Any, own: NDArray[np.float64]) -> Any:
    """In place of a shared law from which single UAVs deviate at a price: one without the price."""
    alone = search.targets.sizes[search.pairs.group] == 1
    return share_law(search, some, assignment, own + np.log(1.0 / fit.RARE - 1.0) * alone)


def _never_compare(velocity: Any, known: Any, label: Any, root: Any, heads: Any, longest: int, noisy: bool) -> Any:
    """In place of the comparison of past and future: every head leads."""
    return np.full(len(heads), np.inf)


def _everywhere(name: str, value: float) -> tuple[tuple[Any, str, Any], ...]:
    return tuple((module, name, value) for module in (fit, delays, pooling))


share_law = fit._share_law

#: Key of each change. The first ones move thresholds, the others switch off parts.
CHANGES = {
    "": Change("nothing", ()),
    "own-law-free": Change(
        "a single UAV deviates from the shared law at no price", ((fit, "_share_law", _share_free),)
    ),
    "own-law-never": Change("no group may deviate from the shared law", ((fit, "_share_law", _share_strictly),)),
    "certain-always": Change(
        "the first level is final if all groups follow, whatever its doubt", ((fit, "_CERTAIN", -1.0),)
    ),
    "certain-never": Change("all classes of features are always tried", ((fit, "_CERTAIN", INFINITE),)),
    "heads-never": Change(
        "single UAVs are not asked about the heads found before all classes are tried",
        ((fit, "ask_about_heads", lambda *arguments: None),),
    ),
    "rare-0.5": Change("what is rare has the prior probability 0.5 instead of 0.05", _everywhere("RARE", 0.5)),
    "rare-0.001": Change("what is rare has the prior probability 0.001", _everywhere("RARE", 0.001)),
    "together-1": Change("a member of a group is as likely a head as a single UAV", ((fit, "_LEAST_TOGETHER", 1.0),)),
    "relay-0": Change(
        "the leader of a relay or late follower may explain any share of its innovations", ((delays, "_RELAY", 0.0),)
    ),
    "relay-never": Change(
        "no UAV that leads follows another, and none has a delay of its own", ((delays, "_RELAY", 1.0 - 1e-12),)
    ),
    "delay-4": Change(
        "delays of a UAV's own are at most 4 samples instead of 12", ((detector, "count_lags", lambda *arguments: 4),)
    ),
    "delay-25": Change(
        "they are at most 25 samples, or a quarter of the window", ((detector, "count_lags", lambda *arguments: 25),)
    ),
    "rows-a-lag": Change("the own past has all lags, however short the window is", ((evidence, "_ROWS_A_LAG", 1),)),
    "freedom": Change("all rows have the same weight, sharp turns too", ((evidence, "_FREEDOM", INFINITE),)),
    "white": Change(
        "rows count as independent, however long the errors of the own past last",
        ((evidence, "_whiteness", lambda innovation: np.ones(len(innovation))),),
    ),
    "share-half": Change(
        "half of the single UAVs follow a head a priori, instead of an unknown share",
        ((fit, "SHARES", np.array([0.5])), (fit, "WEIGHTS", np.array([1.0]))),
    ),
    "own-choice-free": Change("a single UAV chooses a head at no price", ((pooling, "RARE", 0.5),)),
    "own-choice-never": Change("no single UAV chooses a head by itself", ((pooling, "RARE", 1e-300),)),
    "direction-never": Change(
        "the past of a head is not compared with its future", ((fit, "compare_directions", _never_compare),)
    ),
    "direction-velocities": Change(
        "only velocities are compared so, not their changes", ((direction, "_REVERSED", ((0, -1.0),)),)
    ),
    "direction-alone": Change(
        "what other heads of a window do says nothing about a head's direction",
        ((detector, "lead_probabilities", expit),),
    ),
    "unit-spread": Change(
        "speeds are never taken for equal", ((motion, "_UNIT_SPREAD", 0.0), (motion, "_ROUNDING", 0.0))
    ),
    "drift": Change("no drift is taken off", ((motion, "_DRIFT", INFINITE),)),
    "no-pools": Change("no single UAV gains by the law of the other followers", ((pooling, "_pool", _no_pool),)),
    "no-single-uavs": Change("single UAVs never follow: one level, with all classes", ((fit, "LEVELS", LEVELS[1:]),)),
    "no-classes": Change("the second level has the classes of the first", ((fit, "LEVELS", (LEVELS[0], LEVELS[0])),)),
    "no-smoothing": Change(
        "pasts behind noise are not smoothed", ((fit, "smoothed_pasts", lambda v, spectra, lags: lagged(v, lags)),)
    ),
    "no-shared-law": Change("groups share no law", ((fit, "_share_law", lambda *args: None),)),
}


@dataclass(frozen=True)
class Game:
    """A first window and its truth."""

    kind: str
    window: Window
    head: NDArray[np.bool_]
    seed: int


def draw_swarm(rng: np.random.Generator) -> SwarmConfig:
    """A swarm as the calibration draws them."""
    return draw_calibration_swarm(SWARMS.most_uavs, SWARMS.most_clusters, rng)


def list_windows(tiers: list[str], each: int, random: int, seed: int) -> list[tuple[str, str, int]]:
    """Tier, cell and number of the first windows of all cells of some tiers, and of random swarms."""
    found = []
    for cell in cells():
        if cell.tier in tiers:
            found += [(cell.tier, cell.name, n) for n in range(each)]
    found += [(tier, name, n) for tier in SUITES if tier in tiers for name in SUITES[tier].cells for n in range(each)]
    mobilities = [draw_swarm(np.random.default_rng((seed, number))).mobility for number in range(random)]
    swarms = ("random", "drift") if "drift" in tiers else ("random",)
    return [*found, *((tier, mobility, number) for tier in swarms for number, mobility in enumerate(mobilities))]


@lru_cache(maxsize=1)  # all changes are played on a window, one after the other
def draw_game(tier: str, name: str, number: int, random: int, seed: int) -> Game:
    """The first window of one game of a cell, or of a random swarm."""
    if tier in ("random", "drift"):
        rng = np.random.default_rng((seed, number))
        window, head = draw_calibration_window(draw_swarm(rng), rng)
        if tier == "drift":
            flown = np.arange(len(window.position), dtype=np.float32)[:, None, None] * WIND
            window = replace(window, position=window.position + flown, velocity=window.velocity + WIND)
        return Game("P2", window, head, number)
    if tier in SUITES:
        swarm, detector = episode_seeds(SUITES[tier].tuning_seed, number)
        environment = MultiClusterEnv(**SUITES[tier].cells[name].arguments)
        observation, _ = environment.reset(seed=swarm)
        return Game("P2", Window.from_observation(observation), np.asarray(environment.swarm.head), detector)
    cell = next(cell for cell in cells() if (cell.tier, cell.name) == (tier, name))
    env = cell.make_env()
    swarm, detector = episode_seeds(seed, number)
    observation, _ = env.reset(seed=swarm)
    window = Window.from_observation(observation)
    head = np.asarray(env.swarm.head) & (not cell.empty)
    return Game(cell.kind, shifted_tracks(window, detector) if cell.kind == "shifted" else window, head, detector)


def play(game: Game, key: str, policy: Literal["cost", "map"]) -> dict[str, Any]:
    """One window under one change; J is the least J_m that this round allows, or the share of UAVs named in silence."""
    policy = policy if game.head.any() else "map"
    own = FollowMixture(policy=policy, objective="P1" if game.kind == "P1" else "P2")
    with ExitStack() as stack:
        for module, name, value in CHANGES[key].patches:
            stack.enter_context(patch.object(module, name, value))
        own.reset(game.seed)
        named = own.detect(game.window).candidates
    wrong, missed = int((named & ~game.head).sum()), int((game.head & ~named).sum())
    cost = round(wrong / game.window.uavs + (missed > 0) + bool(game.head.any()), 6)
    heads, exact = int(game.head.sum()), int(not wrong and not missed)
    return {"uavs": game.window.uavs, "heads": heads, "exact": exact, "J": cost}


def main() -> None:
    """List the changes, or play."""
    parser = make_parser(__doc__)
    parser.add_argument("--games", type=int, default=4, help="of each cell")
    parser.add_argument("--tier", nargs="*", default=[*sorted({cell.tier for cell in cells()}), "field", "drift"])
    parser.add_argument("--random", type=int, default=120, help="random swarms")
    parser.add_argument("--change", nargs="*", default=[*CHANGES], choices=[*CHANGES], help="beside the whole detector")
    parser.add_argument("--policy", choices=["cost", "map"], default="cost", help="where a UAV follows another")
    parser.add_argument("--seed", type=int, default=SEED)
    parser.add_argument("--results", type=Path, default=FILE)
    if (arguments := parse_or_list(parser, CHANGES)) is None:
        return

    def play_one(cell: Mapping[str, Any], number: int) -> dict[str, Any]:
        return play(
            draw_game(cell["tier"], cell["cell"], number, arguments.random, arguments.seed),
            cell["change"],
            arguments.policy,
        )

    windows = list_windows(arguments.tier, arguments.games, arguments.random, arguments.seed)
    keys = [key for key in CHANGES if not key or key in arguments.change]
    games = [({"change": key, "tier": tier, "cell": cell}, number) for tier, cell, number in windows for key in keys]
    play_games(arguments.results, games, play_one, ("uavs", "heads", "exact", "J"), "game")


if __name__ == "__main__":
    main()
