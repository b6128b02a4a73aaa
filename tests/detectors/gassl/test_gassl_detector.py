"""GASSL as a detector: its candidates, what it must not depend on, and what it refuses."""

import numpy as np
import pytest
from single_cluster_windows import cluster, clusters, detect_each, rate
from synthetic_windows import answer

from detectors.gassl import Gassl

FEW = {"steps": 5}  # where the candidates don't matter


@pytest.mark.parametrize("steps", [0, 100])
def test_names_the_uav_that_is_unlike_the_others_even_untrained(steps):
    windows, heads = clusters(8, follow="f1", followers=5)
    assert rate(detect_each(Gassl(steps=steps), windows), heads) >= 0.75


def test_training_finds_the_head_that_is_not_unlike_the_others():
    """Each follower of f6 is pulled its own way; without a gradient step this test fails."""
    windows, heads = clusters(10, follow="f6", followers=3)
    trained, untrained = (detect_each(made, windows) for made in (Gassl(), Gassl(steps=0)))
    assert rate(trained, heads) >= 0.8
    assert rate(untrained, heads) <= 0.5
    assert min(found.extras["explained"].mean() for found in trained) > 0.6
    assert max(found.extras["explained"].mean() for found in untrained) < 0.1


@pytest.mark.parametrize("memory", [4, 2])
def test_an_answer_is_made_of_the_attention(memory):
    window, _ = cluster(followers=4)
    got = answer(Gassl(memory=memory, times="mean", **FEW), window)
    assert got.candidates.shape == (5,)
    assert got.candidates.sum() == 1
    assert got.scores[got.candidates] == got.scores.max()
    np.testing.assert_allclose(got.attention.sum(axis=1), 1.0, atol=1e-5)
    others = got.attention - 2 * np.eye(5)
    np.testing.assert_array_equal(got.leader, others.argmax(axis=1))
    choice = got.attention.argmax(axis=1)
    np.testing.assert_array_equal(got.extras["choice"], choice)
    votes = [sum(choice[other] == i for other in range(5) if other != i) / 5 for i in range(5)]  # equation (20)
    np.testing.assert_allclose(got.scores, votes)
    attn_heads = got.extras["attention_heads"]
    assert attn_heads.shape == (memory + 1, 5, 5)
    np.testing.assert_allclose(attn_heads.mean(axis=0), got.attention, atol=1e-6)  # equation (12)
    assert got.extras["loss"].shape == (5, 5)
    assert got.extras["explained"].shape == (5,)
    assert got.extras["explained"].max() <= 1


def test_votes_are_counted_at_each_time():
    window, _ = cluster(followers=4, observation_steps=6)
    got = answer(Gassl(steps=0), window)  # R = 2 times
    assert set(np.round(10 * got.scores, 4)) <= set(range(11))  # of 2 x 5 votes
    assert got.scores.sum() <= 1 + 1e-6
    assert got.scores[got.candidates] == got.scores.max()
    single, _ = cluster(followers=4, observation_steps=5)  # R = 1: both ways are one
    one, other = (answer(Gassl(times=times, **FEW), single) for times in ("mean", "votes"))
    np.testing.assert_allclose(one.scores, other.scores, atol=1e-6)
    np.testing.assert_array_equal(one.extras["choice"], other.extras["choice"])


def test_a_learning_rate_that_overflows_gives_even_attention():
    window, _ = cluster(followers=4)
    got = answer(Gassl(learning_rate=1e30), window)
    np.testing.assert_allclose(got.attention, 0.2, atol=1e-6)
    assert got.candidates.sum() == 1
    assert np.isfinite(got.scores).all()
    assert np.isfinite(got.extras["explained"]).all()
    assert np.isfinite(got.extras["attention_heads"]).all()
