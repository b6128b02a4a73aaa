"""MC-GASSL as a detector: whole rounds and games, every stage exchanged, and what happens at the edges."""

import gymnasium as gym
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import usnet_env
from detectors.baselines.trivial import NoCandidates, RandomDetector
from detectors.clustering import Clustering
from detectors.gassl import Gassl
from detectors.mc_gassl import PRESETS, McGassl
from usnet_env import ArgumentError

SMALL = {"head_detector": Gassl(steps=3, times=8, voters=4), "gate_steps": 3, "passes": 1, "online_steps": 2}


def game(seed=0, **arguments):
    """A swarm of the first round: its env, its window."""
    arguments = {"follow": "f1", "clusters": 2, "uavs": 14, "observation_steps": 60} | arguments
    env = gym.make("USNET/MultiCluster-v0", **arguments).unwrapped
    observation, _ = env.reset(seed=seed)
    return env, usnet_env.Window.from_observation(observation)


def played(detector, seed=0, **arguments):
    """A whole game: detections round by round, and the last info."""
    env, window = game(seed, **arguments)
    detector.reset(seed)
    detections, over, info = [], False, {}
    while not over:
        detections.append(detector.detect(window))
        assert not (detections[-1].candidates & ~window.alive).any()
        observation, _, terminated, truncated, info = env.step(detections[-1].candidates)
        window = usnet_env.Window.from_observation(observation)
        over = terminated or truncated
    return detections, info


class OneLabel:
    """A clusterer that sees one cluster, or as many as it is told, in the order of the indices."""

    def __init__(self, count=1):
        self.count = count

    def cluster(self, window, rng):
        living = np.flatnonzero(window.alive)
        labels = np.full(window.uavs, -1)
        labels[living] = np.arange(len(living)) * self.count // len(living)
        return Clustering(labels, self.count)


@pytest.mark.parametrize("follow", ["f1", "f4", "f6"])
def test_it_finds_all_heads_at_once(follow):
    detections, info = played(McGassl(), follow=follow, observation_steps=100)
    assert info["success"] == 1
    assert len(detections) == 1
    found = detections[0]
    assert found.extras["count"] == 2
    assert (found.extras["followed"][found.candidates] >= 2).all()
    assert found.scores[found.candidates].min() > found.scores[~found.candidates].max()


