"""The paper's objectives J_s and J_m, and every metric, as pure functions of the truth and the answers.

Sets of UAVs are boolean masks over the last axis. The functions of one round take any leading axes, ``(..., N)``, and
work on a batch as on one swarm. Conventions where a ratio has no value: precision of an empty answer is 0, and so are
recall, F1 and average precision where there is no head.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from usnet_env.config import ArgumentError, quote

__all__ = [
    "average_precision",
    "exact",
    "f1",
    "finished",
    "head_in_cluster",
    "hits_and_redundant",
    "multi_cluster_objective",
    "precision",
    "purity",
    "recall",
    "redundancy",
    "remaining_heads",
    "rounds_hits_and_redundant",
    "single_cluster_objective",
]

Mask = NDArray[np.bool_]
Counts = NDArray[np.int64]
Ratios = NDArray[np.float64]


def _mask(name: str, value: ArrayLike) -> Mask:
    """``value`` as booleans with at least one axis; refuses anything but 0 and 1."""
    array = np.asarray(value)
    if array.dtype != bool:
        if array.dtype.kind not in "iuf" or not ((array == 0) | (array == 1)).all():
            raise ArgumentError(f"{name} must hold only 0 and 1 (or booleans), got {quote(value)}.")
        array = array.astype(bool)
    if array.ndim == 0 or array.shape[-1] == 0:
        raise ArgumentError(f"{name} must have shape (..., N) with N of at least 1, got {array.shape}.")
    return array


def _pair(first_name: str, first: ArrayLike, name: str, value: ArrayLike) -> tuple[Mask, Mask]:
    """Two masks over the same N UAVs."""
    reference, mask = _mask(first_name, first), _mask(name, value)
    if reference.shape[-1] != mask.shape[-1]:
        raise ArgumentError(
            f"{name} must have as many UAVs as {first_name}, {reference.shape[-1]}, got {mask.shape[-1]}."
        )
    return reference, mask


def _labels(name: str, value: ArrayLike, uavs: int) -> NDArray[np.int64]:
    """``(N,)`` labels; -1 stands for none."""
    labels = np.asarray(value)
    if labels.shape != (uavs,) or labels.dtype.kind not in "iu":
        raise ArgumentError(f"{name} must hold a whole number for each of {uavs} UAVs, got {quote(value)}.")
    return labels.astype(np.int64)


def _one_round_each(head: ArrayLike, candidates_per_round: ArrayLike) -> tuple[Mask, Mask]:
    """Heads ``(N,)`` and candidates ``(R, N)``."""
    heads, candidates = _pair("head", head, "candidates_per_round", candidates_per_round)
    if heads.ndim != 1:
        raise ArgumentError(f"head must have shape (N,), got {heads.shape}.")
    if candidates.ndim != 2:
        raise ArgumentError(f"candidates_per_round must have shape (R, N), got {candidates.shape}.")
    return heads, candidates


def _ratio(part: NDArray[np.int64], whole: NDArray[np.int64]) -> Ratios:
    """``part / whole``, 0 where ``whole`` is 0."""
    return np.asarray(np.where(whole > 0, part / np.maximum(whole, 1), 0.0))


# One round, any leading axes


def hits_and_redundant(head: Mask, alive: Mask, candidates: Mask) -> tuple[Counts, Counts]:
    """How many candidates of a round were heads, and how many were not.

    The sets of §II-A: |H_{r-1}∖H_r| and |C_r∖H_{r-1}|. A destroyed UAV is in no H_{r-1}, so naming it again is
    redundant.

    Args:
        head: ``(..., N)`` bool, H_0, the heads of the first round.
        alive: ``(..., N)`` bool, before this round.
        candidates: ``(..., N)`` bool, C_r.

    Returns:
        Hits and redundant candidates, each ``(...)`` int64.
    """
    hits = (candidates & head & alive).sum(axis=-1, dtype=np.int64)
    return hits, candidates.sum(axis=-1, dtype=np.int64) - hits


def single_cluster_objective(head: ArrayLike, candidates: ArrayLike) -> Ratios:
    """P1's objective J_s = 1{i_L in C_1} - |C_1|, to be maximised; its best value is 0.

    The formula gives the empty answer 0 as well, the best value. An answer of P1 names at least one UAV, so the empty
    one scores -1, as a miss does (decision (k) of the paper's silent points).

    Args:
        head: ``(..., N)`` bool with one head each.
        candidates: ``(..., N)`` bool.

    Returns:
        J_s, ``(...)`` float64.

    Raises:
        ArgumentError: another number of heads than one, or different numbers of UAVs.
    """
    heads, named = _pair("head", head, "candidates", candidates)
    if (heads.sum(axis=-1) != 1).any():
        raise ArgumentError("head must hold exactly one head in P1, got another number.")
    count = named.sum(axis=-1)
    hit = (heads & named).any(axis=-1)
    return np.asarray(np.where(count > 0, hit.astype(float) - count, -1.0))


def precision(head: ArrayLike, candidates: ArrayLike) -> Ratios:
    """Share of the candidates ``(..., N)`` that are heads; 0 without a candidate."""
    heads, named = _pair("head", head, "candidates", candidates)
    return _ratio((heads & named).sum(axis=-1), named.sum(axis=-1))


def recall(head: ArrayLike, candidates: ArrayLike) -> Ratios:
    """Share of the heads ``(..., N)`` that are candidates; 0 without a head."""
    heads, named = _pair("head", head, "candidates", candidates)
    return _ratio((heads & named).sum(axis=-1), heads.sum(axis=-1))


def f1(head: ArrayLike, candidates: ArrayLike) -> Ratios:
    """Harmonic mean of precision and recall, 2 |C & H| / (|C| + |H|); 0 where both sets are empty."""
    heads, named = _pair("head", head, "candidates", candidates)
    return _ratio(2 * (heads & named).sum(axis=-1), named.sum(axis=-1) + heads.sum(axis=-1))


def exact(head: ArrayLike, candidates: ArrayLike) -> Mask:
    """Whether the candidates ``(..., N)`` are the heads, no more and no less."""
    heads, named = _pair("head", head, "candidates", candidates)
    return np.asarray((heads == named).all(axis=-1))


# One episode


def remaining_heads(head: ArrayLike, candidates_per_round: ArrayLike) -> Mask:
    """H_0, ..., H_R by H_r = H_{r-1}∖C_r, equation (2).

    Args:
        head: ``(N,)`` bool, H_0.
        candidates_per_round: ``(R, N)`` bool, C_1 to C_R.

    Returns:
        ``(R + 1, N)`` bool.
    """
    heads, candidates = _one_round_each(head, candidates_per_round)
    hit_so_far = np.logical_or.accumulate(np.vstack([np.zeros_like(heads), candidates]), axis=0)
    return np.asarray(heads & ~hit_so_far)


def rounds_hits_and_redundant(head: ArrayLike, candidates_per_round: ArrayLike) -> tuple[Counts, Counts]:
    """Hits and redundant candidates of every round, each ``(R,)`` int64; see :func:`hits_and_redundant`."""
    before = remaining_heads(head, candidates_per_round)[:-1]
    return hits_and_redundant(before, np.ones_like(before), _mask("candidates_per_round", candidates_per_round))


def redundancy(head: ArrayLike, candidates_per_round: ArrayLike) -> float:
    """Detection redundancy of §II-A, (1/N) sum_r |C_r∖H_{r-1}|; above 1 where UAVs are named in vain repeatedly."""
    _, redundant = rounds_hits_and_redundant(head, candidates_per_round)
    return float(redundant.sum() / np.shape(head)[-1])


def multi_cluster_objective(head: ArrayLike, candidates_per_round: ArrayLike) -> float:
    """P2's objective J_m = R + (1/N) sum_r |C_r∖H_{r-1}|, to be minimised; its best value is 1.

    Args:
        head: ``(N,)`` bool, H_0.
        candidates_per_round: ``(R, N)`` bool, C_1 to C_R; an empty answer is a round.

    Returns:
        J_m of the rounds played, whether or not they found every head (:func:`finished` says so).
    """
    return len(np.asarray(candidates_per_round)) + redundancy(head, candidates_per_round)


def finished(head: ArrayLike, candidates_per_round: ArrayLike) -> bool:
    """Whether every head was hit in some round, H_R = {}."""
    return not remaining_heads(head, candidates_per_round)[-1].any()


# Scores and clusters of one round


def average_precision(head: ArrayLike, scores: ArrayLike) -> float:
    """Area under the precision-recall curve of the scores, as scikit-learn's ``average_precision_score`` defines it.

    Args:
        head: ``(N,)`` bool.
        scores: ``(N,)``, higher is more head-like; equal scores count as one threshold.

    Returns:
        A value from 0 to 1; 0 without a head.
    """
    heads, values = _mask("head", head), np.asarray(scores)
    if values.shape != heads.shape or heads.ndim != 1 or values.dtype.kind not in "biuf":
        raise ArgumentError(f"scores must hold a number for each of {heads.shape[-1]} UAVs, got {quote(scores)}.")
    if not np.isfinite(values).all():
        raise ArgumentError("scores must be finite, got NaN or infinity.")
    if not heads.any():
        return 0.0
    from sklearn.metrics import average_precision_score  # a second of import that the environments need not pay

    return float(average_precision_score(heads, values))


def purity(leader: ArrayLike, clusters: ArrayLike) -> float:
    """Share of the UAVs that are in a cluster most of whose members have the same leader.

    The usual purity, (1/n) sum_k max_j |cluster k & class j|, where the class of a UAV is its leader (a head's is
    itself). The n UAVs are those with a leader; one of them that was put in no cluster counts as wrong.

    Args:
        leader: ``(N,)`` int, index of the head that a UAV follows; a head's own index; -1 leaves the UAV out.
        clusters: ``(N,)`` int, cluster label; -1: none.

    Returns:
        A value from 0 to 1; 0 where nobody has a leader. It hides the heads: see :func:`head_in_cluster`.
    """
    uavs = len(np.asarray(clusters))
    led, label = _labels("leader", leader, uavs), _labels("clusters", clusters, uavs)
    counted = led >= 0
    if not counted.any():
        return 0.0
    most = sum(
        np.unique(led[counted & (label == k)], return_counts=True)[1].max() for k in np.unique(label[counted]) if k >= 0
    )
    return float(most / counted.sum())


def head_in_cluster(head: ArrayLike, leader: ArrayLike, clusters: ArrayLike) -> float:
    """Share of the heads that were put in the cluster that holds most of their own followers.

    Purity hides the heads: they are few, and a head that moves ahead of its followers may be put anywhere at little
    cost. Here only heads count. The cluster "of the followers" is the label that most of them have (-1, no cluster,
    is no label); where labels tie, each of them is good.

    Args:
        head: ``(N,)`` bool.
        leader: ``(N,)`` int, as in :func:`purity`.
        clusters: ``(N,)`` int, cluster label; -1: none.

    Returns:
        A value from 0 to 1 over the heads that have a follower; 0 where no head has one.
    """
    heads = _mask("head", head)
    uavs = heads.shape[-1]
    led, label = _labels("leader", leader, uavs), _labels("clusters", clusters, uavs)
    together = []
    for chief in np.flatnonzero(heads):
        followers = (led == chief) & ~heads
        if not followers.any():
            continue
        values, counts = np.unique(label[followers & (label >= 0)], return_counts=True)
        together.append(label[chief] in values[counts == counts.max(initial=0)])
    return float(np.mean(together)) if together else 0.0
