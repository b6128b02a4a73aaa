"""Checks that no truth leaks into a detector: from an environment, a swarm, a shared generator or a guessed seed."""

from __future__ import annotations

import functools
import gc
import random
import sys
import types
import weakref
from collections import deque
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from detectors.checks.harness import copy_detector, play_windows, require, require_same
from detectors.checks.windows import draw_two_rounds, set_heads, start_environment
from usnet_env.detection import Detection
from usnet_env.evaluation.episode import episode_seeds
from usnet_env.window import Window

_WORLD = ("usnet_env.swarm", "usnet_env.envs", "usnet_env.multiagent", "usnet_env.evaluation")
_ENVIRONMENTS = {"Env", "VectorEnv", "VecEnv", "AECEnv", "ParallelEnv", "EnvBase"}
_FRAMEWORKS = {"gymnasium", "gym", "pettingzoo", "stable_baselines3", "torchrl", "supersuit", "shimmy"}
_VARIABLE = "_environment_of_the_checks"
_LEAVES = (str, bytes, int, float, complex, bool, types.NoneType, type, types.ModuleType, types.CodeType)
_GENERATORS = (np.random.Generator, np.random.BitGenerator, sys.modules["numpy.random"].RandomState, random.Random)
_HEAP_TYPE = 1 << 9  # Py_TPFLAGS_HEAPTYPE: a class written in Python

SEEDS = (0, 2022)  # of an evaluation: the default of ``usnet evaluate``, and that of published tables
LARGE_SEED = 0x8C2F_51D7_E6A0_934B_27F9_1B6E_D05C_48A3  # far beyond what a program can search
# If both kinds of seeds are alike to a detector, it succeeds in all swarms of one kind and in none of the other with a
# probability of at most 1 / C(12, 6), or 0.1 %.
EPISODES = 6
# Few and short windows of a strategy that is hard to see: only a rebuilt swarm shows its heads without a mistake.
SWARM = {"clusters": 4, "uavs": 20, "observation_steps": 10, "follow": "f5"}


def check_no_reach_for_truth(detector: Any) -> None:
    """The window, the detector and its detection hold no reference to an environment, a swarm or a shared generator.

    The search follows attributes, containers, closures and class attributes. A generator is shared if two copies of the
    detector hold it, or if it is a global one.
    """
    windows = draw_two_rounds(detector)
    window = windows[0]
    own, other = copy_detector(detector), copy_detector(detector)
    given = play_windows(own, windows)
    play_windows(other, windows)
    for root, name in ((window, "window"), (own, "detector"), (given, "detection")):
        found = find_truth(root, name)
        require(not found, f"no reference may lead to an environment or a swarm, got {found}.")
    held = [path for path, _ in _find_generators(window, "window")]
    require(not held, f"the window must hold no generator, got one at {''.join(held[:1])}.")
    mine = list(_find_generators(own, "detector"))
    others = {id(thing) for _, thing in _find_generators(other, "detector")}
    # The generators behind the functions of random, numpy.random and torch.
    others |= {id(sys.modules[name].random.__self__) for name in ("random", "numpy.random")}
    if torch := sys.modules.get("torch"):
        others.add(id(torch.default_generator))
    shared = [path for path, thing in mine if id(thing) in others]
    require(
        not shared, f"each copy of a detector must have its own generator, got a shared one at {''.join(shared[:1])}."
    )


def check_truth_nearby_changes_nothing(detector: Any) -> None:
    """The detection doesn't depend on an environment in the caller's frame, in a module or elsewhere in memory.

    The detector answers one window twice. The environment that the window comes from is within reach both times, in all
    these places, but its swarm has other heads the second time.
    """
    environment, window = start_environment(detector)
    ends = np.array([0, 1]), np.array([window.uavs - 2, window.uavs - 1])
    first, second = [_detect_beside_environment(detector, environment, window, heads) for heads in ends]
    del environment  # the traceback of a failure holds this frame, and no later check may find the environment there
    sentence = "the detection must not depend on an environment or swarm elsewhere in memory, got different"
    require_same(first, second, sentence)


def _detect_beside_environment(detector: Any, env: Any, window: Window, heads: NDArray[np.intp]) -> Detection:
    """Call ``detect`` while the environment has these heads, and it and its swarm are within reach.

    It is a local variable here, and a global one of the main module and of this one.
    """
    set_heads(env, heads)
    swarm = env.unwrapped.swarm
    modules = [vars(sys.modules[name]) for name in ("__main__", __name__)]
    try:
        for variables in modules:
            variables[_VARIABLE] = env
        (answer,) = play_windows(copy_detector(detector), [window])
    finally:
        for variables in modules:
            variables.pop(_VARIABLE, None)
    del swarm
    return answer


def find_truth(root: Any, name: str) -> str:
    """Path from ``root`` to the nearest environment or part of a simulated swarm; empty if there is none."""
    for path, thing in walk_references(root, name):
        for kind in type(thing).__mro__:
            of_framework = kind.__name__ in _ENVIRONMENTS and kind.__module__.partition(".")[0] in _FRAMEWORKS
            if of_framework or kind.__module__.startswith(_WORLD):
                return f"{path}, a {type(thing).__module__}.{type(thing).__qualname__}"
    return ""


