"""Windows of single clusters, their heads, and what the tests of GASSL and neural-granger do with the answers."""

from dataclasses import replace

import gymnasium as gym
import numpy as np

import usnet_env


def cluster(seed=0, follow="f1", followers=4, **arguments):
    """A window of the first round, and the head's index."""
    env = gym.make("USNET/SingleCluster-v0", follow=follow, followers=followers, **arguments)
    observation, _ = env.reset(seed=seed)
    window = usnet_env.Window.from_observation(observation)
    return window, int(np.flatnonzero(env.unwrapped.swarm.head)[0])


def clusters(count, first_seed=0, **arguments):
    pairs = [cluster(seed, **arguments) for seed in range(first_seed, first_seed + count)]
    return [window for window, _ in pairs], np.array([head for _, head in pairs])


def detect_each(detector, windows, seed=0):
    """The answers of a detector to all windows, as if they were of one episode."""
    detector.reset(seed)
    return [detector.detect(window) for window in windows]


def named(detections):
    """The candidate of each detection; -1 where none is named."""
    return np.array([int(np.flatnonzero(d.candidates)[0]) if d.candidates.any() else -1 for d in detections])


def rate(found, heads):
    return float((named(found) == heads).mean())


def without(window, gone, unseen=()):
    """The window after UAVs were destroyed, and others were missed: zeros and masks, as the environments have it."""
    alive, seen = window.alive.copy(), window.seen.copy()
    alive[list(gone)], seen[:, [*gone, *unseen]] = False, False
    velocity = window.velocity * (seen[1:] & seen[:-1])[..., None]
    return replace(window, position=window.position * seen[..., None], velocity=velocity, seen=seen, alive=alive)
