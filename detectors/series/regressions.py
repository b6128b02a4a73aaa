"""Regressions over all ordered pairs of UAVs by matrix products.

Entry (i, j) of a result relates UAV i's present to UAV j's past.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from usnet_env.arrays import Floats
from usnet_env.series import LEAST_MOTION, RealT, scale_to_unit

RIDGE = 1e-3  # in units of the mean squared singular value of the features
_LEAST_RIDGE = 1e-9  # with |v| = 1 the squares and the intercept are linearly dependent
_CHUNK_ENTRIES = 1_000_000  # entries of the whitened products in memory at a time: 4 MB for any N
_CHUNK_PAIRS = 4096


def whiten(features: NDArray[RealT], ridge: float = RIDGE, fitted: bool = False) -> tuple[NDArray[RealT], Floats]:
    """Whiten the columns of features, so that one matrix product gives what a ridge regression on them explains.

    With X = U S Vᵀ, λ the ``ridge`` times the mean of s², and d = s² / (s² + λ), a ridge regression of y on X has the
    fit ŷ = U d Uᵀ y. Then Q = U √d, |Qᵀ y|² = yᵀ ŷ. With ``fitted``, Q = U √(d (2 - d)), |Qᵀ y|² = |y|² - |y - ŷ|².

    Returns:
        Q of the shape and type of ``features`` ``(n, R, p)``, 0 for a UAV without motion; and ``(n,)``, the sums of d,
        the degrees of freedom of the fits.
    """
    values = features.astype(np.float64, copy=False)  # a Gram matrix has the square of the features' condition number
    gram = values.transpose(0, 2, 1) @ values
    width = gram.shape[1]
    diagonal = np.arange(width)
    power = np.trace(gram, axis1=1, axis2=2) / width
    penalty = np.where(power > LEAST_MOTION, max(ridge, _LEAST_RIDGE) * power, 1.0)
    gram[:, diagonal, diagonal] += penalty[:, None]
    root = np.linalg.inv(np.linalg.cholesky(gram))
    freedom = width - penalty * (root**2).sum(axis=(1, 2))
    transform = root.transpose(0, 2, 1)
    if fitted:
        gram[:, diagonal, diagonal] += penalty[:, None]
        transform = transform @ (root @ np.linalg.cholesky(gram))
    return np.asarray(values @ transform, features.dtype), freedom


def explain_pairs(
    features: NDArray[np.floating], targets: Sequence[NDArray[np.floating]], ridge: float = RIDGE
) -> tuple[Floats, Floats]:
    """Compute the share of every target, centred ``(R, v, d)``, that each UAV's ``features`` ``(n, R, p)`` explain.

    The shares are R² of regressions with the ``ridge`` of :func:`whiten`. Products are in single precision.

    Returns:
        Shares ``(len(targets), v, n)`` from 0 to 1, entry (s, i, j) for target i and the features of j: 0 for UAVs
        without motion; and the degrees of freedom ``(n,)``.
    """
    uavs, rows, width = features.shape
    voters, axes = targets[0].shape[1:]
    # The axis is the slow index, so that the sums over features and axes below run along contiguous memory.
    flat = [
        np.ascontiguousarray(scale_to_unit(target).transpose(0, 2, 1).reshape(rows, -1), np.float32)
        for target in targets
    ]
    shares = np.zeros((len(targets), voters, uavs))
    freedom = np.zeros(uavs)
    chunk = max(1, _CHUNK_ENTRIES // max(1, width * voters * axes))
    for start in range(0, uavs, chunk):
        sources = slice(start, start + chunk)
        white, freedom[sources] = whiten(features[sources], ridge, fitted=True)
        stacked = white.transpose(0, 2, 1).reshape(-1, rows).astype(np.float32)
        for share, target in zip(shares, flat, strict=True):
            product = stacked @ target
            np.square(product, out=product)
            share[:, sources] = product.reshape(len(white), width * axes, voters).sum(axis=1).T
    return np.clip(shares, 0.0, 1.0), freedom


def explain_beyond_own_past(target: Floats, own_past: Floats, other_past: Floats) -> Floats:
    """The share ``(n, n)`` of what a regression on i's own past leaves of i that j's past explains.

    Let r be the residual of the regression on i's own past, and F the part of j's features that is orthogonal to i's
    own past. By the Frisch-Waugh theorem, adding j's features explains r' F (F' F)^-1 F' r more. With whitened
    features Q_j (``other_past`` ``(n, R, p)``) and Q_i (``own_past`` ``(n, R, q)``, q may be 0) this is
    r' Q_j (I - C C')^-1 Q_j' r with C = Q_j' Q_i. The ``target`` is ``(n, R, d)``.
    """
    uavs, _, width = other_past.shape
    residual = target - own_past @ (own_past.transpose(0, 2, 1) @ target)
    total = (residual**2).sum(axis=(1, 2))
    scale = np.where(total > LEAST_MOTION, total, np.inf)
    share = np.empty((uavs, uavs))
    step = max(1, _CHUNK_PAIRS // uavs)
    for first in range(0, uavs, step):
        rows = slice(first, first + step)
        # Entry (i, j): Q_j' r_i (p, d), and C = Q_j' Q_i (p, q).
        products = np.einsum("jtp,itd->ijpd", other_past, residual[rows], optimize=True)
        overlap = np.einsum("jtp,itq->ijpq", other_past, own_past[rows], optimize=True)
        remainder = (1.0 + 1e-6) * np.eye(width) - overlap @ overlap.swapaxes(-1, -2)
        share[rows] = (products * np.linalg.solve(remainder, products)).sum(axis=(2, 3)) / scale[rows, None]
    return np.clip(share, 0.0, 1.0)
