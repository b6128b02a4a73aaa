"""Off-line training: the same weights whether interrupted or not, and better than a random start."""

import json

import numpy as np
import pytest
import torch
from interrupted_training import Interrupted, read_losses, same_files, stop_at, unchanged_generators

from detectors.mc_gassl.gru import load_weights
from detectors.mc_gassl.train import MetaTraining, draw_task, train_meta
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
    train_meta(tmp_path / "grown", MetaTraining(**short), workers=2)
    grown = train_meta(tmp_path / "grown", MetaTraining(**SMALL))
    assert long.read_bytes() == grown.read_bytes()
    with pytest.raises(ArgumentError, match="episodes must be at least the 12"):
        train_meta(tmp_path / "grown", MetaTraining(**short))
    with pytest.raises(ArgumentError, match="out must hold no checkpoint of another training"):
        train_meta(tmp_path / "grown", MetaTraining(seed=1, **SMALL))
    anew = train_meta(tmp_path / "grown", MetaTraining(seed=1, **SMALL), resume=False)
    assert long.read_bytes() != anew.read_bytes()


def test_what_is_written(tmp_path):
    training = MetaTraining(seed=5, **SMALL)
    path = train_meta(tmp_path, training)
    record = json.loads((tmp_path / "meta.json").read_text())
    assert load_weights(path).width == 3
    versions = {"torch": torch.__version__, "numpy": np.__version__}
    assert record["training"] == training.model_dump(mode="json") | versions
    rows = read_losses(tmp_path)
    assert [int(row["episode"]) for row in rows] == list(range(1, 13))
    losses = [float(row["loss"]) for row in rows]
    assert record["metrics"]["last_loss"] == pytest.approx(np.mean(losses[-6:]))


def test_a_broken_checkpoint_is_refused(tmp_path):
    (tmp_path / "checkpoint.safetensors").write_bytes(b"half of one")
    with pytest.raises(ArgumentError, match="path must be a safetensors file"):
        train_meta(tmp_path, MetaTraining(**SMALL))


def test_a_task_is_two_swarms_of_one_strategy():
    task = draw_task(MetaTraining(**SMALL), 1)
    for swarm in (task.support, task.query):
        assert swarm.inputs.velocity.shape == (9, 16, 4, 3)
        assert sorted(set(swarm.labels.tolist())) == [0, 1, 2]
        assert torch.bincount(swarm.labels).min() >= 3
    assert not torch.equal(task.support.inputs.position, task.query.inputs.position)
    again = draw_task(MetaTraining(**SMALL), 1)
    assert torch.equal(task.query.inputs.velocity, again.query.inputs.velocity)


@pytest.mark.parametrize(
    "size",
    [
        {"strategies": 6, "episodes": 80, "uavs": 18, "anchors": 60},
        pytest.param({"strategies": 10, "episodes": 200, "uavs": 30, "anchors": 90}, marks=pytest.mark.slow),
    ],
)
def test_training_beats_a_random_start_on_strategies_it_has_not_seen(tmp_path, size):
    path = train_meta(tmp_path, MetaTraining(**{**SMALL, **size}))
    metrics = json.loads(path.with_suffix(".json").read_text())["metrics"]
    assert metrics["held_out_loss"] < 0.7 * metrics["held_out_loss_of_random_start"]
    assert metrics["last_loss"] < metrics["first_loss"]


@pytest.mark.parametrize("bad", [{"episodes": 0}, {"strategies": 0}, {"seed": -1}, {"method": "maml"}, {"width": 2}])
def test_bad_settings_are_refused(bad):
    with pytest.raises(ArgumentError, match=next(iter(bad))):
        MetaTraining(**bad)


@pytest.mark.parametrize("bad", [0, 1.5, True])
def test_a_bad_checkpoint_interval_is_refused(tmp_path, bad):
    with pytest.raises(ArgumentError, match="checkpoint_every"):
        train_meta(tmp_path, MetaTraining(**SMALL), checkpoint_every=bad)
