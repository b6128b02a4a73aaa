"""Paths, and files that are written whole or not at all."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from html import escape
from pathlib import Path
from tempfile import TemporaryDirectory, TemporaryFile
from typing import TYPE_CHECKING, Any
from uuid import uuid4

from usnet_env.config import ArgumentError, printable, quote

if TYPE_CHECKING:
    import pandas as pd

_STYLE = """
body { font: 16px/1.5 system-ui, sans-serif; max-width: 62rem; margin: 0 auto; padding: 1rem; }
:root { color-scheme: light dark; } img { max-width: 100%; } summary { cursor: pointer; }
table { border-collapse: collapse; display: block; overflow-x: auto; }
td, th { padding: 0.2rem 0.6rem; border: 1px solid #ccc; text-align: left; }
"""


def as_path(name: str, value: Any) -> Path:
    """Return the argument ``name``, a ``str`` or an object of ``os.PathLike``, as a path; an empty one is refused."""
    text = str(value) if isinstance(value, str | os.PathLike) else ""
    if not text or "\0" in text:
        raise ArgumentError(f"{name} must be a path, got {quote(value)}.")
    return Path(value)


def describe_fault(path: str | os.PathLike[str], kind: str, error: Exception, hint: str = "") -> str:
    """A sentence about a file that can't be read: libraries raise many kinds of errors for damaged ones."""
    if isinstance(error, FileNotFoundError):
        return f"{printable(path)}: no such file."
    reason = getattr(error, "strerror", None) or f"{type(error).__name__}: {error}".removesuffix(": ")
    return f"{printable(path)}: not an intact {kind} ({' '.join(reason.split()).rstrip('.')}{hint})."


def read_csv(source: Any, **options: Any) -> pd.DataFrame:
    """Call :func:`pandas.read_csv` so that each float is the one nearest to its text, with every version of pandas."""
    import pandas as pd

    always_exact = tuple(map(int, pd.__version__.split(".")[:2])) >= (3, 1)  # and the argument is deprecated
    return pd.read_csv(source, **({} if always_exact else {"float_precision": "round_trip"}), **options)


@contextmanager
def atomic_write(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Write to a temporary file that replaces ``path`` at the end of the block; an error deletes it instead.

    Missing folders are created. Yields the path of the temporary file, in the same folder.
    """
    target = as_path("path", path)
    temporary = target.with_name(f".{uuid4().hex}.{target.name}")
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        yield temporary
        os.replace(temporary, target)
    except OSError as error:
        sentence = f"path must be a file that can be written, got {quote(str(target))}: {error.strerror}."
        raise ArgumentError(sentence) from None
    finally:
        with suppress(OSError):  # after success it no longer exists
            temporary.unlink()


@contextmanager
def replace_files(folder: Path, optional: Iterable[str] = ()) -> Iterator[Path]:
    """Write files into a temporary folder, which is yielded; they move into ``folder`` at the end of the block.

    Of the names ``optional``, the files that weren't written are deleted then. An error, or the end of this process,
    before leaves all files as they were.
    """
    with TemporaryDirectory(dir=folder, prefix=".unfinished-") as temporary:
        yield Path(temporary)
        written = {file.name for file in Path(temporary).iterdir()}
        for name in written:
            os.replace(Path(temporary, name), folder / name)
        for name in {*optional} - written:
            (folder / name).unlink(missing_ok=True)


def write_text(path: str | os.PathLike[str], text: str) -> None:
    """Write a text file in UTF-8, as :func:`atomic_write` does."""
    with atomic_write(path) as temporary:
        temporary.write_text(text, encoding="utf-8", newline="")


def write_html(path: str | os.PathLike[str], title: str, body: str) -> None:
    """Write a page that needs no network, as :func:`atomic_write` does; ``title`` is a text, ``body`` is HTML."""
    head = '<meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">'
    head += f"<title>{escape(title)}</title><style>{_STYLE}</style>"
    page = f'<!doctype html>\n<html lang="en"><head>{head}</head><body>\n<h1>{escape(title)}</h1>{body}</body></html>\n'
    write_text(path, page)


def reserve_folder(folder: Path, name: str = "out") -> Path:
    """Create the folder of an argument before the work begins, check that it can be written, and return it."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with TemporaryFile(dir=folder):
            return folder
    except OSError as error:
        sentence = f"{name} must be a folder that can be written, got {quote(str(folder))}: {error.strerror}."
        raise ArgumentError(sentence) from None
