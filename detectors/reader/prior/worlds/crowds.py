"""Worlds in which UAVs act on each other: flocks, herds, people, and particles with springs."""

from collections.abc import Callable

import numpy as np

from detectors.reader.prior.families import draw_log
from detectors.reader.prior.worlds.stage import Flight, Stage, draw_ways, place_groups, travel
from usnet_env.arrays import Floats


def _sum_neighbours(p: Floats, velocity: Floats, weight: Floats, radius: Floats) -> tuple[Floats, Floats, Floats]:
    """The push, mean velocity and mean direction of each UAV's neighbours within ``radius (B, 3)``, ``(B, n, 3)`` each.

    ``weight`` ``(B, n, n)`` is the influence of UAV j on UAV i, 0 on the diagonal. A push falls with the distance.
    """
    square = (p * p).sum(-1)
    distance = np.sqrt(np.maximum(square[:, :, None] + square[:, None] - 2.0 * p @ p.swapaxes(1, 2), 1e-12))
    repulsion, alignment, attraction = (weight * (distance < radius[:, k, None, None]) for k in range(3))
    size_near, size_far = (np.abs(part).sum(-1, keepdims=True) + 1e-9 for part in (alignment, attraction))
    repulsion, attraction = np.abs(repulsion) * (1.0 / radius[:, :1, None] - 1.0 / distance), attraction / distance
    push, pull = (part @ p - part.sum(-1, keepdims=True) * p for part in (repulsion, attraction))
    return push, alignment @ velocity / size_near, pull / size_far


def draw_walkers(rng: np.random.Generator, stage: Stage) -> Flight:
    """UAVs that fly on their own: no UAV leads."""
    start, ways = 30.0 * stage.draw_normals(rng, stage.uavs), draw_ways(rng, stage, stage.steps, stage.uavs)
    return Flight(travel(draw_log(rng, 0.03, 3.0) * start, ways), np.arange(stage.uavs))


def _fly(rng: np.random.Generator, stage: Stage, start: Floats, turn: Floats, wish: Callable[..., Floats]) -> Floats:
    """Positions ``(B, T + 1, n, 3)`` of UAVs, the part ``turn`` of whose velocities becomes their wish in a step."""
    position = np.empty((stage.windows, stage.steps + 31, *start.shape[1:]))
    velocity = np.zeros_like(position)
    position[:, 0], shake = start, draw_log(rng, 0.02, 0.4)
    for t in range(stage.steps + 30):
        goal = wish(t, position, velocity) + shake * stage.draw_normals(rng, start.shape[1])
        velocity[:, t + 1] = (1.0 - turn) * velocity[:, t] + turn * goal
        position[:, t + 1] = position[:, t] + velocity[:, t + 1]
    return position[:, 30:]


def _fly_flock(rng: np.random.Generator, stage: Stage, weight: Floats, drive: Floats) -> Floats:
    """Positions of a flock with influences ``weight (B, n, n)``; a part ``drive (n,)`` of velocity is an own way."""
    windows, uavs, own_part = stage.windows, stage.uavs, drive[:, None]
    spacing = draw_log(rng, 1.0, 6.0, windows, 1)
    radius = spacing * np.sort(draw_log(rng, 1.0, 20.0, windows, 3), axis=1)
    push, align, pull = (draw_log(rng, low, high, windows, 1, 1) for low, high in ((1, 3), (0.2, 1.5), (0.05, 0.6)))
    ways, fixed = draw_ways(rng, stage, stage.steps + 30, uavs), rng.random() < 0.5
    delay = max(0, int(rng.integers(-7, 9)))  # steps, in half of the draws

    def wish(t: int, position: Floats, velocity: Floats) -> Floats:
        acts = _sum_neighbours(position[:, t], velocity[:, max(t - delay, 0)], weight, radius)
        velocity_goal = (1.0 - own_part) * (push * acts[0] + align * acts[1] + pull * acts[2]) + own_part * ways[:, t]
        size = np.linalg.norm(velocity_goal, axis=-1, keepdims=True) + 1e-9
        return velocity_goal / size if fixed else velocity_goal * np.minimum(1.0, 2.0 / size)

    start = 0.6 * spacing[..., None] * uavs ** (1.0 / stage.axes.sum()) * stage.draw_normals(rng, uavs)
    return _fly(rng, stage, start, draw_log(rng, 0.15, 1.0, windows, 1, 1), wish)


