"""Training of the reader: the same weights whether interrupted or not, a loss that falls, families that stay out."""

import json
from itertools import islice

import numpy as np
import pytest
import torch
from interrupted_training import Interrupted, read_losses, same_files, stop_at, unchanged_generators

from detectors.reader import draws, train
from detectors.reader.features import CONTEXT_FEATURES, PAIR_FEATURES, UAV_FEATURES, Features
from detectors.reader.forward import Answer, load_reader, predict
from detectors.reader.prior import FAMILIES, PRIOR_VERSION
from detectors.reader.train import ReaderTraining, compute_loss, train_reader
from usnet_env.config import ArgumentError

SMALL = {"width": 8, "attn_heads": 2, "blocks": 1, "shards": 3, "batches": 2, "windows": 2, "most_uavs": 10}


@pytest.fixture(autouse=True)
def cheap_draws(monkeypatch):
    """Windows of one family of the prior, so that the tests wait for no other."""
    plain = draws.draw_examples
    monkeypatch.setattr(draws, "draw_examples", lambda *given, **named: plain(*given, **named, family="random"))


def train_serially(folder, *given, **settings):
    return train_reader(folder, ReaderTraining(**{**SMALL, **settings}), *given, backend="serial")


def test_interrupted_training_goes_on_to_the_identical_result(tmp_path):
    with unchanged_generators():
        whole = train_serially(tmp_path / "whole")
        with pytest.raises(Interrupted):
            train_serially(tmp_path / "parts", stop_at(2))
        assert not (tmp_path / "parts" / "reader.safetensors").exists()
        calls = []
        train_serially(tmp_path / "parts", lambda *call: calls.append(call))
    assert calls == [(3, 3)]
    same_files(tmp_path / "whole", tmp_path / "parts")
    with pytest.raises(ArgumentError, match="out must hold no checkpoint of another training"):
        train_serially(tmp_path / "parts", seed=1)
    assert whole.read_bytes() != train_serially(tmp_path / "other", seed=1).read_bytes()


def test_a_training_that_is_repeated_on_few_windows_learns_them(tmp_path, monkeypatch):
    shard = next(train._draw_shards(ReaderTraining(**{**SMALL, "batches": 3}), range(1), 1, "serial"))
    monkeypatch.setattr(train, "draw_shard", lambda number, **settings: shard)
    monkeypatch.setattr(train, "_WARM", 10)
    path = train_serially(tmp_path, shards=40, batches=3, width=16)
    rows = read_losses(tmp_path)
    assert [int(row["shard"]) for row in rows] == list(range(1, 41))
    losses = [float(row["loss"]) for row in rows]
    assert np.mean(losses[-5:]) < 0.4 * np.mean(losses[:5])
    record = json.loads(path.with_suffix(".json").read_text())
    assert record["training"]["prior"] == PRIOR_VERSION
    assert record["metrics"]["last_loss"] == pytest.approx(np.mean(losses[-5:]), abs=1e-5)
    families = [json.loads(line)["families"] for line in (tmp_path / "families.jsonl").read_text().splitlines()]
    right, windows = families[-1]["random"]
    assert right / windows == pytest.approx(float(rows[-1]["exact"]), abs=1e-4)
    assert record["metrics"]["last_exact"] >= 0.5 > float(rows[0]["exact"])


def test_a_training_that_starts_from_weights_keeps_their_standards(tmp_path):
    first = train_serially(tmp_path / "first", shards=1)
    second = train_serially(tmp_path / "second", shards=1, start=str(first), seed=5)
    one, two = load_reader(str(first)), load_reader(str(second))
    for name in ("pair_mean", "pair_scale", "uav_mean", "context_scale"):
        np.testing.assert_array_equal(one[name], two[name])
    moved = np.abs(two["enter.weight"] - one["enter.weight"]).max()
    assert 0 < moved < 1e-3  # two small steps
    with pytest.raises(ArgumentError, match=r"^start must hold a network of these sizes, got"):
        train_serially(tmp_path / "wider", start=str(first), width=16)


