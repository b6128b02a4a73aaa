"""Velocities for the tests of the kernel: a few UAVs that follow others, with gaps."""

from __future__ import annotations

import numpy as np


def flight(seed, steps=40, uavs=6):
    """Velocities ``(steps, uavs, 3)``: the odd UAVs repeat the one before them two steps later, with noise."""
    rng = np.random.default_rng(seed)
    velocity = rng.standard_normal((steps, uavs, 3))
    velocity[2:, 1::2] = velocity[:-2, : uavs - uavs % 2 : 2] + 0.5 * velocity[2:, 1::2]
    return velocity + rng.standard_normal(3)  # a common drift


def gaps(seed, steps=40, uavs=6, missed=0.15):
    """``(steps, uavs)``: which velocities were seen."""
    return np.random.default_rng([seed, 1]).random((steps, uavs)) >= missed
