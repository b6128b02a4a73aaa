"""Pairwise screening before a strategy is known: the share of i's innovations that j's past explains, for all pairs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from detectors.follow_mixture.samples import Samples

__all__ = ["KINDS", "FeatureKind", "affordable_kinds", "gain_and_chance", "pairwise_gain", "whitened"]

Floats = NDArray[np.float64]
RealT = TypeVar("RealT", np.float32, np.float64)

_RIDGE = 1e-3
_ROWS_PER_FEATURE = 2.5
_CHUNK_ENTRIES = 1_000_000
_CHANCE_VOTERS = 30


@dataclass(frozen=True)
class FeatureKind:
    """A set of features of a past.

    Args:
        lags: the number of lags.
        linear: whether to use the velocities.
        squares: whether to use their axis-wise squares.
        first: the newest lag, from 0.
    """

    lags: int
    linear: bool = True
    squares: bool = False
    first: int = 0

    @property
    def width(self) -> int:
        """Number of features."""
        return 3 * self.lags * (int(self.linear) + int(self.squares))

    @property
    def name(self) -> str:
        """Name of the features in reports."""
        parts = [name for name in ("linear", "squares") if getattr(self, name)]
        return f"{'+'.join(parts)}({self.first + self.lags})"


#: From rich to poor: rich features cover more strategies, poor ones suit short windows.
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
    """The feature sets that a window with this many rows allows, the richest first; never empty."""
    kinds = [kind for kind in KINDS if kind.first + kind.lags <= memory and rows >= _ROWS_PER_FEATURE * kind.width]
    return kinds or [FeatureKind(1, True, False)]


def _features(samples: Samples, kind: FeatureKind, uavs: slice) -> NDArray[np.float32]:
    """``(n, R, p)``: centred features of some UAVs, 0 where unseen; single precision is enough for screening."""
    part = slice(kind.first, kind.first + kind.lags)
    past = samples.lagged[uavs, :, part].reshape(-1, samples.rows, 3 * kind.lags).astype(np.float32)
    stacked = np.concatenate([past] * kind.linear + [past * past] * kind.squares, axis=2)
    if samples.complete:
        stacked -= stacked.mean(axis=1, keepdims=True)
        return stacked
    times = int(kind.linear) + int(kind.squares)
    seen = np.tile(np.repeat(samples.lag_seen[uavs, :, part], 3, axis=2), (1, 1, times)).astype(np.float32)
    mean = (stacked * seen).sum(axis=1, keepdims=True) / np.maximum(seen.sum(axis=1, keepdims=True), 1)
    return np.asarray((stacked - mean) * seen, np.float32)


def pairwise_gain(
    samples: Samples,
    surprise: Floats,
    kind: FeatureKind,
    shift: int = 0,
    voters: NDArray[np.int64] | None = None,
    columns: NDArray[np.int64] | None = None,
) -> Floats:
    """Log-likelihood that j's features add to i's own past, for all pairs, by matrix products.

    With whitened features Q of j (X = Q R), the explained share of i's innovations y is |Q' y|²/|y|², computed for all
    targets in one product. Unlike the exact conditional regression, this ignores what j's features share with i's own
    past, which can only lower the gain.

    Args:
        samples: samples of n UAVs.
        surprise: ``(n, R, 3)``, the innovations: the residuals of the null model.
        kind: the features.
        shift: circular shift of the targets in rows; surrogates have a shift other than 0.
        voters: ``(v,)``, the UAVs i; all by default.
        columns: ``(c,)``, the UAVs j; all by default.

    Returns:
        ``(v, c)``; 0 for a UAV with itself.
    """
    voters = np.arange(samples.uavs) if voters is None else voters
    return _gains(samples, kind, [(voters, _targets(surprise[voters], shift))], columns)[0]


def gain_and_chance(
    samples: Samples, surprise: Floats, kind: FeatureKind, voters: NDArray[np.int64] | None = None
) -> tuple[Floats, float]:
    """:func:`pairwise_gain`, and the median over some voters of their largest gain in time-shifted data."""
    voters = np.arange(samples.uavs) if voters is None else voters
    some = voters[:: max(1, -(-len(voters) // _CHANCE_VOTERS))]
    asked = [(voters, _targets(surprise[voters], 0)), (some, _targets(surprise[some], samples.rows // 2))]
    gain, surrogate = _gains(samples, kind, asked)
    return gain, float(np.median(surrogate.max(axis=1)))


def _targets(surprise: Floats, shift: int) -> NDArray[np.float32]:
    """``(R, 3 v)``: the innovations ``(v, R, 3)``, scaled to length 1 and shifted by ``shift`` rows."""
    total = (surprise**2).sum(axis=(1, 2))
    scaled = surprise / np.sqrt(np.where(total > 1e-12, total, np.inf))[:, None, None]
    axis_major = scaled.transpose(1, 2, 0).astype(np.float32)
    return np.ascontiguousarray(np.roll(axis_major, shift, axis=0).reshape(len(axis_major), -1))


def _gains(
    samples: Samples,
    kind: FeatureKind,
    asked: list[tuple[NDArray[np.int64], NDArray[np.float32]]],
    columns: NDArray[np.int64] | None = None,
) -> list[Floats]:
    """``(v, c)`` for each group of voters and their targets."""
    everybody = np.arange(samples.uavs) if columns is None else columns
    samples = samples if columns is None else samples.take(columns)
    rows, width = samples.rows, kind.width
    shares = [np.zeros((len(voters), samples.uavs)) for voters, _ in asked]
    step = max(1, _CHUNK_ENTRIES // (width * max(target.shape[1] for _, target in asked)))
    for first in range(0, samples.uavs, step):
        part = slice(first, first + step)
        white = whitened(_features(samples, kind, part))
        stacked = white.transpose(0, 2, 1).reshape(-1, rows)
        for share, (voters, target) in zip(shares, asked, strict=True):
            product = stacked @ target
            np.square(product, out=product)
            share[:, part] = product.reshape(len(white), 3 * width, len(voters)).sum(axis=1).T
    gains = []
    for share, (voters, _) in zip(shares, asked, strict=True):
        gain = -rows * np.log1p(-np.clip(share, 0.0, 1.0 - 1e-6))  # two free dimensions per row, half a logarithm each
        gain[voters[:, None] == everybody[None]] = 0.0
        gains.append(gain)
    return gains


def whitened(features: NDArray[RealT], ridge: float = _RIDGE) -> NDArray[RealT]:
    """Orthonormalise the columns of each ``(R, p)`` block, up to a small ridge."""
    gram = features.transpose(0, 2, 1) @ features
    width = gram.shape[1]
    power = np.trace(gram, axis1=1, axis2=2) / width
    gram += (ridge * power + 1e-9)[:, None, None] * np.eye(width, dtype=gram.dtype)
    inverse = np.linalg.inv(np.linalg.cholesky(gram))
    return np.asarray(features @ inverse.transpose(0, 2, 1), features.dtype)
