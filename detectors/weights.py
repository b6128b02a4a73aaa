"""Weights that ship with a detector: a safetensors file, and a JSON file that records how they were trained.

Loading reads safetensors and JSON and never unpickles. The JSON file holds the SHA-256 of the safetensors file; a
file with another SHA-256 is refused.
"""

from __future__ import annotations

import csv
import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from hashlib import sha256
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
import torch
from safetensors import SafetensorError
from safetensors.torch import load, save
from torch import Tensor

from usnet_env.config import ArgumentError, Config, quote
from usnet_env.files import atomic_write


def _write_arrays(path: str | os.PathLike[str], arrays: Mapping[str, Tensor]) -> bytes:
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
    data = _write_arrays(final, arrays)
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
    return json.loads((files(package) / "data" / f"{name}.json").read_text(encoding="utf-8"))


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
        return load(data)
    except SafetensorError as error:
        raise ArgumentError(f"path must be a safetensors file, got {quote(path)}: {error}.") from None


@dataclass(frozen=True)
class Checkpoint:
    """The file ``checkpoint.safetensors`` of a training: arrays, the losses so far, and the settings.

    Args:
        folder: of the file.
        settings: which must be equal for a training to resume from it.
    """

    folder: Path
    settings: Mapping[str, Any]

    @property
    def path(self) -> Path:
        """Path of the file."""
        return self.folder / "checkpoint.safetensors"

    def _encode_settings(self) -> Tensor:
        return torch.tensor(list(json.dumps(self.settings, sort_keys=True).encode()), dtype=torch.uint8)

    def write(self, arrays: Mapping[str, Tensor], losses: Sequence[float]) -> None:
        """Write the file atomically."""
        own = {"losses": torch.tensor(losses, dtype=torch.float64), "training": self._encode_settings()}
        _write_arrays(self.path, {**arrays, **own})

    def read(self) -> tuple[dict[str, Tensor], list[float]]:
        """Read the arrays and the losses; none if there is no file.

        Raises:
            ArgumentError: the file is broken or belongs to another training.
        """
        if not self.path.exists():
            return {}, []
        arrays = arrays_of(str(self.path), self.path.read_bytes())
        if "losses" not in arrays or not torch.equal(arrays.get("training", torch.empty(0)), self._encode_settings()):
            raise ArgumentError(
                "out must hold no checkpoint of another training (use resume=False or another folder), got "
                f"{quote(str(self.path))}."
            )
        return arrays, arrays["losses"].tolist()


def write_losses(folder: Path, step: str, losses: Sequence[float]) -> None:
    """Write ``losses.csv`` atomically: the loss of each step, from 1; ``step`` is the heading of their numbers."""
    with atomic_write(folder / "losses.csv") as aside, aside.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow([step, "loss"])
        writer.writerows(enumerate(losses, start=1))


def record_training(training: Config) -> dict[str, Any]:
    """The settings of a training, and the versions that computed it."""
    return {**training.model_dump(mode="json"), "torch": torch.__version__, "numpy": np.__version__}
