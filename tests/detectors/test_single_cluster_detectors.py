"""What GASSL and neural-granger have in common: their answers, what these must not depend on, what is refused."""

from dataclasses import replace

import numpy as np
import pytest
from single_cluster_windows import cluster, without
from synthetic_windows import answer

from detectors.checks.windows import pick_uavs
from detectors.gassl import Gassl
from detectors.neural_granger import NeuralGranger
from usnet_env import ArgumentError

FEW = {"steps": 5}  # where the candidates don't matter


@pytest.fixture(params=[Gassl, NeuralGranger])
def kind(request):
    return request.param


@pytest.mark.parametrize("top_k", [1, 3, 50])
def test_the_top_k_are_named(kind, top_k):
    window, _ = cluster(followers=4)
    got = answer(kind(top_k=top_k, **FEW), window)
    assert got.candidates.sum() == min(top_k, 5)
    if top_k == 3:
        assert got.scores[got.candidates].min() >= got.scores[~got.candidates].max()


def test_destroyed_uavs_are_left_out(kind):
    window, head = cluster(followers=6)
    gone = [i for i in range(7) if i != head][1:3]
    got = answer(kind(top_k=7, **FEW), without(window, gone))
    assert not got.candidates[gone].any()
    assert got.candidates.sum() == 5
    assert (got.scores[gone] == 0).all()
    assert (got.attention[gone] == 0).all()
    assert (got.attention[:, gone] == 0).all()
    assert (got.leader[gone] == -1).all()
    assert not np.isin(got.leader, gone).any()
    np.testing.assert_allclose(np.delete(got.attention, gone, axis=0).sum(axis=1), 1.0, atol=1e-5)


def test_a_window_that_is_too_short_is_refused(kind):
    window, _ = cluster(followers=4)
    short = replace(window, position=window.position[:5], velocity=window.velocity[:4], seen=window.seen[:5])
    with pytest.raises(ArgumentError, match="window must hold more than 4 velocities"):
        kind().detect(short)


def test_windows_that_show_nothing(kind):
    window, _ = cluster(followers=4)
    two = pick_uavs(window, np.arange(2))
    unseen = replace(window, seen=np.zeros_like(window.seen))
    for poor in (two, unseen):
        got = answer(kind(top_k=2), poor)
        assert got.candidates.sum() == 2
        assert not got.scores.any()
    assert not answer(kind(), without(window, list(range(5)))).candidates.any()
