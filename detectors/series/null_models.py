"""Null models: what a UAV's own past says about its next velocity. The head of a follower must predict it better."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from detectors.series.designs import RealT, stack_past
from detectors.series.regressions import RIDGE, subtract_projection, whiten


def compute_innovations(values: NDArray[RealT], lags: int, ridge: float = RIDGE) -> NDArray[RealT]:
    """Residuals ``(T - lags, n, d)`` of a ridge regression of each UAV's ``values`` ``(T, n, d)`` on its own past.

    The values are centred, and 0 where unseen; for ``ridge`` see :func:`detectors.series.regressions.whiten`.
    """
    past = stack_past(values, lags)
    white, _ = whiten(past.reshape(*past.shape[:2], lags * values.shape[2]), ridge)
    return subtract_projection(white, values[lags:].transpose(1, 0, 2)).transpose(1, 0, 2)


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
