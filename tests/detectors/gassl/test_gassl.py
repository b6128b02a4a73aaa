"""GASSL: the compiled loops against the readable ones of algorithm_1.py, its candidates, and what it refuses."""

import numpy as np
import pytest
import torch
from single_cluster_windows import cluster, clusters, detect_each, rate
from synthetic_windows import answer

from detectors.gassl import Gassl
from detectors.gassl.agat import draw_agat, list_agat_shapes
from detectors.gassl.algorithm_1 import algorithm_1, find_loss
from detectors.gassl.ifsn import list_ifsn_shapes
from detectors.gassl.layers import view_arrays
from detectors.gassl.topology_matrix import build_batch
from detectors.gassl.training import compute_gradient, train
from detectors.series.gaps import fill_gaps

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
    assert (got.candidates.sum(), got.scores[got.candidates]) == (1, got.scores.max())
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


#: widths that all differ, so that no two axes can be confused
ODD = {"query_hidden": 7, "query": 5, "key": 6, "similarity_hidden": (9, 3)}

CASES = [
    {"followers": 3},
    {"followers": 5, "miss_rate": 0.3, "widths": ODD, "hidden": 11},
    {"followers": 4, "memory": 2, "widths": ODD, "hidden": 4},
    {"followers": 2, "memory": 1},
]


def problem(followers, memory=4, miss_rate=0.0, widths=None, hidden=8, steps=14, seed=0):
    """Inputs of a small window, initial networks, and the settings: ``(inputs, phi, gamma, settings)``."""
    window, _ = cluster(seed, follow="f6", followers=followers, miss_rate=miss_rate, observation_steps=steps)
    assert bool(miss_rate) == (not window.seen.all())
    inputs = build_batch(window, np.arange(window.uavs), memory)
    settings = Gassl(memory=memory, ifsn_hidden=hidden, steps=6, **widths or {})
    rng = np.random.default_rng(seed)
    return inputs, draw_agat(settings, len(inputs.history), rng), settings.draw_gamma(rng), settings


def doubles(*arrays):
    return [torch.from_numpy(array).double().requires_grad_() for array in arrays]


@pytest.mark.parametrize("case", CASES)
def test_the_compiled_loss_and_gradients_are_those_of_the_readable_loss(case):
    inputs, phi, gamma, settings = problem(**case)
    for i in (0, len(inputs.history) - 1):
        networks = (phi[i], list_agat_shapes(settings)), (gamma, list_ifsn_shapes(inputs.entries, settings.ifsn_hidden))
        gradients = [np.empty_like(flat) for flat, _ in networks]
        arrays = (view_arrays(flat, shapes) for flat, shapes in networks)
        into = (view_arrays(flat, shapes) for flat, (_, shapes) in zip(gradients, networks, strict=True))
        found = compute_gradient(*arrays, inputs.of(i), *into)
        phi_i, of_all = doubles(phi[i], gamma)
        loss, _ = find_loss(inputs, i, phi_i, of_all, settings)
        assert found == pytest.approx(loss.item(), rel=1e-4)
        for got, expected in zip(gradients, torch.autograd.grad(loss, (phi_i, of_all)), strict=True):
            largest = float(expected.abs().max())
            assert largest > 0
            np.testing.assert_allclose(got, expected, atol=2e-4 * largest, rtol=0)


@pytest.mark.parametrize("case", CASES[:2])
def test_a_compiled_run_is_the_readable_run(case):
    inputs, phi, gamma, settings = problem(**case)
    fast = train(inputs, phi, gamma, settings)
    slow = algorithm_1(inputs, torch.from_numpy(phi), torch.from_numpy(gamma), settings)
    np.testing.assert_allclose(fast.attn_heads, slow.attn_heads, atol=1e-4)
    np.testing.assert_allclose(fast.gamma, slow.gamma, atol=1e-4)
    np.testing.assert_allclose(fast.loss, slow.loss, rtol=1e-3)
    np.testing.assert_allclose(fast.explained, slow.explained, atol=1e-3)
    np.testing.assert_allclose(fast.attn_heads.sum(axis=2), 1.0, atol=1e-5)
    np.testing.assert_allclose(fast.votes, slow.votes, atol=1e-4)
    np.testing.assert_allclose(fast.votes.sum(axis=1), 1.0, atol=1e-5)
    assert np.abs(fast.gamma - gamma).max() > 1e-3  # the steps did something


def test_both_implementations_name_the_same_candidates():
    answers = []
    for implementation in ("compiled", "printed"):
        detector = Gassl(steps=4, memory=2, implementation=implementation)
        detector.reset(1)
        answers.append([detector.detect(cluster(s, followers=3, observation_steps=16)[0]) for s in range(3)])
    for fast, slow in zip(*answers, strict=True):
        np.testing.assert_array_equal(fast.candidates, slow.candidates)
        np.testing.assert_array_equal(fast.extras["choice"], slow.extras["choice"])
        np.testing.assert_allclose(fast.attention, slow.attention, atol=1e-4)


@pytest.mark.parametrize(("memory", "members"), [(4, [0, 1, 2, 3]), (2, [3, 0, 1]), (1, [1, 2])])
def test_the_batch_holds_the_columns_of_equation_5_at_all_times(memory, members):
    window, _ = cluster(followers=3, observation_steps=15, miss_rate=0.2)
    inputs, filled = build_batch(window, np.array(members), memory), fill_gaps(window)
    times, position, velocity = 15 - memory, filled.position[:, members], filled.velocity[:, members]
    pasts = np.array([velocity[r : r + memory] for r in range(times)])
    first = position[:times]
    assert inputs.history.shape == (len(members), times, 3 * (memory + 1))
    assert inputs.entries == 6 * (memory + 1)
    for r in range(times):
        for i, uav in enumerate(members):
            columns = [(velocity[r + memory - 1 - lag, i] - pasts.mean()) / pasts.std() for lag in range(memory)]
            columns.append((first[r, i] - first.mean(axis=(0, 1))) / first.std(axis=(0, 1)))
            np.testing.assert_allclose(inputs.history[i, r], np.concatenate(columns), atol=1e-4)
            np.testing.assert_allclose(inputs.value[:, :, i, r], columns, atol=1e-4)
            places = np.array([position[s : s + memory + 1, i] for s in range(times)])  # up to t + 1
            np.testing.assert_allclose(inputs.own[i, r], (places[r] - places.mean(axis=(0, 1))).ravel(), atol=1e-3)
            seen = window.velocity_seen[r + memory, uav]
            assert inputs.weight[i, r] == seen
            np.testing.assert_array_equal(inputs.target[i, r], window.velocity[r + memory, uav] * seen)
    assert 0 < inputs.weight.mean() < 1
