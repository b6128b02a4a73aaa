"""The game of observers that fly, as a batch in which an action is only a flight, and scripted patrols."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from usnet_env import Window, make_detector
from usnet_env.multiagent import usnet_observers_v0
from usnet_env.multiagent.sensors import fly_observers
from usnet_env.swarm.formation import ARENA

GAME: dict[str, Any] = {"clusters": 3, "uavs": 30, "observers": 3, "observation_steps": 30, "message_size": 3}
GAME |= {"formation": "gathered", "sensing_range": 200.0}
SPEED, GRID = 4.0, 6  # metres a step; sectors of a side of the arena
SECTORS = (np.stack(np.meshgrid(*[(np.arange(GRID) + 0.5) / GRID] * 2), axis=-1).reshape(-1, 2)) * ARENA[:2]


def compass(count: int) -> np.ndarray:
    """The flights ``(count + 1, 3)``: none, and level ones at top speed in equal angles."""
    angles = 2 * np.pi * np.arange(count) / count
    level = np.stack([np.cos(angles), np.sin(angles), 0 * angles], axis=1)
    return np.concatenate([np.zeros((1, 3)), level])


FLIGHTS = compass(8)  # that learners choose from


class Search:
    """B games in which an action is only a flight; a game that is over begins again.

    Args:
        num_envs: B.
        detector: what names the heads in the windows of each observer; by default the rule of trainings.
        arguments: those of the game that differ from ``GAME``.
    """

    def __init__(self, num_envs: int, detector: str | None = None, **arguments: Any) -> None:
        self.arguments, self.num_envs = GAME | arguments, num_envs
        self.games = usnet_observers_v0.batch_env(num_envs, **self.arguments, observer_speed=SPEED)
        self.reach, self.steps = self.arguments["sensing_range"], self.games.config.steps
        self.count, self.uavs = self.arguments["observers"], self.arguments["uavs"]
        self.detector, self.playing = detector and make_detector(detector), np.ones(num_envs, bool)
        if self.detector:
            self.detector.reset(0)
        self.age = np.zeros((num_envs, len(SECTORS)))  # rounds since an observer was in range of a sector's middle
        self.last = np.zeros((num_envs, self.count, self.uavs, 2))  # where each last saw a UAV, or NaN

    def reset(self, seed: int) -> None:
        """Start all games."""
        self.remember(self.begin(seed, np.ones(self.num_envs, bool)))
        self.scale = 1 + np.abs(self.games.state()).max(axis=0)

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
            whole = named & (2 * self.seen["seen"].sum(axis=2) > self.arguments["observation_steps"])
            led = (truth.root[:, :, None] == np.arange(self.uavs)) & ~truth.head[:, :, None]
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
        others = [np.roll(self.places, -shift, axis=1) - self.places for shift in range(1, self.count)]
        places = np.concatenate([self.places - np.array(ARENA) / 2, *others], axis=2) / ARENA[0]
        held = count_in_sectors(self.last) / 5
        age = np.repeat(np.minimum(self.age, 10)[:, None] / 10, self.count, axis=1)
        return np.concatenate([places, age, held, *self.list_numbers()], axis=2, dtype=np.float32)

    def list_numbers(self) -> list[np.ndarray]:
        """The round, and the shares of UAVs that are alive and that an observer sees, ``(B, K, 1)`` each."""
        alive, legal = (self.seen[name].sum(axis=2, keepdims=True) / self.uavs for name in ("alive", "legal"))
        return [self.seen["round"] / 20, alive, legal]

    def state(self) -> np.ndarray:
        """The true state ``(B, S)`` for a critic."""
        return self.games.state() / self.scale

    def redraw(self) -> None:
        """Between rollouts games may be replaced by others; these aren't."""


def find_sectors(points: np.ndarray) -> np.ndarray:
    """The numbers of the sectors of points ``(..., 2)`` in metres, ``(...)``; of NaN, -1."""
    column = np.nan_to_num(points / ARENA[:2] * GRID).astype(int).clip(0, GRID - 1)
    return np.where(np.isnan(points[..., 0]), -1, column[..., 1] * GRID + column[..., 0])


def count_in_sectors(points: np.ndarray) -> np.ndarray:
    """How many of points ``(..., N, 2)`` are in each sector, ``(..., G)``."""
    return (find_sectors(points)[..., None] == np.arange(len(SECTORS))).sum(axis=-2)


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
    half = ARENA[1] / 2 - np.sqrt(max(search.reach**2 - (ARENA[0] / search.count / 2) ** 2, 0))
    way = SPEED * search.steps * search.seen["round"][..., 0] / half
    y = ARENA[1] / 2 + half * (1 - np.abs((way + 3) % 4 - 2))
    return fly_to(search, np.stack([search.places[..., 0], y], axis=2))


def follow(search: Search) -> np.ndarray:
    """To the mean of the UAVs that the observer saw last, and of the sectors unseen of late that are nearest to it."""
    distance = np.linalg.norm(SECTORS[:, None] - search.places[:, None, :, :2], axis=-1)  # (B, G, K)
    is_near_unseen = (distance.argmin(axis=2)[:, None] == np.arange(search.count)[:, None]) & (search.age >= 5)[:, None]
    found = ~np.isnan(search.last[..., :1])
    total = is_near_unseen.astype(float) @ SECTORS + np.where(found, search.last, 0).sum(axis=2)
    count = is_near_unseen.sum(axis=2, keepdims=True) + found.sum(axis=2)
    return fly_to(search, np.where(count, total / np.maximum(count, 1), search.places[..., :2]))


def frontier(search: Search) -> np.ndarray:
    """One after another to the sector that was unseen for long and is near, and not to one of another."""
    age, goals = search.age.copy(), search.places[..., :2].copy()
    for k in range(search.count):
        distance = np.linalg.norm(SECTORS - goals[:, None, k], axis=2)
        goals[:, k] = SECTORS[(np.minimum(age, 10) - distance / (SPEED * search.steps)).argmax(axis=1)]
        age[np.linalg.norm(SECTORS - goals[:, None, k], axis=2) <= search.reach] = 0
    return fly_to(search, goals)


def cover(search: Search, heads: bool = False) -> np.ndarray:
    """An oracle: one after another to where they see the most UAVs, or heads, as it knows all true positions."""
    truth, flights = search.games.game.swarm, compass(24)
    wanted = truth.alive & truth.head if heads else truth.alive
    near, chosen = np.zeros(wanted.shape), []
    for k in range(search.count):
        ends = search.reach_from(search.places[:, None, k], flights)
        distance = np.linalg.norm(ends[:, :, None] - truth.position[:, None], axis=3) - 0.95 * search.reach
        gain = np.maximum(near[:, None], np.exp(-np.maximum(distance, 0) / 60)) * wanted[:, None]
        chosen.append(gain.sum(axis=2).argmax(axis=1))
        near = gain[np.arange(len(gain)), chosen[-1]]
    return flights[np.stack(chosen, axis=1)]


PATROLS: dict[str, Patrol] = {"stay": stay, "sweep": sweep, "follow": follow, "frontier": frontier}
PATROLS |= {"oracle of coverage": cover, "oracle of heads": partial(cover, heads=True)}


def play(search: Search, patrol: Patrol, seed: int) -> list[dict[str, Any]]:
    """Play a game of each seed from this one on, at once, and return their rows."""
    search.reset(seed)
    episodes = search.num_envs
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
