"""Worlds in which UAVs go to the places of others, or along common ways."""

from __future__ import annotations

import numpy as np

from detectors.reader.prior.draws import draw_log
from detectors.reader.prior.worlds.stage import (
    Flight,
    Stage,
    draw_groups,
    draw_stops,
    draw_ways,
    filter_noise,
    place_groups,
    travel,
)
from usnet_env.arrays import Floats, Indices


def _go_after(rng: np.random.Generator, stage: Stage, track: Floats, leader: Indices, delay: Indices) -> Floats:
    """The positions ``(B, T + 1, n, 3)`` of UAVs that go to places of their leader ``delay`` steps later.

    ``track`` ``(B, before + T + 1, m, 3)`` are the places of the leaders, the first m UAVs. Followers keep a side of
    the way, lag behind, and sway.
    """
    leaders, followers = track.shape[2], np.arange(track.shape[2], stage.uavs)
    window, time = np.arange(stage.windows)[:, None, None], np.arange(track.shape[1] - stage.steps - 1, track.shape[1])
    late = time[:, None] - delay[:, None, followers]
    place = track[window, np.maximum(late, 0), leader[followers]]
    way = np.linalg.norm(np.diff(track, axis=1), axis=-1).mean((1, 2)).reshape(-1, 1, 1, 1)
    ahead = track[window, np.minimum(np.maximum(late, 0) + 4, track.shape[1] - 1), leader[followers]]
    behind = track[window, np.maximum(late - 4, 0), leader[followers]]
    side = np.stack([behind[..., 1] - ahead[..., 1], ahead[..., 0] - behind[..., 0], 0.0 * late], axis=-1)
    side /= np.linalg.norm(side, axis=-1, keepdims=True) + way
    size = (
        way
        * draw_log(rng, 0.02, 10.0, (stage.windows, 1, 1, 1))
        * rng.standard_normal((stage.windows, 1, len(followers), 1))
    )
    sway = filter_noise(stage.draw_normals(rng, *late.shape[1:]), rng.uniform(0.3, 0.98, stage.windows))
    place = place + size * side + way * draw_log(rng, 0.02, 1.0, (stage.windows, 1, 1, 1)) * sway
    return np.concatenate([track[:, -stage.steps - 1 :, :leaders], place], axis=2)


def _track_leaders(rng: np.random.Generator, stage: Stage, leader: Indices, delay: Indices, stops: bool) -> Floats:
    """The places ``(B, before + T + 1, m, 3)`` of m leaders, ``before`` the longest delay."""
    leaders, steps = int(leader.max()) + 1, stage.steps + int(delay.max())
    way = draw_ways(rng, stage, steps, leaders, 0.1 if stops else 0.5)
    if stops:
        way = way * draw_stops(rng, stage, steps, leaders)
    return travel(place_groups(rng, stage, np.arange(leaders)), way)


def draw_path(rng: np.random.Generator, stage: Stage, groups: int = 4) -> Flight:
    """Followers go to the places of their leader, side by side."""
    leader, delay = draw_groups(rng, stage.uavs, groups), stage.draw_delays(rng)
    track = _track_leaders(rng, stage, leader, delay, bool(rng.random() < 0.2))
    return Flight(_go_after(rng, stage, track, leader, delay), leader, delay)


