"""The public callables with valid arguments, and values of many kinds that a caller may give instead of one of them."""

from __future__ import annotations

import inspect
import io
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from decimal import Decimal
from fractions import Fraction
from functools import cache
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from rich.console import Console

import detectors.clustering as clustering
import usnet_env
from detectors import DetectorPolicy
from detectors.policy_detector import PolicyDetector
from usnet_env import Detection, Window, objectives, swarm
from usnet_env.envs import (
    MultiClusterEnv,
    MultiClusterVectorEnv,
    MultiDiscreteCandidates,
    SingleClusterEnv,
    SingleClusterVectorEnv,
)
from usnet_env.envs.game import Rules
from usnet_env.envs.wrappers import BoxMasks
from usnet_env.multiagent import Fusion, policies, register_fusion, usnet_evasion_v0, usnet_observers_v0
from usnet_env.multiagent.evasion import Manoeuvres
from usnet_env.multiagent.play import play_game
from usnet_env.multiagent.sensors import SensorConfig
from usnet_env.multiagent.wrappers import DiscreteActions, MultiDiscreteVotes, ParallelBoxMasks
from usnet_env.plugins import detector_label
from usnet_env.replay import EpisodeRecord, draw_episode, record_episode, write_picture, write_recording
from usnet_env.replay.demo import run_demo
from usnet_env.tracks import Tracks, find_leaders, read_tracks
from usnet_env.tracks.env import TracksEnv

SMALL = {"clusters": 2, "uavs": 8, "observation_steps": 6}


class BadRepr:
    def __repr__(self) -> str:
        raise ZeroDivisionError


class HugeRepr:
    def __repr__(self) -> str:
        return "huge\n" * 200_000


class BadArray:
    def __array__(self, dtype: Any = None, copy: Any = None) -> Any:
        raise ZeroDivisionError


class BadPath:
    def __fspath__(self) -> str:
        raise ZeroDivisionError


class BytesPath:
    def __fspath__(self) -> bytes:
        return b"bytes"


class BadEquality:
    def __eq__(self, other: object) -> bool:
        raise ZeroDivisionError

    __hash__ = None  # type: ignore[assignment]


class BadLength(list):  # type: ignore[type-arg]
    def __len__(self) -> int:
        raise ZeroDivisionError


class BadMapping(dict):  # type: ignore[type-arg]
    def __getitem__(self, key: Any) -> Any:
        raise ZeroDivisionError


def _own_item() -> list[Any]:
    value: list[Any] = []
    value.append(value)
    return value


def _deep_list() -> list[Any]:
    value: list[Any] = []
    for _ in range(5000):
        value = [value]
    return value


# A function for each kind, because a try may change what it receives.
KINDS: dict[str, Callable[[], Any]] = {
    **{
        repr(value): lambda value=value: value
        for value in (
            None, True, False, ..., -1, 0, 1, 3, 10**12, 2**63, 2**64, -(2**63), 1.5, -0.5, float("nan"), float("inf"),
            float("-inf"), 1e39, 1e308, 5e-324, 1j, "", " ", "f1", "f8", "none", "iid", "P1", "rgb_array", "human",
            "two\nlines", "\ud800", "nul\0", "{", "a(b=1)", "math:sqrt", "/dev/null/x", ".", b"bytes", (), (1,),
            (1, 2), ("f1",), (0.5, float("nan")), range(3), slice(1), Decimal("NaN"), Decimal(3), Fraction(1, 3), int,
            frozenset({1}), np.int64(3), np.int8(-1), np.float32("nan"), np.float64(2.0), np.bool_(True),
            np.str_("f1"), np.datetime64("2020-01-01"), np.complex64(1), np.longdouble(1),
        )
    },
    "integer of 5,001 digits": lambda: 10**5000,
    "negative integer of 5,001 digits": lambda: -(10**5000),
    "text of 100,000 characters": lambda: "x" * 100_000,
    "empty list": list,
    "list of whole numbers": lambda: [1, 2],
    "list of a huge integer": lambda: [10**5000],
    "list of NaN": lambda: [float("nan")],
    "list of texts": lambda: ["f1", "f2"],
    "list of an object without a repr": lambda: [BadRepr()],
    "ragged list": lambda: [[1], [1, 2]],
    "list in itself": _own_item,
    "deep list": _deep_list,
    "list without a length": BadLength,
    "dict": lambda: {"a": 1},
    "empty dict": dict,
    "dict of numbers": lambda: {1: 2},
    "dict without items": lambda: BadMapping(a=1),
    "set": lambda: {1, 2},
    "generator": lambda: (i for i in range(2)),
    "object": object,
    "object whose repr raises": BadRepr,
    "object whose repr is huge": HugeRepr,
    "object whose conversion raises": BadArray,
    "path that raises": BadPath,
    "path of bytes": BytesPath,
    "object without equality": BadEquality,
    "path of a missing file": lambda: Path("/nowhere/at/all"),
    "function": lambda: lambda *values, **arguments: None,
    "module": lambda: np,
    **{
        f"array {name}": lambda value=value: np.array(value)
        for name, value in {
            "() int": 6, "() float": 1.5, "() NaN": float("nan"), "() str": "f1", "() None": None, "() bool": True,
            "(0,)": [], "(2,) int": [1, 2], "(2,) NaN": [float("nan"), 1.0], "(8,) zeros": np.zeros(8),
            "(8,) ones": np.ones(8, int), "(2, 3)": np.zeros((2, 3)), "str": ["a", "b"], "complex": [1j, 2],
        }.items()
    },
    "array () of an object": lambda: np.array(BadRepr(), object),
    "array of objects": lambda: np.array([BadRepr(), None], object),
    "array of huge numbers": lambda: np.full(8, 1e300),
    "structured array": lambda: np.zeros(2, [("a", int)]),
    "array of dates": lambda: np.zeros(2, "datetime64[D]"),
}  # fmt: skip


