"""neural-granger as a detector, and each function of its training against a slow and literal one."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from single_cluster_windows import cluster, clusters, detect_each, named, rate, without
from synthetic_windows import answer

from detectors.neural_granger import NeuralGranger, training
from detectors.series.designs import stack_past
from detectors.series.gaps import fill_gaps

SHORT = {"steps": 60}  # enough for an easy head


@pytest.mark.parametrize(
    ("swarm", "arguments", "least"),
    [
        ({"follow": "f4", "followers": 4}, {}, 1.0),
        ({"follow": "f1", "followers": 2}, {}, 1.0),
        ({"follow": "f4", "followers": 2, "decoys": 1}, {}, 1.0),
        ({"followers": 4, "miss_rate": 0.2}, {}, 0.6),
        ({"follow": "f4", "followers": 3}, {"gate": True}, 1.0),
    ],
)
def test_the_head_is_named(swarm, arguments, least):
    windows, heads = clusters(4, **swarm)
    assert rate(detect_each(NeuralGranger(**arguments, **SHORT), windows), heads) >= least


def test_the_gate_names_no_uav_where_none_is_followed_or_seen():
    windows, _ = clusters(4, follow="none", followers=4)
    gated = detect_each(NeuralGranger(gate=True, **SHORT), windows)
    assert np.mean(named(gated) == -1) >= 0.75
    for detection in gated:
        assert detection.extras["followed"] == detection.candidates.any()
    assert (named(detect_each(NeuralGranger(steps=5), windows)) >= 0).all()  # without the gate, the best guess
    for poor in (without(windows[0], [0, 1, 2]), replace(windows[0], seen=np.zeros_like(windows[0].seen))):
        assert not answer(NeuralGranger(gate=True), poor).candidates.any()


def test_an_answer_is_made_of_the_attention():
    window, _ = cluster(followers=4)
    got = answer(NeuralGranger(steps=5), window)
    assert (got.candidates.sum(), got.scores[got.candidates]) == (1, got.scores.max())
    np.testing.assert_allclose(got.attention.sum(axis=1), 1.0, atol=1e-5)
    np.testing.assert_array_equal(got.extras["choice"], got.attention.argmax(axis=1))
    np.testing.assert_array_equal(got.leader, (got.attention - 2 * np.eye(5)).argmax(axis=1))
    np.testing.assert_allclose(got.scores, (got.attention.sum(axis=0) - np.diag(got.attention)) / 5, atol=1e-9)
    assert got.extras["gain"].shape == (5,)


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a GPU")
def test_on_a_gpu():
    windows, heads = clusters(4, followers=4, follow="f3")
    assert rate(detect_each(NeuralGranger(device="cuda"), windows), heads) >= 0.75


CPU = torch.device("cpu")


def samples_of(seed=0, memory=4, **arguments):
    window, head = cluster(seed, **{"followers": 3} | arguments)
    return training.build_samples(window, np.arange(window.uavs), memory, CPU), window, head


@pytest.mark.parametrize("memory", [2, 4])
def test_samples_follow_the_index_convention(memory):
    one, window, _ = samples_of(memory=memory, miss_rate=0.2)
    whole, rows = fill_gaps(window), 100 - memory
    assert one.weight.shape == (4, rows)
    for i, row in [(0, 0), (2, 41), (3, rows - 1)]:
        t = row + memory - 1  # the newest velocity of the sample, v_t
        np.testing.assert_array_equal(one.target[i, row], window.velocity[t + 1, i])
        assert bool(one.weight[i, row]) == window.velocity_seen[t + 1, i]
        np.testing.assert_array_equal(one.position[i, row], whole.position[t, i])
        for lag in range(memory):
            np.testing.assert_array_equal(one.velocity[i, row, lag], whole.velocity[t - lag, i])
    part = training.build_samples(window, np.array([3, 1]), memory, CPU)
    np.testing.assert_array_equal(part.velocity, one.velocity[[3, 1]])


@pytest.mark.parametrize(("times", "blocks"), [(96, 4), (70, 4), (58, 3), (30, 1), (12, 0)])
def test_held_out_times_are_apart_from_those_of_training(times, blocks):
    used, held = training.split_times(times, blocks=4, gap=4, device=CPU)
    assert len(held) == max(1, blocks) * (times // (5 * max(1, blocks)))
    assert len(used) >= times // 3
    assert (used[:, None] - held[None]).abs().min() == (5 if blocks else 1)  # 12 are too few for gaps
    assert 1 + int((held.diff() > 1).sum()) == max(1, blocks)


def literal_error(network, problem, i, j, times):
    """Mean squared error of UAV i from candidate j by j's own network, one time at a time."""
    samples = problem.samples
    slope, readout, linear, where = (weight[j].double() for weight in network.weights)
    shift, bias, gain, spread = (weight[j].double() for weight in network.free)
    errors = []
    for t in times.tolist():
        if samples.weight[i, t] == 0:
            continue
        u = 1.7 * (samples.velocity[j, t] - samples.velocity[j].mean((0, 1))).reshape(-1).double()
        output, units = bias[0].clone(), slope.shape[1]
        for c in range(len(u)):
            output += torch.tanh(slope[c] * u[c] + shift[c]) @ readout[c * units : (c + 1) * units] + u[c] * linear[c]
        offset = (samples.position[j, t] - samples.position[i, t]).double()
        output += torch.cat([offset / 300, offset / (offset.norm() + 1e-6)]) @ where
        output += problem.null[i, t].double() @ gain
        predicted = output / torch.sqrt((output**2).sum() + torch.exp(spread[0, 0]))
        errors.append(float(((predicted - samples.target[i, t].double()) ** 2).sum()))
    return np.mean(errors)


