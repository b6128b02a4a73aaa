"""Converts a window to the velocities of its living UAVs: without a common drift, in units of speed, without gaps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from detectors.series.gaps import fill_gaps
from usnet_env.arrays import Floats, Indices
from usnet_env.window import Window

LEAST_STEPS = 5  # velocities; a shorter window has no past to compare with
# Speeds count as equal if their standard deviation is below this share of the velocities' scatter about their mean: the
# speeds of a swarm that drifts fast as a whole hardly differ either.
_UNIT_SPREAD = 0.02
_ROUNDING = 1e-5  # of the speed; speeds that differ less are equal in single precision
_DRIFT = 3.0  # a mean velocity of more than this many times the scatter is a drift of the swarm and taken off


@dataclass(frozen=True, eq=False)
class Motion:
    """The velocities of n UAVs at T steps.

    Args:
        velocity: ``(n, T, 3)`` in units of the mean speed, without the drift; gaps are filled.
        speed: mean speed without the drift, in metres per step.
        unit: every UAV flies at the same constant speed; then positions are seen without noise.
        drift: ``(3,)`` metres per step, the velocity of the whole swarm that was taken off.
    """

    velocity: Floats
    speed: float
    unit: bool
    drift: Floats


def read_motion(window: Window, living: Indices) -> Motion | None:
    """Read the motion of the living UAVs.

    Args:
        window: the window.
        living: ``(n,)`` indices of the living UAVs.

    Returns:
        ``None`` for fewer than 2 UAVs, fewer than :data:`LEAST_STEPS` velocities, or if no UAV is seen to move.
    """
    if len(living) < 2 or window.observation_steps < LEAST_STEPS:
        return None
    seen = window.velocity_seen[:, living]
    if not seen.any():
        return None
    found = window.velocity[:, living][seen].astype(np.float64)
    flown = np.sqrt(np.vecdot(found, found))
    if flown.mean() <= 0:
        return None
    drift, unit = common_drift(found, flown)
    velocity: Floats = window.velocity - drift
    if not seen.all():
        position = window.position - np.arange(window.observation_steps + 1)[:, None, None] * drift
        track, steps = position.astype(np.float32), velocity.astype(np.float32)
        filled = fill_gaps(Window(track, steps, window.seen, window.alive, window.round))
        velocity = filled.velocity.astype(np.float64)
    velocity = np.ascontiguousarray(velocity[:, living].swapaxes(0, 1))
    speed = float(np.sqrt(np.vecdot(velocity, velocity))[seen.T].mean())
    return Motion(velocity / speed, speed, unit, drift)


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


def lagged(velocity: Floats, lags: int) -> Floats:
    """The velocities before each step from ``lags`` on: ``(n, T - lags, lags, 3)``, newest first."""
    rows = velocity.shape[1] - lags
    return velocity[:, np.arange(rows)[:, None] + lags - 1 - np.arange(lags)[None]]