@dataclass(frozen=True)
class Door:
    """A public callable.

    Args:
        call: called with the arguments by name.
        valid: valid arguments; a function, because a call may change them.
        about: for an argument, other names that a refusal may have instead.
        slow: whether a valid call takes more than some milliseconds.
    """

    call: Callable[..., Any]
    valid: Callable[[], Mapping[str, Any]]
    about: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    slow: bool = False


def _defaults(call: Callable[..., Any], **changes: Any) -> dict[str, Any]:
    """The default of every named parameter, with changes."""
    parameters = inspect.signature(call).parameters.values()
    found = {each.name: each.default for each in parameters if each.default is not each.empty}
    return {**found, **changes}


SIZES = {
    "clusters": ("uavs", "cluster_sizes"),
    **dict.fromkeys(("decoys", "bystanders", "traffic", "clutter"), ("uavs", "cluster_sizes")),
    "uavs": ("cluster_sizes",),
    "sample_every": ("observation_steps",),
    "most_delay": ("memory",),
    "follow": ("memory",),
    "observers": ("sensing_range", "position_noise", "miss_rate"),
}


def _made(kind: type, **small: Any) -> Door:
    """Create an environment and start an episode."""

    def call(**arguments: Any) -> None:
        kind(**arguments).reset(seed=0)

    return Door(call, lambda: _defaults(kind, **small), SIZES)


def _method(make: Callable[[], Any], name: str, **valid: Any) -> Door:
    """Call a method of a new object."""

    def call(**arguments: Any) -> None:
        getattr(make(), name)(**arguments)

    return Door(call, lambda: valid)


def _reset(env: Any) -> Any:
    env.reset(seed=0)
    return env


def _single() -> Any:
    return _reset(SingleClusterEnv(followers=7, observation_steps=6))


def _multi() -> Any:
    return _reset(MultiClusterEnv(**SMALL))


def _batch() -> Any:
    return _reset(MultiClusterVectorEnv(num_envs=2, **SMALL))


def _observers() -> Any:
    return _reset(usnet_observers_v0.parallel_env(observers=2, **SMALL))


def _evasion() -> Any:
    return _reset(usnet_evasion_v0.parallel_env(**SMALL))


@cache
def _window() -> Window:
    return Window.from_observation(_multi()._window)


def _window_parts() -> dict[str, Any]:
    window = _window()
    return {name: getattr(window, name) for name in ("position", "velocity", "seen", "alive", "round", "step")}


def _detection_parts() -> dict[str, Any]:
    masks = {"candidates": np.arange(8) < 2, "scores": np.arange(8.0)}
    return {**masks, "clusters": [0] * 8, "leader": [0] * 8, "attention": np.eye(8), "extras": {}}


@cache
def _record() -> EpisodeRecord:
    return record_episode(MultiClusterEnv(**SMALL), usnet_env.make_detector("destroy-all"), 0, 0)


def _record_parts() -> dict[str, Any]:
    record = _record()
    return {name: getattr(record, name) for name in inspect.signature(EpisodeRecord).parameters}


def _config() -> swarm.SwarmConfig:
    return swarm.SwarmConfig(**SMALL)


def _rngs() -> list[np.random.Generator]:
    return [np.random.default_rng(0)]


