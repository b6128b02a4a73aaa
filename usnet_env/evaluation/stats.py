"""Statistics of episodes: means, rates, interquartile means and profiles with their intervals, and paired tests."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from statistics import NormalDist
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

Sample: TypeAlias = "Sequence[Any] | NDArray[Any]"


class Interval(NamedTuple):
    """A mean and the ends of its 95 % interval."""

    mean: float
    low: float
    high: float


class Profile(NamedTuple):
    """The share ``(t,)`` of the episodes that are better than each threshold, with the ends of its 95 % interval."""

    thresholds: Floats
    share: Floats
    low: Floats
    high: Floats


def _check_sample(values: Sample) -> Floats:
    sample = np.asarray(values, dtype=np.float64)
    if sample.ndim != 1 or not len(sample) or not np.isfinite(sample).all():
        raise ArgumentError("values must hold at least one number, all of them finite.")
    return sample


def _mean_by_group(sample: Floats, groups: Sample | None) -> Floats:
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
    sample, z = _check_sample(values), NormalDist().inv_cdf((1 + CONFIDENCE) / 2)
    grouped = _mean_by_group(sample, groups)
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
    given = _check_sample(values)
    sample = _mean_by_group(given, groups)
    mean = float(sample.mean())
    for equal in (given, sample):  # the first one, too: groups of several sizes differ by rounding
        if np.ptp(equal) <= 1e-12 * abs(equal[0]):
            return Interval(*[float(equal[0])] * 3)
    if len(sample) > _MOST_RESAMPLED:
        half = NormalDist().inv_cdf((1 + confidence) / 2) * float(sample.std()) / math.sqrt(len(sample))
        return Interval(mean, mean - half, mean + half)
    return _bootstrap([sample], np.mean, confidence)


def _expand(confidence: float, samples: Sequence[Floats]) -> float:
    """The level at which a bootstrap interval of few values covers as often as asked (Hesterberg, 2015)."""
    from scipy.special import stdtrit  # scipy is imported when it is needed: it takes most of a second

    n = sum(map(len, samples))
    free = max(n - len(samples), 1)
    quantile = math.sqrt(n / free) * stdtrit(free, (1 + confidence) / 2)
    return 1 - max(2 * NormalDist().cdf(-quantile), 2e-12)  # a level of 1 has no quantile


def _how_to_resample(values: int) -> dict[str, Any]:
    """Arguments of scipy's resampling: as many values at once as memory should hold, and the same draws each time."""
    batch = max(1, _DRAWS_AT_ONCE // values)
    return {"n_resamples": _RESAMPLES, "batch": batch, "vectorized": True, "random_state": np.random.default_rng(0)}


def _bootstrap(samples: Sequence[Floats], statistic: Callable[..., Any], confidence: float) -> Interval:
    """A statistic of the pooled samples with its BCa interval; each sample is resampled on its own."""
    from scipy.stats import bootstrap

    pooled = np.concatenate(samples)
    place, scale = float(pooled.mean()), float(np.ptp(pooled))

    def rounded(*parts: Floats, axis: int = -1) -> Any:  # resampled values that differ by rounding are made equal
        return np.round(statistic(np.concatenate(parts, axis=axis), axis=axis), 9)

    found = bootstrap(
        [(sample - place) / scale for sample in samples],
        rounded,
        confidence_level=_expand(confidence, samples),
        method="BCa" if len(pooled) <= _MOST_RESAMPLED else "percentile",
        **_how_to_resample(len(pooled)),
    ).confidence_interval
    return Interval(float(statistic(pooled)), place + scale * float(found.low), place + scale * float(found.high))


def paired_test(differences: Sample) -> float:
    """The two-sided p-value of paired differences ``(n,)`` if each is as likely with the other sign.

    The randomisation test of Fisher (The Design of Experiments, 1935, section 21) of the mean, as scipy computes it:
    exact for up to 13 differences, with 9,999 random changes of signs for more, and the normal limit for over 5,000.
    """
    sample = _check_sample(differences)
    if len(sample) == 1 or not sample.any():
        return 1.0
    if len(sample) > _MOST_RESAMPLED:
        return math.erfc(abs(float(sample.sum())) / math.sqrt(2 * float((sample**2).sum())))
    from scipy.stats import permutation_test

    found = permutation_test([sample], np.mean, permutation_type="samples", **_how_to_resample(len(sample)))
    return float(found.pvalue)


def holm(values: Sequence[float]) -> list[float]:
    """Adjust p-values for their number (Holm, Scandinavian Journal of Statistics 6, 1979)."""
    order = np.argsort(values)
    factors = len(values) - np.arange(len(values))
    adjusted = np.minimum(np.maximum.accumulate(np.asarray(values, np.float64)[order] * factors), 1.0)
    return [float(value) for value in adjusted[np.argsort(order)]]


def interquartile_mean(strata: Sequence[Sample]) -> Interval:
    """The mean of the middle half of all pooled values, with its BCa interval; each task is resampled on its own.

    Agarwal et al., Deep Reinforcement Learning at the Edge of the Statistical Precipice, NeurIPS 2021, section 4.3. The
    values of task s are ``strata[s]``, ``(n_s,)``. Of more than 5,000 values the interval is the percentile interval.
    """
    from scipy.stats import trim_mean

    samples = [_check_sample(values) for values in strata]
    pooled = np.sort(np.concatenate(samples))
    n = len(pooled)
    if pooled[n // 4] == pooled[n - n // 4 - 1] or any(len(sample) == 1 for sample in samples):
        return Interval(*[float(trim_mean(pooled, 0.25))] * 3)
    return _bootstrap(samples, lambda values, axis=-1: trim_mean(values, 0.25, axis), CONFIDENCE)


def performance_profile(strata: Sequence[Sample], thresholds: Sample, lower_is_better: bool = False) -> Profile:
    """The share of episodes that are better than each threshold, averaged over the tasks, with percentile intervals.

    The run-score distribution of Agarwal et al. (2021, section 4.2), with 2,000 resamples of the stratified bootstrap.
    The values of task s are ``strata[s]``, ``(n_s,)``; thresholds are ``(t,)``.
    """
    rng, at = np.random.default_rng(0), _check_sample(thresholds)
    samples = [_check_sample(values) for values in strata]
    shares, resampled = np.zeros(len(at)), np.zeros((_PROFILE_RESAMPLES, len(at)))
    for sample in samples:
        n, ranked = len(sample), np.sort(sample)
        better = np.searchsorted(ranked, at) if lower_is_better else n - np.searchsorted(ranked, at, side="right")
        shares += better / n / len(samples)
        resampled += rng.binomial(n, better / n, size=resampled.shape) / n / len(samples)
    tail = (1 - _expand(CONFIDENCE, samples)) / 2
    return Profile(at, shares, *np.quantile(resampled, [tail, 1 - tail], axis=0))
