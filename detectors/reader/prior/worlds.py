"""Worlds that the simulator doesn't have, by name, with their weights."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from detectors.reader.prior.draws import draw_log, draw_whole
from detectors.reader.prior.motion import Motion, find_heads


class World(NamedTuple):
    """A world: how often it is drawn among the worlds, and ``draw(rng, windows, steps, most_uavs)``."""

    weight: float
    draw: Callable[[np.random.Generator, int, int, int], Motion]


def draw_walkers(rng: np.random.Generator, windows: int, steps: int, most_uavs: int) -> Motion:
    """UAVs that walk on their own, from jittery to nearly straight."""
    uavs = draw_whole(rng, 2, min(60, most_uavs))
    keep = rng.uniform(0.0, 0.98, (windows, uavs, 1))
    velocity = rng.standard_normal((windows, steps, uavs, 3))
    for t in range(1, steps):
        velocity[:, t] = keep * velocity[:, t - 1] + np.sqrt(1 - keep**2) * velocity[:, t]
    place = draw_log(rng, 3.0, 300.0) * rng.standard_normal((windows, 1, uavs, 3))
    position = np.concatenate([place, place + np.cumsum(velocity, axis=1)], axis=1)
    own = np.broadcast_to(np.arange(uavs), (windows, uavs))
    return find_heads(position, own, np.full(own.shape, np.nan))


WORLDS = {"walkers": World(1.0, draw_walkers)}
