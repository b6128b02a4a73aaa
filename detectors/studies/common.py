"""What several studies share: the paper's follow strategies, how heads fly, and a table with a picture."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass, fields
from typing import Any, Generic, TypedDict, TypeVar

from usnet_env.config import unknown_name
from usnet_env.evaluation.suite import Place
from usnet_env.plugins import make_detector

RowT = TypeVar("RowT")

FOLLOW = ("f1", "f2", "f3", "f4", "f5", "f6", "f7")


class Running(TypedDict, total=False):
    """How the games of a study are played."""

    workers: int | Place  # number of processes, 1 by default, or a place
    progress: Callable[[int, int], None]  # called with the number of games that are done, and of all games


@dataclass(frozen=True)
class Reproduction(Generic[RowT]):
    """A study that was measured."""

    rows: list[RowT]  # those that were asked for
    text: str  # a report of them in Markdown


def swarm_arguments(cell: Any, kind: type, skipped: int = 1) -> dict[str, Any]:
    """The arguments of a cell's environment: the fields of the class of cells after the first ones."""
    return {field.name: getattr(cell, field.name) for field in fields(kind)[skipped:]}


def check_names(argument: str, names: Iterable[str], known: Collection[str]) -> None:
    """Refuse a name that is not known."""
    for name in names:
        if name not in known:
            raise unknown_name(argument, name, known)


def check_detectors(names: Sequence[str], seed: int) -> None:
    """Refuse a wrong name or argument of a detector before anything is measured."""
    for name in names:
        make_detector(name).reset(seed)


def name_flight(cell: Any) -> str:
    """What the name of a file says of how the heads of a cell fly; nothing for the paper's heads."""
    return (f"-{cell.mobility}" if cell.mobility != "iid" else "") + ("-jitter" if cell.head_jitter else "")


def describe_flight(cell: Any) -> str:
    """How the heads of a cell fly, in words."""
    return f"{cell.mobility} heads{' with jitter' if cell.head_jitter else ''}"
