"""Off-line training: the same weights whether interrupted or not, and better than a random start."""

import json
from importlib.resources import files

import numpy as np
import pytest
import torch
from interrupted_training import Interrupted, read_losses, same_files, stop_at, unchanged_generators

from detectors.mc_gassl.gru import load_meta_weights, read_parameters
from detectors.mc_gassl.train import MetaTraining, draw_task, train_meta
from detectors.weights import read_arrays
from usnet_env.config import ArgumentError

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
