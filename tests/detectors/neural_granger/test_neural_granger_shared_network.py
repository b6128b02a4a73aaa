"""One network for a whole swarm, against a slow and literal one and on swarms whose heads are known."""

import gymnasium as gym
import numpy as np
import pytest
import torch
from single_cluster_windows import samples

import usnet_env
from detectors.neural_granger import per_candidate, shared_network
from detectors.neural_granger.per_candidate import (
    AdditiveNetwork,
    PerCandidate,
    Problem,
    find_untrained_times,
    split_times,
)
from detectors.neural_granger.shared_network import Following, follow_by_shared_network


def swarm(follow="f1", seed=0, **arguments):
    """Samples of a swarm with 2 clusters and 12 UAVs, and each UAV's true head (its own for a head)."""
    arguments = {"clusters": 2, "uavs": 12, "observation_steps": 100} | arguments
    env = gym.make("USNET/MultiCluster-v0", follow=follow, **arguments).unwrapped
    observation, _ = env.reset(seed=seed)
    return samples([usnet_env.Window.from_observation(observation)]), torch.from_numpy(env.swarm.root)


def generator(seed=0):
    return torch.Generator().manual_seed(seed)


@pytest.mark.parametrize(
    "follow", [pytest.param("f1", marks=pytest.mark.slow), "f4", pytest.param("f7", marks=pytest.mark.slow)]
)
def test_followers_choose_their_head_and_heads_gain_nothing(follow):
    batch, head = swarm(follow)
    all_uavs = torch.arange(12)
    found = follow_by_shared_network(batch, head, all_uavs, PerCandidate(), generator(), passes=1)
    follower = head != all_uavs
    assert (found.leader[follower] == head[follower]).all()
    assert (found.gain[follower] > 0.4).all()
    assert (found.gain[~follower] < 0.4).all()
    np.testing.assert_array_equal(found.count_followers(0.4), torch.bincount(head[follower], minlength=12))


def test_one_network_serves_clusters_that_fly_in_different_directions():
    batch, head = swarm("f4", mobility="gauss_markov", head_jitter=True, clusters=3, uavs=24)
    all_uavs = torch.arange(24)
    found = follow_by_shared_network(batch, head, all_uavs, PerCandidate(), generator(), passes=1)
    follower = head != all_uavs
    np.testing.assert_array_equal(found.leader[follower], head[follower])
    assert (found.gain[follower] > 0.25).float().mean() > 0.7


SHORT = PerCandidate(steps=80)  # enough for an easy swarm


@pytest.mark.parametrize("settings", [SHORT, pytest.param(PerCandidate(), marks=pytest.mark.slow)])
def test_a_second_pass_mends_a_wrong_head(settings):
    batch, head = swarm("f1")
    heads = head.unique()
    followers = (head != torch.arange(12)).nonzero()[:, 0]
    wrong = head.clone()
    moved = followers[head[followers] == heads[0]][:1]
    wrong[moved] = heads[1]
    found = follow_by_shared_network(batch, wrong, heads, settings, generator(), passes=2)
    np.testing.assert_array_equal(found.leader[followers], head[followers])


@pytest.mark.parametrize("settings", [SHORT, pytest.param(PerCandidate(), marks=pytest.mark.slow)])
def test_without_followers_there_is_no_gain(settings):
    batch, _ = swarm("none")
    head = torch.tensor([0] * 6 + [6] * 6)
    found = follow_by_shared_network(batch, head, torch.arange(12), settings, generator())
    assert found.count_followers(0.4).max() < 2


def test_the_best_source_is_the_one_with_the_least_error(monkeypatch):
    batch, _ = swarm("f3")
    problem = Problem(batch, PerCandidate())
    network = AdditiveNetwork(1, 12, 6, generator())
    all_uavs, times = torch.arange(12), torch.arange(batch.times)
    errors = problem.compute_errors(network.repeat(12), all_uavs, all_uavs, times)[0].detach().mean(2)
    errors.fill_diagonal_(torch.inf)
    sources = torch.tensor([7, 2, 5])
    for entries in (4_000_000, 1):
        monkeypatch.setattr(per_candidate, "_CHUNK_ENTRIES", entries)
        np.testing.assert_array_equal(shared_network._find_best_source(problem, network, all_uavs), errors.argmin(0))
        np.testing.assert_array_equal(
            shared_network._find_best_source(problem, network, sources), sources[errors[sources].argmin(0)]
        )
    leader = errors.argmin(0)
    used, _ = split_times(batch.times, 4, 4, torch.device("cpu"))
    rest = find_untrained_times(used, batch.times)
    assert not set(rest.tolist()) & set(used.tolist())
    gain = shared_network._compute_gain(problem, network, leader, rest)
    for i in range(12):
        error = problem.compute_errors(network, leader[i : i + 1], all_uavs[i : i + 1], rest)[0, 0, 0].detach().mean()
        null = problem.null_error[0, i, rest].mean()
        assert float(gain[i]) == pytest.approx(float(torch.log((null + 1e-3) / (error + 1e-3))), abs=1e-4)


def test_only_gains_above_the_threshold_count():
    following = Following(torch.tensor([1, 0, 1, 1]), torch.tensor([0.5, 0.05, 0.2, -1.0]))
    np.testing.assert_array_equal(following.count_followers(0.1), [0, 2, 0, 0])
    np.testing.assert_array_equal(following.count_followers(-2.0), [1, 3, 0, 0])


def test_the_only_source_has_no_leader_to_choose():
    batch, _ = swarm("f1")
    only = torch.tensor([3])
    found = follow_by_shared_network(batch, torch.full((12,), 3), only, PerCandidate(steps=2), generator())
    assert found.gain[3] == 0
    assert (found.leader == 3).all()


def test_the_seed_decides():
    batch, head = swarm("f2")
    settings = PerCandidate(steps=5)
    first, same, other = (
        follow_by_shared_network(batch, head, torch.arange(12), settings, generator(seed)) for seed in (1, 1, 2)
    )
    np.testing.assert_array_equal(first.gain, same.gain)
    assert not torch.equal(first.gain, other.gain)
