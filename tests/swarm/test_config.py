"""Bad input to the swarm: one sentence with the argument's name."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from usnet_env import ArgumentError
from usnet_env.swarm import SwarmConfig, follow_strategies, mobilities

WHOLE = ["clusters", "uavs", "observation_steps", "memory", "sample_every"]
REAL = ["position_noise", "miss_rate"]
NAMES = ["follow", "mobility", "formation"]


def is_taken(name):
    """Hypothesis draws texts from the package's own sources too, so that any registered name may come."""
    return name in ("around", "none", "uniform") or name in follow_strategies() or name in mobilities()


not_whole = st.one_of(
    st.floats(), st.text(), st.none(), st.booleans(), st.lists(st.integers()), st.integers(max_value=0), st.binary()
)
not_real = st.one_of(
    st.sampled_from([np.nan, np.inf, -np.inf, -1.0, -1, 1e9]), st.text(), st.none(), st.lists(st.floats()), st.binary()
)
not_names = st.one_of(
    st.text().filter(lambda text: not is_taken(text)),
    st.integers(),
    st.none(),
    st.floats(),
    st.lists(st.text()),
)


def refuses(name, value):
    with pytest.raises(ArgumentError) as caught:
        SwarmConfig(**{name: value})
    sentence = str(caught.value)
    assert sentence.startswith(f"{name} must")
    assert "got" in sentence
    assert "\n" not in sentence
    assert sentence.endswith(".")


@given(name=st.sampled_from(WHOLE), value=not_whole)
def test_bad_whole_numbers(name, value):
    refuses(name, value)


@given(name=st.sampled_from(REAL), value=not_real)
def test_bad_real_numbers(name, value):
    refuses(name, value)


@given(name=st.sampled_from(NAMES), value=not_names)
def test_bad_names(name, value):
    refuses(name, value)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("decoys", -1),
        ("decoys", 1.5),
        ("decoys", 10**9),
        ("head_jitter", 1),
        ("head_jitter", "yes"),
        ("follow_seed", -1),
        ("follow_seed", 2**63),
        ("follow_seed", 0.5),
        ("cluster_sizes", 5),
        ("cluster_sizes", "55555"),
        ("cluster_sizes", [2, 2]),
        ("cluster_sizes", [1, 19, 19, 19, 19]),
        ("cluster_sizes", [2, 2, 2, 2, 2]),
        ("cluster_sizes", [15.0, 15.0, 15.0, 16.0, 16.0]),
        ("clusters", 10**12),
        ("uavs", 14),
        ("uavs", 10**12),
        ("observation_steps", 10**9),
        ("observation_steps", 100_000_000 // 82),
        ("memory", 10**9),
        ("sample_every", 10**9),
        ("miss_rate", 1.0),
    ],
)
def test_other_bad_values(name, value):
    refuses(name, value)


def test_what_contradicts_is_named():
    with pytest.raises(ArgumentError, match=r"memory must be at least 4 for follow='f7', got 3\."):
        SwarmConfig(follow="f7", memory=3)
    with pytest.raises(ArgumentError, match=r"uavs must be at least 3 \* clusters \+ decoys = 17 .*got 16\."):
        SwarmConfig(clusters=5, uavs=16, decoys=2)
    with pytest.raises(ArgumentError, match="follw is not an argument"):
        SwarmConfig(follw="f1")


def test_numpy_numbers_and_lists_are_taken():
    config = SwarmConfig(clusters=np.int64(2), uavs=np.int32(9), position_noise=np.float32(1), cluster_sizes=[3, 4])
    assert config.clusters == 2
    assert config.cluster_sizes == (3, 4)
    assert config == SwarmConfig(clusters=2, uavs=9, position_noise=1.0, cluster_sizes=np.array([3, 4]))


def test_a_config_is_frozen():
    with pytest.raises(ValueError, match="frozen"):
        SwarmConfig().clusters = 3
