"""Weights of networks: a safetensors file, and a JSON file that records how they were trained; nothing is unpickled."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from safetensors import SafetensorError
from safetensors.numpy import load, save

from usnet_env.config import ArgumentError, quote
from usnet_env.files import atomic_write, write_text


def _write_arrays(path: Path, arrays: Mapping[str, ArrayLike]) -> None:
    with atomic_write(path) as aside:
        aside.write_bytes(save({name: np.asarray(value, order="C") for name, value in arrays.items()}))


def write_weights(
    path: Path, arrays: Mapping[str, ArrayLike], training: Mapping[str, Any], metrics: Mapping[str, Any]
) -> Path:
    """Write arrays to ``path``, a ``.safetensors`` file that is returned, and beside it the record, a ``.json`` file.

    The record has the settings of the training, the versions that computed it, and the measured quality, ``metrics``.
    """
    _write_arrays(path, arrays)
    settings = {**training, "torch": version("torch"), "numpy": np.__version__}
    write_text(path.with_suffix(".json"), json.dumps({"training": settings, "metrics": metrics}, indent=2) + "\n")
    return path


def read_arrays(path: str | os.PathLike[str]) -> dict[str, NDArray[Any]]:
    """Read the arrays of a safetensors file; a missing or broken one is an ``ArgumentError``."""
    try:
        return load(Path(path).read_bytes())
    except (OSError, SafetensorError) as error:
        reason = getattr(error, "strerror", None) or error
        raise ArgumentError(f"path must be a safetensors file, got {quote(str(path))}: {reason}.") from None


def read_packaged_arrays(package: str, name: str) -> dict[str, NDArray[Any]]:
    """Read the arrays of ``data/<name>.safetensors`` in a package such as ``"detectors.mc_gassl"``."""
    return load((files(package) / "data" / f"{name}.safetensors").read_bytes())


class Checkpoint:
    """The file ``checkpoint.safetensors`` of a training: arrays, losses, and ``settings``, which must not change."""

    def __init__(self, folder: Path, settings: Mapping[str, Any]) -> None:
        self._path = folder / "checkpoint.safetensors"
        self._settings = np.frombuffer(json.dumps(settings, sort_keys=True).encode(), np.uint8)

    def write(self, arrays: Mapping[str, ArrayLike], losses: Sequence[float]) -> None:
        """Write the file atomically."""
        progress: dict[str, ArrayLike] = {"losses": np.asarray(losses, np.float64), "training": self._settings}
        _write_arrays(self._path, {**arrays, **progress})

    def read(self) -> tuple[dict[str, NDArray[Any]], list[float]]:
        """Read the arrays and the losses; none if there is no file. That of another training is refused."""
        if not self._path.exists():
            return {}, []
        arrays = read_arrays(self._path)
        if not np.array_equal(arrays.get("training", np.empty(0)), self._settings):
            raise ArgumentError(
                "out must hold no checkpoint of another training (use resume=False or another folder), got "
                f"{quote(str(self._path))}."
            )
        return arrays, arrays["losses"].tolist()
