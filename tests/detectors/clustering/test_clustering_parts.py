"""Features, affinities and the factorisation, each against a slow reference."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from swarm_windows import swarm_window

from detectors.clustering.affinity import (
    compute_affinity,
    compute_cosine_affinity,
    compute_lag_affinity,
    compute_rbf_affinity,
    correlate_both_ways,
)
from detectors.clustering.features import (
    collect_velocity_series,
    compute_features,
    compute_raw_features,
    compute_scaled_features,
)
from detectors.clustering.partitions import factorise_affinity
from usnet_env import Window


def slow_lag_correlation(series, max_lag, shift=0):
    n, steps, _ = series.shape
    moved = series - series.mean(axis=1, keepdims=True)
    moved = moved / np.sqrt((moved**2).sum(axis=(1, 2), keepdims=True))
    other = np.roll(moved, shift, axis=1)
    result = np.full((n, n), -np.inf)
    for i in range(n):
        for j in range(n):
            for tau in range(-max_lag, max_lag + 1):
                total = sum(moved[i, t + tau] @ other[j, t] for t in range(steps) if 0 <= t + tau < steps)
                result[i, j] = max(result[i, j], total)
    return np.maximum(result, result.T)


@pytest.mark.parametrize("max_lag", [0, 1, 3])
def test_lag_correlation_is_the_best_over_lags_in_both_directions(max_lag):
    series = np.random.default_rng(0).standard_normal((5, 12, 3)) + 4.0
    np.testing.assert_allclose(correlate_both_ways(series, max_lag), slow_lag_correlation(series, max_lag), atol=1e-12)
    np.testing.assert_allclose(
        correlate_both_ways(series, max_lag, surrogate=True), slow_lag_correlation(series, max_lag, shift=6), atol=1e-12
    )


def test_lag_affinity_finds_a_repeated_series_and_subtracts_chance():
    rng = np.random.default_rng(1)
    series = rng.standard_normal((40, 100, 3))
    series[1, 3:] = series[0, :-3]
    affinity = compute_lag_affinity(series, 4)
    assert affinity[0, 1] == affinity[1, 0] > 0.9
    others = affinity[2:, 2:][~np.eye(38, dtype=bool)]
    assert np.mean(others > 0) < 0.05
    assert compute_lag_affinity(series, 2)[0, 1] < 0.2  # out of reach


@settings(max_examples=30, deadline=None)
@given(st.integers(1, 9), st.integers(1, 9), st.integers(1, 3), st.integers(0, 6), st.integers(0, 2**31))
def test_every_affinity_is_symmetric_from_0_to_1(n, steps, width, max_lag, seed):
    series = np.random.default_rng(seed).standard_normal((n, steps, width)).round(1)
    for affinity in ("lag", "rbf", "cosine", None):
        values = compute_affinity(affinity, series, max_lag)
        assert values.shape == (n, n)
        assert values.min() >= 0
        assert values.max() <= 1
        np.testing.assert_allclose(values, values.T, atol=1e-12)
        assert np.array_equal(np.diag(values), np.ones(n))


def test_rbf_and_cosine_are_their_formulas():
    features = np.random.default_rng(2).standard_normal((12, 4)) + 100.0
    squared = ((features[:, None] - features) ** 2).sum(axis=2)
    width = np.sqrt(np.sort(squared, axis=1)[:, 7])
    np.testing.assert_allclose(compute_rbf_affinity(features, 0), np.exp(-squared / np.outer(width, width)))
    moved = features - features.mean(axis=0)
    cosines = moved @ moved.T / np.linalg.norm(moved, axis=1) / np.linalg.norm(moved, axis=1)[:, None]
    np.testing.assert_allclose(compute_cosine_affinity(features, 0), np.maximum(cosines, 0.0), atol=1e-12)


def test_features_are_the_last_samples_of_the_window():
    window, _, _ = swarm_window(0, clusters=2, uavs=9)
    values = compute_raw_features(window, 3).reshape(9, 3, 6)
    np.testing.assert_array_equal(values[..., :3], window.position[-4:-1].swapaxes(0, 1))
    np.testing.assert_array_equal(values[..., 3:], window.velocity[-3:].swapaxes(0, 1))
    standard = compute_scaled_features(window, 3).reshape(-1, 6)
    np.testing.assert_allclose(standard.mean(axis=0), 0, atol=1e-9)
    np.testing.assert_allclose(standard.std(axis=0), 1)
    np.testing.assert_array_equal(collect_velocity_series(window, 3), window.velocity.swapaxes(0, 1))
    assert compute_raw_features(window, 1000).shape == (9, 600)


def test_holes_are_filled_and_the_destroyed_are_0():
    rng = np.random.default_rng(3)
    position = np.cumsum(rng.standard_normal((6, 4, 3)), axis=0).astype(np.float32)
    seen = np.ones((6, 4), bool)
    seen[2, 0] = False  # a hole
    seen[[0, 5], 1] = False  # both ends
    seen[:, 2] = False  # never seen
    alive = np.array([True, True, True, False])
    seen &= alive
    there = (seen[1:] & seen[:-1])[..., None]
    window = Window(position * seen[..., None], np.diff(position, axis=0) * there, seen, alive)
    rows = compute_features("raw", window, 5).reshape(4, 5, 6)
    np.testing.assert_allclose(rows[0, 2, :3], (position[1, 0] + position[3, 0]) / 2, rtol=1e-5)
    np.testing.assert_allclose(rows[1, 0, :3], position[1, 1])
    np.testing.assert_allclose(rows[2], rows[:2].mean(axis=0), rtol=1e-5)
    assert not rows[3].any()
    flight = compute_features("velocities", window, 5)
    np.testing.assert_allclose(flight[0, 1], (position[3, 0] - position[1, 0]) / 2, rtol=1e-5)


@settings(max_examples=40, deadline=None)
@given(st.integers(2, 12), st.integers(1, 5), st.integers(0, 2**31), st.booleans())
def test_the_loss_of_the_factorisation_never_rises_and_is_what_it_says(n, rank, seed, definite):
    rng = np.random.default_rng(seed)
    half = rng.random((n, n)) * (rng.random((n, n)) > 0.3)
    affinity = half @ half.T / n if definite else np.maximum(half, half.T)
    factor, losses = factorise_affinity(affinity, rank, rng, steps=60)
    assert factor.shape == (n, rank)
    assert (factor >= 0).all()
    assert (np.diff(losses) <= 0).all()
    slow = ((affinity - factor @ factor.T) ** 2).sum()
    np.testing.assert_allclose(losses[-1], slow, rtol=1e-6, atol=1e-9 * (1 + (affinity**2).sum()))


def test_the_factorisation_finds_blocks_and_a_stationary_point():
    owner = np.repeat([0, 1, 2], [5, 8, 4])
    affinity = (owner[:, None] == owner).astype(float)
    best = min(
        (factorise_affinity(affinity, 3, np.random.default_rng(s), 2000, 0.0) for s in range(5)), key=lambda f: f[1][-1]
    )
    factor = best[0]
    assert best[1][-1] < 1e-4
    assert len(set(zip(owner, factor.argmax(axis=1), strict=True))) == 3
    gradient = 4 * (factor @ (factor.T @ factor) - affinity @ factor)
    assert np.abs(factor * gradient).max() < 1e-2
