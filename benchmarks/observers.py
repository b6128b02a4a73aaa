"""usnet_observers_v0 with observers that fly: scripted patrols, IPPO and MAPPO, which learn where to fly.

    OMP_NUM_THREADS=1 python benchmarks/observers.py --trainings 3    # goes on after those that the rows have
    python benchmarks/observers.py --draw                             # trains nothing: the table of the rows

Only the flight differs: in all rows each observer names what the detector names in its own window, and its message says
where it is going to be. IPPO and MAPPO (Yu et al. 2022) are PPO with the same weights for all observers, whose flights
are level and at top speed. Their actors get what an observer knows (:meth:`Search.look`); the critic of MAPPO gets the
true state, too. The reward is that of the game, and ``PER_HIT`` for each head that is hit. In training no detector
runs: a head is hit if an observer saw it and two of its followers for half a window.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from itertools import product
from typing import Any

import numpy as np
import pandas as pd
import torch
from paper import shared
from pivot import mean, pivot, rate, size
from torch.distributions import Categorical

from usnet_env import Window, make_detector
from usnet_env.multiagent import usnet_observers_v0
from usnet_env.multiagent.sensors import fly_observers
from usnet_env.swarm.formation import ARENA

ROWS = shared.RESULTS / "observers.csv.gz"
GAME: dict[str, Any] = {"clusters": 3, "uavs": 30, "observers": 3, "observation_steps": 30, "message_size": 3}
CELLS: dict[str, Any] = {"clusters gathered, range 200 m": {"formation": "gathered", "sensing_range": 200.0}}
SPEED, DETECTOR, FRESH, GRID = 4.0, "reader", 1_000_000, 6  # no training reaches the seeds from FRESH on
SECTORS = (np.stack(np.meshgrid(*[(np.arange(GRID) + 0.5) / GRID] * 2), axis=-1).reshape(-1, 2)) * ARENA[:2]
BATCH, ROUNDS, DECISIONS = 64, 16, 2_000_000  # games and rounds of a rollout; decisions of a training
PER_HIT = 2.0  # rounds, the reward in training for a head that is hit


def compass(count: int) -> np.ndarray:
    """The flights ``(count + 1, 3)``: none, and level ones at top speed in equal angles."""
    angles = 2 * np.pi * np.arange(count) / count
    level = np.stack([np.cos(angles), np.sin(angles), 0 * angles], axis=1)
    return np.concatenate([np.zeros((1, 3)), level])


FLIGHTS = compass(8)  # that IPPO and MAPPO choose from


class Search:
    """B games of a cell in which an action is only a flight; a game that is over begins again."""

    def __init__(self, num_envs: int, cell: str, detector: str | None = None) -> None:
        self.games = usnet_observers_v0.batch_env(num_envs, **GAME, **CELLS[cell], observer_speed=SPEED)
        self.reach, self.steps = CELLS[cell]["sensing_range"], self.games.config.steps
        self.detector, self.playing = detector and make_detector(detector), np.ones(num_envs, bool)
        if self.detector:
            self.detector.reset(0)
        self.age = np.zeros((num_envs, len(SECTORS)))  # rounds since an observer was in range of a sector's middle
        self.last = np.zeros((num_envs, GAME["observers"], GAME["uavs"], 2))  # where each last saw a UAV, or NaN

    def reset(self, seed: int) -> None:
        """Start all games."""
        self.remember(self.begin(seed, np.ones(self.games.num_envs, bool)))

    def begin(self, seed: int | None, games: np.ndarray) -> dict[str, np.ndarray]:
        """Start some games, and return what all observers see."""
        self.age[games], self.last[games] = 10, np.nan
        return self.games.reset(seed=seed, games=games)[0]["observer"]

    def remember(self, seen: dict[str, np.ndarray]) -> None:
        """Remember what each observer saw, and from where; all say where they are."""
        self.places = self.games.places.copy()
        self.seen, is_seen = seen, seen["seen"].astype(bool) & (seen["alive"] > 0)[:, :, None]
        instant = np.where(is_seen, np.arange(is_seen.shape[2])[:, None], -1).max(axis=2)
        position = np.take_along_axis(seen["position"], np.maximum(instant, 0)[:, :, None, :, None], axis=2)[:, :, 0]
        self.last = np.where((instant >= 0)[..., None], position[..., :2], self.last)
        self.last[seen["alive"] == 0] = np.nan
        distance = np.linalg.norm(SECTORS[:, None] - self.places[:, None, :, :2], axis=-1)
        self.age = np.where((distance <= self.reach).any(axis=2), 0, self.age + 1)

    def name(self) -> np.ndarray:
        """The votes ``(B, K, N)`` of the detector in games that count; without one, those of the rule of trainings."""
        named, truth = self.seen["legal"].astype(bool), self.games.game.swarm
        if not self.detector:
            whole = named & (2 * self.seen["seen"].sum(axis=2) > GAME["observation_steps"])
            led = (truth.root[:, :, None] == np.arange(GAME["uavs"])) & ~truth.head[:, :, None]
            return whole & truth.head[:, None] & (whole.astype(int) @ led >= 2)
        for b, k in np.argwhere(named.any(axis=2) & self.playing[:, None]):
            legal = named[b, k].copy()
            window = Window.from_observation({name: part[b, k] for name, part in self.seen.items()} | {"alive": legal})
            named[b, k] = self.detector.detect(window).candidates
        return named

    def reach_from(self, places: np.ndarray, flight: np.ndarray) -> np.ndarray:
        """Where flights ``(..., 3)`` end that begin at places ``(..., 3)``, in metres."""
        return fly_observers(places, SPEED * flight, np.array([self.steps]))[..., 0, :]

    def step(self, flight: np.ndarray) -> tuple[np.ndarray, np.ndarray, dict[str, np.ndarray]]:
        """Vote, and fly ``(B, K, 3)``: rewards and ends ``(B,)`` of the games, and their metrics."""
        speed = flight / np.maximum(np.linalg.norm(flight, axis=-1, keepdims=True), 1)
        message = 2 * self.reach_from(self.places, speed) / ARENA - 1
        action = np.concatenate([self.name(), message, np.clip(speed, -1, 1)], axis=2)
        seen, reward, ended, stopped, info = self.games.step({"observer": action})
        over = (ended["observer"] | stopped["observer"])[:, 0]
        self.remember(self.begin(None, over) if over.any() else seen["observer"])
        return reward["observer"][:, 0], over, {name: part[:, 0] for name, part in info["observer"].items()}

    def look(self) -> np.ndarray:
        """What each observer knows ``(B, K, F)``: places, sectors seen of late, UAVs last seen in each, and numbers."""
        count, uavs = GAME["observers"], GAME["uavs"]
        others = [np.roll(self.places, -shift, axis=1) - self.places for shift in range(1, count)]
        places = np.concatenate([self.places - np.array(ARENA) / 2, *others], axis=2) / ARENA[0]
        column = np.nan_to_num(self.last / ARENA[:2] * GRID).astype(int).clip(0, GRID - 1)
        sector = np.where(np.isnan(self.last[..., 0]), -1, column[..., 1] * GRID + column[..., 0])
        held = (sector[..., None] == np.arange(len(SECTORS))).sum(axis=2) / 5
        age = np.repeat(np.minimum(self.age, 10)[:, None] / 10, count, axis=1)
        numbers = [self.seen["round"] / 20, self.seen["alive"].mean(axis=2, keepdims=True)]
        numbers.append(self.seen["legal"].sum(axis=2, keepdims=True) / uavs)
        return np.concatenate([places, age, held, *numbers], axis=2, dtype=np.float32)


# --- patrols: the flights ``(B, K, 3)`` of all observers --------------------------------------------------------------

Patrol = Callable[[Search], np.ndarray]


def fly_to(search: Search, goals: np.ndarray) -> np.ndarray:
    """The flights to goals ``(B, K, 2)`` in metres, at half the height of the arena."""
    offset = np.concatenate([goals, np.full_like(goals[..., :1], ARENA[2] / 2)], axis=2) - search.places
    return offset / np.maximum(np.linalg.norm(offset, axis=2, keepdims=True), SPEED * search.steps)


def stay(search: Search) -> np.ndarray:
    """No flight."""
    return np.zeros_like(search.places)


def sweep(search: Search) -> np.ndarray:
    """To and fro in a strip each, from side to side as far as no corner stays out of range."""
    half = ARENA[1] / 2 - np.sqrt(max(search.reach**2 - (ARENA[0] / GAME["observers"] / 2) ** 2, 0))
    way = SPEED * search.steps * search.seen["round"][..., 0] / half
    y = ARENA[1] / 2 + half * (1 - np.abs((way + 3) % 4 - 2))
    return fly_to(search, np.stack([search.places[..., 0], y], axis=2))


def follow(search: Search) -> np.ndarray:
    """To the mean of the UAVs that the observer saw last, and of the sectors unseen of late that are nearest to it."""
    distance = np.linalg.norm(SECTORS[:, None] - search.places[:, None, :, :2], axis=-1)  # (B, G, K)
    is_near_unseen = (distance.argmin(axis=2)[:, None] == np.arange(GAME["observers"])[:, None]) & (search.age >= 5)[
        :, None
    ]
    found = ~np.isnan(search.last[..., :1])
    total = is_near_unseen.astype(float) @ SECTORS + np.where(found, search.last, 0).sum(axis=2)
    count = is_near_unseen.sum(axis=2, keepdims=True) + found.sum(axis=2)
    return fly_to(search, np.where(count, total / np.maximum(count, 1), search.places[..., :2]))


def frontier(search: Search) -> np.ndarray:
    """One after another to the sector that was unseen for long and is near, and not to one of another."""
    age, goals = search.age.copy(), search.places[..., :2].copy()
    for k in range(GAME["observers"]):
        distance = np.linalg.norm(SECTORS - goals[:, None, k], axis=2)
        goals[:, k] = SECTORS[(np.minimum(age, 10) - distance / (SPEED * search.steps)).argmax(axis=1)]
        age[np.linalg.norm(SECTORS - goals[:, None, k], axis=2) <= search.reach] = 0
    return fly_to(search, goals)


def cover(search: Search, heads: bool = False) -> np.ndarray:
    """An oracle: one after another to where they see the most UAVs, or heads, as it knows all true positions."""
    truth, flights = search.games.game.swarm, compass(24)
    wanted = truth.alive & truth.head if heads else truth.alive
    near, chosen = np.zeros(wanted.shape), []
    for k in range(GAME["observers"]):
        ends = search.reach_from(search.places[:, None, k], flights)
        distance = np.linalg.norm(ends[:, :, None] - truth.position[:, None], axis=3) - 0.95 * search.reach
        gain = np.maximum(near[:, None], np.exp(-np.maximum(distance, 0) / 60)) * wanted[:, None]
        chosen.append(gain.sum(axis=2).argmax(axis=1))
        near = gain[np.arange(len(gain)), chosen[-1]]
    return flights[np.stack(chosen, axis=1)]


PATROLS: dict[str, Patrol] = {"stay": stay, "sweep": sweep, "follow": follow, "frontier": frontier}
PATROLS |= {"oracle of coverage": cover, "oracle of heads": partial(cover, heads=True)}


def follow_policy(actor: torch.nn.Module, rng: np.random.Generator) -> Patrol:
    """The patrol that draws each flight from what an actor says."""

    @torch.no_grad()
    def fly(search: Search) -> np.ndarray:
        shares = torch.softmax(actor(torch.from_numpy(search.look())), dim=-1).numpy()
        return FLIGHTS[(rng.random((*shares.shape[:2], 1)) > shares.cumsum(axis=2)).sum(axis=2).clip(0, 8)]

    return fly


def make_network(inputs: int, outputs: int) -> torch.nn.Module:
    """A network with two hidden layers."""
    layers = [torch.nn.Linear(inputs, 64), torch.nn.Tanh(), torch.nn.Linear(64, 64), torch.nn.Tanh()]
    return torch.nn.Sequential(*layers, torch.nn.Linear(64, outputs))


def train(cell: str, central: bool, seed: int, decisions: int) -> torch.nn.Module:
    """Train an actor by PPO; with a ``central`` critic, which gets the true state, too (MAPPO), or without (IPPO)."""
    search = Search(BATCH, cell)
    search.reset(seed * BATCH)
    scale = 1 + np.abs(search.games.state()).max(axis=0)

    def know(look: np.ndarray) -> torch.Tensor:
        """What the critic gets."""
        if not central:
            return torch.from_numpy(look)
        state = np.repeat((search.games.state() / scale)[:, None], GAME["observers"], axis=1)
        return torch.from_numpy(np.concatenate([look, state], axis=2))

    look = search.look()
    actor, critic = make_network(look.shape[2], len(FLIGHTS)), make_network(know(look).shape[2], 1)
    weights = [*actor.parameters(), *critic.parameters()]
    optimizer = torch.optim.Adam(weights, lr=1e-3, eps=1e-5)
    total = max(1, decisions // (BATCH * ROUNDS * GAME["observers"]))
    for number in range(total):
        optimizer.param_groups[0]["lr"] = 1e-3 * (1 - number / total)
        steps = []
        for _ in range(ROUNDS):
            look = torch.from_numpy(search.look())
            critic_input = know(look.numpy())
            with torch.no_grad():
                policy, value = Categorical(logits=actor(look)), critic(critic_input)[..., 0]
            action = policy.sample()
            reward, over, metrics = search.step(FLIGHTS[action.numpy()])
            paid = torch.from_numpy((reward + PER_HIT * metrics["hits"]) / 5).float()
            pair = [part[:, None].expand(value.shape) for part in (paid, torch.from_numpy(~over).float())]
            steps.append([look, critic_input, action, policy.log_prob(action), value, *pair])
        look, critic_input, action, old_log_prob, value, reward, continues = (
            torch.stack(part) for part in zip(*steps, strict=True)
        )
        advantage, last = torch.zeros_like(value), torch.zeros_like(value[0])
        with torch.no_grad():
            after = critic(know(search.look()))[..., 0]
        for t in reversed(range(ROUNDS)):
            last = reward[t] + 0.99 * continues[t] * after - value[t] + 0.99 * 0.95 * continues[t] * last
            advantage[t], after = last, value[t]
        target, advantage = advantage + value, (advantage - advantage.mean()) / (advantage.std() + 1e-8)
        flat = [part.flatten(0, 2) for part in (look, critic_input, action, old_log_prob, target, advantage)]
        for _ in range(4):
            for rows in torch.randperm(len(flat[0])).split(768):
                look, critic_input, action, old_log_prob, target, gain = (part[rows] for part in flat)
                policy = Categorical(logits=actor(look))
                ratio = (policy.log_prob(action) - old_log_prob).exp()
                loss = 0.5 * (critic(critic_input)[..., 0] - target).square().mean() - 0.01 * policy.entropy().mean()
                loss = loss - torch.minimum(ratio * gain, ratio.clamp(0.8, 1.2) * gain).mean()
                optimizer.zero_grad()
                loss.backward()
                torch.nn.utils.clip_grad_norm_(weights, 0.5)
                optimizer.step()
    return actor


def play(cell: str, patrol: Patrol, episodes: int) -> list[dict[str, Any]]:
    """Play fresh games, at once, and return their rows."""
    search = Search(episodes, cell, DETECTOR)
    search.reset(FRESH)
    rows, covered, rounds = [{} for _ in range(episodes)], np.zeros(episodes), np.zeros(episodes)
    while (playing := search.playing).any():  # a game that is over begins again, but it doesn't count
        seen = search.seen["legal"].any(axis=1).sum(axis=1) / search.seen["alive"][:, 0].sum(axis=1)
        covered, rounds = covered + playing * seen, rounds + playing
        _, over, metrics = search.step(patrol(search))
        for b in np.flatnonzero(playing & over):
            found = {name: float(metrics[name][b]) for name in ("J", "success")}
            rows[b] = {"episode": int(b), **found, "rounds": int(rounds[b]), "coverage": covered[b] / rounds[b]}
        search.playing = playing & ~over
    return rows


def measure(game: shared.Game, episodes: int, decisions: int) -> list[dict[str, Any]]:
    """The rows of a patrol, of which one that learns is trained first."""
    cell, flight, training = game.values()
    if flight in PATROLS:
        patrol = PATROLS[flight]
    else:
        with shared.isolate_torch(training):
            actor = train(cell, flight == "MAPPO", training, decisions)
        patrol = follow_policy(actor, np.random.default_rng(training))
    rows = play(cell, patrol, episodes)
    return [{**game, **row} for row in rows]


def report(rows: pd.DataFrame) -> str:
    """A line for each patrol in each cell. All play the same swarms, which are the unit of the intervals."""
    swept = rows[rows.flight == "sweep"].set_index(["cell", "episode"]).J
    rows = rows.assign(more=rows.J - swept.reindex(pd.MultiIndex.from_frame(rows[["cell", "episode"]])).to_numpy())

    def each(part: pd.DataFrame) -> str:
        means = part.groupby("training").J.mean()
        return ", ".join(f"{value:.2f}" for value in means) if len(means) > 1 else "–"

    columns = {"n": size, "J": mean("J"), "J of each training": each, "J minus that of `sweep`": mean("more")}
    columns |= {"all heads hit": rate("success"), "coverage": mean("coverage")}
    rows = rows.assign(mean=rows.groupby(["cell", "flight"]).J.transform("mean"))  # the best flight of a cell is last
    rows = rows.sort_values(["cell", "mean"], ascending=[True, False], kind="stable")
    return pivot(rows, {"cell": "cell", "flight": "flight"}, columns)


def main(argv: list[str] | None = None) -> None:
    parser = shared.make_parser(__doc__, ROWS)
    parser.add_argument("--trainings", type=int, default=3, help="number of seeds")
    parser.add_argument("--episodes", type=int, default=100, help="games of a training")
    parser.add_argument("--decisions", type=int, default=DECISIONS, help="of a training")
    options = parser.parse_args(argv)
    flights = [(name, seed) for seed, name in product(range(options.trainings), ("IPPO", "MAPPO"))]
    flights += [(name, 0) for name in PATROLS]
    games = [{"cell": cell, "flight": name, "training": seed} for cell in CELLS for name, seed in flights]
    play_all = partial(measure, episodes=options.episodes, decisions=options.decisions)
    print(report(shared.run_missing(options, games, play_all)))


if __name__ == "__main__":
    main()
