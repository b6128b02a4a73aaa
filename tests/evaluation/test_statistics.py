from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import binomtest, bootstrap, norm

from usnet_env.config import ArgumentError
from usnet_env.evaluation import statistics
from usnet_env.evaluation.statistics import mean_interval, rate_interval

NUMBERS = st.floats(-1e6, 1e6)


@pytest.mark.parametrize(("hits", "n"), [(0, 10), (10, 10), (1, 10), (95, 100), (1, 1), (500, 1000)])
def test_wilson_is_its_formula(hits, n):
    z, p = norm.ppf(0.975), hits / n
    middle = (p + z**2 / (2 * n)) / (1 + z**2 / n)
    half = z / (1 + z**2 / n) * np.sqrt(p * (1 - p) / n + z**2 / (4 * n**2))
    interval = rate_interval([1] * hits + [0] * (n - hits))
    assert interval == pytest.approx((p, middle - half, middle + half))


def test_wilson_is_scipy_s():
    for n in (1, 2, 7, 60, 1001):
        for hits in {0, 1, n // 3, n - 1, n}:
            theirs = binomtest(hits, n).proportion_ci(0.95, method="wilson")
            assert rate_interval([1] * hits + [0] * (n - hits))[1:] == pytest.approx(
                tuple(theirs), rel=1e-13, abs=1e-16
            )


@given(st.lists(st.booleans(), min_size=1))
def test_a_rate_s_interval_holds_it_and_stays_within_0_and_1(values):
    interval = rate_interval(values)
    assert 0 <= interval.low <= interval.mean <= interval.high <= 1
    assert interval.low < interval.high  # even where all are equal, n says how sure that is


@given(NUMBERS, st.integers(1, 20))
def test_equal_values_have_no_width(value, n):
    assert mean_interval([value] * n) == (value, value, value)


def test_the_bootstrap_agrees_with_scipy_s_percentile_one():
    sample = np.random.default_rng(3).exponential(size=60)
    ours = mean_interval(sample)
    theirs = bootstrap((sample,), np.mean, method="percentile", rng=np.random.default_rng(1)).confidence_interval
    assert ours.mean == sample.mean()
    width = theirs.high - theirs.low
    assert abs(ours.low - theirs.low) < 0.05 * width
    assert abs(ours.high - theirs.high) < 0.05 * width


def test_the_interval_of_a_large_sample_is_the_limit_of_the_bootstrap(monkeypatch):
    sample = np.random.default_rng(4).lognormal(sigma=1.5, size=6_000)  # its skewness moves both ends
    computed = mean_interval(sample)
    monkeypatch.setattr(statistics, "_MOST_RESAMPLED", len(sample))
    drawn = mean_interval(sample)
    assert computed.mean == drawn.mean
    width = drawn.high - drawn.low
    assert computed.low == pytest.approx(drawn.low, abs=0.02 * width)
    assert computed.high == pytest.approx(drawn.high, abs=0.02 * width)
    assert drawn.high - drawn.mean > 1.03 * (drawn.mean - drawn.low)


def test_the_interval_covers_the_mean_about_as_often_as_it_says():
    rng = np.random.default_rng(0)
    intervals = [mean_interval(rng.normal(size=40), seed=trial) for trial in range(200)]
    covered = sum(interval.low <= 0 <= interval.high for interval in intervals)
    assert 180 <= covered <= 198


def test_large_samples_are_resampled_in_parts(monkeypatch):
    sample = np.random.default_rng(0).random(1_500)
    interval = mean_interval(sample)
    assert interval.high - interval.low == pytest.approx(2 * 1.96 * sample.std() / np.sqrt(len(sample)), rel=0.05)
    sizes = []
    monkeypatch.setattr(statistics, "_DRAWS_AT_ONCE", 20 * len(sample))
    rng = np.random.default_rng
    monkeypatch.setattr(np.random, "default_rng", lambda seed: Sized(rng(seed), sizes))
    assert mean_interval(sample) == interval
    assert max(map(np.prod, sizes)) == 20 * len(sample)


class Sized:
    """A generator that records how many numbers are drawn at once."""

    def __init__(self, rng, sizes):
        self.rng = rng
        self.sizes = sizes

    def integers(self, n, size):
        self.sizes.append(size)
        return self.rng.integers(n, size=size)


def test_the_same_sample_has_the_same_interval():
    assert mean_interval([1.0, 2.0, 4.0]) == mean_interval([1.0, 2.0, 4.0])


@pytest.mark.parametrize("values", [[], [float("nan")], [float("inf")], [[1.0]]])
def test_no_interval_without_finite_numbers(values):
    for function in (mean_interval, rate_interval):
        with pytest.raises(ArgumentError, match="values must hold at least one number"):
            function(values)


def test_a_rate_is_made_of_zeros_and_ones():
    with pytest.raises(ArgumentError, match="0 or 1"):
        rate_interval([0.5])
