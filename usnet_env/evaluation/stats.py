"""Statistics of episodes: means and rates with their intervals, and paired tests."""

from __future__ import annotations

import math
from collections.abc import Sequence
from statistics import NormalDist
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from usnet_env.arrays import Floats

CONFIDENCE = 0.95
_RESAMPLES = 9_999
_MAX_RESAMPLED = 5_000  # values; of more, the normal limit is used
_MAX_DRAWS = 2_000_000  # limits the memory of a resampling to 16 MB an array

Sample: TypeAlias = "Sequence[Any] | NDArray[Any]"


class Interval(NamedTuple):
    """A mean and the ends of its 95 % interval."""

    mean: float
    low: float
    high: float


def _average_by_group(sample: Floats, groups: Sample | None) -> Floats:
    """Independent values ``(g,)`` with the mean of the sample and, nearly, the variance of that mean.

    The linearised ratio estimator: Cochran, Sampling Techniques, 3rd edition, 1977, section 9A.1.
    """
    names, numbers = np.unique(np.arange(len(sample)) if groups is None else np.asarray(groups), return_inverse=True)
    if len(names) == len(sample):
        return sample
    sums = np.bincount(numbers, sample - sample.mean())
    return np.asarray(sample.mean() + sums * (len(sums) / len(sample)))


def rate_interval(values: Sample, groups: Sample | None = None) -> Interval:
    """Compute the share of ones in a sample of zeros and ones ``(n,)``, with Wilson's score interval.

    Values of one of the ``groups`` ``(n,)``, such as the seeds of swarms, depend on each other: n is then the number of
    values divided by the design effect (Kish, Survey Sampling, 1965, section 8.2), or that of groups if all are equal.
    """
    sample, z = np.asarray(values, np.float64), NormalDist().inv_cdf((1 + CONFIDENCE) / 2)
    grouped = _average_by_group(sample, groups)
    mean, n = float(sample.mean()), float(len(sample))  # n may become a fraction, which scipy's Wilson doesn't take
    if len(grouped) < n:
        variance = float(grouped.var()) / len(grouped)
        if variance > 0:
            n = min(n, mean * (1 - mean) / variance)
        elif mean in (0.0, 1.0) or len(grouped) == 1:  # nothing shows how alike the values of a group are
            n = len(grouped)
    middle = (mean + z**2 / (2 * n)) / (1 + z**2 / n)
    half = z / (1 + z**2 / n) * math.sqrt(mean * (1 - mean) / n + z**2 / (4 * n**2))
    # For 0 and for n successes the interval must include the mean, which rounding could prevent.
    return Interval(mean, min(max(middle - half, 0.0), mean), max(min(middle + half, 1.0), mean))


def mean_interval(values: Sample, confidence: float = CONFIDENCE, groups: Sample | None = None) -> Interval:
    """Compute the mean of a sample ``(n,)``, with the bias-corrected and accelerated (BCa) bootstrap interval of scipy.

    Its level is expanded, since the interval of few values is too narrow otherwise (Hesterberg, The American
    Statistician 69, 2015). Of more than 5,000 values it is the interval of the normal limit. If all values are equal,
    it is [mean, mean]. Values of one of the ``groups`` ``(n,)`` depend on each other, and are resampled as a whole.
    """
    ungrouped = np.asarray(values, np.float64)
    sample = _average_by_group(ungrouped, groups)
    mean = float(sample.mean())
    for constant in (ungrouped, sample):  # the first one, too: groups of several sizes differ by rounding
        if np.ptp(constant) <= 1e-12 * abs(constant[0]):
            return Interval(*[float(constant[0])] * 3)
    if len(sample) > _MAX_RESAMPLED:
        half = NormalDist().inv_cdf((1 + confidence) / 2) * float(sample.std()) / math.sqrt(len(sample))
        return Interval(mean, mean - half, mean + half)
    return _bootstrap(sample, confidence)


def _expand_level(confidence: float, values: int) -> float:
    """The level at which a bootstrap interval of few values covers as often as asked (Hesterberg, 2015)."""
    from scipy.special import stdtrit  # scipy is imported when it is needed: it takes most of a second

    degrees = max(values - 1, 1)
    quantile = math.sqrt(values / degrees) * stdtrit(degrees, (1 + confidence) / 2)
    return 1 - max(2 * NormalDist().cdf(-quantile), 2e-12)  # a level of 1 has no quantile


def _plan_resampling(values: int) -> dict[str, Any]:
    """Arguments of scipy's resampling: as many values at once as memory should hold, and the same draws each time."""
    batch = max(1, _MAX_DRAWS // values)
    return {"n_resamples": _RESAMPLES, "batch": batch, "vectorized": True, "random_state": np.random.default_rng(0)}


def _bootstrap(sample: Floats, confidence: float) -> Interval:
    """The mean of a sample with its BCa interval."""
    from scipy.stats import bootstrap

    mean, scale = float(sample.mean()), float(np.ptp(sample))

    def rounded_mean(values: Floats, axis: int = -1) -> Any:  # resampled means that differ by rounding are made equal
        return np.round(values.mean(axis=axis), 9)

    level = _expand_level(confidence, len(sample))
    scaled = [(sample - mean) / scale]
    options = {"confidence_level": level, "method": "BCa"} | _plan_resampling(len(sample))
    result = bootstrap(scaled, rounded_mean, **options)
    low, high = result.confidence_interval
    return Interval(mean, mean + scale * float(low), mean + scale * float(high))


def paired_test(differences: Sample) -> float:
    """The two-sided p-value of paired differences ``(n,)`` if each is as likely with the other sign.

    The randomisation test of Fisher (The Design of Experiments, 1935, section 21) of the mean, as scipy computes it:
    exact for up to 13 differences, with 9,999 random changes of signs for more, and the normal limit for over 5,000.
    """
    sample = np.asarray(differences, np.float64)
    if len(sample) == 1 or not sample.any():
        return 1.0
    if len(sample) > _MAX_RESAMPLED:
        return math.erfc(abs(float(sample.sum())) / math.sqrt(2 * float((sample**2).sum())))
    from scipy.stats import permutation_test

    result = permutation_test([sample], np.mean, permutation_type="samples", **_plan_resampling(len(sample)))
    return float(result.pvalue)


def holm(values: Sequence[float]) -> list[float]:
    """Adjust p-values for their number (Holm, Scandinavian Journal of Statistics 6, 1979)."""
    order = np.argsort(values)
    factors = len(values) - np.arange(len(values))
    adjusted = np.minimum(np.maximum.accumulate(np.asarray(values, np.float64)[order] * factors), 1.0)
    return [float(value) for value in adjusted[np.argsort(order)]]
