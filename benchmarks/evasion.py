"""usnet_evasion_v0 at short windows: swarms and observers learn best responses to each other, in turn.

    OMP_NUM_THREADS=1 python benchmarks/evasion.py --trainings 3    # goes on after those that the rows have
    python benchmarks/evasion.py --draw                             # trains nothing: the tables of the rows

Of every pair of players the pay-off is known: J_m minus the price, which the swarm gets and the observer loses. Against
the observers' mixture in the equilibrium of this matrix, the new swarm is the better of the best constant choice and a
policy that PPO trains; against the swarms' mixture in the new equilibrium, PPO trains a new observer (PSRO, Lanctot et
al. 2017). At the end, the last mixtures are exploited: by constants, detectors, and PPO with 1, 5 and 25 times the
decisions, also of a swarm that sees the true state. These games are fresh: no training, no matrix and no choice met
them. The players of the first training are kept: :func:`read_players` returns them.
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
from usnet_env.multiagent.evasion import Manoeuvres

ROWS, WEIGHTS = shared.RESULTS / "evasion.csv.gz", shared.RESULTS / "evasion.safetensors"
ID = "Evasion/OneSide-v0"  # of the games in which one side learns
GAME: dict[str, Any] = {"clusters": 2, "uavs": 12, "observation_steps": 10, "max_rounds": 6}
PRICES = [f"{choice}_price" for choice in ("mobility", "jitter", "decoy", "delay")]
GAMES = {"usual": GAME, "cheap": GAME | {name: getattr(Manoeuvres(), name) / 5 for name in PRICES}}
SCRIPTED = ("reader", "reader(policy='map')", "destroy-all")  # the first observers; the first swarm does nothing
SIDES = {"head": "swarm", "observer": "observer"}  # what the learned players of a role are called
#: The first seeds of the games of the matrix, of those that choose a constant, and of those that exploit a mixture; no
#: training reaches them.
PLAYED, SEARCHED, FRESH = 1_000_000, 2_000_000, 3_000_000
BATCH, MIXTURE = 64, "mixture"  # games of a training; the name of the last mixtures in rows
BUDGETS = (1, 5, 25)  # of the policies that exploit the last mixtures, in DECISIONS
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


def answer(players: Sequence[Player], met: np.ndarray, seen: dict[str, Any], games: np.ndarray) -> np.ndarray:
    """The actions ``(n, agents, ...)`` in some games ``(n,)``, in each of the player that it met, ``(n,)``."""
    parts = [(met == one, players[one](seen, games[met == one])) for one in np.unique(met)]
    actions = np.zeros((len(games), *parts[0][1].shape[1:]), parts[0][1].dtype)
    for where, part in parts:
        actions[where] = part
    return actions


def mix(players: Sequence[Player], shares: np.ndarray) -> Player:
    """A player that plays each game as one of the players, drawn by their ``shares``."""
    met = np.random.default_rng(0).choice(len(players), 10_000, p=shares)
    return lambda seen, games: answer(players, met[games], seen, games)


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


def follow(policy: Any, view: str) -> Player:
    """A policy of Stable-Baselines3. A swarm draws its choices; an observer names what is more probable than 1/2."""

    def act(seen: dict[str, Any], games: np.ndarray) -> np.ndarray:
        action, _ = policy.predict(show(seen, view, games), deterministic=view == "observer")
        return action.reshape(len(games), seen["legal"].shape[1], -1)

    return act


def show(seen: dict[str, Any], view: str, games: Any = slice(None)) -> Any:
    """What a policy learns from: raw windows, the sizes of clusters and the round (``head``), or the true state."""
    if view == "observer":  # in the opening no UAV may be named
        return {"velocity": seen["velocity"][games, 0], "alive": seen["legal"][games, 0]}
    if view == "state":
        return (np.sign(seen["state"][games]) * np.log1p(np.abs(seen["state"][games]))).astype(np.float32)
    sizes, living = seen["followers"][games].mean(axis=2), (seen["self"] * seen["heads"])[games].sum(axis=2)
    return np.concatenate([sizes, living, seen["round"][games, 0] / GAME["max_rounds"]], axis=1, dtype=np.float32)


class OneSide(gym.vector.VectorEnv[Any, Any, Any]):
    """Games in which one side learns; the players of the other side are drawn for each game by their ``shares``."""

    metadata: ClassVar[dict[str, Any]] = {"autoreset_mode": gym.vector.AutoresetMode.SAME_STEP}

    def __init__(
        self,
        num_envs: int,
        game: str,
        view: str,
        others: Sequence[Player],
        shares: Sequence[float],
        autoreset_mode: str,
    ) -> None:
        self.games = usnet_evasion_v0.batch_env(num_envs, **GAMES[game])
        self.role = "observer" if view == "observer" else "head"
        self.num_envs, self.view, self.others, self.shares = num_envs, view, others, shares
        (self.other,) = SIDES.keys() - {self.role}
        acts, window, agents = self.games.action_spaces, self.games.observation_spaces["observer"], GAME["clusters"]
        self.single_action_space = acts[self.role]
        if self.role == "head":
            self.single_action_space = spaces.MultiDiscrete(np.tile(acts["head"].nvec, agents))
        self.single_observation_space = {
            "observer": lambda: spaces.Dict({"velocity": window["velocity"], "alive": window["legal"]}),
            "head": lambda: spaces.Box(0, 1, (2 * agents + 1,)),
            "state": lambda: spaces.Box(-np.inf, np.inf, start_games(self.games, 0)["head"]["state"].shape[1:]),
        }[view]()

    def reset(self, *, seed: Any = None, options: Any = None) -> tuple[Any, dict[str, Any]]:
        """Start all games."""
        self._rng, self._seen = np.random.default_rng(seed), start_games(self.games, seed)
        self._met = self._rng.choice(len(self.others), self.num_envs, p=self.shares)
        return show(self._seen[self.role], self.view), {}

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Play a step; a game that ends begins again."""
        answers = answer(self.others, self._met, self._seen[self.other], np.arange(self.num_envs))
        chosen = np.reshape(actions, (self.num_envs, self.games.roles[self.role], -1))
        self._seen, paid, over = play_step(self.games, {self.role: chosen, self.other: answers})
        self._met[over] = self._rng.choice(len(self.others), over.sum(), p=self.shares)
        reward = (paid[0] - paid[1]) * (1 if self.role == "head" else -1)
        info = {"final_info": {}, "final_obs": [None] * self.num_envs}
        return show(self._seen[self.role], self.view), reward, over, np.zeros_like(over), info

    def get_attr(self, name: str) -> list[Any]:
        """The attribute of each game, for ``SwarmVecEnv``."""
        return [getattr(self, name)] * self.num_envs


