"""Lagged regression: a follower's velocity is a function of its head's past velocities, which a regression fits."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from detectors.lagged.selection import Evidence, Floats, LaggedArguments, LaggedDetector, centre_columns

__all__ = ["LaggedRegression", "pairwise_r2", "regression_evidence"]

ROWS_PER_FEATURE = 1.5  # measured: down to this ratio, more lags help more than more samples per feature
LEAST_ROWS = 6
_CHUNK_ENTRIES = 1_000_000  # entries of the whitened products in memory at a time: 4 MB for any N


class _Arguments(LaggedArguments):
    lags: Annotated[int, Field(ge=1, le=1000)]
    squares: bool
    ridge: Annotated[float, Field(ge=0)]


class LaggedRegression(LaggedDetector):
    """Votes for heads by ridge regression of each UAV's velocity on another UAV's lagged velocities.

    For every ordered pair (i, j), v_i(t+1) is regressed on v_j(t), ..., v_j(t - lags + 1), their axis-wise squares and
    an intercept. Each UAV votes for the j with the highest adjusted R²; :mod:`detectors.lagged.selection` defines the
    weight of a vote and the number of heads. Up to the normalisation norm(·), f1 to f6 are linear in these features,
    and f7 nearly is.

    In short windows fewer lags are used, and then no squares, so that there are at least ``ROWS_PER_FEATURE`` samples
    per feature. With fewer than ``LEAST_ROWS`` + 1 velocities no regression is fitted and one UAV is named at random.
    A missing sample of a feature is replaced by its mean; a missing target is left out.

    Args:
        clusters: M, the number of heads at the start of the episode. Round 1 names exactly M UAVs. Later rounds, in
            which heads may be missing, name at most M by the rule for unknown M. ``None``: M is unknown, and
            :func:`detectors.lagged.selection.cover_voters` estimates the number of heads in every round.
        lags: the number of past velocities of j among the features, at least 1.
        squares: whether the features include axis-wise squares; f4 and f5 need them.
        ridge: the penalty, in units of the features' mean squared singular value, at least 0.

    Raises:
        ArgumentError: from :meth:`reset` and :meth:`detect`, if an argument is refused.
    """

    def __init__(self, clusters: int | None = None, lags: int = 4, squares: bool = True, ridge: float = 1e-3) -> None:
        self.clusters = clusters
        self.lags = lags
        self.squares = squares
        self.ridge = ridge

    def check_arguments(self) -> _Arguments:
        """Return the checked arguments; raises ``ArgumentError``."""
        return _Arguments(clusters=self.clusters, lags=self.lags, squares=self.squares, ridge=self.ridge)

    def evidence(self, velocity: NDArray[np.floating], seen: NDArray[np.bool_]) -> Evidence | None:
        """Compute the adjusted R² of every pair, see :func:`regression_evidence`."""
        return regression_evidence(velocity, seen, self.lags, self.squares, self.ridge)


def regression_evidence(
    velocity: NDArray[np.floating], seen: NDArray[np.bool_], lags: int, squares: bool, ridge: float
) -> Evidence | None:
    """Compute the adjusted R² of every pair, and for the time-shift surrogate.

    Args:
        velocity: ``(T_ob, n, 3)``, metres per step.
        seen: ``(T_ob, n)`` bool.
        lags: the largest number of lags.
        squares: whether to use squares if the window is long enough.
        ridge: as in :class:`LaggedRegression`.

    Returns:
        The evidence; ``None`` for fewer than 2 UAVs or too short a window.
    """
    steps, uavs = velocity.shape[:2]
    lags, squares = _choose_lags(steps, lags, squares)
    rows = steps - lags
    if uavs < 2 or rows < LEAST_ROWS:
        return None
    explained, freedom = pairwise_r2(velocity, seen, lags, squares, ridge, shifts=(0, rows // 2))
    unexplained = (1.0 - explained) * (rows - 1) / np.maximum(rows - 1 - freedom, 1.0)
    pairs, surrogate = 1.0 - unexplained
    np.fill_diagonal(pairs, -np.inf)
    np.fill_diagonal(surrogate, -np.inf)
    # The standard deviation of R² over three axes for independent samples of which nothing is explained.
    spread = float(np.sqrt(2.0 * max(freedom.mean(), 1.0) / 3.0) / rows)
    return Evidence(pairs, surrogate, spread)


def _choose_lags(steps: int, lags: int, squares: bool) -> tuple[int, bool]:
    """Largest number of lags, and whether to use squares, with ``ROWS_PER_FEATURE`` samples per feature."""
    for with_squares in (True, False) if squares else (False,):
        for fewer in range(lags, 0, -1):
            if steps - fewer >= ROWS_PER_FEATURE * (6 if with_squares else 3) * fewer:
                return fewer, with_squares
    return 1, False


def pairwise_r2(
    velocity: NDArray[np.floating],
    seen: NDArray[np.bool_],
    lags: int,
    squares: bool,
    ridge: float,
    shifts: tuple[int, ...] = (0,),
) -> tuple[Floats, Floats]:
    """Compute R² of the ridge regression of every UAV's velocity on every UAV's past by matrix products.

    With the features' singular value decomposition X_j = U S Vᵀ, the fit's R² is Σ_k (2 d_k - d_k²) (u_kᵀ y)² / ‖y‖²
    with d = s² / (s² + λ). So one whitened matrix Q_j per UAV serves all targets: R²_ij = ‖Q_jᵀ Y_i‖² / ‖Y_i‖².
    λ is ``ridge`` times the mean of s². The products are computed for a few j at a time to bound the memory.

    Args:
        velocity: ``(T, n, 3)``.
        seen: ``(T, n)`` bool; unseen targets and features are 0 after centring.
        lags: 1 to T - 2.
        squares: whether axis-wise squares are among the features.
        ridge: at least 0.
        shifts: the circular shifts of the targets against the features, in samples.

    Returns:
        R² ``(len(shifts), n, n)``, entry (s, i, j) for target i and features of j, in [0, 1]; and ``(n,)``, the
        effective degrees of freedom of each UAV's features. R² is 0 in the row and the column of a UAV that never
        moves or is never seen.
    """
    past = velocity.astype(np.float64)
    steps, uavs = past.shape[:2]
    rows = steps - lags
    target = centre_columns(past[lags:], seen[lags:])
    total = (target**2).sum(axis=(0, 2))
    moving = total > 1e-12
    target /= np.sqrt(np.where(moving, total, np.inf))[:, None]
    # The axis is the slow index, so that the sums over features and axes below run along contiguous memory. float32 is
    # precise enough for R², and the products take nearly all of the time.
    axis_major = target.transpose(0, 2, 1).astype(np.float32)
    targets = [np.ascontiguousarray(np.roll(axis_major, shift, axis=0).reshape(rows, -1)) for shift in shifts]
    if squares:
        past = np.concatenate([past, past**2], axis=2)
    features = past.shape[2] * lags
    result = np.zeros((len(shifts), uavs, uavs))
    freedom = np.zeros(uavs)
    chunk = max(1, _CHUNK_ENTRIES // (features * uavs * 3))
    for start in range(0, uavs, chunk):
        part = slice(start, start + chunk)
        lagged = [
            centre_columns(past[lags - lag : steps - lag, part], seen[lags - lag : steps - lag, part])
            for lag in range(1, lags + 1)
        ]
        whitened, freedom[part] = _whiten_features(np.concatenate(lagged, axis=2).transpose(1, 0, 2), ridge)
        here = len(whitened)
        stacked = whitened.transpose(0, 2, 1).reshape(here * features, rows).astype(np.float32)
        for index, shifted in enumerate(targets):
            product = stacked @ shifted
            np.square(product, out=product)
            explained = product.reshape(here, features, 3 * uavs).sum(axis=1).reshape(here, 3, uavs).sum(axis=1)
            result[index, :, part] = explained.T
    return np.clip(result, 0.0, 1.0), freedom


def _whiten_features(features: Floats, ridge: float) -> tuple[Floats, Floats]:
    """Q ``(c, rows, p)`` such that a ridge on ``features`` explains ‖Qᵀy‖² of y, and its degrees of freedom."""
    gram = features.transpose(0, 2, 1) @ features
    squared, vectors = np.linalg.eigh(gram)
    squared = np.maximum(squared, 0.0)
    penalty = ridge * squared.mean(axis=1, keepdims=True)
    # With |v| = 1 the squares and the intercept are linearly dependent; such directions hold rounding errors only.
    usable = squared > 1e-9 * squared[:, -1:] + 1e-12
    shrink = np.where(usable, squared / np.where(usable, squared + penalty, 1.0), 0.0)
    scale = np.sqrt(shrink * (2.0 - shrink) / np.where(usable, squared, 1.0))
    return features @ (vectors * scale[:, None, :]), shrink.sum(axis=1)
