"""What all worlds share. A world orders its UAVs as it likes, and ``finish`` mixes them. Speeds are about 1."""

from typing import NamedTuple

import numpy as np
from scipy.signal import lfilter

from detectors.reader.examples import Examples
from detectors.reader.prior.families import draw_log
from detectors.reader.prior.observing import make_examples
from usnet_env.arrays import Floats, Indices, Singles


class Stage(NamedTuple):
    """B windows of T steps with n UAVs; ``axes`` ``(3,)`` is 1 for the axes in which they move, else 0."""

    windows: int
    steps: int
    uavs: int
    axes: Floats

    def draw_normals(self, rng: np.random.Generator, *shape: int) -> Floats:
        """Standard normal vectors ``(B, *shape, 3)`` in the axes of the stage."""
        return np.asarray(rng.standard_normal((self.windows, *shape, 3)) * self.axes)

    def draw_each(self, rng: np.random.Generator, low: float, high: float) -> Floats:
        """Log-uniform numbers ``(B, n)`` of the UAVs, in half of the draws one for all of a window."""
        drawn = draw_log(rng, low, high, self.windows, self.uavs if rng.random() < 0.5 else 1)
        return np.broadcast_to(drawn, (self.windows, self.uavs))

    def draw_delays(self, rng: np.random.Generator, most: int = 1000) -> Indices:
        """Delays ``(B, n)``, often similar: up to 12 steps in half of the draws, else up to a third of the window."""
        most = max(2, min(most, 12 if rng.random() < 0.5 else most, self.steps // 3))
        drawn = self.draw_each(rng, 0.6, most)
        if rng.random() < 0.4:
            drawn = drawn[:, :1] * rng.uniform(0.7, 1.3, drawn.shape)
        return np.maximum(np.rint(drawn), 1).astype(np.int64)


class Flight(NamedTuple):
    """Positions ``(B, T + 1, n, 3)``, the leader ``(n,)`` of each UAV, delays, ``(B, n)`` or NaN, and links.

    Links ``(B, n, n)`` are those to the leaders by default, and NaN where they aren't defined.
    """

    position: Floats
    leader: Indices
    delay: Floats | Indices | float = np.nan
    link: Floats | float | None = None


def link_leaders(leader: Indices) -> Singles:
    """1 for the leader ``(..., n)`` of each UAV and 0 for others: ``(..., n, n)``."""
    index = np.arange(leader.shape[-1])
    return ((leader[..., None] == index) & (leader != index)[..., None]).astype(np.float32)


def keep_noise(noise: Floats, phi: Floats) -> Floats:
    """Autoregressive noise of order 1 with the variance of ``noise (B, S, ...)``, and ``phi (B,)``."""
    sigma = np.sqrt(1.0 - phi**2)
    noise[:, 0] /= sigma.reshape(-1, *[1] * (noise.ndim - 2))
    return np.stack([lfilter([r], [1.0, -k], row, axis=0) for row, k, r in zip(noise, phi, sigma, strict=True)])


def draw_ways(rng: np.random.Generator, stage: Stage, steps: int, uavs: int, calm: float = 1.0) -> Floats:
    """Velocities ``(B, steps, uavs, 3)`` of lone UAVs; in a step they forget ``calm`` of a velocity at most."""
    phi = 1.0 - draw_log(rng, 0.01, calm, stage.windows)
    velocity = keep_noise(stage.draw_normals(rng, steps, uavs), phi)
    if rng.random() < 0.5:  # smooth turns
        velocity = keep_noise(velocity, phi)
        velocity /= np.sqrt((velocity**2).mean((1, 2, 3), keepdims=True)) + 1e-9
    velocity = velocity + rng.uniform(0.0, 2.0, (stage.windows, 1, 1, 1)) * stage.draw_normals(rng, 1, uavs)
    if stage.axes.sum() > 1 and rng.random() < 0.6:
        speed = keep_noise(rng.standard_normal((stage.windows, steps, uavs, 1)), np.full(stage.windows, 0.95))
        velocity *= np.exp(rng.uniform(0.0, 0.5) * speed) / (np.linalg.norm(velocity, axis=-1, keepdims=True) + 1e-9)
    return velocity


def draw_groups(rng: np.random.Generator, uavs: int, most: int) -> Indices:
    """The leader ``(n,)`` of each UAV, the leaders first; one group in half of the draws, else 1 to ``most``."""
    groups = 1 if rng.random() < 0.5 else int(rng.integers(1, min(most, uavs // 2) + 1))  # each has a follower
    return np.concatenate([np.arange(groups), np.arange(groups), rng.integers(groups, size=uavs - 2 * groups)])


def place_groups(rng: np.random.Generator, stage: Stage, leader: Indices) -> Floats:
    """Start positions ``(B, n, 3)``: groups apart, or in each other; UAVs of a group spread about its middle."""
    scale, separation = draw_log(rng, 1.0, 60.0, stage.windows, 1, 1), draw_log(rng, 0.1, 10.0, stage.windows, 1, 1)
    middle = separation * stage.draw_normals(rng, int(leader.max()) + 1)
    return np.asarray(scale * (middle[:, leader] + stage.draw_normals(rng, len(leader))))


def travel(start: Floats, velocity: Floats) -> Floats:
    """The positions ``(B, S + 1, n, 3)`` from a start ``(B, n, 3)`` on."""
    return np.cumsum(np.concatenate([start[:, None], velocity], axis=1), axis=1)


def finish(rng: np.random.Generator, stage: Stage, flight: Flight) -> Examples:
    """Add lone UAVs among the others to a third of the flights with a leader, mix all, and find the heads."""
    position, leader = flight.position, flight.leader
    (windows, _, uavs, _), row = position.shape, np.arange(len(position))[:, None]
    delay = np.broadcast_to(np.asarray(flight.delay, np.float32), (windows, uavs))
    link = link_leaders(leader) if flight.link is None else np.asarray(flight.link, np.float32)
    link = np.broadcast_to(link, (windows, uavs, uavs))
    if (leader != np.arange(uavs)).any() and rng.random() < 1 / 3:
        lone = int(rng.integers(max(2, uavs // 3))) + 1
        speed = np.linalg.norm(np.diff(position, axis=1), axis=-1).mean((1, 2))[:, None, None]
        spread = position[:, 0].std((1, 2))[:, None, None] + speed
        place = position[:, 0].mean(1, keepdims=True) + spread * stage.draw_normals(rng, lone)
        ways = travel(place, speed[..., None] * draw_ways(rng, stage, stage.steps, lone))
        position, leader = np.concatenate([position, ways], axis=2), np.append(leader, uavs + np.arange(lone))
        delay = np.concatenate([delay, np.full((windows, lone), np.nan, np.float32)], axis=1)
        link = np.pad(link, ((0, 0), (0, lone), (0, lone)))
    order = rng.permuted(np.tile(np.arange(len(leader)), (windows, 1)), axis=1)  # the UAV at each index
    index, new_leader = np.arange(len(leader)), np.argsort(order, axis=1)[row, leader[order]]
    root = new_leader
    for _ in range(len(index).bit_length()):
        root = root[row, root]
    head = np.stack([np.isin(index, roots[roots != index]) for roots in root])
    new_delay = np.where(new_leader == index, np.float32(np.nan), delay[row, order])
    mixed = np.take_along_axis(position, order[:, None, :, None], axis=2)
    link = link[row[..., None], order[:, :, None], order[:, None]]
    return make_examples(mixed, np.ones(mixed.shape[:3], bool), (head, new_leader, root, link, new_delay, ""))
