"""Explained energies by Cholesky roots against least squares."""

import numpy as np
import pytest

from detectors.series.projections import explain_each, explain_exactly, orthonormalise, project


def make_features(uavs=3, width=5, rows=40, seed=0):
    """Features ``(k, p, R)``; the last row of the first UAV is the sum of all others."""
    features = np.random.default_rng(seed).standard_normal((uavs, width, rows))
    features[0, -1] = features[0, :-1].sum(axis=0)
    return features


def explained(design, target):
    """Energy of ``target (R, a)`` that columns ``(R, p)`` explain."""
    return float(((design @ np.linalg.lstsq(design, target, rcond=None)[0]) ** 2).sum())


@pytest.mark.parametrize("uavs", [0, 3])
def test_projections_of_a_class_hold_what_its_features_explain(uavs):
    features = make_features()[:uavs]
    target = np.random.default_rng(1).standard_normal((40, 2, 4))
    columns = {"some": np.array([0, 2]), "all": np.arange(5)}
    found = dict(project(features, columns, target.astype(np.float32)))
    assert list(found) == list(columns)
    for name, used in columns.items():
        assert found[name].shape == (uavs, len(used), 2, 4)
        for k in range(uavs):
            expected = [explained(features[k, used].T, target[:, :, c]) for c in range(4)]
            np.testing.assert_allclose((found[name][k] ** 2).sum(axis=(0, 1)), expected, rtol=1e-3)
    assert not list(project(features, {}, target.astype(np.float32)))


def test_few_features_are_compared_beyond_the_own_past_of_each_target():
    features, rng = make_features(width=3)[1:], np.random.default_rng(2)
    weight = rng.uniform(0.5, 1.0, (40, 4))
    own = np.linalg.qr(rng.standard_normal((4, 40, 2)))[0]
    innovation = rng.standard_normal((4, 40, 3))
    innovation -= own @ (own.transpose(0, 2, 1) @ innovation)
    both = np.concatenate([innovation, own], axis=2).transpose(1, 2, 0) * weight[:, None]
    found = explain_exactly(features, both.astype(np.float32), (weight**2).astype(np.float32))
    for c in range(4):
        for k in range(2):
            weighted = (features[k] * weight[:, c]).T
            expected = explained(weighted - own[c] @ (own[c].T @ weighted), innovation[c])
            assert found[c, k] == pytest.approx(expected, rel=1e-3)


def test_the_energy_of_pairs_is_a_quadratic_form():
    features = make_features(4)[1:]
    gram = features @ features.transpose(0, 2, 1)
    moment = np.random.default_rng(3).standard_normal((3, 5, 2))
    before = gram.copy(), moment.copy()
    expected = (moment * np.linalg.solve(gram, moment)).sum(axis=(1, 2))
    np.testing.assert_allclose(explain_each(gram, moment), expected, rtol=1e-9)
    assert np.array_equal(gram, before[0])
    assert np.array_equal(moment, before[1])


def test_the_ridge_is_too_small_to_matter_and_large_enough_for_features_that_depend_on_each_other():
    """A feature is the sum of others: in single precision, without a ridge, a division by 0 would explain anything."""
    features, rng = make_features(4, 3, 200), np.random.default_rng(4)
    white = orthonormalise(features[1:])
    np.testing.assert_allclose(white @ white.transpose(0, 2, 1), np.broadcast_to(np.eye(3), (3, 3, 3)), atol=3e-5)
    target = rng.standard_normal((200, 3, 4))
    found = explain_exactly(features, target.astype(np.float32), np.ones((200, 4), np.float32))
    expected = [[explained(features[k].T, target[:, :, c]) for k in range(4)] for c in range(4)]
    np.testing.assert_allclose(found, expected, rtol=1e-3)
    (_, product), *_ = project(features, {"all": np.arange(3)}, target.astype(np.float32))
    np.testing.assert_allclose((product**2).sum(axis=(1, 2)).T, expected, rtol=1e-3)