class Halves:
    """A clusterer that knows the clusters and parts each of them."""

    def __init__(self, leader):
        self.leader = leader

    def cluster(self, window, rng):
        labels = np.unique(self.leader, return_inverse=True)[1] * 2
        for cluster in np.unique(labels):
            members = np.flatnonzero(labels == cluster)
            labels[members[: len(members) // 2]] += 1
        return Clustering(labels, int(labels.max()) + 1)


def test_the_gate_stops_followers_that_a_wrong_clustering_proposes():
    env, window = game(observation_steps=100, uavs=24)
    head = env.swarm.head
    open_gate, closed = (McGassl(clusterer=Halves(env.swarm.leader), gate=gate) for gate in ("none", "ifsn"))
    for detector in (open_gate, closed):
        detector.reset(3)
    free, kept = open_gate.detect(window), closed.detect(window)
    np.testing.assert_array_equal(free.candidates, free.extras["proposed"])
    assert free.candidates.sum() == 4
    np.testing.assert_array_equal(kept.candidates, head)
    assert (kept.candidates <= kept.extras["proposed"]).all()


def test_on_line_training_changes_the_features_of_the_next_round_and_a_reset_undoes_it():
    detector = McGassl(preset="paper", **SMALL)
    _, window = game()
    detector.reset(1)
    before = [tensor.clone() for tensor in detector._parameters.tensors()]
    answer = detector.detect(window)
    assert len(answer.extras["online_loss"]) == 2
    after = detector._parameters.tensors()
    assert max(float((old - new).abs().max()) for old, new in zip(before, after, strict=True)) > 0
    detector.reset(1)
    for old, new in zip(before, detector._parameters.tensors(), strict=True):
        np.testing.assert_array_equal(old, new)


def test_without_gru_features_nothing_is_learned_on_line():
    detector = McGassl(online=True, **SMALL)
    _, window = game()
    detector.reset(0)
    assert detector.detect(window).extras["online_loss"] == []


def test_a_random_start_differs_from_the_meta_learned_one():
    starts = {}
    for start in ("meta", "random"):
        detector = McGassl(preset="paper", start=start)
        detector.reset(0)
        starts[start] = detector._parameters.reset
    assert not np.array_equal(starts["meta"], starts["random"])


@pytest.mark.parametrize("gate", ["ifsn", "none"])
@pytest.mark.parametrize("count", [1, 6, 14])
def test_clusters_of_any_size(gate, count):
    _, window = game()
    detector = McGassl(clusterer=OneLabel(count), gate=gate, **SMALL)
    detector.reset(0)
    answer = detector.detect(window)
    assert answer.candidates.any()
    assert (answer.candidates <= answer.extras["proposed"]).all()
    if gate == "none":
        assert answer.candidates.sum() == count  # one of each


@pytest.mark.parametrize("alive", [0, 1, 2])
def test_hardly_anybody_lives(alive):
    _, window = game()
    some = np.arange(14) < alive
    part = usnet_env.Window(window.position, window.velocity, window.seen & some, some, 3)
    detector = McGassl(**SMALL)
    detector.reset(0)
    answer = detector.detect(part)
    assert answer.candidates.sum() == min(1, alive)
    assert not (answer.candidates & ~some).any()


def test_a_head_detector_of_ones_own_and_one_that_names_nobody():
    _, window = game()
    for head_detector in (RandomDetector(), NoCandidates()):
        detector = McGassl(head_detector=head_detector, gate_steps=3, passes=1)
        detector.reset(0)
        assert detector.detect(window).candidates.sum() >= 1  # the best one, where the gate has nobody to look at
    nobody = McGassl(head_detector=NoCandidates(), gate="none")
    nobody.reset(0)
    assert not nobody.detect(window).candidates.any()


@pytest.mark.parametrize("preset", PRESETS)
def test_the_seed_decides(preset):
    _, window = game()
    answers = []
    for _ in range(2):
        detector = McGassl(preset=preset, **SMALL)
        detector.reset(7)
        answers.append(detector.detect(window))
    for field in ("candidates", "scores", "clusters", "leader", "attention"):
        np.testing.assert_array_equal(getattr(answers[0], field), getattr(answers[1], field))


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ({"preset": "best"}, "preset must be one of"),
        ({"clusterer": "k-means"}, "clusterer must be one of"),
        ({"clusterer": 3}, "clusterer must be a name or have cluster"),
        ({"head_detector": 3}, "head_detector must have reset"),
        ({"gate": "open"}, "gate must be one of"),
        ({"gru_mode": "last"}, "gru_mode must be one of"),
        ({"start": "cold"}, "start must be one of"),
        ({"sampling": "easy"}, "sampling"),
        ({"count": 0}, "count"),
        ({"passes": 0}, "passes"),
        ({"followers": 0}, "followers"),
        ({"online_rate": 0.0}, "online_rate"),
        ({"memory": 0}, "memory"),
    ],
)
def test_bad_arguments(arguments, sentence):
    with pytest.raises(ArgumentError, match=sentence):
        McGassl(**arguments).reset(0)


ANY_GAME = given(
    uavs=st.integers(3, 40),
    clusters=st.integers(1, 8),
    follow=st.sampled_from(["f1", "f4", "f6", "f7", "none"]),
    steps=st.integers(6, 40),
    miss_rate=st.sampled_from([0.0, 0.3]),
    decoys=st.integers(0, 2),
    rounds=st.integers(1, 4),
    preset=st.sampled_from(list(PRESETS)),
    clusterer=st.sampled_from([None, "kmeans", "spectral", "agglomerative", "hdbscan", "snmf"]),
    gate=st.sampled_from([None, "ifsn", "none"]),
    seed=st.integers(0, 2**31 - 1),
)


def play_any(uavs, clusters, follow, steps, miss_rate, decoys, rounds, preset, clusterer, gate, seed):
    clusters = max(1, min(clusters, (uavs - decoys) // 3)) if follow != "none" else 1
    uavs = max(uavs, 3 * clusters + decoys)
    detector = McGassl(preset=preset, clusterer=clusterer, gate=gate, **SMALL)
    detections, info = played(
        detector, seed, uavs=uavs, clusters=clusters, follow=follow, observation_steps=steps, miss_rate=miss_rate,
        decoys=decoys, max_rounds=rounds,
    )  # fmt: skip
    assert 1 <= len(detections) <= rounds
    assert info["round"] == len(detections)


@settings(max_examples=15, deadline=None)
@ANY_GAME
def test_any_game_is_played_to_its_end(**arguments):
    play_any(**arguments)


def test_a_cluster_of_which_nothing_was_seen_is_played_on():
    """Found by the thousand games below: three UAVs share a cluster, and none was seen twice in a row."""
    play_any(
        uavs=13, clusters=2, follow="f1", steps=6, miss_rate=0.3, decoys=2, rounds=1, preset="default",
        clusterer="spectral", gate=None, seed=6,
    )  # fmt: skip


@pytest.mark.slow
@settings(max_examples=1000, deadline=None)
@ANY_GAME
def test_a_thousand_games_are_played_to_their_end(**arguments):
    play_any(**arguments)
