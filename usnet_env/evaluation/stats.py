"""Statistics of episodes: means, rates, interquartile means and profiles with their intervals, and paired tests."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from usnet_env.arrays import Floats
from usnet_env.config import ArgumentError

CONFIDENCE = 0.95
_RESAMPLES = 9_999
_PROFILE_RESAMPLES = 2_000
_MOST_RESAMPLED = 5_000  # values; of more, the normal limit is used
_DRAWS_AT_ONCE = 2_000_000  # limits the memory of a resampling to 16 MB an array

Sample: TypeAlias = "Sequence[float] | Floats"
#: What says which values belong together: a number or a name for each.
Groups: TypeAlias = "Sequence[Any] | NDArray[Any]"


class Interval(NamedTuple):
    """A mean and the ends of its 95 % interval."""

    mean: float
    low: float
    high: float


class Profile(NamedTuple):
    """A performance profile.

    Args:
        thresholds: ``(t,)`` float64.
        share: ``(t,)`` float64, the share of the episodes that are better than each threshold.
        low, high: ``(t,)`` float64, the ends of its 95 % interval at each threshold.
    """

    thresholds: Floats
    share: Floats
    low: Floats
    high: Floats


def _check_sample(values: Sample) -> Floats:
    sample = np.asarray(values, dtype=np.float64)
    if sample.ndim != 1 or not len(sample) or not np.isfinite(sample).all():
        raise ArgumentError("values must hold at least one number, all of them finite.")
    return sample


def _mean_by_group(sample: Floats, groups: Groups) -> Floats:
    """Independent values ``(g,)`` with the mean of the sample and, nearly, the variance of that mean.

    The value of a group is the mean plus the sum of its deviations, in units of the mean size of a group (the
    linearised ratio estimator: Cochran, Sampling Techniques, 3rd edition, 1977, section 9A.1).
    """
    names, numbers = np.unique(np.asarray(groups), return_inverse=True)
    if len(names) == len(sample):
        return sample
    mean = sample.mean()
    sums = np.bincount(numbers, sample - mean)
    return np.asarray(mean + sums * (len(sums) / len(sample)))


def _normal_quantile(confidence: float) -> float:
    from scipy.special import ndtri  # scipy is imported when it is needed: it takes most of a second

    return float(ndtri((1 + confidence) / 2))


def rate_interval(values: Sample, groups: Groups | None = None) -> Interval:
    """Compute the share of ones in a sample of zeros and ones, with Wilson's score interval.

    Values of one group depend on each other. Then n is the effective number of values: n divided by the design effect
    (Kish, Survey Sampling, 1965, section 8.2), the ratio of the variance of the mean over groups to that over
    independent values, if that is above 1. If all values are equal, n is the number of groups.

    Args:
        values: ``(n,)`` of 0 and 1.
        groups: ``(n,)`` the group of each, such as the seed of a swarm that several cells share; ``None``: all are
            independent.

    Raises:
        ArgumentError: there is no value, or one is not finite.
    """
    sample, z = _check_sample(values), _normal_quantile(CONFIDENCE)
    mean, n = float(sample.mean()), float(len(sample))  # n may become a fraction, which scipy's Wilson doesn't take
    if groups is not None and len(grouped := _mean_by_group(sample, groups)) < n:
        variance = float(grouped.var()) / len(grouped)
        if variance > 0:
            n = min(n, mean * (1 - mean) / variance)
        elif mean in (0.0, 1.0) or len(grouped) == 1:  # nothing shows how alike the values of a group are
            n = len(grouped)
    middle = (mean + z**2 / (2 * n)) / (1 + z**2 / n)
    half = z / (1 + z**2 / n) * math.sqrt(mean * (1 - mean) / n + z**2 / (4 * n**2))
    # For 0 and for n successes the interval must include the mean, which rounding could prevent.
    return Interval(mean, min(max(middle - half, 0.0), mean), max(min(middle + half, 1.0), mean))


def mean_interval(values: Sample, confidence: float = CONFIDENCE, groups: Groups | None = None) -> Interval:
    """Compute the mean of a sample, with the bias-corrected and accelerated (BCa) bootstrap interval of scipy.

    Its level is expanded for few values (Hesterberg, The American Statistician 69, 2015, section 4.3). Of more than 5,000 values it is the interval of the normal limit. If all values are equal, it is [mean, mean]:
    resampling cannot show more spread than the sample has. One value has no interval; [mean, mean] stands for it.

    Args:
        values: ``(n,)``.
        confidence: of the interval.
        groups: ``(n,)`` the group of each value; values of one group depend on each other, and groups are resampled as
            a whole. ``None``: all are independent.

    Raises:
        ArgumentError: there is no value, or one is not finite.
    """
    given = _check_sample(values)
    sample = given if groups is None else _mean_by_group(given, groups)
    for equal in (given, sample):  # the first one, too: groups of several sizes differ by rounding
        if np.ptp(equal) <= 1e-12 * abs(equal[0]):
            return Interval(float(equal[0]), float(equal[0]), float(equal[0]))
    mean = float(sample.mean())
    if len(sample) > _MOST_RESAMPLED:
        half = _normal_quantile(confidence) * float(sample.std()) / math.sqrt(len(sample))
        return Interval(mean, mean - half, mean + half)
    scale = float(np.ptp(sample))  # in this unit, resampled means that differ by rounding are made equal
    ends = _bootstrap([(sample - mean) / scale], lambda x, axis: np.round(np.mean(x, axis), 9), confidence)
    return Interval(mean, *(mean + scale * end for end in ends))


def _expand(confidence: float, values: int, samples: int = 1) -> float:
    """The level at which a bootstrap interval of few values covers as often as asked: it is too narrow otherwise.

    Hesterberg, What teachers should know about the bootstrap, The American Statistician 69, 2015, section 4.3.
    """
    from scipy.special import ndtr, stdtrit

    free = max(values - samples, 1)
    tail = float(ndtr(-math.sqrt(values / free) * stdtrit(free, (1 + confidence) / 2)))
    return 1 - 2 * max(tail, 1e-12)  # a level of 1 has no quantile


def _bootstrap(samples: Sequence[Floats], statistic: Callable[..., Any], confidence: float) -> tuple[float, float]:
    """The ends of scipy's BCa interval; each sample is resampled on its own, always with the same random numbers."""
    from scipy.stats import bootstrap

    found = bootstrap(
        samples,
        statistic,
        n_resamples=_RESAMPLES,
        batch=max(1, _DRAWS_AT_ONCE // sum(map(len, samples))),
        confidence_level=_expand(confidence, sum(map(len, samples)), len(samples)),
        method="BCa",
        vectorized=True,
        random_state=np.random.default_rng(0),
    ).confidence_interval
    return float(found.low), float(found.high)


def paired_test(differences: Sample) -> float:
    """The two-sided p-value of paired differences under the hypothesis that each is as likely with the other sign.

    The randomisation test of Fisher (The Design of Experiments, 1935, section 21) with the mean as its statistic, as
    scipy computes it: exact for up to 13 differences, with 9,999 random changes of signs for more. Of more than 5,000
    differences, the p-value of the mean's normal limit.

    Args:
        differences: ``(n,)``.
    """
    sample = _check_sample(differences)
    if len(sample) == 1 or not sample.any():
        return 1.0
    if len(sample) > _MOST_RESAMPLED:
        return math.erfc(abs(float(sample.sum())) / math.sqrt(2 * float((sample**2).sum())))
    from scipy.stats import permutation_test

    found = permutation_test(
        [sample],
        np.mean,
        permutation_type="samples",
        vectorized=True,
        n_resamples=_RESAMPLES,
        batch=max(1, _DRAWS_AT_ONCE // len(sample)),
        random_state=np.random.default_rng(0),
    )
    return float(found.pvalue)


def holm(values: Sequence[float]) -> list[float]:
    """Adjust p-values for their number, so that the chance of any false rejection stays below the level.

    Holm, A simple sequentially rejective multiple test procedure, Scandinavian Journal of Statistics 6, 1979.
    """
    order = np.argsort(values)
    factors = len(values) - np.arange(len(values))
    adjusted = np.minimum(np.maximum.accumulate(np.asarray(values, np.float64)[order] * factors), 1.0)
    found = np.empty(len(values))
    found[order] = adjusted
    return [float(value) for value in found]


def interquartile_mean(strata: Sequence[Sample]) -> Interval:
    """The mean of the middle half of all pooled values, with its BCa interval; each task is resampled on its own.

    Agarwal et al., Deep Reinforcement Learning at the Edge of the Statistical Precipice, NeurIPS 2021, section 4.3. Of
    more than 5,000 values, the interval is that of the normal limit (Tukey and McLaughlin, Sankhya A 25, 1963: the
    variance of a trimmed mean from the winsorised values).

    Args:
        strata: the values of each task, ``(n_s,)`` for task s.
    """
    from scipy.stats import trim_mean

    samples = [_check_sample(values) for values in strata]
    pooled = np.sort(np.concatenate(samples))
    n, mean = len(pooled), float(trim_mean(pooled, 0.25))
    low, high = pooled[n // 4], pooled[n - n // 4 - 1]
    if low == high or any(len(sample) == 1 for sample in samples):
        return Interval(mean, mean, mean)
    if n > _MOST_RESAMPLED:
        clipped = [np.clip(sample, low, high) for sample in samples]
        spread = math.sqrt(sum(len(sample) * float(sample.var()) for sample in clipped)) / (n - 2 * (n // 4))
        half = _normal_quantile(CONFIDENCE) * spread
        return Interval(mean, mean - half, mean + half)

    def statistic(*parts: Floats, axis: int = -1) -> Any:
        return trim_mean(np.concatenate(parts, axis=axis), 0.25, axis)

    return Interval(mean, *_bootstrap(samples, statistic, CONFIDENCE))


def performance_profile(strata: Sequence[Sample], thresholds: Sample, lower_is_better: bool = False) -> Profile:
    """The share of episodes that are better than each threshold, averaged over the tasks, with percentile intervals.

    The run-score distribution of Agarwal et al. (2021, section 4.2), with 2,000 resamples of the stratified bootstrap.

    Args:
        strata: the values of each task, ``(n_s,)`` for task s.
        thresholds: ``(t,)``.
        lower_is_better: whether values below a threshold are better, or those above it.
    """
    sign = -1.0 if lower_is_better else 1.0
    samples, at = [sign * _check_sample(values) for values in strata], _check_sample(thresholds)
    order = np.argsort(sign * at)
    edges = (sign * at)[order]
    rng = np.random.default_rng(0)
    shares, resampled = np.zeros(len(at)), np.zeros((_PROFILE_RESAMPLES, len(at)))
    for sample in samples:
        n, places = len(sample), np.searchsorted(edges, sample, side="left")  # how many edges are below a value
        counts = np.bincount(places, minlength=len(edges) + 1)
        drawn = rng.multinomial(n, counts / n, size=_PROFILE_RESAMPLES)  # how many of n draws are between two edges
        shares += (1 - np.cumsum(counts)[:-1] / n) / len(samples)
        resampled += (1 - np.cumsum(drawn, axis=1)[:, :-1] / n) / len(samples)
    tail = (1 - _expand(CONFIDENCE, sum(map(len, samples)), len(samples))) / 2
    ends = np.empty((3, len(at)))
    ends[:, order] = shares, *np.quantile(resampled, [tail, 1 - tail], axis=0)
    return Profile(at, *ends)
