"""Re-clustering by the trained IFSN, §IV-A-6: the dataset for the on-line training of the GRU network."""

from __future__ import annotations

import numpy as np

from detectors.gassl.ifsn import pair_losses, standardise
from detectors.gassl.training import Inputs
from detectors.series.votes import select_top
from usnet_env.arrays import Floats, Indices, Singles


def best_heads(inputs: Inputs, gamma: Singles) -> Indices:
    """i_H of every UAV, ``(n,)``: the other UAV from which the trained IFSN, Γ, predicts it best, equation (37)."""
    own, source = inputs.own.copy(), inputs.history.copy()
    for i in range(inputs.uavs):
        standardise(own[i])
        standardise(source[i])
    loss = pair_losses(gamma, own, source, inputs.target, inputs.weight)
    np.fill_diagonal(loss, np.inf)
    return np.asarray(np.nan_to_num(loss, nan=np.inf).argmin(axis=1).astype(np.int64))


def count_scores(chosen: Indices) -> Floats:
    """c_{i'} of every UAV, ``(n,)``: how many UAVs have i' as their i_H, equation (38)."""
    return np.bincount(chosen, minlength=len(chosen)).astype(np.float64)


def recluster(chosen: Indices, count: int, rng: np.random.Generator) -> Indices:
    """The clusters of the dataset D_r, ``(n,)``: the M̂ UAVs with the highest scores, each with the UAVs that chose it.

    ``chosen`` is i_H, ``count`` M̂, and ``rng`` breaks ties. Labels begin at 0; UAVs of no cluster have -1.
    """
    score = count_scores(chosen)
    heads = select_top(score, count, rng)
    labels = np.full(len(chosen), -1, np.int64)
    for label, head in enumerate(heads):
        labels[chosen == head] = label
    labels[heads] = np.arange(len(heads))
    return labels
