"""The GRU network of §IV-A: T_0 cells of equations (26) to (29), which are not ``torch.nn.GRU``'s.

The cell has no biases, the reset gate acts before W_h, and the first hidden state is the UAV's position, not zero
(decision (g)). Equation numbers are those of the paper's LaTeX source.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray
from torch import Tensor

from detectors.series.gaps import fill_gaps
from detectors.weights import read_packaged_arrays
from usnet_env.arrays import Floats
from usnet_env.window import Window

_ARENA = (1000.0, 1000.0, 100.0)  # metres, the paper's; positions are divided by it, since they saturate the gates


class GruParameters(NamedTuple):
    """W = {W_r, W_u, W_h}, shared by all cells and all UAVs."""

    reset: Tensor  #: W_r ``(3, 6)``, for [h; v]
    update: Tensor  #: W_u ``(3, 6)``, for [h; v]
    candidate: Tensor  #: W_h ``(3, 6)``, for [v; g_r * h]

    def trainable(self) -> GruParameters:
        """A copy cut off from any earlier computation, in which gradients flow."""
        return GruParameters(*(tensor.detach().clone().requires_grad_(True) for tensor in self))


class GruInputs(NamedTuple):
    """What the GRU network reads of n UAVs at R times t."""

    position: Tensor  #: ``(R, n, 3)`` metres, p_{i,t-T_0+1}, where the first of the velocities starts
    velocity: Tensor  #: ``(R, n, T_0, 3)`` metres per step, oldest first
    seen: Tensor  #: ``(R, n)`` bool, all of the T_0 velocities were seen. What was not seen is filled in

    def at(self, times: Tensor) -> GruInputs:
        """The inputs of some times, ``(r,)`` indices."""
        return GruInputs(*(part[times] for part in self))


def draw_parameters(generator: torch.Generator) -> GruParameters:
    """A random start: uniform in ±1/sqrt(6), float32."""
    return GruParameters(*((2.0 * torch.rand((3, 6), generator=generator) - 1.0) / 6**0.5 for _ in range(3)))


def run_gru(parameters: GruParameters, position: Tensor, velocity: Tensor) -> Tensor:
    """Equations (26) to (29), T_0 times over: e = h_{T_0}, ``(..., 3)``, of any number of UAVs and times at once.

    ``position`` ``(..., 3)`` in metres gives h_0; ``velocity`` is ``(..., T_0, 3)``, metres per step, oldest first.
    """
    h = position / position.new_tensor(_ARENA)
    from_h = torch.cat([parameters.reset[:, :3], parameters.update[:, :3]]).T
    from_reset_h = parameters.candidate[:, 3:].T
    from_v = torch.cat([parameters.reset[:, 3:], parameters.update[:, 3:], parameters.candidate[:, :3]]).T
    for velocity_part in (velocity @ from_v).unbind(-2):
        gates = torch.sigmoid(h @ from_h + velocity_part[..., :6])
        g_r, g_u = gates[..., :3], gates[..., 3:]
        proposal = torch.tanh(velocity_part[..., 6:] + (g_r * h) @ from_reset_h)
        h = (1.0 - g_u) * h + g_u * proposal
    return h


def load_meta_weights() -> GruParameters:
    """The meta-trained weights that this package ships, made by :func:`detectors.mc_gassl.train.train_meta`."""
    return read_parameters(read_packaged_arrays("detectors.mc_gassl", "meta"))


def read_parameters(arrays: Mapping[str, NDArray[Any]]) -> GruParameters:
    """W among the arrays of a weights file or a checkpoint."""
    return GruParameters(*(torch.from_numpy(arrays[name]) for name in GruParameters._fields))


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
