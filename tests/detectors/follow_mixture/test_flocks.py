"""Flocks by simultaneous flight, and their heads, against slow definitions."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mixture_windows import swarm_window
from scipy.stats import multivariate_normal
from sklearn.metrics import adjusted_rand_score, homogeneity_score

from detectors.follow_mixture.flock_evidence import flock_gate, flock_posterior
from detectors.follow_mixture.flock_heads import (
    FlockHeads,
    Shown,
    Watch,
    each_by_itself,
    exact_gain,
    fit_flocks,
    fit_weights,
    heads_of_flocks,
    shared_gain,
    shown,
    squared_error,
    watch_flocks,
)
from detectors.follow_mixture.flock_search import flights, flock_search, seen_spectra
from detectors.follow_mixture.flocks import _worth, flocks_of, fourier_coordinates
from detectors.follow_mixture.samples import filled, samples_of
from detectors.follow_mixture.strategy import Library


def watched(seed=0, **config):
    window, truth = swarm_window(seed, **config)
    samples = samples_of(window, np.arange(window.uavs), 4)
    spectra = seen_spectra(samples)
    return samples, watch_flocks(samples, flocks_of(flights(samples), spectra)), truth


@pytest.mark.parametrize("steps", [9, 10])
def test_fourier_coordinates_keep_lengths_and_angles(steps):
    velocity = np.random.default_rng(0).standard_normal((4, steps, 3))
    coordinates, omega = fourier_coordinates(velocity)
    centred = velocity - velocity.mean(axis=1, keepdims=True)
    assert coordinates.shape == (4, steps - 1, 3)
    assert omega.min() > 0
    assert omega.max() <= np.pi + 1e-12
    np.testing.assert_allclose(
        np.einsum("ikx,jkx->ij", coordinates, coordinates), np.einsum("itx,jtx->ij", centred, centred), atol=1e-10
    )


@given(st.integers(0, 1000), st.integers(1, 6), st.floats(0.05, 20.0))
@settings(max_examples=30, deadline=None)
def test_a_flock_is_worth_what_its_joint_normal_law_says(seed, size, ratio):
    """x_i = s + e_i with s ~ N(0, P) and e ~ N(0, 1), coordinate by coordinate."""
    members = np.random.default_rng(seed).standard_normal((size, 1, 3))
    joint = multivariate_normal(np.zeros(size), np.eye(size) + ratio)
    alone = multivariate_normal(np.zeros(size), np.eye(size))
    expected = sum(joint.logpdf(members[:, 0, axis]) - alone.logpdf(members[:, 0, axis]) for axis in range(3))
    worth = _worth(members.sum(axis=0)[None], np.array([float(size)]), np.array([ratio]))
    assert worth[0] == pytest.approx(expected, rel=1e-9, abs=1e-9)


@pytest.mark.parametrize(("follow", "noise"), [("f1", 0.0), ("f4", 0.3), ("f7", 0.0), ("f1", 1.0)])
def test_followers_of_one_head_are_a_flock_and_heads_fly_alone(follow, noise):
    _, watch, truth = watched(11, follow=follow, position_noise=noise, uavs=40)
    followers = ~truth.head
    assert homogeneity_score(truth.leader[followers], watch.label[followers]) > 0.98
    if follow != "f7":  # followers of a network fly alike only where their places are alike
        assert adjusted_rand_score(truth.leader[followers], watch.label[followers]) > 0.9
    sizes = np.bincount(watch.label)
    assert (sizes[watch.label[truth.head]] == 1).mean() >= (0.9 if noise < 1 else 0.0)


def test_nobody_flocks_where_nobody_follows():
    _, watch, _ = watched(12, follow="none")
    assert watch.flocks == watch.uavs


def test_the_flight_of_a_flock_lacks_its_own_past_and_the_member_that_is_asked():
    samples, watch, _ = watched(13, uavs=20)
    member = int(np.flatnonzero(np.bincount(watch.label)[watch.label] > 2)[0])
    fellows = np.setdiff1d(np.flatnonzero(watch.label == watch.label[member]), member)
    rows = samples.rows
    design = np.column_stack([np.ones(rows), samples.lagged[fellows].mean(axis=0).reshape(rows, -1)])
    flight = samples.target[fellows].mean(axis=0)
    expected = flight - design @ np.linalg.lstsq(design, flight, rcond=None)[0]
    np.testing.assert_allclose(watch.flight[watch.flocks + member], expected, atol=1e-8)


@pytest.mark.parametrize("isotropic", [False, True])
def test_errors_and_gains_are_those_of_regressions_on_both_pasts(isotropic):
    samples, watch, truth = watched(14, follow="f3", uavs=20)
    some = shown(samples, Library(2, isotropic=isotropic))
    rng = np.random.default_rng(0)
    weights = rng.standard_normal((6, 3)) if not isotropic else rng.standard_normal(2)
    predicted = some.predicted(weights)
    left = squared_error(watch, predicted)
    for flock, uav in ((0, 1), (0, 5), (int(watch.label[7]), 7)):
        row = watch.watcher(flock, uav)
        past = watch.past[row]
        error = watch.flight[row] - (predicted[uav] - past @ (past.T @ predicted[uav]))
        assert left[flock, uav] == pytest.approx(float((error**2).sum()), rel=1e-8, abs=1e-8)
    flock, uav = int(watch.label[np.flatnonzero(~truth.head)[0]]), int(np.flatnonzero(truth.head)[0])
    row = watch.watcher(flock, uav)
    seen = some.one(uav, watch.past[row])
    flight = watch.flight[row].reshape(len(seen), -1)
    error = flight - seen @ np.linalg.lstsq(seen, flight, rcond=None)[0]
    expected = -1.5 * watch.freedom * np.log((error**2).sum() / (flight**2).sum())
    assert exact_gain(watch, some, flock, uav) == pytest.approx(expected, rel=1e-3)


def test_the_screen_never_says_more_than_the_exact_regression():
    samples, watch, _ = watched(15, follow="f2", uavs=15)
    some = shown(samples, Library(4))
    found = each_by_itself(watch, some, None)
    exact = np.array([[exact_gain(watch, some, c, j) for j in range(15)] for c in range(watch.flocks)])
    assert (found.gain <= exact + 1e-6).all()


def test_one_strategy_for_all_is_recovered_and_climbs():
    samples, watch, truth = watched(16, follow="f3", uavs=40)
    some = shown(samples, Library(4, isotropic=True))
    sizes = np.bincount(watch.label)
    head = np.array(
        [truth.leader[np.flatnonzero(watch.label == c)[0]] if sizes[c] > 1 else -1 for c in range(watch.flocks)]
    )
    weights = fit_weights(watch, some, head, np.ones(watch.flocks))
    np.testing.assert_allclose(weights / weights[0], [1, 1, 1, 0], atol=0.1)  # f3 adds up three velocities
    found = fit_flocks(watch, some, head)
    assert set(found.heads) == set(np.flatnonzero(truth.head))
    led = np.flatnonzero(head >= 0)
    gain = shared_gain(watch, some.predicted(weights))[1]
    assert (gain[led].argmax(axis=1) == head[led]).all()


@pytest.mark.parametrize("follow", ["f1", "f4", "f6", "f7"])
def test_heads_of_flocks_are_the_heads(follow):
    samples, watch, truth = watched(17, follow=follow, uavs=40)
    found = heads_of_flocks(samples, watch)
    assert set(found.heads) == set(np.flatnonzero(truth.head))
    probability = flock_posterior(watch, found, memory=0.0)
    assert probability[truth.head].min() > 0.9
    assert probability[~truth.head].max() < 0.05


def test_a_flock_whose_head_is_gone_accuses_nobody():
    window, truth = swarm_window(18, uavs=40)
    gone = int(np.flatnonzero(truth.head)[0])
    rest = np.setdiff1d(np.arange(40), gone)
    samples = samples_of(window, rest, 4)
    spectra = seen_spectra(samples)
    watch, found = flock_search(samples, spectra, flocks_of(flights(samples), spectra))
    probability = flock_posterior(watch, found, memory=0.0)
    assert (probability > 0.5).sum() == truth.head.sum() - 1
    assert probability[truth.leader[rest] == gone].max() < 0.05


def test_a_few_lone_flights_that_match_are_luck():
    watch = Watch(np.arange(10), np.zeros((20, 30, 3)), np.zeros((20, 30, 1)))  # ten UAVs, each like nobody else
    rng = np.random.default_rng(0)
    values = rng.normal(size=(10, 30, 1, 3))
    shown = Shown(Library(1, isotropic=True), values)
    watch.flight[:10] = 0.1 * rng.normal(size=(10, 30, 3))

    def gate(followers):
        watch.flight[followers] = values[9, :, 0] + 0.01 * rng.normal(size=(len(followers), 30, 3))
        head = np.full(10, -1)
        head[followers] = 9
        found = FlockHeads(head, np.zeros((10, 10)), shown, np.ones(1), 0.0, 0.0)
        return flock_gate(watch, found)

    two, one = gate([0, 1]), gate([0])
    assert two.passed.all()  # two of ten are a fifth
    assert (one.added > 2 * one.chance).all()
    assert not one.passed.any()


@pytest.mark.parametrize(("uavs", "passes"), [(30, True), (60, False)])
def test_a_flock_of_two_in_a_large_swarm_that_matches_is_luck(uavs, passes):
    label = np.concatenate([[0, 0], np.arange(1, uavs - 1)])  # one pair of fellows, and everybody else alone
    flocks = uavs - 1
    rng = np.random.default_rng(1)
    values = rng.normal(size=(uavs, 30, 1, 3))
    flight = np.zeros((flocks + uavs, 30, 3))
    flight[:flocks] = 0.1 * rng.normal(size=(flocks, 30, 3))
    flight[0] = values[9, :, 0] + 0.01 * rng.normal(size=(30, 3))
    head = np.full(flocks, -1)
    head[0] = 9
    watch = Watch(label, flight, np.zeros((flocks + uavs, 30, 1)))
    found = FlockHeads(head, np.zeros((flocks, uavs)), Shown(Library(1, isotropic=True), values), np.ones(1), 0.0, 0.0)
    gate = flock_gate(watch, found)
    assert (gate.added > 2 * gate.chance).all()
    assert gate.passed.all() == passes  # two of sixty are less than a twentieth


def test_at_most_so_many_heads():
    samples, watch, _ = watched(19, uavs=40)
    assert len(heads_of_flocks(samples, watch, most=2).heads) == 2


def test_gaps_are_flown_straight():
    window, _ = swarm_window(20, miss_rate=0.3, uavs=12)
    whole = filled(window)
    assert whole.seen.all()
    kept = window.velocity_seen
    np.testing.assert_array_equal(whole.velocity[kept], window.velocity[kept])
    np.testing.assert_allclose(np.diff(whole.position, axis=0)[~kept], whole.velocity[~kept], atol=1e-3)
    complete, _ = swarm_window(20, uavs=12)
    assert filled(complete) is complete


def test_units_of_noise_do_not_matter():
    samples, watch, _ = watched(21, uavs=20)
    spectra = seen_spectra(samples)
    scaled = replace(spectra, power=4 * spectra.power, noise=4 * spectra.noise)
    assert np.array_equal(flocks_of(2 * flights(samples), scaled).label, watch.label)
