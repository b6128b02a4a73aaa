"""Lagged regression: a follower's velocity is a function of its head's last velocities, whatever the function."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from detectors.lagged.selection import Evidence, Floats, LaggedArguments, LaggedDetector, centre_columns

__all__ = ["LaggedRegression", "pairwise_r2", "regression_evidence"]

ROWS_PER_FEATURE = 1.5  # measured: more lags beat more samples a feature, down to about here
LEAST_ROWS = 6
_CHUNK_ENTRIES = 1_000_000  # of the whitened products held at a time: 4 MB, whatever N is


class _Arguments(LaggedArguments):
    lags: Annotated[int, Field(ge=1)]
    squares: bool
    ridge: Annotated[float, Field(ge=0)]


class LaggedRegression(LaggedDetector):
    """Ridge of every UAV's velocity on every other's lagged velocities and their squares; votes by explained variance.

    For every ordered pair (i, j), v_i(t+1) is regressed on v_j(t), ..., v_j(t - lags + 1), their axis-wise squares and
    an intercept. Every UAV votes for the j with the highest adjusted R²; see :mod:`detectors.lagged.selection` for the
    weight of a vote and for the number of heads. f1 to f6 are in the reach of these features up to norm(·), f7 nearly.

    In windows with few samples the number of lags shrinks, then the squares go, so that a sample count of
    ``ROWS_PER_FEATURE`` a feature is kept. With fewer than ``LEAST_ROWS`` + 1 velocities there is no evidence at all
    and one UAV is named at random. Where samples are missing, a feature takes its mean and a target does not count.

    Args:
        clusters: M, the number of heads at the start of the episode. Round 1 names exactly as many; later rounds, when
            some may have gone, at most as many by the rule for an unknown number. ``None``: M is not known, and the
            number is found by :func:`detectors.lagged.selection.cover_voters`.
        lags: how many past velocities of j enter, at least 1.
        squares: whether their axis-wise squares enter as well; f4 and f5 can't be seen without.
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
        """The arguments, or ``ArgumentError``."""
        return _Arguments(clusters=self.clusters, lags=self.lags, squares=self.squares, ridge=self.ridge)

    def evidence(self, velocity: NDArray[np.floating], seen: NDArray[np.bool_]) -> Evidence | None:
        """Adjusted R² of every pair, see :func:`regression_evidence`."""
        return regression_evidence(velocity, seen, self.lags, self.squares, self.ridge)


def regression_evidence(
    velocity: NDArray[np.floating], seen: NDArray[np.bool_], lags: int, squares: bool, ridge: float
) -> Evidence | None:
    """Adjusted R² of every pair and of its time-shift surrogate.

    Args:
        velocity: ``(T_ob, n, 3)``, metres per step.
        seen: ``(T_ob, n)`` bool.
        lags: the most lags to use.
        squares: whether to use squares where the window is long enough.
        ridge: as in :class:`LaggedRegression`.

    Returns:
        The evidence, or ``None`` for fewer than 2 UAVs or too short a window.
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
    # The standard deviation of R² over three axes where nothing is explained and samples are independent.
    spread = float(np.sqrt(2.0 * max(freedom.mean(), 1.0) / 3.0) / rows)
    return Evidence(pairs, surrogate, spread)


def _choose_lags(steps: int, lags: int, squares: bool) -> tuple[int, bool]:
    """The most lags, and whether squares, that ``steps`` velocities allow at ``ROWS_PER_FEATURE`` samples a feature."""
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
    """R² of the ridge regression of every UAV's velocity on every UAV's past, from matrix products alone.

    With the features' singular value decomposition X_j = U S Vᵀ, the fit's R² is Σ_k (2 d_k - d_k²) (u_kᵀ y)² / ‖y‖²
    where d = s² / (s² + λ). So one whitened matrix Q_j per UAV serves all targets: R²_ij = ‖Q_jᵀ Y_i‖² / ‖Y_i‖².
    λ is ``ridge`` times the mean of s². Products are made for some j at a time: memory beyond the result is bounded.

    Args:
        velocity: ``(T, n, 3)``.
        seen: ``(T, n)`` bool; an unseen target counts as 0 after centring, and so does an unseen feature.
        lags: 1 to T - 2.
        squares: whether axis-wise squares are among the features.
        ridge: at least 0.
        shifts: by how many samples the targets are shifted (circularly) against the features.

    Returns:
        R² ``(len(shifts), n, n)``, entry (s, i, j) for target i and features of j, in [0, 1]; and ``(n,)``, the
        effective degrees of freedom of each UAV's features. A UAV that never moves, or is never seen, explains and is
        explained by 0.
    """
    past = velocity.astype(np.float64)
    steps, uavs = past.shape[:2]
    rows = steps - lags
    target = centre_columns(past[lags:], seen[lags:])
    total = (target**2).sum(axis=(0, 2))
    moving = total > 1e-12
    target /= np.sqrt(np.where(moving, total, np.inf))[:, None]
    # Targets axis by axis, so that the sums over features and axes below run along contiguous memory; in float32, as
    # R² needs no more digits and the products are nearly all of the work.
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
    """Q ``(c, rows, p)``, where ‖Qᵀy‖² is what the ridge on ``features`` (same shape) explains of y; its freedom."""
    gram = features.transpose(0, 2, 1) @ features
    squared, vectors = np.linalg.eigh(gram)
    squared = np.maximum(squared, 0.0)
    penalty = ridge * squared.mean(axis=1, keepdims=True)
    # |v| = 1 makes the squares linearly dependent with the intercept: such directions carry rounding errors alone.
    usable = squared > 1e-9 * squared[:, -1:] + 1e-12
    shrink = np.where(usable, squared / np.where(usable, squared + penalty, 1.0), 0.0)
    scale = np.sqrt(shrink * (2.0 - shrink) / np.where(usable, squared, 1.0))
    return features @ (vectors * scale[:, None, :]), shrink.sum(axis=1)
