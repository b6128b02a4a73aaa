"""Worlds in which UAVs act on each other: flocks, herds, people, and particles with springs."""

from collections.abc import Callable

import numpy as np

from detectors.reader.prior.families import draw_log
from detectors.reader.prior.worlds.stage import Flight, Stage, draw_ways, place_groups, travel
from usnet_env.arrays import Floats


def _sum_neighbours(place: Floats, velocity: Floats, weight: Floats, radius: Floats) -> tuple[Floats, Floats, Floats]:
    """The push, mean velocity and mean direction of each UAV's neighbours within ``radius (B, 3)``, ``(B, n, 3)`` each.

    ``weight`` ``(B, n, n)`` is the influence of UAV j on UAV i, 0 on the diagonal. A push falls with the distance.
    """
    square = (place * place).sum(-1)
    distance = np.sqrt(np.maximum(square[:, :, None] + square[:, None] - 2.0 * place @ place.swapaxes(1, 2), 1e-12))
    close, near, far = (weight * (distance < radius[:, k, None, None]) for k in range(3))
    size_near, size_far = (np.abs(part).sum(-1, keepdims=True) + 1e-9 for part in (near, far))
    close, far = np.abs(close) * (1.0 / radius[:, :1, None] - 1.0 / distance), far / distance
    push, pull = (part @ place - part.sum(-1, keepdims=True) * place for part in (close, far))
    return push, near @ velocity / size_near, pull / size_far


def draw_walkers(rng: np.random.Generator, stage: Stage) -> Flight:
    """UAVs that fly on their own: nobody leads."""
    place, ways = 30.0 * stage.draw_normals(rng, stage.uavs), draw_ways(rng, stage, stage.steps, stage.uavs)
    return Flight(travel(draw_log(rng, 0.03, 3.0) * place, ways), np.arange(stage.uavs))


def _fly(rng: np.random.Generator, stage: Stage, place: Floats, turn: Floats, wish: Callable[..., Floats]) -> Floats:
    """Positions ``(B, T + 1, n, 3)`` of UAVs, the part ``turn`` of whose velocities becomes their wish in a step."""
    position = np.empty((stage.windows, stage.steps + 31, *place.shape[1:]))
    velocity = np.zeros_like(position)
    position[:, 0], shake = place, draw_log(rng, 0.02, 0.4)
    for t in range(stage.steps + 30):
        wanted = wish(t, position, velocity) + shake * stage.draw_normals(rng, place.shape[1])
        velocity[:, t + 1] = (1.0 - turn) * velocity[:, t] + turn * wanted
        position[:, t + 1] = position[:, t] + velocity[:, t + 1]
    return position[:, 30:]


def _fly_flock(rng: np.random.Generator, stage: Stage, weight: Floats, drive: Floats) -> Floats:
    """Positions of a flock with influences ``weight (B, n, n)``; a part ``drive (n,)`` of velocity is an own way."""
    near, windows, uavs, part = draw_log(rng, 1.0, 6.0, stage.windows, 1), stage.windows, stage.uavs, drive[:, None]
    radius = near * np.sort(draw_log(rng, 1.0, 20.0, windows, 3), axis=1)
    push, align, pull = (draw_log(rng, low, high, windows, 1, 1) for low, high in ((1, 3), (0.2, 1.5), (0.05, 0.6)))
    ways, fixed = draw_ways(rng, stage, stage.steps + 30, uavs), rng.random() < 0.5
    late = max(0, int(rng.integers(-7, 9)))  # steps, in half of the draws

    def wish(t: int, position: Floats, velocity: Floats) -> Floats:
        acts = _sum_neighbours(position[:, t], velocity[:, max(t - late, 0)], weight, radius)
        wanted = (1.0 - part) * (push * acts[0] + align * acts[1] + pull * acts[2]) + part * ways[:, t]
        size = np.linalg.norm(wanted, axis=-1, keepdims=True) + 1e-9
        return wanted / size if fixed else wanted * np.minimum(1.0, 2.0 / size)

    place = 0.6 * near[..., None] * uavs ** (1.0 / stage.axes.sum()) * stage.draw_normals(rng, uavs)
    return _fly(rng, stage, place, draw_log(rng, 0.15, 1.0, windows, 1, 1), wish)


