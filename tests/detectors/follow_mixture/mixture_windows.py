"""Windows of a simulated swarm with their truth, and the answer of a detector to one."""

from __future__ import annotations

import numpy as np

from detectors.follow_mixture import FollowMixture
from usnet_env.swarm import FollowStrategy, register_follow_strategy

OWN_DELAYS = "tests_group_own_delays"
MAJORITY = "tests_group_majority"
ONWARDS = "tests_group_onwards"
DELAYED = "tests_group_delayed_{}"  # by one of the delays 1 and 3


class OwnDelays(FollowStrategy):
    """Every follower copies its head with a delay of its own, of one to three steps."""

    lags = 3

    def direction(self, inputs):
        return inputs.head_velocity[np.arange(len(inputs.follower)), inputs.follower % 3]


def majority(inputs):
    """On every axis the sign of the sum of the head's last three velocities."""
    return np.sign(inputs.head_velocity[:, :3].sum(axis=1))


def onwards(inputs):
    """The next direction of the head if it repeats its last turn."""
    now, before = inputs.head_velocity[:, 0], inputs.head_velocity[:, 1]
    return 2.0 * np.vecdot(now, before)[:, None] * now - before


for delay in (1, 3):
    register_follow_strategy(
        DELAYED.format(delay), lambda inputs, back=delay: inputs.head_velocity[:, back - 1], lags=delay
    )
register_follow_strategy(OWN_DELAYS, OwnDelays())
register_follow_strategy(MAJORITY, majority, lags=3)
register_follow_strategy(ONWARDS, onwards, lags=2)


def answer(window, seed=0, **arguments):
    """The detection of one window by a detector with these arguments."""
    detector = FollowMixture(**arguments)
    detector.reset(seed)
    return detector.detect(window)
