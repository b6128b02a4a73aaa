"""What a detector could change or leave behind in the process in which it runs."""

from __future__ import annotations

import builtins
import operator
import os
import sys
import types
from collections.abc import Sequence
from contextlib import suppress
from multiprocessing import resource_tracker
from pathlib import Path
from typing import Any

_WATCHED_PACKAGES = ("usnet_env", "gymnasium", "detectors")  # with all their modules
_WATCHED_MODULES = ("numpy", "numpy.random")
_METHODS = (types.FunctionType, types.BuiltinFunctionType, property, staticmethod, classmethod)
_PROC = Path("/proc/self")


def are_same(one: Sequence[Any], other: Sequence[Any]) -> bool:
    """Whether two sequences hold the very same objects."""
    return len(one) == len(other) and all(map(operator.is_, one, other))


def list_functions() -> dict[str, tuple[Any, ...]]:
    """List the code that scores detectors: all functions, classes and methods of the watched modules, by name."""
    found: dict[str, tuple[Any, ...]] = {}
    for name, module in list(sys.modules.items()):
        inside = name in _WATCHED_MODULES or any(name == top or name.startswith(f"{top}.") for top in _WATCHED_PACKAGES)
        if inside and isinstance(module, types.ModuleType):
            _list_members(found, name, vars(module))
    _list_members(found, "builtins", vars(builtins))
    return found


def _list_members(found: dict[str, tuple[Any, ...]], path: str, members: Any) -> None:
    for key, value in list(members.items()):
        name = f"{path}.{key}"
        if isinstance(value, type):
            found[name] = (value,)
            if value.__module__ == path:
                methods = {key: method for key, method in vars(value).items() if isinstance(method, _METHODS)}
                _list_members(found, name, methods)
        elif isinstance(value, types.FunctionType):
            found[name] = (value, value.__code__, value.__defaults__)
        elif isinstance(value, _METHODS) or callable(value):
            found[name] = (value,)


def list_processes() -> dict[int, str]:
    """List the child processes of this process, dead ones included that were not waited for; Linux only."""
    found: dict[int, str] = {}
    tracker = getattr(getattr(resource_tracker, "_resource_tracker", None), "_pid", None)
    for children in _PROC.glob("task/*/children"):
        with suppress(OSError):
            for pid in map(int, children.read_text().split()):
                if pid != tracker:  # multiprocessing starts one process for itself
                    command = "ended"
                    with suppress(OSError):
                        command = Path(f"/proc/{pid}/comm").read_text().strip()
                    found[pid] = f"process {pid} ({command})"
    return found


def list_files() -> dict[int, str]:
    """List the open files, pipes and sockets of this process by their numbers; Linux only."""
    found: dict[int, str] = {}
    with suppress(OSError):
        for number in os.listdir(_PROC / "fd"):
            with suppress(OSError):  # the one that lists them is closed by now
                found[int(number)] = f"open file {os.readlink(_PROC / 'fd' / number)}"
    return found
