"""MC-GASSL as a detector: whole games by Algorithm 2, other stages, and small or empty clusters."""

import gymnasium as gym
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from swarm_games import ANY_GAME, InOrder, Known, game, play_any, played

import usnet_env
from detectors.gassl import Gassl
from detectors.mc_gassl import McGassl
from usnet_env import ArgumentError
from usnet_env.replay import EpisodeRecord, record_episode
from usnet_env.replay.recording import attention_maps

SMALL = {"gassl": {"steps": 2}}


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.slow)])
def test_algorithm_2_with_the_papers_stages_finds_all_heads(seed):
    """All heads of three clusters within a few rounds; random candidates of this number hit 1 head in 9."""
    detections, info = played(McGassl(), seed, clusters=3, uavs=27, observation_steps=60, max_rounds=20)
    assert info["success"] == 1
    assert len(detections) <= 3
    assert sum(int(answer.candidates.sum()) for answer in detections) <= 12
    assert all(len(answer.extras["online_loss"]) == 1 for answer in detections)


@pytest.mark.parametrize(("clusters", "uavs"), [(2, 12), pytest.param(3, 27, marks=pytest.mark.slow)])
def test_it_finds_the_heads_if_the_clusters_are_right(clusters, uavs):
    found = []
    for seed in range(3):
        env, window = game(seed, clusters=clusters, uavs=uavs, observation_steps=100)
        detector = McGassl(clusterer=Known(env.swarm.root))
        detector.reset(seed)
        answer = detector.detect(window)
        assert answer.candidates.sum() == clusters
        found.append((answer.candidates & env.swarm.head).sum())
    assert 9 * sum(found) >= 7 * 3 * clusters  # 7 of 9; one of 9 by chance


def test_an_answer_stays_within_the_clusters():
    _, window = game()
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


def test_its_attention_reaches_the_episode_file(tmp_path):
    """The weights of each attention head within the found clusters; their mean is alpha, equation (12)."""
    env = gym.make("USNET/MultiCluster-v0", follow="f1", clusters=2, uavs=14, observation_steps=40, max_rounds=2)
    detector = usnet_env.make_detector("mc-gassl(gassl={'steps': 2})")
    file = record_episode(env, detector, seed=0, detector_seed=0).save(tmp_path / "episode.npz")
    record = EpisodeRecord.load(file)
    assert record.attention_heads.shape == (record.rounds, 5, 14, 14)
    np.testing.assert_allclose(record.attention_heads.mean(axis=1), record.attention, atol=1e-6)
    apart = record.clusters[:, :, None] != record.clusters[:, None]
    assert record.attention.any(axis=(1, 2)).all()
    assert (record.attention_heads[np.broadcast_to(apart[:, None], record.attention_heads.shape)] == 0).all()
    titles = [title for title, _ in attention_maps(record, 0)]
    assert titles == ["all weights", *(f"attention head {number}" for number in range(1, 6))]


def test_one_gamma_goes_through_all_clusters(monkeypatch):
    begins, ends = [], []
    original = Gassl.fit_cluster

    def spy(self, window, members, gamma, rng):
        fit = original(self, window, members, gamma, rng)
        begins.append(gamma.copy())
        ends.append(fit.gamma.copy())
        return fit

    monkeypatch.setattr(Gassl, "fit_cluster", spy)
    detector = McGassl(clusterer=InOrder(3), **SMALL)
    detector.reset(0)
    detector.detect(game()[1])
    assert len(begins) == 3
    for end, begin in zip(ends, begins[1:], strict=False):
        np.testing.assert_array_equal(end, begin)
    assert not np.array_equal(begins[0], begins[1])


@pytest.mark.parametrize("count", [1, 6, 14])
def test_clusters_of_any_size_have_one_candidate_each(count):
    _, window = game()
    detector = McGassl(clusterer=InOrder(count), **SMALL)
    detector.reset(0)
    answer = detector.detect(window)
    assert answer.candidates.sum() == count
    labels = answer.clusters
    assert len(set(labels[answer.candidates].tolist())) == count


