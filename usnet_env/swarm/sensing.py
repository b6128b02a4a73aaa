"""The observer's sensor: sampling, noise, missed detections, partial and false tracks, and identity switches."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from usnet_env.arrays import Floats, Indices, Mask, Singles
from usnet_env.swarm import sensing_kernels
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


def draw_normals(rngs: Generators, *shape: int) -> Singles:
    """Standard normal numbers ``(B, *shape)`` float32, those of an episode from its own generator."""
    normals = np.empty((len(rngs), *shape), np.float32)
    for row, rng in zip(normals, rngs, strict=True):
        rng.standard_normal(out=row, dtype=np.float32)
    return normals


def sense(
    configs: Sequence[SwarmConfig], position: Singles, velocity: Singles, alive: Mask, rngs: Generators, free: Indices,
    observer_position: Floats | None = None, reach: Floats | None = None, first: int = 0,
) -> ObservationBatch:  # fmt: skip
    """Observe B swarms by R observers, R / B of each swarm, with the same sampling.

    If every step is sampled without noise, the observed velocity is the true velocity. Otherwise it is the difference
    of two observed positions, divided by the number of steps between them.

    Noise with a memory φ is an autoregressive process of order 1. With ``course_noise`` ρ the noise n of a UAV with the
    course e, the direction of its next step, becomes n + (ρ - 1) (n · e) e. A partial track begins or ends in the
    middle three fifths of the window, and a false track is seen in one part of it, of a tenth to three fifths. Missed
    detections in bursts are a Markov chain of two states (Gilbert 1960) with the miss rate as its stationary
    distribution.

    Args:
        configs: for each observer its sensor: ``sample_every`` k and the fields of ``SensorArguments`` are used.
        position: ``(B, first + T_ob * k + 1, N + R, 3)`` float32, metres, the true positions, which exchanges of
            identities change in place.
        velocity: ``(B, first + T_ob * k, N + R, 3)`` float32, metres per step, the true velocities.
        alive: ``(B, N)`` bool.
        rngs: one generator per observer; none is used if no sensor has faults.
        free: for each swarm its free UAVs, ``(B, n)`` or ``(B,)`` of arrays; the last are false tracks.
        observer_position: ``(R, T_ob + 1, 3)`` metres, where the observers are at each instant, or ``(R, 1, 3)`` if
            they stand; if there is a limit of what they see.
        reach: ``(R,)`` metres, this limit.
        first: the instant of the flight at which the window begins.
    """
    k, observers_each = configs[0].sample_every, len(configs) // len(alive)
    uavs, alive = alive.shape[1], np.repeat(alive, observers_each, axis=0)
    seen = np.empty((len(alive), len(range(first, position.shape[1], k)), uavs), bool)
    seen[:] = alive[:, None]
    faulty = [r for r, sensor in enumerate(configs) if _has_faults(sensor)]
    if k == 1 and reach is None and not faulty:
        return ObservationBatch(position[:, first:, :uavs], velocity[:, first:, :uavs], seen, alive)
    observers, instants = seen.shape[:2]
    if observers_each > 1 and any(configs[r].swap_rate > 0 for r in faulty):
        position = np.repeat(position, observers_each, axis=0)
    noise = np.empty((sum(configs[r].position_noise > 0 for r in faulty), instants, 3 * uavs), np.float32)
    noisy, differs = np.full(observers, -1), np.full(observers, k > 1)  # the rows of the noise
    sensors = np.zeros((observers, 4), np.float32)
    for r in faulty:
        config, rng, row = configs[r], rngs[r], seen[r]
        present = row.copy()
        # Drawn first, and used last: an exchange of identities depends on which false tracks are present.
        swapped = rng.random(row.shape) < config.swap_rate if config.swap_rate > 0 else None
        differs[r] |= config.swap_rate > 0 or config.position_noise > 0
        if config.position_noise > 0:
            noisy[r] = noisy.max() + 1
            rng.standard_normal(out=noise[noisy[r]], dtype=np.float32)
            bound = NOISE_BOUND * max(1.0, config.course_noise)
            sensors[r] = config.noise_memory, config.course_noise - 1, bound, config.position_noise
        if config.miss_rate > 0:
            row &= _detect(rng.random(row.shape, dtype=np.float32), config.miss_rate, config.miss_burst)
        if config.partial_tracks > 0:
            sensing_kernels.cut_tracks(config.partial_tracks, rng.random((3, uavs)), row)
        if config.clutter:
            false_tracks = free[r // observers_each][-config.clutter :]
            present[:, false_tracks] &= _appear(rng, instants, len(false_tracks))
        if swapped is not None:
            sensing_kernels.exchange(np.float32(SWAP_RANGE), swapped, alive[r], position[r, first::k, :uavs], present)
        row &= present
    seen_tracks = [np.empty((observers, length, 3 * uavs), np.float32) for length in (instants, instants - 1)]
    true_tracks = [np.ascontiguousarray(track).reshape(*track.shape[:2], -1) for track in (position, velocity)]
    if reach is None:
        observer_position, reach = np.zeros((observers, 1, 3)), np.full(observers, np.inf)
    limits = observer_position, reach
    sensing_kernels.observe(first, k, sensors, noisy, noise, differs, *limits, *true_tracks, seen, *seen_tracks)
    seen_position, seen_velocity = (track.reshape(observers, -1, uavs, 3) for track in seen_tracks)
    return ObservationBatch(seen_position, seen_velocity, seen, alive)


def _has_faults(sensor: SwarmConfig) -> bool:
    """Whether the sensor shows anything but the truth."""
    hides = sensor.miss_rate > 0 or sensor.partial_tracks > 0 or sensor.clutter > 0
    return hides or sensor.position_noise > 0 or sensor.swap_rate > 0


def shift_tracks(position: Singles, velocity: Singles, source: Indices, rngs: Generators) -> tuple[Singles, Singles]:
    """Roll the steps of each UAV's track in time by a shift of its own; the track begins where it did.

    The shifts of m UAVs with the same source are T / m steps apart, in random order.
    """
    steps = velocity.shape[1]
    shift = np.empty(source.shape, np.int64)
    for b, rng in enumerate(rngs):
        for root in np.unique(source[b]):
            members = np.flatnonzero(source[b] == root)
            shift[b, members] = (rng.permutation(len(members)) + rng.random()) / len(members) * steps
    instants = (np.arange(steps)[:, None] - shift[:, None]) % steps
    velocity = np.take_along_axis(velocity, instants[..., None], axis=1)
    return np.cumsum(np.concatenate([position[:, :1], velocity], axis=1), axis=1, dtype=np.float32), velocity


def _detect(uniform: Singles, rate: float, burst: float) -> Mask:
    """Which UAVs are detected, ``(T_ob + 1, N)``, from uniform numbers of this shape."""
    detected = uniform >= rate
    if burst > 0:
        sensing_kernels.miss_in_bursts(rate / (burst * (1.0 - rate)), 1.0 - 1.0 / burst, uniform, detected)
    return detected


def _appear(rng: np.random.Generator, instants: int, tracks: int) -> Mask:
    """Which instants false tracks cover, ``(T_ob + 1, tracks)``: one part of the window each."""
    length = np.maximum(2, np.ceil(rng.uniform(0.1, 0.6, tracks) * instants))
    begin = np.floor(rng.random(tracks) * (instants - length + 1))
    time = np.arange(instants)[:, None]
    return np.asarray((time >= begin) & (time < begin + length))
