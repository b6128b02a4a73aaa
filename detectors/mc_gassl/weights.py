"""Weights of the GRU network on disk: safetensors, with a JSON beside them that says how they came about.

Loading reads arrays and JSON and never unpickles. The JSON names the SHA-256 of the weights; others are refused.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from hashlib import sha256
from importlib.resources import files
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError
from safetensors.torch import load, save

from detectors.mc_gassl.gru import GruParameters
from usnet_env.config import InvalidArgument, shown
from usnet_env.files import written_whole

__all__ = ["NAMES", "load_meta_weights", "load_weights", "meta_record", "save_weights"]

#: the arrays of a file, in the order of :meth:`GruParameters.tensors`
NAMES = ("reset", "update", "candidate")

_META = "meta.safetensors"


def save_weights(
    path: str | os.PathLike[str], parameters: GruParameters, training: Mapping[str, Any], metrics: Mapping[str, Any]
) -> Path:
    """Write weights, and ``path`` with the suffix ``.json`` beside them; both appear whole.

    Args:
        path: a name that ends in ``.safetensors``.
        parameters: W.
        training: how they were trained, as JSON takes it.
        metrics: how well, as JSON takes it.

    Returns:
        ``path``.

    Raises:
        InvalidArgument: the path has another suffix or can't be written to.
    """
    final = Path(path)
    if final.suffix != ".safetensors":
        raise InvalidArgument(f"path must be a name that ends in .safetensors, got {shown(str(path))}.")
    data = save({name: value.detach().contiguous() for name, value in zip(NAMES, parameters.tensors(), strict=True)})
    record = {"sha256": sha256(data).hexdigest(), "training": dict(training), "metrics": dict(metrics)}
    with written_whole(final) as aside:
        aside.write_bytes(data)
    with written_whole(final.with_suffix(".json")) as aside:
        aside.write_text(json.dumps(record, indent=2) + "\n", encoding="utf-8")
    return final


def load_weights(path: str | os.PathLike[str]) -> GruParameters:
    """The weights in a file that :func:`save_weights` wrote.

    Raises:
        InvalidArgument: a file is missing or broken, or the weights are not those that the JSON names.
    """
    final = Path(path)
    try:
        data, record = final.read_bytes(), final.with_suffix(".json").read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or error
        raise InvalidArgument(
            f"path must be a weights file with its JSON beside it, got {shown(str(path))}: {reason}."
        ) from None
    return _checked(str(path), data, record)


def load_meta_weights() -> GruParameters:
    """The meta-trained weights that this package ships, made by :func:`detectors.mc_gassl.train.train_meta`."""
    folder = files("detectors.mc_gassl") / "data"
    record = (folder / _META.replace(".safetensors", ".json")).read_text(encoding="utf-8")
    return _checked(_META, (folder / _META).read_bytes(), record)


def meta_record() -> dict[str, Any]:
    """How the shipped weights were trained, and how well: ``sha256``, ``training``, ``metrics``."""
    record: dict[str, Any] = json.loads(
        (files("detectors.mc_gassl") / "data" / _META.replace(".safetensors", ".json")).read_text(encoding="utf-8")
    )
    return record


def _checked(path: str, data: bytes, record: str) -> GruParameters:
    try:
        expected = json.loads(record)["sha256"]
    except (ValueError, KeyError, TypeError):
        raise InvalidArgument(f"path must have a JSON with a sha256 beside it, got {shown(path)} without.") from None
    found = sha256(data).hexdigest()
    if found != expected:
        raise InvalidArgument(
            f"path must hold the weights that its JSON names (sha256 {shown(expected)}), "
            f"got {shown(path)} with the sha256 {found!r}."
        )
    return parameters_of(path, data)


def parameters_of(path: str, data: bytes) -> GruParameters:
    """W from the bytes of a safetensors file with the arrays :data:`NAMES`, and maybe others.

    Raises:
        InvalidArgument: the bytes are none, or hold other arrays; ``path`` is named.
    """
    try:
        arrays = load(data)
    except SafetensorError as error:
        raise InvalidArgument(f"path must be a safetensors file, got {shown(path)}: {error}.") from None
    if any(name not in arrays for name in NAMES):
        raise InvalidArgument(f"path must hold the arrays {', '.join(NAMES)}, got {shown(path)} with {sorted(arrays)}.")
    parameters = GruParameters(*(arrays[name] for name in NAMES))
    if any(value.dtype != torch.float32 or not bool(value.isfinite().all()) for value in parameters.tensors()):
        raise InvalidArgument(f"path must hold finite float32 arrays, got others in {shown(path)}.")
    return parameters