def draw_leaderless(rng: np.random.Generator, stage: Stage) -> Flight:
    """A flock of equals: no UAV leads."""
    weight, drive = 1.0 - np.eye(stage.uavs), np.full(stage.uavs, rng.choice([0.0, 0.0, 0.2]))
    flown = _fly_flock(rng, stage, np.tile(weight, (stage.windows, 1, 1)), drive)
    return Flight(flown, np.arange(stage.uavs), link=np.nan)


def draw_boids_signed(rng: np.random.Generator, stage: Stage) -> Flight:
    """A flock of mutual likes and dislikes, in which all like one UAV much more, and it flies as it wants."""
    weight = draw_log(rng, 0.02, 0.4) * rng.normal(0.3, 1.0, (stage.windows, stage.uavs, stage.uavs))
    weight[:, :, 0] = rng.uniform(0.7, 1.5, (stage.windows, stage.uavs))
    weight[:, 0] *= 0.2 * rng.random()
    drive = np.append(rng.uniform(0.6, 1.0), np.zeros(stage.uavs - 1))
    weight *= 1.0 - np.eye(stage.uavs)
    link = np.abs(weight) > 0.25 * np.abs(weight).max(axis=2, keepdims=True)
    return Flight(_fly_flock(rng, stage, weight, drive), np.zeros(stage.uavs, np.int64), link=link)


def draw_herd(rng: np.random.Generator, stage: Stage) -> Flight:
    """A herd of equals that the first UAV drives from behind; it is unseen in half of the draws. No UAV leads.

    In half of the draws it is seen in up to 6 times finer steps.
    """
    shape, finer = (stage.windows, 1, 1), float(draw_log(rng, 1.0, 6.0)) if rng.random() < 0.5 else 1.0
    reach = finer * draw_log(rng, 4.0, 20.0, *shape)
    weight, radius = np.tile(1.0 - np.eye(stage.uavs), (stage.windows, 1, 1)), reach[:, 0] * [0.15, 0.5, 3.0]
    weight[:, :, 0] = 0.0
    align, pull = (draw_log(rng, 0.1, 0.8, *shape) for _ in range(2))
    course = draw_ways(rng, stage, stage.steps + 30, 1, 0.1 / finer)
    course /= np.linalg.norm(course, axis=-1, keepdims=True) + 1e-9

    def wish(t: int, position: Floats, velocity: Floats) -> Floats:
        current, herd = position[:, t], position[:, t, 1:]
        acts = _sum_neighbours(current, velocity[:, t], weight, radius)
        offset = current - current[:, :1]
        distance = np.linalg.norm(offset, axis=-1, keepdims=True) + 1e-9
        goal_velocity = 1.5 * np.exp(-distance / reach) * offset / distance + acts[0] + align * acts[1] + pull * acts[2]
        aim = herd.mean(1, keepdims=True) - course[:, t] * (reach + herd.std((1, 2), keepdims=True)) - current[:, :1]
        goal_velocity[:, :1] = 1.2 * aim / np.maximum(np.linalg.norm(aim, axis=-1, keepdims=True), 3.0)
        return goal_velocity

    start = 0.15 * reach * np.sqrt(stage.uavs) * stage.draw_normals(rng, stage.uavs)
    start[:, :1] -= 1.5 * reach * course[:, 0]
    shown = _fly(rng, stage, start, draw_log(rng, 0.2, 0.9, *shape) / finer, wish)[:, :, int(rng.integers(2)) :]
    return Flight(shown, np.arange(shown.shape[2]), link=np.nan)


