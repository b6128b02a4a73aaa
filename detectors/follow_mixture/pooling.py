"""Evidence of single UAVs: followers that move like no other UAV at the same time.

The own regression of such a UAV on its head says little if it has much jitter: fitting 3 p weights costs more than they
explain. But the followers of one head have one law. So a law is fitted to all followers of a candidate but one, and
this one gains as much as that law predicts of it. A UAV that follows no candidate loses by that on average, however
slowly the UAVs turn, so no threshold is needed.

Followers may have different laws, however. So each single UAV may also choose one candidate for itself, if that stands
out from all others.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import betaln

from detectors.follow_mixture.evidence import (
    OWN_LAW,
    RIDGE,
    Pairs,
    Statistics,
    Targets,
    gain_by_laws,
    pair,
    screen,
    whiten,
)
from detectors.follow_mixture.features import LONE, make_features
from usnet_env.arrays import Floats, Indices, Mask

_TURNS = 3  # of choosing the followers of a candidate and fitting their law
_ASKED = 200  # most single UAVs that are asked; bounds time and memory
_CLASSES = 2  # in which the greedy search goes on
_SHORTLISTED = 100  # candidates that the greedy search compares
_NUMBERS = 4_000_000  # of one array; bounds the memory
_NOTHING = 1e-12


@dataclass(frozen=True, eq=False)
class LonePairs:
    """The pairs of single UAVs and candidates.

    Args:
        pairs: P pairs.
        own: ``(P,)`` what the UAV gains by a law of its own; -inf for candidates that it does not choose.
        asks_more: whether a candidate was nominated or chosen, beside the heads that are known.
        head: ``(C,)`` the heads of the groups, whose laws their single followers share; -1 for none.
    """

    pairs: Pairs
    own: Floats
    asks_more: bool
    head: Indices

    def compare(self, targets: Targets, pairs: Pairs, some: Statistics, evidence: Floats) -> Floats:
        """Evidence ``(P,)`` of these pairs, the last ones of ``pairs``, in one class; ``evidence`` is of all pairs."""
        lone = np.arange(len(evidence)) >= len(evidence) - len(self.own)
        led = self.head[pairs.group] == pairs.uav
        pooled = _pool(targets, pairs, some, np.where(lone, evidence > 0, led), ~lone)
        return np.maximum(pooled[lone], self.own)


def ask_single_uavs(targets: Targets, past: Floats, names: Sequence[str], head: Indices) -> LonePairs:
    """The candidates that single UAVs may follow.

    Args:
        targets: the groups.
        past: ``(n, R, L, 3)`` pasts of the candidates.
        names: the feature classes of laws that followers share.
        head: ``(C,)`` the heads of the groups of several; -1 for none.
    """
    single = np.flatnonzero(targets.sizes == 1)
    single = single[:: max(-(-len(single) // _ASKED), 1)]
    itself = single[:, None] == targets.label
    choice, gained = _choose(np.where(itself, -np.inf, screen(targets, past, LONE, single)))
    chooses = gained > 0
    new = _nominate(targets, past, names, single)
    own = np.full(itself.shape, -np.inf)
    own[np.flatnonzero(chooses), choice[chooses]] = gained[chooses]
    asked = (np.isin(np.arange(len(past)), np.union1d(head[head >= 0], new)) | np.isfinite(own)) & ~itself
    place, uav = np.nonzero(asked)
    return LonePairs(pair(targets, single[place], uav), own[place, uav], bool(len(new) or chooses.any()), head)


def _nominate(targets: Targets, past: Floats, names: Sequence[str], single: Indices) -> Indices:
    """The candidates whose law predicts single UAVs, by a greedy search: the best one, the best one for all others, ...

    The screening ignores what a candidate's features share with the own pasts of the single UAVs. What the followers of
    a candidate gain must exceed their description length.

    Args:
        targets: the groups.
        past: ``(n, R, L, 3)`` pasts of the candidates.
        names: the feature classes.
        single: ``(c,)`` the groups of one UAV that are asked.
    """
    worth = np.full((len(names), len(past)), -np.inf)
    chunk = max(_NUMBERS // (past.shape[1] * max(len(single), 1)), 1)
    every = np.arange(len(past))
    gained = np.zeros(len(single))
    for first in range(0, len(past) if len(single) > 1 else 0, chunk):
        for screening in _screenings(targets, past, every[first : first + chunk], names, single):
            worth[names.index(screening.name), screening.uav], _ = screening.weigh(gained)
    found: list[int] = []
    if worth.max(initial=-np.inf) > 0:
        some = np.argsort(-worth.max(axis=0), kind="stable")[:_SHORTLISTED]
        best = worth.max(axis=1)
        likely = [names[place] for place in np.argsort(-best)[:_CLASSES] if best[place] > 0]
        screenings = list(_screenings(targets, past, some, likely, single))
        while True:
            values, gains = zip(*(screening.weigh(gained) for screening in screenings), strict=True)
            value = np.where(np.isin(some, found), -np.inf, values)
            which, place = np.unravel_index(value.argmax(), value.shape)
            if value[which, place] <= 0:
                break
            found.append(int(some[place]))
            gained = np.maximum(gained, gains[which][place])
    return np.asarray(found, np.int64)


@dataclass(frozen=True, eq=False)
class _Screening:
    """Products of k candidates' features, which are made orthonormal, and the innovations of c single UAVs.

    Args:
        name: of the feature class.
        uav: ``(k,)`` the candidates.
        moment: ``(k, c, 3 p)`` features times innovations.
        others: ``(k, c)`` whether the single UAV is not the candidate.
        strength: ``(c,)`` mean square of the weights of the rows.
        energy: ``(c,)`` of the innovations.
        rows: ``(c,)`` effective number of rows.
    """

    name: str
    uav: Indices
    moment: Floats
    others: Mask
    strength: Floats
    energy: Floats
    rows: Floats

    def weigh(self, gained: Floats) -> tuple[Floats, Floats]:
        """What the followers of each candidate gain, less their description length ``(k,)``; the gains ``(k, c)``.

        Args:
            gained: ``(c,)`` what the single UAVs gain already, by other candidates.
        """
        moment, strength, energy = self.moment, self.strength, self.energy
        width = moment.shape[2] // 3
        share = np.minimum((moment**2).sum(axis=2) / (strength * energy), 1.0 - _NOTHING)
        follows = self.others & (share * (self.rows - width) > (1.0 - share) * width)  # the F ratio exceeds 1
        follows &= -1.5 * self.rows * np.log1p(-share) > gained
        gain = np.zeros(share.shape)
        for _ in range(_TURNS):
            used = follows * (3.0 * self.rows / energy)
            aim = (used[:, None] @ moment) - used[:, :, None] * moment
            rest = np.maximum((used @ strength)[:, None] - used * strength, _NOTHING)
            by_chance = 3.0 * width * rest / np.maximum((aim**2).sum(axis=2), _NOTHING)
            law = aim * (np.maximum(1.0 - by_chance, 0.0) / rest)[:, :, None]
            left = energy + (law * (strength[:, None] * law - 2.0 * moment)).sum(axis=2)
            gain = -1.5 * self.rows * np.log(np.maximum(left / energy, _NOTHING)) * self.others
            before, follows = follows, gain > gained
            if np.array_equal(before, follows):
                break
        count = follows.sum(axis=1)
        naming = -betaln(count + 1, len(gained) - count + 1)  # a number, and a choice
        return np.where(count > 1, np.maximum(gain - gained, 0.0).sum(axis=1) - naming, -np.inf), gain


def _screenings(
    targets: Targets, past: Floats, uav: Indices, names: Sequence[str], single: Indices
) -> Iterator[_Screening]:
    """The products of some candidates with the single UAVs, by class."""
    weight = targets.weight[single]
    flat = (targets.innovation[single] * weight[:, :, None]).transpose(1, 0, 2).reshape(weight.shape[1], -1)
    others = targets.label[uav, None] != single[None]
    for name, features in make_features(past[uav], names):
        k, rows, width = features.shape
        white = whiten(features).transpose(0, 2, 1).reshape(-1, rows)
        moment = (white @ flat).reshape(k, width, len(single), 3).transpose(0, 2, 1, 3).reshape(k, len(single), -1)
        yield _Screening(
            name, uav, moment, others, (weight**2).mean(axis=1), targets.energy[single], targets.rows[single]
        )


def _pool(targets: Targets, pairs: Pairs, some: Statistics, follows: Mask, fixed: Mask) -> Floats:
    """``(P,)``: log-likelihood that each pair gains by the law of the candidate's other followers.

    A candidate without other followers has no law: 0.

    Args:
        targets: the groups.
        pairs: the pairs.
        some: the statistics of one class.
        follows: ``(P,)`` the followers at first; then, in turns, those that gain.
        fixed: ``(P,)`` pairs of which that does not change.
    """
    weight = (3.0 * targets.rows / targets.energy)[pairs.target]
    gram, moment = some.gram * weight[:, None, None], some.moment * weight[:, None, None]
    candidates, column = np.unique(pairs.uav, return_inverse=True)
    evidence = np.zeros(len(weight))
    for _ in range(_TURNS):
        grams = np.zeros((len(candidates), *gram.shape[1:]))
        moments = np.zeros((len(candidates), *moment.shape[1:]))
        np.add.at(grams, column[follows], gram[follows])
        np.add.at(moments, column[follows], moment[follows])
        law = _fit_laws(grams, moments)[column]
        law[follows] = _fit_laws(grams[column[follows]] - gram[follows], moments[column[follows]] - moment[follows])
        evidence = gain_by_laws(targets, pairs, some, law)
        before, follows = follows, np.where(fixed, follows, evidence > 0)
        if np.array_equal(before, follows):
            break
    return evidence


def _fit_laws(gram: Floats, moment: Floats) -> Floats:
    """Laws ``(k, p, 3)``, shrunk by the share of what they explain that 3 p weights explain by chance."""
    width = gram.shape[1]
    ridge = RIDGE * np.trace(gram, axis1=1, axis2=2) / width + _NOTHING
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
    return evidence[best, every].argmax(axis=1), gain[best, every] - np.log(len(evidence)) - OWN_LAW
