"""IFSN, the inherent follow strategy network of §III-A: one MLP Γ for all UAVs of a window."""

from __future__ import annotations

from itertools import pairwise

import torch
from torch import Tensor

__all__ = ["Ifsn"]


class Ifsn:
    """Γ of E windows: inputs -> hidden layers (three in the paper) with tanh -> v̂_{i,t+1}.

    Args:
        windows: E.
        inputs: length of the concatenation of P_{i,t}, V̂_{i,t} and p̂_{i,t-T_0+1}.
        hidden: widths of the hidden layers.
        generator: where the first values come from, uniform in ±1/sqrt(inputs of the layer).
    """

    def __init__(self, windows: int, inputs: int, hidden: tuple[int, ...], generator: torch.Generator) -> None:
        self.layers: list[tuple[Tensor, Tensor]] = []
        for before, after in pairwise((inputs, *hidden, 3)):
            shape = ((windows, before, after), (windows, 1, after))
            drawn = [
                ((2.0 * torch.rand(*size, generator=generator, device=generator.device) - 1.0) / before**0.5)
                for size in shape
            ]
            self.layers.append((drawn[0].requires_grad_(True), drawn[1].requires_grad_(True)))

    def parameters(self) -> list[Tensor]:
        """All of Γ."""
        return [parameter for layer in self.layers for parameter in layer]

    def __call__(self, inputs: Tensor) -> Tensor:
        """Predicted velocities ``(E, ..., 3)`` for inputs ``(E, ..., d)``."""
        flat = inputs.reshape(inputs.shape[0], -1, inputs.shape[-1])
        for index, (weight, bias) in enumerate(self.layers):
            flat = torch.baddbmm(bias, flat, weight)
            if index + 1 < len(self.layers):
                flat = torch.tanh(flat)
        return flat.view(*inputs.shape[:-1], 3)
