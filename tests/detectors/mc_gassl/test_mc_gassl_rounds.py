"""Two rounds of the default MC-GASSL against Algorithm 2 written out with the paper's stages, one after another."""

from functools import partial

import numpy as np
import pytest
import torch
from mc_gassl_inputs import swarm_window

from detectors.clustering import make_clusterer
from detectors.gassl import Gassl
from detectors.gassl.topology_matrix import build_batch
from detectors.gassl.training import prepare_inputs
from detectors.mc_gassl import McGassl
from detectors.mc_gassl.algorithm_2 import best_heads, count_scores, recluster
from detectors.mc_gassl.features import gru_features, inputs_of
from detectors.mc_gassl.gru import GruParameters, load_meta_weights
from detectors.mc_gassl.triplet import Metric, batch_loss
from detectors.series.votes import choose_heads, count_votes, select_top
from usnet_env import Window

STEPS = 6  # Ω


def play_round(window, weights, rng):
    """A round by Algorithm 2's lines: what it finds, and W for the next round."""
    # lines 2 and 3: the GRU network's newest features, M̂ by the gap statistic, K-Means
    features = partial(gru_features, parameters=weights, mode="single")
    clustering = make_clusterer("kmeans", features=features, count="gap-one-se").cluster(window, rng)
    # line 4: Algorithm 1 in every cluster, one Γ for all
    gassl = Gassl(steps=STEPS)
    gamma = gassl.draw_gamma(rng)
    candidates, scores = np.zeros(window.uavs, bool), np.zeros(window.uavs)
    for label in range(clustering.count):
        members = np.flatnonzero(clustering.labels == label)
        if len(members) < 3:
            candidates[rng.choice(members)] = True
            continue
        fit = gassl.fit_cluster(window, members, gamma, rng)
        gamma = fit.gamma
        attention = fit.attention.astype(np.float64)
        choose_heads(attention, True, rng)  # the leaders
        c = count_votes(choose_heads(attention, False, rng))
        scores[members] = c
        candidates[members[select_top(c, 1, rng)]] = True
    # line 5: equations (37), (38) and (39)
    living = np.flatnonzero(window.alive)
    chosen = best_heads(prepare_inputs(build_batch(window, living)), gamma)
    followed, labels = np.zeros(window.uavs), np.full(window.uavs, -1)
    followed[living] = count_scores(chosen)
    labels[living] = recluster(chosen, clustering.count, rng)
    generator = torch.Generator().manual_seed(int(rng.integers(2**63)))
    at = [tensor.clone().requires_grad_() for tensor in weights.tensors()]
    loss = batch_loss(
        GruParameters(*at), inputs_of(window), torch.from_numpy(labels), Metric(sampling="hard"), generator
    )
    gradients = torch.autograd.grad(loss, at)
    moved = GruParameters(
        *(tensor - 1.0 * gradient for tensor, gradient in zip(weights.tensors(), gradients, strict=True))
    )
    return clustering, candidates, scores, followed, loss.item(), moved


def windows_of_two_rounds(seed=0):
    """A window, and a later one in which three UAVs are destroyed."""
    config = {"uavs": 24, "clusters": 3, "follow": "f1", "observation_steps": 30}
    first, (second, _) = swarm_window(seed, **config)[0], swarm_window(seed + 1, **config)
    alive = np.arange(24) >= 3
    return first, Window(second.position, second.velocity, second.seen & alive, alive, 2)


def check_equal(got, expected):
    clustering, candidates, scores, followed, loss, _ = expected
    np.testing.assert_array_equal(got.clusters, clustering.labels)
    assert got.extras["count"] == clustering.count
    np.testing.assert_array_equal(got.candidates, candidates)
    np.testing.assert_allclose(got.scores, scores)
    np.testing.assert_array_equal(got.extras["followed"], followed)
    assert got.extras["online_loss"] == [pytest.approx(loss, rel=1e-5)]


def test_two_rounds_of_the_defaults_are_algorithm_2():
    first, second = windows_of_two_rounds()
    detector = McGassl(gassl={"steps": STEPS})
    detector.reset(11)
    rng = np.random.default_rng(11)
    one = play_round(first, load_meta_weights(), rng)
    assert one[0].count > 1
    check_equal(detector.detect(first), one)
    two = play_round(second, one[-1], rng)
    check_equal(detector.detect(second), two)


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
