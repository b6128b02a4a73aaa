"""Heads of flocks by the response of flight to flight, against slow definitions."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mixture_windows import swarm_window
from scipy.stats import multivariate_normal

from detectors.follow_mixture.detector import FollowMixture
from detectors.follow_mixture.flock_leads import (
    explained_by_leads,
    joint_density,
    leads_of_flocks,
    responses,
)
from detectors.follow_mixture.flock_search import flights, seen_spectra
from detectors.follow_mixture.flocks import Flocks, flocks_of
from detectors.follow_mixture.noise import FlightSpectra
from detectors.follow_mixture.samples import samples_of

SMOOTH = {"mobility": "gauss_markov", "head_jitter": True, "position_noise": 0.4, "uavs": 40, "clusters": 3}


def flown(seed, **config):
    window, truth = swarm_window(seed, **config)
    samples = samples_of(window, np.arange(window.uavs), 4)
    spectra = seen_spectra(samples)
    velocity = flights(samples)
    return window, truth, velocity, spectra, flocks_of(velocity, spectra)


@given(st.integers(0, 1000), st.floats(0.1, 5.0), st.floats(0.1, 5.0), st.floats(0.0, 0.95), st.floats(0.0, 6.3))
@settings(max_examples=40, deadline=None)
def test_the_joint_density_is_that_of_complex_normals(seed, first, second, coherence, phase):
    """A circular complex normal with covariance C is a real normal of twice the size with C's real form, halved."""
    rng = np.random.default_rng(seed)
    x, y = rng.normal(size=(2, 3)) + 1j * rng.normal(size=(2, 3))
    both = coherence * np.sqrt(first * second) * np.exp(1j * phase)
    covariance = np.array([[first, np.conj(both)], [both, second]])
    real = 0.5 * np.block([[covariance.real, -covariance.imag], [covariance.imag, covariance.real]])
    pairs = np.stack([x.real, y.real, x.imag, y.imag], axis=1)
    expected = multivariate_normal(np.zeros(4), real).logpdf(pairs).sum() + 6.0 * np.log(np.pi)
    found = joint_density(
        (np.abs(x) ** 2).sum(),
        (np.abs(y) ** 2).sum(),
        (y * x.conj()).sum(),
        np.float64(first),
        np.float64(second),
        both,
    )
    assert float(found) == pytest.approx(expected, rel=1e-8, abs=1e-8)


def test_responses_leave_the_candidate_out_of_its_flock():
    rng = np.random.default_rng(1)
    velocity = rng.normal(size=(5, 20, 3))
    flocks = Flocks(np.array([0, 0, 0, 1, 2]), 0.1, 0.0)
    seen = responses(velocity, FlightSpectra(np.ones(5), np.full(5, 0.5), 0.2), flocks)
    assert seen.null.shape == (1, 5)
    flight = np.fft.rfft(velocity, axis=1, norm="ortho")[:, 1:10]
    for uav, mates in ((0, [1, 2]), (2, [0, 1]), (3, [0, 1, 2])):
        mean = flight[mates].mean(axis=0)
        np.testing.assert_allclose(seen.response[0, uav], (np.abs(mean) ** 2).sum(axis=1))
        np.testing.assert_allclose(seen.cross[0, uav], (mean * flight[uav].conj()).sum(axis=1))
        np.testing.assert_allclose(seen.own[0, uav], (seen.noise + 0.1) / len(mates))


def test_gains_are_the_same_by_pairs_and_by_matrix():
    *_, velocity, spectra, flocks = flown(31, follow="f2", **SMOOTH)
    seen = responses(velocity, spectra, flocks)
    weights = np.array([0.6, 0.3, -0.1, 0.0])
    matrix = seen.all_gains(weights)
    flock, head = np.array([0, len(matrix) - 1]), np.array([3, 17])
    np.testing.assert_allclose(seen.gain(weights, flock, head), matrix[flock, head])
    assert seen.reversed().reversed().cross == pytest.approx(seen.cross)


@pytest.mark.parametrize(("follow", "delay"), [("f1", (1.0,)), ("f2", (0.5, 0.5)), ("f3", (1 / 3, 1 / 3, 1 / 3))])
def test_the_heads_of_smooth_noisy_flocks_and_the_strategy_are_found(follow, delay):
    window, truth, velocity, spectra, flocks = flown(32, follow=follow, **SMOOTH)
    leads = leads_of_flocks(velocity, spectra, flocks)
    assert leads is not None
    found = explained_by_leads(leads, flocks)
    np.testing.assert_array_equal(found.heads, np.flatnonzero(truth.head))
    assert all(reason.startswith("passed") for reason in found.reasons)
    wanted = np.zeros(len(leads.weights))
    wanted[: len(delay)] = delay
    assert np.abs(np.cumsum(leads.weights) - np.cumsum(wanted)).max() < 0.35
    followers = found.leader >= 0
    assert (found.leader[followers] == truth.leader[followers]).mean() > 0.9
    assert found.explained[followers].min() > 0.3
    assert ((found.given >= 0) & (found.given <= 1)).all()
    whole = FollowMixture(policy="map").detect(window)
    np.testing.assert_array_equal(whole.candidates, truth.head)
    assert whole.extras["strategy"]["class"].startswith("response")


def test_who_led_follows_where_time_runs_backwards():
    _, truth, velocity, spectra, flocks = flown(32, follow="f1", **SMOOTH)
    backwards = leads_of_flocks(velocity[:, ::-1], spectra, flocks)
    assert backwards is None or not truth.head[backwards.head].any()


def test_flocks_without_a_head_are_not_given_one():
    """Flocks that share a flight of which no delayed copy flies."""
    rng = np.random.default_rng(3)
    shared = np.zeros((4, 120, 3))
    for step in range(1, 120):
        shared[:, step] = 0.9 * shared[:, step - 1] + 0.2 * rng.normal(size=(4, 3))
    track = np.cumsum(np.repeat(shared, 5, axis=0), axis=1) + 0.3 * rng.normal(size=(20, 120, 3))
    velocity = np.diff(track, axis=1)
    spectra = FlightSpectra(np.full(20, 0.2), np.full(20, 0.9), 0.09)
    assert leads_of_flocks(velocity, spectra, flocks_of(velocity, spectra)) is None


def test_without_flocks_there_are_no_leads():
    *_, velocity, spectra, flocks = flown(33, follow="none", position_noise=0.4, uavs=20)
    assert not len(flocks.several)
    assert leads_of_flocks(velocity, spectra, flocks) is None
