"""Weights of the GRU network on disk, in the form of :mod:`detectors.weights`."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from detectors.mc_gassl.gru import GruParameters
from detectors.weights import packaged_arrays, packaged_record, read_arrays, write_weights
from usnet_env.config import ArgumentError, quote

#: the arrays of a file, in the order of :meth:`GruParameters.tensors`
NAMES = ("reset", "update", "candidate")

_META = ("detectors.mc_gassl", "meta")


def save_weights(
    path: str | os.PathLike[str], parameters: GruParameters, training: Mapping[str, Any], metrics: Mapping[str, Any]
) -> Path:
    """Write W, and ``path`` with the suffix ``.json`` beside it, see :func:`detectors.weights.write_weights`.

    Raises:
        ArgumentError: the path has another suffix than ``.safetensors`` or can't be written to.
    """
    return write_weights(path, dict(zip(NAMES, parameters.tensors(), strict=True)), training, metrics)


def load_weights(path: str | os.PathLike[str]) -> GruParameters:
    """The weights in a file that :func:`save_weights` wrote.

    Raises:
        ArgumentError: a file is missing or broken, or the weights are not those that the JSON names.
    """
    return parameters_of(str(path), read_arrays(path))


def load_meta_weights() -> GruParameters:
    """The meta-trained weights that this package ships, made by :func:`detectors.mc_gassl.train.train_meta`."""
    return parameters_of("meta", packaged_arrays(*_META))


def meta_record() -> dict[str, Any]:
    """How the shipped weights were trained, and how well: ``sha256``, ``training``, ``metrics``."""
    return packaged_record(*_META)


def parameters_of(path: str, arrays: Mapping[str, Tensor]) -> GruParameters:
    """W from the arrays :data:`NAMES` of a file, which may hold others.

    Raises:
        ArgumentError: the arrays are not those of a GRU network; ``path`` is named.
    """
    if any(name not in arrays for name in NAMES):
        raise ArgumentError(f"path must hold the arrays {', '.join(NAMES)}, got {quote(path)} with {sorted(arrays)}.")
    parameters = GruParameters(*(arrays[name] for name in NAMES))
    if any(value.dtype != torch.float32 or not bool(value.isfinite().all()) for value in parameters.tensors()):
        raise ArgumentError(f"path must hold finite float32 arrays, got others in {quote(path)}.")
    return parameters
