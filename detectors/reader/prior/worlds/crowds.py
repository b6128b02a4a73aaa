"""Worlds in which UAVs act on each other: flocks, herds, people, and particles with springs."""

from __future__ import annotations

import numpy as np

from detectors.reader.prior.draws import draw_log
from detectors.reader.prior.worlds.neighbours import fly_springs, sum_neighbours
from detectors.reader.prior.worlds.stage import Flight, Stage, draw_ways, place_groups, travel
from usnet_env.arrays import Floats


def draw_walkers(rng: np.random.Generator, stage: Stage) -> Flight:
    """UAVs that fly on their own: nobody leads."""
    own = np.arange(stage.uavs)
    place = place_groups(rng, stage, np.zeros_like(own))
    return Flight(travel(place, draw_ways(rng, stage, stage.steps, stage.uavs)), own)


def _fly_flock(
    rng: np.random.Generator, stage: Stage, weight: Floats, ways: Floats, drive: Floats, least: float = 0.1
) -> Floats:
    """Positions ``(B, T + 1, n, 3)`` of a flock of push, alignment and attraction with ``weight (B, n, n)``.

    The part ``drive`` ``(B, n)`` of the velocity is that of the ways ``(B, S, n, 3)``, S > T. The flock turns as far in
    a step as its inertia allows, and its speed is fixed in half of the draws. Neighbours may act some steps late.
    """
    windows, uavs, drive = stage.windows, stage.uavs, drive[..., None]
    near = draw_log(rng, 1.0, 6.0, windows)
    radius = near[:, None] * np.sort(draw_log(rng, 1.0, 20.0, (windows, 3)), axis=1)
    place = 0.6 * near[:, None, None] * uavs ** (1.0 / stage.axes.sum()) * stage.draw_normals(rng, uavs)
    push, align, pull = (draw_log(rng, low, high, (windows, 1, 1)) for low, high in ((1, 3), (least, 1.5), (0.05, 0.6)))
    turn, shake = draw_log(rng, 0.15, 1.0, (windows, 1, 1)), draw_log(rng, 0.02, 0.4, (windows, 1, 1))
    fixed, late = rng.random() < 0.5, int(rng.choice([0, 0, int(rng.integers(1, 9))]))
    velocity, positions = [stage.draw_normals(rng, uavs)], []
    for t in range(ways.shape[1]):
        positions.append(place)
        acts = sum_neighbours(place, velocity[max(len(velocity) - 1 - late, 0)], weight, radius)
        wanted = push * acts[0] + align * acts[1] + pull * acts[2] + shake * stage.draw_normals(rng, uavs)
        wanted = (1.0 - drive) * wanted + drive * ways[:, t]
        new = (1.0 - turn) * velocity[-1] + turn * wanted
        speed = np.linalg.norm(new, axis=-1, keepdims=True)
        new = new / (speed + 1e-9) if fixed else new * np.minimum(1.0, 2.0 / (speed + 1e-9))
        velocity.append(new)
        place = place + new
    return np.stack(positions[-stage.steps - 1 :], axis=1)


def draw_leaderless(rng: np.random.Generator, stage: Stage) -> Flight:
    """A flock of equals: nobody leads."""
    weight = np.tile(1.0 - np.eye(stage.uavs), (stage.windows, 1, 1))
    ways = draw_ways(rng, stage, stage.steps + 20, stage.uavs)
    drive = np.full((stage.windows, stage.uavs), rng.choice([0.0, 0.0, 0.2]))
    return Flight(_fly_flock(rng, stage, weight, ways, drive), np.arange(stage.uavs))


def draw_boids_signed(rng: np.random.Generator, stage: Stage) -> Flight:
    """A flock of mutual likes and dislikes, in which all like one UAV much more, and it flies as it wants."""
    weight = draw_log(rng, 0.02, 0.4) * rng.normal(0.3, 1.0, (stage.windows, stage.uavs, stage.uavs))
    weight[:, :, 0] = rng.uniform(0.7, 1.5, (stage.windows, stage.uavs))
    weight[:, 0] *= 0.2 * rng.random()
    weight *= 1.0 - np.eye(stage.uavs)
    drive = np.zeros((stage.windows, stage.uavs))
    drive[:, 0] = rng.uniform(0.6, 1.0)
    ways = draw_ways(rng, stage, stage.steps + 20, stage.uavs)
    return Flight(_fly_flock(rng, stage, weight, ways, drive, 0.4), np.zeros(stage.uavs, np.int64))