@pytest.mark.parametrize("entries", [4_000_000, 1])
def test_errors_of_all_pairs(monkeypatch, entries):
    monkeypatch.setattr(training, "_CHUNK_ENTRIES", entries)
    problem = training.Problem(samples_of(follow="f6", miss_rate=0.1)[0], NeuralGranger())
    network = training.AdditiveNetwork.draw(4, 12, 6, torch.Generator().manual_seed(0))
    for parameter in (*network.weights, *network.free):
        parameter.data += 0.3 * torch.randn(parameter.shape, generator=torch.Generator().manual_seed(1))
    network, times = network.select(torch.arange(4)), torch.arange(10, 24)
    found = problem.compute_all_errors(network.select, times)
    for i, j in np.ndindex(4, 4):
        assert float(found[i, j]) == pytest.approx(literal_error(network, problem, i, j, times), rel=1e-4)


def test_noise_on_the_sources_is_a_share_of_the_error_of_the_null_model():
    smooth = training.Problem(samples_of(follow="none", mobility="gauss_markov")[0], NeuralGranger())
    random = training.Problem(samples_of(follow="none")[0], NeuralGranger())
    assert smooth.noise.mean() < 0.7 * random.noise.mean()
    np.testing.assert_allclose(random.noise, 0.2, atol=0.04)  # unit variance after scaling, nothing predicted
    assert not training.Problem(samples_of()[0], SimpleNamespace(ridge=1.0, input_noise=0.0)).noise.any()


@pytest.mark.parametrize(("rows", "gap"), [(40, 4), (30, 1), (3, 1)])
def test_predictions_from_a_uav_s_own_past_are_cross_fitted(rows, gap):
    steps = rows + 2
    rng = np.random.default_rng(5)
    velocity, seen = rng.standard_normal((steps, 6, 3)), rng.random((steps, 6)) >= 0.15
    past = stack_past(velocity, 2).reshape(6, rows, 6)
    target, weight = velocity[2:].swapaxes(0, 1), seen[2:].T.astype(float)
    found = training.predict_from_own_past(past, target, weight, 0.3, gap)
    for i in range(6):
        for row in range(rows):
            fold = [r for r in range(rows) if r * 8 // rows == row * 8 // rows]
            kept = [r for r in range(rows) if (r < fold[0] - gap or r > fold[-1] + gap) and weight[i, r]]
            gram, moment = 0.3 * np.eye(6), np.zeros((6, 3))
            for r in kept:
                gram += np.outer(past[i, r], past[i, r])
                moment += np.outer(past[i, r], target[i, r])
            np.testing.assert_allclose(found[i, row], past[i, row] @ np.linalg.solve(gram, moment), atol=1e-9)
