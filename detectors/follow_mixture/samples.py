"""Converts a window to the samples of a regression: the velocity of each UAV at t, and its past before t."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import gcd
from typing import Any

import numpy as np
from numpy.typing import NDArray

from usnet_env.window import Window

__all__ = ["Samples", "filled", "samples_of", "stride"]

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

_EACH = ("target", "seen", "lagged", "lag_seen", "position", "position_seen")  # arrays with one row per UAV
# Speeds count as equal if their standard deviation is below this share of the velocities' scatter about their mean: the
# speeds of a swarm that drifts fast as a whole hardly differ either.
_UNIT_SPREAD = 0.02
_ROUNDING = 1e-5  # of the speed; speeds that differ less are equal in single precision
_DRIFT = 3.0  # a mean velocity of more than this many times the scatter is a drift of the swarm and taken off


@dataclass(frozen=True, eq=False)
class Samples:
    """R rows of n UAVs; row r is time t = ``memory`` + r of the window.

    Args:
        target: ``(n, R, 3)`` velocity at t, in units of the swarm's mean speed, without a common drift; 0 where not
            seen.
        seen: ``(n, R)`` bool, the target was seen.
        lagged: ``(n, R, L, 3)`` velocities at t - 1, ..., t - L, newest first; 0 where not seen.
        lag_seen: ``(n, R, L)`` bool.
        position: ``(n, R, 3)`` metres, at the instant t - 1, where the velocity of lag 1 begins.
        position_seen: ``(n, R)`` bool.
        speed: mean speed without the drift, metres per step.
        unit: every UAV flies at the same constant speed: velocities are directions.
        drift: ``(3,)`` metres per step, the velocity of the whole swarm that was taken off.
    """

    target: Floats
    seen: Mask
    lagged: Floats
    lag_seen: Mask
    position: Floats
    position_seen: Mask
    speed: float
    unit: bool
    drift: Floats

    @property
    def uavs(self) -> int:
        """Number of UAVs."""
        return int(self.target.shape[0])

    @property
    def rows(self) -> int:
        """R."""
        return int(self.target.shape[1])

    @property
    def memory(self) -> int:
        """L."""
        return int(self.lagged.shape[2])

    @property
    def complete(self) -> bool:
        """Whether no sample is missing."""
        return bool(self.seen.all() and self.lag_seen.all())

    def take(self, uavs: NDArray[np.int64]) -> Samples:
        """The samples of some of the UAVs."""
        some: dict[str, Any] = {name: getattr(self, name)[uavs] for name in _EACH}
        return replace(self, **some)

    def beside(self, others: Samples) -> Samples:
        """The samples of these UAVs, then of the others."""
        both: dict[str, Any] = {name: np.concatenate([getattr(self, name), getattr(others, name)]) for name in _EACH}
        return replace(self, **both)

    def moved(self, shift: int) -> Samples:
        """The samples with all pasts shifted circularly by ``shift`` rows."""
        return replace(self, lagged=np.roll(self.lagged, shift, axis=1), lag_seen=np.roll(self.lag_seen, shift, axis=1))


def samples_of(window: Window, living: NDArray[np.int64], memory: int, like: Samples | None = None) -> Samples | None:
    """Make the samples of the living UAVs.

    Args:
        window: the window.
        living: ``(n,)`` indices of the living UAVs.
        memory: L, smaller if the window has fewer than L + 4 velocities.
        like: samples of the same swarm from which ``unit`` and ``drift`` are taken.

    Returns:
        ``None`` for fewer than 2 UAVs, fewer than 5 velocities, or if no UAV moves.
    """
    steps = window.observation_steps
    memory = min(memory, steps - 4)
    if len(living) < 2 or memory < 1:
        return None
    velocity = np.ascontiguousarray(window.velocity[:, living].swapaxes(0, 1), np.float64)
    seen = np.ascontiguousarray(window.velocity_seen[:, living].T)
    speeds = np.sqrt(np.vecdot(velocity, velocity))
    if not seen.any():
        return None
    flown = speeds if seen.all() else speeds[seen]
    speed = float(flown.mean())
    if speed <= 0:
        return None
    drift, unit = common_drift(velocity[seen], flown) if like is None else (like.drift, like.unit)
    if drift.any():
        velocity = velocity - drift
        speed = float(np.sqrt(np.vecdot(velocity, velocity)[seen]).mean())
    velocity = np.where(seen[..., None], velocity, 0.0) / speed
    rows = steps - memory
    lags = np.arange(memory)[None, :]
    at = np.arange(rows)[:, None] + memory - 1 - lags  # (R, L): index of the velocity at lag 1, 2, ...
    return Samples(
        target=velocity[:, memory:],
        seen=seen[:, memory:],
        lagged=velocity[:, at],
        lag_seen=seen[:, at],
        position=window.position[memory - 1 : steps - 1, living].swapaxes(0, 1).astype(np.float64),
        position_seen=window.seen[memory - 1 : steps - 1, living].T.copy(),
        speed=speed,
        unit=unit,
        drift=drift,
    )


def common_drift(velocity: Floats, speeds: Floats) -> tuple[Floats, bool]:
    """The drift of a swarm, and whether all its UAVs fly at one speed relative to it.

    Args:
        velocity: ``(k, 3)`` seen velocities.
        speeds: ``(k,)`` their lengths.

    Returns:
        ``(3,)``, 0 if the swarm flies at one speed or does not drift fast as a whole. A drift is the centre of the
        sphere of velocities of one speed, or else the mean velocity.
    """
    none, mean = np.zeros(3), velocity.mean(axis=0)
    scatter = float(np.sqrt(velocity.var(axis=0).sum()))
    if speeds.std() < max(_UNIT_SPREAD * scatter, _ROUNDING * float(speeds.mean())):
        return none, True
    if not np.sqrt(mean @ mean) > _DRIFT * scatter > 0:
        return none, False
    # On a sphere about c, |u|² = 2 (c - mean)·u + constant holds for u = v - mean: a linear regression.
    about = velocity - mean
    squares = (about**2).sum(axis=1)
    half, *_ = np.linalg.lstsq(2.0 * about, squares - squares.mean(), rcond=1e-6)
    relative = np.sqrt(((about - half) ** 2).sum(axis=1))
    unit = bool(relative.std() < _UNIT_SPREAD * scatter)
    return (mean + half if unit else mean), unit


def stride(observations: int, most: int, rows: int) -> int:
    """The step of a subsample of at most ``most`` observations that covers all rows of a window evenly.

    Observations are ordered by UAV: a step with a common factor with the number of rows would omit rows.
    """
    every = max(1, -(-observations // most))
    while gcd(every, rows) > 1:
        every += 1
    return every


def filled(window: Window) -> Window:
    """Fill in the missing samples of living UAVs by linear interpolation of the positions."""
    missed = ~window.seen & window.alive
    if not missed.any():
        return window
    position = np.array(window.position, np.float64)
    instants = np.arange(len(position))
    for uav in np.flatnonzero(missed.any(axis=0) & window.seen.any(axis=0)):
        there = window.seen[:, uav]
        for axis in range(3):
            position[~there, uav, axis] = np.interp(instants[~there], instants[there], position[there, uav, axis])
    velocity = np.where(window.velocity_seen[..., None], window.velocity, np.diff(position, axis=0))
    return Window(position.astype(np.float32), velocity, window.seen | window.alive, window.alive, window.round)
