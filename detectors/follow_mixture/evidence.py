"""First evidence, before any strategy is known: what j's past explains of i's surprises, for all pairs at once."""

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

    @property
    def name(self) -> str:
        """How the features are called in reports."""
        parts = [name for name in ("linear", "squares") if getattr(self, name)]
        return f"{'+'.join(parts)}({self.first + self.lags})"


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


def _features(samples: Samples, kind: FeatureKind, uavs: slice) -> NDArray[np.float32]:
    """``(n, R, p)`` of some UAVs, centred features, 0 where unseen; single precision serves for screening."""
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
    """Log-likelihood that j's features add to i's own history, for all pairs, by matrix products.

    With features of j whitened once (X = Q R), the share of i's surprise they explain is |Q' y|²/|y|², for all targets
    in one product. Against the exact conditional regression it leaves out what j's features share with i's own past,
    which can only lower the gain.

    Args:
        samples: n UAVs.
        surprise: ``(n, R, 3)`` what the null leaves of each target.
        kind: which features.
        shift: targets are moved circularly by so many rows; other than 0 they are surrogates.
        voters: ``(v,)`` the UAVs that are asked; all by default.
        columns: ``(c,)`` about whom they are asked; all by default.

    Returns:
        ``(v, c)``; 0 where a UAV meets itself.
    """
    voters = np.arange(samples.uavs) if voters is None else voters
    return _gains(samples, kind, [(voters, _targets(surprise[voters], shift))], columns)[0]


def gain_and_chance(
    samples: Samples, surprise: Floats, kind: FeatureKind, voters: NDArray[np.int64] | None = None
) -> tuple[Floats, float]:
    """:func:`pairwise_gain`, and the most that some voters gain by anybody at a wrong time, in the median."""
    voters = np.arange(samples.uavs) if voters is None else voters
    some = voters[:: max(1, -(-len(voters) // _CHANCE_VOTERS))]
    asked = [(voters, _targets(surprise[voters], 0)), (some, _targets(surprise[some], samples.rows // 2))]
    gain, surrogate = _gains(samples, kind, asked)
    return gain, float(np.median(surrogate.max(axis=1)))


def _targets(surprise: Floats, shift: int) -> NDArray[np.float32]:
    """``(R, 3 v)`` surprises ``(v, R, 3)`` of length 1, moved by ``shift`` rows."""
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
        gain = -rows * np.log1p(-np.clip(share, 0.0, 1.0 - 1e-6))  # two free dimensions a row, half a logarithm each
        gain[voters[:, None] == everybody[None]] = 0.0
        gains.append(gain)
    return gains


def whitened(features: NDArray[RealT], ridge: float = _RIDGE) -> NDArray[RealT]:
    """Orthonormal columns that span those of each ``(R, p)`` block, but for a little ridge."""
    gram = features.transpose(0, 2, 1) @ features
    width = gram.shape[1]
    power = np.trace(gram, axis1=1, axis2=2) / width
    gram += (ridge * power + 1e-9)[:, None, None] * np.eye(width, dtype=gram.dtype)
    inverse = np.linalg.inv(np.linalg.cholesky(gram))
    return np.asarray(features @ inverse.transpose(0, 2, 1), features.dtype)
