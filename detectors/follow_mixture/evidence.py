"""First evidence, before any strategy is known: what j's past explains of i's surprises, for all pairs at once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from detectors.follow_mixture.samples import Samples

__all__ = ["KINDS", "FeatureKind", "affordable_kinds", "pairwise_gain", "whitened"]

Floats = NDArray[np.float64]

_RIDGE = 1e-3
_ROWS_PER_FEATURE = 2.5
_CHUNK_ENTRIES = 1_000_000


@dataclass(frozen=True)
class FeatureKind:
    """Which features of a past are tried together: ``lags`` velocities and, where ``squares``, their squares.

    Args:
        lags: how many lags.
        linear: the velocities themselves.
        squares: their axis-wise squares.
        first: the newest lag that is used, from 0.
    """

    lags: int
    linear: bool = True
    squares: bool = False
    first: int = 0

    @property
    def width(self) -> int:
        """How many features."""
        return 3 * self.lags * (int(self.linear) + int(self.squares))


#: From rich to poor: rich features name the followers of any strategy in reach, poor ones serve short windows.
KINDS = (
    FeatureKind(4, True, True),
    FeatureKind(2, True, False),
    FeatureKind(2, False, True),
    FeatureKind(2, True, True),
    FeatureKind(1, True, False),
    FeatureKind(1, False, True),
    FeatureKind(1, True, False, first=1),
)


def affordable_kinds(rows: int, memory: int) -> list[FeatureKind]:
    """The kinds that a window of that many rows can feed, the richest first; never empty."""
    kinds = [kind for kind in KINDS if kind.first + kind.lags <= memory and rows >= _ROWS_PER_FEATURE * kind.width]
    return kinds or [FeatureKind(1, True, False)]


def _features(samples: Samples, kind: FeatureKind, uavs: slice) -> Floats:
    """``(n, R, p)`` of some UAVs, centred features, 0 where unseen."""
    part = slice(kind.first, kind.first + kind.lags)
    past = samples.lagged[uavs, :, part]
    seen = samples.lag_seen[uavs, :, part, None]
    values = [past] if kind.linear else []
    if kind.squares:
        values.append(past * past)
    stacked = np.concatenate(values, axis=3)
    if samples.complete:
        stacked = stacked - stacked.mean(axis=1, keepdims=True)
    else:
        weight = np.broadcast_to(seen, stacked.shape)
        mean = (stacked * weight).sum(axis=1, keepdims=True) / np.maximum(weight.sum(axis=1, keepdims=True), 1)
        stacked = (stacked - mean) * weight
    return stacked.reshape(len(stacked), samples.rows, -1)


def pairwise_gain(
    samples: Samples,
    surprise: Floats,
    kind: FeatureKind,
    shifts: tuple[int, ...] = (0,),
    voters: NDArray[np.int64] | None = None,
) -> Floats:
    """Log-likelihood that j's features add to i's own history, for all pairs, by matrix products.

    With features of j whitened once (X = Q R), the share of i's surprise they explain is |Q' y|²/|y|², for all targets
    in one product. Against the exact conditional regression it leaves out what j's features share with i's own past,
    which can only lower the gain.

    Args:
        samples: n UAVs.
        surprise: ``(n, R, 3)`` what the null leaves of each target.
        kind: which features.
        shifts: targets are moved circularly by so many rows; shifts other than 0 are surrogates.
        voters: ``(v,)`` the UAVs that are asked; all by default.

    Returns:
        ``(len(shifts), v, n)``, entry (s, i, j); 0 where a UAV meets itself.
    """
    rows = samples.rows
    voters = np.arange(samples.uavs) if voters is None else voters
    surprise = surprise[voters]
    uavs = len(voters)
    total = (surprise**2).sum(axis=(1, 2))
    scaled = surprise / np.sqrt(np.where(total > 1e-12, total, np.inf))[:, None, None]
    axis_major = scaled.transpose(1, 2, 0).astype(np.float32)  # (R, 3, n)
    targets = [np.ascontiguousarray(np.roll(axis_major, shift, axis=0).reshape(rows, -1)) for shift in shifts]
    width = kind.width
    share = np.zeros((len(shifts), uavs, samples.uavs))
    step = max(1, _CHUNK_ENTRIES // (width * uavs * 3))
    for first in range(0, samples.uavs, step):
        part = slice(first, first + step)
        white = whitened(_features(samples, kind, part))
        stacked = white.transpose(0, 2, 1).reshape(-1, rows).astype(np.float32)
        for index, target in enumerate(targets):
            product = stacked @ target
            np.square(product, out=product)
            share[index, :, part] = product.reshape(len(white), width, 3, uavs).sum(axis=(1, 2)).T
    gain = -rows * np.log1p(-np.clip(share, 0.0, 1.0 - 1e-6))  # two free dimensions a row, half a logarithm each
    gain[:, np.arange(uavs), voters] = 0.0
    return gain


def whitened(features: Floats, ridge: float = _RIDGE) -> Floats:
    """Orthonormal columns that span those of each ``(R, p)`` block, but for a little ridge."""
    gram = features.transpose(0, 2, 1) @ features
    width = gram.shape[1]
    power = np.trace(gram, axis1=1, axis2=2) / width
    gram += (ridge * power + 1e-9)[:, None, None] * np.eye(width)
    inverse = np.linalg.inv(np.linalg.cholesky(gram))
    return features @ inverse.transpose(0, 2, 1)
