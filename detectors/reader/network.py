"""The network of the reader: attention over pairs of UAVs, for training on any device; equivariant under permutation.

Each UAV and each ordered pair (i, j) has a vector. In a block, UAV i attends to UAVs j by the vectors of its pairs, and
gathers what it looks at, what looks at it, and the states of those it looks at; then each pair is updated from itself,
from its reverse and from both of its UAVs. :mod:`detectors.reader.forward` computes the same without torch.
"""

from __future__ import annotations

from typing import Annotated

import torch
from pydantic import Field
from torch import Tensor, nn
from torch.nn.functional import gelu, layer_norm

from detectors.reader.features import CONTEXT_FEATURES, PAIR_FEATURES, UAV_FEATURES
from detectors.reader.forward import LARGEST, ROW_NOISE, Answer
from usnet_env.config import ArgumentError, Config


class NetworkSizes(Config):
    """Sizes of a :class:`ReaderNetwork`."""

    width: Annotated[int, Field(ge=4, le=512)] = 32  #: length of the vector of a pair and of a UAV
    attn_heads: Annotated[int, Field(ge=1, le=32)] = 4  #: must divide ``width``
    blocks: Annotated[int, Field(ge=1, le=16)] = 3


def _stack_layers(inputs: int, hidden: int, outputs: int) -> nn.Sequential:
    return nn.Sequential(nn.Linear(inputs, hidden), nn.GELU("tanh"), nn.Linear(hidden, outputs))


class _Block(nn.Module):
    """One update of the vectors of UAVs and of pairs."""

    def __init__(self, sizes: NetworkSizes) -> None:
        super().__init__()
        width = sizes.width
        self.attention = nn.Linear(width, sizes.attn_heads, bias=False)
        self.gathered = nn.Linear(2 * width, width, bias=False)  # chosen and received, each head to its own values
        self.uav = _stack_layers(5 * width + sizes.attn_heads, 2 * width, width)
        self.mix = nn.Linear(2 * width, width)  # of a pair and its reverse
        self.ends = nn.Linear(width, 2 * width, bias=False)
        self.out = nn.Linear(width, width, bias=False)

    def forward(self, pair: Tensor, uav: Tensor) -> tuple[Tensor, Tensor]:
        """Return the updated ``pair`` ``(B, n, n, w)`` and ``uav`` ``(B, n, w)``."""
        (batch, n, width), heads = uav.shape, len(self.attention.weight)
        normed, state = layer_norm(pair, (width,)), layer_norm(uav, (width,))
        transposed = normed.transpose(1, 2).contiguous()
        attention = torch.softmax(torch.matmul(self.attention.weight, normed.transpose(2, 3)), dim=3)  # (B, i, h, j)
        attention_to = attention.permute(0, 3, 2, 1).contiguous()  # (B, j, heads, i)
        gathered = torch.matmul(attention, normed), torch.matmul(attention_to, transposed)  # (B, n, heads, w)
        head_inputs = zip(gathered, self.gathered.weight.view(heads, -1, 2, width).unbind(dim=2), strict=True)
        chosen, received = (torch.einsum("bihc,hdc->bihd", *each).flatten(2) for each in head_inputs)
        received = torch.sign(received) * torch.log1p(received.abs())  # it grows with the number of followers
        attended = torch.einsum("bihj,bjhd->bihd", attention, state.view(batch, n, heads, -1)).flatten(2)
        mean_state = uav.mean(dim=1, keepdim=True).expand(batch, n, width)
        inputs = [state, chosen, received, attended, mean_state, torch.log1p(attention_to.sum(dim=3))]
        uav = uav + self.uav(torch.cat(inputs, dim=2))
        row, column = self.ends(layer_norm(uav, (width,))).chunk(2, dim=2)
        ends = (row + self.mix.bias)[:, :, None] + column[:, None]
        direct, reverse = self.mix.weight.chunk(2, dim=1)
        mixed = torch.addmm(ends.view(-1, width), normed.view(-1, width), direct.t())
        mixed = gelu(torch.addmm(mixed, transposed.view(-1, width), reverse.t()), approximate="tanh")
        return torch.addmm(pair.view(-1, width), mixed, self.out.weight.t()).view_as(pair), uav


