"""The network: attention of every UAV over all others, from pair statistics to heads; equivariant under permutation."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, NamedTuple

import torch
from pydantic import Field
from torch import Tensor, nn

from detectors.learned.features import PAIR_FEATURES
from usnet_env.config import ArgumentError, Config, quote

__all__ = ["Answer", "HeadNetwork", "NetworkSizes", "build_network", "draw_network"]

_CONTEXT = 3  # what every pair is told about the window: log n, log T_ob, share of missing samples


class NetworkSizes(Config):
    """Sizes of a :class:`HeadNetwork`.

    Args:
        width: numbers of a pair and of a UAV.
        heads: of attention.
        blocks: rounds of exchange between pairs and UAVs.
    """

    width: Annotated[int, Field(ge=4, le=512)] = 32
    heads: Annotated[int, Field(ge=1, le=32)] = 4
    blocks: Annotated[int, Field(ge=1, le=16)] = 3


class Answer(NamedTuple):
    """What the network says of n UAVs.

    Args:
        head: ``(n,)`` logits of being a head.
        leader: ``(n, n)`` logits; row i: whom UAV i follows, itself meaning nobody.
    """

    head: Tensor
    leader: Tensor


class _Block(nn.Module):
    """One exchange: every UAV attends to the others, is told who attends to it, and its pairs are told in turn."""

    def __init__(self, sizes: NetworkSizes) -> None:
        super().__init__()
        width, heads = sizes.width, sizes.heads
        self.pair_norm = nn.LayerNorm(width)
        self.attention = nn.Linear(width, heads)
        self.value = nn.Linear(width, width)
        self.uav = nn.Sequential(nn.Linear(4 * width, 2 * width), nn.GELU(), nn.Linear(2 * width, width))
        self.uav_norm = nn.LayerNorm(width)
        self.forth = nn.Linear(width, width)
        self.back = nn.Linear(width, width, bias=False)
        self.row = nn.Linear(width, width, bias=False)
        self.column = nn.Linear(width, width, bias=False)
        self.out = nn.Linear(width, width)

    def forward(self, pair: Tensor, uav: Tensor) -> tuple[Tensor, Tensor]:
        """``pair`` ``(n, n, w)`` and ``uav`` ``(n, w)``, both moved on."""
        n, width = uav.shape
        normed = self.pair_norm(pair)
        attention = torch.softmax(self.attention(normed), dim=1)
        value = self.value(normed).reshape(n, n, attention.shape[2], -1)
        given = attention[..., None] * value
        chosen = given.sum(dim=1).reshape(n, width)
        received = given.sum(dim=0).reshape(n, width)  # grows with the followers: its logarithm enters
        received = torch.sign(received) * torch.log1p(received.abs())
        whole = uav.mean(dim=0, keepdim=True).expand(n, width)
        uav = uav + self.uav(torch.cat([self.uav_norm(uav), chosen, received, whole], dim=1))
        known = self.uav_norm(uav)
        told = self.row(known)[:, None] + self.column(known)[None]
        mixed = self.forth(normed) + self.back(normed).transpose(0, 1) + told
        return pair + self.out(nn.functional.gelu(mixed)), uav


class HeadNetwork(nn.Module):
    """Pair statistics in, head and leader logits out, for any number of UAVs.

    Pairs (i, j) carry vectors, UAVs carry vectors. In each block UAV i attends to all j by what pair (i, j) knows; j
    sums up who attends to it, i whom it attends to; and pair (i, j) is told of pair (j, i), of i and of j. All weights
    are shared by all UAVs, so that numbering the UAVs otherwise only numbers the answer otherwise.

    Args:
        sizes: width, heads and blocks.
    """

    def __init__(self, sizes: NetworkSizes) -> None:
        super().__init__()
        if sizes.width % sizes.heads:
            raise ArgumentError(f"heads must divide width ({sizes.width}), got {sizes.heads}.")
        width = sizes.width
        self.sizes = sizes
        self.forth = nn.Linear(PAIR_FEATURES, width)
        self.back = nn.Linear(PAIR_FEATURES, width, bias=False)
        self.itself = nn.Parameter(torch.zeros(width))
        self.context = nn.Linear(_CONTEXT, width, bias=False)
        self.enter = nn.Linear(width, width)
        self.blocks = nn.ModuleList(_Block(sizes) for _ in range(sizes.blocks))
        self.leader = nn.Sequential(nn.LayerNorm(width), nn.Linear(width, 1))
        self.head = nn.Sequential(nn.LayerNorm(width), nn.Linear(width, width), nn.GELU(), nn.Linear(width, 1))

    def forward(self, features: Tensor, context: Tensor) -> Answer:
        """The answer for n UAVs.

        Args:
            features: ``(n, n, PAIR_FEATURES)`` of :func:`detectors.learned.features.pair_features`.
            context: ``(3,)``: log n, log T_ob and the share of missing samples.
        """
        n = len(features)
        diagonal = torch.eye(n)[..., None] * self.itself
        pair = self.forth(features) + self.back(features).transpose(0, 1) + diagonal + self.context(context)
        pair = self.enter(nn.functional.gelu(pair))
        uav = pair.new_zeros(n, self.sizes.width)
        for block in self.blocks:
            pair, uav = block(pair, uav)
        return Answer(self.head(uav)[:, 0], self.leader(pair)[..., 0])


def draw_network(sizes: NetworkSizes, seed: int) -> HeadNetwork:
    """A network with random weights; the global generator is left as it was."""
    with torch.random.fork_rng(devices=[]):
        torch.random.set_rng_state(torch.Generator().manual_seed(seed).get_state())
        return HeadNetwork(sizes)


def build_network(path: str, arrays: Mapping[str, Tensor]) -> HeadNetwork:
    """The network with these weights, whose sizes follow from their shapes.

    Raises:
        ArgumentError: the arrays are not those of a network, or not finite; ``path`` is named.
    """
    try:
        width, heads = len(arrays["itself"]), len(arrays["blocks.0.attention.weight"])
        blocks = sum(name.endswith(".attention.weight") for name in arrays)
        network = draw_network(NetworkSizes(width=width, heads=heads, blocks=blocks), 0)
        network.load_state_dict(dict(arrays))
    except (KeyError, TypeError, RuntimeError, ArgumentError):
        raise ArgumentError(
            f"path must hold the arrays of a head network, got {quote(path)} with {quote(sorted(arrays))}."
        ) from None
    if any(not bool(value.isfinite().all()) for value in arrays.values()):
        raise ArgumentError(f"path must hold finite arrays, got others in {quote(path)}.")
    return network.eval()
