"""Means with 95 % intervals: Wilson's score interval for rates, a bootstrap interval for all other metrics."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from usnet_env.config import ArgumentError

__all__ = ["CONFIDENCE", "Interval", "mean_interval", "rate_interval"]

CONFIDENCE = 0.95
_QUANTILE = 1.959963984540054  # of the normal distribution, at (1 + CONFIDENCE) / 2

_RESAMPLES = 9_999
_DRAWS_AT_ONCE = 2_000_000  # limits the indices in memory to 16 MB for any number of episodes
_MOST_RESAMPLED = 5_000  # values; of more, the quantiles of the resampled mean are computed, not drawn


class Interval(NamedTuple):
    """A mean and the ends of its 95 % interval."""

    mean: float
    low: float
    high: float


def _check_sample(values: Sequence[float] | NDArray[np.float64]) -> NDArray[np.float64]:
    sample = np.asarray(values, dtype=np.float64)
    if sample.ndim != 1 or not len(sample) or not np.isfinite(sample).all():
        raise ArgumentError("values must hold at least one number, all of them finite.")
    return sample


def rate_interval(values: Sequence[float] | NDArray[np.float64]) -> Interval:
    """Compute the share of ones in a sample of zeros and ones, with Wilson's score interval.

    Args:
        values: ``(n,)`` of 0 and 1.

    Raises:
        ArgumentError: there is no value, or a value is neither 0 nor 1.
    """
    sample = _check_sample(values)
    if not ((sample == 0) | (sample == 1)).all():
        raise ArgumentError("values of a rate must be 0 or 1.")
    # The formula of scipy.stats.binomtest, whose import takes seconds.
    mean, n = float(sample.mean()), len(sample)
    width = 2 * (n + _QUANTILE**2)
    middle = (2 * n * mean + _QUANTILE**2) / width
    half = _QUANTILE / width * math.sqrt(4 * n * mean * (1 - mean) + _QUANTILE**2)
    # For 0 and for n successes the interval must include the mean, which rounding could prevent.
    return Interval(mean, min(max(middle - half, 0.0), mean), max(min(middle + half, 1.0), mean))


def mean_interval(values: Sequence[float] | NDArray[np.float64], seed: int = 0) -> Interval:
    """Compute the mean of a sample, with the percentile bootstrap interval of 9,999 resamples.

    Of more than 5,000 values, the quantiles of the resampled means are computed to the order 1/n by the expansion of
    Cornish and Fisher with the sample's skewness (Hall, The Bootstrap and Edgeworth Expansion, 1992, section 2.5).

    If all values are equal, or there is only one, the interval is [mean, mean]: resampling cannot show more spread than
    the sample has.

    Args:
        values: ``(n,)``.
        seed: seeds the resampling; the same values and seed give the same interval.

    Raises:
        ArgumentError: there is no value, or one is not finite.
    """
    sample = _check_sample(values)
    if (sample == sample[0]).all():
        constant = float(sample[0])
        return Interval(constant, constant, constant)
    rng, n = np.random.default_rng(seed), len(sample)
    if n > _MOST_RESAMPLED:
        centred = sample - sample.mean()
        spread = float(np.sqrt((centred**2).mean()))
        shift = float((centred**3).mean()) / spread**3 * (_QUANTILE**2 - 1) / (6 * math.sqrt(n))
        mean = float(sample.mean())
        low, high = (mean + spread / math.sqrt(n) * (sign * _QUANTILE + shift) for sign in (-1, 1))
        return Interval(mean, low, high)
    means = np.empty(_RESAMPLES)
    step = max(1, _DRAWS_AT_ONCE // n)
    for first in range(0, _RESAMPLES, step):
        part = means[first : first + step]
        part[:] = sample[rng.integers(n, size=(len(part), n))].mean(axis=1)
    tail = (1 - CONFIDENCE) / 2
    low, high = np.quantile(means, [tail, 1 - tail])
    return Interval(float(sample.mean()), float(low), float(high))
