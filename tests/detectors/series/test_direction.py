"""Leading or a common cause: what the past of a UAV says about a group, compared with what its future says."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import t as student

from detectors.series.direction import _log_density, compare_directions, lead_probabilities

STEPS, DELAY, FOLLOWERS = 100, 3, 4


def smooth_flight(rng, axes=3, steps=STEPS + 20, kept=0.9):
    """Gauss-Markov velocities ``(steps, axes)``."""
    velocity = np.zeros((steps, axes))
    for t in range(1, steps):
        velocity[t] = kept * velocity[t - 1] + np.sqrt(1 - kept**2) * rng.normal(size=axes)
    return velocity


def led_group(rng, law=lambda v: v, share=1.0, **flight):
    """``(n, T, a)``: UAV 0, and followers that repeat a function of its velocity for a share of the time."""
    source = smooth_flight(rng, **flight)
    other = smooth_flight(rng, **flight)
    late = law(source)[20 - DELAY : 20 - DELAY + STEPS]
    from_then = int(share * STEPS)
    late = np.concatenate([late[:from_then], law(other)[20 + from_then : 20 + STEPS]])
    noise = 0.1 * rng.normal(size=(FOLLOWERS, *late.shape))
    return np.concatenate([source[None, 20 : 20 + STEPS], late + noise])


def driven_group(rng, **flight):
    """``(n, T, a)``: UAVs that all follow an unseen point with a delay."""
    source = smooth_flight(rng, **flight)[20 - DELAY : 20 - DELAY + STEPS]
    return source + 0.3 * rng.normal(size=(1 + FOLLOWERS, *source.shape))


def compare(velocity, longest=12, noisy=False):
    count = len(velocity)
    label = np.minimum(np.arange(count), 1)  # the followers are one group
    root = np.zeros(count, np.int64)
    (ratio,) = compare_directions(velocity, (velocity[:1], velocity[:1]), label, root, np.array([0]), longest, noisy)
    return ratio


@pytest.mark.parametrize("noisy", [False, True])
@pytest.mark.parametrize("axes", [1, 2, 3])
def test_a_leader_is_told_from_a_common_cause(axes, noisy):
    rngs = [np.random.default_rng(seed) for seed in range(20)]
    leads = [compare(led_group(rng, axes=axes), noisy=noisy) for rng in rngs]
    driven = [compare(driven_group(rng, axes=axes), noisy=noisy) for rng in rngs]
    assert np.mean(np.array(leads) > 0) >= 0.9
    assert np.mean(np.array(driven) < 0) >= 0.8
    assert np.median(leads) > 2 > 0 > -0.5 > np.median(driven)


def test_the_one_that_follows_does_not_lead():
    for seed in range(5):
        leader, follower = led_group(np.random.default_rng(seed))[:2]
        assert compare(np.stack([follower, leader])) < -2 < 2 < compare(np.stack([leader, follower]))


def test_nothing_is_compared_in_a_short_window_or_without_followers():
    flight = led_group(np.random.default_rng(0))
    assert compare(flight[:, :31]) == np.inf
    assert np.isfinite(compare(flight[:, :32]))
    alone = compare_directions(
        flight, (flight[:0], flight[:0]), np.arange(5), np.full(5, -1), np.array([], np.int64), 12, False
    )
    assert alone.shape == (0,)


@given(st.lists(st.floats(-30.0, 30.0), min_size=1, max_size=6))
@settings(max_examples=40)
def test_the_probability_to_lead_is_that_of_all_sets_of_leaders(ratio):
    """If all shares of leaders are as probable, so are all numbers of them, and all sets with the same number."""
    count, found, total = len(ratio), np.zeros(len(ratio)), 0.0
    for leads in itertools.product((0, 1), repeat=count):
        weight = np.exp(np.dot(leads, ratio)) / math.comb(count, sum(leads))
        total += weight
        found += weight * np.array(leads)
    np.testing.assert_allclose(lead_probabilities(np.array(ratio)), found / total, rtol=1e-6, atol=1e-12)


def test_other_heads_that_lead_make_a_doubtful_head_a_leader():
    assert lead_probabilities(np.array([-0.2]))[0] < 0.5 < lead_probabilities(np.array([-0.2, 8.0, 8.0]))[0]
    assert lead_probabilities(np.array([0.2]))[0] > 0.5 > lead_probabilities(np.array([0.2, -8.0, -8.0]))[0]
    np.testing.assert_allclose(lead_probabilities(np.full(3, np.inf)), 1.0)


def test_a_lead_of_eight_blocks_has_a_t_distribution_with_seven_degrees_of_freedom():
    values = np.array([-30.0, -1.0, 0.0, 0.5, 4.0])
    expected = student(7).logpdf(values) - student(7).logpdf(0.0)
    np.testing.assert_allclose(_log_density(values), expected, atol=1e-9)
