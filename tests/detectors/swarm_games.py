"""Windows and games of several clusters for the tests of MC-GASSL, and clusterers that know them."""

import gymnasium as gym
import numpy as np

import usnet_env
from detectors.clustering import Clustering


def game(seed=0, **arguments):
    """The environment and the first window of a swarm."""
    arguments = {"follow": "f1", "clusters": 2, "uavs": 14, "observation_steps": 40} | arguments
    env = gym.make("USNET/MultiCluster-v0", **arguments).unwrapped
    observation, _ = env.reset(seed=seed)
    return env, usnet_env.Window.from_observation(observation)


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
    """A clusterer that knows the clusters, and divides each into ``parts`` by index."""

    def __init__(self, leader, parts=1):
        self.leader, self.parts = leader, parts

    def cluster(self, window, rng):
        labels = np.unique(self.leader, return_inverse=True)[1] * self.parts
        for cluster in np.unique(labels):
            members = np.flatnonzero(labels == cluster)
            labels[members] += np.arange(len(members)) * self.parts // len(members)
        return Clustering(labels, int(labels.max()) + 1)
