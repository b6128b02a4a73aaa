"""How the tests fly swarms."""

import numpy as np

from usnet_env.swarm import SwarmConfig, advance, start


def generators(seeds):
    return [np.random.default_rng(seed) for seed in seeds]


def fly(follow="f1", rounds=1, seed=0, **arguments):
    """The last of some windows of a swarm, and the state before it without the leading axis."""
    config = SwarmConfig(**{"follow": follow, "memory": 12, "clusters": 2, "uavs": 24, **arguments})
    rngs = generators([seed])
    state = start(config, rngs)
    for _ in range(rounds):
        before = state
        state, window = advance(config, state, rngs)
    return before.episode(), window


def flown(window):
    """Velocities and positions of the first swarm in double precision."""
    return window.velocity[0].astype(float), window.position[0].astype(float)


def unit(x):
    return x / np.linalg.norm(x, axis=-1, keepdims=True)


def turns(velocity):
    course = unit(velocity)
    return np.arccos(np.clip((course[1:] * course[:-1]).sum(axis=-1), -1, 1))
