"""Generate the pages of the environments and games, each the docstring of its class, and the field's tables."""

from __future__ import annotations

import dataclasses
import importlib
import inspect
import re
from collections.abc import Iterable
from typing import Any

import usnet_env.envs
from usnet_env.envs import ENVIRONMENTS
from usnet_env.envs.registration import TRACKS
from usnet_env.multiagent import GAMES
from usnet_env.swarm.follow import CONTROLS, FIELD_MODELS
from usnet_env.swarm.kinematics import KINEMATICS
from usnet_env.tracks.env import TracksEnv

__all__ = ["environment_pages", "field_tables", "game_pages"]


def environment_pages() -> dict[str, str]:
    """Markdown of one page for each Gymnasium environment class, by file name (without suffix)."""
    kinds = dict.fromkeys(kind for kind, _ in ENVIRONMENTS.values())
    pages = {re.sub(r"(?<!^)(?=[A-Z])", "_", kind).lower(): _environment_page(kind) for kind in kinds}
    return pages | {"tracks": _tracks_page()}


def game_pages() -> dict[str, str]:
    """Markdown of one page for each PettingZoo game, by file name (without suffix)."""
    return {name: _game_page(name) for name in GAMES}


def _environment_page(kind: str) -> str:
    summary, sections = _docstring(getattr(usnet_env.envs, f"{kind}Env"))
    ids = {name: arguments for name, (of, arguments) in ENVIRONMENTS.items() if of == kind}
    rows = "\n".join(f"| `{name}` | {_format_arguments(arguments)} |" for name, arguments in ids.items())
    first = next(iter(ids))
    return f"""# {kind}

{summary}

| id | arguments that it sets |
| --- | --- |
{rows}

`gym.make("usnet_env:{first}")` creates the environment.
`gym.make_vec("usnet_env:{first}", num_envs=64)` creates the vector environment
{{class}}`usnet_env.envs.{kind}VectorEnv`: with `reset(seed=s)`, its episode b is the one that a single environment
plays with the seed s + b.

{sections}
"""


def _tracks_page() -> str:
    summary, sections = _docstring(TracksEnv)
    return f"""# Tracks

{summary}

`gym.make("usnet_env:{TRACKS}", path="flock.csv")` creates the environment. [Recorded tracks](../tracks.md) has an
introduction.

{sections}
"""


def _game_page(name: str) -> str:
    summary, sections = _docstring(importlib.import_module(f"usnet_env.multiagent.{name}").parallel_env)
    return f"""# {name}

{summary}

`from usnet_env.multiagent import {name}` imports the game. `{name}.parallel_env()` creates it in parallel form,
`{name}.env()` in turn-based form. [Several agents](../multiagent.md) has an introduction and examples.

{sections}
"""


def field_tables() -> list[str]:
    """The tables of docs/field.md: assumptions and equations of field models, controls, and kinematics models."""
    follow = [(name, model, model.citation, model.parameters) for name, model in FIELD_MODELS.items()]
    controls = [(name, model, model.citation, model.parameters) for name, model in CONTROLS.items()]
    moves = [
        (name, kinematics, kinematics.source, [field.name for field in dataclasses.fields(kinematics)])
        for name, kinematics in KINEMATICS.items()
        if dataclasses.is_dataclass(kinematics)
    ]
    return [_assumptions(follow), _equations(follow), _equations(controls), _assumptions(moves), _equations(moves)]


def _assumptions(parts: Iterable[tuple[str, Any, str, Iterable[str]]]) -> str:
    """A table of parts ``(name, part, source, names of parameters)`` of the simulator: what each breaks."""
    lines = [f"| `{name}` | {part.breaks} | {source} |" for name, part, source, _ in parts]
    return "\n".join(["| name | breaks the assumption | source |", "| --- | --- | --- |", *lines])


def _equations(parts: Iterable[tuple[str, Any, str, Iterable[str]]]) -> str:
    """A table of parts of the simulator: equations and parameters."""
    lines = [
        f"| `{name}` | `{part.equation}` | {', '.join(f'`{key}={getattr(part, key)!r}`' for key in keys) or 'none'} |"
        for name, part, _, keys in parts
    ]
    return "\n".join(["| name | equation | parameters |", "| --- | --- | --- |", *lines])


def _docstring(described: type) -> tuple[str, str]:
    """The first line of a docstring, and the rest."""
    summary, _, sections = (inspect.getdoc(described) or "").partition("\n")
    return summary, sections.strip()


def _format_arguments(arguments: dict[str, object]) -> str:
    return ", ".join(f"`{name}={value!r}`" for name, value in arguments.items()) or "none"
