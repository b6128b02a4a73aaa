"""The parts of follow-mixture against slow definitions and properties."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mixture_windows import problem, swarm_window
from scipy.integrate import quad
from scipy.stats import vonmises_fisher

from detectors.follow_mixture.evidence import FeatureKind, affordable_kinds, gain_and_chance, pairwise_gain
from detectors.follow_mixture.facility import LEAST_VOTERS, locate_heads
from detectors.follow_mixture.likelihood import Noise, fit_directions, log_normaliser, natural_parameters
from detectors.follow_mixture.noise import fit_spectra, smoothed_pasts
from detectors.follow_mixture.samples import samples_of
from detectors.follow_mixture.search import explained_by_reach, misfit, within_reach
from detectors.follow_mixture.strategy import (
    Library,
    directions,
    fit_strategy,
    gain_matrix,
    head_features,
    pair_features,
)
from detectors.policy import Policy, choose


def test_rows_are_the_velocities_and_what_came_before():
    window, _ = swarm_window(0)
    samples = samples_of(window, np.arange(window.uavs), 4)
    assert samples.unit
    assert samples.complete
    for row, uav in ((0, 3), (17, 5), (samples.rows - 1, 29)):
        t = row + 4
        np.testing.assert_allclose(samples.target[uav, row] * samples.speed, window.velocity[t, uav], rtol=1e-5)
        np.testing.assert_allclose(samples.lagged[uav, row, 2] * samples.speed, window.velocity[t - 3, uav], rtol=1e-5)
        np.testing.assert_array_equal(samples.position[uav, row], window.position[t - 1, uav])


@given(st.floats(1e-3, 300.0))
@settings(deadline=None, max_examples=25)
def test_directions_are_judged_by_the_von_mises_fisher_density(kappa):
    law = vonmises_fisher([0, 0, 1.0], kappa)
    y = np.array([0.6, 0, 0.8])
    ours = float(log_normaliser(np.array([kappa]))[0] + kappa * (y[2] - 1.0))
    assert ours == pytest.approx(float(law.logpdf(y)) + np.log(4 * np.pi), abs=1e-6)
    # it is a density: its mean over the sphere is 1
    mean, _ = quad(lambda z: 0.5 * np.exp(log_normaliser(np.array([kappa]))[0] + kappa * (z - 1.0)), -1, 1, limit=200)
    assert mean == pytest.approx(1.0, rel=1e-3)


def test_natural_parameters_spread_by_the_length_of_the_raw_direction():
    direction = np.array([[2.0, 0, 0], [0.5, 0, 0]])
    theta, constant = natural_parameters(direction, Noise(0.1, 0.0, True))
    np.testing.assert_allclose(theta[:, 0], [400.0, 25.0])
    np.testing.assert_allclose(constant, log_normaliser(np.array([400.0, 25.0])) - [400.0, 25.0])


@pytest.mark.parametrize("isotropic", [False, True])
def test_the_raw_direction_is_found_behind_the_norm(isotropic):
    rng = np.random.default_rng(0)
    features = np.concatenate([rng.standard_normal((600, 6)), np.ones((600, 1))], axis=1)
    truth = np.zeros((7, 3))
    truth[:3], truth[3:6] = 2.0 * np.eye(3), -1.0 * np.eye(3)
    raw = features @ truth
    flights = raw + 0.05 * np.sqrt((raw**2).sum(axis=1).mean()) * rng.standard_normal(raw.shape)
    flights /= np.linalg.norm(flights, axis=1, keepdims=True)
    found, noise = fit_directions(features, flights, np.ones(600), True, isotropic=isotropic)
    scale = np.sqrt((raw**2).sum(axis=1).mean())
    np.testing.assert_allclose(found, truth / scale, atol=0.02)
    assert noise.spread == pytest.approx(0.05, rel=0.25)


def brute_force(gain, price):
    """The best value over all sets of heads."""
    uavs = len(gain)
    best, found = 0.0, ()
    for count in range(1, 4):
        for heads in itertools.combinations(range(uavs), count):
            followers = np.setdiff1d(np.arange(uavs), heads)
            gained = np.maximum(gain[np.ix_(followers, heads)], 0.0)
            value = gained.max(axis=1).sum() - price * count
            if count > 1:
                value -= np.log(count) * np.count_nonzero(gained.max(axis=1))
            votes = np.bincount(gained.argmax(axis=1)[gained.max(axis=1) > 0], minlength=count)
            if votes.min() >= LEAST_VOTERS and value > best:
                best, found = value, heads
    return best, found


@given(st.integers(0, 10_000))
@settings(deadline=None, max_examples=20)
def test_heads_are_located_as_by_trying_all_sets(seed):
    rng = np.random.default_rng(seed)
    gain = rng.normal(-2.0, 2.0, (9, 9))
    gain[[1, 2, 3], 0] += 12
    gain[[5, 6, 7], 4] += 12
    np.fill_diagonal(gain, 0.0)
    value, heads = brute_force(gain, 3.0)
    found = locate_heads(gain, np.arange(9), 3.0)
    assert found.value == pytest.approx(value, abs=1e-9)
    assert tuple(found.heads) == heads
    assert (found.leader[found.heads] == -1).all()


@given(st.integers(0, 1000))
@settings(deadline=None, max_examples=15)
def test_no_head_stands_without_followers(seed):
    gain = np.random.default_rng(seed).normal(0.0, 3.0, (12, 12))
    np.fill_diagonal(gain, 0.0)
    found = locate_heads(gain, np.arange(12), 1.0)
    for head in found.heads:
        assert (found.leader == head).sum() >= LEAST_VOTERS


def test_pairwise_gain_is_the_regression_of_surprises():
    samples, history, _, _ = problem(1, uavs=12, clusters=2, observation_steps=40)
    kind = FeatureKind(2, True, True)
    for shift in (0, 7):
        table = pairwise_gain(samples, history.surprise, kind, shift)
        for i, j in ((0, 1), (4, 9), (11, 3)):
            past = samples.lagged[j, :, :2]
            features = np.concatenate([past.reshape(samples.rows, -1), (past**2).reshape(samples.rows, -1)], axis=1)
            features = features - features.mean(axis=0)
            y = np.roll(history.surprise[i], shift, axis=0)
            gram = features.T @ features
            gram += 1e-3 * np.trace(gram) / len(gram) * np.eye(len(gram))
            explained = np.trace(y.T @ features @ np.linalg.solve(gram, features.T @ y)) / (y**2).sum()
            assert table[i, j] == pytest.approx(-samples.rows * np.log1p(-explained), rel=2e-3)


def test_chance_is_what_some_voters_gain_at_a_wrong_time():
    samples, history, _, _ = problem(3)
    kind = FeatureKind(4, True, True)
    gain, chance = gain_and_chance(samples, history.surprise, kind)
    np.testing.assert_allclose(gain, pairwise_gain(samples, history.surprise, kind), rtol=1e-4, atol=1e-3)
    wrong = pairwise_gain(samples, history.surprise, kind, samples.rows // 2)
    assert chance == pytest.approx(np.median(wrong.max(axis=1)), rel=1e-4)  # 30 UAVs: all are asked
    assert np.median(gain.max(axis=1)) > 2.0 * chance


def test_gain_is_the_difference_of_two_log_likelihoods():
    samples, history, leader, _ = problem(2, follow="f2", miss_rate=0.1)
    strategy = fit_strategy(samples, leader, Library(4, squares=True))
    columns = np.unique(leader[leader >= 0])
    table = gain_matrix(samples, history, strategy, columns)
    i, k = int(np.flatnonzero(leader == columns[1])[0]), 1
    total = 0.0
    for row in range(samples.rows):
        if not (samples.seen[i, row] and samples.lag_seen[columns[k], row].all()):
            continue
        past = samples.lagged[columns[k], row]
        features = np.concatenate([past.ravel(), (past**2).ravel(), [1.0]])
        direction = features @ strategy.coefficients
        kappa = 1.0 / (strategy.noise.floor**2 + strategy.noise.spread**2 / (direction @ direction))
        along = direction @ samples.target[i, row] / np.linalg.norm(direction)
        total += float(log_normaliser(np.array([kappa]))[0]) + kappa * (along - 1.0)
        total -= history.log_likelihood[i, row]
    assert table[i, k] == pytest.approx(total, rel=1e-6)


@pytest.mark.parametrize("follow", ["f1", "f3", "f5"])
def test_a_strategy_in_its_class_leaves_only_noise(follow):
    samples, _, leader, _ = problem(3, follow=follow)
    strategy = fit_strategy(samples, leader, Library(4, squares=True))
    assert misfit(samples, strategy, leader).worst < 1.35


@pytest.mark.parametrize("follow", ["f6", "f7"])
def test_a_strategy_out_of_its_class_shows(follow):
    samples, _, leader, _ = problem(3, follow=follow)
    strategy = fit_strategy(samples, leader, Library(4, squares=True))
    assert misfit(samples, strategy, leader).worst > 2.0


def test_the_reach_is_found():
    samples, _, leader, _ = problem(27, follow="f6", clusters=5, uavs=82)
    library = Library(4, squares=True, towards=True)
    found = within_reach(samples, leader, library)
    assert found.library.reach == pytest.approx(60.0, rel=0.01)
    assert found.noise.spread < 0.6 * fit_strategy(samples, leader, library).noise.spread


def test_what_a_reach_explains_is_the_regression_with_its_column():
    samples, _, leader, _ = problem(27, follow="f6", clusters=5, uavs=82)
    library = Library(4, squares=True, towards=True)
    followers = np.flatnonzero(leader >= 0)
    strategy = fit_strategy(samples, leader, library)
    reaches = np.array([40.0, 60.0, 90.0])
    fast = explained_by_reach(samples, strategy, followers, leader[followers], reaches)
    direction, _ = directions(samples, strategy, followers, leader[followers])
    target = (samples.target[followers] * np.linalg.norm(direction, axis=2, keepdims=True)).reshape(-1, 3)

    def left(reach):
        kind = replace(library, reach=reach)
        shared, _ = head_features(samples, kind, leader[followers])
        own, _ = pair_features(samples, kind, followers, leader[followers])
        columns = np.concatenate([own, shared], axis=2).reshape(len(target), -1)
        # Squares of a velocity at one speed add up to a constant but for rounding, which is no column.
        return ((target - columns @ np.linalg.lstsq(columns, target, rcond=1e-6)[0]) ** 2).sum()

    np.testing.assert_allclose(fast, [left(0.0) - left(reach) for reach in reaches], rtol=1e-4)


def test_the_true_strategy_is_recovered():
    samples, _, leader, _ = problem(4, follow="f2")
    strategy = fit_strategy(samples, leader, Library(4, squares=True))
    weights = strategy.coefficients[:6] / strategy.coefficients[:6].max()
    np.testing.assert_allclose(weights, np.concatenate([np.eye(3), np.eye(3)]), atol=0.06)
    assert np.abs(strategy.coefficients[6:]).max() < 0.06 * strategy.coefficients[:6].max()


@pytest.mark.parametrize("noise", [0.3, 1.0])
def test_noise_is_told_from_flight(noise):
    window, _ = swarm_window(5, position_noise=noise, mobility="gauss_markov", head_jitter=True)
    samples = samples_of(window, np.arange(window.uavs), 4)
    velocity = np.concatenate([samples.lagged[:, 0, ::-1], samples.target], axis=1)
    assert np.sqrt(fit_spectra(velocity).noise) * samples.speed == pytest.approx(noise, rel=0.2)


def test_smoothed_pasts_know_nothing_of_the_present():
    window, _ = swarm_window(6, position_noise=0.5)
    samples = samples_of(window, np.arange(window.uavs), 4)
    velocity = np.concatenate([samples.lagged[:, 0, ::-1], samples.target], axis=1)
    spectra = fit_spectra(velocity)
    lagged = smoothed_pasts(samples, velocity, spectra)
    # the definition: the expectation of v at t - 2 given all that was seen before t, under the fitted spectrum
    steps, uav, row, lag = velocity.shape[1], 7, 40, 2
    t = row + 4
    mean = velocity[uav].mean(axis=0)
    flight = spectra.flight(steps)[uav]
    seen = (flight + spectra.seen(steps))[:t, :t]
    expected = mean + flight[t - lag, :t] @ np.linalg.solve(seen, velocity[uav, :t] - mean)
    np.testing.assert_allclose(lagged[uav, row, lag - 1], expected, atol=1e-8)


def test_short_windows_get_poor_features():
    assert affordable_kinds(96, 4)[0].width == 24
    assert all(kind.width <= 6 for kind in affordable_kinds(17, 3))
    assert affordable_kinds(4, 4)


@given(st.integers(0, 10_000), st.floats(0.0, 3.0))
@settings(deadline=None, max_examples=30)
def test_the_policy_costs_least(seed, price):
    rng = np.random.default_rng(seed)
    probability = rng.beta(0.3, 0.5, 6)
    alive = np.ones(6, bool)
    named = choose(probability, alive, Policy(redundancy_price=price, round_price=1.0), rng.random(6))

    def cost(some):
        rest = np.setdiff1d(np.arange(6), some)
        return 1.0 - np.prod(1.0 - probability[rest]) + price / 6 * (1.0 - probability[list(some)]).sum()

    costs = [cost(some) for count in range(1, 7) for some in itertools.combinations(range(6), count)]
    assert cost(np.flatnonzero(named)) == pytest.approx(min(costs), abs=1e-9)


def test_the_policy_keeps_to_its_budget_and_to_the_living():
    probability = np.array([0.9, 0.8, 0.7, 0.2])
    alive = np.array([True, False, True, True])
    tie = np.zeros(4)
    assert choose(probability, alive, Policy(shot_budget=1), tie).tolist() == [True, False, False, False]
    assert choose(probability, alive, Policy(policy="map"), tie).tolist() == [True, False, True, False]
    assert choose(probability, alive, Policy(objective="P1"), tie).tolist() == [True, False, False, False]
    assert not choose(np.full(4, 0.1), alive, Policy(policy="map"), tie).any()
    assert choose(np.full(4, 0.001), alive, Policy(), tie).sum() >= 1
    assert not choose(probability, np.zeros(4, bool), Policy(), tie).any()


def test_what_turns_as_two_velocities_do_is_in_the_class_of_turns():
    """The features of turned velocities are the turned features; the next move of who keeps turning is one of them."""
    samples, _, _, _ = problem(3)
    library = Library(2, linear=False, turns=True, isotropic=True)
    rng = np.random.default_rng(0)
    turn, _ = np.linalg.qr(rng.standard_normal((3, 3)))
    turn *= np.sign(np.linalg.det(turn))
    plain, turned = (
        head_features(replace(samples, lagged=lagged), library)[0][..., :-1].reshape(30, samples.rows, 9, 3)
        for lagged in (samples.lagged, samples.lagged @ turn.T)
    )
    np.testing.assert_allclose(turned, plain @ turn.T, atol=1e-6)
    newest, before = samples.lagged[:, :, 0], samples.lagged[:, :, 1]
    onwards = 2.0 * np.vecdot(newest, before)[..., None] * newest - before
    np.testing.assert_allclose(2.0 * plain[:, :, 3] - plain[:, :, 1], onwards, atol=1e-6)
    assert library.name == "turns+isotropic(2)"
