"""Worlds in which UAVs set off behind one of several leaders, or turn as fast as a leader turns."""

import numpy as np

from detectors.reader.prior.families import draw_log
from detectors.reader.prior.worlds.stage import Flight, Stage, draw_groups, keep_noise, place_groups, travel
from usnet_env.arrays import Floats, Indices


def _draw_trips(rng: np.random.Generator, stage: Stage, steps: int, leaders: int, begin: Floats) -> Floats:
    """Velocities ``(B, S, m, 3)`` of leaders: at rest until ``begin (B, m)``, then on ways with few turns."""
    shape, time = (stage.windows, steps, leaders), np.arange(steps)[:, None]
    heading = rng.uniform(0.0, 2.0 * np.pi, (stage.windows, 1, leaders))
    if rng.random() < 0.4:
        heading = heading[..., :1] + draw_log(rng, 0.05, 0.6) * rng.standard_normal(heading.shape)
    for _ in range(int(rng.integers(4))):
        elapsed = time - rng.uniform(0.0, steps, (stage.windows, 1, leaders))
        turn = rng.uniform(-2.5, 2.5, (stage.windows, 1, leaders))
        heading = heading + turn * np.clip(elapsed / rng.uniform(1.0, 10.0), 0.0, 1.0)
    heading = heading + np.cumsum(rng.choice([0.0, 0.0, 0.01, 0.04]) * rng.standard_normal(shape), axis=1)
    climb = np.broadcast_to(0.3 * stage.axes[2] * rng.standard_normal((stage.windows, 1, leaders)), shape)
    pace = np.exp(rng.choice([0.0, 0.15]) * rng.standard_normal((stage.windows, 1, leaders)))
    stop = steps * rng.uniform(0.6, 1.0) if rng.random() < 0.25 else steps
    walks = pace * np.clip((time - begin[:, None]) / rng.uniform(1.0, 8.0), 0.0, 1.0) * (time <= stop)
    return np.asarray(walks[..., None] * np.stack([np.cos(heading), np.sin(heading), climb], axis=-1))


