"""Weights of networks: a safetensors file, and a JSON file that records how they were trained; nothing is unpickled."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
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


def _write_arrays(path: Path, arrays: Mapping[str, Tensor]) -> None:
    with atomic_write(path) as aside:
        aside.write_bytes(save({name: value.detach().contiguous() for name, value in arrays.items()}))


def write_weights(
    path: str | os.PathLike[str], arrays: Mapping[str, Tensor], training: Mapping[str, Any], metrics: Mapping[str, Any]
) -> Path:
    """Write arrays to ``path`` and their record beside it, under the suffix ``.json``; each appears whole.

    Args:
        path: a file name with the suffix ``.safetensors``; it is returned.
        arrays: the arrays by name.
        training: the settings of the training, for JSON.
        metrics: the measured quality, for JSON.
    """
    final = Path(path)
    _write_arrays(final, arrays)
    with atomic_write(final.with_suffix(".json")) as aside:
        record = {"training": dict(training), "metrics": dict(metrics)}
        aside.write_text(json.dumps(record, indent=2) + "\n", encoding="utf-8")
    return final


def read_arrays(path: str | os.PathLike[str]) -> dict[str, Tensor]:
    """Read the arrays of a safetensors file, such as :func:`write_weights` writes.

    Raises:
        ArgumentError: the file is missing or broken.
    """
    try:
        return load(Path(path).read_bytes())
    except (OSError, SafetensorError) as error:
        reason = getattr(error, "strerror", None) or error
        raise ArgumentError(f"path must be a safetensors file, got {quote(str(path))}: {reason}.") from None


def packaged_arrays(package: str, name: str) -> dict[str, Tensor]:
    """Read the arrays of ``data/<name>.safetensors`` in a package such as ``"detectors.learned"``."""
    return load((files(package) / "data" / f"{name}.safetensors").read_bytes())


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
        progress = {"losses": torch.tensor(losses, dtype=torch.float64), "training": self._encode_settings()}
        _write_arrays(self.path, {**arrays, **progress})

    def read(self) -> tuple[dict[str, Tensor], list[float]]:
        """Read the arrays and the losses; none if there is no file.

        Raises:
            ArgumentError: the file is broken or belongs to another training.
        """
        if not self.path.exists():
            return {}, []
        arrays = read_arrays(self.path)
        if "losses" not in arrays or not torch.equal(arrays.get("training", torch.empty(0)), self._encode_settings()):
            raise ArgumentError(
                "out must hold no checkpoint of another training (use resume=False or another folder), got "
                f"{quote(str(self.path))}."
            )
        return arrays, arrays["losses"].tolist()


def write_losses(folder: Path, step: str, losses: Sequence[float]) -> None:
    """Write ``losses.csv`` atomically: the loss of each step, from 1; ``step`` is the heading of their numbers."""
    lines = [f"{step},loss", *(f"{number},{loss}" for number, loss in enumerate(losses, start=1))]
    with atomic_write(folder / "losses.csv") as aside:
        aside.write_text("\n".join(lines) + "\n", encoding="utf-8")


def record_training(training: Config) -> dict[str, Any]:
    """The settings of a training, and the versions that computed it."""
    return {**training.model_dump(mode="json"), "torch": torch.__version__, "numpy": np.__version__}
