"""GASSL as a detector: its candidates, what it must not depend on, and what it refuses."""

import numpy as np
import pytest
from single_cluster_windows import cluster, clusters, rate

from detectors.gassl import Gassl

FEW = {"steps": 5}  # where the candidates don't matter


def detector(seed=0, **arguments):
    made = Gassl(**arguments)
    made.reset(seed)
    return made


def detect_each(windows, **arguments):
    made = detector(**arguments)
    return [made.detect(window) for window in windows]


@pytest.mark.parametrize("rule", ["paper", "exclude-self"])
def test_finds_the_head(rule):
    windows, heads = clusters(4, follow="f1", followers=5)
    assert rate(detect_each(windows, rule=rule), heads) >= 0.75


@pytest.mark.parametrize("rule", ["paper", "exclude-self"])
@pytest.mark.parametrize("memory", [4, 2])
def test_an_answer_is_made_of_the_attention(rule, memory):
    window, _ = cluster(followers=4)
    got = detector(rule=rule, memory=memory, **FEW).detect(window)
    assert got.candidates.shape == (5,)
    assert got.candidates.sum() == 1
    assert got.scores[got.candidates] == got.scores.max()
    np.testing.assert_allclose(got.attention.sum(axis=1), 1.0, atol=1e-5)
    others = got.attention - 2 * np.eye(5)
    np.testing.assert_array_equal(got.leader, others.argmax(axis=1))
    choice = got.attention.argmax(axis=1) if rule == "paper" else got.leader
    np.testing.assert_array_equal(got.extras["choice"], choice)
    votes = [sum(choice[other] == i for other in range(5) if other != i) / 5 for i in range(5)]  # equation (20)
    np.testing.assert_allclose(got.scores, votes)
    attn_heads = got.extras["attention_heads"]
    assert attn_heads.shape == (memory + 1, 5, 5)
    np.testing.assert_allclose(attn_heads.mean(axis=0), got.attention, atol=1e-6)  # equation (12)
    assert got.extras["loss"].shape == (5, 5)
    assert got.extras["explained"].shape == (5,)
    assert got.extras["explained"].max() <= 1


def test_a_learning_rate_that_overflows_gives_even_attention():
    window, _ = cluster(followers=4)
    got = detector(learning_rate=1e30).detect(window)
    np.testing.assert_allclose(got.attention, 0.2, atol=1e-6)
    assert got.candidates.sum() == 1
    assert np.isfinite(got.scores).all()
    assert np.isfinite(got.extras["explained"]).all()
    assert np.isfinite(got.extras["attention_heads"]).all()
