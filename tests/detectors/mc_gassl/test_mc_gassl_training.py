"""Trainings: the steps against finite differences; the same weights whether interrupted or not; ``usnet train``."""

import json
from importlib.resources import files

import numpy as np
import pytest
import torch
from click.testing import CliRunner
from interrupted_training import Interrupted, read_losses, same_files, stop_at, unchanged_generators
from mc_gassl_inputs import clustered, generator, parameters

from detectors.commands import train
from detectors.mc_gassl.gru import GruParameters, load_meta_weights, read_parameters
from detectors.mc_gassl.train import MetaTraining, draw_task, train_meta
from detectors.mc_gassl.training_steps import Task, take_meta_step, train_online
from detectors.mc_gassl.triplet import Metric, compute_batch_loss
from detectors.weights import read_arrays
from usnet_env.config import ArgumentError

# Every hinge is far from its kink, so that differences are derivatives; the triplets don't depend on the weights.
SMOOTH = MetaTraining(margin=5.0, times=3, anchors=10, inner_rate=0.3, outer_rate=0.2)


def task(seed=0):
    return Task(clustered(seed=seed), clustered(seed=seed + 100))


def numerical_gradient(loss, at, step=1e-6):
    gradients = []
    for k, tensor in enumerate(at):
        gradient = torch.zeros_like(tensor)
        for index in torch.cartesian_prod(*(torch.arange(length) for length in tensor.shape)):
            ends = []
            for sign in (1.0, -1.0):
                moved = [array.clone() for array in at]
                moved[k][tuple(index)] += sign * step
                ends.append(float(loss(GruParameters(*moved))))
            gradient[tuple(index)] = (ends[0] - ends[1]) / (2.0 * step)
        gradients.append(gradient)
    return gradients


def less(at, rate, gradients):
    return GruParameters(*(tensor - rate * g for tensor, g in zip(at, gradients, strict=True)))


def assert_equal_parameters(one, two, tolerance=0.0):
    for a, b in zip(one, two, strict=True):
        torch.testing.assert_close(a, b, rtol=0.0, atol=tolerance)
        assert not a.requires_grad


def losses_of(drawn, metric, own):
    """Support and query loss as functions of the weights, on the batches that a step draws from ``own``."""
    functions = []
    for swarm in (drawn.support, drawn.query):
        state = own.get_state()

        def loss(at, swarm=swarm, state=state):
            return compute_batch_loss(at, swarm.inputs, swarm.labels, metric, generator().set_state(state))

        functions.append(loss)
        compute_batch_loss(parameters(), swarm.inputs, swarm.labels, metric, own)  # moves ``own`` on to the next batch
    return functions


def test_the_meta_step_is_equations_35_and_36_to_first_order():
    drawn, at = task(), parameters()
    support, query = losses_of(drawn, SMOOTH, generator(5))
    temporary = less(at, 0.3, numerical_gradient(support, at))
    want = less(at, 0.2, numerical_gradient(query, temporary))
    found, loss = take_meta_step(at, drawn, SMOOTH, generator(5))
    assert_equal_parameters(found, want, 1e-7)
    assert loss == pytest.approx(float(query(temporary)), abs=1e-7)
    # neither a plain step from W, nor one from the temporary parameters, nor the whole derivative through both steps
    plain = less(at, 0.2, numerical_gradient(query, at))
    from_temporary = less(temporary, 0.2, numerical_gradient(query, temporary))
    whole_gradient = torch.autograd.grad(through_both(support, query, at, 0.3), at)
    for other in (plain, from_temporary, less(at, 0.2, whole_gradient)):
        assert max((a - b).abs().max() for a, b in zip(found, other, strict=True)) > 1e-3


def through_both(support, query, at, rate):
    """L_Q(W - alpha grad L_S(W)) with its whole graph: second-order meta learning."""
    for tensor in at:
        tensor.requires_grad_(True)
    gradients = torch.autograd.grad(support(at), at, create_graph=True)
    return query(less(at, rate, gradients))


def separable(seed=0):
    """Clusters whose UAVs share their velocities but for a little noise, at positions that tell nothing."""
    swarm = clustered(times=30, uavs=12, clusters=3, seed=seed)
    velocity = swarm.inputs.velocity
    velocity[:, :] = velocity[:, swarm.labels] + 0.05 * velocity[:, torch.arange(12).roll(1)]
    swarm.inputs.position.mul_(0.2)
    return swarm


def test_online_training_parts_the_clusters():
    swarm = separable()
    at = parameters(spread=0.3)
    kept = GruParameters(*map(torch.clone, at))
    before = torch.random.get_rng_state()
    _, losses = train_online(at, *swarm, Metric(), 80, 0.5, generator(1))
    assert len(losses) == 80
    assert sum(losses[-10:]) < 0.5 * sum(losses[:10])
    assert_equal_parameters(at, kept)
    again, same = (train_online(at, *swarm, Metric(), 5, 0.5, generator(1)) for _ in range(2))
    assert again[1] == same[1] == losses[:5]
    assert_equal_parameters(again[0], same[0])
    assert torch.equal(before, torch.random.get_rng_state())


