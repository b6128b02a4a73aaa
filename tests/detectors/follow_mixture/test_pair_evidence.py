"""Who follows whom by pairs alone, and the parts of the quick way that look at followers one by one."""

from math import gcd

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mixture_windows import OWN_DELAYS, problem, swarm_window

from detectors.follow_mixture.detector import FollowMixture
from detectors.follow_mixture.evidence import pairwise_gain
from detectors.follow_mixture.explain import at_once, missed_by_flocks, nearly_all, unled
from detectors.follow_mixture.explanation import KINDS, Explanation
from detectors.follow_mixture.history import own_history
from detectors.follow_mixture.likelihood import Noise, flight_likelihood, log_normaliser, natural_parameters
from detectors.follow_mixture.noise import fit_spectra
from detectors.follow_mixture.pair_evidence import (
    explained_by_pairs,
    flies_with,
    fly_alone,
    led_by,
    led_by_laws,
    pair_evidence,
    plain_evidence,
)
from detectors.follow_mixture.samples import samples_of, stride
from detectors.follow_mixture.strategy import Library, fit_strategy, gain_matrix
from usnet_env.envs import SingleClusterEnv
from usnet_env.window import Window

STRAIGHT = {"follow": "f7", "mobility": "straight", "head_jitter": True, "clusters": 5, "uavs": 82}


def seen(seed, **config):
    samples, history, leader, truth = problem(seed, **config)
    return samples, history, leader, np.flatnonzero(truth.head)