def test_a_blind_network_reads_nothing_of_pairs(tmp_path):
    weights = load_reader(str(train_serially(tmp_path, shards=1, blind=True)))
    rng = np.random.default_rng(0)
    shapes = (6, 6, PAIR_FEATURES), (6, UAV_FEATURES), (CONTEXT_FEATURES,)
    features = Features(*(rng.standard_normal(shape, np.float32) for shape in shapes))
    other = features._replace(pair=rng.standard_normal(shapes[0], np.float32))
    np.testing.assert_array_equal(predict(weights, features).head, predict(weights, other).head)
    alone = features._replace(uav=features.uav + np.eye(UAV_FEATURES, dtype=np.float32)[0])
    assert (predict(weights, features).head != predict(weights, alone).head).any()


@pytest.mark.slow
def test_processes_draw_the_shards_in_order(monkeypatch):
    monkeypatch.undo()  # of what other processes don't see
    training = ReaderTraining(**{**SMALL, "batches": 1}, without=tuple(name for name in FAMILIES if name != "none"))
    ahead = list(train._draw_shards(training, range(1, 3), 2, None))
    serial = train._draw_shards(training, range(1, 3), 1, "serial")
    for one, other in zip(ahead, serial, strict=True):
        for left, right in zip(one, other, strict=True):
            assert left[1].family == right[1].family == "none"
            for a, b in zip((*left[0], *left[1][:-1]), (*right[0], *right[1][:-1]), strict=True):
                np.testing.assert_array_equal(a, b)


def test_a_draw_that_fails_ends_the_training(tmp_path, monkeypatch):
    def fail(*_given, **_named):
        raise ZeroDivisionError("no luck")

    monkeypatch.setattr(draws, "draw_examples", fail)
    with pytest.raises(ZeroDivisionError, match="no luck"):
        train_serially(tmp_path)


def test_the_loss_of_right_answers_is_small_and_unknown_delays_count_nothing():
    head = torch.tensor([[True, False, False]])
    leader, delay = torch.tensor([[0, 0, 1]]), torch.tensor([[np.nan, 2.0, 3.0]])
    root, link = torch.tensor([[0, 0, 0]]), torch.tensor([[[np.nan, 0, 0], [1.0, 0, 0], [0, 1, 0]]])

    def answer(sign, known):
        logits = [sign * 20.0 * torch.nn.functional.one_hot(right, 3).float() for right in (leader, root)]
        logits.append(sign * (40.0 * link.nan_to_num(0.5) - 20.0))
        return Answer(sign * (40.0 * head - 20.0), *logits, torch.tensor([-20.0 * sign]), known)

    right = torch.tensor([[99.0, np.log1p(2.0), np.log1p(3.0)]], dtype=torch.float32)
    assert compute_loss(answer(1, right), head, leader, root, link, delay) < 1e-5
    assert compute_loss(answer(1, right + 1.0), head, leader, root, link, delay) == pytest.approx(0.05, abs=1e-4)
    assert compute_loss(answer(-1, right), head, leader, root, link, delay) == pytest.approx(
        60 / 3**0.5 + 0.6 * 20 + 0.3 * 20 + 0.2 * 160 / 3 + 0.3 * 20, rel=0.01
    )
    assert torch.isfinite(compute_loss(answer(1, right), head, leader, root, link, torch.full((1, 3), np.nan)))


def test_unknown_settings_are_refused_in_one_sentence(tmp_path):
    with pytest.raises(ArgumentError, match=r"^without must be one of .*, got 'starlings'"):
        train_serially(tmp_path, without=("starlings",))
    if not torch.cuda.is_available():
        with pytest.raises(ArgumentError, match=r"^device must be 'cpu' where torch finds no CUDA device, got 'cuda'"):
            train_serially(tmp_path, device="cuda")
    assert list(islice(tmp_path.iterdir(), 1)) == []
