"""Weights on disk: the same again, or refused."""

import json
from hashlib import sha256

import pytest
import torch
from mc_gassl_inputs import parameters
from safetensors.torch import save

from detectors.mc_gassl.gru import NAMES, load_meta_weights, load_weights
from detectors.mc_gassl.train import MetaTraining
from detectors.weights import packaged_record, write_weights
from usnet_env.config import ArgumentError


@pytest.fixture
def saved(tmp_path):
    drawn = parameters(4, dtype=torch.float32)
    return write_weights(tmp_path / "new" / "w.safetensors", vars(drawn), {"seed": 1}, {"loss": 0.5}), drawn


def replace(path, data):
    """Other bytes, with a JSON that names them."""
    path.write_bytes(data)
    path.with_suffix(".json").write_text(json.dumps({"sha256": sha256(data).hexdigest()}))


def test_weights_come_back_as_they_were(saved):
    path, drawn = saved
    for a, b in zip(load_weights(path).tensors(), drawn.tensors(), strict=True):
        assert torch.equal(a, b)
    record = json.loads(path.with_suffix(".json").read_text())
    assert record == {
        "sha256": sha256(path.read_bytes()).hexdigest(),
        "training": {"seed": 1},
        "metrics": {"loss": 0.5},
    }
    assert sorted(file.name for file in path.parent.iterdir()) == ["w.json", "w.safetensors"]


def test_weights_that_the_record_does_not_name_are_refused(saved):
    path, _ = saved
    data = bytearray(path.read_bytes())
    data[-1] ^= 1
    path.write_bytes(data)
    with pytest.raises(ArgumentError, match="path must hold the weights that its JSON names"):
        load_weights(path)


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"\x80\x04}q\x00.", "must be a safetensors file"),  # a pickle
        (b"", "must be a safetensors file"),
        (save({"reset": torch.zeros(3, 6)}), "must hold the arrays reset, update, candidate"),
        (save({name: torch.full((3, 6), torch.nan) for name in NAMES}), "finite float32"),
        (save({name: torch.zeros(3, 6).double() for name in NAMES}), "finite float32"),
        (save({name: torch.zeros(3, 5) for name in NAMES}), "parameters must be three arrays"),
        (save({name: torch.zeros(()) for name in NAMES}), "parameters must be three arrays"),
    ],
)
def test_files_without_weights_are_refused(saved, data, message):
    path, _ = saved
    replace(path, data)
    with pytest.raises(ArgumentError, match=message):
        load_weights(path)


@pytest.mark.parametrize("record", ["", "[]", "{}", "\ufeff{"])
def test_a_broken_record_is_refused(saved, record):
    path, _ = saved
    path.with_suffix(".json").write_text(record, encoding="utf-8")
    with pytest.raises(ArgumentError, match="path must have a JSON with a sha256"):
        load_weights(path)


def test_a_missing_file_is_refused(saved, tmp_path):
    path, _ = saved
    with pytest.raises(ArgumentError, match="path must be a weights file"):
        load_weights(tmp_path / "none.safetensors")
    path.with_suffix(".json").unlink()
    with pytest.raises(ArgumentError, match="path must be a weights file"):
        load_weights(path)


def test_another_suffix_is_refused(tmp_path):
    with pytest.raises(ArgumentError, match=r"path must be a name that ends in \.safetensors"):
        write_weights(tmp_path / "w.pt", vars(parameters()), {}, {})


def test_the_shipped_weights_are_the_default_trainings():
    shipped, record = load_meta_weights(), packaged_record("detectors.mc_gassl", "meta")
    training = {name: value for name, value in record["training"].items() if name not in ("torch", "numpy")}
    assert training == MetaTraining().model_dump(mode="json")
    assert shipped.width == training["width"]
    assert training["seed"] < 1000
    metrics = record["metrics"]
    assert metrics["held_out_loss"] < 0.5 * metrics["held_out_loss_of_random_start"]
