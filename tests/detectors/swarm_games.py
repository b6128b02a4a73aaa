"""Windows and games of several clusters for the tests of lead-votes and MC-GASSL, and clusterers that know them."""

import gymnasium as gym
import numpy as np
from hypothesis import strategies as st

import usnet_env
from detectors.clustering import Clustering

#: Any game; `play_any` makes its numbers fit each other.
ANY_GAME = {
    "uavs": st.integers(3, 40),
    "clusters": st.integers(1, 8),
    "follow": st.sampled_from(["f1", "f4", "f6", "f7", "none"]),
    "observation_steps": st.integers(6, 40),
    "miss_rate": st.sampled_from([0.0, 0.3]),
    "decoys": st.integers(0, 2),
    "max_rounds": st.integers(1, 4),
    "seed": st.integers(0, 2**31 - 1),
}


def game(seed=0, **arguments):
    """The environment and the first window of a swarm."""
    arguments = {"follow": "f1", "clusters": 2, "uavs": 14, "observation_steps": 40} | arguments
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


def play_any(detector, uavs, clusters, follow, decoys, **arguments):
    """Play one of :data:`ANY_GAME` to its end."""
    clusters = max(1, min(clusters, (uavs - decoys) // 3)) if follow != "none" else 1
    uavs = max(uavs, 3 * clusters + decoys)
    detections, info = played(detector, clusters=clusters, uavs=uavs, follow=follow, decoys=decoys, **arguments)
    assert 1 <= len(detections) <= arguments["max_rounds"]
    assert info["round"] == len(detections)


def part_of(window, alive):
    """The window if only some UAVs are alive."""
    return usnet_env.Window(window.position, window.velocity, window.seen & alive, alive, 3)


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
