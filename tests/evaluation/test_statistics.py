from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import binomtest, bootstrap, norm, permutation_test, t, trim_mean

from usnet_env.config import ArgumentError
from usnet_env.evaluation import statistics
from usnet_env.evaluation.statistics import holm, interquartile_mean, mean_interval, paired_test, rate_interval

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


@given(NUMBERS, st.integers(1, 20))  # one value has no interval: [mean, mean] stands for it
def test_equal_values_have_no_width(value, n):
    assert mean_interval([value] * n) == (value, value, value)


def test_the_bootstrap_agrees_with_scipy_s_percentile_one_at_the_wider_level():
    sample = np.random.default_rng(3).exponential(size=60)
    ours = mean_interval(sample)
    level = 2 * norm.cdf(np.sqrt(60 / 59) * t.ppf(0.975, 59)) - 1
    theirs = bootstrap(
        (sample,), np.mean, method="percentile", confidence_level=level, rng=np.random.default_rng(1)
    ).confidence_interval
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


@pytest.mark.parametrize(("n", "share"), [(3, 0.75), (4, 0.88), (5, 0.92), (7, 0.945), (10, 0.945), (40, 0.95)])
def test_the_interval_covers_the_mean_about_as_often_as_it_says(n, share):
    """Of few values too; below 7, no interval between the least and the largest value can."""
    rng = np.random.default_rng(n)
    intervals = [mean_interval(rng.normal(size=n), seed=trial) for trial in range(400)]
    covered = sum(interval.low <= 0 <= interval.high for interval in intervals)
    assert abs(covered / 400 - share) < 3 * np.sqrt(share * (1 - share) / 400)


@pytest.mark.parametrize(("tasks", "n"), [(1, 5), (3, 3), (3, 5), (10, 3)])
def test_the_interval_of_the_interquartile_mean_covers_that_of_all_values(tasks, n):
    rng = np.random.default_rng(n)
    intervals = [interquartile_mean(rng.normal(size=(tasks, n)), seed=trial) for trial in range(300)]
    covered = sum(interval.low <= 0 <= interval.high for interval in intervals)
    assert 0.9 <= covered / 300 <= 0.99


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


@given(st.lists(st.booleans(), min_size=2, max_size=40), st.integers(2, 8))
def test_copies_of_a_value_in_one_group_add_nothing(hits, copies):
    groups = np.repeat(np.arange(len(hits)), copies)
    copied = np.repeat(np.array(hits, float), copies)
    assert rate_interval(copied, groups) == pytest.approx(rate_interval(np.array(hits, float)), abs=1e-12)
    assert mean_interval(copied, groups=groups) == pytest.approx(mean_interval(np.array(hits, float)), abs=1e-12)


def test_intervals_of_groups_hold_where_those_of_single_values_are_too_narrow():
    """30 groups of 20: the rate of a group is uniform, so that values of one group are alike; the true rate is 1/2."""
    rng, groups = np.random.default_rng(0), np.repeat(np.arange(30), 20)
    held = np.zeros(3)
    for _ in range(300):
        values = (rng.random(600) < rng.random(30)[groups]).astype(float)
        for k, found in enumerate(
            (rate_interval(values, groups), mean_interval(values, groups=groups), rate_interval(values))
        ):
            held[k] += found.low <= 0.5 <= found.high
    assert (held[:2] / 300 > 0.91).all()
    assert held[2] / 300 < 0.7


