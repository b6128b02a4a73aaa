"""Intervals and tests against slow references, and against how often they hold."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import binomtest, norm

from usnet_env.evaluation import stats
from usnet_env.evaluation.stats import holm, mean_interval, paired_test, rate_interval

TASKS = [np.random.default_rng(task).gamma(2, size=n) + task for task, n in enumerate((30, 45, 60))]


def test_wilson_is_scipy_s():
    for n in (1, 2, 7, 60, 1001):
        for hits in {0, 1, n // 3, n - 1, n}:
            theirs = binomtest(hits, n).proportion_ci(0.95, method="wilson")
            ours = rate_interval([1] * hits + [0] * (n - hits))
            assert ours[1:] == pytest.approx(tuple(theirs), rel=1e-12, abs=1e-15)


def slow_bca(sample, level):
    """Efron's bias-corrected and accelerated interval, in loops (Efron and Tibshirani, 1993, chapter 14.3)."""
    rng, n = np.random.default_rng(7), len(sample)
    means = np.array([rng.choice(sample, n).mean() for _ in range(20_000)])
    bias = norm.ppf((means < sample.mean()).mean())
    left_out = np.array([np.delete(sample, place).mean() for place in range(n)])
    skew = left_out.mean() - left_out
    acceleration = (skew**3).sum() / (6 * (skew**2).sum() ** 1.5)
    z = [bias + norm.ppf(tail) for tail in ((1 - level) / 2, (1 + level) / 2)]
    return np.quantile(means, [norm.cdf(bias + each / (1 - acceleration * each)) for each in z])


@pytest.mark.parametrize("level", [0.95, 0.99])
def test_the_interval_of_a_mean_is_that_of_the_slow_bca_bootstrap(level):
    sample = np.random.default_rng(3).exponential(size=60)
    ours = mean_interval(sample, confidence=level)
    low, high = slow_bca(sample, level)
    assert ours.mean == sample.mean()
    assert ours.low == pytest.approx(low, abs=0.05 * (high - low))
    assert ours.high == pytest.approx(high, abs=0.05 * (high - low))
    assert mean_interval(sample, confidence=level) == ours


def test_the_interval_of_a_large_sample_is_the_limit_of_the_bootstrap(monkeypatch):
    sample = np.random.default_rng(4).exponential(size=5_001)
    computed = mean_interval(sample)
    assert computed.high - computed.low == pytest.approx(2 * 1.96 * sample.std() / np.sqrt(5_001), rel=1e-3)
    monkeypatch.setattr(stats, "_MAX_RESAMPLED", len(sample))
    monkeypatch.setattr(stats, "_RESAMPLES", 2_000)
    drawn = mean_interval(sample)
    width = drawn.high - drawn.low
    assert computed.mean == drawn.mean
    assert computed.low == pytest.approx(drawn.low, abs=0.1 * width)
    assert computed.high == pytest.approx(drawn.high, abs=0.1 * width)


def test_the_interval_covers_the_mean_as_often_as_it_says(monkeypatch):
    """Also of few values: the plain bootstrap interval covers 82 % with 5."""
    monkeypatch.setattr(stats, "_RESAMPLES", 1_000)
    rng = np.random.default_rng(5)
    intervals = [mean_interval(rng.normal(size=5)) for _ in range(1_000)]
    assert 0.90 <= np.mean([interval.low <= 0 <= interval.high for interval in intervals]) <= 0.98


def test_intervals_of_groups_hold_where_those_of_single_values_are_too_narrow(monkeypatch):
    """30 groups of 20: the rate of a group is uniform, so that values of one group are alike; the true rate is 1/2."""
    monkeypatch.setattr(stats, "_RESAMPLES", 500)
    rng, groups = np.random.default_rng(0), np.repeat(np.arange(30), 20)
    held = np.zeros(3)
    for _ in range(200):
        values = (rng.random(600) < rng.random(30)[groups]).astype(float)
        found = rate_interval(values, groups), mean_interval(values, groups=groups), rate_interval(values)
        held += [interval.low <= 0.5 <= interval.high for interval in found]
    assert (held[:2] / 200 > 0.89).all()
    assert held[2] / 200 < 0.7


def test_groups_of_one_and_independent_values_change_nothing():
    values = (np.random.default_rng(1).random(200) < 0.3).astype(float)
    assert rate_interval(values, np.arange(200)[::-1]) == rate_interval(values)
    assert mean_interval(values, groups=np.arange(200)[::-1]) == mean_interval(values)
    alike = rate_interval(values, np.arange(200) // 4)  # groups by chance
    assert alike.high - alike.low < 1.4 * (rate_interval(values).high - rate_interval(values).low)
    assert rate_interval(np.ones(60), np.arange(60) % 6) == rate_interval(np.ones(6))  # a group counts as one value


@given(st.floats(-1e6, 1e6), st.lists(st.integers(1, 6), min_size=1, max_size=8))
def test_equal_values_in_groups_of_several_sizes_have_no_interval(value, sizes):
    groups = np.repeat(np.arange(len(sizes)), sizes)
    assert mean_interval([value] * len(groups), groups=groups) == (value, value, value)


@given(st.lists(st.integers(-3, 3), min_size=1, max_size=10))
def test_the_p_value_of_few_differences_is_exact(differences):
    sums = np.array([0])
    for each in differences:
        sums = np.concatenate([sums + each, sums - each])
    assert paired_test(differences) == pytest.approx(np.mean(np.abs(sums) >= abs(sum(differences))))


@pytest.mark.parametrize("shift", [0.0, 0.4])
def test_the_p_value_of_many_differences_is_that_of_random_signs(shift, monkeypatch):
    sample = np.random.default_rng(5).normal(shift, 1.0, 30)
    signs = np.random.default_rng(2).choice([-1.0, 1.0], size=(20_000, 30))
    slow = (np.abs(signs @ sample) >= abs(sample.sum())).mean()
    assert paired_test(sample) == pytest.approx(slow, abs=0.02)
    assert paired_test(-sample) == pytest.approx(paired_test(sample), abs=0.02)
    many = np.random.default_rng(6).normal(shift / 20, 1.0, 5_001)
    limit = paired_test(many)
    monkeypatch.setattr(stats, "_MAX_RESAMPLED", 5_001)
    monkeypatch.setattr(stats, "_RESAMPLES", 2_000)
    assert paired_test(many) == pytest.approx(limit, abs=0.04)


def test_no_p_value_is_zero_and_those_of_no_difference_and_of_one_are_one():
    assert paired_test(np.arange(1, 60)) == pytest.approx(2 / 10_000)  # as large as one of 9,999 and itself, two sides
    assert paired_test([0.0, 0.0]) == paired_test([2.0]) == 1.0
    assert paired_test([1.0, 1.0]) == 0.5  # two of four sign changes are as large


def test_holm_is_its_definition():
    assert holm([0.01, 0.04, 0.03, 0.005]) == pytest.approx([0.03, 0.06, 0.06, 0.02])
    assert holm([0.7, 0.6]) == [1.0, 1.0]
    assert holm([]) == []
