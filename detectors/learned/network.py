"""The network: computes heads from pair statistics by attention over UAVs; equivariant under permutation."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, NamedTuple

import torch
from pydantic import Field
from torch import Tensor, nn

from detectors.learned.features import PAIR_FEATURES
from usnet_env.config import ArgumentError, Config, quote

_CONTEXT = 3  # values that describe the window: log n, log T_ob, share of missing samples


class NetworkSizes(Config):
    """Sizes of a :class:`HeadNetwork`."""

    width: Annotated[int, Field(ge=4, le=512)] = 32  #: length of the vector of a pair and of a UAV
    attn_heads: Annotated[int, Field(ge=1, le=32)] = 4  #: must divide ``width``
    blocks: Annotated[int, Field(ge=1, le=16)] = 3  #: each of them updates UAVs and pairs


class Answer(NamedTuple):
    """Output of the network for n UAVs."""

    head: Tensor  #: ``(n,)`` logits of being a head
    leader: Tensor  #: ``(n, n)`` logits; entry (i, j): UAV i follows UAV j; entry (i, i): it follows no UAV


class _Block(nn.Module):
    """One update: each UAV attends to all UAVs and receives the attention of all; then the pairs are updated."""

    def __init__(self, sizes: NetworkSizes) -> None:
        super().__init__()
        width = sizes.width
        self.pair_norm = nn.LayerNorm(width)
        self.attention = nn.Linear(width, sizes.attn_heads)
        self.value = nn.Linear(width, width)
        self.uav = nn.Sequential(nn.Linear(4 * width, 2 * width), nn.GELU(), nn.Linear(2 * width, width))
        self.uav_norm = nn.LayerNorm(width)
        self.forth = nn.Linear(width, width)
        self.back = nn.Linear(width, width, bias=False)
        self.row = nn.Linear(width, width, bias=False)
        self.column = nn.Linear(width, width, bias=False)
        self.out = nn.Linear(width, width)

    def forward(self, pair: Tensor, uav: Tensor) -> tuple[Tensor, Tensor]:
        """Return the updated ``pair`` ``(n, n, w)`` and ``uav`` ``(n, w)``."""
        n, width = uav.shape
        normed = self.pair_norm(pair)
        attention = torch.softmax(self.attention(normed), dim=1)
        value = self.value(normed).reshape(n, n, attention.shape[2], -1)
        given = attention[..., None] * value
        chosen = given.sum(dim=1).reshape(n, width)
        received = given.sum(dim=0).reshape(n, width)  # grows with the number of followers, hence the logarithm
        received = torch.sign(received) * torch.log1p(received.abs())
        whole = uav.mean(dim=0, keepdim=True).expand(n, width)
        uav = uav + self.uav(torch.cat([self.uav_norm(uav), chosen, received, whole], dim=1))
        known = self.uav_norm(uav)
        update = self.row(known)[:, None] + self.column(known)[None]
        mixed = self.forth(normed) + self.back(normed).transpose(0, 1) + update
        return pair + self.out(nn.functional.gelu(mixed)), uav


class HeadNetwork(nn.Module):
    """Computes head and leader logits from pair statistics, for any number of UAVs.

    Each UAV and each pair (i, j) has a feature vector. In each block the vectors of the pairs (i, j) give UAV i's
    attention over all UAVs j. UAV i sums the values of the pairs (i, j), to which it attends, and of the pairs (j, i),
    which attend to it. Then the vector of pair (i, j) is updated from those of pair (j, i), UAV i and UAV j. All UAVs
    share all weights; so a permutation of the UAVs permutes the output.

    Args:
        sizes: width, number of attention heads and number of blocks.
    """

    def __init__(self, sizes: NetworkSizes) -> None:
        super().__init__()
        if sizes.width % sizes.attn_heads:
            raise ArgumentError(f"attn_heads must divide width ({sizes.width}), got {sizes.attn_heads}.")
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
        """Compute the logits for n UAVs from the inputs that :func:`detectors.learned.features.make_inputs` makes."""
        n = len(features)
        diagonal = torch.eye(n)[..., None] * self.itself
        pair = self.forth(features) + self.back(features).transpose(0, 1) + diagonal + self.context(context)
        pair = self.enter(nn.functional.gelu(pair))
        uav = pair.new_zeros(n, self.sizes.width)
        for block in self.blocks:
            pair, uav = block(pair, uav)
        return Answer(self.head(uav)[:, 0], self.leader(pair)[..., 0])


def draw_network(sizes: NetworkSizes, seed: int) -> HeadNetwork:
    """Make a network with random weights; the global generator stays unchanged."""
    with torch.random.fork_rng(devices=[]):
        torch.random.set_rng_state(torch.Generator().manual_seed(seed).get_state())
        return HeadNetwork(sizes)


def build_network(path: str, arrays: Mapping[str, Any]) -> HeadNetwork:
    """Build the network with these weights, if they are those of one; its sizes follow from their shapes."""
    try:
        width, attn_heads = len(arrays["itself"]), len(arrays["blocks.0.attention.weight"])
        blocks = sum(name.endswith(".attention.weight") for name in arrays)
        network = draw_network(NetworkSizes(width=width, attn_heads=attn_heads, blocks=blocks), 0)
        network.load_state_dict({name: torch.as_tensor(array) for name, array in arrays.items()})
    except (KeyError, TypeError, RuntimeError, ArgumentError) as error:
        raise ArgumentError(f"path must hold the arrays of a head network, got {quote(path)}: {error}.") from None
    return network.eval()
