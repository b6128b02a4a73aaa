"""What the folder of a suite holds beside the runs of its cells: which suite it is, and which detectors failed."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import yaml

from usnet_env.config import ArgumentError, Config
from usnet_env.evaluation.identity import describe
from usnet_env.evaluation.store import write_text

SUITE, FAILURES = "suite.json", "failures.yaml"

Failures = dict[str, dict[str, str]]  # by cell and by detector

PartT = TypeVar("PartT")


def write_suite(folder: Path, suite: Config) -> None:
    """Write which suite was played last, unless the folder says so; objects among its arguments are described."""
    text = json.dumps(describe(suite), indent=2) + "\n"
    path = folder / SUITE
    if not path.is_file() or path.read_bytes() != text.encode():
        write_text(path, text)


def read_suite(folder: Path) -> dict[str, Any] | None:
    """The fields of the suite that :func:`write_suite` was given; ``None`` in a folder of an earlier version.

    Raises:
        ArgumentError: the file holds something else.
    """
    return _read(folder / SUITE, "folder", lambda text: dict(json.loads(text)))


def write_failures(folder: Path, failures: Failures) -> None:
    """Write which detectors have failed in which cells."""
    write_text(folder / FAILURES, yaml.safe_dump(failures, allow_unicode=True))


def read_failures(folder: Path) -> Failures:
    """The failures of earlier calls with the same folder.

    Raises:
        ArgumentError: the file holds something else.
    """

    def parse(text: str) -> Failures:
        return {cell: dict(own) for cell, own in (yaml.safe_load(text) or {}).items()}

    return _read(folder / FAILURES, "out", parse) or {}


def _read(path: Path, argument: str, parse: Callable[[str], PartT]) -> PartT | None:
    """Read a file of the folder ``argument``; ``None`` if there is none."""
    if not path.exists():
        return None
    try:
        return parse(path.read_text(encoding="utf-8"))
    except (yaml.YAMLError, AttributeError, TypeError, ValueError):
        raise ArgumentError(
            f"{argument} must hold a {path.name} of a suite, got a broken one in {str(path.parent)!r}."
        ) from None