@given(st.integers(0, 20_000), st.integers(1, 3000), st.integers(1, 300))
def test_a_stride_meets_all_rows_alike(observations, most, rows):
    every = stride(observations, most, rows)
    assert -(-observations // every) <= most
    assert gcd(every, rows) == 1
    met = np.bincount(np.arange(observations)[::every] % rows, minlength=rows)
    assert met.max() - met.min() <= 1


def test_fifty_followers_are_fitted_at_all_times():
    """A part of their rows that met every sixth moment only explained nobody."""
    for seed in range(3):
        observation, _ = (env := SingleClusterEnv(follow="f7", followers=50)).reset(seed=seed)
        window = Window.from_observation(observation)
        samples = samples_of(window, np.arange(51), 4)
        head = np.flatnonzero(env.swarm.head)
        leader = np.where(env.swarm.head, -1, head[0])
        strategy = fit_strategy(samples, leader, Library(4, squares=True, towards=True))
        gain = gain_matrix(samples, own_history(samples), strategy, head)
        assert (np.delete(gain[:, 0], head) > 0).all()


@pytest.mark.parametrize("library", [
    Library(4, squares=True, towards=True),
    Library(4, squares=True, towards=True, reach=60.0),
    Library(3, towards=True, own=True),
    Library(2, own=True),
])  # fmt: skip
@pytest.mark.parametrize("miss_rate", [0.0, 0.1])
def test_the_gain_of_a_pair_is_the_difference_of_two_log_likelihoods(library, miss_rate):
    samples, history, leader, _ = seen(2, follow="f6", miss_rate=miss_rate)
    strategy = fit_strategy(samples, leader, library)
    columns = np.unique(leader[leader >= 0])
    table = gain_matrix(samples, history, strategy, columns)
    i, k = int(np.flatnonzero(leader == columns[1])[0]), 1
    total = 0.0
    for row in range(samples.rows):
        place = samples.position_seen[i, row] and samples.position_seen[columns[k], row]
        own = samples.lag_seen[i, row, : library.lags].all()
        past = samples.lagged[columns[k], row, : library.lags]
        known = samples.seen[i, row] and samples.lag_seen[columns[k], row, : library.lags].all()
        if not known or (library.towards and not place) or (library.own and not own):
            continue
        parts = []
        if library.towards:
            gap = samples.position[columns[k], row] - samples.position[i, row]
            distance = np.linalg.norm(gap)
            parts += [gap / distance, gap / 300.0] + [gap / distance * (distance > library.reach)] * bool(library.reach)
        if library.own:
            parts.append(samples.lagged[i, row, : library.lags].ravel())
        parts += [past.ravel()] + [(past**2).ravel()] * library.squares + [[1.0]]
        direction = np.concatenate(parts) @ strategy.coefficients
        kappa = 1.0 / (strategy.noise.floor**2 + strategy.noise.spread**2 / (direction @ direction))
        along = direction @ samples.target[i, row] / np.linalg.norm(direction)
        value = float(log_normaliser(np.array([kappa]))[0]) + kappa * (along - 1.0)
        total += max(value, np.log(0.01)) - history.log_likelihood[i, row]
    assert table[i, k] == pytest.approx(total, rel=2e-4)


@pytest.mark.parametrize("noise", [Noise(0.1, 0.05, True), Noise(0.3, 0.0, False)])
def test_flights_are_as_likely_axis_by_axis(noise):
    rng = np.random.default_rng(0)
    direction, flight = rng.normal(size=(2, 40, 3))
    theta, constant = natural_parameters(direction, noise)
    fast = flight_likelihood(direction.T.copy(), flight.T.copy(), noise)
    np.testing.assert_allclose(fast, np.vecdot(theta, flight) + constant, rtol=1e-9)


def test_a_fit_goes_on_from_a_smaller_class():
    samples, history, leader, heads = seen(27, follow="f6", clusters=5, uavs=82)
    small = fit_strategy(samples, leader, Library(4, squares=True))
    kind = Library(4, squares=True, towards=True)
    begun, anew = (fit_strategy(samples, leader, kind, start=start) for start in (small, None))
    gains = [gain_matrix(samples, history, strategy, heads).max(axis=1).sum() for strategy in (begun, anew)]
    assert gains[0] == pytest.approx(gains[1], rel=0.01)


def test_fellows_with_one_delay_tell_a_follower_from_a_head():
    samples, history, leader, heads = seen(3, follow=OWN_DELAYS, clusters=3, uavs=45)
    assert fly_alone(samples, history, heads, leader)
    first = int(np.flatnonzero((leader == heads[0]) & (np.arange(45) % 3 == 0))[0])
    wrong = np.where((leader == heads[0]) & (np.arange(45) % 3 > 0), first, leader)  # the later behind the earlier
    assert not fly_alone(samples, history, np.union1d(heads, first), wrong)


@pytest.mark.parametrize("mobility", ["iid", "gauss_markov"])
def test_who_is_taken_for_the_head_of_its_fellows_flies_at_once_with_them(mobility):
    samples, history, leader, heads = seen(5, follow="f3", mobility=mobility, head_jitter=True)
    fellow = int(np.flatnonzero(leader == heads[0])[0])
    wrong = np.where((leader == heads[0]) | (np.arange(30) == heads[0]), fellow, leader)
    wrong[fellow] = -1
    assert not fly_alone(samples, history, np.union1d(heads[1:], fellow), wrong)
    mates = np.flatnonzero(leader == heads[0])
    assert flies_with(samples, history, fellow, mates[mates != fellow])
    assert not flies_with(samples, history, int(heads[1]), mates)
    assert not flies_with(samples, history, fellow, mates[:0])


@pytest.mark.parametrize("mobility", ["iid", "gauss_markov", "smooth_turn", "straight"])
def test_who_flies_like_its_head_is_no_fellow(mobility):
    """Also where a head's next velocity is its last, so that followers fly almost at once with it."""
    samples, history, leader, heads = seen(5, follow="f1", mobility=mobility, head_jitter=True)
    assert fly_alone(samples, history, heads, leader)


def test_of_known_heads_everybody_is_led_by_its_own_and_strangers_by_none():
    samples, history, leader, heads = seen(6, follow="f2", clusters=4, uavs=60)
    pairs = pair_evidence(samples, history)
    named, moved = led_by(samples, history, pairs, heads)
    np.testing.assert_array_equal(named, leader)
    assert len(moved) == 3
    np.testing.assert_allclose(
        moved[1],
        pairwise_gain(samples, history.surprise, pairs.kind, samples.rows // 2)[:, heads],
        rtol=1e-3,
        atol=0.01,
    )
    samples, history, _, heads = seen(6, follow="none", clusters=4, uavs=60)
    named, _ = led_by(samples, history, pair_evidence(samples, history), heads)
    assert (named >= 0).mean() < 0.1


def test_by_laws_of_heads_weak_followers_are_told_and_strangers_are_not():
    """Behind a straight head some hardly heed it: their own evidence is what chance gives, that of all together not."""
    weak = told_weak = strangers = 0
    for seed in (0, 1, 13, 19, 21):  # in most swarms nobody is weak
        samples, history, leader, heads = seen(seed, **STRAIGHT, decoys=4)
        pairs = plain_evidence(samples, history, pair_evidence(samples, history))
        sure, _ = led_by(samples, history, pairs, heads)
        sure = np.where(leader >= 0, sure, -1)
        more = led_by_laws(samples, history, heads, sure)
        np.testing.assert_array_equal(more[sure >= 0], sure[sure >= 0])
        left = (sure < 0) & (leader >= 0)
        weak, told_weak = weak + left.sum(), told_weak + (more == leader)[left].sum()
        strangers += (more >= 0)[leader < 0].sum()
    assert weak >= 20
    assert told_weak > 0.8 * weak
    assert strangers <= 2  # of 20 decoys


def test_whom_laws_may_be_asked_about():
    samples, history, leader, heads = seen(1, follow="f2")
    assert led_by_laws(samples, history, heads, leader) is leader  # nobody is left
    some = leader.copy()
    some[[np.flatnonzero(leader == head)[-1] for head in heads]] = -1
    np.testing.assert_array_equal(led_by_laws(samples, history, heads, some), leader)
    lone = np.where(leader == heads[0], leader, -1)  # the others show no law
    np.testing.assert_array_equal(led_by_laws(samples, history, heads, lone), lone)


def test_half_the_features_gain_less_by_chance():
    samples, history, _, _ = seen(2, **STRAIGHT)
    rich = pair_evidence(samples, history)
    plain = plain_evidence(samples, history, rich)
    assert rich.kind.squares
    assert not plain.kind.squares
    assert plain.chance < rich.chance
    assert plain_evidence(samples, history, plain) is plain
    samples, history, _, _ = seen(2, follow="f4")  # squares are what f4 looks at
    rich = pair_evidence(samples, history)
    assert plain_evidence(samples, history, rich) is rich


@pytest.mark.parametrize(("seeds", "least"), [(2, 2), pytest.param(6, 5, marks=pytest.mark.slow)])
def test_behind_straight_heads_pairs_say_what_no_shared_strategy_can(seeds, least):
    right = 0
    for seed in range(seeds):
        samples, history, leader, heads = seen(seed, **STRAIGHT)
        found, _ = at_once(samples, history, pair_evidence(samples, history), None)
        assert found is not None
        assert found.passed.all()
        if not found.strategy["shared"]:
            assert (found.gain[found.leader >= 0] > 0).all()
            assert ((found.explained >= 0) & (found.explained < 1)).all()
            assert len(found.reasons) == len(found.heads)
        right += np.array_equal(found.heads, heads) and (found.leader == leader).mean() > 0.9
    assert right >= least


@pytest.mark.parametrize("mobility", ["iid", "gauss_markov", "smooth_turn", "waypoint", "straight"])
def test_pairs_explain_nobody_where_nobody_follows(mobility):
    for seed in range(4):
        samples, history, _, _ = seen(seed, follow="none", mobility=mobility, head_jitter=bool(seed % 2))
        found = explained_by_pairs(samples, history, pair_evidence(samples, history))
        assert found is None or not nearly_all(found)
        assert found is None or unled(found) > 10


@pytest.mark.parametrize("seeds", [1, pytest.param(4, marks=pytest.mark.slow)])
def test_delays_of_ones_own_are_told_at_once(seeds):
    named = 0
    for seed in range(seeds):
        window, truth = swarm_window(
            seed, follow=OWN_DELAYS, clusters=5, uavs=82, mobility="gauss_markov", head_jitter=True
        )
        answer = FollowMixture().detect(window)
        named += np.array_equal(answer.candidates, truth.head)
    assert named == seeds


def told(leader, passed, kind=None):
    leader = np.array(leader)
    heads = np.unique(leader[leader >= 0])
    nothing = np.zeros(len(leader))
    return Explanation(heads, leader, nothing, nothing, nothing, nothing, kind=kind, passed=np.array(passed))


def test_those_whom_a_strategy_leaves_over_may_hide_their_head_from_flocks():
    """0 and 6 lead; a strategy that holds leaves 6 to 11 over, and flocks put all of them behind 0."""
    kind = np.array([0] + 5 * [2] + 6 * [5])
    held = told([-1] + 5 * [0] + 6 * [-1], [True], kind)
    better = missed_by_flocks(held, told([-1] + 11 * [0], [True]))
    np.testing.assert_array_equal(better.heads, [0])
    np.testing.assert_array_equal(better.kind, [0] + 5 * [2] + 6 * [KINDS.index("missing")])
    # whom flocks leave over too is a decoy
    astray = told([-1] + 5 * [0] + 6 * [-1], [True])
    assert missed_by_flocks(held, astray) is astray
    # and a head among them that passed its gate is found
    both = [-1] + 5 * [0] + [-1] + 5 * [6]
    assert len(missed_by_flocks(held, told(both, [True, True])).heads) == 2
    assert len(missed_by_flocks(held, told(both, [True, False])).heads) == 1


@pytest.mark.parametrize("seed", [12, *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(13, 17))])
def test_who_is_left_over_where_moments_are_missing_is_asked_again(seed):
    """In some of these swarms one follower is left over, whom flocks explain."""
    window, truth = swarm_window(seed, follow="f6", clusters=5, uavs=82, miss_rate=0.3)
    assert np.array_equal(FollowMixture().detect(window).candidates, truth.head)


def test_nothing_is_fitted_where_no_moment_is_seen_with_all_of_its_past():
    samples, _, leader, _ = seen(4, follow="f1", miss_rate=0.9)
    assert not samples.lag_seen[leader >= 0].all(axis=2).any()
    assert fit_strategy(samples, leader, Library(4, own=True)) is None


def test_straight_flight_that_is_seen_without_noise_has_no_spectrum():
    flight = np.tile(np.array([1.0, 0.0, 0.0]), (5, 8, 1))
    spectra = fit_spectra(flight)
    assert 0 < spectra.noise < 1e-12
    assert (spectra.power < 1e-6).all()
