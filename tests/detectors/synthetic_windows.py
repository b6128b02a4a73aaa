"""Windows made by hand: heads with fresh random directions, and their followers; and windows of simulated swarms."""

import numpy as np

from usnet_env import Window
from usnet_env.swarm import SwarmConfig, advance, start


def unit(vectors):
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def flight(rng, sizes=(6, 4, 3), steps=100, kind="f1", noise=0.05):
    """Velocities ``(steps, N, 3)`` and the leader ``(N,)`` of every UAV; heads sit at random indices.

    ``kind``: f1 (last velocity), f4 (squares of the last two) or none (all UAVs fly like heads).
    """
    uavs = sum(size + 1 for size in sizes)
    order = rng.permutation(uavs)
    leader = np.empty(uavs, int)
    start = 0
    for size in sizes:
        members = order[start : start + size + 1]
        leader[members] = members[0]
        start += size + 1
    heads = leader == np.arange(uavs)
    velocity = unit(rng.standard_normal((steps + 3, uavs, 3)))
    past, before = velocity[1:-1, leader], velocity[:-2, leader]
    wanted = {"f1": past, "f4": past**2 + before**2, "none": velocity[2:]}[kind]
    followed = unit(wanted + noise * rng.standard_normal(wanted.shape))
    return np.where(heads[:, None], velocity[2:], followed)[-steps:], leader


def window_of(velocity, seen=None, alive=None, round=1, step=None):
    """The window that shows ``velocity``; what is unseen or destroyed is 0, as the environments have it."""
    steps, uavs = velocity.shape[:2]
    seen = np.ones((steps + 1, uavs), bool) if seen is None else seen
    alive = np.ones(uavs, bool) if alive is None else alive
    seen = seen & alive
    position = np.concatenate([np.zeros((1, uavs, 3)), np.cumsum(velocity, axis=0)])
    there = seen[1:] & seen[:-1]
    return Window(
        position=np.where(seen[..., None], position, 0),
        velocity=np.where(there[..., None], velocity, 0),
        seen=seen,
        alive=alive,
        round=round,
        step=step,
    )


def answer(detector, window, seed=0):
    """What a detector answers to the first window of an episode."""
    detector.reset(seed)
    return detector.detect(window)


def heads_of(leader):
    return leader == np.arange(len(leader))


def swarm_window(seed=0, **config):
    """The first window of a simulated swarm and the truth about it."""
    settings, rngs = SwarmConfig(**{"clusters": 3, "uavs": 30, **config}), [np.random.default_rng(seed)]
    state, sighting = advance(settings, start(settings, rngs), rngs)
    arrays = (getattr(sighting, name)[0] for name in ("position", "velocity", "seen", "alive"))
    return Window(*arrays), state.episode(0)
