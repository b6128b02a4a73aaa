"""Velocities for the tests of the kernel: a few UAVs that follow others, with gaps."""

from __future__ import annotations

import numpy as np
from hypothesis import strategies as st


def flight(seed, steps=40, uavs=6):
    """Velocities ``(steps, uavs, 3)``: the odd UAVs repeat the one before them two steps later, with noise."""
    rng = np.random.default_rng(seed)
    velocity = rng.standard_normal((steps, uavs, 3))
    velocity[2:, 1::2] = velocity[:-2, : uavs - uavs % 2 : 2] + 0.5 * velocity[2:, 1::2]
    return velocity + rng.standard_normal(3)  # a common drift


def gaps(seed, steps=40, uavs=6, missed=0.15):
    """``(steps, uavs)``: which velocities were seen."""
    return np.random.default_rng([seed, 1]).random((steps, uavs)) >= missed


@st.composite
def flights(draw, least_steps=12):
    """A velocity, its mask and a permutation of its UAVs."""
    seed, uavs = draw(st.integers(0, 2**31)), draw(st.integers(2, 7))
    steps = draw(st.integers(least_steps, 50))
    order = np.array(draw(st.permutations(range(uavs))))
    return flight(seed, steps, uavs), gaps(seed, steps, uavs, draw(st.sampled_from([0.0, 0.1, 0.4]))), order
