"""USNET/Probing-v0: how often, how soon and at what reward probers name the head, in six cells.

    OMP_NUM_THREADS=1 python benchmarks/probing.py                   # plays what the rows lack
    OMP_NUM_THREADS=1 python benchmarks/probing.py --train 40000     # trains `ppo` anew, for so many looks
    python benchmarks/probing.py --draw                              # plays nothing: the tables of the rows

A row is an episode; all probers play the same swarms. ``none`` watches and never moves an intruder. ``ppo`` learned in
all cells, in other episodes, when to watch, to fly or to name, and how far to trust the detector in that. ``oracle``
knows the head, flies at it, and names it as soon as it is the most probable.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any

import gymnasium as gym
import numpy as np
import pandas as pd
from gymnasium import spaces
from paper import shared
from pivot import mean, pivot, rate, size
from policies import read_policies, write_policies
from scipy.special import softmax

import usnet_env.envs  # noqa: F401  # registers the environment
from usnet_env import make_detector
from usnet_env.envs.play import play_probe
from usnet_env.envs.probers import TARGETS, Prober

ROWS, WEIGHTS = shared.RESULTS / "probing.csv.gz", shared.RESULTS / "probing.safetensors"
PROBERS = (*TARGETS, "ppo", "oracle")
#: The arguments of each cell, beside those of all.
ALL = {"followers": 9, "look_every": 5}
CELLS: dict[str, dict[str, Any]] = {
    "decoys that fly as the head": {"mobility": "alike", "decoys": 3},
    "the same, noise 1 m": {"mobility": "alike", "decoys": 3, "position_noise": 1.0},
    "25 steps, noise 1 m": {"observation_steps": 25, "position_noise": 1.0},
    "noise 2.5 m": {"position_noise": 2.5},
    "smooth head, jitter, noise 1 m": {"mobility": "gauss_markov", "head_jitter": True, "position_noise": 1.0},
    "no noise": {},
}
TRUSTS = (1.0, 0.5, 0.2)  # weights of the detector beside the reactions, of which `ppo` chooses one in each look
SETTINGS: dict[str, Any] = {"n_steps": 64, "batch_size": 128, "n_epochs": 10, "learning_rate": 1e-3, "ent_coef": 0.003}


class ChoosingProber(Prober):
    """A prober that does what a policy chooses.

    It waits (0), or flies at the nearest UAV that is more probable than 1/N with the weight ``TRUSTS[k]`` (1 + k), or
    names the most probable one (1 + len(TRUSTS) + k).
    """

    policy: Any = None  # of Stable-Baselines3

    def act(self, observation: Mapping[str, Any]) -> dict[str, Any]:
        """The action for an observation, with the belief as ``self.belief``."""
        return self.do(int(self.policy.predict(self.describe(observation), deterministic=True)[0]))

    def describe(self, observation: Mapping[str, Any]) -> np.ndarray:
        """Take in an observation: with each weight the two greatest beliefs, and the way to the first; four facts."""
        self.look(observation)
        self.beliefs = softmax(np.outer(TRUSTS, self.evidence[0]) + self.evidence[1], axis=1)
        first, second = np.argsort(-self.beliefs, axis=1, kind="stable")[:, :2].T
        lines = np.arange(len(TRUSTS))
        told = [2 * self.beliefs[lines, first], 2 * self.beliefs[lines, second], self.count_steps()[0, first] / 20]
        elapsed, steps = int(observation["elapsed"][0]), self.arguments.observation_steps
        speed = np.linalg.norm(observation["velocity"][: max(elapsed, 1)], axis=2).mean()  # it shows the noise
        facts = [elapsed / steps, (steps - elapsed) / 30, len(self.belief) / 5, speed / 2]
        return np.nan_to_num([*np.ravel(told), *facts]).clip(0, 5).astype(np.float32)

    def do(self, choice: int) -> dict[str, Any]:
        """The action of a choice; in a full window all name the most probable UAV."""
        self.belief = self.beliefs[(choice - 1) % len(TRUSTS)]
        if choice > len(TRUSTS) or self.full:
            return self.stay(int(self.belief.argmax()))
        return self.fly(partial(TARGETS["nearest"], self)) if choice else self.stay()


class Choices(gym.Env[Any, Any]):
    """The games of all cells, with the choices of a :class:`ChoosingProber` as actions."""

    def __init__(self, detector: Any) -> None:
        self.games: list[Any] = [gym.make("USNET/Probing-v0", **ALL, **cell).unwrapped for cell in CELLS.values()]
        self.prober = ChoosingProber(detector)
        self.observation_space = spaces.Box(0, 5, (3 * len(TRUSTS) + 4,), np.float32)
        self.action_space = spaces.Discrete(1 + 2 * len(TRUSTS))

    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[Any, dict[str, Any]]:
        """Start an episode of a cell, with a seed that no row has."""
        super().reset(seed=seed)
        self.game, first = self.games[self.np_random.integers(len(self.games))], self.np_random.integers(2**31, 2**32)
        observation, _ = self.game.reset(seed=int(first))
        self.prober.reset(self.game.arguments, int(first) + 1)
        return self.prober.describe(observation), {}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Do what was chosen."""
        observation, reward, over, _, _ = self.game.step(self.prober.do(int(action)))
        return self.prober.describe(observation), reward, over, False, {}


