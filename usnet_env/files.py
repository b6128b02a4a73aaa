"""Atomic writing, and files that only one process at a time may change."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from errno import EISDIR
from pathlib import Path
from typing import Any
from uuid import uuid4

from usnet_env.config import ArgumentError, quote

try:
    import fcntl
except ImportError:  # Windows has no such locks
    fcntl = None  # type: ignore[assignment]

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
        if not path or "\0" in path or max(name_sizes, default=0) > _LONGEST_NAME:
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


def reserve_folder(folder: Path, file: str) -> FileLock:
    """Lock a file of the folder ``out`` before the work begins: one that can't be written should not cost the work.

    Raises:
        ArgumentError: another process uses the folder, or it can't be written.
    """
    try:
        return FileLock(folder / file)
    except OSError as error:
        why = error.strerror or error
        raise ArgumentError(f"out must be a folder that can be written, got {quote(str(folder))}: {why}.") from None


class FileLock:
    """Allows only one process to change a file and the files that belong to it.

    The lock is a file beside the given one, ``.<name>.lock``, that holds the number of the process. The system
    releases the lock when the process ends, whatever ends it, so a lock file that a killed process left is no obstacle.

    Args:
        path: the file. Missing folders are created, and removed again by :meth:`release` if they are empty.

    Raises:
        ArgumentError: another process has the lock; the message names it.
        OSError: the folder cannot be written.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = Path(path)
        self._lock_path = self.path.with_name(f".{self.path.name}.lock")
        folder = self.path.parent
        self._created = [each for each in (folder, *folder.parents) if not each.exists()]
        folder.mkdir(parents=True, exist_ok=True)
        self._file = self._take()

    def _take(self) -> int:
        while True:
            file = os.open(self._lock_path, os.O_RDWR | os.O_CREAT, 0o644)
            try:
                if fcntl is not None:
                    fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError:
                owner = os.read(file, 20).decode("ascii", "replace").strip()
                os.close(file)
                process = f"process {owner}" if owner else "another process"
                raise ArgumentError(
                    f"out must be a folder that no other run uses, got {quote(str(self.path.parent))}, "
                    f"which {process} uses."
                ) from None
            if self._is_at_its_place(file):
                os.ftruncate(file, 0)
                os.write(file, f"{os.getpid()}\n".encode())
                return file
            os.close(file)  # its owner has removed it between the two calls

    def _is_at_its_place(self, file: int) -> bool:
        try:
            return os.path.samestat(os.stat(self._lock_path), os.fstat(file))
        except OSError:
            return False

    def check(self) -> None:
        """Check that the folder is still the one that was locked.

        Raises:
            ArgumentError: the folder or the lock file was removed or replaced.
        """
        if not self._is_at_its_place(self._file):
            raise ArgumentError(
                f"out must stay as it is during a run, got {quote(str(self.path.parent))}, which was removed."
            )

    def remove_unfinished(self, start: str) -> None:
        """Remove what killed processes left in the folder of files that :func:`atomic_write` had begun.

        Args:
            start: how the names of these files begin.
        """
        for path in self.path.parent.iterdir():
            if re.fullmatch(rf"\.{re.escape(start)}.*\.[0-9a-f]{{32}}", path.name):
                with suppress(OSError):  # a folder, or a file that another user owns
                    path.unlink()

    def release(self) -> None:
        """Remove the lock, and the folders that it created if nothing was written into them."""
        if self._is_at_its_place(self._file):
            with suppress(OSError):
                self._lock_path.unlink()
        os.close(self._file)
        for folder in self._created:
            with suppress(OSError):  # it is not empty
                folder.rmdir()

    def __enter__(self) -> FileLock:
        return self

    def __exit__(self, *_: object) -> None:
        self.release()
