"""Suites: lists of environments that detectors are compared on, each kept in a YAML file with a version."""

from __future__ import annotations

from importlib.resources import files
from os import PathLike
from pathlib import Path
from typing import Any, Literal

import yaml
from pydantic import Field

from usnet_env.config import ArgumentError, Config, unknown_name
from usnet_env.files import as_path

_FOLDER = files("usnet_env.evaluation") / "suites"
_NAMES = sorted(entry.name.removesuffix(".yaml") for entry in _FOLDER.iterdir() if entry.name.endswith(".yaml"))


class Cell(Config):
    """One setting: an environment and its arguments."""

    env: str
    arguments: dict[str, Any] = Field(default_factory=dict)


class Suite(Config):
    """A list of settings, and the seeds of their episodes."""

    name: str = Field(description="name of the file, without its suffix")
    version: int = Field(ge=1, le=10_000, description="it grows with every change of the file")
    purpose: str = Field(description="what the suite is for, in one sentence")
    episodes: int = Field(ge=1, le=1_000_000, description="episodes of a cell in published tables")
    seed: int = Field(ge=1000, lt=2**63, description="seed of published tables")
    tuning_seed: int = Field(ge=0, lt=1000, description="seed for tuning a detector, whose swarms are other ones")
    unit: Literal["swarm", "cell"] = Field(
        "swarm", description="what was drawn at random, the unit of intervals; a drawn cell has swarms of its own"
    )
    weights: str | None = Field(
        None, pattern="^[0-9a-f]{64}$", description="SHA-256 of the reader's weights, which the seed was drawn after"
    )
    cells: dict[str, Cell] = Field(min_length=1, description="the settings by name")

    @property
    def label(self) -> str:
        """Name and version."""
        return f"{self.name} (version {self.version})"


def list_suites() -> dict[str, Suite]:
    """The suites of this package, by name."""
    return {name: load_suite(name) for name in _NAMES}


def load_suite(suite: str | PathLike[str]) -> Suite:
    """Read a suite. What a file with ``extends`` lacks is that of the named suite; arguments and cells are joined.

    Args:
        suite: the name of a suite of this package, or the path of a YAML file.

    Raises:
        ArgumentError: there is no such suite, or the file does not describe one; the message names its first fault.

    >>> list(load_suite("paper").cells)[:2]
    ['f1', 'f2']
    """
    path = as_path("suite", suite)
    try:
        content = _read_content(path)
        shared, env = content.pop("arguments", None) or {}, content.pop("env", "USNET/MultiCluster-v0")
        cells = {str(name): {"env": env} | shared | (values or {}) for name, values in content.pop("cells").items()}
        checked = {name: Cell(env=arguments.pop("env"), arguments=arguments) for name, arguments in cells.items()}
        return Suite(name=path.stem, cells=checked, **content)
    except ArgumentError:
        raise
    except (OSError, yaml.YAMLError, KeyError, TypeError, ValueError, AttributeError, RecursionError) as error:
        reason = " ".join(str(getattr(error, "strerror", None) or error).split())
        sentence = f"suite must be a YAML file with a mapping of cells, got {path.name!r}: {reason}."
        raise ArgumentError(sentence) from None


def _read_content(path: Path) -> dict[str, Any]:
    """Read a file of a suite, together with those that it extends; ``path`` may also be a name."""
    source: Any = path if path.suffix in (".yaml", ".yml") else _FOLDER / f"{path}.yaml"
    if source is not path and not source.is_file():
        raise unknown_name("suite", str(path), _NAMES)
    content: dict[str, Any] = dict(yaml.safe_load(source.read_bytes()))
    if "extends" not in content:
        return content
    base = _read_content(Path(content.pop("extends")))
    joined = {name: (base.get(name) or {}) | (content.get(name) or {}) for name in ("arguments", "cells")}
    return base | content | joined