def draw_herd(rng: np.random.Generator, stage: Stage) -> Flight:
    """A herd of equals that a driver pushes from behind; it is unseen in half of the draws. Nobody leads."""
    windows, herd = stage.windows, stage.uavs - 1
    reach = draw_log(rng, 4.0, 20.0, (windows, 1, 1))
    radius = np.stack([reach[:, 0, 0] * share for share in (0.15, 0.5, 3.0)], axis=1)
    place = 0.15 * reach * np.sqrt(herd) * stage.draw_normals(rng, herd)
    weight = np.tile(1.0 - np.eye(herd), (windows, 1, 1))
    goal = draw_ways(rng, stage, stage.steps + 30, 1, 0.1)[:, :, 0]
    goal /= np.linalg.norm(goal, axis=-1, keepdims=True) + 1e-9
    align, pull, calm = (draw_log(rng, 0.1, 0.8, (windows, 1, 1)) for _ in range(3))
    driver = -reach[:, 0] * 1.5 * goal[:, 0]
    velocity, positions = np.zeros_like(place), []
    for t in range(goal.shape[1]):
        positions.append(np.concatenate([driver[:, None], place], axis=1))
        away = place - driver[:, None]
        distance = np.linalg.norm(away, axis=-1, keepdims=True) + 1e-9
        flees = 1.5 * np.exp(-distance / reach) * away / distance
        acts = sum_neighbours(place, velocity, weight, radius)
        wanted = flees + acts[0] + align * acts[1] + pull * acts[2] * flees.max() + 0.1 * stage.draw_normals(rng, herd)
        velocity = (1.0 - calm) * velocity + calm * wanted
        place = place + velocity
        wish = place.mean(1) - goal[:, t] * (reach[:, 0] + place.std((1, 2))[:, None]) - driver
        driver = driver + 1.2 * wish / np.maximum(np.linalg.norm(wish, axis=-1, keepdims=True), 3.0)
    flight = Flight(np.stack(positions[-stage.steps - 1 :], axis=1), np.arange(stage.uavs))
    return flight.drop(1) if rng.random() < 0.5 else flight


def draw_people(rng: np.random.Generator, stage: Stage) -> Flight:
    """Groups of 2 to 6 people: one of each knows the way, in front or aside; the others keep by it, and apart."""
    groups = max(1, round(stage.uavs / float(rng.uniform(2.0, 6.0))))
    leader = np.arange(stage.uavs) % groups
    ways = draw_ways(rng, stage, stage.steps + 20, groups, 0.1)
    slot = draw_log(rng, 0.5, 3.0) * (stage.draw_normals(rng, stage.uavs) + rng.normal(0.0, 1.5) * stage.axes)
    slot[:, :groups] = 0.0
    position = np.empty((stage.windows, ways.shape[1] + 1, stage.uavs, 3))
    velocity = np.empty_like(position)
    position[:, 0] = 3.0 * place_groups(rng, stage, np.arange(groups))[:, leader] + slot
    velocity[:, 0] = ways[:, 0, leader]
    together = (leader[:, None] == leader) - np.eye(stage.uavs)
    weight = np.tile(together + 0.2 * (leader[:, None] != leader), (stage.windows, 1, 1))
    weight[:, :groups] *= rng.uniform(0.0, 0.4)
    radius, shake = np.tile([1.5, 0.1, 0.1], (stage.windows, 1)), draw_log(rng, 0.02, 0.3)
    delay, window = np.minimum(stage.draw_delays(rng), 15), np.arange(stage.windows)[:, None]
    copies, keeps, turn = (draw_log(rng, low, 1.0, (stage.windows, 1, 1)) for low in (0.3, 0.05, 0.2))
    for t in range(ways.shape[1]):
        late = np.maximum(t - delay, 0)
        wanted = copies * velocity[window, late, leader]
        wanted += keeps * (position[window, late, leader] + slot - position[:, t])
        wanted[:, :groups] = ways[:, t]
        wanted += sum_neighbours(position[:, t], velocity[:, t], weight, radius)[0]
        wanted += shake * stage.draw_normals(rng, stage.uavs)
        velocity[:, t + 1] = (1.0 - turn) * velocity[:, t] + turn * wanted
        position[:, t + 1] = position[:, t] + velocity[:, t + 1]
    return Flight(position[:, -stage.steps - 1 :], leader, delay)


def draw_springs(rng: np.random.Generator, stage: Stage) -> Flight:
    """Particles with springs; the first pulls all others, and these pull it back less, or not at all."""
    windows, uavs = stage.windows, stage.uavs
    size = draw_log(rng, 0.003, 0.3, (windows, 1, 1)) / uavs**0.5
    linked = rng.random((windows, uavs, uavs)) < rng.uniform(0.0, 0.7)
    spring = size * np.triu(linked, 1)
    spring += spring.swapaxes(1, 2)
    spring[:, :, 0] = size[:, 0] * rng.uniform(0.5, 3.0, (windows, uavs))
    spring[:, 0] = spring[:, :, 0] * (rng.uniform(0.0, 1.0) if rng.random() < 0.3 else 0.0)
    spring[:, 0, 0] = 0.0
    position = np.empty((windows, stage.steps + 1, uavs, 3))
    speed = draw_log(rng, 0.05, 0.5) * np.ones(3)
    position[:, 0], velocity = stage.draw_normals(rng, uavs), speed * stage.draw_normals(rng, uavs)
    push = rng.choice([0.0, 0.01, 0.05]) * stage.draw_normals(rng, stage.steps, uavs)
    push[:, :, 0] *= rng.uniform(0.0, 3.0)
    drag = draw_log(rng, 0.005, 0.3, windows) if push.any() else np.zeros(windows)
    wall = np.inf if rng.random() < 0.4 else rng.uniform(2.0, 6.0)
    fly_springs(position, velocity, spring, drag, push, wall, 4)
    return Flight(position, np.zeros(uavs, np.int64))
