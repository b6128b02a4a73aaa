"""Episode b of a batch is the single swarm with the same seed, bit for bit."""

import numpy as np
import pytest
from flights import generators

from usnet_env.swarm import MOBILITIES, SwarmConfig, advance, destroy, start
from usnet_env.swarm.follow import CONTROLS, FIELD_MODELS, LED_MODELS, FollowFunction
from usnet_env.swarm.mobility import MobilityFunction
from usnet_env.swarm.random_follow import random_follow_strategy


def wander(rng, position, steps, state):
    return rng.standard_normal((steps, len(position), 3))


SENSOR = {
    "position_noise": 1.0, "noise_memory": 0.5, "miss_rate": 0.1, "miss_burst": 3.0, "partial_tracks": 0.3,
    "swap_rate": 0.01,
}  # fmt: skip
CASES = [
    *({"follow": f"f{k}"} for k in range(1, 8)),
    *({"follow": "f6", "mobility": name, "head_jitter": True} for name in MOBILITIES),
    *({"follow": name, "kinematics": "limited"} for name in (*FIELD_MODELS, *CONTROLS)),
    *({"follow": "f6", "kinematics": name} for name in ("varied_speed", "lagged", "layered")),
    *({"follow": name, "led_by": (1, 3), "kinematics": "limited"} for name in ("f2", "part_time", *LED_MODELS)),
    {"follow": FollowFunction(lambda inputs: inputs.head_velocity[:, 1]), "led_by": 2, "mobility": "waypoint"},
    {"follow": "none", "mobility": "smooth_turn"},
    {"follow": "f5", "sample_every": 2, "clutter": 4, **SENSOR},
    {"follow": FollowFunction(lambda inputs: -inputs.head_velocity[:, 1])},
    {"follow": random_follow_strategy(np.random.default_rng(0))},
    {"mobility": MobilityFunction(wander), "head_jitter": True},
    {"mobility": MobilityFunction(wander), "kinematics": "lagged"},
]


@pytest.mark.parametrize("case", CASES, ids=lambda case: "-".join(str(value)[:14] for value in case.values()))
def test_episode_b_of_a_batch_is_the_single_swarm(case):
    """Over rounds with destruction; there are more episodes than one chunk of noise holds."""
    arguments = {"memory": 12, "formation": "around", "decoys": 2, "bystanders": 2, "traffic": 2, **case}
    config = SwarmConfig(clusters=3, uavs=60, observation_steps=24, **arguments)
    rngs, alone = generators(range(45)), generators([40])
    batch, single = start(config, rngs), start(config, alone)
    shooter = np.random.default_rng(1)
    for _ in range(3):
        batch, windows = advance(config, batch, rngs)
        single, window = advance(config, single, alone)
        for name in ("position", "velocity", "seen", "alive"):
            np.testing.assert_array_equal(getattr(windows, name)[40], getattr(window, name)[0], err_msg=name)
        assert np.isfinite(windows.velocity).all()
        assert not windows.velocity.swapaxes(1, 2)[~windows.alive].any()
        candidates = shooter.random(batch.alive.shape) < 0.2
        for b in range(45):  # leave every swarm a head
            candidates[b, np.flatnonzero(batch.head[b] & batch.alive[b])[:1]] = False
        batch, single = destroy(batch, candidates), destroy(single, candidates[40:41])
    for name, array in single.arrays().items():
        np.testing.assert_array_equal(batch.arrays()[name][40], array[0], err_msg=name)
