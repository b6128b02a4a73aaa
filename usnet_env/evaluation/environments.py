"""Create and describe environments by id; every refusal is one sentence."""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from importlib import import_module
from typing import Any

import gymnasium as gym
from gymnasium.envs.registration import load_env_creator

from usnet_env.config import ArgumentError, quote, unknown_name
from usnet_env.envs.play import refuse_probing


def usnet_ids() -> list[str]:
    """The ids of this package in Gymnasium's registry."""
    return sorted(name for name in gym.registry if name.startswith("USNET/"))


def make_environment(env_id: str, env_kwargs: Mapping[str, Any]) -> gym.Env[Any, Any]:
    """Create the environment of this id, with or without its module: ``"usnet_env:USNET/MultiCluster-v0"``.

    What has no ``swarm`` and ``problem`` to score an answer is refused, and recorded tracks whose leaders are unknown.
    """
    module, _, name = env_id.rpartition(":")
    try:
        import_module(module or __name__)
    except (ImportError, ValueError) as error:
        raise ArgumentError(f"env must name a module that can be imported, got {quote(env_id)}: {error}.") from None
    if name not in gym.registry:
        raise unknown_name("env", env_id, usnet_ids())
    if "render_mode" in env_kwargs:
        raise ArgumentError("render_mode must be left out: an evaluation draws no pictures.")
    env: gym.Env[Any, Any] = gym.make(name, disable_env_checker=True, **env_kwargs)
    if not all(hasattr(type(env.unwrapped), attribute) for attribute in ("swarm", "problem")):
        raise ArgumentError(f"env must be a USNET environment ({', '.join(usnet_ids())}), got {quote(env_id)}.")
    refuse_probing(env)
    if not getattr(env.unwrapped, "labelled", True):
        got = "tracks without a column 'leader' that names their ids"
        raise ArgumentError(f"env must know the leaders to score detectors, got {got}.")
    return env


def describe_environments() -> dict[str, str]:
    """Describe each id of this package in one line, and each PettingZoo game by its module's name.

    An id that only sets arguments of another one is described by this id and the arguments.
    """
    from usnet_env.multiagent import GAMES  # not at the top: it registers the games with PettingZoo

    specs = {name: gym.registry[name] for name in usnet_ids()}
    plain_id = {spec.entry_point: name for name, spec in specs.items() if not spec.kwargs}
    texts = {}
    for name, spec in specs.items():
        creator = load_env_creator(spec.entry_point) if isinstance(spec.entry_point, str) else spec.entry_point
        line = (inspect.getdoc(creator) or "").partition("\n")[0]
        presets = ", ".join(f"{key}={value}" for key, value in spec.kwargs.items())
        base = plain_id.get(spec.entry_point)
        if presets:
            line = f"{base} with {presets}" if base else f"{line} ({presets})"
        texts[name] = line
    return texts | {f"usnet_env.multiagent.{name}": text for name, text in GAMES.items()}
