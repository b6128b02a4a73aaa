"""What is clustered: features of every UAV, from a window.

``raw`` and ``scaled`` are the paper's one window of T_0 samples, in metres or standardised, laid out in a row;
``velocities`` is the series of the whole window. All are without holes: an unseen position is interpolated in time
between those seen (held at the ends), an unseen velocity is the UAV's own mean, and a UAV that was never seen takes the
mean of the others.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from usnet_env.config import ArgumentError
from usnet_env.window import Window, frozen_array

__all__ = ["FEATURES", "features_of", "raw", "scaled", "velocities"]

Floats = NDArray[np.float64]
#: A window's features ``(N, d)`` or, as a series in time, ``(N, T, d)``; rows of destroyed UAVs do not count.
Features = Callable[[Window], ArrayLike]


def _filled_position(window: Window) -> Floats:
    """``(T_ob + 1, N, 3)`` metres."""
    position = window.position.astype(np.float64)
    seen = window.seen & window.alive
    instants = np.arange(len(position))
    for uav in np.flatnonzero(seen.any(axis=0) & ~seen.all(axis=0)):
        at = np.flatnonzero(seen[:, uav])
        for axis in range(3):
            position[:, uav, axis] = np.interp(instants, at, position[at, uav, axis])
    return _with_unseen_uavs(position, seen)


def _filled_velocity(window: Window) -> Floats:
    """``(T_ob, N, 3)`` metres per step."""
    seen = window.velocity_seen[..., None]
    velocity = window.velocity.astype(np.float64) * seen
    mean = velocity.sum(axis=0) / np.maximum(seen.sum(axis=0), 1)
    return _with_unseen_uavs(np.where(seen, velocity, mean), window.velocity_seen)


def _with_unseen_uavs(values: Floats, seen: NDArray[np.bool_]) -> Floats:
    """``values`` ``(T, N, 3)`` where the UAVs that were never ``seen`` ``(T, N)`` take the mean of the others."""
    known: NDArray[np.bool_] = np.asarray(seen.any(axis=0))
    if known.any():
        values[:, ~known] = values[:, known].mean(axis=1, keepdims=True)
    return values


def _last_samples(window: Window, memory: int) -> tuple[Floats, Floats]:
    """The last T_0 velocities and the positions where they start, each ``(N, T_0, 3)``."""
    position, velocity = _filled_position(window)[:-1], _filled_velocity(window)
    return position[-memory:].swapaxes(0, 1), velocity[-memory:].swapaxes(0, 1)


def _in_a_row(position: Floats, velocity: Floats) -> Floats:
    return np.concatenate([position, velocity], axis=2).reshape(len(position), -1)


def raw(window: Window, memory: int) -> Floats:
    """The paper's window: the last T_0 velocities and the positions where they start, ``(N, 6 T_0)``.

    Metres and metres per step, sample by sample; of a shorter window, all that there is.
    """
    return _in_a_row(*_last_samples(window, memory))


def scaled(window: Window, memory: int) -> Floats:
    """As :func:`raw`, with each of the six coordinates (three of position, three of velocity) standardised.

    Mean and standard deviation are over all living UAVs and samples, so that nothing within a window is distorted.
    """
    parts = []
    for values in _last_samples(window, memory):
        living = values[window.alive].reshape(-1, 3)
        if len(living) == 0:
            living = np.zeros((1, 3))
        spread = living.std(axis=0)
        parts.append((values - living.mean(axis=0)) / np.where(spread > 1e-12, spread, 1.0))
    return _in_a_row(*parts)


def velocities(window: Window, memory: int) -> Floats:
    """The series of the whole window's velocities, ``(N, T_ob, 3)`` metres per step; ``memory`` plays no part."""
    return _filled_velocity(window).swapaxes(0, 1)


#: the features that have a name
FEATURES: dict[str, Callable[[Window, int], Floats]] = {"raw": raw, "scaled": scaled, "velocities": velocities}


def features_of(features: str | Features, window: Window, memory: int) -> Floats:
    """Features of all N UAVs by name or callable; 0 for the destroyed.

    Returns:
        ``(N, d)``, or a series ``(N, T, d)``.

    Raises:
        ArgumentError: a callable gave another shape, or what is not finite.
    """
    if isinstance(features, str):
        values = FEATURES[features](window, memory)
    else:
        given = np.array(features(window), copy=True)
        if given.ndim not in (2, 3):
            raise ArgumentError(f"features must give an array (N, d) or (N, T, d), got shape {given.shape}.")
        given[~window.alive[: len(given)]] = 0
        shape = (window.uavs, *[None] * (given.ndim - 1))
        values = frozen_array("features", given, np.float64, shape).copy()
    values[~window.alive] = 0.0
    return values
