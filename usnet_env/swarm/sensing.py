"""The observer's sensor: sampling, position noise and missed detections."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from usnet_env.arrays import Mask, Singles
from usnet_env.swarm.config import NOISE_BOUND, SwarmConfig

__all__ = ["ObservationBatch", "sense"]


@dataclass(frozen=True)
class ObservationBatch:
    """The observed windows of B swarms.

    Args:
        position: ``(B, T_ob + 1, N, 3)`` float32, metres; 0 where the UAV was not detected.
        velocity: ``(B, T_ob, N, 3)`` float32, metres per step; 0 unless the UAV was detected at both ends of the step.
        seen: ``(B, T_ob + 1, N)`` bool, whether the UAV was detected.
        alive: ``(B, N)`` bool, false for destroyed UAVs.
    """

    position: Singles
    velocity: Singles
    seen: Mask
    alive: Mask


def sense(
    config: SwarmConfig, position: Singles, velocity: Singles, alive: Mask, rngs: Sequence[np.random.Generator]
) -> ObservationBatch:
    """Observe B swarms.

    If every step is sampled without noise, the observed velocity is the true velocity. Otherwise it is the difference
    of two observed positions, divided by the number of steps between them.

    Args:
        config: the sensor: ``sample_every`` k, ``position_noise`` and ``miss_rate`` are used.
        position: ``(B, T_ob * k + 1, N, 3)`` float32, metres, the true positions from the start of the window.
        velocity: ``(B, T_ob * k, N, 3)`` float32, metres per step, the true velocities.
        alive: ``(B, N)`` bool.
        rngs: one generator per episode.

    Returns:
        The observed windows.
    """
    k = config.sample_every
    differenced = k > 1 or config.position_noise > 0
    if k > 1:
        position = position[:, ::k]
    if config.position_noise > 0:
        noise = np.empty(position.shape, np.float32)
        for row, rng in zip(noise, rngs, strict=True):
            rng.standard_normal(out=row, dtype=np.float32)
        np.clip(noise, -NOISE_BOUND, NOISE_BOUND, out=noise)
        noise *= np.float32(config.position_noise)
        noise.swapaxes(1, 2)[~alive] = 0.0
        position = position + noise
    if differenced:
        velocity = np.diff(position, axis=1)
        if k > 1:
            velocity /= np.float32(k)
    seen = np.broadcast_to(alive[:, None], position.shape[:3]).copy()
    if config.miss_rate > 0:
        for row, rng in zip(seen, rngs, strict=True):
            row &= rng.random(row.shape, dtype=np.float32) >= config.miss_rate
        # `where` instead of a product: a product with 0 would keep the sign of the hidden value.
        position = np.where(seen[..., None], position, np.float32(0.0))
        velocity = np.where((seen[:, 1:] & seen[:, :-1])[..., None], velocity, np.float32(0.0))
    return ObservationBatch(position, velocity, seen, alive.copy())
