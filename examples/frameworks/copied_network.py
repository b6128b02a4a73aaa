"""A small network that computes :func:`how_copied.how_copied` itself: one logit per UAV, for raw windows."""

import torch
from torch import Tensor, nn
from torch.distributions import Bernoulli, Independent


class Bits(Independent):
    """The distribution of an action: N independent bits with one joint log-probability."""

    def __init__(self, logits: Tensor) -> None:
        super().__init__(Bernoulli(logits=logits), 1)


class CopiedNetwork(nn.Module):
    """A UAV that many others copy is a head. The share of the swarm that copies a UAV goes through a shared network.

    Permuting the UAVs permutes the logits. All tensors may have the same leading axes (a batch, agents).
    """

    def __init__(self, hidden: int = 16) -> None:
        super().__init__()
        self.judge = nn.Sequential(nn.Linear(1, hidden), nn.Tanh(), nn.Linear(hidden, 1))

    def forward(self, velocity: Tensor, alive: Tensor) -> Tensor:
        """``(…, N)`` logits of ``velocity`` ``(…, T_ob, N, 3)`` and ``alive`` ``(…, N)``; below -100 if destroyed."""
        return self.judge(copied_share(velocity, alive)[..., None])[..., 0] - 1e3 * (alive == 0)


def copied_share(velocity: Tensor, alive: Tensor) -> Tensor:
    """``(…, N)``: the share of the living UAVs that copy this UAV best, one step later."""
    agreement = torch.einsum("...tic,...tjc->...ij", velocity[..., 1:, :, :], velocity[..., :-1, :, :])
    agreement = agreement - 1e6 * (torch.eye(alive.shape[-1], device=alive.device) + (alive == 0)[..., None, :])
    copied = nn.functional.one_hot(agreement.argmax(dim=-1), alive.shape[-1])  # row i: the UAV that i copies
    votes = (copied * alive[..., None]).sum(dim=-2)
    return votes / alive.sum(dim=-1, keepdim=True).clamp(min=1)
