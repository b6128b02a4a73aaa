"""Windows of simulated swarms, with the truth."""

from __future__ import annotations

import numpy as np

from usnet_env import Window
from usnet_env.swarm import SwarmConfig, advance, start


def swarm_window(seed=0, **config):
    """A window, heads (N,) and leaders (N,) of a swarm in its first round."""
    rngs = [np.random.default_rng(seed)]
    settings = SwarmConfig(**config)
    state, sighting = advance(settings, start(settings, rngs), rngs)
    truth = state.episode(0)
    arrays = (getattr(sighting, name)[0] for name in ("position", "velocity", "seen", "alive"))
    return Window(*arrays), truth.head, truth.root


def without(window, gone):
    """The window of round 2, in which the UAVs ``gone`` (N,) have been destroyed."""
    alive = window.alive & ~gone
    seen = window.seen & alive
    return Window(
        np.where(seen[..., None], window.position, 0), np.where(alive[:, None], window.velocity, 0), seen, alive, 2
    )