def _objectives() -> dict[str, Door]:
    head, leader = np.arange(8) < 1, np.zeros(8, int)
    values = {
        "head": head, "alive": np.ones(8, bool), "candidates": head, "candidates_per_round": head[None],
        "scores": np.arange(8.0), "leader": leader, "clusters": leader, "estimate": leader, "root": leader,
        "roots": False,
    }  # fmt: skip
    functions = {name: getattr(objectives, name) for name in objectives.__all__}
    return {
        f"objectives.{name}": Door(
            function,
            lambda function=function: {each: values[each] for each in inspect.signature(function).parameters},
            {name: tuple(values) for name in values},  # two masks contradict each other
        )
        for name, function in functions.items()
    }


DETECTORS = {  # name -> whether detect is quick
    "random": True, "destroy-all": True, "none": True, "one-per-round": True, "lagged-correlation": True,
    "lagged-regression": True, "granger": True, "factions": True, "gassl": False, "mc-gassl": False,
    "front-most": True, "directional-delays": True, "lagged-network": True, "net-lag-regression": True, "flica": True,
    "mflica": True, "transfer-entropy": True,
    "neural-granger": False, "lead-votes": False, "follow-mixture": False, "learned": False,
}  # fmt: skip


def _detectors() -> dict[str, Door]:
    def door(name: str, quick: bool) -> Door:
        kind = type(usnet_env.make_detector(name))

        def call(seed: Any, **arguments: Any) -> None:
            detector = kind(**arguments)
            detector.reset(seed)
            if quick:
                detector.detect(_window())

        return Door(call, lambda: _defaults(kind, seed=0))

    return {f"detector {name}": door(name, quick) for name, quick in DETECTORS.items()}


def _tracks(folder: Path) -> dict[str, Door]:
    rng = np.random.default_rng(0)
    times, places = np.tile(np.arange(20.0), 3), rng.normal(size=(60, 2))
    ids = np.repeat(["a", "b", "c"], 20).tolist()
    tracks = Tracks.from_samples(ids, times, places)
    file = folder / "tracks.csv"
    lines = [f"{i},{t},{x},{y}" for i, t, (x, y) in zip(ids, times, places, strict=True)]
    file.write_text("\n".join(["id,t,x,y", *lines]))
    samples = {"ids": ids, "time": times, "position": places, "leader": None}
    return {
        "read_tracks": Door(read_tracks, lambda: _defaults(read_tracks, path=str(file))),
        "Tracks.from_samples": Door(Tracks.from_samples, lambda: dict(samples), {"position": ("time", "ids")}),
        "Tracks.resample": Door(tracks.resample, lambda: {"step": 1.0, "max_gap": None}),
        "Tracks.windows": Door(
            lambda **arguments: list(tracks.resample(1.0).windows(**arguments)),
            lambda: {"length": 10, "stride": None, "least_steps": None},
            {"length": ("least_steps",)},
        ),
        "find_leaders": Door(
            find_leaders,
            lambda: _defaults(find_leaders, tracks=tracks.resample(1.0), detector="none", length=10),
        ),
        "TracksEnv": Door(
            TracksEnv,
            lambda: _defaults(TracksEnv, path=str(file), window=10, step=1.0),
            {"step": ("length",), "window": ("length",)},
        ),
    }


def _clusterers() -> dict[str, Door]:
    def door(name: str, kind: Any) -> Door:
        def call(**arguments: Any) -> None:
            clustering.make_clusterer(name, **arguments).cluster(_window(), np.random.default_rng(0))

        return Door(call, lambda: _defaults(kind))

    return {f"clusterer {name}": door(name, kind) for name, kind in clustering.clusterers().items()}


def _evaluate(**arguments: Any) -> None:
    usnet_env.evaluate(**arguments)


def _quiet() -> Console:
    return Console(file=io.StringIO())


class _Answers:
    """A detector of another class."""

    def reset(self, seed: int | None = None) -> None:
        pass

    def detect(self, window: Window) -> Detection:
        return Detection(window.alive, window.alive.astype(float))


