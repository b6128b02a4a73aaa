"""Symmetric non-negative matrix factorisation, A ≈ H Hᵀ (Kuang, Ding and Park, SIAM SDM 2012)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["symmetric_nmf"]

Floats = NDArray[np.float64]

_LEAST = 1e-12  # an entry at exactly 0 could never leave it


def symmetric_nmf(
    affinity: Floats, rank: int, rng: np.random.Generator, steps: int = 300, tolerance: float = 1e-5
) -> tuple[Floats, Floats]:
    """A local minimum of |A - H Hᵀ|² over H >= 0, from a random start.

    The update H ← H ∘ (AH / HHᵀH)^p with p = 1/4 minimises a bound of the loss that touches it at H, so that the loss
    never rises; p = 1/2 is faster near a minimum but may raise it, and is kept only where it does not.

    Args:
        affinity: ``(n, n)`` symmetric, >= 0.
        rank: columns of H.
        rng: draws the start, uniform, of the affinity's mean size.
        steps: the most updates.
        tolerance: stop when an update lowers the loss by less than this share.

    Returns:
        H ``(n, rank)``, and the loss at the start and after every update.
    """
    size = float((affinity**2).sum())
    factor = 2.0 * np.sqrt(affinity.mean() / rank) * rng.random((len(affinity), rank)) + _LEAST
    product, gram = affinity @ factor, factor.T @ factor
    losses = [_loss(size, factor, product, gram)]
    for _ in range(steps):
        ratio = product / np.maximum(factor @ gram, _LEAST)
        for power in (0.5, 0.25):
            trial = np.maximum(factor * ratio**power, _LEAST)
            product, gram = affinity @ trial, trial.T @ trial
            loss = _loss(size, trial, product, gram)
            if loss <= losses[-1]:
                break
        else:  # converged: what is left is rounding
            break
        factor = trial
        losses.append(loss)
        if losses[-2] - loss <= tolerance * losses[-2]:
            break
    return factor, np.array(losses)


def _loss(size: float, factor: Floats, product: Floats, gram: Floats) -> float:
    """|A - H Hᵀ|² from A H and Hᵀ H, at least 0."""
    return max(size - 2.0 * float((factor * product).sum()) + float((gram**2).sum()), 0.0)
