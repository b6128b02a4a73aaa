"""Converts a window to the inputs of the network."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from detectors.learned.features import pair_features
from usnet_env.window import Window


class Inputs(NamedTuple):
    """Inputs of :class:`detectors.learned.network.HeadNetwork` for n UAVs.

    Args:
        features: ``(n, n, PAIR_FEATURES)``, see :func:`detectors.learned.features.pair_features`.
        context: ``(3,)``: log(n / 50), log(T_ob / 100) and the share of missing samples.
    """

    features: Tensor
    context: Tensor


def make_inputs(window: Window, living: NDArray[np.intp]) -> Inputs:
    """Make the inputs for the UAVs with the indices ``living`` ``(n,)`` of a window."""
    missing = 1.0 - float(window.velocity_seen[:, living].mean()) if len(living) else 0.0
    context = [math.log(max(len(living), 1) / 50.0), math.log(window.observation_steps / 100.0), missing]
    return Inputs(torch.from_numpy(pair_features(window, living)), torch.tensor(context))
