"""From attention to candidates: the head that every UAV chooses, the probabilities c_i, and the top K."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["RULES", "choose_heads", "count_votes", "select_top"]

Floats = NDArray[np.float64]

#: Vote rules by name; see :func:`count_votes`.
RULES = ("paper", "exclude-self")


def choose_heads(attention: Floats, exclude_self: bool, rng: np.random.Generator) -> NDArray[np.int64]:
    """i_L^{(i)} of every UAV, ``(n,)``: the UAV that it attends to most, equation (19).

    Args:
        attention: ``(n, n)`` alpha_{i,i'}.
        exclude_self: whether a UAV may not choose itself.
        rng: breaks ties, so that they don't favour low indices.
    """
    weight = attention.copy()
    if exclude_self:
        np.fill_diagonal(weight, -np.inf)
    ties = weight == weight.max(axis=1, keepdims=True)
    return np.where(ties, rng.random(weight.shape), -1.0).argmax(axis=1).astype(np.int64)


def count_votes(chosen: NDArray[np.int64]) -> Floats:
    """c_i = (1/n) sum_{i' != i} 1{i_L^{(i')} = i} of every UAV, ``(n,)``, equation (20).

    Args:
        chosen: ``(n,)`` from :func:`choose_heads`. A UAV that chose itself counts for no UAV.
    """
    uavs = len(chosen)
    others = chosen[chosen != np.arange(uavs)]
    return np.asarray(np.bincount(others, minlength=uavs) / uavs)


def select_top(scores: Floats, count: int, rng: np.random.Generator) -> NDArray[np.intp]:
    """Indices of the ``count`` highest scores, ties broken at random; equations (21), (22)."""
    return np.lexsort((rng.random(len(scores)), -scores))[:count]
