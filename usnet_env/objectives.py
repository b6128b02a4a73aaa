"""The paper's objectives J_s and J_m and all metrics, as pure functions of the true heads and the candidates.

A set of UAVs is a boolean mask over the last axis. Functions of one round accept any leading axes, ``(..., N)``, and so
a batch. An undefined ratio is 0: the precision of an empty set, and recall and average precision without heads.
Arguments are trusted: they come from a window and a detection, which check them. Several functions share these:

* ``head``: ``(..., N)`` bool, H_0, the heads at the start.
* ``candidates``: ``(..., N)`` bool, C_r; ``candidates_per_round``: ``(R, N)`` bool, C_1 to C_R, of one episode.
* ``scores``: ``(N,)``, a higher score means a more likely head.
* ``clusters``: ``(N,)`` int, cluster labels; -1: none.
* ``root``: ``(N,)`` int, index of the head that each UAV follows; a head's own index; -1: the UAV is not counted.
* ``leader``: ``(N,)`` int, index of the UAV that each follows directly; its own index or -1 if it follows none.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from usnet_env.arrays import Floats, Indices, Mask
from usnet_env.detection import Detection


def _count(*masks: ArrayLike) -> Indices:
    """Number of UAVs that are in all sets."""
    in_all = np.asarray(masks[0], bool)
    for mask in masks[1:]:
        in_all = in_all & np.asarray(mask, bool)
    return np.asarray(in_all.sum(axis=-1, dtype=np.int64))


def _divide(part: Indices, total: Indices) -> Floats:
    """``part / total``, 0 where ``total`` is 0."""
    return np.asarray(np.where(total > 0, part / np.maximum(total, 1), 0.0))


def hits_and_redundant(head: Mask, alive: Mask, candidates: Mask) -> tuple[Indices, Indices]:
    """Number of candidates of a round that are living heads (hits), and number of the other candidates (redundant).

    These are |H_{r-1}∖H_r| and |C_r∖H_{r-1}| of §II-A, each ``(...)`` int64. A destroyed UAV, which is not among those
    ``alive`` before this round, counts as redundant.
    """
    hits = _count(head, alive, candidates)
    return hits, _count(candidates) - hits


def single_cluster_objective(head: ArrayLike, candidates: ArrayLike) -> Floats:
    """P1's objective J_s = |C_1 & H_0| - |C_1| of masks ``(..., N)``, to be maximised; the maximum is 0.

    With one head it is the paper's 1{i_L in C_1} - |C_1|. An empty set of candidates, for which the formula gives 0,
    scores -1 where a UAV leads, like a miss (decision (k) on docs/game.md).

    >>> float(single_cluster_objective([True, False, False], [True, True, False]))  # the head and a redundant UAV
    -1.0
    """
    count, hits = _count(candidates), _count(head, candidates)
    return np.asarray(np.where(count > 0, hits - count, np.where(np.any(head, axis=-1), -1.0, 0.0)))


def precision(head: ArrayLike, candidates: ArrayLike) -> Floats:
    """Share of the candidates ``(..., N)`` that are heads; 0 without a candidate.

    >>> float(precision([True, False, False], [True, True, False]))
    0.5
    """
    return _divide(_count(head, candidates), _count(candidates))


def recall(head: ArrayLike, candidates: ArrayLike) -> Floats:
    """Share of the heads ``(..., N)`` that are candidates; 0 without a head.

    >>> float(recall([True, False, True], [True, True, False]))
    0.5
    """
    return _divide(_count(head, candidates), _count(head))


def f1(head: ArrayLike, candidates: ArrayLike) -> Floats:
    """Harmonic mean of precision and recall of masks ``(..., N)``, 2|C & H| / (|C| + |H|); 1 where both are empty.

    >>> round(float(f1([True, False, True], [True, False, False])), 2)
    0.67
    """
    total = _count(candidates) + _count(head)
    return np.asarray(np.where(total > 0, _divide(2 * _count(head, candidates), total), 1.0))


def exact(head: ArrayLike, candidates: ArrayLike) -> Mask:
    """Whether the set of candidates ``(..., N)`` equals the set of heads."""
    return np.asarray((np.asarray(head, bool) == np.asarray(candidates, bool)).all(axis=-1))


def remaining_heads(head: ArrayLike, candidates_per_round: ArrayLike) -> Mask:
    """The remaining heads H_0, ..., H_R by H_r = H_{r-1}∖C_r, equation (2), as ``(R + 1, N)`` bool."""
    hit = np.logical_or.accumulate(np.asarray(candidates_per_round, bool), axis=0)
    return np.asarray(head, bool) & ~np.vstack([np.zeros_like(hit[:1]), hit])


def redundancy(head: ArrayLike, candidates_per_round: ArrayLike, uavs: int | None = None) -> float:
    """Detection redundancy of §II-A, (1/N) sum_r |C_r∖H_{r-1}|, of ``(N,)`` and ``(R, N)``; it may exceed 1.

    ``uavs`` is the number of UAVs at the start, if the arrays are longer.
    """
    hits = _count(remaining_heads(head, candidates_per_round)[:-1], candidates_per_round)
    return float((_count(candidates_per_round) - hits).sum() / (uavs or np.shape(head)[-1]))


def multi_cluster_objective(head: ArrayLike, candidates_per_round: ArrayLike, uavs: int | None = None) -> float:
    """P2's objective J_m = R + (1/N) sum_r |C_r∖H_{r-1}| of ``(N,)`` and ``(R, N)``, to be minimised: at least 1.

    An empty set of candidates counts as a round, and heads may be left (see :func:`found_all_heads`). ``uavs`` is that
    of :func:`redundancy`.

    >>> multi_cluster_objective([True, False, True, False], [[True, True, False, False], [False, False, True, False]])
    2.25
    """
    return len(np.asarray(candidates_per_round)) + redundancy(head, candidates_per_round, uavs)


def found_all_heads(head: ArrayLike, candidates_per_round: ArrayLike) -> bool:
    """Whether every head ``(N,)`` was a candidate in some round ``(R, N)``, so that H_R is empty."""
    return not remaining_heads(head, candidates_per_round)[-1].any()


def average_precision(head: ArrayLike, scores: ArrayLike) -> float:
    """Area under the precision-recall curve of scores ``(N,)`` by scikit-learn's ``average_precision_score``.

    Equal scores form one threshold. The value is from 0 to 1; 0 without a head.

    >>> round(average_precision([True, False, True, False], [0.9, 0.8, 0.7, 0.1]), 3)
    0.833
    """
    heads, values = np.asarray(head, bool), np.asarray(scores)
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
    """Purity of a clustering ``(N,)``: share of the UAVs whose head is the most frequent head in their cluster.

    Only UAVs with a head count, a head as its own; one without a cluster counts as wrong. It is 0 if no UAV has a head.

    >>> purity(root=[0, 0, 2, 2], clusters=[0, 0, 0, 1])
    0.75
    """
    roots, label = np.asarray(root), np.asarray(clusters)
    is_counted = roots >= 0
    if not is_counted.any():
        return 0.0
    labels = np.unique(label[is_counted & (label >= 0)])
    correct = sum(np.unique(roots[is_counted & (label == k)], return_counts=True)[1].max() for k in labels)
    return float(correct / is_counted.sum())


def head_in_cluster(head: ArrayLike, root: ArrayLike, clusters: ArrayLike) -> float:
    """Share of the heads ``(N,)`` whose cluster is the one that holds most of their followers.

    Only heads with followers count; without any, the value is 0. The cluster of the followers is their most frequent
    label except -1; if several labels tie, each of them is accepted.
    """
    heads, roots, label = np.asarray(head, bool), np.asarray(root), np.asarray(clusters)
    correct = []
    for i in np.flatnonzero(heads):
        followers = (roots == i) & ~heads
        if followers.any():
            values, counts = np.unique(label[followers & (label >= 0)], return_counts=True)
            correct.append(label[i] in values[counts == counts.max(initial=0)])
    return float(np.mean(correct)) if correct else 0.0


def find_roots(leader: ArrayLike) -> Indices:
    """The head of each UAV's tree, ``(N,)`` int64: its own index if it follows none, -1 if its leaders form a cycle.

    >>> find_roots([-1, 0, 1, 3]).tolist()  # UAV 2 follows UAV 1, which follows UAV 0
    [0, 0, 0, 3]
    """
    direct = np.asarray(leader, np.int64)
    indices = np.arange(len(direct))
    root = np.where(direct >= 0, direct, indices)
    for _ in range(len(direct).bit_length()):  # each pass doubles the length of the chains that are followed
        root = root[root]
    is_end = (direct < 0) | (direct == indices)
    return np.where(is_end[root], root, -1)


def find_candidates(detection: Detection) -> Indices:
    """``(N,)``: the candidate that each UAV follows by an answer; a candidate has its own index, -1: none."""
    root = find_roots(detection.list_leaders())
    return np.where((root >= 0) & detection.candidates[root], root, -1)


def list_followers(detection: Detection, head: int) -> list[int]:
    """Indices of those that follow a head, directly or through others; without leaders, those in its cluster.

    A detector may give the head a leader, such as the UAV that is most similar to it; a candidate follows no UAV.
    """
    return [int(i) for i in np.flatnonzero(find_roots(detection.list_leaders()) == head) if i != head]


def group_leader_accuracy(leader: ArrayLike, scores: ArrayLike) -> float:
    """Share of the groups whose head has the highest of its group's scores ``(N,)``; the groups are known.

    If k members tie at the top and the head is one of them, the group counts 1/k. It is 0 without groups.

    >>> group_leader_accuracy(leader=[0, 0, 2, 2], scores=[0.9, 0.1, 0.2, 0.7])
    0.5
    """
    roots, values, shares = find_roots(leader), np.asarray(scores), []
    for head in np.unique(roots[(roots >= 0) & (roots != np.arange(len(roots)))]):
        top = np.flatnonzero(roots == head)
        top = top[values[top] == values[top].max()]
        shares.append((head in top) / len(top))
    return float(np.mean(shares)) if shares else 0.0
