"""The null model: what a UAV's own past says about its next velocity. The head of a follower must predict it better."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from detectors.series.designs import RealT


def predict_from_own_past(
    past: NDArray[RealT], target: NDArray[RealT], weight: NDArray[RealT], penalty: float, gap: int, folds: int = 8
) -> NDArray[RealT]:
    """Predict each UAV from its own past by a cross-fitted ridge regression.

    Each fold of consecutive rows is predicted by a fit to the others, without the ``gap`` rows next to it. ``past`` is
    ``(..., R, p)``, with a column of ones for the mean, ``target`` and prediction are ``(..., R, d)``, ``weight``
    ``(..., R)`` is 1 where the target was seen, and ``penalty`` is added to the diagonal of the Gram matrix.
    """
    rows = past.shape[-2]
    index = np.arange(rows)
    fold = index * folds // rows
    weighted = past * weight[..., None]
    eye = (penalty * np.eye(past.shape[-1])).astype(past.dtype)
    prediction = np.zeros_like(target)
    for k in np.unique(fold):
        inside = np.flatnonzero(fold == k)
        outside = (index < inside[0] - gap) | (index > inside[-1] + gap)
        left = weighted[..., outside, :].swapaxes(-1, -2)
        weights = np.linalg.solve(left @ past[..., outside, :] + eye, left @ target[..., outside, :])
        prediction[..., inside, :] = past[..., inside, :] @ weights
    return prediction
