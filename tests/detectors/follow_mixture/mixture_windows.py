"""Windows of a simulated swarm, and the slow definitions that the fast ones are held against."""

from __future__ import annotations

import numpy as np

from detectors.follow_mixture.history import own_history
from detectors.follow_mixture.samples import samples_of
from usnet_env import Window
from usnet_env.swarm import FollowStrategy, SwarmConfig, advance, register_follow_strategy, start

OWN_DELAYS = "tests_own_delays"
MAJORITY = "tests_majority"
ONWARDS = "tests_onwards"


class OwnDelays(FollowStrategy):
    """Every follower copies its head with a delay of its own, of one to three steps."""

    lags = 3

    def direction(self, inputs):
        delay = np.arange(len(inputs.own_position)) % 3
        return inputs.head_velocity[np.arange(len(delay)), delay]


def majority(inputs):
    """On every axis the sign of the head's last three velocities together."""
    return np.sign(inputs.head_velocity[:, :3].sum(axis=1))


def onwards(inputs):
    """Where the head flies next if it turns again as it did."""
    now, before = inputs.head_velocity[:, 0], inputs.head_velocity[:, 1]
    return 2.0 * np.vecdot(now, before)[:, None] * now - before


register_follow_strategy(OWN_DELAYS, OwnDelays())
register_follow_strategy(MAJORITY, majority, lags=3)
register_follow_strategy(ONWARDS, onwards, lags=2)


def swarm_window(seed, **config):
    """One window and the truth about it."""
    settings = SwarmConfig(**{"clusters": 3, "uavs": 30, **config})
    generators = [np.random.default_rng(seed)]
    state, seen = advance(settings, start(settings, generators), generators)
    return Window(seen.position[0], seen.velocity[0], seen.seen[0], seen.alive[0]), state.episode(0)


def problem(seed=0, **config):
    """The samples of one window, their null, ``(n,)`` whom everybody follows (-1: nobody), and the truth."""
    window, truth = swarm_window(seed, **config)
    samples = samples_of(window, np.arange(window.uavs), 4)
    leader = np.where(truth.head | truth.decoy, -1, truth.leader)
    return samples, own_history(samples), leader, truth
