"""Evidence of single UAVs: followers that move like no other UAV at the same time.

The own regression of such a UAV on its head says little if it has much jitter: fitting 3 p weights costs more than they
explain. But the followers of one head have one law. So a law is fitted to all followers of a candidate but one, and
this one gains as much as that law predicts of it. A UAV that follows no candidate loses by that on average, however
slowly the UAVs turn, so no threshold is needed.

Followers may have different laws, however. So each single UAV may also choose one candidate for itself, if that stands
out from all others; and :mod:`detectors.follow_mixture.delays` finds the leaders of those with delays of their own.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import prod

import numpy as np
from scipy.special import betaln

from detectors.follow_mixture.delays import ASKED, sample_single_uavs
from detectors.follow_mixture.evidence import RARE, Pairs, Statistics, Targets, gain_by_law, pair, pick, screen
from detectors.series.designs import sum_groups
from detectors.series.features import LONE, make_features
from detectors.series.projections import NOTHING, RIDGE, project
from usnet_env.arrays import Floats, Indices, Mask

_TURNS = 3  # of choosing the followers of a candidate and fitting their law
_CLASSES = 2  # in which the greedy search goes on
_SHORTLISTED = 100  # candidates that the greedy search compares
_NUMBERS = 4_000_000  # of one array; bounds the memory


@dataclass(frozen=True, eq=False)
class MorePairs:
    """Pairs that the first level leaves out: of single UAVs, and of groups that follow with a delay of their own."""

    single: Pairs  #: of single UAVs and candidates
    late: Pairs  #: D pairs of a group, or a single UAV, and a UAV that it follows with a delay
    odds: Floats  #: ``(D,)`` log-odds of these
    new: bool  #: whether a candidate was found beside the heads that are known
    head: Indices  #: ``(C,)`` the heads of the groups, whose laws their single followers share; -1 for none

    def list_pairs(self, targets: Targets, pairs: Pairs) -> Pairs:
        """Those that are not among the ``pairs`` of groups; those of single UAVs are the last ones."""
        new = (targets.sizes[self.late.group] > 1) & ~np.isin(_code(targets, self.late), _code(targets, pairs))
        return pick(self.late, new).join(self.single)

    def compare(self, targets: Targets, pairs: Pairs, some: Statistics, own: Floats) -> Floats:
        """Evidence ``(P,)`` of all ``pairs``, those of single UAVs last, in one class, from that of laws of their own.

        That of a single UAV is by the law of its candidate's other followers.
        """
        groups = len(own) - len(self.single.group)
        follows = np.append(self.head[pairs.group[:groups]] == pairs.uav[:groups], own[groups:] > 0)
        found = np.append(own[:groups], _pool(targets, pairs, some, follows, groups))
        _, place, late = np.intersect1d(_code(targets, pairs), _code(targets, self.late), return_indices=True)
        found[place] = np.maximum(found[place], self.odds[late])
        return found


def _code(targets: Targets, pairs: Pairs) -> Indices:
    """A number for each pair."""
    return np.asarray(pairs.group * len(targets.label) + pairs.uav)


def ask_about_heads(targets: Targets, past: Floats, head: Indices) -> MorePairs | None:
    """Pairs of the other single UAVs and their best candidates if all these are heads ``(C,)`` found, else ``None``."""
    none, heads = np.empty(0, np.int64), head[head >= 0]
    single = np.setdiff1d(np.flatnonzero(targets.sizes == 1), targets.label[heads])
    best = _screen_single_uavs(targets, past, single[:ASKED]).max(axis=0).argmax(axis=1)
    known = len(single) == len(best) and np.isin(best, heads).all()
    return MorePairs(pair(single, best), pair(none, none), np.empty(0), False, head) if known else None


def ask_single_uavs(
    targets: Targets, past: Floats, names: Sequence[str], head: Indices, late: Pairs, odds: Floats
) -> MorePairs:
    """The candidates that single UAVs may follow.

    ``names`` are the feature classes of laws that followers share; ``head`` ``(C,)`` the heads of groups of several, or
    -1; ``late`` D pairs of a group and a UAV that it follows with a delay of its own, and ``odds`` their log-odds.
    """
    single = sample_single_uavs(targets)
    new = _nominate(targets, past, names, single)
    if len(single) and len(past) > 3:
        chosen, gained = _choose(targets, _screen_single_uavs(targets, past, single), single)
        other = ~np.isin(_code(targets, chosen), _code(targets, late))
        late = Pairs(*map(np.append, vars(late).values(), vars(pick(chosen, other)).values()))
        odds = np.append(odds, gained[other])
    asked = np.isin(np.arange(len(past)), np.union1d(head[head >= 0], new)) & (single[:, None] != targets.label)
    alone = np.isin(late.group, single)
    asked[np.searchsorted(single, late.group[alone]), late.uav[alone]] = True
    place, uav = np.nonzero(asked)
    return MorePairs(pair(single[place], uav), late, odds, bool(len(new) or len(odds)), head)


def _screen_single_uavs(targets: Targets, past: Floats, single: Indices) -> Floats:
    """``(K, c, n)``: the evidence of :func:`screen` for ``single`` ``(c,)`` groups of one UAV; -inf for itself."""
    return np.where(single[:, None] == targets.label, -np.inf, screen(targets, past, LONE, single))


def _nominate(targets: Targets, past: Floats, names: Sequence[str], single: Indices) -> Indices:
    """The candidates whose law predicts single UAVs, by a greedy search: the best one, the best one for all others, ...

    The screening ignores what a candidate's features share with the own pasts of the single UAVs. What the followers of
    a candidate gain must exceed their description length. The arguments are those of :func:`_screenings`.
    """
    worth = np.full((len(names), len(past)), -np.inf)
    chunk = max(_NUMBERS // max(past.shape[3] * len(single), past[0].size), 1)
    every = np.arange(len(past))
    gained = np.zeros(len(single))
    kept: list[_Screening] = []
    for first in range(0, len(past) if len(single) > 1 else 0, chunk):
        for screening in _screenings(targets, past, every[first : first + chunk], names, single):
            worth[names.index(screening.name), screening.uav], _ = screening.weigh(gained)
            kept += [screening] if len(past) <= _SHORTLISTED else []
    found: list[int] = []
    if worth.max(initial=-np.inf) > 0:
        some = every if kept else np.argsort(-worth.max(axis=0), kind="stable")[:_SHORTLISTED]
        best = worth.max(axis=1)
        likely = [names[place] for place in np.argsort(-best)[:_CLASSES] if best[place] > 0]
        screenings = [screening for screening in kept if screening.name in likely]
        screenings = screenings or list(_screenings(targets, past, some, likely, single))
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
    """Products ``(k, c, a p)`` of candidates' features, which are made orthonormal, and innovations of single UAVs."""

    name: str  #: of the feature class
    uav: Indices  #: ``(k,)`` the candidates
    moment: Floats  #: the products
    targets: Targets
    single: Indices  #: ``(c,)`` the groups of one UAV that are asked

    def weigh(self, gained: Floats) -> tuple[Floats, Floats]:
        """What the followers of each candidate gain, less their description length ``(k,)``; the gains ``(k, c)``.

        ``gained`` ``(c,)`` is what the single UAVs gain already, by other candidates.
        """
        moment, axes, width = self.moment, self.targets.axes, self.moment.shape[2] // self.targets.axes
        rows, energy = self.targets.rows[self.single], self.targets.energy[self.single]
        strength = (self.targets.weight[self.single] ** 2).mean(axis=1)
        others, square = self.targets.label[self.uav, None] != self.single, np.vecdot(moment, moment)
        share = np.minimum(square / (strength * energy), 1.0 - NOTHING)
        follows = others & (share * (rows - width) > (1.0 - share) * width)  # the F ratio exceeds 1
        follows &= -0.5 * axes * rows * np.log1p(-share) > gained
        gain = np.zeros(share.shape)
        for _ in range(_TURNS):
            used = follows * (axes * rows / energy)
            whole = (used[:, None] @ moment)[:, 0]  # and the aim is that of the other followers: whole less own
            along = (moment @ whole[:, :, None])[:, :, 0]
            aim = np.vecdot(whole, whole)[:, None] - used * (2.0 * along - used * square)
            rest = np.maximum((used @ strength)[:, None] - used * strength, NOTHING)
            shrunk = 1.0 - axes * width * rest / np.maximum(aim, NOTHING)  # by what chance explains
            law = np.where(follows.sum(axis=1)[:, None] > follows, np.maximum(shrunk, 0.0) / rest, 0.0)  # times the aim
            left = energy + law * (strength * law * aim - 2.0 * (along - used * square))
            gain = -0.5 * axes * rows * np.log(np.maximum(left / energy, NOTHING)) * others
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
    flat = (targets.innovation[single] * targets.weight[single, None]).transpose(2, 1, 0).astype(np.float32)
    for name, product in project(*make_features(past[uav], names), flat):
        moment = product.reshape(len(uav), prod(product.shape[1:3]), len(single)).swapaxes(1, 2)
        yield _Screening(name, uav, moment.astype(np.float64, order="C"), targets, single)