def draw_set_off(rng: np.random.Generator, stage: Stage, groups: int = 3) -> Flight:
    """UAVs at rest set off one after another, on ways that are parallel to the leader's, and stop so."""
    leader = draw_groups(rng, stage.uavs, groups)
    delay = np.maximum(np.sort(rng.integers(1, max(3, stage.steps // 3), (stage.windows, stage.uavs)), axis=1), 1)
    track = _track_leaders(rng, stage, leader, delay, True)
    start = place_groups(rng, stage, leader)
    fan = 1.0 + draw_log(rng, 0.01, 0.2) * rng.standard_normal((stage.windows, 1, stage.uavs, 1))
    flown = _go_after(rng, stage, track, leader, delay)
    first = track[:, :1, leader]
    return Flight(start[:, None] + fan * (flown - first), leader, delay)


def draw_file(rng: np.random.Generator, stage: Stage) -> Flight:
    """A file: each UAV goes to the places of the one before it."""
    gap = 1 + rng.integers(0, max(1, stage.steps // (2 * stage.uavs)) + 1, (stage.windows, stage.uavs))
    total = np.cumsum(gap, axis=1) - gap[:, :1]
    lead = np.zeros(stage.uavs, np.int64)
    track = _track_leaders(rng, stage, lead, total, bool(rng.random() < 0.3))
    return Flight(_go_after(rng, stage, track, lead, total), np.maximum(np.arange(stage.uavs) - 1, 0), gap)


def draw_convoy(rng: np.random.Generator, stage: Stage) -> Flight:
    """An open file on a circle, which the first leads: it begins at one end of the arc, and its pace varies."""
    gap = 1 + rng.integers(0, 8, (stage.windows, stage.uavs))
    total = np.cumsum(gap, axis=1) - gap[:, :1]
    steps = stage.steps + int(total.max())
    pace = filter_noise(rng.standard_normal((stage.windows, steps)), rng.uniform(0.5, 0.98, stage.windows))
    angle = np.cumsum(np.exp(rng.uniform(0.1, 0.6) * pace), axis=1)
    angle *= (rng.uniform(0.5, 0.95, stage.windows) * 2 * np.pi / angle[:, -1])[:, None] * rng.choice([-1.0, 1.0])
    round_ = np.stack([np.cos(angle), np.sin(angle), 0.0 * angle], axis=-1)[:, :, None] * steps / (2 * np.pi)
    track = np.concatenate([round_[:, :1], round_], axis=1)
    lead = np.zeros(stage.uavs, np.int64)
    return Flight(_go_after(rng, stage, track, lead, total), np.maximum(np.arange(stage.uavs) - 1, 0), gap)


def draw_ring_road(rng: np.random.Generator, stage: Stage) -> Flight:
    """Cars on a closed ring, each behind another (optimal velocities, Bando et al. 1995): nobody leads."""
    shape = stage.windows, stage.uavs
    gap, eager = 2.0, draw_log(rng, 0.2, 1.5, (stage.windows, 1))
    length = gap * stage.uavs
    along = gap * np.arange(stage.uavs) + rng.normal(0.0, 0.2, shape)
    speed, places = np.full(shape, 0.5), []
    step = float(draw_log(rng, 0.2, 1.0))
    for t in range(-50, stage.steps + 1):
        ahead = np.mod(np.roll(along, -1, axis=1) - along, length)
        wanted = (np.tanh(ahead - gap) + np.tanh(gap)) / 2.0
        speed = np.maximum(speed + step * eager * (wanted - speed) + rng.normal(0.0, 0.02, shape), 0.0)
        along = along + step * speed
        if t >= 0:
            places.append(along)
    angle, radius = np.stack(places, axis=1) * 2 * np.pi / length, length / (2 * np.pi)
    lane = radius + rng.normal(0.0, 0.05, (stage.windows, 1, stage.uavs))
    position = np.stack([lane * np.cos(angle), lane * np.sin(angle), 0.0 * angle], axis=-1)
    return Flight(position, np.arange(stage.uavs))


def draw_route(rng: np.random.Generator, stage: Stage) -> Flight:
    """UAVs on one winding way, each from its own place on it and at its own pace, some the other way: nobody leads."""
    steps = 3 * stage.steps
    road = travel(stage.draw_normals(rng, 1), draw_ways(rng, stage, steps, 1, 0.1))[:, :, 0]
    pace = draw_log(rng, 0.3, 1.0, (stage.windows, 1, stage.uavs)) if rng.random() < 0.7 else np.full((1, 1, 1), 0.8)
    vary = filter_noise(
        rng.standard_normal((stage.windows, stage.steps + 1, stage.uavs)), rng.uniform(0.5, 0.98, stage.windows)
    )
    gone = np.cumsum(pace * np.exp(rng.uniform(0.0, 0.4) * vary), axis=1)
    along = rng.uniform(0.0, 1.2 * stage.steps, (stage.windows, 1, stage.uavs)) + np.minimum(gone, 1.7 * stage.steps)
    back = rng.random(stage.uavs) < float(rng.choice([0.0, 0.5]))
    along = np.where(back, steps - along, along)
    before = along.astype(np.int64)
    part, window = (along - before)[..., None], np.arange(stage.windows)[:, None, None]
    place = (1.0 - part) * road[window, before] + part * road[window, before + 1]
    sway = filter_noise(stage.draw_normals(rng, stage.steps + 1, stage.uavs), np.full(stage.windows, 0.9))
    return Flight(place + draw_log(rng, 0.02, 1.0) * sway, np.arange(stage.uavs))


def draw_cars(rng: np.random.Generator, stage: Stage) -> Flight:
    """Traffic in lanes: each car takes on the speed of the one before it after a delay; the first of a lane leads."""
    lanes = int(rng.integers(1, min(4, stage.uavs // 2) + 1))
    own = np.arange(stage.uavs)
    leader, delay = np.where(own < lanes, own, own - lanes), np.minimum(stage.draw_delays(rng), 12)
    before = int(delay.max()) * (stage.uavs // lanes) + 1
    keep = rng.uniform(0.7, 0.99, stage.windows)
    wish = filter_noise(rng.standard_normal((stage.windows, before + stage.steps, stage.uavs)), keep)
    pace = np.maximum(1.0 + rng.uniform(0.1, 0.6) * wish, 0.0)
    gain, window = stage.draw_each(rng, 0.3, 1.0), np.arange(stage.windows)[:, None]
    for t in range(1, before + stage.steps):
        for row in range(lanes, stage.uavs, lanes):
            led = own[row : row + lanes]
            copied = pace[window, np.maximum(t - delay[:, led], 0), leader[led]]
            pace[:, t, led] = gain[:, led] * copied + (1.0 - gain[:, led]) * pace[:, t - 1, led]
    pace[:, :, lanes:] += draw_log(rng, 0.003, 0.1) * rng.standard_normal(pace[:, :, lanes:].shape)
    gap = draw_log(rng, 2.0, 20.0, (stage.windows, 1))
    along = (
        np.cumsum(pace[:, before - 1 :], axis=1) - (gap * (own // lanes + rng.uniform(0.0, 0.5, stage.uavs)))[:, None]
    )
    across = np.broadcast_to(own % lanes * rng.uniform(1.0, 4.0), along.shape) + rng.normal(0.0, 0.02, along.shape)
    return Flight(np.stack([along, across, 0.0 * along], axis=-1), leader, delay)


def draw_initiators(rng: np.random.Generator, stage: Stage) -> Flight:
    """UAVs that rest or mill about; one sets off, and the others join 5 to 40 steps later and go to its places.

    In some windows another one begins a second, shorter trip; the leader is who led longer.
    """
    trips = [(0, 0.0, 1.0)] if stage.uavs < 3 or rng.random() < 0.6 else [(0, 0.0, 0.65), (1, 0.65, 1.0)]
    order = trips if rng.random() < 0.5 else [(who, 1.0 - end, 1.0 - begin) for who, begin, end in reversed(trips)]
    delay = rng.integers(5, max(7, min(41, stage.steps // 3)), (stage.windows, stage.uavs))
    place = draw_log(rng, 2.0, 15.0) * stage.draw_normals(rng, stage.uavs)
    keep = rng.uniform(0.0, 0.9, stage.windows)
    velocity = rng.choice([0.02, 0.1, 0.3]) * filter_noise(stage.draw_normals(rng, stage.steps, stage.uavs), keep)
    position, window = np.empty((stage.windows, stage.steps + 1, stage.uavs, 3)), np.arange(stage.windows)[:, None]
    position[:, 0] = place
    ways = draw_ways(rng, stage, stage.steps, 1, 0.1)
    far = draw_log(rng, 1.0, 6.0)
    for t in range(stage.steps):
        who, begin, end = next(trip for trip in order if t < trip[2] * stage.steps)
        set_off = int((begin + 0.15 * (end - begin)) * stage.steps)
        step = velocity[:, t].copy()
        if t >= set_off:
            step[:, who] += ways[:, t, 0]
            behind = np.maximum(t - delay, 0)
            target = position[window, behind, who] - position[:, t]
            pull = 1.3 * target / np.maximum(np.linalg.norm(target, axis=-1, keepdims=True), far)
            joins = (t >= set_off + delay) & (np.arange(stage.uavs) != who)
            step += np.where(joins[..., None], pull, 0.0)
        position[:, t + 1] = position[:, t] + step
    return Flight(position, np.zeros(stage.uavs, np.int64), delay)
