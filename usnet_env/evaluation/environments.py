"""Find, check and create environments by id; every refusal is one sentence."""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from importlib import import_module
from typing import Any

import gymnasium as gym
from gymnasium.envs.registration import EnvSpec, load_env_creator

from usnet_env.config import ArgumentError, quote, unknown_argument, unknown_name


def usnet_ids() -> list[str]:
    """The ids of this package in Gymnasium's registry."""
    return sorted(name for name in gym.registry if name.startswith("USNET/"))


def find_environment(env_id: str) -> EnvSpec:
    """Return the registered environment of this id, with or without its module (``"usnet_env:USNET/MultiCluster-v0"``).

    Raises:
        ArgumentError: there is no such module or no such id; the message names the nearest id.
    """
    module, _, name = env_id.rpartition(":")
    if module:
        try:
            import_module(module)
        except (ImportError, ValueError) as error:
            raise ArgumentError(f"env must name a module that can be imported, got {quote(env_id)}: {error}.") from None
    if name not in gym.registry:
        raise unknown_name("env", env_id, usnet_ids())
    return gym.registry[name]


def _load_creator(spec: EnvSpec) -> Any:
    """Return the class or function that creates the environment."""
    return load_env_creator(spec.entry_point) if isinstance(spec.entry_point, str) else spec.entry_point


def list_arguments(spec: EnvSpec) -> list[str] | None:
    """Return the names of the keyword arguments that the environment takes; ``None`` if it takes any name.

    ``render_mode`` is left out, because an evaluation draws no pictures.
    """
    parameters = inspect.signature(_load_creator(spec)).parameters.values()
    if any(parameter.kind is parameter.VAR_KEYWORD for parameter in parameters):
        return None
    return [parameter.name for parameter in parameters if parameter.name != "render_mode"]


def make_environment(env_id: str, env_kwargs: Mapping[str, Any]) -> gym.Env[Any, Any]:
    """Create the environment of this id.

    Raises:
        ArgumentError: as :func:`find_environment`; or the environment does not take an argument or refuses its value,
            or no detector can be scored there.
    """
    spec = find_environment(env_id)
    creator, known = _load_creator(spec), list_arguments(spec)
    for name in env_kwargs:
        if known is not None and name not in known:
            config = getattr(getattr(creator, "__init__", None), "config", None)
            raise unknown_argument(str(name), spec.id, known, getattr(config, "instead", {}))
    env: gym.Env[Any, Any] = gym.make(spec, disable_env_checker=True, **env_kwargs)
    check_environment(env)
    return env


def check_environment(env: Any) -> None:
    """Refuse what has no ``swarm`` and ``problem`` to score an answer, or recorded tracks whose leaders are unknown.

    Raises:
        ArgumentError: no detector can be scored in this environment.
    """
    if not isinstance(env, gym.Env) or not all(hasattr(type(env.unwrapped), name) for name in ("swarm", "problem")):
        raise ArgumentError(f"env must be a USNET environment ({', '.join(usnet_ids())}), got {quote(env)}.")
    if not getattr(env.unwrapped, "labelled", True):
        raise ArgumentError(
            "env must know the leaders to score detectors, got tracks without a column 'leader' that names their ids."
        )


def describe_environments() -> dict[str, str]:
    """Describe each id of this package in one line, and each PettingZoo game by its module's name.

    An id that only sets arguments of another one is described by this id and the arguments.
    """
    from usnet_env.multiagent.registration import GAMES  # not at the top: it registers the games with PettingZoo

    texts: dict[str, str] = {}
    base: dict[Any, str] = {
        gym.registry[name].entry_point: name for name in usnet_ids() if not gym.registry[name].kwargs
    }
    for name in usnet_ids():
        spec = gym.registry[name]
        presets = ", ".join(f"{key}={value}" for key, value in spec.kwargs.items())
        line = (inspect.getdoc(_load_creator(spec)) or "").partition("\n")[0]
        other = base.get(spec.entry_point)
        texts[name] = f"{other} with {presets}" if presets and other else f"{line} ({presets})" if presets else line
    return texts | {f"usnet_env.multiagent.{name}": text for name, text in GAMES.items()}
