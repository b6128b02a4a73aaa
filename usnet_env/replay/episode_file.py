"""The file of an episode: arrays and one JSON text in a ``.npz``, without pickled objects."""

from __future__ import annotations

import json
import os
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from usnet_env.config import ArgumentError, quote
from usnet_env.files import as_path, atomic_write

#: Version 2 added ``attention`` and ``communication_links``, version 3 ``labelled``, version 4 ``attention_heads``,
#: ``probability``, ``features``, ``reasons``, ``choices`` and ``observers``. In version 5 ``leader`` became ``root``.
#: Older files are read as well.
FORMAT_VERSION = 5
_FORMAT = "usnet-episode"
_METADATA = "metadata"
#: What :func:`read_episode_file` unpacks at most without ``max_bytes``: 256 MiB, or this multiple of the file's size.
SMALL_BYTES, LARGEST_RATIO = 2**28, 20


def write_episode_file(path: str | os.PathLike[str], words: Mapping[str, Any], arrays: Mapping[str, Any]) -> Path:
    """Write arrays and the plain values ``words`` as one compressed file; the file appears whole."""
    text = json.dumps({**words, "format": _FORMAT, "version": FORMAT_VERSION})
    everything: dict[str, Any] = {**arrays, _METADATA: np.array(text)}
    with atomic_write(path) as aside, aside.open("wb") as file:
        np.savez_compressed(file, **everything)
    return as_path("path", path)


def _check_size(loaded: np.lib.npyio.NpzFile, file_bytes: int, max_bytes: int | None) -> None:
    """Refuse a file whose arrays need more than ``max_bytes``, before any of them is unpacked."""
    most = max(SMALL_BYTES, LARGEST_RATIO * file_bytes) if max_bytes is None else max_bytes
    archive = loaded.zip
    assert archive is not None  # it is until the file is closed
    needed = sum(member.file_size for member in archive.infolist())
    if needed > most:
        raise ArgumentError(
            f"max_bytes must be at least the {needed} bytes that the arrays of this file of {file_bytes} bytes need, "
            f"got {most}."
        )


def read_episode_file(
    path: str | os.PathLike[str], max_bytes: int | None
) -> tuple[str, dict[str, Any], dict[str, Any]]:
    """Read a file that :func:`write_episode_file` of this or an earlier version wrote; nothing in it is executed.

    Returns:
        The quoted path, for messages; the plain values, with ``version``; and the arrays.

    Raises:
        ArgumentError: the file does not exist, is of another kind or a newer version, is damaged, or holds more than
            ``max_bytes``.
    """
    place = as_path("path", path)
    where = quote(os.fspath(place))
    foreign = ArgumentError(f"path must be an episode file of this project, got {where}.")
    try:
        with place.open("rb") as file:
            if not zipfile.is_zipfile(file):  # np.load would read the whole array of another kind of file
                file.seek(0)
                cut = file.read(4) == b"PK\x03\x04"  # how a .npz file begins; its table is at the end
                raise (
                    ArgumentError(f"path must be an intact episode file, got {where}: its end is missing.")
                    if cut
                    else foreign
                )
            file.seek(0)
            loaded = np.load(file, allow_pickle=False)
            if not isinstance(loaded, np.lib.npyio.NpzFile) or _METADATA not in loaded.files:
                raise foreign
            _check_size(loaded, os.fstat(file.fileno()).st_size, max_bytes)
            arrays: dict[str, Any] = {name: loaded[name] for name in loaded.files}
        words = json.loads(str(arrays.pop(_METADATA)))
    except ArgumentError:
        raise
    except IsADirectoryError:
        raise ArgumentError(f"path must be an episode file, got the folder {where}.") from None
    except FileNotFoundError:
        raise ArgumentError(f"path must be an episode file, got {where}, which does not exist.") from None
    except Exception as error:  # a damaged header makes NumPy raise whatever Python's own tokenizer raises
        why = " ".join(str(error).split()) or type(error).__name__
        raise ArgumentError(f"path must be an intact episode file, got {where}, not readable: {why}.") from None
    if not isinstance(words, dict) or words.pop("format", None) != _FORMAT:
        raise foreign
    if words.get("version") not in range(1, FORMAT_VERSION + 1):
        raise ArgumentError(
            f"path must be an episode file of a version up to {FORMAT_VERSION}, got {where} of version "
            f"{quote(words.get('version'))}."
        )
    return where, words, arrays
