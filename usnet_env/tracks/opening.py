"""Open text files row by row: plain, gzip or zip, with a limit on the expanded size and on the length of a row."""

from __future__ import annotations

import gzip
import io
import os
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

from usnet_env.config import ArgumentError, quote

SMALL_BYTES, LARGEST_RATIO = 2**28, 20  # without max_bytes: 256 MiB, or this multiple of the file's size
_LONGEST_ROW = 2**20  # bytes
_GZIP, _ZIP = b"\x1f\x8b", b"PK\x03\x04"
_TEXT_SUFFIXES = (".csv", ".tsv", ".txt", ".gpx")
_DAMAGES = (EOFError, zlib.error, gzip.BadGzipFile, zipfile.BadZipFile, NotImplementedError, RuntimeError)
_UTF_16 = (b"\xff\xfe", b"\xfe\xff")


def expanded_limit(path: Path, max_bytes: int | None) -> int:
    """The most bytes that a compressed file may expand to: ``max_bytes``, or what suits its size."""
    return max(SMALL_BYTES, LARGEST_RATIO * path.stat().st_size) if max_bytes is None else max_bytes


def check_expanded_size(path: Path, needed: int, max_bytes: int | None) -> None:
    """Refuse a file that expands to more than :func:`expanded_limit`, by the number of bytes that the file tells."""
    most = expanded_limit(path, max_bytes)
    if needed > most:
        raise ArgumentError(
            f"max_bytes must be at least the {needed} bytes that {quote(os.fspath(path))} expands to, got {most}."
        )


def damaged_file(path: Path, error: Exception, kind: str = "") -> ArgumentError:
    """The error for a file of some kind that can't be read."""
    why = " ".join(str(error).split()).rstrip(".") or type(error).__name__
    what = f"an intact {kind} file" if kind else "an intact file"
    return ArgumentError(f"path must be {what}, got {quote(os.fspath(path))}, not readable: {why}.")


def is_zip(path: Path) -> bool:
    """Whether the file begins like a zip archive."""
    with path.open("rb") as file:
        return file.read(4) == _ZIP


def _check_gzip(file: IO[bytes], path: Path, most: int) -> None:
    """Refuse a gzip file that expands to more than ``most`` bytes, before the slow work on its rows begins.

    The size in its trailer may be that of its last part only, or wrong, so the bytes are expanded and counted.
    """
    with gzip.open(file) as expanded:
        limited = _Limited(expanded, path, most)
        while limited.read(_LONGEST_ROW):
            pass
    file.seek(0)


class _Limited(io.RawIOBase):
    """Reads a stream of unknown size, and refuses to go on after ``most`` bytes."""

    def __init__(self, source: IO[bytes] | gzip.GzipFile, path: Path, most: int) -> None:
        self._source, self._path, self._most, self._left = source, path, most, most

    def readable(self) -> bool:
        return True

    def readinto(self, buffer: Any) -> int:
        part = self._source.read(len(buffer))
        self._left -= len(part)
        if self._left < 0:
            raise _too_large(self._path, self._most)
        buffer[: len(part)] = part
        return len(part)


def _too_large(path: Path, most: int) -> ArgumentError:
    return ArgumentError(
        f"max_bytes must be at least the expanded size of {quote(str(path))}, which exceeds {most} bytes."
    )


@contextmanager
def open_expanded(path: Path, max_bytes: int | None) -> Iterator[IO[bytes]]:
    """Open a file for reading bytes; gzip, and zip with one text file in it, are expanded.

    Raises:
        ArgumentError: the archive is damaged, holds no text file or several, or expands to too many bytes.
    """
    try:
        with path.open("rb") as file:
            magic = file.peek(4)[:4]  # a pipe can't be read again
            most = expanded_limit(path, max_bytes)
            if magic[:2] == _GZIP:
                if file.seekable():
                    _check_gzip(file, path, most)
                with gzip.open(file) as expanded:
                    yield io.BufferedReader(_Limited(expanded, path, most), 2**16)
            elif magic == _ZIP:
                with zipfile.ZipFile(file) as archive:
                    member = _find_member(archive, path)
                    if archive.getinfo(member).file_size > most:  # if this number is wrong, _Limited notices
                        raise _too_large(path, most)
                    with archive.open(member) as expanded:
                        yield io.BufferedReader(_Limited(expanded, path, most), 2**16)
            else:
                yield file
    except _DAMAGES as error:
        raise damaged_file(path, error) from None


def find_suffix(path: Path) -> str:
    """The suffix of a file, or of the text file in a gzip or zip archive, in small letters.

    Raises:
        ArgumentError: the zip archive is damaged, or holds no text file or several.
    """
    suffix = path.suffix.lower()
    if suffix == ".zip" and is_zip(path):
        try:
            with zipfile.ZipFile(path) as archive:
                return Path(_find_member(archive, path)).suffix.lower()
        except _DAMAGES as error:
            raise damaged_file(path, error) from None
    return Path(path.stem).suffix.lower() if suffix == ".gz" else suffix


def _find_member(archive: zipfile.ZipFile, path: Path) -> str:
    """The one text file in a zip archive; the copies that a Mac adds, which hold no text, are left out."""
    names = [each for each in archive.namelist() if each.lower().endswith(_TEXT_SUFFIXES)]
    texts = [each for each in names if not each.startswith("__MACOSX/")]
    if len(texts) != 1:
        raise ArgumentError(
            f"path must be a zip archive with one file of {', '.join(_TEXT_SUFFIXES)}, got {quote(str(path))} with "
            f"{quote(archive.namelist())}."
        )
    return texts[0]


def read_lines(file: IO[bytes], path: Path, encoding: str) -> Iterator[str]:
    """Decode a file row by row.

    Raises:
        ArgumentError: a row is not in this encoding or longer than 1 MiB; the sentence names the row.
    """
    where, number = quote(os.fspath(path)), 0
    while raw := file.readline(_LONGEST_ROW):
        number += 1
        if number == 1:
            if raw[:2] in _UTF_16:
                raise ArgumentError(f"path must be a text file in {encoding}, got {where} in UTF-16; save it as UTF-8.")
            raw = raw.removeprefix(b"\xef\xbb\xbf")
        if len(raw) >= _LONGEST_ROW:
            raise ArgumentError(
                f"path must be a text file with rows of at most {_LONGEST_ROW} bytes, got {where}, whose row {number} "
                "is longer."
            )
        try:
            yield raw.decode(encoding)
        except UnicodeDecodeError as error:
            raise ArgumentError(
                f"path must be a text file in {encoding}, got {where}, whose row {number} holds the byte "
                f"0x{raw[error.start]:02X} at place {error.start + 1} (encoding= names another one, such as latin-1)."
            ) from None
