"""usnet_evasion_v0 at short windows: swarms and observers learn best responses to each other, in turn.

    OMP_NUM_THREADS=1 python benchmarks/evasion.py --trainings 3    # goes on after those that the rows have
    python benchmarks/evasion.py --draw                             # trains nothing: the tables of the rows

Of every pair of players the pay-off is known: J_m minus the price, which the swarm gets and the observer loses. PPO
trains a new swarm against the observers' mixture in the equilibrium of this matrix, then a new observer against the
swarms' mixture in the new one (PSRO, Lanctot et al. 2017). A row is a game that no training has seen. The even games
tell the equilibria, so that the odd ones, which tell what a best response gains, are fresh. The players of the first
training are kept: :func:`read_players` returns them.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from functools import partial
from itertools import permutations, product
from typing import Any, ClassVar

import gymnasium as gym
import numpy as np
import pandas as pd
from gymnasium import spaces
from paper import shared
from pivot import across, mean, pivot
from policies import read_policies, write_policies
from scipy.optimize import linprog

from usnet_env import Window, make_detector
from usnet_env.multiagent import usnet_evasion_v0

ROWS, WEIGHTS = shared.RESULTS / "evasion.csv.gz", shared.RESULTS / "evasion.safetensors"
ID = "Evasion/OneSide-v0"  # of the games in which one side learns
GAME: dict[str, Any] = {"clusters": 2, "uavs": 12, "observation_steps": 10, "max_rounds": 6}
SCRIPTED = ("reader", "destroy-all")  # the first observers; the first swarm does nothing
SIDES = {"head": "swarm", "observer": "observer"}  # what the learned players of a role are called
PLAYED, BATCH = 1_000_000, 64  # the first seed of the games of rows, which no training reaches; games of a training
DECISIONS = {"head": 10_240, "observer": 32_768}  # of a training
PPO_OF = {  # each role's arguments of PPO
    "head": {"n_steps": 4, "learning_rate": 5e-3, "ent_coef": 0.01},
    "observer": {"n_steps": 16, "learning_rate": 2e-3, "ent_coef": 0.05},
}
#: Plays one side: the actions ``(n, agents, ...)`` in some games ``(n,)``, of all of which it gets the observations.
Player = Callable[[dict[str, Any], np.ndarray], np.ndarray]


def choose(*choice: int) -> Player:
    """A swarm whose heads choose the same in every window."""
    return lambda seen, games: np.tile(choice, (len(games), GAME["clusters"], 1))


def detect(name: str) -> Player:
    """An observer that names what a detector finds, and no UAV before the first window."""
    detector = make_detector(name)
    detector.reset(0)

    def act(seen: dict[str, Any], games: np.ndarray) -> np.ndarray:
        named = np.zeros((len(games), 1, GAME["uavs"]), bool)
        for row, b in enumerate(games):
            if seen["legal"][b].any():
                window = Window.from_observation({name: part[b, 0] for name, part in seen.items()})
                named[row] = detector.detect(window).candidates
        return named

    return act


def follow(policy: Any, role: str) -> Player:
    """A policy of Stable-Baselines3. A swarm draws its choices; an observer names what is more probable than 1/2."""

    def act(seen: dict[str, Any], games: np.ndarray) -> np.ndarray:
        action, _ = policy.predict(show(seen, role, games), deterministic=role == "observer")
        return action.reshape(len(games), seen["legal"].shape[1], -1)

    return act


def show(seen: dict[str, Any], role: str, games: Any = slice(None)) -> Any:
    """What a policy learns from: an observer from raw windows, a swarm from the sizes of its clusters and the round."""
    if role == "observer":  # in the opening no UAV may be named
        return {"velocity": seen["velocity"][games, 0], "alive": seen["legal"][games, 0]}
    sizes, living = seen["followers"][games].mean(axis=2), (seen["self"] * seen["heads"])[games].sum(axis=2)
    return np.concatenate([sizes, living, seen["round"][games, 0] / GAME["max_rounds"]], axis=1, dtype=np.float32)


class OneSide(gym.vector.VectorEnv[Any, Any, Any]):
    """Games in which one side learns; the players of the other side are drawn for each game by their ``shares``."""

    metadata: ClassVar[dict[str, Any]] = {"autoreset_mode": gym.vector.AutoresetMode.SAME_STEP}

    def __init__(
        self, num_envs: int, role: str, others: Sequence[Player], shares: Sequence[float], autoreset_mode: str
    ) -> None:
        self.games = usnet_evasion_v0.batch_env(num_envs, **GAME)
        self.num_envs, self.role, self.others, self.shares = num_envs, role, others, shares
        (self.other,) = SIDES.keys() - {role}
        acts, window, agents = self.games.action_spaces, self.games.observation_spaces["observer"], GAME["clusters"]
        self.single_observation_space, self.single_action_space = {
            "observer": (spaces.Dict({"velocity": window["velocity"], "alive": window["legal"]}), acts["observer"]),
            "head": (spaces.Box(0, 1, (2 * agents + 1,)), spaces.MultiDiscrete(np.tile(acts["head"].nvec, agents))),
        }[role]

    def reset(self, *, seed: Any = None, options: Any = None) -> tuple[Any, dict[str, Any]]:
        """Start all games."""
        self._rng, (self._seen, _) = np.random.default_rng(seed), self.games.reset(seed=seed)
        self._met = self._rng.choice(len(self.others), self.num_envs, p=self.shares)
        return show(self._seen[self.role], self.role), {}

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Play a step; a game that ends begins again."""
        space, count = self.games.action_spaces[self.other], self.games.roles[self.other]
        answers = np.zeros((self.num_envs, count, *space.shape), np.int64)
        for number, player in enumerate(self.others):
            if len(met := np.flatnonzero(self._met == number)):
                answers[met] = player(self._seen[self.other], met)
        own = np.reshape(actions, (self.num_envs, self.games.roles[self.role], -1))
        self._seen, paid, over = play_step(self.games, {self.role: own, self.other: answers})
        if over.any():
            self._seen, _ = self.games.reset(games=over)
            self._met[over] = self._rng.choice(len(self.others), over.sum(), p=self.shares)
        reward = (paid[0] - paid[1]) * (1 if self.role == "head" else -1)
        info = {"final_info": {}, "final_obs": [None] * self.num_envs}
        return show(self._seen[self.role], self.role), reward, over, np.zeros_like(over), info

    def get_attr(self, name: str) -> list[Any]:
        """The attribute of each game, for ``SwarmVecEnv``."""
        return [getattr(self, name)] * self.num_envs


