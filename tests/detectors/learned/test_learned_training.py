"""Training of the learned detector: the same weights whether interrupted or not, a loss that falls, files that hold."""

import json
from importlib.resources import files

import numpy as np
import pytest
import torch
from interrupted_training import Interrupted, read_losses, same_files, stop_at, unchanged_generators

from detectors.checks.windows import draw_window
from detectors.learned import Learned
from detectors.learned.detector import load_network
from detectors.learned.network import build_network
from detectors.learned.train import HeadTraining, train_heads
from detectors.random_swarms import draw_training_swarm
from detectors.weights import read_arrays, write_weights
from usnet_env.config import ArgumentError
from usnet_env.swarm.random_follow import RandomFollowStrategy

SMALL = {
    "steps": 6,
    "swarms": 2,
    "width": 8,
    "attn_heads": 2,
    "blocks": 1,
    "most_uavs": 16,
    "most_clusters": 2,
    "warm": 2,
}


def test_interrupted_training_goes_on_to_the_identical_result(tmp_path):
    training = HeadTraining(**SMALL)
    with unchanged_generators():
        whole = train_heads(tmp_path / "whole", training)
        with pytest.raises(Interrupted):
            train_heads(tmp_path / "parts", training, stop_at(5), checkpoint_every=4)
        assert not (tmp_path / "parts" / "learned.safetensors").exists()
        calls = []
        train_heads(tmp_path / "parts", training, lambda *call: calls.append(call), checkpoint_every=4)
    assert calls == [(5, 6), (6, 6)]
    same_files(tmp_path / "whole", tmp_path / "parts")
    with pytest.raises(ArgumentError, match="out must hold no checkpoint of another training"):
        train_heads(tmp_path / "parts", HeadTraining(**{**SMALL, "seed": 1}))
    anew = train_heads(tmp_path / "parts", HeadTraining(**{**SMALL, "seed": 1}), resume=False)
    assert whole.read_bytes() != anew.read_bytes()


def test_a_short_training_lowers_the_loss_and_writes_what_it_did(tmp_path):
    training = HeadTraining(**{**SMALL, "steps": 30, "swarms": 2, "width": 16, "rate": 1e-2})
    path = train_heads(tmp_path, training)
    record = json.loads((tmp_path / "learned.json").read_text())
    versions = {"torch": torch.__version__, "numpy": np.__version__}
    assert record["training"] == training.model_dump(mode="json") | versions
    rows = read_losses(tmp_path)
    assert [int(row["step"]) for row in rows] == list(range(1, 31))
    losses = [float(row["loss"]) for row in rows]
    metrics = record["metrics"]
    assert metrics["last_loss"] == pytest.approx(np.mean(losses[-15:]), abs=1e-5)
    assert np.mean(losses[-10:]) < 0.7 * np.mean(losses[:10])
    assert metrics["held_out_loss"] < np.mean(losses[:10])
    detector = Learned(weights=str(path))
    window = draw_window(detector, 9, 2)
    detector.reset(0)
    assert not np.array_equal(detector.detect(window).scores, Learned().detect(window).scores)


def test_swarms_of_training_are_of_every_kind():
    drawn = [draw_training_swarm(120, 10, np.random.default_rng(seed)) for seed in range(300)]
    assert all(config.follow == "none" or isinstance(config.follow, RandomFollowStrategy) for config in drawn)
    assert {config.mobility for config in drawn} >= {"iid", "gauss_markov", "smooth_turn", "waypoint"}
    assert {config.clusters for config in drawn} == set(range(1, 11))
    assert min(config.uavs for config in drawn) == 10
    assert 110 < max(config.uavs for config in drawn) <= 120
    assert min(config.observation_steps for config in drawn) < 12
    for name in ("decoys", "miss_rate", "position_noise", "head_jitter"):
        assert 0 < sum(bool(getattr(config, name)) for config in drawn) < 300


def test_the_shipped_weights_are_those_of_the_default_training():
    record = json.loads((files("detectors.learned") / "data" / "learned.json").read_text())
    plain = {name: value for name, value in record["training"].items() if name not in ("torch", "numpy")}
    assert HeadTraining(**plain) == HeadTraining()  # what the command trains by default
    assert record["metrics"]["last_loss"] < 0.5 * record["metrics"]["first_loss"]


def test_foreign_weights_are_refused(tmp_path):
    network = load_network()
    path = write_weights(tmp_path / "own.safetensors", network.state_dict(), {}, {"loss": 1})
    assert json.loads(path.with_suffix(".json").read_text())["metrics"] == {"loss": 1}
    for name, value in read_arrays(path).items():
        assert torch.equal(torch.as_tensor(value), network.state_dict()[name])
    with pytest.raises(ArgumentError, match="path must hold the arrays of a head network"):
        build_network("other", {"w": torch.zeros(3)})
    (tmp_path / "checkpoint.safetensors").write_bytes(b"half of one")
    for refused in (lambda: train_heads(tmp_path, HeadTraining(**SMALL)), lambda: read_arrays(tmp_path / "none")):
        with pytest.raises(ArgumentError, match="path must be a safetensors file"):
            refused()