def test_the_candidate_of_a_small_cluster_is_random():
    _, window = game()
    named = set()
    for seed in range(12):
        detector = McGassl(clusterer=InOrder(7), online_steps=0, **SMALL)
        detector.reset(seed)
        named |= set(np.flatnonzero(detector.detect(window).candidates).tolist())
    assert named == set(range(14))


def test_a_random_start_is_not_the_meta_trained_one():
    _, window = game()
    losses = {}
    for start in ("meta", "random"):
        detector = McGassl(start=start, count=2, **SMALL)
        detector.reset(0)
        losses[start] = detector.detect(window).extras["online_loss"]
    assert losses["meta"] != losses["random"]


@pytest.mark.parametrize("steps", [0, 1, 3])
def test_there_is_one_loss_for_each_step_of_online_training(steps):
    detector = McGassl(online_steps=steps, count=2, **SMALL)
    detector.reset(0)
    assert len(detector.detect(game()[1]).extras["online_loss"]) == steps


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ({"gru_mode": "last"}, "gru_mode must be one of"),
        ({"start": "cold"}, "start must be one of"),
        ({"sampling": "easy"}, "sampling must "),
        ({"count": 0}, "count must "),
        ({"online_rate": 0.0}, "online_rate must "),
        ({"online_steps": -1}, "online_steps must "),
        ({"memory": 0}, "memory must "),
        ({"gassl": {"units": 3}}, "gassl must hold arguments of Gassl other than memory, got 'units'"),
        ({"gassl": {"memory": 3}}, "gassl must hold arguments of Gassl other than memory, got 'memory'"),
        ({"gassl": {"steps": 0}}, "steps must "),
    ],
)
def test_bad_arguments_are_refused(arguments, sentence):
    with pytest.raises(ArgumentError, match=f"^{sentence}"):
        McGassl(**arguments).reset(0)


def test_a_window_that_is_too_short_is_refused():
    _, window = game()
    short = usnet_env.Window(window.position[:5], window.velocity[:4], window.seen[:5], window.alive, 1)
    detector = McGassl(**SMALL)
    detector.reset(0)
    with pytest.raises(ArgumentError, match=r"^window must hold more than memory = 4 velocities, got 4\.$"):
        detector.detect(short)


def test_a_window_in_which_all_is_masked_teaches_nothing():
    _, window = game()
    unseen = usnet_env.Window(window.position, window.velocity, np.zeros_like(window.seen), window.alive, 1)
    detector, undisturbed = McGassl(**SMALL), McGassl(**SMALL)
    detector.reset(0)
    undisturbed.reset(0)
    answer = detector.detect(unseen)
    assert answer.candidates.sum() == 1
    assert not answer.scores.any()
    undisturbed.rng.permutation(window.uavs)  # the draw of the candidate
    np.testing.assert_array_equal(detector.detect(window).scores, undisturbed.detect(window).scores)


CLUSTERERS = st.sampled_from(["kmeans", "spectral", "agglomerative", "hdbscan", "snmf"])
FEATURES = st.sampled_from(["gru", "raw"])


def play(clusterer, features, **arguments):
    count = "own" if clusterer == "hdbscan" else "gap-one-se"
    play_any(McGassl(clusterer=clusterer, features=features, count=count, **SMALL), **arguments)


@settings(max_examples=8, deadline=None)
@given(clusterer=CLUSTERERS, features=FEATURES, **ANY_GAME)
def test_any_game_is_played_to_its_end(**arguments):
    play(**arguments)


def test_a_cluster_of_which_no_velocity_was_seen():
    """Three UAVs share a cluster, and none of them was seen at two successive instants."""
    _, window = game()
    seen = window.seen.copy()
    seen[::2, :7] = False
    detector = McGassl(clusterer=InOrder(2), **SMALL)
    detector.reset(0)
    answer = detector.detect(usnet_env.Window(window.position, window.velocity, seen, window.alive, 1))
    assert answer.candidates[:7].sum() == 1
    assert answer.candidates[7:].sum() == 1


@pytest.mark.slow
@settings(max_examples=500, deadline=None)
@given(clusterer=CLUSTERERS, features=FEATURES, **ANY_GAME)
def test_hundreds_of_games_are_played_to_their_end(**arguments):
    play(**arguments)
