"""Whatever is given for an argument of an environment either works or is refused in one sentence that names it."""

import inspect

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from usnet_env import ArgumentError
from usnet_env.envs import MultiClusterEnv, SingleClusterEnv

CLASSES = (SingleClusterEnv, MultiClusterEnv)
ARGUMENTS = [(kind, name) for kind in CLASSES for name in inspect.signature(kind).parameters]

anything = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(-(10**20), 10**20),
    st.integers(-5, 30),
    st.floats(),
    st.sampled_from([np.nan, np.inf, -np.inf, -1, 0, 0.5, 10**12, np.int64(3), np.float32(0.1)]),
    st.text(max_size=5),
    st.sampled_from(["f1", "f8", "iid", "none", "uniform", "human", "rgb_array"]),
    st.lists(st.one_of(st.integers(-3, 40), st.floats(), st.text(max_size=3)), max_size=6),
    st.dictionaries(st.text(max_size=3), st.integers(), max_size=2),
    st.binary(max_size=4),
    st.just(object()),
)


@pytest.mark.parametrize(("kind", "name"), ARGUMENTS, ids=lambda value: getattr(value, "__name__", value))
@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(value=anything)
def test_every_argument_works_or_is_named(kind, name, value):
    try:
        env = kind(**{name: value})
    except ArgumentError as error:
        sentence = str(error)
        # A size that contradicts another may be told of by the other's name.
        about = {"clusters": ("clusters", "uavs", "cluster_sizes")}.get(name, (name,))
        about += ("uavs",) * (name in ("decoys", "bystanders", "traffic", "clutter"))
        named = sentence.split()[0] in about or (name == "sample_every" and "observation_steps" in sentence)
        assert named, sentence
        assert "got" in sentence
        assert "\n" not in sentence
        assert sentence.endswith(".")
    else:
        assert env.observation_space.shape is None  # a Dict space: the env was really made


@pytest.mark.parametrize("kind", CLASSES)
def test_an_unknown_argument_is_named(kind):
    with pytest.raises(ArgumentError, match=r"^follw is not an argument of \w+ \(did you mean 'follow'\?\); it takes"):
        kind(follw="f1")
