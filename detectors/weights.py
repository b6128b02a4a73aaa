"""Weights that ship with a detector: a safetensors file, and a JSON file that records how they were trained.

Loading reads safetensors and JSON and never unpickles. The JSON file holds the SHA-256 of the safetensors file; a
file with another SHA-256 is refused.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from hashlib import sha256
from importlib.resources import files
from pathlib import Path
from typing import Any

from safetensors import SafetensorError
from safetensors.torch import load, save
from torch import Tensor

from usnet_env.config import ArgumentError, quote
from usnet_env.files import atomic_write

__all__ = ["arrays_of", "packaged_arrays", "packaged_record", "read_arrays", "write_arrays", "write_weights"]


def write_arrays(path: str | os.PathLike[str], arrays: Mapping[str, Tensor]) -> bytes:
    """Write arrays to a safetensors file atomically and return the bytes written."""
    data: bytes = save({name: value.detach().contiguous() for name, value in arrays.items()})
    with atomic_write(path) as aside:
        aside.write_bytes(data)
    return data


def write_weights(
    path: str | os.PathLike[str], arrays: Mapping[str, Tensor], training: Mapping[str, Any], metrics: Mapping[str, Any]
) -> Path:
    """Write arrays to ``path`` and their record to the same name with the suffix ``.json``, each atomically.

    Args:
        path: a file name that ends in ``.safetensors``.
        arrays: the arrays by name.
        training: the settings of the training; must be serialisable as JSON.
        metrics: the measured quality; must be serialisable as JSON.

    Returns:
        ``path``.

    Raises:
        ArgumentError: the path has another suffix or can't be written.
    """
    final = Path(path)
    if final.suffix != ".safetensors":
        raise ArgumentError(f"path must be a name that ends in .safetensors, got {quote(str(path))}.")
    data = write_arrays(final, arrays)
    record = {"sha256": sha256(data).hexdigest(), "training": dict(training), "metrics": dict(metrics)}
    with atomic_write(final.with_suffix(".json")) as aside:
        aside.write_text(json.dumps(record, indent=2) + "\n", encoding="utf-8")
    return final


def read_arrays(path: str | os.PathLike[str]) -> dict[str, Tensor]:
    """Read the arrays of a file written by :func:`write_weights`.

    Raises:
        ArgumentError: a file is missing or broken, or the SHA-256 in the JSON file is not that of the arrays.
    """
    final = Path(path)
    try:
        data, record = final.read_bytes(), final.with_suffix(".json").read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or error
        raise ArgumentError(
            f"path must be a weights file with its JSON beside it, got {quote(str(path))}: {reason}."
        ) from None
    return _verify_arrays(str(path), data, record)


def packaged_arrays(package: str, name: str) -> dict[str, Tensor]:
    """Read the arrays of ``data/<name>.safetensors`` in a package such as ``"detectors.learned"``."""
    folder = files(package) / "data"
    record = (folder / f"{name}.json").read_text(encoding="utf-8")
    return _verify_arrays(f"{name}.safetensors", (folder / f"{name}.safetensors").read_bytes(), record)


def packaged_record(package: str, name: str) -> dict[str, Any]:
    """Read ``data/<name>.json`` in a package, with the keys ``sha256``, ``training`` and ``metrics``."""
    record: dict[str, Any] = json.loads((files(package) / "data" / f"{name}.json").read_text(encoding="utf-8"))
    return record


def _verify_arrays(path: str, data: bytes, record: str) -> dict[str, Tensor]:
    try:
        expected = json.loads(record)["sha256"]
    except (ValueError, KeyError, TypeError):
        raise ArgumentError(f"path must have a JSON with a sha256 beside it, got {quote(path)} without.") from None
    found = sha256(data).hexdigest()
    if found != expected:
        raise ArgumentError(
            f"path must hold the weights that its JSON names (sha256 {quote(expected)}), "
            f"got {quote(path)} with the sha256 {found!r}."
        )
    return arrays_of(path, data)


def arrays_of(path: str, data: bytes) -> dict[str, Tensor]:
    """Parse the bytes of a safetensors file.

    Raises:
        ArgumentError: the bytes are not a safetensors file; the message names ``path``.
    """
    try:
        arrays: dict[str, Tensor] = load(data)
    except SafetensorError as error:
        raise ArgumentError(f"path must be a safetensors file, got {quote(path)}: {error}.") from None
    return arrays