@pytest.mark.parametrize("labels", [[0] * 9, list(range(9)), [-1] * 9])
def test_online_training_without_a_triplet_changes_nothing(labels):
    at = parameters()
    found, losses = train_online(at, clustered().inputs, torch.tensor(labels), SMOOTH, 3, 1.0, generator())
    assert_equal_parameters(found, at)
    assert losses == [0.0, 0.0, 0.0]


SMALL = {"strategies": 3, "episodes": 12, "uavs": 16, "clusters": 3, "observation_steps": 12, "times": 2, "anchors": 20}


@pytest.mark.parametrize("method", ["meta", "joint"])
def test_interrupted_training_goes_on_to_the_identical_result(tmp_path, method):
    training = MetaTraining(method=method, **SMALL)
    with unchanged_generators():
        train_meta(tmp_path / "whole", training, checkpoint_every=100)
        with pytest.raises(Interrupted):
            train_meta(tmp_path / "parts", training, stop_at(3 + 5), checkpoint_every=5)
        assert not (tmp_path / "parts" / f"{method}.safetensors").exists()
        calls = []
        train_meta(tmp_path / "parts", training, lambda *call: calls.append(call), checkpoint_every=5)
    assert calls == [(1, 15), (2, 15), (3, 15), (13, 15), (15, 15)]
    same_files(tmp_path / "whole", tmp_path / "parts")


def test_training_can_be_prolonged_but_not_cut_short_or_changed(tmp_path):
    long = train_meta(tmp_path / "long", MetaTraining(**SMALL))
    short = {**SMALL, "episodes": 7}
    train_meta(tmp_path / "grown", MetaTraining(**short))
    grown = train_meta(tmp_path / "grown", MetaTraining(**SMALL))
    assert long.read_bytes() == grown.read_bytes()
    with pytest.raises(ArgumentError, match="episodes must be at least the 12"):
        train_meta(tmp_path / "grown", MetaTraining(**short))
    with pytest.raises(ArgumentError, match="out must hold no checkpoint of another training"):
        train_meta(tmp_path / "grown", MetaTraining(seed=1, **SMALL))
    anew = train_meta(tmp_path / "grown", MetaTraining(seed=1, **SMALL), resume=False)
    assert long.read_bytes() != anew.read_bytes()


def test_a_task_is_two_swarms_of_one_strategy():
    task = draw_task(MetaTraining(**SMALL), 1)
    for swarm in (task.support, task.query):
        assert swarm.inputs.velocity.shape == (9, 16, 4, 3)
        assert sorted(set(swarm.labels.tolist())) == [0, 1, 2]
        assert torch.bincount(swarm.labels).min() >= 3
    assert not torch.equal(task.support.inputs.position, task.query.inputs.position)
    again = draw_task(MetaTraining(**SMALL), 1)
    assert torch.equal(task.query.inputs.velocity, again.query.inputs.velocity)


def test_training_beats_a_random_start_on_strategies_it_has_not_seen_and_is_recorded(tmp_path):
    training = MetaTraining(**{**SMALL, "episodes": 60, "anchors": 60})
    path = train_meta(tmp_path, training)
    record = json.loads(path.with_suffix(".json").read_text())
    losses = [float(row["loss"]) for row in read_losses(tmp_path)]
    assert record["training"].items() >= training.model_dump(mode="json").items()
    assert len(losses) == 60
    metrics = record["metrics"]
    assert metrics["last_loss"] == pytest.approx(np.mean(losses[-30:]))
    assert metrics["held_out_loss"] < 0.8 * metrics["held_out_loss_of_random_start"]
    assert read_parameters(read_arrays(path)).reset.shape == (3, 6)


def test_the_shipped_weights_are_the_default_trainings():
    record = json.loads((files("detectors.mc_gassl") / "data" / "meta.json").read_text())
    training = {name: value for name, value in record["training"].items() if name not in ("torch", "numpy")}
    assert training == MetaTraining().model_dump(mode="json")
    assert load_meta_weights().reset.shape == (3, 6)
    assert record["metrics"]["held_out_loss"] < 0.5 * record["metrics"]["held_out_loss_of_random_start"]


@pytest.mark.parametrize("seed", [0, 3])
def test_a_training_writes_its_files_and_prints_the_path(tmp_path, seed):
    words = ["meta", "--strategies", "1", "--episodes", "2", "--method", "joint", *(["--seed", "3"] if seed else [])]
    done = CliRunner().invoke(train, [*words, "--out", str(tmp_path)], catch_exceptions=False)
    assert done.exit_code == 0
    assert str(tmp_path) in done.stdout
    assert json.loads((tmp_path / "joint.json").read_text())["training"]["seed"] == seed
    with pytest.raises(ArgumentError, match="out must be a folder that can be written"):
        CliRunner().invoke(train, ["meta", "--out", str(tmp_path / "joint.json" / "out")], catch_exceptions=False)
