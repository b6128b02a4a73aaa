"""A window as the GRU network reads it, and the network's features as clusterers take them."""

from __future__ import annotations

import numpy as np
import torch
from numpy.lib.stride_tricks import sliding_window_view

from detectors.mc_gassl.gru import GruInputs, GruParameters, run_gru
from detectors.series.gaps import fill_gaps
from usnet_env.arrays import Floats
from usnet_env.window import Window


def make_inputs(window: Window, memory: int = 4) -> GruInputs:
    """What the GRU network reads of all N UAVs at all R = T_ob - T_0 + 1 times of a window, float32.

    What was not seen is filled in. Destroyed UAVs are 0 and never seen. A window shorter than ``memory``, T_0, has one.
    """
    steps = window.observation_steps
    memory = min(memory, steps)
    filled, alive = fill_gaps(window), window.alive[:, None]
    position = filled.position[: steps - memory + 1] * alive
    velocity = sliding_window_view(filled.velocity * alive, memory, axis=0).swapaxes(2, 3)
    seen = sliding_window_view(window.velocity_seen, memory, axis=0).all(axis=-1)
    return GruInputs(*(torch.from_numpy(np.array(values)) for values in (position, velocity, seen)))


def compute_gru_features(window: Window, parameters: GruParameters, memory: int = 4) -> Floats:
    """The GRU network's features e_{i,t} of the last T_0 samples of all N UAVs, ``(N, 3)``; destroyed UAVs are 0.

    A clusterer takes ``functools.partial(compute_gru_features, parameters=parameters)``. ``memory`` is T_0.
    """
    inputs = make_inputs(window, memory)
    with torch.no_grad():
        values: Floats = run_gru(parameters, inputs.position[-1:], inputs.velocity[-1:])[0].double().numpy()
    values[~window.alive] = 0.0
    return values