def make_doors(folder: Path) -> dict[str, Door]:
    """All doors by name; files are written into ``folder``."""
    saved = _record().save(folder / "saved.npz")
    follow: dict[str, Any] = {"name": "mine", "strategy": lambda inputs: inputs.head_velocity[:, 0]}
    model: dict[str, Any] = {"name": "mine", "model": lambda rng, place, steps, state: np.ones((steps, len(place), 3))}
    named = np.zeros(8, np.int8)
    head = {name: np.zeros(4, int) for name in ("head_0", "head_1")}
    vote = {f"observer_{k}": named for k in range(2)}
    heads = policies.TruthfulHead()
    return {
        "SingleClusterEnv": _made(SingleClusterEnv, followers=4, observation_steps=6),
        "MultiClusterEnv": _made(MultiClusterEnv, **SMALL),
        "SingleClusterVectorEnv": Door(
            _made(SingleClusterVectorEnv).call,
            lambda: {**_defaults(SingleClusterEnv, followers=4, observation_steps=6), "num_envs": 2},
            SIZES,
        ),
        "MultiClusterVectorEnv": Door(
            _made(MultiClusterVectorEnv).call, lambda: {**_defaults(MultiClusterEnv, **SMALL), "num_envs": 2}, SIZES
        ),
        "usnet_observers_v0": _made(usnet_observers_v0.parallel_env, **SMALL),
        "usnet_evasion_v0": _made(usnet_evasion_v0.parallel_env, **SMALL),
        "usnet_evasion_v0.env": _made(usnet_evasion_v0.env, **_defaults(usnet_evasion_v0.parallel_env, **SMALL)),
        "reset P1": _method(_single, "reset", seed=0, options=None),
        "reset P2": _method(_multi, "reset", seed=0, options={}),
        "reset batch": _method(_batch, "reset", seed=0, options=None),
        "reset observers": _method(_observers, "reset", seed=0, options=None),
        "reset evasion": _method(_evasion, "reset", seed=0, options=None),
        "step P1": _method(_single, "step", action=named),
        "step P2": _method(_multi, "step", action=named),
        "step batch": Door(lambda action: _batch().step(action), lambda: {"action": [named, named]}),
        "step observers": _method(_observers, "step", actions=vote),
        "step observers, one": Door(
            lambda action: _observers().step({**vote, "observer_1": action}), lambda: {"action": named}
        ),
        "step evasion": _method(_evasion, "step", actions={"observer_0": named, **head}),
        "step evasion, one": Door(
            lambda action: _evasion().step({"observer_0": named, **head, "head_1": action}),
            lambda: {"action": np.zeros(4, int)},
        ),
        "observation_space": _method(_observers, "observation_space", agent="observer_0"),
        "action_space": _method(_evasion, "action_space", agent="head_0"),
        "set_state": _method(_multi, "set_state", state=_multi().get_state()),
        "BoxMasks": Door(BoxMasks, lambda: {"env": _multi()}),
        "MultiDiscreteCandidates": Door(MultiDiscreteCandidates, lambda: {"env": _multi()}),
        "DiscreteActions": Door(DiscreteActions, lambda: {"env": _observers()}),
        "MultiDiscreteVotes": Door(MultiDiscreteVotes, lambda: {"env": _observers()}),
        "ParallelBoxMasks": Door(ParallelBoxMasks, lambda: {"env": _observers()}),
        "DiscreteActions.step": Door(
            lambda action: DiscreteActions(_observers()).step({"observer_0": 0, "observer_1": action}),
            lambda: {"action": 0},
        ),
        "SwarmConfig": Door(
            lambda **arguments: swarm.start(swarm.SwarmConfig(**arguments), _rngs()),
            lambda: _defaults(swarm.SwarmConfig, **SMALL),
            SIZES,
        ),
        "Rules": Door(Rules, lambda: _defaults(Rules)),
        "Manoeuvres": Door(Manoeuvres, lambda: _defaults(Manoeuvres)),
        "SensorConfig": Door(SensorConfig, lambda: _defaults(SensorConfig), SIZES),
        "swarm.start": Door(swarm.start, lambda: {"config": _config(), "rngs": _rngs()}),
        "swarm.advance": Door(
            swarm.advance, lambda: {"config": _config(), "state": swarm.start(_config(), _rngs()), "rngs": _rngs()}
        ),
        "swarm.destroy": Door(
            swarm.destroy, lambda: {"state": swarm.start(_config(), _rngs()), "candidates": named[None].astype(bool)}
        ),
        "register_follow_strategy": Door(
            usnet_env.register_follow_strategy, lambda: _defaults(usnet_env.register_follow_strategy, **follow)
        ),
        "register_mobility": Door(usnet_env.register_mobility, lambda: _defaults(usnet_env.register_mobility, **model)),
        "register_fusion": Door(
            register_fusion, lambda: {"name": "mine", "rule": Fusion("scores", min), "replace": False}
        ),
        "register_detector": Door(
            usnet_env.register_detector,
            lambda: _defaults(usnet_env.register_detector, name="mine", factory=_Answers),
        ),
        "register_clusterer": Door(
            clustering.register_clusterer, lambda: {"name": "mine", "factory": clustering.KMeans, "replace": False}
        ),
        "make_detector": Door(
            lambda detector: usnet_env.make_detector(detector), lambda: {"detector": "none"}, {"detector": ("name",)}
        ),
        "detector_label": Door(detector_label, lambda: {"detector": "none", "arguments": None}),
        "make_clusterer": Door(lambda clusterer: clustering.make_clusterer(clusterer), lambda: {"clusterer": "kmeans"}),
        "Window": Door(Window, _window_parts, {"position": ("velocity", "seen", "alive")}),
        "Window.from_observation": Door(Window.from_observation, lambda: {"observation": _multi()._window}),
        "Window.from_observation, one": Door(
            lambda **parts: Window.from_observation(parts), _window_parts, {"position": ("velocity", "seen", "alive")}
        ),
        "Detection": Door(Detection, _detection_parts, {"candidates": ("scores",)}),
        "EpisodeRecord": Door(
            EpisodeRecord, _record_parts, {"position": ("velocity",), "head": ("decoy",), "candidates": ("alive",)}
        ),
        "EpisodeRecord.load": Door(EpisodeRecord.load, lambda: {"path": saved, "max_bytes": None}),
        "EpisodeRecord.save": Door(_record().save, lambda: {"path": folder / "again.npz"}),
        **{
            f"EpisodeRecord.{name}": Door(getattr(_record(), name), lambda: {"number": 1})
            for name in ("last_position", "communication_links", "hierarchy")
        },
        "EpisodeRecord.topology_matrix": Door(
            _record().topology_matrix,
            lambda: {"number": 1, "t": 5, "head": int(np.flatnonzero(_record().head)[0]), "memory": 2},
            {"memory": ("t",)},
        ),
        "record_episode": Door(
            record_episode,
            lambda: _defaults(
                record_episode, env=MultiClusterEnv(**SMALL), detector=_Answers(), seed=0, detector_seed=0
            ),
        ),
        "draw_episode": Door(draw_episode, lambda: {"record": _record()}, slow=True),
        "write_picture": Door(
            write_picture, lambda: {"record": _record(), "path": folder / "picture.png"}, slow=True
        ),
        "write_recording": Door(
            write_recording, lambda: {"record": _record(), "path": folder / "replay.rrd"}, slow=True
        ),
        "run_demo": Door(
            run_demo,
            lambda: _defaults(
                run_demo, out=folder / "demo", clusters=2, uavs=8, detector="destroy-all", console=_quiet()
            ),
            SIZES,
            slow=True,
        ),
        "evaluate": Door(
            _evaluate,
            lambda: _defaults(
                usnet_env.evaluate, env="USNET/MultiCluster-v0", detector="none", episodes=1,
                env_kwargs={**SMALL, "max_rounds": 1},
            ),
            slow=True,
        ),
        "evaluate, an argument of the environment": Door(
            lambda **arguments: usnet_env.evaluate(
                "USNET/MultiCluster-v0", "destroy-all", episodes=1, env_kwargs=arguments
            ),
            lambda: {k: v for k, v in _defaults(MultiClusterEnv, **SMALL).items() if k != "render_mode"},
            SIZES,
            slow=True,
        ),
        "gym.make": Door(
            lambda **arguments: gym.make("USNET/MultiCluster-v0", **arguments),
            lambda: {k: v for k, v in _defaults(MultiClusterEnv, **SMALL).items() if k != "render_mode"},
            SIZES,
        ),
        "play_game": Door(
            play_game,
            lambda: {
                "env": usnet_evasion_v0.parallel_env(max_rounds=1, **SMALL),
                "policies": {"observer": policies.RandomObserver(), "head": heads},
                "seed": 0,
                "label": "",
            },
        ),
        "CamouflagedHead": Door(policies.CamouflagedHead, lambda: _defaults(policies.CamouflagedHead)),
        "RandomObserver": Door(policies.RandomObserver, lambda: {"count": 1}),
        "DetectorObserver": Door(policies.DetectorObserver, lambda: {"detector": _Answers()}),
        "Policy.reset": Door(
            policies.TruthfulHead().reset, lambda: {"seed": 0, "action_space": _evasion().action_space("head_0")}
        ),
        "DetectorPolicy": Door(DetectorPolicy, lambda: {"detector": _Answers(), "seed": 0}),
        "PolicyDetector": Door(
            lambda seed, **arguments: PolicyDetector(**arguments).reset(seed),
            lambda: {"policy": DetectorPolicy(_Answers()), "observe": None, "threshold": 0.0, "seed": 0},
        ),
        **_tracks(folder),
        **_objectives(),
        **_detectors(),
        **_clusterers(),
    }  # fmt: skip