def draw_leaderless(rng: np.random.Generator, stage: Stage) -> Flight:
    """A flock of equals: nobody leads."""
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
    goal = draw_ways(rng, stage, stage.steps + 30, 1, 0.1 / finer)
    goal /= np.linalg.norm(goal, axis=-1, keepdims=True) + 1e-9

    def wish(t: int, position: Floats, velocity: Floats) -> Floats:
        place, herd = position[:, t], position[:, t, 1:]
        acts = _sum_neighbours(place, velocity[:, t], weight, radius)
        away = place - place[:, :1]
        distance = np.linalg.norm(away, axis=-1, keepdims=True) + 1e-9
        wanted = 1.5 * np.exp(-distance / reach) * away / distance + acts[0] + align * acts[1] + pull * acts[2]
        behind = herd.mean(1, keepdims=True) - goal[:, t] * (reach + herd.std((1, 2), keepdims=True)) - place[:, :1]
        wanted[:, :1] = 1.2 * behind / np.maximum(np.linalg.norm(behind, axis=-1, keepdims=True), 3.0)
        return wanted

    place = 0.15 * reach * np.sqrt(stage.uavs) * stage.draw_normals(rng, stage.uavs)
    place[:, :1] -= 1.5 * reach * goal[:, 0]
    seen = _fly(rng, stage, place, draw_log(rng, 0.2, 0.9, *shape) / finer, wish)[:, :, int(rng.integers(2)) :]
    return Flight(seen, np.arange(seen.shape[2]), link=np.nan)


def draw_people(rng: np.random.Generator, stage: Stage) -> Flight:
    """Groups of 2 to 6 people: one of each knows the way, in front or aside; the others keep by it, and apart."""
    groups = max(1, round(stage.uavs / float(rng.uniform(2.0, 6.0))))
    leader, window = np.arange(stage.uavs) % groups, np.arange(stage.windows)[:, None]
    ways, delay = draw_ways(rng, stage, stage.steps + 30, groups, 0.1), stage.draw_delays(rng, 15)
    slot = draw_log(rng, 0.5, 3.0) * (stage.draw_normals(rng, stage.uavs) + rng.normal(0.0, 1.5) * stage.axes)
    slot[:, :groups] = 0.0
    weight = np.tile(np.where(leader[:, None] == leader, 1.0, 0.2) - np.eye(stage.uavs), (stage.windows, 1, 1))
    weight[:, :groups] *= rng.uniform(0.0, 0.4)
    copies, keeps, turn = (draw_log(rng, low, 1.0, stage.windows, 1, 1) for low in (0.3, 0.05, 0.2))

    def wish(t: int, position: Floats, velocity: Floats) -> Floats:
        late = np.maximum(t - delay, 0)
        wanted = keeps * (position[window, late, leader] + slot - position[:, t])
        wanted += copies * velocity[window, late, leader]
        wanted[:, :groups] = ways[:, t]
        return wanted + _sum_neighbours(position[:, t], velocity[:, t], weight, np.full((len(weight), 3), 1.5))[0]

    place = 3.0 * place_groups(rng, stage, np.arange(groups))[:, leader] + slot
    return Flight(_fly(rng, stage, place, turn, wish), leader, delay)


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
    places, velocity = [stage.draw_normals(rng, uavs)], draw_log(rng, 0.03, 0.5) * stage.draw_normals(rng, uavs)
    for part in range(4 * stage.steps):  # four parts of each step
        force = spring @ places[-1] - spring.sum(-1, keepdims=True) * places[-1]
        velocity = velocity + (push[:, part // 4] - drag * velocity + force) / 4.0
        places.append(places[-1] + velocity / 4.0)
        velocity = np.where(np.abs(places[-1]) > wall, -np.sign(places[-1]) * np.abs(velocity), velocity)
    link = (spring > 0) & ~np.eye(uavs, dtype=bool)
    return Flight(np.stack(places[::4], axis=1), np.zeros(uavs, np.int64), link=link)
