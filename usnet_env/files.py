"""Atomic writing: a file is written completely or not at all."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from errno import EISDIR
from pathlib import Path
from typing import Any
from uuid import uuid4

from usnet_env.config import ArgumentError, quote

__all__ = ["as_path", "atomic_write"]

_LONGEST_NAME = 255  # bytes; the limit of the usual file systems


def as_path(name: str, value: Any) -> Path:
    """Return the argument ``name`` as a path.

    Args:
        name: the argument's name in error messages.
        value: a ``str``, or an object of ``os.PathLike`` that returns one.

    Raises:
        ArgumentError: the value has another type, or no file can have this name.
    """
    try:
        path = os.fspath(value)
        name_sizes = [len(os.fsencode(part)) for part in Path(path).parts]
        if "\0" in path or max(name_sizes, default=0) > _LONGEST_NAME:
            raise ValueError
    except Exception:  # the __fspath__ of a foreign class may raise anything
        raise ArgumentError(f"{name} must be a path, got {quote(value)}.") from None
    return Path(path)


@contextmanager
def atomic_write(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Write to a temporary file that replaces ``path`` at the end of the block; an error deletes it instead.

    Args:
        path: the file to create or replace. Missing folders are created.

    Yields:
        The path of the temporary file, in the same folder.

    Raises:
        ArgumentError: the file can't be written.
    """
    final = as_path("path", path)
    aside = final.parent / f".{final.name}.{uuid4().hex}"
    try:
        if final.is_dir():
            raise IsADirectoryError(EISDIR, os.strerror(EISDIR))
        final.parent.mkdir(parents=True, exist_ok=True)
        yield aside
        os.replace(aside, final)
    except OSError as error:
        raise ArgumentError(
            f"path must be a file that can be written, got {quote(str(final))}: {error.strerror or error}."
        ) from None
    finally:
        with suppress(OSError):  # after success it no longer exists
            aside.unlink()
