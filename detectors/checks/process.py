"""What a detector could change or leave behind in the process in which it runs."""

from __future__ import annotations

import builtins
import os
import sys
import threading
import types
from contextlib import suppress
from multiprocessing import resource_tracker
from pathlib import Path
from typing import Any

_WATCHED_PACKAGES = ("usnet_env", "gymnasium", "detectors")  # with all their modules
_WATCHED_MODULES = ("numpy", "numpy.random")
_METHODS = (types.FunctionType, types.BuiltinFunctionType, property, staticmethod, classmethod)
_PROC = Path("/proc/self")


class Same:
    """Some objects; equal only to the very same objects."""

    def __init__(self, *parts: Any) -> None:
        self.parts = parts

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Same) or len(other.parts) != len(self.parts):
            return False
        return all(one is another for one, another in zip(self.parts, other.parts, strict=True))

    __hash__ = None  # type: ignore[assignment]  # it is compared, and never a key


def list_functions() -> dict[str, Same]:
    """List the code that scores detectors: all functions, classes and methods of the watched modules, by name."""
    found: dict[str, Same] = {}
    for name, module in list(sys.modules.items()):
        inside = name in _WATCHED_MODULES or any(name == top or name.startswith(f"{top}.") for top in _WATCHED_PACKAGES)
        if inside and isinstance(module, types.ModuleType):
            _list_members(found, name, vars(module))
    _list_members(found, "builtins", vars(builtins))
    return found


def _list_members(found: dict[str, Same], path: str, members: Any) -> None:
    for key, value in list(members.items()):
        name = f"{path}.{key}"
        if isinstance(value, type):
            found[name] = Same(value)
            if value.__module__ == path:
                methods = {key: method for key, method in vars(value).items() if isinstance(method, _METHODS)}
                _list_members(found, name, methods)
        elif isinstance(value, types.FunctionType):
            found[name] = Same(value, value.__code__, value.__defaults__)
        elif isinstance(value, _METHODS) or callable(value):
            found[name] = Same(value)


def list_threads() -> set[threading.Thread]:
    """List the running threads of Python."""
    return set(threading.enumerate())


def list_processes() -> dict[str, str]:
    """List the child processes of this process, dead ones included that were not waited for; Linux only."""
    found: dict[str, str] = {}
    tracker = getattr(getattr(resource_tracker, "_resource_tracker", None), "_pid", None)
    for children in _PROC.glob("task/*/children"):
        with suppress(OSError):
            for pid in children.read_text().split():
                if pid != str(tracker):  # multiprocessing starts one process for itself
                    command = "ended"
                    with suppress(OSError):
                        command = Path(f"/proc/{pid}/comm").read_text().strip()
                    found[f"process {pid}"] = f"process {pid} ({command})"
    return found


def list_files() -> dict[str, str]:
    """List the open files, pipes and sockets of this process by their numbers; Linux only."""
    found: dict[str, str] = {}
    with suppress(OSError):
        for number in os.listdir(_PROC / "fd"):
            with suppress(OSError):  # the one that lists them is closed by now
                found[f"file {number}"] = f"open file {os.readlink(_PROC / 'fd' / number)}"
    return found