def start_games(games: Any, seed: Any) -> dict[str, Any]:
    """Start games, and return what all see."""
    return show_state(games, games.reset(seed=seed)[0])


def show_state(games: Any, seen: dict[str, Any]) -> dict[str, Any]:
    """What all see; heads also see the true state ``(B, S)``."""
    return seen | {"head": seen["head"] | {"state": games.state()}}


def play_step(games: Any, actions: dict[str, np.ndarray]) -> tuple[dict[str, Any], np.ndarray, np.ndarray]:
    """Play a step: what all see, ``(2, B)`` its part of J_m and the price, and which games ended and began again."""
    seen, rewards, _, _, infos = games.step(actions)
    paid = np.stack([-rewards["observer"][:, 0], infos["observer"]["price"][:, 0]])
    over = ~games.active["observer"][:, 0]
    if over.any():
        seen, _ = games.reset(games=over)
    return show_state(games, seen), paid, over


def play(game: str, swarm: Player, observer: Player, episodes: int, first: int = PLAYED) -> pd.DataFrame:
    """Let two players play games, at once; the first has the seed ``first``."""
    games, total, left = (
        usnet_evasion_v0.batch_env(episodes, **GAMES[game]),
        np.zeros((2, episodes)),
        np.arange(episodes),
    )
    seen = start_games(games, first)
    while len(left):  # a game that is over begins again, but its rewards don't count
        choices, named = np.zeros((episodes, GAME["clusters"], 4), int), np.zeros((episodes, 1, GAME["uavs"]), bool)
        choices[left], named[left] = swarm(seen["head"], left), observer(seen["observer"], left)
        seen, paid, over = play_step(games, {"head": choices, "observer": named})
        total[:, left] += paid[:, left]
        left = left[~over[left]]
    return pd.DataFrame({"episode": range(episodes), "J": total[0], "price": total[1]})


