"""1,500 values at the doors of the package: each is taken, or refused by a plain exception that names the argument."""

import inspect
import random
import re
from collections import Counter

import numpy as np
import pytest

import usnet_env
from usnet_env import ArgumentError, Window, make_detector
from usnet_env.envs import MultiClusterEnv, MultiClusterVectorEnv, SingleClusterEnv
from usnet_env.multiagent import usnet_evasion_v0, usnet_observers_v0
from usnet_env.tracks import read_tracks

VALUES = [
    None, True, False, -1, 0, 2**63, 10**400, 1.5, -0.5, float("nan"), float("inf"), 1j, "", " ", "nonsense", "f8",
    "two\nlines", "nul\0", "/dev/null/x", "x" * 1000, b"bytes", (), [1, 2], ["f1", 3], [[1], [1, 2]], [float("nan")],
    {}, {"a": 1}, {1: 2}, object(), int, np.float32("nan"), np.array(["a"]), np.zeros((2, 3)), np.full(8, 1e300),
]  # fmt: skip
SMALL = {"clusters": 2, "uavs": 8, "observation_steps": 6}
SIZES = ("clusters", "uavs", "cluster_sizes", "followers", "decoys", "bystanders", "traffic", "clutter")
#: Other arguments that a refusal may name, since two arguments contradict each other.
RELATED = {
    **dict.fromkeys(SIZES, SIZES),
    "sample_every": ("observation_steps",),
    "most_delay": ("memory",),
    "follow": ("memory",),
    "distribution": ("a",),
    "observers": ("sensing_range", "position_noise", "miss_rate"),
    "max_rounds": ("max_cycles",),
    "detector": ("label",),
    "encoding": ("path",),
    "env_kwargs": ("a",),
}
WINDOW = {
    "position": np.zeros((7, 8, 3)),
    "velocity": np.zeros((6, 8, 3)),
    "seen": np.ones((7, 8)),
    "alive": np.ones(8),
    "round": 1,
    "step": None,
}


def make(kind):
    return lambda **arguments: kind(**arguments).reset(seed=0)


def defaults(call, **changes):
    parameters = inspect.signature(call).parameters.values()
    found = {one.name: one.default for one in parameters if one.kind is one.KEYWORD_ONLY}
    return {name: value for name, value in found.items() if value is not inspect.Parameter.empty} | changes


def run_detector(name):
    def call(seed, **arguments):
        detector = make_detector(name, **arguments)
        detector.reset(seed)
        detector.detect(Window(**WINDOW))

    return call


@pytest.fixture(scope="module")
def doors(tmp_path_factory):
    """Name of a door -> a callable, and its valid arguments."""
    file = tmp_path_factory.mktemp("tracks") / "tracks.csv"
    file.write_text("id,t,x,y\n" + "".join(f"{i},{t},{t},{i}\n" for t in range(20) for i in "123"))
    played = {"env": "USNET/MultiCluster-v0", "detector": "none", "episodes": 1, "seed": 0, "workers": 1, "out": None}
    tracks = {**defaults(read_tracks), "path": str(file)}
    tracks.pop("progress", None)  # a function to call: Python says that another value is not callable
    detectors = ("random", "lagged-regression", "granger", "one-per-round", "lagged-correlation")
    return {
        "SingleClusterEnv": (make(SingleClusterEnv), defaults(SingleClusterEnv, followers=4, observation_steps=6)),
        "MultiClusterEnv": (make(MultiClusterEnv), defaults(MultiClusterEnv, **SMALL)),
        "MultiClusterVectorEnv": (make(MultiClusterVectorEnv), {"num_envs": 2, **SMALL}),
        "usnet_observers_v0": (
            make(usnet_observers_v0.parallel_env),
            defaults(usnet_observers_v0.parallel_env, **SMALL),
        ),
        "usnet_evasion_v0": (make(usnet_evasion_v0.parallel_env), defaults(usnet_evasion_v0.parallel_env, **SMALL)),
        "read_tracks": (read_tracks, tracks),
        "evaluate": (usnet_env.evaluate, {**played, "env_kwargs": {**SMALL, "max_rounds": 1}, "backend": None}),
        **{
            f"detector {name}": (run_detector(name), make_detector(name).get_params() | {"seed": 0})
            for name in detectors
        },
    }


def try_value(call, valid, argument, value):
    """``"taken"``, ``"refused"``, or what is wrong with the refusal."""
    try:
        call(**{**valid, argument: value})
    except (ArgumentError, TypeError, ValueError) as error:
        names = (argument, *RELATED.get(argument, ()))
        named = any(re.search(rf"(?<!\w){re.escape(name)}(?!\w)", str(error)) for name in names)
        named |= str(error).startswith(f"{usnet_env.config.printable(value)}: ")  # a file
        return "refused" if named and len(str(error)) < 2500 else f"{type(error).__name__}: {str(error)[:200]}"
    return "taken"


@pytest.mark.filterwarnings("ignore:redundancy_price is 0")
def test_1500_values_are_taken_or_refused_by_name_and_leave_no_file(doors, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    cases = [(door, argument) for door, (_, valid) in doors.items() for argument in valid]
    triples = [(*case, value) for case in cases for value in VALUES]
    counts, faults = Counter(), []
    for door, argument, value in random.Random(0).sample(triples, 1500):
        before = set(tmp_path.iterdir())
        found = try_value(*doors[door], argument, value)
        if found not in ("taken", "refused"):
            faults.append(f"{door}({argument}={usnet_env.config.quote(value)}): {found}")
        elif found == "refused":
            assert set(tmp_path.iterdir()) == before, (door, argument, value)
        counts[found] += 1
    assert not faults, "\n".join(faults)
    assert counts["refused"] > 700