def make_model(detector: Any) -> Any:
    """PPO that names seldom at first, since who names at once learns nothing about tests."""
    from stable_baselines3 import PPO
    from stable_baselines3.common.env_util import make_vec_env

    games, network = make_vec_env(lambda: Choices(detector), 8), {"net_arch": [32, 32]}
    model = PPO("MlpPolicy", games, seed=0, gamma=1.0, device="cpu", policy_kwargs=network, **SETTINGS)
    model.policy.action_net.bias.data[1 + len(TRUSTS) :] -= 3.0
    return model


def train(label: str, looks: int) -> None:
    """Train, write the weights after each rollout, and print the mean reward of the last 100 episodes."""
    model = make_model(make_detector(label))
    while model.num_timesteps < looks:
        model.learn(1, reset_num_timesteps=False)
        print(model.num_timesteps, f"{np.mean([game['r'] for game in model.ep_info_buffer]):.3f}", flush=True)
        write_policies(WEIGHTS, {"ppo": model.policy}, {"looks": model.num_timesteps, "detector": label, **SETTINGS})


class Oracle(Prober):
    """Knows the head."""

    head = 0

    def act(self, observation: Mapping[str, Any]) -> dict[str, Any]:
        """The action for an observation, with the belief as ``self.belief``."""
        self.look(observation)
        first = int(self.belief.argmax())
        if self.full or (first == self.head and observation["elapsed"][0]):
            return self.stay(first)
        return self.fly(lambda steps: np.arange(len(steps)) == self.head)


def make_prober(label: str, target: str) -> Prober:
    """A prober by its name."""
    detector = make_detector(label)
    if target == "ppo":
        prober = ChoosingProber(detector)
        prober.policy = make_model(detector).policy
        prober.policy.load_state_dict(read_policies(WEIGHTS)["ppo"], strict=False)
        return prober
    return Oracle(detector) if target == "oracle" else Prober(detector, target)


def play(game: shared.Game) -> list[dict[str, Any]]:
    """Play an episode."""
    env = gym.make("USNET/Probing-v0", **ALL, **CELLS[game["cell"]])
    seed = int(np.random.default_rng([shared.SEED, game["episode"]]).integers(2**31))
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
    order = [(cell, target) for cell in CELLS for target in PROBERS]
    rows = pd.concat([rows[(rows.cell == cell) & (rows.target == target)] for cell, target in order])
    columns = {"n": size, "names the head": rate("right"), "steps until it names": mean("elapsed", 1)}
    return pivot(rows, {"cell": "cell", "target": "target"}, {**columns, "reward": mean("reward")})


def main(argv: list[str] | None = None) -> None:
    parser = shared.make_parser(__doc__, ROWS)
    parser.add_argument("--detector", default="reader(objective='P1')")
    parser.add_argument("--episodes", type=int, default=50)
    parser.add_argument("--train", type=int, metavar="LOOKS")
    options = parser.parse_args(argv)
    if options.train:
        train(options.detector, options.train)
        if options.rows.exists():
            rows = shared.read_rows(options.rows)
            shared.write_rows(options.rows, rows[rows.target != "ppo"])
    games = [
        {"detector": options.detector, "cell": cell, "target": target, "episode": episode}
        for target in PROBERS
        for cell in CELLS
        for episode in range(options.episodes)
    ]
    print(report(shared.run_missing(options, games, play)))


if __name__ == "__main__":
    main()
