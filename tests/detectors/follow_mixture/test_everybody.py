"""What everybody says together, where flocks are in doubt about their heads."""

import numpy as np
import pytest
from mixture_windows import OWN_DELAYS, swarm_window

from detectors.follow_mixture.detector import FollowMixture
from detectors.follow_mixture.explain import by_everybody, by_flocks, in_doubt
from detectors.follow_mixture.explanation import Explanation
from detectors.follow_mixture.flock_heads import watch_flocks
from detectors.follow_mixture.flock_search import first_guesses, flights, seen_spectra
from detectors.follow_mixture.flocks import flocks_of
from detectors.follow_mixture.history import own_history
from detectors.follow_mixture.samples import samples_of
from detectors.follow_mixture.search import climb_together, unexplained

TURNS = {"follow": "f7", "mobility": "smooth_turn", "head_jitter": True, "clusters": 5, "uavs": 82}


def told(seed, **config):
    window, truth = swarm_window(seed, **config)
    samples = samples_of(window, np.arange(window.uavs), 4)
    spectra = seen_spectra(samples)
    return window, truth, samples, spectra, by_flocks(samples, spectra, None)


def wrong_about_heads(truth, found):
    return not np.array_equal(found.heads, np.flatnonzero(truth.head))


def test_what_flocks_got_wrong_everybody_puts_right():
    """Of some swarms behind a network in smooth turns, flocks miss heads of some; everybody together of none."""
    wrong, mended = 0, 0
    for seed in range(40, 46):
        window, truth, samples, spectra, found = told(seed, **TURNS)
        if wrong_about_heads(truth, found):
            wrong += 1
            assert in_doubt(found)
            better = by_everybody(samples, samples, spectra, found, None)
            mended += better is not None and not wrong_about_heads(truth, better)
            assert np.array_equal(FollowMixture().detect(window).candidates, truth.head) or better is None
    assert wrong >= 2
    assert mended >= wrong - 1


def test_a_third_of_an_assignment_leads_to_all_of_it():
    _, truth, samples, _, _ = told(41, **TURNS)
    rng = np.random.default_rng(0)
    start = np.where(truth.head, -1, truth.leader)
    start[rng.permutation(82)[:50]] = -1
    found = climb_together(samples, own_history(samples), [start])
    assert found is not None
    assert unexplained(found) <= 2
    np.testing.assert_array_equal(found.heads.heads, np.flatnonzero(truth.head))


def test_nonsense_explains_nobody():
    _, _, samples, spectra, _ = told(42, follow="none", clusters=3, uavs=30)
    start = np.where(np.arange(30) < 3, -1, np.arange(30) % 3)
    assert climb_together(samples, own_history(samples), [start]) is None
    watch = watch_flocks(samples, flocks_of(flights(samples), spectra))
    assert all(guess.shape == (30,) for guess in first_guesses(samples, watch))


@pytest.mark.parametrize("seed", [43, 44])
def test_followers_with_delays_of_their_own_do_not_lead_the_later(seed):
    window, truth, samples, spectra, found = told(seed, follow=OWN_DELAYS, clusters=5, uavs=82)
    assert not wrong_about_heads(truth, found)
    better = by_everybody(samples, samples, spectra, found, None)
    assert better is None or not wrong_about_heads(truth, better)
    np.testing.assert_array_equal(FollowMixture().detect(window).candidates, truth.head)


def test_a_shared_strategy_that_leaves_nobody_out_is_not_in_doubt():
    sure = Explanation(
        heads=np.array([0]),
        leader=np.array([-1, 0, 0, 0]),
        probability=np.zeros(4),
        given=np.zeros(4),
        gain=np.zeros(4),
        explained=np.zeros(4),
        strategy={"shared": True},
        passed=np.array([True]),
    )
    assert not in_doubt(sure)
    sure.strategy["shared"] = False
    assert in_doubt(sure)
