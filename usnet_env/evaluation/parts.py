"""What a program has registered itself, sent to other processes, in which it is registered again."""

from __future__ import annotations

import pickle
from collections.abc import Collection, Iterable
from contextlib import suppress
from dataclasses import dataclass
from importlib import import_module
from typing import Any

from gymnasium.vector.utils import CloudpickleWrapper

from usnet_env.plugins import register_detector, registered_detectors
from usnet_env.swarm import register_follow_strategy, register_mobility
from usnet_env.swarm.follow import FollowFunction, follow_strategies
from usnet_env.swarm.mobility import MobilityFunction, mobilities

__all__ = ["Part", "register_parts", "registered_parts"]

_REGISTER = {"follow": register_follow_strategy, "mobility": register_mobility, "detector": register_detector}


@dataclass(frozen=True)
class Part:
    """A follow strategy, mobility or detector that the program has registered itself.

    Args:
        kind, name: what it is, and its name.
        module: where it is defined.
        part: the object, to be pickled by value.
    """

    kind: str
    name: str
    module: str
    part: CloudpickleWrapper[Any]


def registered_parts(kinds: Collection[str] = tuple(_REGISTER)) -> list[Part]:
    """What this program has registered itself.

    What cannot be pickled is left out; a worker process that needs it then refuses its name.

    Args:
        kinds: which kinds of parts; by default all.
    """
    found: list[tuple[str, str, Any, Any]] = [
        (kind, name, part, part.function if isinstance(part, FollowFunction | MobilityFunction) else type(part))
        for kind, parts in (("follow", follow_strategies()), ("mobility", mobilities()))
        for name, part in parts.items()
    ]
    found += [("detector", name, factory, factory) for name, factory in registered_detectors().items()]
    parts = []
    for kind, name, part, origin in found:
        module = str(getattr(origin, "__module__", ""))
        if kind in kinds and not module.startswith("usnet_env."):
            with suppress(Exception):
                pickle.dumps(wrapper := CloudpickleWrapper(part))
                parts.append(Part(kind, name, module, wrapper))
    return parts


def register_parts(parts: Iterable[Part]) -> None:
    """Register parts in this process, unless the main script or their module has registered them here too."""
    known = {"follow": follow_strategies(), "mobility": mobilities(), "detector": registered_detectors()}
    for part in parts:
        with suppress(Exception):  # its module cannot be imported here: its name is refused if it is used
            if part.module != "__main__":
                import_module(part.module)
            if part.name not in known[part.kind]:
                _REGISTER[part.kind](part.name, part.part.fn)  # type: ignore[operator]
