"""R² of all pairs from matrix products, held against one scikit-learn ridge per pair."""

import numpy as np
import pytest
from sklearn.linear_model import Ridge
from synthetic_windows import flight

from detectors.lagged import regression
from detectors.lagged.regression import pairwise_r2


def features_of(velocity, j, lags, squares):
    steps = len(velocity)
    columns = []
    for lag in range(1, lags + 1):
        past = velocity[lags - lag : steps - lag, j]
        columns += [past, past**2] if squares else [past]
    return np.concatenate(columns, axis=1)


def reference(velocity, lags, squares, ridge, shift=0):
    uavs = velocity.shape[1]
    result = np.empty((uavs, uavs))
    for j in range(uavs):
        x = features_of(velocity, j, lags, squares)
        penalty = ridge * np.sum((x - x.mean(axis=0)) ** 2) / x.shape[1]
        for i in range(uavs):
            y = np.roll(velocity[lags:, i], shift, axis=0)
            rest = y - Ridge(alpha=penalty, solver="svd").fit(x, y).predict(x)
            result[i, j] = 1 - np.sum(rest**2) / np.sum((y - y.mean(axis=0)) ** 2)
    return result


@pytest.mark.parametrize("kind", ["f1", "f4", "none"])
@pytest.mark.parametrize(
    ("lags", "squares", "ridge"), [(4, True, 1e-3), (1, False, 0.0), (2, True, 0.3), (3, False, 1e-2)]
)
def test_agrees_with_one_ridge_per_pair(kind, lags, squares, ridge):
    velocity, _ = flight(np.random.default_rng(1), sizes=(4, 3), steps=60, kind=kind)
    seen = np.ones(velocity.shape[:2], bool)
    explained, freedom = pairwise_r2(velocity, seen, lags, squares, ridge, shifts=(0, 17))
    for index, shift in enumerate((0, 17)):
        np.testing.assert_allclose(explained[index], reference(velocity, lags, squares, ridge, shift), atol=2e-6)
    assert (freedom <= lags * (6 if squares else 3) + 1e-9).all()
    if squares and ridge < 1e-2:  # |v| = 1 takes one square a lag away
        assert ((freedom > 4.75 * lags) & (freedom < 5 * lags)).all()


def test_chunks_do_not_change_the_result(monkeypatch):
    velocity, _ = flight(np.random.default_rng(2))
    seen = np.random.default_rng(3).random(velocity.shape[:2]) > 0.1
    whole, freedom = pairwise_r2(velocity, seen, 4, True, 1e-3)
    monkeypatch.setattr(regression, "_CHUNK_ENTRIES", 1)
    pieces, same = pairwise_r2(velocity, seen, 4, True, 1e-3)
    np.testing.assert_allclose(pieces, whole, atol=1e-6)
    np.testing.assert_allclose(same, freedom)


def test_unseen_targets_are_left_out():
    rng = np.random.default_rng(4)
    velocity, leader = flight(rng, sizes=(5,), steps=200)
    follower = int(np.flatnonzero(leader != np.arange(6))[0])
    seen = np.ones(velocity.shape[:2], bool)
    seen[::7, follower] = False
    noisy = velocity.copy()
    noisy[~seen] = 1e3  # whatever stands there must not be read
    for one in (velocity, noisy):
        explained, _ = pairwise_r2(one, seen, 1, False, 0.0)
        assert explained[0, follower, leader[follower]] > 0.8
    np.testing.assert_allclose(
        pairwise_r2(velocity, seen, 4, True, 1e-3)[0], pairwise_r2(noisy, seen, 4, True, 1e-3)[0], atol=1e-6
    )


def test_without_following_adjusted_r2_is_about_zero():
    velocity, _ = flight(np.random.default_rng(5), sizes=(20, 20), kind="none")
    evidence = regression.regression_evidence(velocity, np.ones(velocity.shape[:2], bool), 4, True, 1e-3)
    for matrix in (evidence.pairs, evidence.surrogate):
        off_diagonal = matrix[~np.eye(len(matrix), dtype=bool)]
        assert abs(off_diagonal.mean()) < 0.005
        assert off_diagonal.std() == pytest.approx(evidence.spread, rel=0.35)
