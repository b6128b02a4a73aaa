"""Innovations, features and evidence of follow-mixture against direct regressions."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize_scalar

from detectors.follow_mixture.evidence import (
    add_rests,
    bayes_factor,
    gather_statistics,
    make_targets,
    own_evidence,
    pair,
)
from detectors.series.features import make_features

LAGS = 2
LABEL = np.array([0, 1, 1, 1, 2, 2, 3, 4, 1, 2])
HEAD_OF = {1: 0, 2: 6}  # UAV 7 is a group of one that follows no UAV
NAMES = ("v(1)", "v(L)", "v+v²+vv(1)", "v+v²+v×v(2)")


def make_problem(seed=0, steps=60):
    """Velocities ``(10, steps, 3)`` of two groups that copy a head, and their pasts ``(10, 2, 3, steps - 2)``."""
    rng = np.random.default_rng(seed)
    velocity = rng.normal(size=(len(LABEL), steps, 3))
    for group, head in HEAD_OF.items():
        for uav in np.flatnonzero(group == LABEL):
            velocity[uav, 1:] = 0.8 * velocity[head, :-1] + 0.3 * velocity[uav, 1:]
    velocity[3, steps // 2] += 6.0  # one sharp turn
    past = np.stack([velocity[:, LAGS - 1 - lag : steps - 1 - lag] for lag in range(LAGS)], axis=1)
    return velocity, past.swapaxes(2, 3)


def regress(design, target):
    """The residuals of least squares."""
    return target - design @ np.linalg.lstsq(design, target, rcond=None)[0]


def weighted_parts(velocity, members):
    """Weighted target ``(R, 3)``, weighted columns of the own past ``(R, z)`` and weights ``(R,)`` of some UAVs."""
    mean = velocity[members].mean(axis=0)
    rows = len(mean) - LAGS
    own_lags = min(max(rows // 12, 1), LAGS)
    known = np.column_stack([np.ones(rows), *(mean[LAGS - 1 - lag : len(mean) - 1 - lag] for lag in range(own_lags))])
    square = (regress(known, mean[LAGS:]) ** 2).sum(axis=1)
    weight = 1.0 / np.sqrt(1.0 + square / (4.0 * np.median(square) / 2.366))
    return mean[LAGS:] * weight[:, None], known * weight[:, None], weight


def members_of(group, uav):
    """The members of a group but the candidate."""
    return np.setdiff1d(np.flatnonzero(group == LABEL), uav)


def all_pairs(velocity):
    """The targets, and every group with every UAV, but a single UAV with itself."""
    group, uav = np.nonzero((np.bincount(LABEL)[:, None] > 1) | (LABEL[None] != np.arange(5)[:, None]))
    return add_rests(make_targets(velocity, LABEL, LAGS), pair(group, uav), velocity)


def test_the_evidence_of_a_pair_is_that_of_a_regression_on_both_pasts():
    velocity, past = make_problem(1)
    targets, pairs = all_pairs(velocity)
    for statistics in gather_statistics(targets, past, pairs, NAMES):
        evidence = own_evidence(targets, pairs, statistics)
        features = make_features(past, [statistics.name])[0].swapaxes(1, 2)
        for group, uav in ((1, 0), (1, 3), (2, 6), (2, 0), (0, 5), (2, 5)):
            (place,) = np.flatnonzero((pairs.group == group) & (pairs.uav == uav))
            target, known, weight = weighted_parts(velocity, members_of(group, uav))
            alone = (regress(known, target) ** 2).sum()
            both = np.column_stack([known, features[uav] * weight[:, None]])
            share = 1.0 - (regress(both, target) ** 2).sum() / alone
            expected = bayes_factor(share, targets.rows[pairs.target[place]], statistics.width, 3)
            assert evidence[place] == pytest.approx(float(expected), rel=1e-3, abs=1e-2)
        assert evidence[(pairs.group == 1) & (pairs.uav == 0)] > 50


@given(st.integers(0, 1000), st.integers(1, 6), st.floats(0.0, 2.0), st.integers(1, 3))
@settings(max_examples=30)
def test_the_bayes_factor_is_the_largest_of_a_g_prior(seed, width, strength, axes):
    """y ~ N(0, s² (I + g P)) for the projection P on the features, with s² integrated over 1 / s²."""
    rng = np.random.default_rng(seed)
    rows = 20
    features = np.linalg.qr(rng.normal(size=(rows, width)))[0]
    y = strength * features @ rng.normal(size=(width, axes)) + rng.normal(size=(rows, axes))

    def evidence(g):
        covariance = np.eye(rows) + g * features @ features.T
        bent = np.sum(y * np.linalg.solve(covariance, y))
        return -0.5 * axes * (np.linalg.slogdet(covariance)[1] + rows * np.log(bent / (y**2).sum()))

    best = max(0.0, -minimize_scalar(lambda x: -evidence(np.exp(x)), (-3.0, 3.0), tol=1e-10).fun)
    share = ((features.T @ y) ** 2).sum() / (y**2).sum()
    assert float(bayes_factor(share, np.float64(rows), width, axes)) == pytest.approx(best, rel=1e-6, abs=1e-6)


def test_features_of_a_row_are_functions_of_its_past():
    past = np.random.default_rng(0).normal(size=(2, 3, 3, 9))

    def features(row):
        newest, before = row[0], row[1]
        x, y, z = newest
        return {
            "v(1)": newest,
            "v²(1)": newest**2,
            "v(L)": row.ravel(),
            "v²(L)": row.ravel() ** 2,
            "v+v²+vv(1)": [*newest, *newest**2, y * z, z * x, x * y],
            "v+v²(L)": [*row.ravel(), *row.ravel() ** 2],
            "v+v²+v×v(2)": [*newest, *before, *newest**2, *before**2, *np.outer(newest, before).ravel()],
        }

    names = list(features(past[0, :, :, 0]))
    for some in (names, *([name] for name in names)):
        values, columns = make_features(past, some)
        assert list(columns) == some
        for name, used in columns.items():
            expected = np.array([[features(uav[:, :, row])[name] for row in range(9)] for uav in past])
            expected = expected - expected.mean(axis=1, keepdims=True)
            np.testing.assert_allclose(values[:, used].swapaxes(1, 2), expected, atol=1e-12)
    assert list(make_features(past[:, :1], ["v(1)", "v(L)", "v+v²(L)", "v+v²+v×v(2)", "v²(1)"])[1]) == ["v(1)", "v²(1)"]
