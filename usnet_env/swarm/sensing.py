"""The observer's sensor: sampling, noise, missed detections, partial and false tracks, and identity switches."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from usnet_env.arrays import Indices, Mask, Singles
from usnet_env.swarm import kernels
from usnet_env.swarm.config import NOISE_BOUND, SWAP_RANGE, SwarmConfig

Generators = Sequence[np.random.Generator]


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

    @classmethod
    def unseen(cls, config: SwarmConfig, alive: Mask) -> Self:
        """The windows of swarms, or of one without the leading axis, in which no UAV is seen."""
        instants, uavs = config.observation_steps + 1, alive.shape[-1]
        return cls(
            position=np.zeros((*alive.shape[:-1], instants, uavs, 3), np.float32),
            velocity=np.zeros((*alive.shape[:-1], instants - 1, uavs, 3), np.float32),
            seen=np.zeros((*alive.shape[:-1], instants, uavs), bool),
            alive=alive.copy(),
        )


def draw_normals(rngs: Generators, *shape: int) -> Singles:
    """Standard normal numbers ``(B, *shape)`` float32, those of an episode from its own generator."""
    drawn = np.empty((len(rngs), *shape), np.float32)
    for row, rng in zip(drawn, rngs, strict=True):
        rng.standard_normal(out=row, dtype=np.float32)
    return drawn


def sense(
    config: SwarmConfig,
    position: Singles,
    velocity: Singles,
    alive: Mask,
    rngs: Generators,
    clutter: Indices | None = None,
) -> ObservationBatch:
    """Observe B swarms.

    If every step is sampled without noise, the observed velocity is the true velocity. Otherwise it is the difference
    of two observed positions, divided by the number of steps between them.

    Noise with a memory φ is an autoregressive process of order 1. With ``course_noise`` ρ the noise n of a UAV with the
    course e, the direction of its next step, becomes n + (ρ - 1) (n · e) e. A false track is seen in one part of the
    window, of a tenth to three fifths of its instants. Missed detections in bursts are a Markov chain of two
    states (Gilbert 1960) with the miss rate as its stationary distribution.

    Args:
        config: the sensor: ``sample_every`` k and the fields of ``SensorArguments`` are used.
        position: ``(B, T_ob * k + 1, N, 3)`` float32, metres, the true positions from the start of the window.
        velocity: ``(B, T_ob * k, N, 3)`` float32, metres per step, the true velocities.
        alive: ``(B, N)`` bool.
        rngs: one generator per episode.
        clutter: ``(B, c)`` int64, the indices of false tracks.
    """
    k = config.sample_every
    differenced = k > 1 or config.position_noise > 0 or config.swap_rate > 0
    if k > 1:
        position = position[:, ::k]
    # Drawn in this order, and used below: an exchange of identities depends on which false tracks are present.
    swaps = [rng.random(position.shape[1:3]) < config.swap_rate for rng in rngs] if config.swap_rate > 0 else []
    if config.position_noise > 0:
        noise = draw_normals(rngs, *position.shape[1:])
    seen = np.broadcast_to(alive[:, None], position.shape[:3]).copy()
    present = seen.copy()
    for row, rng in zip(seen, rngs, strict=True):
        if config.miss_rate > 0:
            row &= _detect(rng.random(row.shape, dtype=np.float32), config.miss_rate, config.miss_burst)
        if config.partial_tracks > 0:
            row &= _cover(rng, row.shape[0], row.shape[1], config.partial_tracks)
    if config.clutter and clutter is not None:
        for row, rng, false in zip(present, rngs, clutter, strict=True):
            row[:, false] &= _appear(rng, row.shape[0], len(false))
    if config.swap_rate > 0:
        holder = np.stack([_swap(*episode) for episode in zip(position, present, swaps, alive, strict=True)])
        if (holder != np.arange(holder.shape[2])).any():
            position = np.take_along_axis(position, holder[..., None], axis=2)
            present = np.take_along_axis(present, holder, axis=2)
    seen &= present
    if config.position_noise > 0:
        if config.noise_memory > 0:
            kernels.remember(np.float32(config.noise_memory), noise)
        if config.course_noise != 1:
            course = np.diff(position, axis=1, append=2 * position[:, -1:] - position[:, -2:-1])
            course /= np.maximum(np.linalg.norm(course, axis=-1, keepdims=True), np.float32(1e-6))
            noise += np.float32(config.course_noise - 1) * (noise * course).sum(axis=-1, keepdims=True) * course
        bound = NOISE_BOUND * max(1.0, config.course_noise)
        np.clip(noise, -bound, bound, out=noise)
        noise *= np.float32(config.position_noise)
        noise.swapaxes(1, 2)[~alive] = 0.0
        position = position + noise
    if differenced:
        velocity = np.diff(position, axis=1) / np.float32(k)
    if config.miss_rate > 0 or config.partial_tracks > 0 or config.clutter:
        # `where` instead of a product: a product with 0 would keep the sign of the hidden value.
        position = np.where(seen[..., None], position, np.float32(0.0))
        velocity = np.where((seen[:, 1:] & seen[:, :-1])[..., None], velocity, np.float32(0.0))
    return ObservationBatch(position, velocity, seen, alive.copy())


def shift_tracks(position: Singles, velocity: Singles, source: Indices, rngs: Generators) -> tuple[Singles, Singles]:
    """Roll the steps of each UAV's track in time by a shift of its own; the track begins where it did.

    The shifts of m UAVs with the same source are T / m steps apart, in random order.
    """
    steps = velocity.shape[1]
    shift = np.empty(source.shape, np.int64)
    for b, rng in enumerate(rngs):
        for first in np.unique(source[b]):
            members = np.flatnonzero(source[b] == first)
            places = (rng.permutation(len(members)) + rng.random()) / len(members)
            shift[b, members] = places * steps
    when = (np.arange(steps)[:, None] - shift[:, None]) % steps
    velocity = np.take_along_axis(velocity, when[..., None], axis=1)
    return np.cumsum(np.concatenate([position[:, :1], velocity], axis=1), axis=1, dtype=np.float32), velocity


def _detect(drawn: Singles, rate: float, burst: float) -> Mask:
    """Which UAVs are detected, ``(T_ob + 1, N)``, from uniform numbers of this shape."""
    if burst == 0:
        return drawn >= rate
    detected = drawn >= rate
    kernels.miss_in_bursts(rate / (burst * (1.0 - rate)), 1.0 - 1.0 / burst, drawn, detected)
    return detected


def _cover(rng: np.random.Generator, instants: int, uavs: int, share: float) -> Mask:
    """Which instants the tracks cover, ``(T_ob + 1, N)``: a partial track begins or ends in the middle three fifths."""
    partial, cut, early = rng.random(uavs) < share, rng.uniform(0.2, 0.8, uavs), rng.random(uavs) < 0.5
    time = np.arange(instants)[:, None] / max(instants - 1, 1)
    return ~partial | np.where(early, time <= cut, time >= cut)


def _appear(rng: np.random.Generator, instants: int, tracks: int) -> Mask:
    """Which instants false tracks cover, ``(T_ob + 1, tracks)``: one part of the window each."""
    length = np.maximum(2, np.ceil(rng.uniform(0.1, 0.6, tracks) * instants))
    begin = np.floor(rng.random(tracks) * (instants - length + 1))
    time = np.arange(instants)[:, None]
    return np.asarray((time >= begin) & (time < begin + length))


def _swap(position: Singles, present: Mask, swaps: Mask, alive: Mask) -> Indices:
    """Whose track each identity shows, ``(T_ob + 1, N)`` int64; a UAV switches at most once in an instant.

    ``swaps`` ``(T_ob + 1, N)`` marks the identities that switch if another one is near and present.
    """
    holder = np.arange(len(alive))  # the true UAV of each identity
    shown = np.tile(holder, (len(swaps), 1))
    for t in np.flatnonzero(swaps.any(axis=1)):
        place, free = position[t], alive & present[t][holder]
        for i in np.flatnonzero(swaps[t] & free):
            distance = np.linalg.norm(place[holder] - place[holder[i]], axis=1)
            distance[~free | (np.arange(len(alive)) == i)] = np.inf
            j = int(distance.argmin())
            if free[i] and distance[j] <= SWAP_RANGE:
                holder[i], holder[j] = holder[j], holder[i]
                free[i] = free[j] = False
        shown[t:] = holder
    return shown