def find_constant(game: str, observer: Player) -> tuple[int, ...]:
    """The best of all choices that heads can make alike in every window, against an observer.

    All play some games, the better ones more (successive halving).
    """
    counts = usnet_evasion_v0.batch_env(1, **GAME).action_spaces["head"].nvec
    best, first = list(product(*map(range, counts))), SEARCHED
    for episodes, kept in ((25, 20), (100, 5), (400, 1)):
        means = {choice: find_mean(play(game, choose(*choice), observer, episodes, first)) for choice in best}
        best, first = sorted(means, key=lambda choice: -means[choice])[:kept], first + episodes
    return best[0]


def find_mean(rows: pd.DataFrame) -> float:
    """The mean pay-off of games."""
    return float((rows.J - rows.price).mean())


def make_model(game: str, view: str, others: Sequence[Player] = (), shares: Sequence[float] = (), seed: int = 0) -> Any:
    """PPO for a side, against a mixture of the other side's players."""
    from stable_baselines3 import PPO

    from detectors.rl.sb3 import PairPolicy
    from usnet_env.frameworks.sb3 import SwarmVecEnv

    if ID not in gym.registry:  # in each process
        gym.register(ID, vector_entry_point=OneSide)
    policy: Any = PairPolicy if view == "observer" else "MlpPolicy"
    envs = SwarmVecEnv(ID, BATCH, game=game, view=view, others=others, shares=shares)
    how = PPO_OF["observer" if view == "observer" else "head"]
    return PPO(policy, envs, seed=seed, gamma=1.0, batch_size=256, n_epochs=4, device="cpu", **how)


def read_players() -> dict[str, dict[str, Player]]:
    """The policies that learned in the first training, by role and name."""
    players: dict[str, dict[str, Player]] = {role: {} for role in SIDES}
    for name, weights in read_policies(WEIGHTS).items():
        (role,) = (role for role, side in SIDES.items() if name.startswith(side))
        policy = make_model("usual", role).policy
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
    """The mean pay-offs, a line for each swarm and a column for each observer, as the rows order them."""
    payoff = rows.assign(payoff=rows.J - rows.price).pivot_table("payoff", "head", "observer")
    return payoff.loc[rows["head"].unique(), rows.observer.unique()]


def learn(game: shared.Game, rounds: int, length: float, episodes: int, fresh: int) -> list[dict[str, Any]]:
    """Train swarms and observers in turn, and return the rows of all pairs and of what exploits the last mixtures.

    The policies of the first training are written.
    """
    rules, seed = game["game"], game["training"]
    players: dict[str, dict[str, Player]] = {"head": {"nothing": choose(0, 0, 0, 0)}, "observer": {}}
    parts, policies = list[pd.DataFrame](), dict[str, Any]()

    def add(role: str, name: str, player: Player) -> None:
        players[role][name] = player
        for pair in product(*(players[side] if side != role else [name] for side in SIDES)):
            found = play(rules, players["head"][pair[0]], players["observer"][pair[1]], episodes)
            parts.append(found.assign(head=pair[0], observer=pair[1]))

    for name in SCRIPTED:
        add("observer", name, detect(name))
    for number, (role, other) in product(range(1, rounds + 1), permutations(SIDES)):
        others, (_, mixtures) = [*players[other].values()], solve(tabulate(pd.concat(parts)))
        name, model = f"{SIDES[role]} {number}", make_model(rules, role, others, mixtures[other], seed)
        if number > 1:  # from the last policy of this side
            model.policy.load_state_dict(policies[f"{SIDES[role]} {number - 1}"].state_dict())
        policies[name] = model.learn(int(length * DECISIONS[role])).policy
        player = follow(policies[name], role)
        if role == "head":
            mixture = mix(others, mixtures[other])
            constant = find_constant(rules, mixture)
            both = {name: player, f"{name}, constant {constant}": choose(*constant)}
            name = max(both, key=lambda one: find_mean(play(rules, both[one], mixture, 500, SEARCHED + 525)))
            player = both[name]
        add(role, name, player)
        print(f"{rules}, training {seed}, {name}, {time.process_time():.0f} s", flush=True)
    if rules == "usual" and seed == 0:
        write_policies(WEIGHTS, policies, {"decisions": DECISIONS, "length": length, "ppo": PPO_OF, "game": GAME})
    print(tabulate(pd.concat(parts)).round(2).to_string(), flush=True)
    _, mixtures = solve(tabulate(pd.concat(parts)))
    last = {role: policies[f"{side} {rounds}"].state_dict() for role, side in SIDES.items()}
    for role, other in permutations(SIDES):
        others = [*players[other].values()]
        whole = {side: mix([*players[side].values()], mixtures[side]) for side in SIDES}
        responses = {MIXTURE: whole[role]} if role == "head" else {}
        responses |= find_responses(rules, role, others, mixtures[other], seed, length, last[role])
        for name, player in responses.items():
            found = play(rules, *(whole | {role: player}).values(), fresh, FRESH)
            parts.append(found.assign(**{role: name, other: MIXTURE}))
            print(
                f"{rules}, training {seed}, {role} {name}: {find_mean(found):.3f}, {time.process_time():.0f} s",
                flush=True,
            )
    return pd.concat(parts).assign(**game).to_dict("records")