def play_step(games: Any, actions: dict[str, np.ndarray]) -> tuple[dict[str, Any], np.ndarray, np.ndarray]:
    """Play a step: what all see, ``(2, B)`` its part of J_m and the price, and which games are over, ``(B,)``."""
    seen, rewards, _, _, infos = games.step(actions)
    paid = np.stack([-rewards["observer"][:, 0], infos["observer"]["price"][:, 0]])
    return seen, paid, ~games.active["observer"][:, 0]


def play(swarm: Player, observer: Player, episodes: int) -> pd.DataFrame:
    """Let two players play games, at once."""
    games, total, left = usnet_evasion_v0.batch_env(episodes, **GAME), np.zeros((2, episodes)), np.arange(episodes)
    seen, _ = games.reset(seed=PLAYED)
    while len(left):  # a game that is over begins again, but its rewards don't count
        choices, named = np.zeros((episodes, GAME["clusters"], 4), int), np.zeros((episodes, 1, GAME["uavs"]), bool)
        choices[left], named[left] = swarm(seen["head"], left), observer(seen["observer"], left)
        seen, paid, over = play_step(games, {"head": choices, "observer": named})
        total[:, left] += paid[:, left]
        left = left[~over[left]]
        if over.any() and len(left):
            seen, _ = games.reset(games=over)
    return pd.DataFrame({"episode": range(episodes), "J": total[0], "price": total[1]})


def make_model(role: str, others: Sequence[Player] = (), shares: Sequence[float] = (), seed: int = 0) -> Any:
    """PPO for a side, against a mixture of the other side's players."""
    from stable_baselines3 import PPO

    from detectors.rl.sb3 import PairPolicy
    from usnet_env.frameworks.sb3 import SwarmVecEnv

    if ID not in gym.registry:  # in each process
        gym.register(ID, vector_entry_point=OneSide)
    policy: Any = PairPolicy if role == "observer" else "MlpPolicy"
    envs = SwarmVecEnv(ID, BATCH, role=role, others=others, shares=shares)
    return PPO(policy, envs, seed=seed, gamma=1.0, batch_size=256, n_epochs=4, device="cpu", **PPO_OF[role])


def read_players() -> dict[str, dict[str, Player]]:
    """The swarms and the observers that learned in the first training, by role and name."""
    players: dict[str, dict[str, Player]] = {role: {} for role in SIDES}
    for name, weights in read_policies(WEIGHTS).items():
        (role,) = (role for role, side in SIDES.items() if name.startswith(side))
        policy = make_model(role).policy
        policy.load_state_dict(weights, strict=False)
        players[role][name] = follow(policy, role)
    return players


def solve(payoff: pd.DataFrame) -> tuple[float, dict[str, np.ndarray]]:
    """The value of a matrix game for the swarms, its lines, and the mixtures of an equilibrium."""
    lines, columns = payoff.shape
    bound = np.hstack([-payoff.to_numpy().T, np.ones((columns, 1))])  # the value is at most what a column leaves
    whole, limits = np.append(np.ones(lines), 0.0)[None], [(0, None)] * lines + [(None, None)]
    found = linprog(np.append(np.zeros(lines), -1.0), bound, np.zeros(columns), whole, [1.0], limits)
    mixtures = {"head": found.x[:-1], "observer": -found.ineqlin.marginals}
    return -found.fun, {role: part.clip(0) / part.clip(0).sum() for role, part in mixtures.items()}


