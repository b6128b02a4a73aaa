"""What a program has registered itself, sent to other processes, in which it is registered again."""

from __future__ import annotations

import pickle
from collections.abc import Collection, Iterable
from contextlib import suppress
from dataclasses import dataclass
from importlib import import_module
from typing import Any

from gymnasium.vector.utils import CloudpickleWrapper

from usnet_env.registry import REGISTRIES


@dataclass(frozen=True)
class Part:
    """A part that the program has registered itself, such as a follow strategy or a detector.

    Args:
        kind, name: what it is, and its name.
        home: the module of the registry.
        module: where the part is defined.
        part: the object, to be pickled by value.
    """

    kind: str
    name: str
    home: str
    module: str
    part: CloudpickleWrapper[Any]


def registered_parts(kinds: Collection[str] | None = None) -> list[Part]:
    """What this program has registered itself.

    What cannot be pickled is left out; a worker process that needs it then refuses its name.

    Args:
        kinds: which kinds of parts, as in :data:`usnet_env.registry.REGISTRIES`; ``None`` for all.
    """
    parts = []
    for kind, registry in REGISTRIES.items():
        for name, part in registry.registered.items() if kinds is None or kind in kinds else ():
            origin = getattr(part, "function", None) or getattr(part, "rule", None) or part
            with suppress(Exception):
                pickle.dumps(wrapper := CloudpickleWrapper(part))
                parts.append(Part(kind, name, registry.home, str(getattr(origin, "__module__", "")), wrapper))
    return parts


def register_parts(parts: Iterable[Part]) -> None:
    """Register parts in this process, unless the main script or their module has registered them here too."""
    for part in parts:
        with suppress(Exception):  # its module cannot be imported here: its name is refused if it is used
            import_module(part.home)
            if part.module != "__main__":
                import_module(part.module)
            if part.name not in REGISTRIES[part.kind].registered:
                REGISTRIES[part.kind].register(part.name, part.part.fn)
