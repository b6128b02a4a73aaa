"""Weights of the GRU network on disk, in the form of :mod:`detectors.weights`."""

from __future__ import annotations

import os
from collections.abc import Mapping

import torch
from torch import Tensor

from detectors.mc_gassl.gru import GruParameters
from detectors.weights import packaged_arrays, read_arrays
from usnet_env.config import ArgumentError, quote

#: the arrays of a file
NAMES = ("reset", "update", "candidate")


def load_weights(path: str | os.PathLike[str]) -> GruParameters:
    """The weights in a file that :func:`detectors.mc_gassl.train.train_meta` wrote.

    Raises:
        ArgumentError: a file is missing or broken, or the weights are not those that the JSON names.
    """
    return parameters_of(str(path), read_arrays(path))


def load_meta_weights() -> GruParameters:
    """The meta-trained weights that this package ships, made by :func:`detectors.mc_gassl.train.train_meta`."""
    return parameters_of("meta", packaged_arrays("detectors.mc_gassl", "meta"))


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
