"""Worlds in which UAVs copy the velocities of a leader some steps late, go to its places, or share a way."""

import numpy as np

from detectors.reader.prior.families import draw_log
from detectors.reader.prior.worlds.stage import Flight, Stage, draw_groups, draw_ways, keep_noise, place_groups, travel
from usnet_env.arrays import Floats, Indices


def _copy(rng: np.random.Generator, stage: Stage, source: Indices, delay: Indices, least: float) -> Floats:
    """Positions ``(B, T + 1, n, 3)`` of UAVs that copy ``source`` ``(T, n)``; who is its own flies its way.

    v_i(t) = g v_L(t - d_i) + w u_i(t), u the last velocity of the UAV, or a way of its own, g ``least`` to 1, w 1 - g
    or up to 0.6.
    """
    source = np.concatenate([np.tile(source[:1], (int(delay.max()) + 5, 1)), source])
    velocity = draw_ways(rng, stage, len(source), stage.uavs)
    has_own_way, gain = rng.random() < 0.4, stage.draw_each(rng, least, 1.0)[..., None]
    shake = draw_log(rng, 0.005, 0.3, stage.windows, 1, 1)
    own_gain = 1.0 - gain if rng.random() < 0.6 else np.full_like(gain, rng.uniform(0.0, 0.6))
    window, index = np.arange(stage.windows)[:, None], np.arange(stage.uavs)
    for t in range(1, len(source)):
        followers = np.flatnonzero(source[t] != index)
        copied = velocity[window, np.maximum(t - delay[:, followers], 0), source[t, followers]]
        base = velocity[:, t if has_own_way else t - 1, followers] + shake * stage.draw_normals(rng, len(followers))
        velocity[:, t, followers] = gain[:, followers] * copied + own_gain[:, followers] * base
    return travel(place_groups(rng, stage, source[-1][source[-1]]), velocity[:, -stage.steps :])


def draw_star(rng: np.random.Generator, stage: Stage, groups: int = 4) -> Flight:
    """Up to so many groups whose UAVs all copy one leader."""
    leader, delay = draw_groups(rng, stage.uavs, groups), stage.draw_delays(rng)
    return Flight(_copy(rng, stage, np.tile(leader, (stage.steps, 1)), delay, 0.1), leader, delay)


