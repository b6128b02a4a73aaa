"""Statistics of episodes: means, interquartile means, profiles and paired differences, with their intervals."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr, stdtrit

from usnet_env.arrays import Floats
from usnet_env.config import ArgumentError

CONFIDENCE = 0.95
_QUANTILE = 1.959963984540054  # of the normal distribution, at (1 + CONFIDENCE) / 2

_RESAMPLES = 9_999
_PROFILE_RESAMPLES = 2_000
_MOST_ENUMERATED = 13  # differences, whose 2^13 changes of sign are fewer than the random ones
_DRAWS_AT_ONCE = 2_000_000  # limits the indices in memory to 16 MB for any number of episodes
_MOST_RESAMPLED = 5_000  # values; of more, the quantiles of the resampled mean are computed, not drawn


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
    if numbers.shape != sample.shape:
        raise ArgumentError(f"groups must have one entry for each of the {len(sample)} values, got {numbers.size}.")
    if len(names) == len(sample):
        return sample
    mean = sample.mean()
    sums = np.bincount(numbers, sample - mean)
    return np.asarray(mean + sums * (len(sums) / len(sample)))


def rate_interval(values: Sample, groups: Groups | None = None) -> Interval:
    """Compute the share of ones in a sample of zeros and ones, with Wilson's score interval.

    Values of one group depend on each other. Then n is the effective number of values: n divided by the design effect
    (Kish, Survey Sampling, 1965, section 8.2), the ratio of the variance of the mean over groups to that over
    independent values, if that is above 1. If all values are equal, n is the number of groups.

    Args:
        values: ``(n,)`` of 0 and 1.
        groups: ``(n,)`` the group of each, such as the number of an episode that several cells share; ``None``: all
            are independent.

    Raises:
        ArgumentError: there is no value, or a value is neither 0 nor 1.
    """
    sample = _check_sample(values)
    if not ((sample == 0) | (sample == 1)).all():
        raise ArgumentError("values of a rate must be 0 or 1.")
    # The formula of scipy.stats.binomtest, whose import takes seconds.
    mean, n = float(sample.mean()), float(len(sample))
    if groups is not None and len(grouped := _mean_by_group(sample, groups)) < n:
        count = len(grouped)
        variance = float(grouped.var()) / count
        if variance > 0:
            n = min(n, mean * (1 - mean) / variance)
        elif mean in (0.0, 1.0) or count == 1:  # nothing shows how alike the values of a group are
            n = count
    width = 2 * (n + _QUANTILE**2)
    middle = (2 * n * mean + _QUANTILE**2) / width
    half = _QUANTILE / width * math.sqrt(4 * n * mean * (1 - mean) + _QUANTILE**2)
    # For 0 and for n successes the interval must include the mean, which rounding could prevent.
    return Interval(mean, min(max(middle - half, 0.0), mean), max(min(middle + half, 1.0), mean))


def _wide_quantile(n: int, strata: int = 1, confidence: float = CONFIDENCE) -> float:
    """The quantile of the normal distribution to which the bootstrap's interval of n values extends.

    Resamples spread less than samples do, by sqrt((n - 1) / n), and the spread of few values is not well known, which
    Student's distribution tells: the expanded percentile interval (Hesterberg, What Teachers Should Know About the
    Bootstrap, The American Statistician 69, 2015).

    Args:
        n: number of independent values.
        strata: in how many parts, of which each has a mean of its own.
        confidence: of the interval.
    """
    free = max(1, n - strata)
    return math.sqrt(n / free) * -float(stdtrit(free, (1 - confidence) / 2))


def _split_resamples(n: int) -> list[int]:
    """How many resamples of n values to draw at a time."""
    step = max(1, _DRAWS_AT_ONCE // n)
    return [min(step, _RESAMPLES - first) for first in range(0, _RESAMPLES, step)]


def _ends(resampled: Floats, quantile: float) -> tuple[float, float]:
    """The ends of the percentile interval at a quantile of the normal distribution."""
    tail = float(ndtr(-quantile))
    low, high = np.quantile(resampled, [tail, 1 - tail])
    return float(low), float(high)


def mean_interval(
    values: Sample, seed: int = 0, confidence: float = CONFIDENCE, groups: Groups | None = None
) -> Interval:
    """Compute the mean of a sample, with the expanded percentile bootstrap interval of 9,999 resamples.

    Its levels are those that a sample of n values needs, see :func:`_wide_quantile`. It does not reach beyond the
    values: of normal values, intervals of 2, 3, 4 and 5 hold the mean in 50, 75, 88 and 92 % of all samples.

    Of more than 5,000 values, the quantiles of the resampled means are computed to the order 1/n by the expansion of
    Cornish and Fisher with the sample's skewness (Hall, The Bootstrap and Edgeworth Expansion, 1992, section 2.5).

    If all values are equal, the interval is [mean, mean]: resampling cannot show more spread than the sample has. One
    value has no interval; [mean, mean] stands for it.

    Args:
        values: ``(n,)``.
        seed: seeds the resampling; the same values and seed give the same interval.
        confidence: of the interval.
        groups: ``(n,)`` the group of each value; values of one group depend on each other, and groups are resampled as
            a whole. ``None``: all are independent.

    Raises:
        ArgumentError: there is no value, or one is not finite.
    """
    given = _check_sample(values)
    sample = given if groups is None else _mean_by_group(given, groups)
    for same in (given, sample):  # the first one, too: groups of several sizes differ by rounding
        if (same == same[0]).all():
            constant = float(same[0])
            return Interval(constant, constant, constant)
    rng, n = np.random.default_rng(seed), len(sample)
    quantile = _wide_quantile(n, confidence=confidence)
    if n > _MOST_RESAMPLED:
        centred = sample - sample.mean()
        spread = float(np.sqrt((centred**2).mean()))
        shift = float((centred**3).mean()) / spread**3 * (quantile**2 - 1) / (6 * math.sqrt(n))
        mean = float(sample.mean())
        low, high = (mean + spread / math.sqrt(n) * (sign * quantile + shift) for sign in (-1, 1))
        return Interval(mean, low, high)
    means = [sample[rng.integers(n, size=(count, n))].mean(axis=1) for count in _split_resamples(n)]
    return Interval(float(sample.mean()), *_ends(np.concatenate(means), quantile))


def paired_test(differences: Sample) -> float:
    """The two-sided p-value of paired differences under the hypothesis that each is as likely with the other sign.

    The randomisation test of Fisher (The Design of Experiments, 1935, section 21) with the mean as its statistic. Up to
    13 differences, all changes of their signs are tried, and p is exact; of more, 9,999 random ones. Of more than 5,000
    differences, the p-value of the mean's normal limit.

    Args:
        differences: ``(n,)``.

    Raises:
        ArgumentError: there is no difference, or one is not finite.
    """
    sample = _check_sample(differences)
    n, found = len(sample), abs(float(sample.sum()))
    if not sample.any():
        return 1.0
    if n > _MOST_RESAMPLED:
        return math.erfc(found / math.sqrt(2 * float((sample**2).sum())))
    if n <= _MOST_ENUMERATED:
        every = 1.0 - 2 * (np.arange(2**n)[:, None] >> np.arange(n) & 1)
        return float((np.abs(every @ sample) >= found * (1 - 1e-12)).mean())
    rng, as_large = np.random.default_rng(0), 0
    for count in _split_resamples(n):
        signs = 2.0 * rng.integers(2, size=(count, n)) - 1
        as_large += int((np.abs(signs @ sample) >= found * (1 - 1e-12)).sum())
    return (1 + as_large) / (1 + _RESAMPLES)


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


def _middle_mean(values: Floats) -> Floats:
    """The mean of the values without the lowest and the highest quarter, along the last axis."""
    n = values.shape[-1]
    cut = n // 4
    return np.partition(values, (cut, n - cut - 1), axis=-1)[..., cut : n - cut].mean(axis=-1)


def interquartile_mean(strata: Sequence[Sample], seed: int = 0) -> Interval:
    """The mean of the middle half of all values, with its expanded percentile interval from the stratified bootstrap.

    Agarwal et al., Deep Reinforcement Learning at the Edge of the Statistical Precipice, NeurIPS 2021, section 4.3: all
    values are pooled, and the lowest and the highest quarter are left out (each rounded down to whole values). 9,999
    resamples are drawn from each task on its own; the levels are those of :func:`mean_interval`. Of more than 5,000
    values, the interval is that of the normal limit (Tukey and McLaughlin, Sankhya A 25, 1963: the variance of a
    trimmed mean from the winsorised values).

    Args:
        strata: the values of each task, ``(n_s,)`` for task s.
        seed: seeds the resampling.

    Raises:
        ArgumentError: a task has no value, or a value is not finite.
    """
    samples = [_check_sample(each) for each in strata]
    pooled = np.sort(np.concatenate(samples))
    n = len(pooled)
    mean = float(_middle_mean(pooled))
    quantile = _wide_quantile(n, len(samples))
    if n > _MOST_RESAMPLED:
        cut = n // 4
        clipped = [np.clip(each, pooled[cut], pooled[n - cut - 1]) for each in samples]
        spread = math.sqrt(sum(len(each) * float(each.var()) for each in clipped)) / (n - 2 * cut)
        return Interval(mean, mean - quantile * spread, mean + quantile * spread)
    rng, found = np.random.default_rng(seed), []
    for count in _split_resamples(n):
        drawn = [each[rng.integers(len(each), size=(count, len(each)))] for each in samples]
        found.append(_middle_mean(np.concatenate(drawn, axis=1)))
    return Interval(mean, *_ends(np.concatenate(found), quantile))


def are_finite_numbers(values: Any) -> bool:
    """Whether the values are an array ``(t,)`` of at least one finite number."""
    try:
        found = np.asarray(values, np.float64)
    except (TypeError, ValueError):
        return False
    return found.ndim == 1 and bool(len(found)) and bool(np.isfinite(found).all())


def performance_profile(strata: Sequence[Sample], thresholds: Sample, lower_is_better: bool = False) -> Profile:
    """The share of episodes that are better than each threshold, with pointwise percentile intervals.

    The run-score distribution of Agarwal et al. (2021, section 4.2): the share of values above a threshold in each
    task, averaged over the tasks, with 2,000 resamples of the stratified bootstrap. If lower values are better, it is
    the share below the threshold.

    Args:
        strata: the values of each task, ``(n_s,)`` for task s.
        thresholds: ``(t,)``.
        lower_is_better: which values are better.

    Raises:
        ArgumentError: a task has no value, or a value is not finite.
    """
    sign = -1.0 if lower_is_better else 1.0
    samples, at = [sign * _check_sample(each) for each in strata], _check_sample(thresholds)
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
    tail = (1 - CONFIDENCE) / 2
    ends = np.empty((3, len(at)))
    ends[:, order] = shares, *np.quantile(resampled, [tail, 1 - tail], axis=0)
    return Profile(at, *ends)
