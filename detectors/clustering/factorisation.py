"""Symmetric non-negative matrix factorisation of an affinity (Kuang, Ding and Park, SIAM SDM 2012)."""

from __future__ import annotations

import numpy as np

from usnet_env.arrays import Floats

_LEAST = 1e-12  # lower bound of an entry: the multiplicative update would keep an entry of 0 forever


def factorise_affinity(
    affinity: Floats, rank: int, rng: np.random.Generator, steps: int = 300, tolerance: float = 1e-5
) -> tuple[Floats, Floats]:
    """Find a local minimum of |A - H Hᵀ|² over H ≥ 0 from a random start.

    The update is H ← H ∘ (A H / H Hᵀ H)^p. With p = 1/4 it minimises an upper bound of the loss that is equal to the
    loss at H, so the loss never rises. With p = 1/2 it is faster near a minimum, but the loss may rise; such an update
    is used only if the loss does not rise.

    Args:
        affinity: A, ``(n, n)`` symmetric, ≥ 0.
        rank: the number of columns of H.
        rng: generator of the start: uniform, scaled so that H Hᵀ has the mean size of A.
        steps: the largest number of updates.
        tolerance: stop when an update reduces the loss by at most this share.

    Returns:
        H ``(n, rank)``, and the loss at the start and after every update ``(updates + 1,)``.
    """
    size = float((affinity**2).sum())
    factor = 2.0 * np.sqrt(affinity.mean() / rank) * rng.random((len(affinity), rank)) + _LEAST
    product, gram = affinity @ factor, factor.T @ factor
    losses = [_compute_loss(size, factor, product, gram)]
    for _ in range(steps):
        ratio = product / np.maximum(factor @ gram, _LEAST)
        for power in (0.5, 0.25):
            trial = np.maximum(factor * ratio**power, _LEAST)
            product, gram = affinity @ trial, trial.T @ trial
            loss = _compute_loss(size, trial, product, gram)
            if loss <= losses[-1]:
                break
        else:  # converged: only rounding errors remain
            break
        factor = trial
        losses.append(loss)
        if losses[-2] - loss <= tolerance * losses[-2]:
            break
    return factor, np.array(losses)


def _compute_loss(size: float, factor: Floats, product: Floats, gram: Floats) -> float:
    """Compute |A - H Hᵀ|² from |A|², A H and Hᵀ H; rounding errors below 0 are cut off."""
    return max(size - 2.0 * float((factor * product).sum()) + float((gram**2).sum()), 0.0)
