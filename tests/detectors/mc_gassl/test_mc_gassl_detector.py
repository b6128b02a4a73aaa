"""MC-GASSL as a detector: whole games by Algorithm 2, other stages, and small or empty clusters."""

from dataclasses import replace

import numpy as np
import pytest
from single_cluster_windows import without
from synthetic_windows import swarm_window

from detectors.clustering import Clustering
from detectors.mc_gassl import McGassl

SMALL = {"gassl": {"steps": 2}}
GAME = {"clusters": 2, "uavs": 14, "observation_steps": 40}


class InOrder:
    """A clusterer that divides the living UAVs by index into ``count`` clusters."""

    def __init__(self, count=1):
        self.count = count

    def cluster(self, window, rng):
        living = np.flatnonzero(window.alive)
        labels = np.full(window.uavs, -1)
        labels[living] = np.arange(len(living)) * self.count // len(living)
        return Clustering(labels, self.count)


class Known:
    """A clusterer that knows the clusters."""

    def __init__(self, leader):
        self.leader = leader

    def cluster(self, window, rng):
        labels = np.unique(self.leader, return_inverse=True)[1]
        return Clustering(labels, int(labels.max()) + 1)


def test_training_finds_the_heads_if_the_clusters_are_right():
    """Each follower of f6 is pulled its own way, so no head is unlike them; by chance, 2.5 of 10 heads are found."""
    window, truth = swarm_window(follow="f6", clusters=10, uavs=40, cluster_sizes=[3] * 10, observation_steps=100)
    found = []
    for arguments in ({}, {"gassl": {"steps": 0}}):
        detector = McGassl(clusterer=Known(truth.root), **arguments)
        detector.reset(0)
        answer = detector.detect(window)
        assert answer.candidates.sum() == 10
        found.append((answer.candidates & truth.head).sum())
    assert found[0] >= 5 > found[1]


def test_an_answer_stays_within_the_clusters():
    window, _ = swarm_window(**GAME)
    labels = InOrder(3).cluster(window, None).labels
    detector = McGassl(clusterer=InOrder(3), **SMALL)
    detector.reset(0)
    answer = detector.detect(window)
    np.testing.assert_array_equal(answer.clusters, labels)
    assert [int(answer.candidates[labels == label].sum()) for label in range(3)] == [1, 1, 1]
    other = labels[:, None] != labels
    assert (answer.attention[other] == 0).all()
    np.testing.assert_allclose(answer.attention.sum(axis=1), 1.0, atol=1e-5)
    assert (labels[answer.leader] == labels).all()
    assert (answer.leader != np.arange(14)).all()
    for label in range(3):
        members = labels == label
        assert answer.scores[answer.candidates & members] == answer.scores[members].max()
    assert answer.extras["followed"].sum() == 14  # every UAV has one best head, equation (38)
    assert answer.extras["count"] == 3


@pytest.mark.parametrize("alive", [0, 1, 2])
def test_fewer_than_three_living_uavs(alive):
    living = np.arange(14) < alive
    detector = McGassl(**SMALL)
    detector.reset(0)
    window, _ = swarm_window(**GAME)
    answer = detector.detect(replace(window, seen=window.seen & living, alive=living, round=3))
    assert answer.candidates.sum() == min(1, alive)
    assert not (answer.candidates & ~living).any()


def windows_of_two_rounds(seed=0):
    """A window, and a later one in which three UAVs are destroyed."""
    config = {"uavs": 24, "clusters": 3, "follow": "f1", "observation_steps": 30}
    first, second = (swarm_window(seed + k, **config)[0] for k in range(2))
    return first, replace(without(second, range(3)), round=2)


def test_the_gru_network_is_carried_on_and_forgotten_by_reset():
    first, second = windows_of_two_rounds()
    carried, forgotten = McGassl(gassl={"steps": 1}, count=3), McGassl(gassl={"steps": 1}, count=3)
    for made in (carried, forgotten):
        made.reset(4)
    begin = carried.detect(first)
    assert begin.extras["online_loss"][0] > 0
    after = carried.detect(second)
    forgotten.detect(first)
    forgotten.reset(4)
    again = forgotten.detect(first)
    np.testing.assert_array_equal(begin.candidates, again.candidates)
    assert begin.extras["online_loss"] == again.extras["online_loss"]
    # with the network of round 1 and the same generator, round 2 has another loss
    frozen = McGassl(gassl={"steps": 1}, count=3, online_rate=1e-30)
    frozen.reset(4)
    frozen.detect(first)
    assert frozen.detect(second).extras["online_loss"] != after.extras["online_loss"]
