"""From a window to what the network takes."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from detectors.learned.features import pair_features
from usnet_env.window import Window

__all__ = ["Inputs", "make_inputs"]


class Inputs(NamedTuple):
    """Arguments of :class:`detectors.learned.network.HeadNetwork` for n UAVs.

    Args:
        features: ``(n, n, PAIR_FEATURES)``.
        context: ``(3,)``: log n, log T_ob and the share of missing samples, each of order 1.
    """

    features: Tensor
    context: Tensor


def make_inputs(window: Window, living: NDArray[np.intp]) -> Inputs:
    """What the network sees of the ``living`` UAVs ``(n,)`` of a window."""
    missing = 1.0 - float(window.velocity_seen[:, living].mean()) if len(living) else 0.0
    context = [math.log(max(len(living), 1) / 50.0), math.log(window.observation_steps / 100.0), missing]
    return Inputs(torch.from_numpy(pair_features(window, living)), torch.tensor(context))
