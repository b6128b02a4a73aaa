"""A small network that reads raw windows and learns by trial and error who leads."""

from __future__ import annotations

import torch
from torch import Tensor, nn


class PairNetwork(nn.Module):
    """Compares each UAV with each other one, lets each choose whom it follows, and judges each by who follows it.

    Two banks of filters over the last steps of a track make 2 x ``filters`` courses of each UAV. The mean products of
    the courses of two UAVs are what is known about the pair. Neither the order of the UAVs matters, nor the orientation
    of space, and their number may change.

    Args:
        filters: filters of each bank.
        lags: steps of a filter.
        width: hidden units.
        named: so many UAVs are named at the start, on average.
    """

    def __init__(self, filters: int = 8, lags: int = 6, width: int = 24, named: int = 1) -> None:
        super().__init__()
        self.lags, self.named = lags, named
        self.banks = nn.Parameter(torch.randn(2, lags, filters) / lags**0.5)
        self.compare = nn.Sequential(nn.Linear(2 * filters, width), nn.Tanh(), nn.Linear(width, 2))
        self.judge = nn.Sequential(nn.Linear(2, width), nn.Tanh(), nn.Linear(width, 2))
        for part in self.judge[-1].parameters():  # otherwise the number that is named at the start is left to chance
            nn.init.zeros_(part)

    def forward(self, velocity: Tensor, alive: Tensor) -> tuple[Tensor, Tensor]:
        """``(B, N)`` logits of being a candidate, and ``(B,)`` values.

        Args:
            velocity: ``(B, T_ob, N, 3)``, T_ob at least ``lags``.
            alive: ``(B, N)``; the logit of a destroyed UAV is -1000.
        """
        past = velocity.unfold(1, self.lags, 1)  # (B, T', N, 3, lags)
        first, second = (torch.einsum("btncl,lk->btnck", past, bank) for bank in self.banks)
        products = torch.einsum("btick,btjck->bijk", first, second) / past.shape[1]
        features = torch.cat([products, products.transpose(1, 2)], dim=-1)
        living, uavs = alive > 0, alive.shape[1]
        is_barred = torch.eye(uavs, dtype=torch.bool, device=alive.device) | ~living[:, None]
        choice = self.compare(4.0 * features).masked_fill(is_barred[..., None], -1e3).softmax(dim=2)
        followers = (choice * living[:, :, None, None]).sum(dim=1)  # (B, N, 2)
        share = followers / living.sum(dim=1).clamp(min=2)[:, None, None]
        outputs = self.judge(4.0 * share)
        return finish_outputs(4.0 * outputs[..., 0], outputs[..., 1], living, self.named)


def finish_outputs(scores: Tensor, values: Tensor, living: Tensor, named: int = 1) -> tuple[Tensor, Tensor]:
    """The logits ``(B, N)`` and the values ``(B,)`` that a network returns, from what it finds about each UAV.

    At the start about ``named`` UAVs are named, since an agent that names none, or all, learns little.
    """
    count = living.sum(dim=1)
    logits = scores - torch.log(count.clamp(min=2 * named) / named - 1.0)[:, None]
    return logits.masked_fill(~living, -1e3), (values * living).sum(dim=1) / count.clamp(min=1)
