"""The fast AGAT and IFSN, held against Algorithm 1 written out literally."""

import literal
import numpy as np
import pytest
import torch
from gassl_windows import cluster, clusters, samples

from detectors.gassl import input_pooling
from detectors.gassl.agat import Agat, AgatSizes
from detectors.gassl.ifsn import Ifsn
from detectors.gassl.input_pooling import (
    InputPooling,
    Standardised,
    _evaluate,
    fit_input_pooling,
    ifsn_inputs,
    losses,
    standardise,
)
from detectors.gassl.similarity import similarity, similarity_by_tensors


def networks(windows, uavs, memory=4, spread=1.0, seed=0):
    """AGAT and IFSN; ``spread`` scales all values, so that attention is far from even."""
    generator = torch.Generator().manual_seed(seed)
    agat = Agat(windows, uavs, AgatSizes(memory, 7, 5, 6, (9, 3)), generator)
    ifsn = Ifsn(windows, 6 * memory + 6, (11, 10, 9), generator)
    for parameter in agat.parameters() + ifsn.parameters():
        parameter.data *= spread
    agat.last.data *= 10.0
    return agat, ifsn


def some_times(batch, count=5):
    return batch.at(torch.arange(3, 3 + count))


@pytest.mark.parametrize(("followers", "memory", "miss_rate"), [(3, 4, 0.0), (5, 4, 0.2), (4, 2, 0.0)])
def test_losses_and_gradients_are_those_of_the_equations(followers, memory, miss_rate):
    windows, _ = clusters(2, follow="f6", followers=followers, miss_rate=miss_rate)
    batch = some_times(standardise(samples(windows, memory)))
    agat, ifsn = networks(2, followers + 1, memory, spread=2.0)
    phi, gamma = literal.leaves(agat, ifsn, torch.float64)

    slow = literal.losses(phi, gamma, batch)
    fast = losses(agat, ifsn, batch)
    np.testing.assert_allclose(fast.detach(), slow.detach(), rtol=2e-5)

    # Different weights for different UAVs: no gradient may reach the Φ of another.
    weight = torch.linspace(0.5, 2.0, fast.numel()).view(fast.shape)
    (fast * weight).sum().backward()
    (slow * weight).sum().backward()
    pairs = [(name, getattr(agat, name).grad, value.grad) for name, value in phi.items()]
    pairs += [(f"Γ {k}", one.grad, two.grad) for k, (one, two) in enumerate(zip(ifsn.parameters(), gamma, strict=True))]
    for name, fast_gradient, slow_gradient in pairs:
        size = float(slow_gradient.abs().max())
        assert size > 0, name
        np.testing.assert_allclose(fast_gradient, slow_gradient, atol=2e-4 * size, rtol=1e-3, err_msg=name)


def test_attention_is_that_of_the_equations():
    windows, _ = clusters(2, followers=4)
    batch = some_times(standardise(samples(windows)))
    agat, ifsn = networks(2, 5, spread=2.0)
    phi, _ = literal.leaves(agat, ifsn, torch.float64)
    attended = agat(batch.velocity, batch.position)
    np.testing.assert_allclose(attended.alpha.detach(), literal.attention(phi, batch).detach(), atol=2e-6)
    np.testing.assert_allclose(attended.alpha.sum(-1).detach(), 1.0, atol=1e-6)
    assert float(attended.alpha.detach().std()) > 0.05  # uneven enough to tell one order of axes from another


def test_the_loop_of_the_algorithm_starts_from_the_same_losses():
    window, _ = cluster(followers=3)
    inputs = standardise(samples([window]))
    agat, ifsn = networks(1, 4)
    phi, gamma = literal.leaves(agat, ifsn, torch.float32)
    shared = [value[0] for value in gamma]
    one = literal.window_of(inputs, 0)
    slow = []
    for i in range(4):
        predicted, alpha = literal.forward(literal.parameters_of(phi, i), shared, one, i)
        slow.append((((one.target[i] - predicted.detach()) ** 2).sum(-1) * one.weight[i]).sum().item())
        np.testing.assert_allclose(alpha.sum(-1).detach(), 1.0, atol=1e-6)
    np.testing.assert_allclose(losses(agat, ifsn, inputs).detach()[0], slow, rtol=1e-4)
    attended = literal.train(agat, ifsn, inputs, InputPooling(), steps=2)
    assert attended.shape == (4, 4)
    np.testing.assert_allclose(attended.sum(1), 1.0, atol=1e-5)


