"""Evidence of single UAVs: followers that move like no other UAV at the same time.

The own regression of such a UAV on its head says little if it has much jitter: fitting 3 p weights costs more than they
explain. But the followers of one head have one law. So a law is fitted to all followers of a candidate but one, and
this one gains as much as that law predicts of it. A UAV that follows no candidate loses by that on average, however
slowly the UAVs turn, so no threshold is needed.

Followers may have different laws, however. So each single UAV may also choose one candidate for itself, if that stands
out from all others.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import betaln

from detectors.follow_mixture.evidence import Pairs, Statistics, Targets, gain_by_laws, pair, screen, whiten
from detectors.follow_mixture.features import LONE, make_features

__all__ = ["LonePairs", "ask_single_uavs"]

Floats = NDArray[np.float64]
Indices = NDArray[np.int64]

_OWN_CHOICE = 3.0  # log prior odds of the law of all followers against a law of the UAV's own
_TURNS = 3  # of choosing the followers of a candidate and fitting their law
_ASKED = 200  # most single UAVs that are asked; bounds time and memory
_NOMINATED = 30  # candidates
_NUMBERS = 4_000_000  # of one array; bounds the memory
_NOTHING = 1e-12


@dataclass(frozen=True, eq=False)
class LonePairs:
    """The pairs of single UAVs and candidates.

    Args:
        pairs: P pairs.
        own: ``(P,)`` what the UAV gains by a law of its own; -inf for candidates that it does not choose.
        asks_more: whether a candidate is among them that is no head yet.
    """

    pairs: Pairs
    own: Floats
    asks_more: bool

    def compare(self, targets: Targets, pairs: Pairs, some: Statistics, evidence: Floats) -> Floats:
        """Evidence ``(P,)`` of these pairs, the last ones of ``pairs``, in one class; ``evidence`` is of all pairs."""
        pooled = _pool(targets, pairs, some, evidence)
        return np.maximum(pooled[len(pooled) - len(self.own) :], self.own)


def ask_single_uavs(targets: Targets, past: Floats, names: Sequence[str], heads: Indices) -> LonePairs:
    """The candidates that single UAVs may follow.

    Args:
        targets: the groups.
        past: ``(n, R, L, 3)`` pasts of the candidates.
        names: the feature classes of laws that followers share.
        heads: the heads of groups of several.
    """
    single = np.flatnonzero(targets.sizes == 1)
    single = single[:: max(-(-len(single) // _ASKED), 1)]
    itself = single[:, None] == targets.label
    choice, gained = _choose(np.where(itself, -np.inf, screen(targets, past, LONE, single)))
    chooses = gained > 0
    new = _nominate(targets, past, names, single)
    own = np.full(itself.shape, -np.inf)
    own[np.flatnonzero(chooses), choice[chooses]] = gained[chooses]
    asked = (np.isin(np.arange(len(past)), np.union1d(heads, new)) | np.isfinite(own)) & ~itself
    place, uav = np.nonzero(asked)
    return LonePairs(pair(targets, single[place], uav), own[place, uav], bool(len(new) or chooses.any()))


def _nominate(targets: Targets, past: Floats, names: Sequence[str], single: Indices) -> Indices:
    """The candidates whose law predicts single UAVs, the best first.

    The screening ignores what a candidate's features share with the own pasts of the single UAVs. What the followers of
    a candidate gain must exceed the description length of the candidate, log n, and of its followers.

    Args:
        targets: the groups.
        past: ``(n, R, L, 3)`` pasts of the candidates.
        names: the feature classes.
        single: ``(c,)`` the groups of one UAV that are asked.
    """
    uavs, rows = past.shape[:2]
    weight = targets.weight[single]
    flat = (targets.innovation[single] * weight[:, :, None]).transpose(1, 0, 2).reshape(rows, -1)
    strength = (weight**2).mean(axis=1)
    energy, effective = targets.energy[single], targets.rows[single]
    precision = 3.0 * effective / energy
    others = targets.label[:, None] != single[None]  # (n, c): no UAV follows itself
    worth = np.zeros(uavs)
    chunk = max(_NUMBERS // (rows * max(len(single), 1)), 1)
    for first in range(0, uavs if len(single) > 1 else 0, chunk):
        part = slice(first, first + chunk)
        for _, features in make_features(past[part], names):
            k, _, width = features.shape
            white = whiten(features).transpose(0, 2, 1).reshape(-1, rows)
            moment = (white @ flat).reshape(k, width, len(single), 3).transpose(0, 2, 1, 3).reshape(k, len(single), -1)
            share = (moment**2).sum(axis=2) / (strength * energy)
            follows = others[part] & (share * (effective - width) > (1.0 - share) * width)  # the F ratio exceeds 1
            for _ in range(_TURNS):
                used = follows * precision
                aim = (used[:, None] @ moment) - used[:, :, None] * moment
                rest = np.maximum((used @ strength)[:, None] - used * strength, _NOTHING)
                by_chance = 3.0 * width * rest / np.maximum((aim**2).sum(axis=2), _NOTHING)
                law = aim * (np.maximum(1.0 - by_chance, 0.0) / rest)[:, :, None]
                left = energy + (law * (strength[:, None] * law - 2.0 * moment)).sum(axis=2)
                gain = -1.5 * effective * np.log(np.maximum(left / energy, _NOTHING)) * others[part]
                before, follows = follows, gain > 0
                if np.array_equal(before, follows):
                    break
            count = (gain > 0).sum(axis=1)
            cost = -betaln(count + 1, len(single) - count + 1)  # of naming the followers: a number, and a choice
            worth[part] = np.maximum(worth[part], np.maximum(gain, 0.0).sum(axis=1) - cost)
    found = np.flatnonzero(worth > np.log(uavs))
    return np.asarray(found[np.argsort(-worth[found], kind="stable")][:_NOMINATED])


def _pool(targets: Targets, pairs: Pairs, some: Statistics, own: Floats) -> Floats:
    """``(P,)``: log-likelihood that each pair gains by the law of the candidate's other followers.

    Followers are, in turns, the groups that gain. A candidate without other followers has no law: 0.

    Args:
        targets: the groups.
        pairs: the pairs.
        some: the statistics of one class.
        own: ``(P,)`` evidence of laws of each group's own; the first followers gain by them.
    """
    weight = (3.0 * targets.rows / targets.energy)[pairs.target]
    gram, moment = some.gram * weight[:, None, None], some.moment * weight[:, None, None]
    candidates, column = np.unique(pairs.uav, return_inverse=True)
    follows = own > 0
    evidence = np.zeros(len(own))
    for _ in range(_TURNS):
        grams = np.zeros((len(candidates), *gram.shape[1:]))
        moments = np.zeros((len(candidates), *moment.shape[1:]))
        np.add.at(grams, column[follows], gram[follows])
        np.add.at(moments, column[follows], moment[follows])
        law = _fit_laws(grams, moments)[column]
        law[follows] = _fit_laws(grams[column[follows]] - gram[follows], moments[column[follows]] - moment[follows])
        evidence = gain_by_laws(targets, pairs, some, law)
        before, follows = follows, evidence > 0
        if np.array_equal(before, follows):
            break
    return evidence


def _fit_laws(gram: Floats, moment: Floats) -> Floats:
    """Laws ``(k, p, 3)``, shrunk by the share of what they explain that 3 p weights explain by chance."""
    width = gram.shape[1]
    ridge = 1e-6 * np.trace(gram, axis1=1, axis2=2) / width + _NOTHING
    law = np.linalg.solve(gram + ridge[:, None, None] * np.eye(width), moment)
    explained = (moment * law).sum(axis=(1, 2))
    return np.asarray(law * np.maximum(1.0 - 3.0 * width / np.maximum(explained, _NOTHING), 0.0)[:, None, None])


def _choose(evidence: Floats) -> tuple[Indices, Floats]:
    """The candidate that each single UAV would follow with a law of its own, ``(c,)``, and what it gains, ``(c,)``.

    The likelihoods of candidates that a UAV does not follow differ by chance, the more the slower the UAVs turn. The
    largest of many exponential variables exceeds the second by their scale on average, and the second exceeds the third
    by half of it. So the first difference, which is the gain, is measured in units of the second ones.

    Args:
        evidence: ``(K, c, n)`` of the screening, -inf for the UAV itself.
    """
    if min(evidence.shape[1:]) < 1 or evidence.shape[2] < 4:
        return np.zeros(evidence.shape[1], np.int64), np.full(evidence.shape[1], -np.inf)
    ranked = -np.partition(-evidence, 2, axis=2)[:, :, :3]
    scale = max(2.0 * float((ranked[:, :, 1] - ranked[:, :, 2]).mean()), 1.0)
    gain = (ranked[:, :, 0] - ranked[:, :, 1]) / scale
    best = gain.argmax(axis=0)
    every = np.arange(evidence.shape[1])
    return evidence[best, every].argmax(axis=1), gain[best, every] - np.log(len(evidence)) - _OWN_CHOICE
