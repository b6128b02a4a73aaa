"""What flies: the motions of B windows with their truth, before anybody observes them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline

from detectors.reader.examples import Examples
from usnet_env.arrays import Floats, Indices, Mask, Singles


class Motion(NamedTuple):
    """B motions of n UAVs; ``head``, ``leader``, ``root`` and ``delay`` as in ``Examples``.

    Args:
        position: ``(B, T + 1, n, 3)`` metres.
        seen: ``(B, T + 1, n)`` bool.
        velocity: ``(B, T, n, 3)`` metres a step where it is known better than from the positions, else None.
    """

    position: Floats | Singles
    seen: Mask
    head: Mask
    leader: Indices
    root: Indices
    delay: Singles
    velocity: Singles | None = None


def find_heads(position: Floats, leader: Indices, delay: Floats) -> Motion:
    """A motion of which all is seen; heads and roots are where the chains of leaders end."""
    root = leader
    for _ in range(int(np.ceil(np.log2(leader.shape[1] + 1)))):
        root = np.take_along_axis(root, root, axis=1)
    own = np.arange(leader.shape[1])
    head = np.zeros(leader.shape, bool)
    for row, roots in zip(head, root, strict=True):
        row[roots[roots != own]] = True
    late = np.where(leader == own, np.nan, delay).astype(np.float32)
    return Motion(position, np.ones(position.shape[:3], bool), head, leader, root, late)


def thin(motion: Motion, every: int) -> Motion:
    """Sample every k-th instant."""
    seen, late = motion.seen[:, ::every], motion.delay / np.float32(every)
    return motion._replace(position=motion.position[:, ::every], seen=seen, delay=late, velocity=None)


def fill(motion: Motion, times: int, steps: int, cubic: bool) -> Motion:
    """Interpolate the places of a motion that is all seen at ``times`` its rate, to ``steps`` steps."""
    position = motion.position
    coarse, fine = np.arange(position.shape[1]), np.arange(steps + 1) / times
    if cubic:
        dense = CubicSpline(coarse, position, axis=1)(fine)
    else:
        before = np.minimum(fine.astype(np.int64), len(coarse) - 2)
        part = (fine - before)[:, None, None]
        dense = (1 - part) * position[:, before] + part * position[:, before + 1]
    seen, late = np.ones(dense.shape[:3], bool), motion.delay * np.float32(times)
    return motion._replace(position=dense, seen=seen, delay=late, velocity=None)


def flatten(motion: Motion) -> Motion:
    """Project a motion on the plane."""
    return motion._replace(position=motion.position * np.array([1.0, 1.0, 0.0]), velocity=None)


def make_examples(motion: Motion, family: str) -> Examples:
    """The windows of a motion, with zeros where a UAV isn't seen."""
    position, seen = motion.position, motion.seen
    velocity = np.diff(position, axis=1) if motion.velocity is None else motion.velocity
    both = (seen[:, 1:] & seen[:, :-1])[..., None]
    return Examples(
        np.where(seen[..., None], position, 0.0).astype(np.float32),
        np.where(both, velocity, 0.0).astype(np.float32),
        seen,
        motion.head,
        motion.leader.astype(np.int64),
        motion.root.astype(np.int64),
        motion.delay.astype(np.float32),
        family,
    )