@pytest.mark.slow
def test_the_loop_of_the_algorithm_finds_the_head():
    found = []
    for seed in range(3):
        window, head = cluster(seed, follow="f3", followers=5)
        inputs = standardise(samples([window]))
        generator = torch.Generator().manual_seed(seed)
        agat, ifsn = Agat(1, 6, AgatSizes(4, 16, 8, 8, (16, 8)), generator), Ifsn(1, 30, (32, 32, 32), generator)
        attended = literal.train(agat, ifsn, inputs, InputPooling(), steps=200)
        found.append(int(torch.bincount(attended.argmax(1), minlength=6).argmax()) == head)
    assert sum(found) >= 2


def test_heads_of_velocities_and_of_the_position_look_at_their_own_values():
    window, _ = cluster(followers=4)
    batch = some_times(standardise(samples([window])))
    agat, _ = networks(1, 5, spread=2.0)

    def alpha_of(velocity, position):
        return agat(velocity, position).alpha.detach()[0, :4]  # rows of the UAVs that don't change themselves

    before = alpha_of(batch.velocity, batch.position)
    position, velocity = batch.position.clone(), batch.velocity.clone()
    position[:, 4] += 1.0
    velocity[:, 4, :, 1] += 1.0
    moved, turned = alpha_of(batch.velocity, position), alpha_of(velocity, batch.position)
    np.testing.assert_array_equal(moved[:, :, :4], before[:, :, :4])
    assert (moved[:, :, 4] - before[:, :, 4]).abs().max() > 1e-3
    np.testing.assert_array_equal(turned[:, :, [0, 2, 3, 4]], before[:, :, [0, 2, 3, 4]])
    assert (turned[:, :, 1] - before[:, :, 1]).abs().max() > 1e-3


def test_windows_of_a_batch_do_not_mix():
    windows, _ = clusters(3, followers=3)
    together = some_times(standardise(samples(windows)))
    agat, ifsn = networks(3, 4)
    whole = losses(agat, ifsn, together).detach()
    other = standardise(samples([windows[0], windows[1], clusters(1, first_seed=9, followers=3)[0][0]]))
    changed = losses(agat, ifsn, some_times(other)).detach()
    np.testing.assert_array_equal(whole[:2], changed[:2])
    assert (whole[2] != changed[2]).all()


def pairs(windows=2, uavs=5, times=7, wide=9, narrow=3, dtype=torch.float32, seed=0):
    generator = torch.Generator().manual_seed(seed)
    s = windows * uavs
    shapes = [(s, times, wide), (s, 3, wide), (s, wide, narrow), (s, narrow), (s, narrow), (windows, times, uavs, 3)]
    tensors = [torch.randn(shape, generator=generator, dtype=torch.float64).to(dtype) for shape in shapes]
    return [*(tensor.requires_grad_() for tensor in tensors[:5]), tensors[5]]


@pytest.mark.parametrize(
    ("windows", "uavs", "times", "wide", "narrow"),
    [(2, 5, 7, 9, 3), (1, 3, 1, 1, 1), (3, 4, 33, 16, 8), (1, 17, 8, 8, 4)],
)
def test_the_compiled_similarity_agrees_with_tensors_in_double_precision(windows, uavs, times, wide, narrow):
    fast_inputs = pairs(windows, uavs, times, wide, narrow)
    exact_inputs = [value.detach().double().requires_grad_(value.requires_grad) for value in fast_inputs]
    fast, exact = similarity(*fast_inputs), similarity_by_tensors(*exact_inputs)
    np.testing.assert_allclose(fast.detach(), exact.detach(), rtol=1e-5, atol=1e-5)
    upstream = torch.randn(fast.shape, generator=torch.Generator().manual_seed(1))
    fast.backward(upstream)
    exact.backward(upstream.double())
    for fast_input, exact_input in zip(fast_inputs[:5], exact_inputs[:5], strict=True):
        size = float(exact_input.grad.abs().max())
        np.testing.assert_allclose(fast_input.grad, exact_input.grad, rtol=1e-4, atol=2e-5 * size)


def test_the_compiled_similarity_takes_what_is_not_contiguous():
    inputs = pairs()
    turned = [value.detach().transpose(0, 1).contiguous().transpose(0, 1) for value in inputs]
    assert not turned[0].is_contiguous()
    np.testing.assert_array_equal(similarity(*turned), similarity(*inputs).detach())