def draw_graded(rng: np.random.Generator, stage: Stage) -> Flight:
    """A graded order: each UAV copies the one before it, or any before it, or one of the two before it."""
    follower = np.arange(1, stage.uavs)
    low = [follower - 1, np.zeros_like(follower), np.maximum(follower - 2, 0)][int(rng.integers(3))]
    leader = np.append(0, rng.integers(low, follower))
    delay = stage.draw_delays(rng, stage.steps // (3 * min(stage.uavs, 8)))
    return Flight(_copy(rng, stage, np.tile(leader, (stage.steps, 1)), delay, 0.4), leader, delay)


def draw_changes(rng: np.random.Generator, stage: Stage) -> Flight:
    """Others take the lead in turn; the leader is who leads longest, for at least half of the window."""
    leaders = int(rng.integers(2, min(4, stage.uavs - 1) + 1))
    longest = rng.uniform(0.5, 0.8)
    share = np.append(longest, (1.0 - longest) * rng.dirichlet(np.ones(leaders - 1)))
    order = rng.permutation(leaders)
    ends, delay = np.cumsum(share[order])[:-1] * stage.steps, stage.draw_delays(rng, stage.steps // 10)
    source = order[np.searchsorted(ends, np.arange(stage.steps), side="right")][:, None].repeat(stage.uavs, axis=1)
    return Flight(_copy(rng, stage, source, delay, 0.3), np.zeros(stage.uavs, np.int64), delay)


def _keep_gaps(rng: np.random.Generator, stage: Stage, leader: Indices, delay: Indices) -> Floats:
    """Positions ``(B, T + 1, n, 3)`` on a road along x of cars that keep a gap to their leader.

    A gap is as long as what is driven in the delay: dv_i = k (x_L - x_i - d_i v_i) / d_i + c (v_L - v_i), the optimal
    velocity with relative velocities (Bando et al. 1995; Jiang et al. 2001). Standing gaps are left out.
    """
    windows, one, is_first = stage.windows, (stage.windows, 1), leader == np.arange(stage.uavs)
    rate, largest_change = draw_log(rng, 0.5 / stage.steps, 0.2, *one), draw_log(rng, 0.01, 0.3, *one)
    shake = draw_log(rng, 0.001, 0.05, *one) * (is_first + 0.3)
    pulled, copied = stage.draw_each(rng, 0.03, 0.5), stage.draw_each(rng, 0.03, 0.5)
    target = rng.uniform(0.0, 2.0, one) * np.ones(stage.uavs)
    speed, position = target.copy(), np.zeros((windows, stage.uavs))
    for i in np.flatnonzero(~is_first):
        position[:, i] = position[:, leader[i]] - delay[:, i] * speed[:, i]
    positions = []
    for t in range(2 * stage.steps + 1):
        if t >= stage.steps:
            positions.append(position)
        drawn = np.maximum(rng.uniform(-0.5, 2.0, target.shape), 0.0)
        target = np.where(rng.random(target.shape) < rate, drawn, target)
        follow = pulled * ((position[:, leader] - position) / delay - speed) + copied * (speed[:, leader] - speed)
        change = np.where(is_first, np.clip(target - speed, -largest_change, largest_change), follow)
        change += shake * rng.standard_normal(speed.shape) * (speed > 0)
        speed = np.maximum(speed + change, 0.0)
        position = position + speed
    return np.stack(positions, axis=1)[..., None] * np.array([1.0, 0.0, 0.0])


def draw_cars(rng: np.random.Generator, stage: Stage) -> Flight:
    """Traffic in lanes: each car takes on the speed of the one before it, or keeps a gap; the first of a lane leads."""
    lanes, index = int(rng.integers(min(4, stage.uavs // 2))) + 1, np.arange(stage.uavs)
    leader, delay = np.where(index < lanes, index, index - lanes), stage.draw_delays(rng, 12)
    road, spacing = stage._replace(axes=np.array([1.0, 0.0, 0.0])), draw_log(rng, 5.0, 50.0)
    if rng.random() < 0.5:
        position, spacing = _keep_gaps(rng, stage, leader, delay), draw_log(rng, 0.2, 20.0)
        position[..., 0] -= rng.uniform(0.0, 100.0, lanes)[index % lanes]
    else:
        position = _copy(rng, road, np.tile(leader, (stage.steps, 1)), delay, 0.3)
        position += rng.uniform(1.5, 4.0) * np.arange(stage.steps + 1)[:, None, None] * road.axes - position[:, :1]
    position[..., 0] -= spacing * (index // lanes + rng.uniform(0.0, 0.5, stage.uavs))
    position[..., 1] += index % lanes * rng.uniform(1.0, 4.0) + rng.normal(0.0, 0.02, position.shape[:3])
    return Flight(position, leader, delay)


def draw_fission(rng: np.random.Generator, stage: Stage) -> Flight:
    """Some followers leave a leader for another one, so that two groups become one, or one becomes two."""
    leader = np.append([0, 1, 0, 1], rng.integers(2, size=stage.uavs - 4))
    movers = np.flatnonzero(rng.random(stage.uavs - 4) < rng.uniform(0.2, 1.0)) + 4
    source, delay = np.tile(leader, (stage.steps, 1)), stage.draw_delays(rng, stage.steps // 10)
    source[: int(rng.uniform(0.15, 0.45) * stage.steps), movers] = 1 - leader[movers]
    return Flight(_copy(rng, stage, source[:: int(rng.choice([-1, 1]))], delay, 0.3), leader, delay)


def _go_after(
    rng: np.random.Generator, stage: Stage, track: Floats, leader: Indices, delay: Indices, wide: float = 10.0,
    swayed: float = 1.0,
) -> Floats:  # fmt: skip
    """Positions ``(B, T + 1, n, 3)`` of m leaders with the ``track (B, S + T + 1, m, 3)`` and of those who go there.

    ``swayed`` is 0 if they don't leave their ways, else 1.
    """
    leaders, last = leader[track.shape[2] :], track.shape[1] - 1
    window, shape = np.arange(stage.windows)[:, None, None], (stage.windows, 1, 1, 1)
    past = np.maximum(np.arange(last - stage.steps, last + 1)[:, None] - delay[:, None, track.shape[2] :], 0)
    step = np.linalg.norm(np.diff(track, axis=1), axis=-1).mean((1, 2)).reshape(shape) + 1e-9
    course = track[window, np.minimum(past + 4, last), leaders] - track[window, np.maximum(past - 4, 0), leaders]
    side = course[..., [1, 0, 2]] * [-1.0, 1.0, 0.0] / (np.linalg.norm(course, axis=-1, keepdims=True) + step)
    offset = draw_log(rng, 0.002 * wide, wide, *shape) * rng.standard_normal((stage.windows, 1, len(leaders), 1))
    sway = keep_noise(stage.draw_normals(rng, *past.shape[1:]), rng.uniform(0.3, 0.98, stage.windows))
    sway *= swayed * draw_log(rng, 0.02, 1.0, *shape)
    position = track[window, past, leaders] + step * (offset * side + sway)
    return np.concatenate([track[:, -stage.steps - 1 :], position], axis=2)


def _track(
    rng: np.random.Generator, stage: Stage, leader: Indices, delay: Indices, rest: bool, straight: bool = False
) -> Floats:
    """Draw positions ``(B, S + T + 1, m, 3)`` of m leaders, S the longest delay; some ``rest`` until they set off."""
    warm_up, leaders, walks = int(delay.max()), int(leader.max()) + 1, np.array(1.0)
    velocity = draw_ways(rng, stage, warm_up + stage.steps, leaders, 0.1 if rest else 0.5)
    if straight:
        velocity[:] = velocity[:, :1] / (np.linalg.norm(velocity[:, :1], axis=-1, keepdims=True) + 1e-9)
    if rest:
        time = (np.arange(-warm_up, stage.steps)[:, None, None] + 0.5) / stage.steps
        start = rng.uniform(0.05, 0.4, (stage.windows, 1, leaders, 1))
        walks = np.clip((time - start) * stage.steps / rng.uniform(1.0, 10.0), 0.0, 1.0)
        for _ in range(int(rng.integers(3))):
            walks = walks * (np.abs(time - start - rng.uniform(0.1, 0.6)) > rng.uniform(0.02, 0.1))
    return travel(place_groups(rng, stage, np.arange(leaders)), velocity * walks)


def draw_path(rng: np.random.Generator, stage: Stage, groups: int = 4) -> Flight:
    """Followers go to the places of their leader, side by side."""
    leader, delay = draw_groups(rng, stage.uavs, groups), stage.draw_delays(rng)
    track = _track(rng, stage, leader, delay, bool(rng.random() < 0.2))
    return Flight(_go_after(rng, stage, track, leader, delay), leader, delay)


def draw_set_off(rng: np.random.Generator, stage: Stage, groups: int = 3) -> Flight:
    """UAVs at rest set off one after another, on ways that are parallel to the leader's, and stop so."""
    leader = draw_groups(rng, stage.uavs, groups)
    delay = 1 + np.sort(rng.integers(stage.steps // 2, size=(stage.windows, stage.uavs)), axis=1)
    straight = bool(rng.random() < 0.4)
    track = _track(rng, stage, leader, delay, True, straight)
    fan = 1.0 + draw_log(rng, 0.01, 0.2) * rng.standard_normal((stage.windows, 1, stage.uavs, 1))
    path = _go_after(rng, stage, track, leader, delay, 1e-3, 0.0 if straight else 1.0) - track[:, :1, leader]
    shake = stage.draw_normals(rng, stage.steps, stage.uavs) * (np.diff(path, axis=1) != 0).any(-1, keepdims=True)
    shake = np.cumsum(np.pad(shake, ((0, 0), (1, 0), (0, 0), (0, 0))), axis=1) * draw_log(rng, 0.005, 0.2)
    return Flight(place_groups(rng, stage, leader)[:, None] + fan * path + shake, leader, delay)


def draw_file(rng: np.random.Generator, stage: Stage, closed: bool = False) -> Flight:
    """A file: each UAV goes to the places of the one before it, with ``closed`` on a part of a circle."""
    gap = 1 + rng.integers(stage.steps // (2 * stage.uavs) + 1, size=(stage.windows, stage.uavs))
    total, lead = np.cumsum(gap, axis=1) - gap[:, :1], np.zeros(stage.uavs, np.int64)
    track = _track(rng, stage, lead, total, not closed and bool(rng.random() < 0.3))
    if closed:
        angle = np.cumsum(np.linalg.norm(np.diff(track[:, :, 0], axis=1, prepend=track[:, :1, 0]), axis=-1), axis=1)
        angle *= rng.uniform(0.5, 0.95) * 2.0 * np.pi / (angle[:, -1:] + 1e-9)
        track = stage.steps / 6.0 * np.stack([np.cos(angle), np.sin(angle), 0.0 * angle], axis=-1)[:, :, None]
    return Flight(_go_after(rng, stage, track, lead, total), np.maximum(np.arange(stage.uavs) - 1, 0), gap)


def draw_ring_road(rng: np.random.Generator, stage: Stage) -> Flight:
    """Cars on a closed ring, each behind another (optimal velocities, Bando et al. 1995): no UAV leads."""
    shape, length = (stage.windows, stage.uavs), 2.0 * stage.uavs
    arc, speed, arcs = 2.0 * np.arange(stage.uavs) + rng.normal(0.0, 0.2, shape), np.full(shape, 0.5), []
    step, sensitivity = draw_log(rng, 0.2, 1.0), draw_log(rng, 0.2, 1.5, stage.windows, 1)
    for _ in range(50 + stage.steps + 1):
        goal = np.tanh(np.mod(np.roll(arc, -1, axis=1) - arc, length) - 2.0) / 2.0 + 0.5
        speed = np.maximum(speed + step * sensitivity * (goal - speed) + rng.normal(0.0, 0.02, shape), 0.0)
        arc = arc + step * speed
        arcs.append(arc)
    angle = np.stack(arcs[50:], axis=1) * 2.0 * np.pi / length
    radius = length / (2.0 * np.pi) + rng.normal(0.0, 0.05, (stage.windows, 1, stage.uavs))
    position = np.stack([radius * np.cos(angle), radius * np.sin(angle), 0.0 * angle], -1)
    return Flight(position, np.arange(stage.uavs), link=np.nan)


def draw_route(rng: np.random.Generator, stage: Stage) -> Flight:
    """UAVs on one winding way, from their own places on it, at their own paces, some backwards: no UAV leads.

    In half of the draws all begin near each other and keep similar paces, as if they followed.
    """
    shape = stage.windows, stage.steps + 1, stage.uavs
    road = travel(stage.draw_normals(rng, 1), draw_ways(rng, stage, 3 * stage.steps, 1, 0.1))[:, :, 0]
    variation = keep_noise(rng.standard_normal(shape), rng.uniform(0.5, 0.98, stage.windows))
    similar, pace = rng.random() < 0.5, stage.draw_each(rng, 0.3, 1.0)
    if similar:
        pace = pace[:, :1] * rng.uniform(0.85, 1.15, pace.shape)
    gone = np.cumsum(pace[:, None] * np.exp(rng.uniform(0.0, 0.2 if similar else 0.4) * variation), axis=1)
    begin = rng.uniform(0.0, rng.uniform(0.05, 0.5) if similar else 1.2, (stage.windows, 1, stage.uavs)) * stage.steps
    position = begin + np.minimum(gone, 1.7 * stage.steps)
    is_backward = rng.random(stage.uavs) < (0.0 if similar else rng.choice([0.0, 0.5]))
    position = np.where(is_backward, 3 * stage.steps - position, position)
    index, fraction = position.astype(np.int64), position[..., None] % 1.0
    window = np.arange(stage.windows)[:, None, None]
    point = (1.0 - fraction) * road[window, index] + fraction * road[window, index + 1]
    sway = keep_noise(stage.draw_normals(rng, *shape[1:]), np.full(stage.windows, 0.9)) * draw_log(rng, 0.02, 1.0)
    offset = stage.draw_normals(rng, 1, stage.uavs) * draw_log(rng, 0.02, 1.0)
    return Flight(point + offset + rng.choice([0.0, 1.0, 1.0]) * sway, np.arange(stage.uavs))


def draw_initiators(rng: np.random.Generator, stage: Stage) -> Flight:
    """UAVs rest or mill about; one sets off, others join late and go to its places; another has a shorter trip."""
    swap = float(rng.choice([0.0, 0.0, 0.35, 0.65]))  # when the other trip ends, or this one
    index, window = np.arange(stage.uavs), np.arange(stage.windows)[:, None]
    delay = rng.integers(5, max(7, min(41, stage.steps // 3)), (stage.windows, stage.uavs))
    step = rng.choice([0.02, 0.1, 0.3]) * stage.draw_normals(rng, stage.steps, stage.uavs)
    step = keep_noise(step, rng.uniform(0.0, 0.9, stage.windows))
    position = np.empty((stage.windows, stage.steps + 1, stage.uavs, 3))
    position[:, 0] = draw_log(rng, 2.0, 15.0) * stage.draw_normals(rng, stage.uavs)
    ways, brake_distance = draw_ways(rng, stage, stage.steps, 1, 0.1), draw_log(rng, 1.0, 6.0)
    for t in range(stage.steps):
        active = int((t < swap * stage.steps) == (swap < 0.5)) if swap else 0
        elapsed = t - ((swap if t >= swap * stage.steps else 0.0) + 0.1) * stage.steps
        target = position[window, np.maximum(t - delay, 0), active] - position[:, t]
        pull = 1.3 * target / np.maximum(np.linalg.norm(target, axis=-1, keepdims=True), brake_distance)
        step[:, t] += np.where(((elapsed >= delay) & (index != active))[..., None], pull, 0.0)
        step[:, t, active] += ways[:, t, 0] * (elapsed >= 0)
        position[:, t + 1] = position[:, t] + step[:, t]
    return Flight(position, np.zeros(stage.uavs, np.int64), delay)
