"""A window as the GRU network reads it, and the network's features as clusterers take them."""

from __future__ import annotations

from typing import Literal

import numpy as np
import torch
from numpy.lib.stride_tricks import sliding_window_view

from detectors.mc_gassl.gru import ARENA_SCALE, GruInputs, GruParameters, Scale, embed
from detectors.series.gaps import fill_gaps
from usnet_env.arrays import Floats
from usnet_env.window import Window

#: features of the newest T_0 samples (the paper's), their mean over all times, or one for every time
Mode = Literal["single", "mean", "series"]


def inputs_of(window: Window, memory: int = 4) -> GruInputs:
    """What the GRU network reads of all N UAVs at all R = T_ob - T_0 + 1 times of a window, float32.

    What was not seen is filled in (:func:`detectors.series.gaps.fill_gaps`). Destroyed UAVs are 0 and never seen. Of a
    window shorter than ``memory``, T_0, all samples that there are make one time.
    """
    steps = window.observation_steps
    memory = min(memory, steps)
    whole, alive = fill_gaps(window), window.alive[:, None]
    position = whole.position[: steps - memory + 1] * alive
    velocity = sliding_window_view(whole.velocity * alive, memory, axis=0).swapaxes(2, 3)
    seen = sliding_window_view(window.velocity_seen, memory, axis=0).all(axis=-1)
    return GruInputs(*(torch.from_numpy(np.array(values)) for values in (position, velocity, seen)))


def gru_features(
    window: Window, parameters: GruParameters, mode: Mode = "single", memory: int = 4, scale: Scale = ARENA_SCALE
) -> Floats:
    """The GRU network's features of all N UAVs; destroyed UAVs are 0.

    As ``features=`` of a clusterer: ``functools.partial(gru_features, parameters=parameters, mode="series")``.

    Args:
        window: what the observer saw.
        parameters: W, see :func:`detectors.mc_gassl.gru.load_meta_weights`.
        mode: ``"single"``, the paper's e_{i,t} of the last T_0 samples; ``"mean"``, the mean of e_{i,t} over the times
            at which the UAV was seen throughout (over all, if there are none); ``"series"``, e_{i,t} at all times.
        memory: T_0.
        scale: metres by which positions are divided; the one that the parameters were trained with.

    Returns:
        ``(N, w)``, or ``(N, T_ob - T_0 + 1, w)`` for ``"series"``.
    """
    inputs = inputs_of(window, memory)
    if mode == "single":
        inputs = inputs.at(torch.tensor([inputs.times - 1]))
    with torch.no_grad():
        embedding = embed(parameters, inputs, scale).double()
    if mode == "mean":
        seen = inputs.seen | ~inputs.seen.any(dim=0)
        embedding = (embedding * seen[..., None]).sum(dim=0, keepdim=True) / seen.sum(dim=0)[:, None]
    values: Floats = embedding.numpy().swapaxes(0, 1).copy()
    values[~window.alive] = 0.0
    return values if mode == "series" else values[:, 0]