class ReaderNetwork(nn.Module):
    """Answers for windows from their features, for any number of UAVs.

    Args:
        sizes: width, heads of attention and blocks.
        features: numbers of features of a pair, a UAV and a window.
    """

    def __init__(
        self, sizes: NetworkSizes, features: tuple[int, int, int] = (PAIR_FEATURES, UAV_FEATURES, CONTEXT_FEATURES)
    ) -> None:
        super().__init__()
        if sizes.width % sizes.attn_heads:
            raise ArgumentError(f"attn_heads must divide width ({sizes.width}), got {sizes.attn_heads}.")
        width, (pairs, uavs, contexts) = sizes.width, features
        for name, count in zip(("pair", "uav", "context"), features, strict=True):
            self.register_buffer(f"{name}_mean", torch.zeros(count))
            self.register_buffer(f"{name}_scale", torch.ones(count))
        self.enter = nn.Linear(pairs, 2 * width, bias=False)  # of a pair, and of its reverse
        self.enter_uav = _stack_layers(uavs + contexts, 2 * width, width)
        self.ends = nn.Linear(width, 2 * width, bias=False)
        self.context = nn.Linear(contexts, width)
        self.itself = nn.Parameter(torch.zeros(width))
        self.rows = nn.Linear(2 * width, width)  # of a pair, and of the pair relative to its row
        self.blocks = nn.ModuleList(_Block(sizes) for _ in range(sizes.blocks))
        self.links = nn.Linear(width, 3)  # leader, root and link
        self.head = _stack_layers(width, width, 2)  # head and delay
        self.silent = _stack_layers(2 * width, width, 1)

    def _standardise(self, name: str, values: Tensor) -> Tensor:
        mean, scale = self.get_buffer(f"{name}_mean"), self.get_buffer(f"{name}_scale")
        return torch.addcmul(-mean * scale, values, scale).clamp_(-float(LARGEST), float(LARGEST))

    def forward(self, pair: Tensor, uav: Tensor, context: Tensor) -> Answer[Tensor]:
        """Answer for features ``pair`` ``(B, n, n, F)``, ``uav`` ``(B, n, G)`` and ``context`` ``(B, K)``."""
        n, width = uav.shape[1], len(self.itself)
        context = self._standardise("context", context)
        state = self.enter_uav(torch.cat([self._standardise("uav", uav), context[:, None].expand(-1, n, -1)], dim=2))
        pair = self._enter_pairs(self._standardise("pair", pair), state, self.context(context))
        for block in self.blocks:
            pair, state = block(pair, state)
        leader, root, link = self.links(layer_norm(pair, (width,))).unbind(dim=3)
        state = layer_norm(state, (width,))
        head, delay = self.head(state).unbind(dim=2)
        no_leader = self.silent(torch.cat([state.mean(dim=1), state.amax(dim=1)], dim=1))
        return Answer(head, leader, root, link, no_leader[:, 0], delay)

    def _enter_pairs(self, pair: Tensor, state: Tensor, context: Tensor) -> Tensor:
        """The first vectors of pairs ``(B, n, n, w)``: also relative to the other pairs of their row."""
        batch, n, width = state.shape
        direct, reverse = self.enter(pair).chunk(2, dim=3)
        row, column = self.ends(state).chunk(2, dim=2)
        sums = direct + reverse.transpose(1, 2) + (row + context[:, None])[:, :, None] + column[:, None]
        entered = gelu(sums + torch.eye(n, device=pair.device)[..., None] * self.itself, approximate="tanh")
        relative = entered - entered.mean(dim=2, keepdim=True)
        relative = relative * torch.rsqrt(relative.square().mean(dim=2, keepdim=True) + float(ROW_NOISE))
        absolute, relative_weight = self.rows.weight.chunk(2, dim=1)
        absolute_part = torch.addmm(self.rows.bias, entered.view(-1, width), absolute.t())
        return torch.addmm(absolute_part, relative.view(-1, width), relative_weight.t()).view(batch, n, n, width)


def draw_network(sizes: NetworkSizes, seed: int) -> ReaderNetwork:
    """Make a network with random weights; the global generator stays unchanged."""
    with torch.random.fork_rng(devices=[]):
        torch.random.set_rng_state(torch.Generator().manual_seed(seed).get_state())
        return ReaderNetwork(sizes)