def _pool(targets: Targets, pairs: Pairs, some: Statistics, follows: Mask, groups: int) -> Floats:
    """``(k,)``: log-likelihood that the last k pairs, of single UAVs, gain by the law of the other followers.

    A candidate without other followers has no law: 0. ``follows`` ``(P,)`` are the followers at first; then, in turns,
    those that gain, and of the first pairs, of ``groups``, the same as at first.
    """
    weight = (targets.axes * targets.rows / targets.energy)[pairs.target]
    candidates, column = np.unique(pairs.uav, return_inverse=True)
    single = slice(groups, None)
    lone, own, place = pick(pairs, single), some.pick(single), column[single]
    evidence = np.zeros(len(place))
    for _ in range(_TURNS):
        led, behind = np.flatnonzero(follows), np.flatnonzero(follows[single])
        used, row = np.unique(column[led], return_inverse=True)
        gram, moment = (sum_groups(weight[led, None, None] * values[led], row) for values in (some.gram, some.moment))
        law = np.zeros((len(candidates), *some.moment.shape[1:]))
        law[used] = _fit_laws(gram, moment)
        law, others = law[place], row[len(row) - len(behind) :]
        itself = weight[single][behind, None, None]
        law[behind] = _fit_laws(gram[others] - itself * own.gram[behind], moment[others] - itself * own.moment[behind])
        evidence = gain_by_law(targets, lone, own, law)[0]
        before, follows = follows[single], np.append(follows[:groups], evidence > 0)
        if np.array_equal(before, follows[single]):
            break
    return evidence


