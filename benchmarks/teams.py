"""Teams of observers that learn: what they know has one form for all teams, and the laws of their games are drawn."""

from __future__ import annotations

import numpy as np
from patrols import FLIGHTS, SECTORS, SPEED, Search, count_in_sectors, find_sectors

from usnet_env.envs.distribution import Distribution
from usnet_env.swarm.formation import ARENA

SEEDS, GAMES, PARTS = 1_000_000, 64, 4  # of trainings; games at once, in batches that fly different laws
DRAWN = Distribution(
    follow=["random", "mixed", "chain"],
    mobility=["iid", "smooth_turn", "local_waypoint"],
    formation=["gathered", "around"],
    clusters=(2, 4),
    uavs=(18, 30),
)
RANGES = 150.0, 200.0, 250.0  # metres; one is drawn
AHEAD = np.array([1.0, 2.0, 3.0, 4.5])  # flights from where an observer is


class Team(Search):
    """Games in which what an observer knows has the same form for any number of observers and UAVs."""

    alone = False  # whether an observer knows nothing of the others' places

    def look(self) -> np.ndarray:
        """What each observer knows about each flight ``(B, K, 9, F)``: about points ahead, about its end, and numbers.

        Of a point: the rounds since an observer was near, the UAVs last seen there, whether it is in the arena, and how
        far the next observer is. Of an end: the UAVs last seen in range and nearby, and the unseen sectors in range.
        """
        points = self.places[:, :, None, None, :2] + SPEED * self.steps * FLIGHTS[:, None, :2] * AHEAD[:, None]
        is_inside, sector = ((points >= 0) & (points <= ARENA[:2])).all(axis=-1), find_sectors(points)  # (B, K, 9, 4)
        games, observers, *_ = np.ogrid[: self.num_envs, : self.count, :1, :1]
        age, held = np.minimum(self.age, 10) / 10, count_in_sectors(self.last)
        parts = [age[games, sector] * is_inside, held[games, observers, sector] * is_inside / 5, is_inside]
        parts.append(self.measure_distances(points))
        end = self.reach_from(self.places[:, :, None], np.broadcast_to(FLIGHTS, (1, 1, *FLIGHTS.shape)))[..., :2]
        gap = np.linalg.norm(end[:, :, :, None] - self.last[:, :, None], axis=-1) / self.reach  # (B, K, 9, N)
        in_range = np.linalg.norm(end[:, :, :, None] - SECTORS, axis=-1) <= self.reach  # (B, K, 9, G)
        sums = [(gap < 1).sum(axis=3) / 5, (gap < 0.6).sum(axis=3) / 5, (in_range * age[:, None, None]).sum(axis=3) / 3]
        numbers = np.concatenate([*self.list_numbers(), np.full_like(self.places[..., :1], self.reach / 200)], axis=2)
        numbers = np.broadcast_to(numbers[:, :, None], (*end.shape[:3], numbers.shape[2]))
        stays = np.broadcast_to(np.arange(len(FLIGHTS))[:, None] == 0, (*end.shape[:3], 1))
        return np.concatenate([*parts, np.stack(sums, axis=3), numbers, stays], axis=3, dtype=np.float32)

    def measure_distances(self, points: np.ndarray) -> np.ndarray:
        """The distances of points ``(B, K, 9, 4, 2)`` to the next other observer, in km; at most 1."""
        near = np.ones(points.shape[:-1])
        for shift in range(1, 1 if self.alone else self.count):
            other = np.roll(self.places, -shift, axis=1)[:, :, None, None, :2]
            near = np.minimum(near, np.linalg.norm(points - other, axis=-1) / 1000)
        return near

    def state(self) -> np.ndarray:
        """True positions ``(B, S)``: observers, the heads and UAVs that are alive in each sector; and the round."""
        truth = self.games.game.swarm
        is_head, position = truth.alive & truth.head, truth.position[..., :2]
        heads, uavs = (count_in_sectors(np.where(some[..., None], position, np.nan)) for some in (is_head, truth.alive))
        places, rounds = self.places.reshape(self.num_envs, -1) / 1000, self.seen["round"][:, 0] / 20
        return np.concatenate([places, heads, uavs / 5, rounds], axis=1, dtype=np.float32)


class Drawn:
    """Games of drawn laws in several batches, of which one is drawn anew after each rollout."""

    def __init__(self, observers: int, seed: int) -> None:
        self.count, self.num_envs, self.rng = observers, GAMES, np.random.default_rng(seed)
        self.parts = [self.draw() for _ in range(PARTS)]

    def draw(self) -> Team:
        """A batch of games."""
        drawn = {"observers": self.count, "sensing_range": self.rng.choice(RANGES), **DRAWN.draw(self.rng)}
        team = Team(self.num_envs // PARTS, **drawn)
        team.reset(int(self.rng.integers(SEEDS)))
        return team

    def redraw(self) -> None:
        """Replace the oldest batch."""
        self.parts = [*self.parts[1:], self.draw()]

    def look(self) -> np.ndarray:
        """That of all games."""
        return np.concatenate([part.look() for part in self.parts])

    def state(self) -> np.ndarray:
        """That of all games."""
        return np.concatenate([part.state() for part in self.parts])

    def step(self, flight: np.ndarray) -> tuple[np.ndarray, np.ndarray, dict[str, np.ndarray]]:
        """Fly in all games: rewards, ends, hits."""
        steps = [part.step(own) for part, own in zip(self.parts, np.split(flight, PARTS), strict=True)]
        reward, over, hits = (
            np.concatenate(each) for each in zip(*((*two, metrics["hits"]) for *two, metrics in steps), strict=True)
        )
        return reward, over, {"hits": hits}
