"""Samples that the observer missed: one rule for every detector that needs tracks without gaps."""

from __future__ import annotations

import numpy as np

from usnet_env.window import Window


def fill_gaps(window: Window) -> Window:
    """Fill in the samples of living UAVs that were missed.

    A missed position is interpolated linearly between the seen ones before and after it; before the first and after
    the last seen position, that one is repeated. A missed velocity is the difference of the filled positions. A UAV
    that was never seen has the mean track of the other living UAVs.

    Returns:
        A window in which every living UAV is always seen, unless none was ever seen; what was seen is as it was.

    >>> position = np.array([[[0.0, 0, 0]], [[0, 0, 0]], [[2, 0, 0]]])
    >>> window = Window(position, np.zeros((2, 1, 3)), seen=[[1], [0], [1]], alive=[1])
    >>> fill_gaps(window).position[:, 0, 0].tolist()
    [0.0, 1.0, 2.0]
    """
    seen, alive = window.seen, window.alive
    was_seen = seen.any(axis=0) & alive
    if seen[:, alive].all() or not was_seen.any():
        return window
    position, velocity = window.position.copy(), window.velocity.copy()
    instants = np.arange(len(position))
    for uav in np.flatnonzero(was_seen & ~seen.all(axis=0)):
        seen_instants = np.flatnonzero(seen[:, uav])
        for axis in range(3):
            position[:, uav, axis] = np.interp(instants, seen_instants, position[seen_instants, uav, axis])
    is_missed = ~window.velocity_seen
    velocity[is_missed] = np.diff(position, axis=0)[is_missed]
    for values in (position, velocity):
        values[:, alive & ~was_seen] = values[:, was_seen].mean(axis=1, keepdims=True)
        values[:, ~alive] = 0.0
    return Window(position, velocity, np.broadcast_to(alive, seen.shape), alive, window.round, window.step)
