"""Regressions and correlations of all pairs by matrix products, against one regression or one loop per pair."""

import numpy as np
import pytest
from sklearn.linear_model import Ridge

from detectors.lagged import Granger, LaggedCorrelation, LaggedRegression
from detectors.series.designs import centre_past
from detectors.series.regressions import explain_beyond_own_past, explain_pairs, whiten
from usnet_env.series import centre_columns


def flight(seed, steps=40, uavs=6):
    """Velocities ``(steps, uavs, 3)``: the odd UAVs repeat the one before them two steps later, with noise."""
    rng = np.random.default_rng(seed)
    velocity = rng.standard_normal((steps, uavs, 3))
    velocity[2:, 1::2] = velocity[:-2, : uavs - uavs % 2 : 2] + 0.5 * velocity[2:, 1::2]
    return velocity + rng.standard_normal(3)  # a common drift


def gaps(seed, steps=40, uavs=6, missed=0.15):
    """``(steps, uavs)``: which velocities were seen."""
    return np.random.default_rng([seed, 1]).random((steps, uavs)) >= missed


def design(velocity, seen, lags, squares=False):
    """Centred targets ``(R, n, 3)`` and centred features ``(n, R, p)``."""
    values = np.concatenate([velocity, velocity**2], axis=2) if squares else velocity
    return centre_columns(velocity[lags:], seen[lags:]), centre_past(values, seen, lags)


def directions(seed, steps=60, uavs=5):
    """Velocities of length 1, for which the squares and the intercept are linearly dependent."""
    velocity = flight(seed, steps, uavs)
    return velocity / np.linalg.norm(velocity, axis=2, keepdims=True)


@pytest.mark.parametrize("make", [flight, directions])
@pytest.mark.parametrize(("lags", "squares", "ridge"), [(4, True, 1e-3), (1, False, 0.0), (2, True, 0.3)])
def test_shares_are_those_of_one_ridge_per_pair(make, lags, squares, ridge):
    velocity = make(1, steps=60, uavs=5)
    target, past = design(velocity, np.ones(velocity.shape[:2], bool), lags, squares)
    shifted = np.roll(target, 17, axis=0)
    r2, freedom = explain_pairs(past, (target, shifted), ridge)
    for j, x in enumerate(past):
        model = Ridge(alpha=ridge * np.sum(x**2) / x.shape[1], fit_intercept=False, solver="svd")
        for index, targets in enumerate((target, shifted)):
            for i in range(5):
                y = targets[:, i]
                fit = model.fit(x, y).predict(x)
                assert r2[index, i, j] == pytest.approx(1 - np.sum((y - fit) ** 2) / np.sum(y**2), abs=2e-6)
        singular = np.linalg.svd(x, compute_uv=False) ** 2
        if ridge:
            assert freedom[j] == pytest.approx(np.sum(singular / (singular + model.alpha)), abs=1e-6)


def test_unseen_samples_are_not_read():
    velocity, seen = flight(6), gaps(6)
    wild = np.where(seen[..., None], velocity, 1e3)
    for detector in (LaggedRegression(lags=3), Granger(lags=2, own_lags=1), LaggedCorrelation(max_lag=3)):
        plain, other = (detector.evidence(values, seen) for values in (velocity, wild))
        np.testing.assert_allclose(other.pairs, plain.pairs, atol=1e-6)
        np.testing.assert_allclose(other.surrogate, plain.surrogate, atol=1e-6)


@pytest.mark.parametrize("own_lags", [0, 1, 2])
def test_the_share_beyond_the_own_past_is_the_ratio_of_two_least_squares(own_lags):
    velocity = np.cumsum(flight(7), axis=0)
    velocity -= 0.8 * np.roll(velocity, 1, axis=0)  # with memory
    target, past = design(velocity, gaps(7), 2)
    own = past[:, :, : 3 * own_lags]
    white = whiten(own, ridge=0.0)[0] if own_lags else own
    share = explain_beyond_own_past(target.swapaxes(0, 1), white, whiten(past, ridge=0.0)[0])
    for i in range(6):
        for j in range(6):
            if i == j:
                continue

            def left(features, y=target[:, i]):
                return np.sum((y - features @ np.linalg.lstsq(features, y, rcond=None)[0]) ** 2)

            alone = left(own[i]) if own_lags else np.sum(target[:, i] ** 2)
            assert share[i, j] == pytest.approx(1 - left(np.concatenate([own[i], past[j]], axis=1)) / alone, abs=1e-4)
