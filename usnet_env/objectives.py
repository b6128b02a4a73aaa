"""The paper's objectives J_s and J_m and all metrics, as pure functions of the true heads and the candidates.

A set of UAVs is a boolean mask over the last axis. Functions of one round accept any leading axes, ``(..., N)``, and so
a batch. An undefined ratio is 0: the precision of an empty set, and recall, F1 and average precision without heads.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from usnet_env.arrays import Floats, Indices, Mask
from usnet_env.config import ArgumentError, quote
from usnet_env.detection import Detection
from usnet_env.window import as_array

__all__ = [
    "average_precision",
    "exact",
    "f1",
    "find_roots",
    "found_all_heads",
    "group_leader_accuracy",
    "head_in_cluster",
    "hits_and_redundant",
    "leader_accuracy",
    "multi_cluster_objective",
    "precision",
    "purity",
    "recall",
    "redundancy",
    "remaining_heads",
    "rounds_hits_and_redundant",
    "single_cluster_objective",
]


def _mask(name: str, value: ArrayLike) -> Mask:
    """Convert ``value`` to booleans with at least one axis; values other than 0 and 1 raise."""
    array = as_array(name, value)
    if array.dtype != bool:
        if array.dtype.kind not in "iuf" or not ((array == 0) | (array == 1)).all():
            raise ArgumentError(f"{name} must hold only 0 and 1 (or booleans), got {quote(value)}.")
        array = array.astype(bool)
    if array.ndim == 0 or array.shape[-1] == 0:
        raise ArgumentError(f"{name} must have shape (..., N) with N of at least 1, got {array.shape}.")
    return array


def _pair(first_name: str, first: ArrayLike, name: str, value: ArrayLike) -> tuple[Mask, Mask]:
    """Convert two masks over the same N UAVs."""
    reference, mask = _mask(first_name, first), _mask(name, value)
    if reference.shape[-1] != mask.shape[-1]:
        raise ArgumentError(
            f"{name} must have as many UAVs as {first_name}, {reference.shape[-1]}, got {mask.shape[-1]}."
        )
    return reference, mask


def _labels(name: str, value: ArrayLike, uavs: int | None = None) -> Indices:
    """Convert ``(N,)`` labels to int64, with ``None`` for any N; -1 means no label."""
    labels = as_array(name, value)
    if uavs is None:
        if labels.ndim != 1:
            raise ArgumentError(f"{name} must have shape (N,), got {labels.shape}.")
        uavs = len(labels)
    if labels.shape != (uavs,) or labels.dtype.kind not in "iu":
        raise ArgumentError(f"{name} must hold a whole number for each of {uavs} UAVs, got {quote(value)}.")
    return labels.astype(np.int64)


def _ratio(part: Indices, whole: Indices) -> Floats:
    """``part / whole``, 0 where ``whole`` is 0."""
    return np.asarray(np.where(whole > 0, part / np.maximum(whole, 1), 0.0))


# One round, any leading axes


def hits_and_redundant(head: Mask, alive: Mask, candidates: Mask) -> tuple[Indices, Indices]:
    """Number of candidates of a round that are living heads (hits), and number of the other candidates (redundant).

    These are |H_{r-1}∖H_r| and |C_r∖H_{r-1}| of §II-A. A destroyed UAV is not in H_{r-1}, so it counts as redundant.

    Args:
        head: ``(..., N)`` bool, H_0, the heads at the start.
        alive: ``(..., N)`` bool, the UAVs alive before this round.
        candidates: ``(..., N)`` bool, C_r.

    Returns:
        Hits and redundant candidates, each ``(...)`` int64.
    """
    heads, living = _pair("head", head, "alive", alive)
    _, chosen = _pair("head", heads, "candidates", candidates)
    try:
        hits = (chosen & heads & living).sum(axis=-1, dtype=np.int64)
    except ValueError:
        raise ArgumentError(
            f"candidates must have the leading axes of head {heads.shape} and alive {living.shape}, got {chosen.shape}."
        ) from None
    return hits, chosen.sum(axis=-1, dtype=np.int64) - hits


def single_cluster_objective(head: ArrayLike, candidates: ArrayLike) -> Floats:
    """P1's objective J_s = |C_1 & H_0| - |C_1|, to be maximised; the maximum is 0.

    With one head it is the paper's 1{i_L in C_1} - |C_1|. The formula also gives 0 for an empty set of candidates.
    Where a UAV leads, at least one candidate is required, so an empty set scores -1, like a miss (decision (k) on
    docs/game.md).

    Args:
        head: ``(..., N)`` bool, H_0: one head, or as many as the follow strategy has, none included.
        candidates: ``(..., N)`` bool.

    Returns:
        J_s, ``(...)`` float64.

    Raises:
        ArgumentError: the masks have different numbers of UAVs.
    """
    heads, chosen = _pair("head", head, "candidates", candidates)
    count = chosen.sum(axis=-1)
    hits = (heads & chosen).sum(axis=-1)
    return np.asarray(np.where(count > 0, hits - count, np.where(heads.any(axis=-1), -1.0, 0.0)))


def precision(head: ArrayLike, candidates: ArrayLike) -> Floats:
    """Share of the candidates ``(..., N)`` that are heads; 0 without a candidate."""
    heads, chosen = _pair("head", head, "candidates", candidates)
    return _ratio((heads & chosen).sum(axis=-1), chosen.sum(axis=-1))


def recall(head: ArrayLike, candidates: ArrayLike) -> Floats:
    """Share of the heads ``(..., N)`` that are candidates; 0 without a head."""
    heads, chosen = _pair("head", head, "candidates", candidates)
    return _ratio((heads & chosen).sum(axis=-1), heads.sum(axis=-1))


def f1(head: ArrayLike, candidates: ArrayLike) -> Floats:
    """Harmonic mean of precision and recall, 2 |C & H| / (|C| + |H|); 0 where both sets are empty."""
    heads, chosen = _pair("head", head, "candidates", candidates)
    return _ratio(2 * (heads & chosen).sum(axis=-1), chosen.sum(axis=-1) + heads.sum(axis=-1))


def exact(head: ArrayLike, candidates: ArrayLike) -> Mask:
    """Whether the set of candidates ``(..., N)`` equals the set of heads."""
    heads, chosen = _pair("head", head, "candidates", candidates)
    return np.asarray((heads == chosen).all(axis=-1))


# One episode


def remaining_heads(head: ArrayLike, candidates_per_round: ArrayLike) -> Mask:
    """The remaining heads H_0, ..., H_R by H_r = H_{r-1}∖C_r, equation (2).

    Args:
        head: ``(N,)`` bool, H_0.
        candidates_per_round: ``(R, N)`` bool, C_1 to C_R.

    Returns:
        ``(R + 1, N)`` bool.
    """
    heads, candidates = _pair("head", head, "candidates_per_round", candidates_per_round)
    if heads.ndim != 1:
        raise ArgumentError(f"head must have shape (N,), got {heads.shape}.")
    if candidates.ndim != 2:
        raise ArgumentError(f"candidates_per_round must have shape (R, N), got {candidates.shape}.")
    hit_so_far = np.logical_or.accumulate(np.vstack([np.zeros_like(heads), candidates]), axis=0)
    return np.asarray(heads & ~hit_so_far)


def rounds_hits_and_redundant(head: ArrayLike, candidates_per_round: ArrayLike) -> tuple[Indices, Indices]:
    """Hits and redundant candidates of every round, each ``(R,)`` int64; see :func:`hits_and_redundant`."""
    before = remaining_heads(head, candidates_per_round)[:-1]
    return hits_and_redundant(before, np.ones_like(before), _mask("candidates_per_round", candidates_per_round))


def redundancy(head: ArrayLike, candidates_per_round: ArrayLike) -> float:
    """Detection redundancy of §II-A, (1/N) sum_r |C_r∖H_{r-1}|; it exceeds 1 if many UAVs are redundant repeatedly."""
    _, redundant = rounds_hits_and_redundant(head, candidates_per_round)
    return float(redundant.sum() / np.shape(head)[-1])


def multi_cluster_objective(head: ArrayLike, candidates_per_round: ArrayLike) -> float:
    """P2's objective J_m = R + (1/N) sum_r |C_r∖H_{r-1}|, to be minimised; the minimum is 1.

    Args:
        head: ``(N,)`` bool, H_0.
        candidates_per_round: ``(R, N)`` bool, C_1 to C_R; an empty set counts as a round.

    Returns:
        J_m of these rounds, also if heads are left (see :func:`found_all_heads`).
    """
    redundant = redundancy(head, candidates_per_round)  # it checks both arguments
    return len(np.asarray(candidates_per_round)) + redundant


def found_all_heads(head: ArrayLike, candidates_per_round: ArrayLike) -> bool:
    """Whether every head was hit in some round, so that H_R is empty."""
    return not remaining_heads(head, candidates_per_round)[-1].any()


# Scores and clusters of one round


def average_precision(head: ArrayLike, scores: ArrayLike) -> float:
    """Area under the precision-recall curve of the scores, as scikit-learn's ``average_precision_score`` defines it.

    Args:
        head: ``(N,)`` bool.
        scores: ``(N,)``, a higher score means a more likely head; equal scores form one threshold.

    Returns:
        A value from 0 to 1; 0 without a head.
    """
    heads, values = _mask("head", head), as_array("scores", scores)
    if values.shape != heads.shape or heads.ndim != 1 or values.dtype.kind not in "biuf":
        raise ArgumentError(f"scores must hold a number for each of {heads.shape[-1]} UAVs, got {quote(scores)}.")
    if not np.isfinite(values).all():
        raise ArgumentError("scores must be finite, got NaN or infinity.")
    if not heads.any():
        return 0.0
    # Not by scikit-learn's function, whose import takes a second in every worker process of an evaluation.
    order = np.argsort(values, kind="stable")[::-1]
    ranked = values[order]
    last = np.append(np.flatnonzero(ranked[1:] != ranked[:-1]), len(ranked) - 1)  # last UAV of each threshold
    hits = np.cumsum(heads[order])[last]
    precision, recall = hits / (last + 1), hits / heads.sum()
    return float(np.sum((np.diff(recall, prepend=0.0) * precision)[::-1]))  # in its order: equal to the last bit


def purity(root: ArrayLike, clusters: ArrayLike) -> float:
    """Purity of a clustering: share of the UAVs whose head is the most frequent head in their cluster.

    The usual definition, (1/n) sum_k max_j |cluster k & class j|, where the class of a UAV is its head (that of a head
    is the head itself). The n UAVs are those with a head; a UAV without a cluster counts as wrong.

    Args:
        root: ``(N,)`` int, index of the head that a UAV follows; a head's own index; -1: the UAV is not counted.
        clusters: ``(N,)`` int, cluster label; -1: none.

    Returns:
        A value from 0 to 1; 0 if no UAV has a head. Purity says little about the heads: see
        :func:`head_in_cluster`.
    """
    label = _labels("clusters", clusters)
    roots = _labels("root", root, len(label))
    counted = roots >= 0
    if not counted.any():
        return 0.0
    most = sum(
        np.unique(roots[counted & (label == k)], return_counts=True)[1].max()
        for k in np.unique(label[counted])
        if k >= 0
    )
    return float(most / counted.sum())


def head_in_cluster(head: ArrayLike, root: ArrayLike, clusters: ArrayLike) -> float:
    """Share of the heads whose cluster is the one that holds most of their followers.

    Heads are few, so a clustering that puts all heads in wrong clusters still has a high purity. Here only heads
    count. The cluster of the followers is their most frequent label, without -1; if several labels tie, each of them is
    accepted.

    Args:
        head: ``(N,)`` bool.
        root: ``(N,)`` int, as in :func:`purity`.
        clusters: ``(N,)`` int, cluster label; -1: none.

    Returns:
        A value from 0 to 1 over the heads with at least one follower; 0 if there is none.
    """
    heads = _mask("head", head)
    if heads.ndim != 1:
        raise ArgumentError(f"head must have shape (N,), got {heads.shape}.")
    uavs = heads.shape[-1]
    roots, label = _labels("root", root, uavs), _labels("clusters", clusters, uavs)
    correct = []
    for i in np.flatnonzero(heads):
        followers = (roots == i) & ~heads
        if not followers.any():
            continue
        values, counts = np.unique(label[followers & (label >= 0)], return_counts=True)
        correct.append(label[i] in values[counts == counts.max(initial=0)])
    return float(np.mean(correct)) if correct else 0.0


# Trees: a follower may lead others


def find_roots(leader: ArrayLike) -> Indices:
    """Find the head of each UAV's tree.

    Args:
        leader: ``(N,)`` int, index of the UAV that each follows directly; its own index or -1 if it follows none.

    Returns:
        ``(N,)`` int64, the UAV from which the chain of leaders begins; a UAV that follows none has its own index, and
        one whose leaders form a cycle has -1.

    Raises:
        ArgumentError: an index is not below N.
    """
    direct = _labels("leader", leader)
    uavs = len(direct)
    if (direct >= uavs).any():
        raise ArgumentError(f"leader must hold indices below {uavs}, got {quote(leader)}.")
    own = np.arange(uavs)
    root = np.where(direct >= 0, direct, own)
    for _ in range(uavs.bit_length()):  # each pass doubles the length of the chains that are followed
        root = root[root]
    ends = (direct < 0) | (direct == own)
    return np.where(ends[root], root, -1)


def list_followers(detection: Detection, head: int) -> list[int]:
    """Indices of those that follow a head, directly or through others; without leaders, those in its cluster.

    A detector may give the head a leader, such as the UAV that is most similar to it; a candidate follows no UAV.
    """
    if detection.leader is not None:
        leader = np.where(detection.candidates, np.arange(len(detection.leader)), detection.leader)
        behind = find_roots(leader) == head
    elif detection.clusters is not None and detection.clusters[head] >= 0:
        behind = detection.clusters == detection.clusters[head]
    else:
        return []
    return [int(i) for i in np.flatnonzero(behind) if i != head]


def leader_accuracy(leader: ArrayLike, estimate: ArrayLike, *, roots: bool = False) -> float:
    """Share of the followers whose leader is the estimated one.

    Args:
        leader: ``(N,)`` int, index of the UAV that each follows directly; its own index or -1 if it follows none.
        estimate: ``(N,)`` int, the same of a detection.
        roots: whether to compare the heads of the trees instead of the direct leaders: where a chain of leaders ends.

    Returns:
        A value from 0 to 1; 0 if no UAV follows another one.

    Raises:
        ArgumentError: an argument has another shape or type.
    """
    if not isinstance(roots, bool):
        raise ArgumentError(f"roots must be True or False, got {quote(roots)}.")
    truth = _labels("leader", leader)
    found = _labels("estimate", estimate, len(truth))
    follows = (truth >= 0) & (truth != np.arange(len(truth)))
    if not follows.any():
        return 0.0
    if roots:
        truth, found = find_roots(truth), np.where(found >= 0, find_roots(found), -1)
    return float((truth == found)[follows].mean())


def group_leader_accuracy(leader: ArrayLike, scores: ArrayLike) -> float:
    """Share of the groups whose head has the highest score of its group; the groups are known.

    A group is a head with all that follow it, directly or through others. If k members tie at the top and the head is
    one of them, the group counts 1/k.

    Args:
        leader: ``(N,)`` int, index of the UAV that each follows directly; its own index or -1 if it follows none.
        scores: ``(N,)``, a higher score means a more likely head.

    Returns:
        A value from 0 to 1 over the groups of at least 2 UAVs; 0 if there is none.
    """
    roots = find_roots(leader)
    values = as_array("scores", scores)
    if values.shape != roots.shape or values.dtype.kind not in "biuf" or not np.isfinite(values).all():
        raise ArgumentError(f"scores must hold a finite number for each of {len(roots)} UAVs, got {quote(scores)}.")
    shares = []
    for head in np.unique(roots[(roots >= 0) & (roots != np.arange(len(roots)))]):
        top = np.flatnonzero(roots == head)
        top = top[values[top] == values[top].max()]
        shares.append((head in top) / len(top))
    return float(np.mean(shares)) if shares else 0.0