def find_responses(
    game: str,
    role: str,
    others: Sequence[Player],
    shares: np.ndarray,
    seed: int,
    length: float,
    weights: dict[str, Any],
) -> dict[str, Player]:
    """What may exploit a mixture of the other side's players, by name; ``weights`` are of this side's last policy."""
    if role == "observer":
        found = {name: detect(name) for name in SCRIPTED}
    else:
        constant = find_constant(game, mix(others, shares))
        found = {f"constant {constant}": choose(*constant)}
    budgets = [(role, budget) for budget in BUDGETS] + [("state", BUDGETS[-1])] * (role == "head")
    for view, budget in budgets:
        model = make_model(game, view, others, shares, seed)
        if view == role:
            model.policy.load_state_dict(weights)
        policy = model.learn(int(length * budget * DECISIONS[role])).policy
        found[f"PPO, {'sees the state, ' * (view == 'state')}{budget} times"] = follow(policy, view)
    return found


def report(rows: pd.DataFrame) -> str:
    """The pay-offs of the first training, and of all trainings what each response to the last mixtures gains."""
    rows = rows.assign(payoff=rows.J - rows.price)
    exploits = (rows["head"] == MIXTURE) | (rows.observer == MIXTURE)
    first = rows[(rows.game == "usual") & (rows.training == rows.training.min()) & ~exploits]
    columns = across("observer", first.observer.unique(), lambda part: f"{part.payoff.mean():.2f}")
    found = rows[exploits].copy()
    found["swarm"], found["observer"] = (found[side].str.replace(r" \(\d.*", "", regex=True) for side in SIDES)
    runs = found.game + ", seed " + found.training.astype(str)
    gains = across("run", runs.unique(), mean("payoff"))
    lines = {"swarm": "swarm", "observer": "observer"}
    return f"{pivot(first, {'swarm': 'head'}, columns)}\n\n{pivot(found.assign(run=runs), lines, gains)}"


def main(argv: list[str] | None = None) -> None:
    parser = shared.make_parser(__doc__, ROWS)
    parser.add_argument("--trainings", type=int, default=1, help="number of seeds")
    parser.add_argument("--rounds", type=int, default=8, help="swarms, and observers, that a training learns")
    parser.add_argument("--length", type=float, default=1.0, help="of each best response, as a share of the default")
    parser.add_argument("--episodes", type=int, default=200, help="games of a pair of players")
    parser.add_argument("--fresh", type=int, default=1000, help="games of a response to the last mixtures")
    options = parser.parse_args(argv)
    how = {name: getattr(options, name) for name in ("rounds", "length", "episodes", "fresh")}
    play_all = partial(learn, **how)
    games = [{"game": game, "training": seed} for game, seed in product(GAMES, range(options.trainings))]
    print(report(shared.run_missing(options, games, play_all)))


if __name__ == "__main__":
    main()
