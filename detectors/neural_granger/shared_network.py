"""One network for a whole swarm, and the leader that it gives to every UAV.

All followers obey the same follow strategy, so one network learns it from all clusters together. Applied to every pair
of UAVs it then gives the UAV from which each UAV is predicted best, across the borders of the clusters that it was
trained with. The idea is that of equations (37) and (38) of the paper, with a network of its own.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from detectors.neural_granger.inputs import Samples
from detectors.neural_granger.per_candidate import (
    AdditiveNetwork,
    PerCandidate,
    Problem,
    held_out_times,
    other_times,
    weighted_mean,
)

__all__ = ["Following", "follow_by_shared_network"]

_CHUNK_ENTRIES = 4_000_000  # coordinates of predictions formed at once where no gradient is kept


@dataclass(frozen=True)
class Following:
    """The leaders that the shared network finds, for one window of n UAVs.

    Args:
        leader: ``(n,)`` i_H: the source other than itself from which UAV i is predicted best.
        gain: ``(n,)`` log ratio of the error of i's own history to that from i_H, on times that were not trained on.
    """

    leader: Tensor
    gain: Tensor

    def count_followers(self, threshold: float) -> Tensor:
        """``(n,)`` how many UAVs with a gain of at least ``threshold`` have UAV i' as their leader."""
        return torch.bincount(self.leader[self.gain >= threshold], minlength=len(self.leader))


def follow_by_shared_network(
    samples: Samples,
    head: Tensor,
    sources: Tensor,
    settings: PerCandidate,
    generator: torch.Generator,
    passes: int = 2,
) -> Following:
    """Train one network on all UAVs and their supposed heads, and let every UAV choose its leader by it.

    Args:
        samples: one window of n UAVs.
        head: ``(n,)`` index of each UAV's supposed head; a supposed head's own index.
        sources: ``(s,)`` indices of the UAVs that may be chosen, at least two; the supposed heads among them.
        settings: sizes and rates; ``voters`` UAVs are drawn in each step.
        generator: where all draws come from.
        passes: trainings; from the second on, each UAV's head is the one that it chose among the supposed heads.
    """
    problem = Problem(samples, settings, centre=False)
    used, _ = held_out_times(samples.times, settings.blocks, samples.velocity.shape[3], head.device)
    rest = other_times(used, samples.times)
    heads = torch.unique(head)
    for number in range(passes):
        network = AdditiveNetwork(1, problem.source.shape[2], settings.units, generator)
        _train(problem, network, head, heads, used, generator)
        if number < passes - 1 and len(heads) > 1:
            chosen = _best_source(problem, network, heads)
            head = torch.where(torch.isin(torch.arange(len(head), device=head.device), heads), head, chosen)
    leader = _best_source(problem, network, sources)
    return Following(leader, _gain(problem, network, leader, rest))


def _train(
    problem: Problem,
    network: AdditiveNetwork,
    head: Tensor,
    heads: Tensor,
    used: Tensor,
    generator: torch.Generator,
) -> None:
    """The network learns to predict every UAV from its head; errors count by their logarithm."""
    settings, samples = problem.settings, problem.samples
    everyone = torch.arange(samples.uavs, device=head.device)
    followers = everyone[(head != everyone) & (samples.weight[0].sum(-1) > 0)]
    if not len(followers):
        return
    optimiser = network.optimiser(settings)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, settings.steps)
    for _ in range(settings.steps):
        times = used[torch.randperm(len(used), generator=generator, device=head.device)[: settings.times]]
        draw = torch.randperm(len(followers), generator=generator, device=head.device)[: settings.voters]
        voters = followers[draw]
        errors = problem.errors(network.copies(len(heads)), heads, voters, times, generator)[0]
        weight = samples.weight[0, voters][:, times]
        mean = weighted_mean(errors, weight)
        theirs = (heads[:, None] == head[voters]) & (weight.sum(-1) > 0)
        loss = (torch.log(mean + settings.floor) * theirs).sum() / len(voters)
        optimiser.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]  # torch leaves it untyped
        optimiser.step()
        schedule.step()


@torch.no_grad()
def _best_source(problem: Problem, network: AdditiveNetwork, sources: Tensor) -> Tensor:
    """``(n,)`` the source, other than itself, with the least error over all times; in bounded memory."""
    samples = problem.samples
    uavs, times = samples.uavs, torch.arange(samples.times, device=sources.device)
    everyone = torch.arange(uavs, device=sources.device)
    step = max(1, _CHUNK_ENTRIES // max(1, uavs * samples.times * 3))
    lowest = torch.full((uavs,), torch.inf, device=sources.device)
    best = torch.full((uavs,), int(sources[0]), device=sources.device)
    for columns in torch.split(sources, step):
        errors = problem.errors(network.copies(len(columns)), columns, everyone, times)[0]
        mean = weighted_mean(errors, samples.weight[0]).masked_fill(columns[:, None] == everyone, torch.inf)
        least, which = mean.min(0)
        best = torch.where(least < lowest, columns[which], best)
        lowest = torch.minimum(least, lowest)
    return best


@torch.no_grad()
def _gain(problem: Problem, network: AdditiveNetwork, leader: Tensor, times: Tensor) -> Tensor:
    """``(n,)`` log ratio of the null's error to that from each UAV's leader."""
    samples, floor = problem.samples, problem.settings.floor
    weight = samples.weight[0][:, times]
    null = weighted_mean(problem.null_error[0][:, times], weight)
    gain = torch.zeros_like(null)
    for column in torch.unique(leader):
        theirs = (leader == column).nonzero()[:, 0]
        errors = problem.errors(network, column[None], theirs, times)[0, 0]
        gain[theirs] = torch.log((null[theirs] + floor) / (weighted_mean(errors, weight[theirs]) + floor))
    alone = leader == torch.arange(len(leader), device=leader.device)  # the only source has no other UAV to choose
    return gain.masked_fill(alone | (samples.weight[0].sum(-1) == 0), 0.0)
