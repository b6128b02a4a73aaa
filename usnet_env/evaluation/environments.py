"""Environments by id: found, checked and made with one sentence for whatever is refused."""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from difflib import get_close_matches
from importlib import import_module
from typing import Any

import gymnasium as gym
from gymnasium.envs.registration import EnvSpec, load_env_creator

from usnet_env.config import ArgumentError, quote

__all__ = [
    "environment_about",
    "environment_arguments",
    "environment_spec",
    "is_usnet",
    "make_environment",
    "usnet_ids",
]

_HINTS = 3


def usnet_ids() -> list[str]:
    """The ids of this package in Gymnasium's registry."""
    return sorted(name for name in gym.registry if name.startswith("USNET/"))


def environment_spec(env_id: str) -> EnvSpec:
    """The registered environment of that id, with or without its module (``"usnet_env:USNET/MultiCluster-v0"``).

    Raises:
        ArgumentError: no such module, or no such id; the sentence names the nearest ids.
    """
    module, _, name = env_id.rpartition(":")
    if module:
        try:
            import_module(module)
        except (ImportError, ValueError) as error:
            raise ArgumentError(f"env must name a module that can be imported, got {quote(env_id)}: {error}.") from None
    if name in gym.registry:
        return gym.registry[name]
    ids = usnet_ids()
    near = get_close_matches(name, ids, n=_HINTS, cutoff=0.5) or ids
    raise ArgumentError(f"env must be a registered id, got {quote(env_id)} (near: {', '.join(near)}).")


def _creator(spec: EnvSpec) -> Any:
    """The class or function that makes the environment."""
    return load_env_creator(spec.entry_point) if isinstance(spec.entry_point, str) else spec.entry_point


def environment_arguments(spec: EnvSpec) -> list[str] | None:
    """Names of the keyword arguments that the environment takes; ``None`` if it takes any.

    ``render_mode`` is not among them: nobody looks at an evaluation.
    """
    parameters = inspect.signature(_creator(spec)).parameters.values()
    if any(parameter.kind is parameter.VAR_KEYWORD for parameter in parameters):
        return None
    return [parameter.name for parameter in parameters if parameter.name != "render_mode"]


def is_usnet(env: gym.Env[Any, Any]) -> bool:
    """Whether the environment holds a swarm and a problem for the referee to look at."""
    return _has_truth(type(env.unwrapped))


def _has_truth(kind: type) -> bool:
    return all(hasattr(kind, name) for name in ("swarm", "problem"))


def _stranger(spec: EnvSpec) -> ArgumentError:
    return ArgumentError(f"env must be a USNET environment ({', '.join(usnet_ids())}), got {quote(spec.id)}.")


def make_environment(spec: EnvSpec, env_kwargs: Mapping[str, Any]) -> gym.Env[Any, Any]:
    """Make the environment.

    Raises:
        ArgumentError: an argument that it does not take or refuses, or an environment of another kind.
    """
    creator = _creator(spec)
    if isinstance(creator, type) and not _has_truth(creator):
        raise _stranger(spec)
    known = environment_arguments(spec)
    for name in env_kwargs:
        if known is not None and name not in known:
            near = get_close_matches(str(name), known, n=1)
            hint = f" (did you mean {near[0]!r}?)" if near else ""
            raise ArgumentError(f"{name} is not an argument of {spec.id}{hint}; it takes {', '.join(known)}.")
    env: gym.Env[Any, Any] = gym.make(spec, disable_env_checker=True, **env_kwargs)
    if not is_usnet(env):
        env.close()
        raise _stranger(spec)
    return env


def environment_about(env_id: str) -> str:
    """One line about a registered id: the first of its class's docstring, and the arguments that it sets."""
    spec = gym.registry[env_id]
    line = (inspect.getdoc(_creator(spec)) or "").partition("\n")[0]
    presets = ", ".join(f"{name}={value}" for name, value in spec.kwargs.items())
    return f"{line} ({presets})" if presets else line
