"""Heads or fellows: behind a noisy observer a fellow follower's past tells what one's own noisy past could not."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from detectors.follow_mixture.evidence import affordable_kinds, pairwise_gain
from detectors.follow_mixture.history import OwnHistory
from detectors.follow_mixture.mixture import Mixture, fit_mixture
from detectors.follow_mixture.samples import Samples
from detectors.follow_mixture.strategy import Library, directions

__all__ = ["FELLOW", "heads_of_fellows", "present_to_past"]

_SHARED = 30.0  # nine squared correlations, times the rows, that exceed this are shared: once in 2,000 by chance

FELLOW = 0.3  # the present of a head tells next to nothing beyond its past, that of a fellow more than all its past


def present_to_past(samples: Samples, mixture: Mixture) -> float:
    """What the heads' present adds to the prediction of their followers, relative to what their past gives.

    All followers of a head do the same at once; the head did it before. So the present of a true head adds little
    where flight is not smooth, and that of a fellow follower, who was taken for a head, adds most of all.
    """
    leader = mixture.heads.leader
    followers = np.flatnonzero(leader >= 0)
    if not len(followers):
        return 0.0
    heads = leader[followers]
    predicted, valid = directions(samples, mixture.strategy, followers, heads)
    keep = valid & samples.seen[followers] & samples.seen[heads]
    error = (samples.target[followers] - predicted)[keep]
    present = samples.target[heads][keep]
    if len(error) < 10:
        return 0.0
    error = error - error.mean(axis=0)
    present = present - present.mean(axis=0)
    weights = np.linalg.lstsq(present, error, rcond=None)[0]
    left = ((error - present @ weights) ** 2).sum(axis=0)
    whole = np.maximum((error**2).sum(axis=0), 1e-12)
    added = -0.5 * len(error) * float(np.log(np.clip(left / whole, 1e-6, 1.0)).sum())
    place = np.searchsorted(mixture.columns, heads)
    past = float(mixture.gain[followers, place].sum())
    return added / max(past, 1e-9)


def heads_of_fellows(samples: Samples, history: OwnHistory, mixture: Mixture, most: int | None) -> Mixture | None:
    """The heads of clusters that were found through fellows: among those who fly at another time, by whole clusters.

    Args:
        samples: n UAVs.
        history: the null.
        mixture: right in who flies together, wrong in who leads.
        most: the largest number of heads.

    Returns:
        The best mixture whose heads do not fly at once with their clusters, or ``None``.
    """
    heads = mixture.heads
    together = heads.leader.copy()
    together[heads.heads] = heads.heads
    rest = np.flatnonzero(~at_once(samples, history, together))
    if not len(rest):
        return None
    best: Mixture | None = None
    for kind in affordable_kinds(samples.rows, samples.memory):
        gain = pairwise_gain(samples, history.surprise, kind)
        leader = np.full(samples.uavs, -1, np.int64)
        for head in heads.heads:
            members = together == head
            leader[members] = rest[gain[0][np.ix_(members, rest)].sum(axis=0).argmax()]
        for library in (Library(samples.memory, squares=True), Library(samples.memory, squares=True, isotropic=True)):
            found = fit_mixture(samples, history, leader, library, rest, most)
            if found is not None and len(found.heads.heads) and (best is None or found.value > best.value):
                best = found
    return best


def at_once(samples: Samples, history: OwnHistory, together: NDArray[np.int64]) -> NDArray[np.bool_]:
    """``(n,)`` whether a UAV does at the same time what the others of its cluster do; not so for who is in none."""
    result = np.zeros(samples.uavs, bool)
    surprise = history.surprise
    for label in np.unique(together[together >= 0]):
        members = np.flatnonzero(together == label)
        own = surprise[members]
        others = (own.sum(axis=0, keepdims=True) - own) / max(len(members) - 1, 1)
        product = own.transpose(0, 2, 1) @ others
        power = (own**2).sum(axis=(1, 2))[:, None, None] * (others**2).sum(axis=(1, 2))[:, None, None] / 9.0
        square = samples.rows * product**2 / np.maximum(power, 1e-12)  # each about chi-square where nothing is shared
        result[members] = square.sum(axis=(1, 2)) > _SHARED
    return result