def draw_people(rng: np.random.Generator, stage: Stage) -> Flight:
    """Groups of 2 to 6 people: one of each knows the way, in front or aside; the others keep by it, and apart."""
    groups = max(1, round(stage.uavs / float(rng.uniform(2.0, 6.0))))
    leader, window = np.arange(stage.uavs) % groups, np.arange(stage.windows)[:, None]
    ways, delay = draw_ways(rng, stage, stage.steps + 30, groups, 0.1), stage.draw_delays(rng, 15)
    slot = draw_log(rng, 0.5, 3.0) * (stage.draw_normals(rng, stage.uavs) + rng.normal(0.0, 1.5) * stage.axes)
    slot[:, :groups] = 0.0
    weight = np.tile(np.where(leader[:, None] == leader, 1.0, 0.2) - np.eye(stage.uavs), (stage.windows, 1, 1))
    weight[:, :groups] *= rng.uniform(0.0, 0.4)
    velocity_gain, slot_gain, turn = (draw_log(rng, low, 1.0, stage.windows, 1, 1) for low in (0.3, 0.05, 0.2))

    def wish(t: int, position: Floats, velocity: Floats) -> Floats:
        past = np.maximum(t - delay, 0)
        goal = slot_gain * (position[window, past, leader] + slot - position[:, t])
        goal += velocity_gain * velocity[window, past, leader]
        goal[:, :groups] = ways[:, t]
        return goal + _sum_neighbours(position[:, t], velocity[:, t], weight, np.full((len(weight), 3), 1.5))[0]

    start = 3.0 * place_groups(rng, stage, np.arange(groups))[:, leader] + slot
    return Flight(_fly(rng, stage, start, turn, wish), leader, delay)


def draw_springs(rng: np.random.Generator, stage: Stage) -> Flight:
    """Particles with springs, in a box or not; the first pulls all others; they pull it back as each other, or not.

    A spring acts on both of its ends, or on one.
    """
    windows, uavs = stage.windows, stage.uavs
    stiff = draw_log(rng, 0.0005, 0.2, windows, 1, 1) / np.sqrt(uavs)
    spring = stiff * (rng.random((windows, uavs, uavs)) < rng.uniform(0.0, 0.8))
    if rng.random() < 0.5:
        spring = np.triu(spring, 1) + np.triu(spring, 1).swapaxes(1, 2)
    spring[:, 0] *= rng.choice([0.0, 1.0, 1.0, rng.random()])
    spring[:, :, 0] = stiff[:, 0] * rng.uniform(0.5, 3.0, (windows, uavs)) ** rng.integers(2)
    pushed, wall = rng.choice([0.0, 0.0, 0.0, 0.003, 0.02]), np.inf if rng.random() < 0.4 else rng.uniform(2.0, 10.0)
    push = pushed * stage.draw_normals(rng, stage.steps, uavs)
    push[:, :, 0] *= rng.uniform(0.0, 3.0)
    drag = float(draw_log(rng, 0.005, 0.3)) if pushed else 0.0
    positions, velocity = [stage.draw_normals(rng, uavs)], draw_log(rng, 0.03, 0.5) * stage.draw_normals(rng, uavs)
    for substep in range(4 * stage.steps):  # four parts of each step
        force = spring @ positions[-1] - spring.sum(-1, keepdims=True) * positions[-1]
        velocity = velocity + (push[:, substep // 4] - drag * velocity + force) / 4.0
        positions.append(positions[-1] + velocity / 4.0)
        velocity = np.where(np.abs(positions[-1]) > wall, -np.sign(positions[-1]) * np.abs(velocity), velocity)
    link = (spring > 0) & ~np.eye(uavs, dtype=bool)
    return Flight(np.stack(positions[::4], axis=1), np.zeros(uavs, np.int64), link=link)