def _fit_laws(gram: Floats, moment: Floats) -> Floats:
    """Laws ``(k, p, a)``, shrunk by the share of what they explain that 3 p weights explain by chance."""
    width, axes = moment.shape[1:]
    ridge = RIDGE * np.trace(gram, axis1=1, axis2=2) / width + NOTHING
    law = np.linalg.solve(gram + ridge[:, None, None] * np.eye(width), moment)
    explained = (moment * law).sum(axis=(1, 2))
    return np.asarray(law * np.maximum(1.0 - axes * width / np.maximum(explained, NOTHING), 0.0)[:, None, None])


def _choose(targets: Targets, evidence: Floats, single: Indices) -> tuple[Pairs, Floats]:
    """Pairs of a single UAV and the candidate that stands out for it from all others; the log-odds of each.

    The likelihoods of candidates that a UAV does not follow differ by chance, the more the slower the UAVs turn. The
    largest of many exponential variables exceeds the second by their scale on average, and the second exceeds the third
    by half of it. So the first difference, which is the gain, is measured in units of the second ones.

    ``evidence`` ``(K, c, n)`` is that of :func:`_screen_single_uavs`.
    """
    first, second, third = np.moveaxis(-np.partition(-evidence, 2, axis=2)[:, :, :3], 2, 0)
    gain = (first - second) / max(2.0 * float((second - third).mean()), 1.0)
    odds = gain.max(axis=0) - np.log(len(evidence)) - np.log(1.0 / RARE - 1.0)
    choice = evidence[gain.argmax(axis=0), np.arange(len(single))].argmax(axis=1)
    return pair(single[odds > 0], choice[odds > 0]), odds[odds > 0]
