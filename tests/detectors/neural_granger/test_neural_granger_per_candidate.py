"""One network for each candidate: each function against a slow and literal one."""

import numpy as np
import pytest
import torch
from single_cluster_windows import clusters, samples

from detectors.neural_granger import per_candidate
from detectors.neural_granger.per_candidate import (
    AdditiveNetwork,
    PerCandidate,
    Problem,
    compute_all_errors,
    fit_per_candidate,
    predict_from_own_history,
    split_times,
)

CPU = torch.device("cpu")


def batch_of(count=2, followers=3, **arguments):
    windows, heads = clusters(count, followers=followers, **arguments)
    return samples(windows), heads


@pytest.mark.parametrize("miss_rate", [0.0, 0.2])
def test_the_null_model_is_a_ridge_regression_on_other_times(miss_rate):
    batch, _ = batch_of(follow="f6", miss_rate=miss_rate)
    got = predict_from_own_history(batch, ridge=1.0)
    times = batch.times
    for e in range(2):
        for i in range(4):
            features = 1.7 * batch.velocity[e, i].reshape(times, -1).double().numpy()
            features = np.column_stack([features, np.ones(times)])
            target, weight = batch.target[e, i].double().numpy(), batch.weight[e, i].numpy()
            for fold in range(8):
                inside = [t for t in range(times) if t * 8 // times == fold]
                outside = [t for t in range(times) if (t < inside[0] - 4 or t > inside[-1] + 4) and weight[t] > 0]
                x = features[outside]
                solution = np.linalg.solve(x.T @ x + np.eye(x.shape[1]), x.T @ target[outside])
                np.testing.assert_allclose(got[e, i, inside], features[inside] @ solution, atol=2e-4)


def test_the_null_model_predicts_smooth_flight_and_not_random_flight():
    def explained(batch):
        return 1 - ((predict_from_own_history(batch, 1.0) - batch.target) ** 2).sum() / (batch.target**2).sum()

    # A head moves by itself, so the null model is applied to a window without followers.
    smooth, _ = batch_of(follow="none", mobility="gauss_markov")
    random, _ = batch_of(follow="none")
    assert explained(smooth) > 0.5
    assert explained(random) < 0.1


@pytest.mark.parametrize(("times", "blocks"), [(96, 4), (100, 4), (70, 4), (58, 3), (46, 2), (30, 1), (16, 1), (12, 0)])
def test_held_out_times_are_apart_from_those_of_training(times, blocks):
    used, held = split_times(times, blocks=4, gap=4, device=CPU)
    assert len(held) == max(1, blocks) * (times // (5 * max(1, blocks)))
    assert sorted(set(held.tolist())) == held.tolist()
    assert len(used) >= times // 3
    assert (used[:, None] - held[None]).abs().min() == (5 if blocks else 1)  # 12 are too few for gaps
    assert 1 + int((held.diff() > 1).sum()) == max(1, blocks)


@pytest.mark.parametrize("times", [1, 2, 5, 9])
def test_very_short_windows_still_have_times_of_both_kinds(times):
    used, held = split_times(times, blocks=4, gap=4, device=CPU)
    assert len(used) >= 1
    assert len(held) >= 1
    assert used.max() < times
    assert held.max() < times


def literal_error(network, problem, batch, e, i, j, times):
    """Mean squared error of UAV i from candidate j by j's own network, one time at a time."""
    row = e * batch.uavs + j
    slope, readout, linear, where = (weight[row].double() for weight in network.weights)
    shift, bias, gain, spread = (weight[row].double() for weight in network.free)
    total, count = 0.0, 0.0
    for t in times.tolist():
        if batch.weight[e, i, t] == 0:
            continue
        u = 1.7 * (batch.velocity[e, j, t] - batch.velocity[e, j].mean((0, 1))).reshape(-1).double()
        output = bias[0].clone()
        for c in range(len(u)):
            units = slope.shape[1]
            output += torch.tanh(slope[c] * u[c] + shift[c]) @ readout[c * units : (c + 1) * units] + u[c] * linear[c]
        offset = (batch.position[e, j, t] - batch.position[e, i, t]).double()
        output += torch.cat([offset / 300, offset / (offset.norm() + 1e-6)]) @ where
        output += problem.null[e, i, t].double() @ gain
        predicted = output / torch.sqrt((output**2).sum() + torch.exp(spread[0, 0]))
        total += float(((predicted - batch.target[e, i, t].double()) ** 2).sum())
        count += 1.0
    return total / count


@pytest.mark.parametrize("entries", [4_000_000, 1])
def test_errors_of_all_pairs(monkeypatch, entries):
    monkeypatch.setattr(per_candidate, "_CHUNK_ENTRIES", entries)
    batch, _ = batch_of(follow="f6", miss_rate=0.1)
    problem = Problem(batch, PerCandidate())
    network = AdditiveNetwork(8, 12, 6, torch.Generator().manual_seed(0))
    for parameter in (*network.weights, *network.free):
        parameter.data += 0.3 * torch.randn(parameter.shape, generator=torch.Generator().manual_seed(1))
    times = torch.arange(10, 24)
    rows = 4 * torch.arange(2)[:, None]
    got = compute_all_errors(problem, lambda columns: network.select((rows + columns).reshape(-1)), times)
    for e in range(2):
        for i in range(4):
            for j in range(4):
                expected = literal_error(network.select(torch.arange(8)), problem, batch, e, i, j, times)
                assert float(got[e, i, j]) == pytest.approx(expected, rel=1e-4)


def test_gains_are_log_ratios_of_the_nulls_error(monkeypatch):
    batch, _ = batch_of(miss_rate=0.1)
    settings = PerCandidate(steps=3)
    seen = []

    def watched(problem, select, times):
        errors = compute_all_errors(problem, select, times)
        seen.append((problem, times, errors))
        return errors

    monkeypatch.setattr(per_candidate, "compute_all_errors", watched)
    fit = fit_per_candidate(batch, settings, torch.Generator().manual_seed(0))
    used, held, untrained = (times for _, times, _ in seen[:3])  # the last for the choice of the winner
    assert sorted([*used.tolist(), *untrained.tolist()]) == list(range(batch.times))
    assert set(held.tolist()) < set(untrained.tolist())
    problem, times, errors = seen[1]
    for e, i, j in np.ndindex(2, 4, 4):
        weight = batch.weight[e, i, times]
        null = (problem.null_error[e, i, times] * weight).sum() / weight.sum()
        expected = 0.0 if i == j else float(torch.log((null + 1e-3) / (errors[e, i, j] + 1e-3)))
        assert float(fit.held_out_gain[e, i, j]) == pytest.approx(expected, abs=1e-5)


def test_the_winner_is_the_head_and_its_followers_attend_to_it():
    batch, heads = batch_of(count=4, followers=4, follow="f4")
    fit = fit_per_candidate(batch, PerCandidate(), torch.Generator().manual_seed(0))
    np.testing.assert_array_equal(fit.winner, heads)
    np.testing.assert_allclose(fit.attention.sum(2), 1.0, atol=1e-5)
    for e, head in enumerate(heads):
        followers = [i for i in range(5) if i != head]
        assert (fit.attention[e, followers, head] > 0.9).all()
        assert (fit.held_out_gain[e, followers, head] > 0.5).all()
        assert (fit.explained[e, followers] > 0.5).all()
        assert fit.explained[e].max() <= 1
    assert (fit.held_out_gain.diagonal(dim1=1, dim2=2) == 0).all()


def test_noise_on_the_sources_is_a_share_of_the_error_of_the_null_model():
    smooth = Problem(batch_of(follow="none", mobility="gauss_markov")[0], PerCandidate())
    random = Problem(batch_of(follow="none")[0], PerCandidate())
    assert smooth.noise.mean() < 0.7 * random.noise.mean()
    np.testing.assert_allclose(random.noise, 0.2, rtol=0.2)  # unit variance after scaling, nothing predicted
    assert (Problem(batch_of()[0], PerCandidate(input_noise=0.0)).noise == 0).all()


def test_selected_networks_are_copies_without_gradient():
    network = AdditiveNetwork(3, 12, 2, torch.Generator().manual_seed(0))
    part = network.select(torch.tensor([2, 0]))
    for whole, some in zip((*network.weights, *network.free), (*part.weights, *part.free), strict=True):
        np.testing.assert_array_equal(some, whole.detach()[[2, 0]])
        assert not some.requires_grad
