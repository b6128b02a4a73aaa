"""Pairwise Granger causality: does j's past improve the prediction of i from i's own past? (Granger, 1969)."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from detectors.lagged.selection import Evidence, Floats, LaggedArguments, LaggedDetector, centre_columns

__all__ = ["Granger", "granger_evidence"]

_RIDGE = 1e-3
_LEAST_ROWS_PER_FEATURE = 2.5
_CHUNK_PAIRS = 4096


class _Arguments(LaggedArguments):
    lags: Annotated[int, Field(ge=1, le=1000)]
    own_lags: Annotated[int, Field(ge=0, le=1000)]


class Granger(LaggedDetector):
    """Votes for heads by pairwise Granger causality.

    For every ordered pair (i, j), v_i(t+1) is regressed on i's own last velocities, and then on these and j's last
    velocities. The evidence is the share of the first residual's variance that the second regression explains, adjusted
    for the number of parameters. Votes and heads follow from it by :mod:`detectors.lagged.selection`.

    Args:
        clusters: M at the start of the episode, or ``None``; as in :class:`detectors.lagged.LaggedRegression`.
        lags: the number of past velocities of j, at least 1; fewer in short windows.
        own_lags: the number of past velocities of i, at least 0.

    Raises:
        ArgumentError: from :meth:`reset` and :meth:`detect`, if an argument is refused.
    """

    def __init__(self, clusters: int | None = None, lags: int = 3, own_lags: int = 2) -> None:
        self.clusters = clusters
        self.lags = lags
        self.own_lags = own_lags

    def check_arguments(self) -> _Arguments:
        """Return the checked arguments; raises ``ArgumentError``."""
        return _Arguments(clusters=self.clusters, lags=self.lags, own_lags=self.own_lags)

    def evidence(self, velocity: NDArray[np.floating], seen: NDArray[np.bool_]) -> Evidence | None:
        """Compute the Granger causality of every pair, see :func:`granger_evidence`."""
        return granger_evidence(velocity, seen, self.lags, self.own_lags)


def granger_evidence(
    velocity: NDArray[np.floating], seen: NDArray[np.bool_], lags: int, own_lags: int
) -> Evidence | None:
    """Compute the adjusted share of i's residual that j's past explains, for every pair and for the surrogate.

    Let r be the residual of the regression on i's own past, and F the part of j's features that is orthogonal to i's
    own past. By the Frisch-Waugh theorem, adding j's features explains r' F (F' F)^-1 F' r more. With whitened
    features Q_j and Q_i this is r' Q_j (I - C C')^-1 Q_j' r with C = Q_j' Q_i, a small linear system per pair.

    Args:
        velocity: ``(T_ob, n, 3)``, metres per step.
        seen: ``(T_ob, n)`` bool; an unseen feature is replaced by its mean, an unseen target is left out.
        lags: the number of past velocities of j.
        own_lags: the number of past velocities of i.

    Returns:
        The evidence; ``None`` for fewer than 2 UAVs or too short a window.
    """
    steps, uavs = velocity.shape[:2]
    lags = min(lags, max(1, int(steps / (1 + 3 * _LEAST_ROWS_PER_FEATURE))))
    own_lags = min(own_lags, lags)
    rows = steps - lags
    if uavs < 2 or rows < 6:
        return None
    flight = velocity.astype(np.float64)
    target = centre_columns(flight[lags:], seen[lags:]).transpose(1, 0, 2)
    past = np.concatenate(
        [
            centre_columns(flight[lags - lag : steps - lag], seen[lags - lag : steps - lag])
            for lag in range(1, lags + 1)
        ],
        axis=2,
    ).transpose(1, 0, 2)
    theirs = _orthonormalise_columns(past)
    own = _orthonormalise_columns(past[:, :, : 3 * own_lags]) if own_lags else np.zeros((uavs, rows, 0))
    pairs, surrogate = (
        _compute_conditional_share(np.roll(target, shift, axis=1), np.roll(own, shift, axis=1), theirs)
        for shift in (0, rows // 2)
    )
    freedom = 3 * lags
    pairs, surrogate = (
        1.0 - (1.0 - share) * (rows - 1) / max(rows - 1 - freedom - 3 * own_lags, 1) for share in (pairs, surrogate)
    )
    np.fill_diagonal(pairs, -np.inf)
    np.fill_diagonal(surrogate, -np.inf)
    return Evidence(pairs, surrogate, float(np.sqrt(2.0 * freedom / 3.0) / rows))


def _orthonormalise_columns(features: Floats) -> Floats:
    """Orthonormalise the columns of each ``(rows, p)`` block, up to a small ridge."""
    gram = features.transpose(0, 2, 1) @ features
    width = gram.shape[1]
    power = np.trace(gram, axis1=1, axis2=2) / width
    gram += (_RIDGE * power + 1e-9)[:, None, None] * np.eye(width)
    return features @ np.linalg.inv(np.linalg.cholesky(gram)).transpose(0, 2, 1)


def _compute_conditional_share(target: Floats, own: Floats, theirs: Floats) -> Floats:
    """``(n, n)``: the share of the residual of a regression on ``own`` that ``theirs`` explains."""
    uavs, _, width = theirs.shape
    residual = target - own @ (own.transpose(0, 2, 1) @ target)
    total = (residual**2).sum(axis=(1, 2))
    scale = np.where(total > 1e-12, total, np.inf)
    share = np.empty((uavs, uavs))
    step = max(1, _CHUNK_PAIRS // uavs)
    for first in range(0, uavs, step):
        some = slice(first, first + step)
        # Entry (i, j): Q_j' r_i (p, 3), and C = Q_j' Q_i (p, q).
        onto = np.einsum("jtp,itd->ijpd", theirs, residual[some], optimize=True)
        shared = np.einsum("jtp,itq->ijpq", theirs, own[some], optimize=True)
        left = (1.0 + 1e-6) * np.eye(width) - shared @ shared.swapaxes(-1, -2)
        share[some] = (onto * np.linalg.solve(left, onto)).sum(axis=(2, 3)) / scale[some, None]
    return np.clip(share, 0.0, 1.0)
