"""Send a function to another process, with what the program has registered, which is registered there again."""

from __future__ import annotations

import pickle
from collections.abc import Callable, Collection
from contextlib import suppress
from dataclasses import dataclass
from importlib import import_module
from typing import Any

from gymnasium.vector.utils import CloudpickleWrapper

from usnet_env.parts import REGISTRIES


@dataclass(frozen=True)
class _Part:
    """A part that the program has registered itself, such as a follow strategy or a detector."""

    kind: str
    name: str
    home: str  # the module of the registry
    module: str  # where the part is defined
    part: CloudpickleWrapper[Any]  # to be pickled by value


def send(function: Callable[..., Any], kinds: Collection[str] | None = None) -> Any:
    """Prepare a function for another process, where it arrives by value: that process need not be able to import it.

    Args:
        function: what is sent. Classes and functions of a notebook go along with it.
        kinds: which kinds of registered parts go along, as in :data:`usnet_env.parts.REGISTRIES`; ``None``: all.

    Returns:
        An object that is the function once it is unpickled.
    """
    return _Sent(CloudpickleWrapper(function), _registered_parts(kinds))


@dataclass(frozen=True)
class _Sent:
    """A function on its way to another process."""

    function: CloudpickleWrapper[Any]
    registered: list[_Part]

    def __reduce__(self) -> Any:
        return _receive, (self.function, self.registered)


def _registered_parts(kinds: Collection[str] | None) -> list[_Part]:
    """What this program has registered; what cannot be pickled is left out, and a process that needs it refuses it."""
    parts = []
    for kind, registry in REGISTRIES.items():
        for name, part in registry.registered.items() if kinds is None or kind in kinds else ():
            origin = getattr(part, "function", None) or getattr(part, "rule", None) or part
            with suppress(Exception):
                pickle.dumps(wrapper := CloudpickleWrapper(part))
                parts.append(_Part(kind, name, registry.home, str(getattr(origin, "__module__", "")), wrapper))
    return parts


def _receive(function: CloudpickleWrapper[Any], registered: list[_Part]) -> Any:
    """Register parts in this process, unless the main script or their module has registered them here too."""
    for part in registered:
        with suppress(Exception):  # its module cannot be imported here: its name is refused if it is used
            import_module(part.home)
            if part.module != "__main__":
                import_module(part.module)
            if part.name not in REGISTRIES[part.kind].registered:
                REGISTRIES[part.kind].register(part.name, part.part.fn)
    return function.fn
