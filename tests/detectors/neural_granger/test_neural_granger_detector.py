"""neural-granger as a detector: its candidates, its gate, and the shape of an answer."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from single_cluster_windows import cluster, clusters, detect_each, named, rate, without
from synthetic_windows import answer

from detectors.neural_granger import NeuralGranger

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


def test_the_gate_names_no_uav_where_none_is_followed():
    windows, _ = clusters(4, follow="none", followers=4)
    gated = detect_each(NeuralGranger(gate=True, **SHORT), windows)
    assert np.mean(named(gated) == -1) >= 0.75
    for detection in gated:
        assert detection.extras["followed"] == detection.candidates.any()
    assert (named(detect_each(NeuralGranger(steps=5), windows)) >= 0).all()  # without the gate, the best guess


def test_an_answer_is_made_of_the_attention():
    window, _ = cluster(followers=4)
    got = answer(NeuralGranger(steps=5), window)
    assert got.candidates.sum() == 1
    assert got.scores[got.candidates] == got.scores.max()
    np.testing.assert_allclose(got.attention.sum(axis=1), 1.0, atol=1e-5)
    np.testing.assert_array_equal(got.extras["choice"], got.attention.argmax(axis=1))
    np.testing.assert_array_equal(got.leader, (got.attention - 2 * np.eye(5)).argmax(axis=1))
    np.testing.assert_allclose(got.scores, (got.attention.sum(axis=0) - np.diag(got.attention)) / 5, atol=1e-9)
    assert got.extras["gain"].shape == (5,)


def test_the_gate_names_no_uav_of_windows_that_show_nothing():
    window, _ = cluster(followers=4)
    for poor in (without(window, [0, 1, 2]), replace(window, seen=np.zeros_like(window.seen))):
        assert not answer(NeuralGranger(gate=True), poor).candidates.any()


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a GPU")
def test_on_a_gpu():
    windows, heads = clusters(4, followers=4, follow="f3")
    assert rate(detect_each(NeuralGranger(device="cuda"), windows), heads) >= 0.75