def _find_generators(root: Any, name: str) -> Iterator[tuple[str, Any]]:
    torch = sys.modules.get("torch")
    kinds = (*_GENERATORS, torch.Generator) if torch is not None else _GENERATORS
    return ((path, thing) for path, thing in walk_references(root, name) if isinstance(thing, kinds))


def walk_references(root: Any, name: str) -> Iterator[tuple[str, Any]]:
    """Yield each object that ``root`` refers to, directly or not, with its path; breadth first, each object once.

    Modules, the methods of classes and the globals of functions are not followed: they lead to every object.
    """
    seen = {id(root)}
    alive = [root]  # keeps the objects alive, so that no id is reused
    waiting = deque([(name, root)])
    while waiting:
        path, thing = waiting.popleft()
        yield path, thing
        for step, child in _list_children(thing):
            if id(child) not in seen and not isinstance(child, _LEAVES):
                seen.add(id(child))
                alive.append(child)
                waiting.append((path + step, child))


def _list_children(thing: Any) -> Iterator[tuple[str, Any]]:
    if isinstance(thing, Mapping):
        try:
            yield from ((f"[{key!r}]"[:40], value) for key, value in list(thing.items()))
        except Exception:  # a plugin's mapping may raise any exception
            return
    elif isinstance(thing, list | tuple | set | frozenset | deque):
        yield from ((f"[{number}]", value) for number, value in enumerate(list(thing)))
    elif isinstance(thing, np.ndarray):
        yield ".base", thing.base
        if thing.dtype == object:
            yield from ((f".flat[{number}]", value) for number, value in enumerate(thing.flat))
    elif isinstance(thing, np.random.Generator):
        yield ".bit_generator", thing.bit_generator
    elif isinstance(thing, types.FunctionType):
        cells = [cell for cell in thing.__closure__ or () if cell != types.CellType()]
        yield from ((f".<closure {number}>", cell.cell_contents) for number, cell in enumerate(cells))
        yield ".__defaults__", thing.__defaults__
        yield ".__kwdefaults__", thing.__kwdefaults__
    elif isinstance(thing, types.MethodType):
        yield from ((".__self__", thing.__self__), (".__func__", thing.__func__))
    elif isinstance(thing, functools.partial):
        yield from ((".func", thing.func), (".args", thing.args), (".keywords", thing.keywords))
    elif isinstance(thing, weakref.ref):
        yield "()", thing()
    elif isinstance(thing, types.GeneratorType) and thing.gi_frame is not None:
        yield ".<locals>", dict(thing.gi_frame.f_locals)
    elif not hasattr(thing, "__dict__"):
        # Iterators, other objects made in C, and objects with slots only: ask the garbage collector.
        yield from ((".<held>", child) for child in gc.get_referents(thing))
        return
    yield from ((f".{key}", value) for key, value in list(getattr(thing, "__dict__", {}).items()))
    for kind in type(thing).__mro__:
        if kind.__flags__ & _HEAP_TYPE and not isinstance(thing, types.FunctionType | types.MethodType):
            yield from ((f".{key}", value) for key, value in vars(kind).items() if _is_data(key, value))
            slots = getattr(kind, "__slots__", ())
            for slot in (slots,) if isinstance(slots, str) else slots:
                if slot not in ("__dict__", "__weakref__"):
                    yield f".{slot}", getattr(thing, slot, None)


def _is_data(key: str, value: Any) -> bool:
    """Whether a class attribute is data, not a method, a property or a special name."""
    if isinstance(value, staticmethod | classmethod | types.FunctionType):
        return False
    return not key.startswith("__") and not hasattr(type(value), "__get__")


def check_seeds_reveal_no_heads(detector: Any) -> None:
    """The detector is no better at swarms whose seeds can be guessed than at swarms whose seeds cannot.

    The seeds of a swarm and of its detector follow from the seed of the evaluation and the number of the episode, as in
    :func:`usnet_env.evaluate`. A detector that searches them can simulate the swarm again, with its true heads.
    """
    for seed in SEEDS:
        if all(_names_heads_only(detector, seed, episode) for episode in range(EPISODES)):
            require(
                any(_names_heads_only(detector, LARGE_SEED, episode) for episode in range(EPISODES)),
                "the detector must not search the seed of the swarm, got no mistake in the first "
                f"{EPISODES} swarms of an evaluation with seed {seed}, and a mistake in each of {EPISODES} swarms "
                "whose seeds are too large to be searched.",
            )


def _names_heads_only(detector: Any, seed: int, episode: int) -> bool:
    """Whether the detector names at least one UAV of a swarm and all UAVs that it names are heads."""
    swarm_seed, detector_seed = episode_seeds(seed, episode)
    _, window = start_environment(seed=swarm_seed, **SWARM)
    try:
        (answer,) = play_windows(copy_detector(detector), [window], detector_seed)
    except Exception:  # a detector may refuse so short a window
        return False
    env, _ = start_environment(seed=swarm_seed, **SWARM)  # again, because no truth is within reach while it answers
    head = env.unwrapped.swarm.head  # type: ignore[attr-defined]  # all environments of USNET have it
    return bool(answer.candidates.any()) and not bool(np.any(answer.candidates & ~head))
