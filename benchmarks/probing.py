"""USNET/Probing-v1: how often, how soon and at what reward probers name the head, in twelve cells.

    OMP_NUM_THREADS=1 python benchmarks/probing.py                      # plays what the rows lack
    OMP_NUM_THREADS=1 python benchmarks/probing.py --detector NAME    # the same with a detector
    python benchmarks/probing.py --draw                                 # plays nothing: the tables of the rows

A row is an episode; all probers play the same swarms. ``copies`` stands for the probers without a detector, ``learned``
for those that ``probing_learners.py`` plays. ``guess``
names a random UAV at once; ``none`` never moves an intruder; ``park`` flies to the middle of the swarm and stays there;
``oracle`` knows the head, flies at it, and names it as soon as it is the most probable, or at the end.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import gymnasium as gym
import numpy as np
import pandas as pd
from paper import shared
from pivot import mean, pivot, rate, size

import usnet_env.envs  # noqa: F401  # registers the environment
from usnet_env import make_detector
from usnet_env.envs.play import play_probe
from usnet_env.envs.probers import TARGETS, Prober

ROWS, COPIES = shared.RESULTS / "probing.csv.gz", "copies"
#: The arguments of each cell, beside those of all.
ALL = {"followers": 9, "look_every": 5}
_ONE: dict[str, dict[str, Any]] = {
    "decoys that fly as the head": {"mobility": "alike", "decoys": 3},
    "the same, noise 1 m": {"mobility": "alike", "decoys": 3, "position_noise": 1.0},
    "noise 2.5 m": {"position_noise": 2.5},
    "25 steps, noise 1 m": {"observation_steps": 25, "position_noise": 1.0},
    "smooth head, jitter, noise 1 m": {"mobility": "gauss_markov", "head_jitter": True, "position_noise": 1.0},
    "no noise": {},
}
CELLS = _ONE | {
    f"{cell}; K = {count}": _ONE[cell] | {"intruders": count} for count in (2, 4) for cell in list(_ONE)[:3]
}


class Guess(Prober):
    """Names a random UAV at the first look."""

    def act(self, observation: Mapping[str, Any]) -> dict[str, Any]:
        """The action for an observation."""
        self.look(observation)
        self.belief = np.full(len(self.belief), 1 / len(self.belief))
        return self.stay(int(self.rng.integers(len(self.belief))))


class Park(Prober):
    """Flies to the middle of the swarm as it is at first, and stays there."""

    def act(self, observation: Mapping[str, Any]) -> dict[str, Any]:
        """The action for an observation, with the belief as ``self.belief``."""
        answer = super().act(observation)
        if not observation["elapsed"][0]:
            self.goal = self.middle
        return self.steer_to(self.goal) if answer["name"] == len(self.belief) else answer


class Oracle(Prober):
    """Knows the head."""

    head = 0

    def act(self, observation: Mapping[str, Any]) -> dict[str, Any]:
        """The action for an observation, with the belief as ``self.belief``."""
        self.look(observation)
        if self.full or (self.belief.argmax() == self.head and observation["elapsed"][0]):
            return self.stay(self.head)
        return self.fly(lambda distance: np.arange(len(distance)) == self.head)


OTHERS = {"guess": Guess, "park": Park, "oracle": Oracle}
PROBERS = [(COPIES, target) for target in ("guess", "none", "park", "nearest", "oracle")]
STILL = "guess", "none"  # these never move an intruder, and so play with one only


def make_prober(label: str, target: str) -> Prober:
    """A prober by the label of its detector and its name."""
    return OTHERS[target]() if target in OTHERS else Prober(None if label == COPIES else make_detector(label), target)


def make_game(cell: str) -> Any:
    """The environment of a cell."""
    return gym.make("USNET/Probing-v1", **ALL, **CELLS[cell])


def draw_seed(episode: int) -> int:
    """The seed of an episode, in all cells and of all probers."""
    return int(np.random.default_rng([shared.SEED, episode]).integers(2**31))


def play(game: shared.Game) -> list[dict[str, Any]]:
    """Play an episode."""
    env = shared.cached(make_game, game["cell"])
    seed = draw_seed(game["episode"])
    prober = shared.cached(make_prober, game["detector"], game["target"])
    if isinstance(prober, Oracle):
        env.reset(seed=seed)
        prober.head = int(env.unwrapped.swarm.head.argmax())
    played, total = play_probe(env, prober, seed)
    elapsed, steps = played.observation["elapsed"][0], env.unwrapped.config.observation_steps
    measured = {"right": int(played.info["J"] == 0), "elapsed": int(elapsed), "early": int(elapsed < steps)}
    return [game | measured | {"belief": played.answer.scores.max(), "reward": total}]


def report(rows: pd.DataFrame) -> str:
    """A line for each cell and prober, in their order."""
    known = rows.detector.unique()
    probers = [*PROBERS, *((label, target) for label in known if label != COPIES for target in TARGETS)]
    order = [(cell, *prober) for cell in CELLS for prober in probers]
    rows = pd.concat(
        [part for _, part in sorted(rows.groupby(["cell", "detector", "target"]), key=lambda one: order.index(one[0]))]
    )
    columns = {"n": size, "names the head": rate("right"), "steps until it names": mean("elapsed", 1)}
    lines = {"cell": "cell", "target": "target", "belief by": "detector"}
    return pivot(rows, lines, {**columns, "reward": mean("reward")})


def main(argv: list[str] | None = None) -> None:
    parser = shared.make_parser(__doc__, ROWS)
    parser.add_argument("--detector", default=COPIES)
    parser.add_argument("--episodes", type=int, default=200)
    options = parser.parse_args(argv)
    probers = PROBERS if options.detector == COPIES else [(options.detector, target) for target in TARGETS]
    games = [
        {"detector": label, "cell": cell, "target": target, "episode": episode}
        for label, target in probers
        for cell in CELLS
        if "intruders" not in CELLS[cell] or target not in STILL
        for episode in range(options.episodes)
    ]
    print(report(shared.run_missing(options, games, play)))


if __name__ == "__main__":
    main()
