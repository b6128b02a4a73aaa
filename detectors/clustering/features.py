"""Features of every UAV, computed from a window: the input of the clusterers.

``"raw"`` and ``"scaled"`` are the paper's window of T_0 samples as one row per UAV, in metres or standardised.
``"velocities"`` is the time series of the whole window. Missing samples are filled in by
:func:`detectors.series.gaps.fill_gaps`.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from detectors.series.gaps import fill_gaps
from usnet_env.arrays import Floats
from usnet_env.config import ArgumentError, quote
from usnet_env.window import Window, frozen_array

#: A function from a window to features ``(N, d)`` or a time series ``(N, T, d)``; rows of destroyed UAVs are ignored.
Features = Callable[[Window], ArrayLike]


def compute_raw_features(window: Window, memory: int) -> Floats:
    """Return the paper's window: the last T_0 velocities and the positions where they start, ``(N, 6 T_0)``.

    Metres and metres per step, sample by sample: x, y, z of the position, then of the velocity. T_0, the ``memory``, is
    lowered to T_ob.
    """
    whole = fill_gaps(window)
    samples = np.concatenate([whole.position[:-1][-memory:], whole.velocity[-memory:]], axis=2, dtype=np.float64)
    return samples.swapaxes(0, 1).reshape(window.uavs, -1)


def compute_scaled_features(window: Window, memory: int) -> Floats:
    """Return :func:`compute_raw_features` with each of the six coordinates standardised, ``(N, 6 T_0)``.

    The mean and the standard deviation of a coordinate are over all living UAVs and all T_0 samples.
    """
    samples = compute_raw_features(window, memory).reshape(window.uavs, -1, 6)
    living = samples[window.alive].reshape(-1, 6)
    spread = living.std(axis=0)
    return ((samples - living.mean(axis=0)) / np.where(spread > 1e-12, spread, 1.0)).reshape(window.uavs, -1)


def collect_velocity_series(window: Window, memory: int) -> Floats:
    """Return the velocities of the whole window, ``(N, T_ob, 3)`` in metres per step; ``memory`` is not used."""
    return fill_gaps(window).velocity.swapaxes(0, 1).astype(np.float64)


#: The built-in features by name.
FEATURES: dict[str, Callable[[Window, int], Floats]] = {
    "raw": compute_raw_features,
    "scaled": compute_scaled_features,
    "velocities": collect_velocity_series,
}


def compute_features(features: str | Features, window: Window, memory: int) -> Floats:
    """Compute the features of all N UAVs by a name or a callable.

    Args:
        features: a name of :data:`FEATURES`, or a callable from a window to features.
        window: the observer's window.
        memory: T_0 of ``"raw"`` and ``"scaled"``, in samples.

    Returns:
        ``(N, d)``, or a time series ``(N, T, d)``; 0 for destroyed UAVs.

    Raises:
        ArgumentError: a callable does not take a window, or returned another shape, or values that are not finite.
    """
    if isinstance(features, str):
        values = FEATURES[features](window, memory)
    else:
        try:
            given = np.array(features(window), copy=True)
        except (TypeError, ValueError) as error:
            raise ArgumentError(
                f"features must return an array of a window, got {quote(features)}, which raised "
                f"{type(error).__name__}: {quote(str(error))}."
            ) from error
        if given.ndim not in (2, 3):
            raise ArgumentError(f"features must return an array of shape (N, d) or (N, T, d), got shape {given.shape}.")
        given[~window.alive[: len(given)]] = 0
        shape = (window.uavs, *[None] * (given.ndim - 1))
        values = frozen_array("features", given, np.float64, shape).copy()
    values[~window.alive] = 0.0
    return values
