"""The windows that the checks use: simulated swarms, and swarms that carry no information about their heads."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from usnet_env.swarm import SwarmConfig, SwarmState, advance, destroy, start
from usnet_env.window import Window

__all__ = [
    "make_hovering_window",
    "permute_uavs",
    "simulate_missing_samples",
    "simulate_swarm_with_heads",
    "simulate_window",
]


def simulate_window(
    clusters: int = 3,
    uavs: int = 14,
    *,
    seed: int = 0,
    destroyed: int = 0,
    observation_steps: int = 60,
    round: int = 1,
    **config: Any,
) -> Window:
    """Simulate a swarm and return one window.

    Args:
        clusters: M, the number of clusters.
        uavs: N, at least 3 M.
        seed: seed of the swarm.
        destroyed: number of destroyed UAVs, heads included, at most N - 3; one head always survives.
        observation_steps: T_ob.
        round: number of the round.
        config: further arguments of :class:`usnet_env.swarm.SwarmConfig`.
    """
    swarm = SwarmConfig(clusters=clusters, uavs=uavs, observation_steps=observation_steps, **config)
    rng = np.random.default_rng(seed)
    state = start(swarm, [rng])
    spared = np.flatnonzero(state.head[0])[:1]
    order = rng.permutation(np.setdiff1d(np.arange(uavs), spared))
    gone = np.zeros((1, uavs), bool)
    gone[0, order[: min(destroyed, uavs - 3)]] = True
    _, sighting = advance(swarm, destroy(state, gone), [rng])
    return Window(sighting.position[0], sighting.velocity[0], sighting.seen[0], sighting.alive[0], round)


def simulate_missing_samples(seed: int = 0) -> Window:
    """Simulate a noisy window with missing samples: single ones, all of one UAV, and all UAVs at some steps."""
    window = simulate_window(seed=seed, miss_rate=0.3, position_noise=0.2, destroyed=2, round=2)
    seen = window.seen.copy()
    seen[:, np.flatnonzero(window.alive)[0]] = False
    seen[[0, 20, 21]] = False
    return _mask_unseen_samples(window.position, window.velocity, seen, window.alive, window.round)


def make_hovering_window(uavs: int = 8, steps: int = 60, *, together: bool = False, seed: int = 0) -> Window:
    """Make a window in which no UAV moves, so that every spread is 0 and no UAV looks like a head.

    Args:
        uavs: N.
        steps: T_ob.
        together: whether all UAVs are at one point and differ in their indices only.
        seed: seed of the positions.
    """
    place = np.random.default_rng(seed).uniform(0, 100, (1 if together else uavs, 3))
    position = np.broadcast_to(place.astype(np.float32), (steps + 1, uavs, 3))
    return Window(
        position, np.zeros((steps, uavs, 3), np.float32), np.ones((steps + 1, uavs), bool), np.ones(uavs, bool)
    )


def permute_uavs(window: Window, order: NDArray[np.intp]) -> Window:
    """Return the window with UAV ``order[i]`` at index i."""
    return Window(
        window.position[:, order], window.velocity[:, order], window.seen[:, order], window.alive[order], window.round
    )


def simulate_swarm_with_heads(window: Window, heads: NDArray[np.intp]) -> SwarmState:
    """Make the state of another swarm with the window's N, and with heads at the indices ``heads``."""
    config = SwarmConfig(clusters=1, uavs=window.uavs, observation_steps=window.observation_steps)
    state = start(config, [np.random.default_rng(0)]).episode()
    head = np.zeros(window.uavs, bool)
    head[heads] = True
    return replace(state, head=head, leader=np.where(head, np.arange(window.uavs), heads[0]))


def _mask_unseen_samples(
    position: NDArray[np.float32],
    velocity: NDArray[np.float32],
    seen: NDArray[np.bool_],
    alive: NDArray[np.bool_],
    round: int,
) -> Window:
    """Make a window with zeros for unseen samples, as in the environments."""
    both = seen[1:] & seen[:-1]
    return Window(np.where(seen[..., None], position, 0), np.where(both[..., None], velocity, 0), seen, alive, round)