def _draw_factions(rng: np.random.Generator, uavs: int) -> Indices:
    """The leader ``(n,)`` of each UAV, one to four leaders first; in some draws a part of the UAVs never follows."""
    groups = int(rng.integers(min(4, uavs // 2))) + 1
    leader = np.concatenate([np.arange(groups), np.arange(groups), rng.integers(groups, size=uavs - 2 * groups)])
    is_alone = (rng.random(uavs) < rng.choice([0.0, 0.0, 0.3, 0.6])) & (np.arange(uavs) >= 2 * groups)
    return np.where(is_alone, np.arange(uavs), leader)


def _draw_sources(rng: np.random.Generator, leader: Indices, steps: int, shown: int) -> Indices:
    """The leader of each UAV at each step ``(S, n)``: some UAVs join another leader early in the window, or late."""
    source, index = np.tile(leader, (steps, 1)), np.arange(len(leader))
    groups = int(leader[leader != index].max()) + 1
    if groups > 1 and rng.random() < 0.3:
        is_mover = (rng.random(len(index)) < 0.5) & (leader != index) & (index >= 2 * groups)
        length = int(shown * rng.uniform(0.1, 0.35))
        span = slice(0, steps - shown + length) if rng.random() < 0.5 else slice(steps - length, steps)
        source[span] = np.where(is_mover, (leader + 1) % groups, leader)
    return source


def draw_factions(rng: np.random.Generator, stage: Stage) -> Flight:
    """One to four UAVs set off from a crowd; the others of a faction go to the late places of theirs.

    A window begins before that, or so long after that all go straight: only who is in front tells.
    """
    windows, leader = stage.windows, _draw_factions(rng, stage.uavs)
    warm_up = int(rng.choice([0.0, rng.uniform(0.2, 1.5)]) * min(stage.steps, 200))
    steps, groups = warm_up + stage.steps, int(leader[leader != np.arange(stage.uavs)].max()) + 1
    start = rng.uniform(0.0, 0.4 * (warm_up or stage.steps), (windows, groups if rng.random() < 0.5 else 1))
    start = np.broadcast_to(start, (windows, groups))
    delay = rng.integers(2, max(4, min(int(rng.choice([12, 45])), stage.steps // 4)), (windows, stage.uavs))
    ways, source = _draw_trips(rng, stage, steps, groups, start), _draw_sources(rng, leader, steps, stage.steps)
    shake = keep_noise(stage.draw_normals(rng, steps, stage.uavs), rng.uniform(0.0, 0.9, windows))
    shake *= rng.choice([0.0, 0.02, 0.1, 0.3])
    position = np.empty((windows, steps + 1, stage.uavs, 3))
    position[:, 0] = draw_log(rng, 1.0, 20.0, windows, 1, 1) * stage.draw_normals(rng, stage.uavs)
    top_speed, brake_distance = rng.uniform(1.0, 1.5), draw_log(rng, 0.5, 6.0)
    memory, velocity = rng.choice([0.0, rng.uniform(0.0, 0.8)]), np.zeros((windows, stage.uavs, 3))
    window, follows = np.arange(windows)[:, None], leader != np.arange(stage.uavs)
    for t in range(steps):
        pull = position[window, np.maximum(t - delay, 0), source[t]] - position[:, t]
        pull *= top_speed / np.maximum(np.sqrt((pull * pull).sum(axis=-1, keepdims=True)), brake_distance)
        is_off = (t >= start[:, np.where(follows, source[t], 0)] + delay) & follows
        velocity = memory * velocity + (1.0 - memory) * is_off[..., None] * pull
        velocity[:, :groups] = ways[:, t]
        position[:, t + 1] = position[:, t] + velocity + shake[:, t]
    return Flight(position[:, warm_up:], leader, delay)


def _draw_banks(rng: np.random.Generator, stage: Stage, steps: int) -> Floats:
    """Angles of bank ``(B, S, n)`` that UAVs command by themselves: held for a while, or varied all the time."""
    shape = stage.windows, steps, stage.uavs
    if rng.random() < 0.5:
        return keep_noise(rng.standard_normal(shape), 1.0 - draw_log(rng, 0.02, 0.5, stage.windows))
    rows = np.arange(steps)[:, None]
    since = np.maximum.accumulate(np.where(rng.random(shape) < draw_log(rng, 0.02, 0.2), rows, 0), axis=1)
    return np.take_along_axis(rng.standard_normal(shape) * rng.choice([1.0, 0.0], shape, p=[0.7, 0.3]), since, axis=1)


def _follow_banks(
    rng: np.random.Generator, stage: Stage, own_bank: Floats, leader: Indices, delay: Indices, lag: Floats
) -> Floats:
    """Angles ``(B, S, n)`` of UAVs that tend to their leader's late one, or to their own, with a lag of first order."""
    gain, follows = stage.draw_each(rng, 0.6, 1.4), leader != np.arange(stage.uavs)
    own_gain = draw_log(rng, 0.01, 0.4, stage.windows, 1) * follows
    bank, window = own_bank.copy(), np.arange(stage.windows)[:, None]
    for t in range(1, own_bank.shape[1]):
        leader_bank = gain * bank[window, np.maximum(t - delay, 0), leader] + own_gain * own_bank[:, t]
        bank[:, t] = bank[:, t - 1] + (np.where(follows, leader_bank, own_bank[:, t]) - bank[:, t - 1]) / lag
    return bank


def draw_turn_rate(rng: np.random.Generator, stage: Stage) -> Flight:
    """Wings at constant speeds whose angle of bank follows a leader's, late and with a lag, not its course.

    A level turn with the bank b has the rate c tan(b) / v. In some draws they climb by the leader's climb, too.
    Others command their turns as the leaders do.
    """
    leader, uavs = draw_groups(rng, stage.uavs, 4), stage.uavs
    if rng.random() < 0.25:
        leader = np.append(0, rng.integers(np.arange(1, uavs)))
    is_alone = (rng.random(uavs) < rng.choice([0.0, 0.3])) & (np.arange(uavs) >= 2 * (leader.max() + 1))
    leader = np.where(is_alone & ~np.isin(np.arange(uavs), leader), np.arange(uavs), leader)
    delay, lag = stage.draw_delays(rng, 12), stage.draw_each(rng, 1.0, 8.0)
    steps = stage.steps + 60
    speed, turn_gain = stage.draw_each(rng, 0.6, 1.6), draw_log(rng, 0.01, 0.3, stage.windows, 1, 1)
    bank = _follow_banks(rng, stage, _draw_banks(rng, stage, steps), leader, delay, lag)
    course = np.cumsum(turn_gain * np.tan(np.clip(0.6 * bank, -1.2, 1.2)) / speed[:, None], axis=1)
    course += rng.uniform(0.0, 2.0 * np.pi, (stage.windows, 1, uavs))
    climb = np.zeros_like(course)
    if stage.axes[2]:
        climb = _follow_banks(rng, stage, _draw_banks(rng, stage, steps), leader, delay, lag) * rng.uniform(0.0, 0.4)
        climb = np.clip(climb, -1.2, 1.2) + 0.1 * rng.standard_normal((stage.windows, 1, uavs))
    velocity = np.stack([np.cos(climb) * np.cos(course), np.cos(climb) * np.sin(course), np.sin(climb)], axis=-1)
    velocity = (speed[:, None, :, None] * velocity)[:, -stage.steps :]
    position = travel(place_groups(rng, stage, leader), velocity)
    return Flight(position, leader, delay + lag - 1.0)
