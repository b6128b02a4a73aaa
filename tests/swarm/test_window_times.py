"""Which instants a window shows."""

import numpy as np

from usnet_env.swarm import SwarmConfig, advance, start


def test_a_window_ends_where_the_swarm_is_now():
    config = SwarmConfig(clusters=2, uavs=10, observation_steps=10)
    rngs = [np.random.default_rng(0)]
    state = start(config, rngs)
    for _ in range(2):
        state, window = advance(config, state, rngs)
        np.testing.assert_array_equal(window.position[:, -1], state.position)
        np.testing.assert_array_equal(window.velocity[:, -1], state.past_velocity[:, -1])
