"""Algorithm 1: the readable loop against a literal reading, and the compiled loops against the readable one."""

import literal
import numpy as np
import pytest
import torch
from single_cluster_windows import cluster

from detectors.gassl import Gassl
from detectors.gassl.agat import AgatSizes, draw_agat
from detectors.gassl.algorithm_1 import algorithm_1, batch_loss
from detectors.gassl.ifsn import draw_ifsn
from detectors.gassl.topology_matrix import build_batch
from detectors.gassl.training import gradient, prepare_inputs, train
from detectors.series.votes import choose_heads, count_votes

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
    inputs = prepare_inputs(build_batch(window, memory=memory))
    agat, ifsn, rng = AgatSizes(memory=memory, **widths or {}), hidden, np.random.default_rng(seed)
    return inputs, draw_agat(agat, inputs.uavs, rng), draw_ifsn(inputs.entries, ifsn, rng), agat, ifsn


def doubles(*arrays):
    return [torch.from_numpy(array).double().requires_grad_() for array in arrays]


@pytest.mark.parametrize("case", CASES)
def test_the_readable_loss_is_that_of_the_equations(case):
    inputs, phi, gamma, agat, ifsn = problem(**case | {"steps": 9})
    i = inputs.uavs - 1
    phi_i, of_all = doubles(phi[i], gamma)
    loss, alpha = batch_loss(inputs, i, phi_i, of_all, agat, ifsn)
    expected, expected_alpha = literal.loss_and_attention(inputs, i, phi_i, of_all, agat, ifsn)
    assert loss.item() == pytest.approx(expected.item(), rel=1e-9)
    np.testing.assert_allclose(alpha.detach(), expected_alpha.detach(), atol=1e-9)
    assert float(alpha.detach().std()) > 0.02  # uneven enough to distinguish one order of axes from another


@pytest.mark.parametrize("case", CASES)
def test_the_compiled_loss_and_gradients_are_those_of_the_readable_loss(case):
    inputs, phi, gamma, agat, ifsn = problem(**case)
    for i in (0, inputs.uavs - 1):
        found, d_phi, d_gamma = gradient(phi[i], gamma, agat.numbers(), *inputs.of(i))
        phi_i, of_all = doubles(phi[i], gamma)
        loss, _ = batch_loss(inputs, i, phi_i, of_all, agat, ifsn)
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
    assert np.abs(fast.gamma - gamma).max() > 1e-3  # the steps did something
    chosen, c = literal.vote(torch.from_numpy(slow.attention))
    attention = fast.attention.astype(np.float64)
    np.testing.assert_array_equal(choose_heads(attention, False, np.random.default_rng(0)), chosen)
    np.testing.assert_allclose(count_votes(chosen.numpy()), c, atol=1e-6)


def test_one_gamma_is_handed_from_uav_to_uav():
    """The first loss of the second UAV is that of the Γ which the first UAV left, and of its own initial Φ."""
    inputs, phi, gamma, agat, _ = problem(followers=2)
    fit = train(inputs, phi, gamma, agat, 3, RATE)
    handed_on = gamma.copy()
    phi_0 = phi[0].copy()
    for step in range(3):
        loss, d_phi, d_gamma = gradient(phi_0, handed_on, agat.numbers(), *inputs.of(0))
        assert fit.loss[0, step] == pytest.approx(loss, rel=1e-5)
        phi_0 -= np.float32(3e-3) * d_phi
        handed_on -= np.float32(3e-3) * d_gamma
    second = agat.numbers(), *inputs.of(1)
    assert fit.loss[1, 0] == pytest.approx(gradient(phi[1], handed_on, *second)[0], rel=1e-5)
    assert fit.loss[1, 0] != pytest.approx(gradient(phi[1], gamma, *second)[0], rel=1e-5)


@pytest.mark.parametrize("memory", [4, 2])
def test_both_implementations_name_the_same_candidates(memory):
    answers = []
    for implementation in ("compiled", "printed"):
        detector = Gassl(steps=4, memory=memory, implementation=implementation)
        detector.reset(1)
        answers.append([detector.detect(cluster(s, followers=3, observation_steps=16)[0]) for s in range(3)])
    for fast, slow in zip(*answers, strict=True):
        np.testing.assert_array_equal(fast.candidates, slow.candidates)
        np.testing.assert_array_equal(fast.extras["choice"], slow.extras["choice"])
        np.testing.assert_allclose(fast.attention, slow.attention, atol=1e-4)
