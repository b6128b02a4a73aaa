"""Windows of a simulated swarm, and the slow definitions that the fast ones are held against."""

from __future__ import annotations

import numpy as np

from usnet_env import Window
from usnet_env.swarm import SwarmConfig, advance, start


def swarm_window(seed, **config):
    """One window and the truth about it."""
    settings = SwarmConfig(**{"clusters": 3, "uavs": 30, **config})
    generators = [np.random.default_rng(seed)]
    state, seen = advance(settings, start(settings, generators), generators)
    return Window(seen.position[0], seen.velocity[0], seen.seen[0], seen.alive[0]), state.episode(0)