def test_groups_of_one_and_independent_values_change_nothing():
    values = (np.random.default_rng(1).random(200) < 0.3).astype(float)
    assert rate_interval(values, np.arange(200)[::-1]) == rate_interval(values)
    assert mean_interval(values, groups=np.arange(200)[::-1]) == mean_interval(values)
    alike = rate_interval(values, np.arange(200) // 4)  # groups by chance
    assert alike.high - alike.low < 1.4 * (rate_interval(values).high - rate_interval(values).low)


@given(st.floats(-1e6, 1e6), st.lists(st.integers(1, 6), min_size=1, max_size=8))
def test_equal_values_in_groups_of_several_sizes_have_no_interval(value, sizes):
    groups = np.repeat(np.arange(len(sizes)), sizes)
    assert mean_interval([value] * len(groups), groups=groups) == (value, value, value)


def test_where_all_are_equal_a_group_counts_as_one_value():
    assert rate_interval(np.ones(60), np.arange(60) % 6) == rate_interval(np.ones(6))
    with pytest.raises(ArgumentError, match="groups must have one entry for each of the 3 values, got 2"):
        rate_interval([0, 1, 1], [0, 1])


TASKS = [np.random.default_rng(task).gamma(2, size=n) + task for task, n in enumerate((30, 45, 60))]


def slow_middle_mean(values):
    ranked = sorted(values)
    cut = int(0.25 * len(ranked))
    middle = ranked[cut : len(ranked) - cut]
    return sum(middle) / len(middle)


def slow_profile(tasks, thresholds):
    """rliable's definition, in loops."""
    return [
        sum(sum(1 for value in task if value > threshold) / len(task) for task in tasks) / len(tasks)
        for threshold in thresholds
    ]


def slow_bootstrap(tasks, statistic, resamples, tail=0.025):
    """Draws each task's values on their own, as rliable's StratifiedBootstrap does."""
    rng = np.random.default_rng(11)
    found = [statistic([rng.choice(task, len(task)) for task in tasks]) for _ in range(resamples)]
    return np.quantile(found, [tail, 1 - tail], axis=0)


@given(st.lists(NUMBERS, min_size=1, max_size=40))
def test_the_interquartile_mean_is_scipy_s_and_the_slow_one(values):
    ours = interquartile_mean([values]).mean
    assert ours == pytest.approx(slow_middle_mean(values), rel=1e-9, abs=1e-6)
    assert ours == pytest.approx(trim_mean(values, 0.25), rel=1e-9, abs=1e-6)


def test_the_interval_of_the_interquartile_mean_is_that_of_the_slow_stratified_bootstrap(monkeypatch):
    ours = interquartile_mean(TASKS)
    level = norm.cdf(-np.sqrt(135 / 132) * t.ppf(0.975, 132))
    low, high = slow_bootstrap(TASKS, lambda tasks: slow_middle_mean(np.concatenate(tasks)), 2_000, level)
    assert ours.low == pytest.approx(low, abs=0.06 * (high - low))
    assert ours.high == pytest.approx(high, abs=0.06 * (high - low))
    large = [np.random.default_rng(task).gamma(2, size=3_000) for task in range(2)]
    computed = interquartile_mean(large)
    monkeypatch.setattr(statistics, "_MOST_RESAMPLED", 6_000)
    monkeypatch.setattr(statistics, "_RESAMPLES", 999)
    drawn = interquartile_mean(large)
    width = drawn.high - drawn.low
    assert computed.mean == drawn.mean
    assert computed.low == pytest.approx(drawn.low, abs=0.1 * width)
    assert computed.high == pytest.approx(drawn.high, abs=0.1 * width)


@pytest.mark.parametrize("sign", [1, -1])
def test_a_profile_is_that_of_the_slow_reference(sign):
    thresholds = [3.0, 0.5, 1.0, TASKS[1][7], 100.0, -1.0]  # in any order, and one that is a value
    tasks = [sign * task for task in TASKS]
    ours = statistics.performance_profile(tasks, [sign * each for each in thresholds], lower_is_better=sign == -1)
    assert ours.share == pytest.approx(slow_profile(TASKS, thresholds))
    low, high = slow_bootstrap(TASKS, lambda parts: slow_profile(parts, thresholds), 1_000)
    assert ours.low == pytest.approx(low, abs=0.015)
    assert ours.high == pytest.approx(high, abs=0.015)
    assert ours.thresholds.tolist() == [sign * each for each in thresholds]


@pytest.mark.parametrize("shift", [0.0, 0.5])
def test_the_paired_test_is_scipy_s(shift, monkeypatch):
    sample = np.random.default_rng(5).normal(shift, 1.0, 30)
    theirs = permutation_test(
        (sample,), np.sum, permutation_type="samples", n_resamples=9_999, rng=np.random.default_rng(2)
    )
    assert paired_test(sample) == pytest.approx(theirs.pvalue, abs=0.02)
    many = np.random.default_rng(6).normal(shift / 20, 1.0, 5_001)
    limit = paired_test(many)
    monkeypatch.setattr(statistics, "_MOST_RESAMPLED", 5_001)
    assert paired_test(many) == pytest.approx(limit, abs=0.02)


def test_the_paired_test_of_no_difference_and_of_one():
    assert paired_test([0.0, 0.0]) == 1.0
    assert paired_test([2.0]) == 1.0
    assert paired_test([1.0, 1.0]) == 0.5  # two of four sign changes are as large


@given(st.lists(st.integers(-3, 3), min_size=1, max_size=13))
def test_the_p_value_of_few_differences_is_exact(differences):
    sums = np.array([0])
    for each in differences:
        sums = np.concatenate([sums + each, sums - each])
    assert paired_test(differences) == np.mean(np.abs(sums) >= abs(sum(differences)))


def test_holm_is_its_definition():
    values = [0.01, 0.04, 0.03, 0.005]
    assert holm(values) == pytest.approx([0.03, 0.06, 0.06, 0.02])
    assert holm([0.7, 0.6]) == [1.0, 1.0]
    assert holm([]) == []
