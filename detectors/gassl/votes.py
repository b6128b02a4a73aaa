"""From attention to candidates: whom every UAV chooses, the probabilities c_i, and the top K."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["RULES", "choices", "probabilities", "top"]

Floats = NDArray[np.float64]

#: Vote rules by name; see :func:`probabilities`.
RULES = ("paper", "exclude-self", "occlusion", "mass")


def choices(attention: Floats, exclude_self: bool, rng: np.random.Generator) -> NDArray[np.int64]:
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


def probabilities(
    rule: str, attention: Floats, rise: Floats, choice: NDArray[np.int64], own: NDArray[np.int64]
) -> Floats:
    """c_i of every UAV, ``(n,)``.

    ``paper`` and ``exclude-self`` count choices, c_i = (1/n) sum_{i' != i} 1{i_L^{(i')} = i} (equation (20));
    ``mass`` sums attention in place of choices; ``occlusion`` sums the share of the rise in UAV i's loss that dropping
    a candidate causes, negative rises counting as none.

    Args:
        rule: one of :data:`RULES`.
        attention: ``(n, n)`` alpha_{i,i'}.
        rise: ``(n, n)``, for ``occlusion``.
        choice: ``(n,)`` with a UAV's own index allowed, for ``paper``.
        own: ``(n,)`` without, for ``exclude-self``.
    """
    uavs = len(attention)
    if rule in ("paper", "exclude-self"):
        chosen = choice if rule == "paper" else own
        votes = np.zeros((uavs, uavs))
        votes[np.arange(uavs), chosen] = 1.0
    elif rule == "occlusion":
        votes = np.maximum(rise, 0.0)
        np.fill_diagonal(votes, 0.0)
        votes = votes / np.maximum(votes.sum(axis=1, keepdims=True), 1e-12)
    else:
        votes = attention.copy()
    np.fill_diagonal(votes, 0.0)
    return np.asarray(votes.sum(axis=0) / uavs)


def top(scores: Floats, count: int, rng: np.random.Generator) -> NDArray[np.intp]:
    """Indices of the ``count`` highest scores, ties broken at random; equations (21), (22)."""
    return np.lexsort((rng.random(len(scores)), -scores))[:count]
