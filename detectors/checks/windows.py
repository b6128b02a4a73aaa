"""The windows that the checks use: simulated swarms, and a swarm that carries no information about its heads."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from usnet_env.detection import read_tags
from usnet_env.swarm import SwarmConfig, advance, destroy, start
from usnet_env.window import Window

STEPS = 30  # T_ob of most windows: what the checks look for shows in short windows too


def draw_window(
    detector: Any,
    uavs: int = 14,
    clusters: int = 3,
    *,
    seed: int = 0,
    destroyed: int = 0,
    round: int = 1,
    **config: Any,
) -> Window:
    """Simulate a window of a size that the detector takes by its tags; at least one head and 3 UAVs survive."""
    tags = read_tags(detector)
    uavs = max(3, min(uavs, tags.most_uavs or uavs))
    steps = max(STEPS, tags.least_steps)
    swarm = SwarmConfig(clusters=min(clusters, uavs // 3), uavs=uavs, observation_steps=steps, **config)
    rng = np.random.default_rng(seed)
    state = start(swarm, [rng])
    order = rng.permutation(np.setdiff1d(np.arange(uavs), np.flatnonzero(state.head[0])[:1]))
    is_destroyed = np.zeros((1, uavs), bool)
    is_destroyed[0, order[: min(destroyed, uavs - 3)]] = True
    _, sighting = advance(swarm, destroy(state, is_destroyed), [rng])
    return Window(sighting.position[0], sighting.velocity[0], sighting.seen[0], sighting.alive[0], round)


def draw_two_rounds(detector: Any) -> list[Window]:
    """Simulate the windows of two rounds."""
    return [draw_window(detector), draw_window(detector, seed=1, destroyed=3, round=2)]


def draw_gaps(detector: Any) -> Window:
    """Simulate a noisy window with missing samples: single ones, all of one UAV, and all UAVs at some steps."""
    window = draw_window(detector, miss_rate=0.3, position_noise=0.2, destroyed=2, round=2)
    seen = window.seen.copy()
    seen[:, np.flatnonzero(window.alive)[0]] = False
    seen[[0, 20, 21]] = False
    both_seen = seen[1:] & seen[:-1]
    position = np.where(seen[..., None], window.position, 0)
    velocity = np.where(both_seen[..., None], window.velocity, 0)
    return replace(window, position=position, velocity=velocity, seen=seen)


def stop_uavs(window: Window) -> Window:
    """The window if no UAV moved."""
    position = np.broadcast_to(window.position[:1], window.position.shape)
    return replace(window, position=position, velocity=np.zeros_like(window.velocity))


def pick_uavs(window: Window, index: NDArray[np.intp]) -> Window:
    """The window of the UAVs ``index``, in this order."""
    arrays = (window.position[:, index], window.velocity[:, index], window.seen[:, index], window.alive[index])
    return Window(*arrays, window.round, window.step)
