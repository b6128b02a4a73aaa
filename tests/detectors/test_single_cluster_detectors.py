"""What GASSL and neural-granger have in common: their answers, what these must not depend on, what is refused."""

from dataclasses import replace

import numpy as np
import pytest
from single_cluster_windows import cluster, without

from detectors.checks.windows import pick_uavs
from detectors.gassl import Gassl
from detectors.neural_granger import NeuralGranger
from usnet_env import ArgumentError

FEW = {"steps": 5}  # where the candidates don't matter


@pytest.fixture(params=[Gassl, NeuralGranger])
def kind(request):
    return request.param


@pytest.fixture
def detector(kind):
    """Makes detectors."""

    def make(seed=0, **arguments):
        made = kind(**arguments)
        made.reset(seed)
        return made

    return make


@pytest.mark.parametrize("top_k", [1, 3, 50])
def test_the_top_k_are_named(detector, top_k):
    window, _ = cluster(followers=4)
    got = detector(top_k=top_k, **FEW).detect(window)
    assert got.candidates.sum() == min(top_k, 5)
    if top_k == 3:
        assert got.scores[got.candidates].min() >= got.scores[~got.candidates].max()


def test_destroyed_uavs_are_left_out(detector):
    window, head = cluster(followers=6)
    gone = [i for i in range(7) if i != head][1:3]
    got = detector(top_k=7, **FEW).detect(without(window, gone))
    assert not got.candidates[gone].any()
    assert got.candidates.sum() == 5
    assert (got.scores[gone] == 0).all()
    assert (got.attention[gone] == 0).all()
    assert (got.attention[:, gone] == 0).all()
    assert (got.leader[gone] == -1).all()
    assert not np.isin(got.leader, gone).any()
    np.testing.assert_allclose(np.delete(got.attention, gone, axis=0).sum(axis=1), 1.0, atol=1e-5)


def test_a_window_that_is_too_short_is_refused(detector):
    window, _ = cluster(followers=4)
    short = replace(window, position=window.position[:5], velocity=window.velocity[:4], seen=window.seen[:5])
    with pytest.raises(ArgumentError, match="window must hold more than 4 velocities"):
        detector().detect(short)


def test_windows_that_show_nothing(detector):
    window, _ = cluster(followers=4)
    two = pick_uavs(window, np.arange(2))
    unseen = replace(window, seen=np.zeros_like(window.seen))
    for poor in (two, unseen):
        answer = detector(top_k=2).detect(poor)
        assert answer.candidates.sum() == 2
        assert not answer.scores.any()
    answer = detector().detect(without(window, list(range(5))))
    assert not answer.candidates.any()
