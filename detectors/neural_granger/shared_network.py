"""One network for a whole swarm, and the leader of every UAV according to it.

All followers use the same follow strategy, so one network can learn it from all clusters together. Applied to all pairs
of UAVs, the network gives the UAV from whose past each UAV is predicted best, also across the borders of the clusters.
The idea is that of equations (37) and (38) of the paper; the network is a different one.
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
    compute_all_errors,
    compute_weighted_mean,
    find_untrained_times,
    split_times,
    train_on_pairs,
)


@dataclass(frozen=True)
class Following:
    """The leaders that the shared network finds, for one window of n UAVs.

    Args:
        leader: ``(n,)`` i_H, the source other than i from which UAV i is predicted best.
        gain: ``(n,)`` logarithm of the null model's error for UAV i, divided by the error of the prediction from i_H,
            on times that were not trained on.
    """

    leader: Tensor
    gain: Tensor

    def count_followers(self, threshold: float) -> Tensor:
        """Count, for each UAV ``(n,)``, the UAVs that have it as their leader and a gain of at least ``threshold``."""
        return torch.bincount(self.leader[self.gain >= threshold], minlength=len(self.leader))


def follow_by_shared_network(
    samples: Samples,
    head: Tensor,
    sources: Tensor,
    settings: PerCandidate,
    generator: torch.Generator,
    passes: int = 2,
) -> Following:
    """Train one network on all UAVs and their supposed heads, and find every UAV's leader with it.

    Args:
        samples: one window of n UAVs.
        head: ``(n,)`` index of each UAV's supposed head; the own index of a supposed head.
        sources: ``(s,)`` indices of the UAVs that can be leaders, at least two, including the supposed heads.
        settings: sizes and rates; ``voters`` UAVs are drawn in each step.
        generator: of all random numbers.
        passes: number of trainings; before each but the first, every follower is assigned to the supposed head from
            which the previous network predicts it best.
    """
    problem = Problem(samples, settings, centre=False)
    used, _ = split_times(samples.times, settings.blocks, samples.velocity.shape[3], head.device)
    rest = find_untrained_times(used, samples.times)
    heads, everyone = torch.unique(head), torch.arange(samples.uavs, device=head.device)
    for number in range(passes):
        network = AdditiveNetwork(1, problem.source.shape[2], settings.units, generator)
        followers = torch.nonzero((head != everyone) & (samples.weight[0].sum(-1) > 0))[:, 0]
        if len(followers):
            pairs = heads, followers, heads[:, None] == head
            train_on_pairs(problem, network, pairs, used, generator)
        if number < passes - 1 and len(heads) > 1:
            chosen = _find_best_source(problem, network, heads)
            head = torch.where(torch.isin(everyone, heads), head, chosen)
    leader = _find_best_source(problem, network, sources)
    return Following(leader, _compute_gain(problem, network, leader, rest))


@torch.no_grad()
def _find_best_source(problem: Problem, network: AdditiveNetwork, sources: Tensor) -> Tensor:
    """Find each UAV's source ``(n,)``, other than the UAV itself, with the least error over all times."""
    samples = problem.samples
    uavs, times = (torch.arange(count, device=sources.device) for count in (samples.uavs, samples.times))
    errors = compute_all_errors(problem, lambda columns: network.repeat(len(columns)), times, sources)[0]
    return sources[errors.masked_fill(uavs[:, None] == sources, torch.inf).argmin(1)]


@torch.no_grad()
def _compute_gain(problem: Problem, network: AdditiveNetwork, leader: Tensor, times: Tensor) -> Tensor:
    """Logarithm ``(n,)`` of the null model's error, divided by the error of the prediction from the leader."""
    samples, floor = problem.samples, problem.settings.floor
    weight = samples.weight[0][:, times]
    null = compute_weighted_mean(problem.null_error[0][:, times], weight)
    gain = torch.zeros_like(null)
    for column in torch.unique(leader):
        theirs = (leader == column).nonzero()[:, 0]
        errors = problem.compute_errors(network, column[None], theirs, times)[0, 0]
        gain[theirs] = torch.log((null[theirs] + floor) / (compute_weighted_mean(errors, weight[theirs]) + floor))
    alone = leader == torch.arange(len(leader), device=leader.device)  # the only source has no other UAV to choose
    return gain.masked_fill(alone | (samples.weight[0].sum(-1) == 0), 0.0)
