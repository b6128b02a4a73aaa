"""What all worlds share: their size, the ways of UAVs that fly on their own, places, delays, and groups.

A world orders its UAVs as it likes, the same in all windows: ``finish`` mixes them. Lengths are relative: the speed of
a UAV is about 1.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.signal import lfilter

from detectors.reader.prior.draws import draw_log
from detectors.reader.prior.motion import Motion, find_heads
from usnet_env.arrays import Floats, Indices


class Stage(NamedTuple):
    """B windows of T steps with n UAVs; ``axes`` ``(3,)`` is 1 for the axes in which they move, else 0."""

    windows: int
    steps: int
    uavs: int
    axes: Floats

    def draw_normals(self, rng: np.random.Generator, *shape: int) -> Floats:
        """Standard normal vectors ``(B, *shape, 3)`` in the axes of the stage."""
        return np.asarray(rng.standard_normal((self.windows, *shape, 3)) * self.axes)

    def draw_each(self, rng: np.random.Generator, low: float, high: float, uavs: int | None = None) -> Floats:
        """Log-uniform numbers ``(B, n)`` of all UAVs, in half of the draws one for a window."""
        uavs = self.uavs if uavs is None else uavs
        width = uavs if rng.random() < 0.5 else 1
        return np.broadcast_to(draw_log(rng, low, high, (self.windows, width)), (self.windows, uavs))

    def draw_delays(self, rng: np.random.Generator, uavs: int | None = None) -> Indices:
        """Delays ``(B, n)`` in steps: up to 12 in half of the draws, else up to a third of the window."""
        most = max(2, min(12, self.steps // 3) if rng.random() < 0.5 else self.steps // 3)
        return np.maximum(np.round(self.draw_each(rng, 0.6, most, uavs)), 1).astype(np.int64)


class Flight(NamedTuple):
    """The positions ``(B, T + 1, n, 3)``, the leader ``(n,)`` of each UAV, and the delays, ``(B, n)`` or NaN."""

    position: Floats
    leader: Indices
    delay: Floats | Indices | float = np.nan

    def drop(self, first: int) -> Flight:
        """The flight without its first UAVs, which nobody saw; the others have no leader."""
        position = self.position[:, :, first:]
        return Flight(position, np.arange(position.shape[2]))


def filter_noise(noise: Floats, keep: Floats) -> Floats:
    """Autoregressive noise of order 1 and the variance of ``noise (B, S, ...)``, with ``keep (B,)``."""
    rest = np.sqrt(1.0 - keep**2)
    noise[:, 0] /= rest.reshape(-1, *[1] * (noise.ndim - 2))
    return np.stack([lfilter([r], [1.0, -k], row, axis=0) for row, k, r in zip(noise, keep, rest, strict=True)])


def draw_ways(rng: np.random.Generator, stage: Stage, steps: int, uavs: int, calm: float = 1.0) -> Floats:
    """Velocities ``(B, steps, uavs, 3)`` of UAVs that fly on their own: from jittery to nearly straight.

    ``calm`` is the largest part of a velocity that is forgotten in a step. The speed is constant, varies slowly, or
    varies with the turns.
    """
    keep = 1.0 - draw_log(rng, 0.01, calm, stage.windows)
    way = filter_noise(stage.draw_normals(rng, steps, uavs), keep)
    if rng.random() < 0.5:  # smooth turns
        way = filter_noise(way, keep)
        way /= np.sqrt((way**2).mean((1, 2, 3), keepdims=True)) + 1e-9
    way = way + rng.uniform(0.0, 2.0, (stage.windows, 1, 1, 1)) * stage.draw_normals(rng, 1, uavs)
    if rng.random() < 0.6:
        speed = filter_noise(rng.standard_normal((stage.windows, steps, uavs, 1)), np.full(stage.windows, 0.95))
        way *= np.exp(rng.uniform(0.0, 0.5) * speed) / (np.linalg.norm(way, axis=-1, keepdims=True) + 1e-9)
    return way


def draw_stops(rng: np.random.Generator, stage: Stage, steps: int, uavs: int) -> Floats:
    """Factors ``(B, steps, uavs, 1)`` of speed: 0 until a UAV sets off and while it stops, else 1, with short ramps."""
    time = np.arange(steps)[None, :, None]
    start = rng.uniform(0.1, 0.5, (stage.windows, 1, uavs)) * steps
    go = np.clip((time - start) / rng.uniform(1.0, 10.0), 0.0, 1.0)
    for _ in range(int(rng.integers(0, 3))):
        begin, last = start + rng.uniform(0.1, 0.6) * steps, rng.uniform(0.03, 0.2) * steps
        go = go * np.clip(np.abs(time - begin - last / 2) - last / 2, 0.0, 3.0) / 3.0
    return np.asarray(go[..., None])


def draw_groups(rng: np.random.Generator, uavs: int, most: int) -> Indices:
    """The leader ``(n,)`` of each UAV in 1 to ``most`` groups, whose leaders come first; each group has a follower."""
    groups = int(rng.integers(1, min(most, uavs // 2) + 1))
    followers = np.concatenate([np.arange(groups), rng.integers(groups, size=uavs - 2 * groups)])
    return np.concatenate([np.arange(groups), followers])


def place_groups(rng: np.random.Generator, stage: Stage, leader: Indices) -> Floats:
    """Start places ``(B, n, 3)``: groups apart, or in each other; UAVs of a group spread about its middle."""
    near = draw_log(rng, 1.0, 60.0, (stage.windows, 1, 1))
    middle = near * draw_log(rng, 0.1, 10.0, (stage.windows, 1, 1)) * stage.draw_normals(rng, int(leader.max()) + 1)
    return np.asarray(middle[:, leader] + near * stage.draw_normals(rng, len(leader)))


def travel(place: Floats, velocity: Floats) -> Floats:
    """The positions ``(B, S + 1, n, 3)`` from a start ``(B, n, 3)`` on."""
    return np.concatenate([place[:, None], place[:, None] + np.cumsum(velocity, axis=1)], axis=1)


def finish(rng: np.random.Generator, stage: Stage, flight: Flight, bystanders: bool) -> Motion:
    """Add lone UAVs among the others to a third of the flights, mix all, and find the heads."""
    position, leader = flight.position, flight.leader
    windows, _, uavs, _ = position.shape
    delay = np.broadcast_to(np.asarray(flight.delay, np.float64), (windows, uavs))
    if bystanders and rng.random() < 1 / 3:
        lone = int(rng.integers(1, max(2, uavs // 3) + 1))
        speed = np.linalg.norm(np.diff(position, axis=1), axis=-1).mean((1, 2))[:, None, None, None]
        middle, spread = position[:, 0].mean(1, keepdims=True), position[:, 0].std((1, 2))[:, None, None]
        place = middle + (spread + speed[:, 0]) * stage.draw_normals(rng, lone)
        ways = travel(place, speed * draw_ways(rng, stage, stage.steps, lone))
        position = np.concatenate([position, ways], axis=2)
        leader = np.append(leader, uavs + np.arange(lone))
        delay = np.concatenate([delay, np.full((windows, lone), np.nan)], axis=1)
    order = rng.permuted(np.tile(np.arange(len(leader)), (windows, 1)), axis=1)  # who stands at a place
    rank = np.argsort(order, axis=1)
    position = np.take_along_axis(position, order[:, None, :, None], axis=2)
    return find_heads(
        position,
        np.take_along_axis(rank, leader[order], axis=1),
        np.take_along_axis(delay, order, axis=1),
    )
