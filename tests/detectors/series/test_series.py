"""The one rule for missed samples, regressions of all pairs against one of each pair, and votes."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sklearn.linear_model import Ridge
from synthetic_windows import window_of

from detectors.lagged import EvidenceDetector, Granger, LaggedCorrelation, LaggedRegression
from detectors.series.designs import centre_past
from detectors.series.gaps import fill_gaps
from detectors.series.regressions import explain_beyond_own_past, explain_pairs, whiten
from detectors.series.votes import Evidence, choose_heads, cover_voters
from usnet_env.series import centre_columns


@given(st.integers(0, 2**31), st.integers(1, 15), st.integers(1, 6), st.sampled_from([0.0, 0.3, 0.8, 1.0]))
def test_a_filled_window_has_no_gaps_and_keeps_what_was_seen(seed, steps, uavs, missed):
    rng = np.random.default_rng(seed)
    seen, alive = rng.random((steps + 1, uavs)) >= missed, rng.random(uavs) >= 0.2
    window = window_of(rng.standard_normal((steps, uavs, 3)), seen, alive, round=2)
    filled = fill_gaps(window)
    assert filled.round == window.round
    np.testing.assert_array_equal(filled.alive, window.alive)
    np.testing.assert_array_equal(filled.position[window.seen], window.position[window.seen])
    there = window.velocity_seen
    np.testing.assert_array_equal(filled.velocity[there], window.velocity[there])
    assert not filled.position[:, ~window.alive].any()
    assert not filled.velocity[:, ~window.alive].any()
    if window.seen.any():
        assert filled.seen[:, window.alive].all()
        moved = np.diff(filled.position.astype(float), axis=0)
        np.testing.assert_allclose(filled.velocity[:, window.alive], moved[:, window.alive], atol=1e-4)
    if window.seen[:, window.alive].all():
        assert filled is window


def test_missed_positions_lie_on_the_line_between_their_neighbours():
    velocity, seen = np.random.default_rng(1).standard_normal((6, 3, 3)), np.ones((7, 3), bool)
    whole = window_of(velocity).position
    seen[2:4, 0] = False  # in the middle
    seen[:2, 1] = seen[6, 1] = False  # at both ends
    seen[:, 2] = False  # never seen
    filled = fill_gaps(window_of(velocity, seen))
    for step in (1, 2):
        np.testing.assert_allclose(
            filled.position[1 + step, 0], whole[1, 0] + step / 3 * (whole[4, 0] - whole[1, 0]), atol=1e-6
        )
    for step in (1, 2, 3):
        np.testing.assert_allclose(filled.velocity[step, 0], (whole[4, 0] - whole[1, 0]) / 3, atol=1e-6)
    np.testing.assert_allclose(filled.position[:2, 1], whole[[2, 2], 1], atol=1e-6)
    np.testing.assert_allclose(filled.position[6, 1], whole[5, 1], atol=1e-6)
    assert not filled.velocity[[0, 1, 5], 1].any()
    np.testing.assert_allclose(filled.position[:, 2], filled.position[:, :2].mean(axis=1), atol=1e-6)


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


@pytest.mark.parametrize("exclude_self", [False, True])
def test_ties_of_attention_favour_no_index(exclude_self):
    rng = np.random.default_rng(0)
    even = np.full((5, 5), 0.2)
    counts = np.zeros((5, 5))
    for _ in range(1000):
        counts[np.arange(5), choose_heads(even, exclude_self, rng)] += 1
    if exclude_self:
        assert (np.diag(counts) == 0).all()
        counts = counts[~np.eye(5, dtype=bool)]
    expected = 1000 / (4 if exclude_self else 5)
    assert (np.abs(counts - expected) < 5 * np.sqrt(expected)).all()


def test_a_head_needs_voters_that_no_other_head_explains():
    pairs = np.zeros((9, 9))
    pairs[[1, 2, 3], 0] = 0.9  # three follow 0
    pairs[3, 2] = 0.95  # one of them looks a little more like its fellow
    pairs[[5, 6], 4] = 0.8, 0.7  # two follow 4
    pairs[8, 7] = 0.9  # a single stray voter
    np.fill_diagonal(pairs, -np.inf)
    surrogate = np.zeros((9, 9))
    evidence = Evidence(pairs, surrogate, spread=0.05)
    assert evidence.threshold == pytest.approx(0.15)
    assert (cover_voters(evidence), cover_voters(evidence, most=1)) == ([0, 4], [0])
    assert cover_voters(Evidence(surrogate, surrogate, spread=0.05)) == []

    class Voters(EvidenceDetector):
        def evidence(self, velocity, seen):
            return evidence

    found = Voters().detect(window_of(np.zeros((7, 9, 3))))
    np.testing.assert_allclose(found.scores, [1.8, 0, 0.95, 0, 1.5, 0, 0, 0.9, 0])  # the weighted votes
