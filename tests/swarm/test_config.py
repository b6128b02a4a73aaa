"""Bad input to the swarm is refused with the argument's name."""

import numpy as np
import pytest

from usnet_env import ArgumentError
from usnet_env.swarm import SwarmConfig


@pytest.mark.parametrize(
    ("name", "value"),
    [
        *((name, 0) for name in ("clusters", "uavs", "observation_steps", "memory")),
        *((name, value) for name in ("position_noise", "miss_rate") for value in (np.nan, -1.0, 1e9)),
        *((name, value) for name in ("follow", "mobility", "formation", "kinematics") for value in ("", "f8", 3, None)),
        ("sample_every", 10**9),
        ("decoys", -1),
        ("head_jitter", "yes"),
        ("follow_seed", 2**63),
        ("cluster_sizes", "55555"),
        ("cluster_sizes", [2, 2]),
        ("cluster_sizes", [1, 19, 19, 19, 19]),
        ("cluster_sizes", [2, 2, 2, 2, 2]),
        ("uavs", 14),
        ("miss_rate", 1.0),
        ("miss_burst", 0.5),
        *(("led_by", value) for value in (-1, 9, 1.5, (0, 2), (3, 2), (1, 2, 3), "two")),
    ],
)
def test_a_bad_value_is_named(name, value):
    with pytest.raises(ArgumentError, match=rf"^{name} must [^\n]*got [^\n]*\.$"):
        SwarmConfig(**{name: value})


def test_what_contradicts_is_named():
    with pytest.raises(ArgumentError, match=r"memory must be at least 4 for follow='f7', got 3"):
        SwarmConfig(follow="f7", memory=3)
    with pytest.raises(ArgumentError, match=r"uavs must be at least .* = 17 .*got 16"):
        SwarmConfig(clusters=5, uavs=16, decoys=2)
    with pytest.raises(ArgumentError, match="miss_burst must"):
        SwarmConfig(miss_rate=0.9, miss_burst=2.0)
    with pytest.raises(ArgumentError, match="follw"):
        SwarmConfig(follw="f1")