def tabulate(rows: pd.DataFrame) -> pd.DataFrame:
    """The mean pay-offs in even games, a line for each swarm and a column for each observer, as the rows order them."""
    even = rows[rows.episode % 2 == 0]
    payoff = even.assign(payoff=even.J - even.price).pivot_table("payoff", "head", "observer")
    return payoff.loc[rows["head"].unique(), rows.observer.unique()]


def learn(game: shared.Game, rounds: int, length: float, episodes: int) -> list[dict[str, Any]]:
    """Train swarms and observers in turn, and return the rows of all pairs. Those of the first training are written."""
    seed = game["training"]
    players: dict[str, dict[str, Player]] = {"head": {"nothing": choose(0, 0, 0, 0)}, "observer": {}}
    parts, policies = list[pd.DataFrame](), dict[str, Any]()

    def add(role: str, name: str, player: Player) -> None:
        players[role][name] = player
        for pair in product(*(players[side] if side != role else [name] for side in SIDES)):
            found = play(players["head"][pair[0]], players["observer"][pair[1]], episodes)
            parts.append(found.assign(head=pair[0], observer=pair[1]))

    for name in SCRIPTED:
        add("observer", name, detect(name))
    for number, (role, other) in product(range(1, rounds + 1), permutations(SIDES)):
        _, mixtures = solve(tabulate(pd.concat(parts)))
        name, model = f"{SIDES[role]} {number}", make_model(role, [*players[other].values()], mixtures[other], seed)
        if number > 1:  # from the last policy of this side
            model.policy.load_state_dict(policies[f"{SIDES[role]} {number - 1}"].state_dict())
        policies[name] = model.learn(int(length * DECISIONS[role])).policy
        add(role, name, follow(policies[name], role))
        print(f"training {seed}, {name}, {time.process_time():.0f} s", flush=True)
    if seed == 0:
        write_policies(WEIGHTS, policies, {"decisions": DECISIONS, "length": length, "ppo": PPO_OF, "game": GAME})
    print(tabulate(pd.concat(parts)).round(2).to_string(), flush=True)
    return pd.concat(parts).assign(**game).to_dict("records")


def find_gains(rows: pd.DataFrame) -> pd.DataFrame:
    """What each best response of a training gained when it was new, in each odd game, and the pay-off before."""
    table, parts = tabulate(rows), []
    games = rows[rows.episode % 2 == 1].set_index(["head", "observer", "episode"]).payoff.unstack()
    known = {"head": ["nothing"], "observer": list(SCRIPTED)}

    def mix(shares: dict[str, dict[str, float]]) -> pd.Series:
        pairs = product(shares["head"].items(), shares["observer"].items())
        return sum(games.loc[(one, other)] * share * part for (one, share), (other, part) in pairs)

    for number, role in product(range(1, rows["head"].nunique()), SIDES):
        _, mixtures = solve(table.loc[known["head"], known["observer"]])
        shares = {side: dict(zip(known[side], mixtures[side], strict=True)) for side in SIDES}
        value, name = mix(shares), f"{SIDES[role]} {number}"
        gain = (mix(shares | {role: {name: 1.0}}) - value) * (1 if role == "head" else -1)
        parts.append(pd.DataFrame({"response": name, "value": value, "gain": gain}).reset_index())
        known[role].append(name)
    return pd.concat(parts)


def report(rows: pd.DataFrame) -> str:
    """The pay-offs of the first training, and of all trainings what each best response gained when it was new."""
    rows = rows.assign(payoff=rows.J - rows.price)
    seeds, first = sorted(rows.training.unique()), rows[rows.training == rows.training.min()]
    table = pivot(
        first, {"swarm": "head"}, across("observer", first.observer.unique(), lambda part: f"{part.payoff.mean():.2f}")
    )
    gains = pd.concat([find_gains(part).assign(training=seed) for seed, part in rows.groupby("training")])
    columns = across("training", seeds, mean("value"), "value before, seed {}")
    columns |= across("training", seeds, mean("gain"), "gain, seed {}")
    return f"{table}\n\n{pivot(gains, {'best response': 'response'}, columns)}"


def main(argv: list[str] | None = None) -> None:
    parser = shared.make_parser(__doc__, ROWS)
    parser.add_argument("--trainings", type=int, default=1, help="number of seeds")
    parser.add_argument("--rounds", type=int, default=8, help="swarms, and observers, that a training learns")
    parser.add_argument("--length", type=float, default=1.0, help="of each best response, as a share of the default")
    parser.add_argument("--episodes", type=int, default=200)
    options = parser.parse_args(argv)
    play_all = partial(learn, rounds=options.rounds, length=options.length, episodes=options.episodes)
    games = [{"training": seed} for seed in range(options.trainings)]
    print(report(shared.run_missing(options, games, play_all)))


if __name__ == "__main__":
    main()
