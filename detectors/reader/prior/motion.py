"""What flies: the motions of B windows with their truth, how they are sampled, and the examples that they become."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.interpolate import make_interp_spline

from detectors.reader.examples import Examples
from usnet_env.arrays import Floats, Indices, Mask, Singles


class Motion(NamedTuple):
    """B motions of n UAVs: positions ``(B, T + 1, n, 3)`` in metres, and the other fields of ``Examples``.

    ``velocity`` is None where it follows from the positions.
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
    root, own = leader, np.arange(leader.shape[1])
    for _ in range(leader.shape[1].bit_length()):
        root = np.take_along_axis(root, root, axis=1)
    head = np.stack([np.isin(own, row[row != own]) for row in root])
    late = np.where(leader == own, np.nan, delay).astype(np.float32)
    return Motion(position, np.ones(position.shape[:3], bool), head, leader, root, late)


def resample(motion: Motion, instants: Floats, degree: int = 1) -> Motion:
    """Sample a motion at evenly spaced instants, in steps; between its own by splines, if all of it is seen."""
    late = motion.delay / np.float32(instants[1])
    if instants[1] >= 1:
        own = instants.astype(np.int64)
        return motion._replace(position=motion.position[:, own], seen=motion.seen[:, own], delay=late, velocity=None)
    position = make_interp_spline(np.arange(motion.position.shape[1]), motion.position, degree, axis=1)(instants)
    return motion._replace(position=position, seen=np.ones(position.shape[:3], bool), delay=late, velocity=None)


def make_examples(motion: Motion, family: str) -> Examples:
    """The windows of a motion, with zeros where a UAV isn't seen."""
    position, seen, head, leader, root, delay, velocity = motion
    velocity = np.diff(position, axis=1) if velocity is None else velocity
    both = (seen[:, 1:] & seen[:, :-1])[..., None]
    shown = np.where(seen[..., None], position, 0.0).astype(np.float32)
    return Examples(shown, np.where(both, velocity, 0.0).astype(np.float32), seen, head, leader, root, delay, family)