def test_the_gradient_of_the_tensor_path_is_that_of_finite_differences():
    assert torch.autograd.gradcheck(similarity_by_tensors, pairs(1, 3, 2, 4, 3, dtype=torch.float64))


def test_standardised_inputs():
    windows, _ = clusters(2, followers=3)
    batch = standardise(samples(windows))
    for e in range(2):
        assert batch.velocity[e].mean() == pytest.approx(0, abs=1e-5)
        assert batch.velocity[e].std() == pytest.approx(1, rel=1e-4)
        np.testing.assert_allclose(batch.position[e].reshape(-1, 3).mean(0), 0, atol=1e-4)
        np.testing.assert_allclose(batch.position[e].reshape(-1, 3).std(0), 1, rtol=1e-4)
    raw = samples(windows)
    np.testing.assert_array_equal(batch.target, raw.target)


def test_samples_follow_the_index_convention():
    window, _ = cluster(followers=3, miss_rate=0.2)
    one = samples([window])
    assert one.target.shape == (1, 4, 96, 3)
    for i, row in [(0, 0), (2, 41), (3, 95)]:
        t = row + 3  # the newest velocity of the sample, v_t
        np.testing.assert_array_equal(one.target[0, i, row], window.velocity[t + 1, i])
        assert bool(one.weight[0, i, row]) == window.velocity_seen[t + 1, i]
        for lag in range(4):
            np.testing.assert_array_equal(one.velocity[0, i, row, lag], window.velocity[t - lag, i])
        for tensor, instant in ((one.position, t - 3), (one.position_now, t)):
            known = np.flatnonzero(window.seen[:, i])
            nearest = known[np.abs(known - instant) == np.abs(known - instant).min()]
            assert any(np.array_equal(tensor[0, i, row], window.position[k, i]) for k in nearest)


@pytest.mark.parametrize("drop", [0, 2])
def test_occlusion_is_the_rise_in_loss_without_a_candidate(drop):
    """The closed form against attention renormalised without the candidate, one pair at a time."""
    window, _ = cluster(followers=3)
    batch = standardise(samples([window]))
    agat, ifsn = networks(1, 4, spread=2.0)
    with torch.no_grad():
        fit = _evaluate(agat, ifsn, batch, occlude=True)
        alpha = agat(batch.velocity, batch.position).alpha.clone()
        values = torch.cat([batch.velocity, batch.position.unsqueeze(3)], dim=3)

        def error(weights):
            pooled = torch.einsum("eithj,ejthc->eithc", weights, values)
            return ((ifsn(ifsn_inputs(batch.velocity, batch.position, pooled)) - batch.target) ** 2).sum(-1).mean(-1)

        before = error(alpha)
        alpha[..., drop] = 0
        after = error(alpha / alpha.sum(-1, keepdim=True))
    np.testing.assert_allclose(fit.rise[:, :, drop], after - before, atol=2e-5)
    np.testing.assert_allclose(fit.attention.sum(-1), 1.0, atol=1e-5)
    power = (batch.target**2).sum(-1).mean(-1)
    np.testing.assert_allclose(fit.explained, 1 - before / power, atol=1e-5)


def test_chunks_of_times_do_not_change_what_is_evaluated(monkeypatch):
    windows, _ = clusters(2, followers=3, miss_rate=0.2)
    batch = samples(windows)
    fits = []
    for entries in (4_000_000, 1):
        monkeypatch.setattr(input_pooling, "_CHUNK_ENTRIES", entries)
        fits.append(fit_input_pooling(batch, InputPooling(steps=2), torch.Generator().manual_seed(0), occlude=True))
    for name in ("attention_heads", "rise", "explained"):
        np.testing.assert_allclose(getattr(fits[0], name), getattr(fits[1], name), atol=1e-5)


def test_steps_lower_the_loss():
    windows, _ = clusters(2, follow="f3", followers=4)
    batch = samples(windows)
    explained = [
        fit_input_pooling(batch, InputPooling(steps=steps), torch.Generator().manual_seed(0), occlude=False).explained
        for steps in (1, 100)
    ]
    assert explained[1].mean() > explained[0].mean() + 0.2


def test_a_batch_at_some_times():
    batch = standardise(samples([cluster(followers=2)[0]]))
    part = batch.at(torch.tensor([5, 1]))
    assert isinstance(part, Standardised)
    np.testing.assert_array_equal(part.velocity[:, :, 1], batch.velocity[:, :, 1])
    np.testing.assert_array_equal(part.weight[:, :, 0], batch.weight[:, :, 5])
