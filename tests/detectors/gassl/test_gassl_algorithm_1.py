"""Algorithm 1: the compiled loops against the readable ones of algorithm_1.py, and their inputs."""

import numpy as np
import pytest
import torch
from single_cluster_windows import cluster

from detectors.gassl import Gassl
from detectors.gassl.agat import AgatSizes, draw_agat
from detectors.gassl.algorithm_1 import algorithm_1, compute_loss
from detectors.gassl.ifsn import draw_ifsn
from detectors.gassl.topology_matrix import build_batch
from detectors.gassl.training import compute_gradient, train
from detectors.series.gaps import fill_gaps

#: widths that all differ, so that no two axes can be confused
ODD = {"query_hidden": 7, "query": 5, "key": 6, "similarity_hidden": (9, 3)}

RATE = 3e-3
CASES = [
    {"followers": 3},
    {"followers": 5, "miss_rate": 0.3, "widths": ODD, "hidden": 11},
    {"followers": 4, "memory": 2, "widths": ODD, "hidden": 4},
    {"followers": 2, "memory": 1},
]


def problem(followers, memory=4, miss_rate=0.0, widths=None, hidden=8, steps=14, seed=0):
    """Inputs of a small window, and initial networks: ``(inputs, phi, gamma, agat, ifsn)``."""
    window, _ = cluster(seed, follow="f6", followers=followers, miss_rate=miss_rate, observation_steps=steps)
    assert bool(miss_rate) == (not window.seen.all())
    inputs = build_batch(window, np.arange(window.uavs), memory)
    agat, ifsn, rng = AgatSizes(memory=memory, **widths or {}), hidden, np.random.default_rng(seed)
    return inputs, draw_agat(agat, inputs.uavs, rng), draw_ifsn(inputs.entries, ifsn, rng), agat, ifsn


def doubles(*arrays):
    return [torch.from_numpy(array).double().requires_grad_() for array in arrays]


@pytest.mark.parametrize("case", CASES)
def test_the_compiled_loss_and_gradients_are_those_of_the_readable_loss(case):
    inputs, phi, gamma, agat, ifsn = problem(**case)
    for i in (0, inputs.uavs - 1):
        found, d_phi, d_gamma = compute_gradient(phi[i], gamma, agat.numbers(), inputs.of(i))
        phi_i, of_all = doubles(phi[i], gamma)
        loss, _ = compute_loss(inputs, i, phi_i, of_all, agat, ifsn)
        assert found == pytest.approx(loss.item(), rel=1e-4)
        for got, expected in zip((d_phi, d_gamma), torch.autograd.grad(loss, (phi_i, of_all)), strict=True):
            largest = float(expected.abs().max())
            assert largest > 0
            np.testing.assert_allclose(got, expected, atol=2e-4 * largest, rtol=0)


@pytest.mark.parametrize("case", CASES[:2])
def test_a_compiled_run_is_the_readable_run(case):
    inputs, phi, gamma, agat, ifsn = problem(**case)
    fast = train(inputs, phi, gamma, agat, 6, RATE)
    slow = algorithm_1(inputs, torch.from_numpy(phi), torch.from_numpy(gamma), agat, ifsn, 6, RATE)
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
