"""Fits one window: groups, the evidence of each group for each candidate, the heads, and the posterior."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from detectors.follow_mixture.assignment import Assignment, assign_groups
from detectors.follow_mixture.delays import ask_delays, find_hierarchy
from detectors.follow_mixture.evidence import (
    RARE,
    Pairs,
    Statistics,
    Targets,
    add_rests,
    choose_pairs,
    fit_law,
    gain_by_law,
    gather_statistics,
    make_targets,
    own_evidence,
    pick,
    screen,
)
from detectors.follow_mixture.groups import find_groups, limit_candidates
from detectors.follow_mixture.motion import Motion, filter_tracks, fit_spectra, smoothed_pasts
from detectors.follow_mixture.pooling import MorePairs, ask_about_heads, ask_single_uavs
from detectors.series.direction import SHARES, WEIGHTS, compare_directions
from detectors.series.features import LEVELS, LONE
from detectors.series.projections import NOTHING
from usnet_env.arrays import Floats, Indices

_CERTAIN = 7.0  # log-odds of every UAV at which the search ends
_LEAST_TOGETHER = 0.01  # least prior probability that a head moves with its followers, relative to a single UAV
_ITERATIONS = 8


@dataclass(frozen=True, eq=False)
class Fit:
    """The result for n UAVs."""

    group: Indices  #: ``(n,)`` the group of each UAV
    heads: Indices  #: ``(M,)`` ascending
    leader: Indices  #: ``(n,)`` the UAV that each UAV follows, a head or a relay; -1 for none and for heads
    root: Indices  #: ``(n,)`` the head of each UAV, at the end of its leaders; its own index for heads, -1 for none
    log_odds: Floats  #: ``(n,)`` of leading, before calibration; -inf for UAVs without any evidence
    relays: Floats  #: ``(2, n)``, see :class:`detectors.follow_mixture.delays.Hierarchy`
    leads: Floats  #: ``(M,)`` log-likelihood ratio of each head: that it leads, against a common cause
    gain: Floats  #: ``(n,)`` log-likelihood that the UAV's group gains by its head, in nats
    features: str  #: the class of features that the law uses
    law: Floats | None  #: ``(p, a)`` weights of the shared law, or ``None`` if each group has a law of its own
    value: float  #: gain of all groups less the prices, in nats
    noise: float  #: variance of the position noise, in squared steps of mean speed
    lag: Indices  #: ``(M,)`` the most probable lag of each head's groups, in samples; 0 if no lag explains them alone


@dataclass(frozen=True, eq=False)
class _Search:
    """What all states of the search share."""

    targets: Targets
    past: Floats  #: ``(n, L, a, R)`` of the candidates
    pairs: Pairs  #: those with evidence
    classes: list[Statistics]  #: of the pairs, of K classes
    own: Floats  #: ``(K, P)`` evidence of laws of each pair's own
    most: int | None  #: the largest number of heads

    @classmethod
    def measure(cls, targets: Targets, past: Floats, pairs: Pairs, names: Sequence[str], most: int | None) -> _Search:
        """Measure some pairs in the classes ``names``."""
        classes = gather_statistics(targets, past, pairs, names)
        own = np.array([own_evidence(targets, pairs, some) for some in classes])
        return cls(targets, past, pairs, classes, own, most)

    def add(self, more: MorePairs) -> _Search:
        """This search with more pairs."""
        added, names = more.list_pairs(self.targets, self.pairs), [some.name for some in self.classes]
        others = _Search.measure(self.targets, self.past, added, names, self.most)
        pairs = self.pairs.join(added)
        classes = [some.join(other) for some, other in zip(self.classes, others.classes, strict=True)]
        rows = zip(classes, np.hstack([self.own, others.own]), strict=True)
        own = np.array([more.compare(self.targets, pairs, some, row) for some, row in rows])
        return replace(self, pairs=pairs, classes=classes, own=own)

    @cached_property
    def table(self) -> tuple[Indices, Indices, Indices]:
        """The candidates ``(c,)``, the groups that they are alone, or -1, and the candidates' places of the pairs."""
        candidates, column = np.unique(self.pairs.uav, return_inverse=True)
        own = self.targets.label[candidates]
        return candidates, np.where(self.targets.sizes[own] == 1, own, -1), column

    def assign(self, evidence: Floats) -> Assignment:
        """The heads that a table of evidence ``(P,)`` implies."""
        (candidates, itself, column), sizes = self.table, self.targets.sizes
        gain = np.full((len(sizes), len(candidates)), -np.inf)
        follows = np.where(sizes > 1, np.log(1.0 / RARE - 1.0), 0.0)  # several do, unless their head is not there
        gain[self.pairs.group, column] = evidence + follows[self.pairs.group]
        return assign_groups(gain, candidates, itself, sizes, self.most)

    def explains(self, assignment: Assignment, single: bool = True) -> bool:
        """Whether every group follows, but the heads that are single UAVs; or every group of several."""
        lead = np.zeros(len(self.targets.sizes), bool)
        lead[self.targets.label[assignment.heads]] = True
        alone = self.targets.sizes == 1
        return bool(((assignment.head >= 0) | (alone & (lead | (not single)))).all())

    def chosen(self, assignment: Assignment) -> Indices:
        """The pairs, each a group and its head, of an assignment."""
        return np.flatnonzero(assignment.head[self.pairs.group] == self.pairs.uav)


@dataclass(frozen=True, eq=False)
class _Answer:
    """One state of the search: the evidence ``(P,)`` of all pairs, and the heads that follow from it."""

    search: _Search
    assignment: Assignment
    evidence: Floats
    value: float
    features: str = "each its own"
    law: Floats | None = None

    @property
    def gain(self) -> Floats:
        """``(C,)``: the evidence of each group for its head, 0 without one."""
        chosen, gain = self.search.chosen(self.assignment), np.zeros(len(self.search.targets.sizes))
        gain[self.search.pairs.group[chosen]] = self.evidence[chosen]
        return gain

    def is_certain(self, log_odds: Floats, single: bool) -> bool:
        """Whether no UAV is in doubt and all groups are explained, those of a ``single`` UAV too."""
        return self.search.explains(self.assignment, single) and bool(np.abs(log_odds).min() > _CERTAIN)


def fit_motion(motion: Motion, lags: int, longest: int, most: int | None, rng: np.random.Generator) -> Fit | None:
    """Fit one window; ``None`` if no UAV moves with or after another one.

    A law may use ``lags`` past velocities of a head, fewer in short windows; ``longest`` is the longest delay of a
    follower by itself, in samples, a quarter of the window at most; ``most`` the largest number of heads. ``rng`` draws
    the UAVs that are grouped together in a large swarm.
    """
    velocity = motion.velocity
    lags = min(lags, velocity.shape[1] // 2)
    spectra = fit_spectra(velocity, motion.unit)
    targets = make_targets(velocity, label := find_groups(velocity, spectra, rng), lags)
    past = smoothed_pasts(velocity, spectra, lags)
    several, only = np.flatnonzero(targets.sizes > 1), limit_candidates(label, rng)
    kept = spectra.memory**lags
    more: MorePairs | None = None  # at first no single UAV follows, as heads and decoys do not
    for names in LEVELS:
        pairs = choose_pairs(targets, screen(targets, past, names, several, only), several)
        targets, pairs = add_rests(targets, pairs, velocity)
        search = _Search.measure(targets, past, pairs, names, most)
        found = _search_laws(search if more is None else search.add(more))
        log_odds = _posterior(found, kept)
        certain, complete = (found.is_certain(log_odds, single) for single in (False, True))
        # If single UAVs follow these heads, no further one is needed.
        ask = more is None and certain and not complete
        if ask and (asked := ask_about_heads(targets, past, found.assignment.head)) is not None:
            again = _search_laws(search.add(asked))
            if again.is_certain(odds := _posterior(again, kept), single=True):
                found, log_odds, complete = again, odds, True
        leads = np.union1d(found.assignment.heads, np.flatnonzero(log_odds > 0))
        if more is not None or complete:
            break
        late = ask_delays(targets, velocity, past, leads, found.gain, longest)
        more = ask_single_uavs(targets, past, LEVELS[-1], found.assignment.head, *late)
        if certain and not more.new:
            break
    if found.assignment.value <= 0 and not len(several):
        return None
    order = find_hierarchy(targets, velocity, past, leads, found.assignment.head, found.gain, longest)
    heads, count = np.unique(order.root, return_counts=True)
    heads = heads[(count > 1) & np.isin(heads, order.root[found.assignment.heads])]
    root = np.where(np.isin(order.root, heads), order.root, -1)
    follows = (root >= 0) & (order.leader >= 0)
    known = filter_tracks(velocity, spectra, heads)
    return Fit(
        group=label,
        heads=heads,
        leader=np.where(follows, order.leader, -1),
        root=root,
        log_odds=log_odds,
        relays=order.relays,
        leads=compare_directions(velocity, known, label, root, heads, longest, spectra.noise > 0),
        gain=np.where(follows, order.gain, 0.0),
        features=found.features,
        law=found.law,
        value=found.value,
        noise=spectra.noise,
        lag=_find_lags(found, heads),
    )


def _find_lags(found: _Answer, heads: Indices) -> Indices:
    """``(M,)``: the lag at which each head alone explains best the groups assigned to it; 0 if none does."""
    search, targets, past = found.search, found.search.targets, found.search.past
    chosen, (_, lags, axes, rows) = pick(search.pairs, search.chosen(found.assignment)), past.shape
    each = past[chosen.uav].reshape(-1, 1, axes, rows)  # one candidate for each lag
    pairs = Pairs(np.repeat(chosen.group, lags), np.arange(len(each)), np.repeat(chosen.target, lags))
    classes = gather_statistics(targets, each, pairs, LONE)
    own = np.max([own_evidence(targets, pairs, some) for some in classes], axis=0).reshape(-1, lags)
    evidence, led = np.zeros((len(heads), lags)), np.isin(chosen.uav, heads)
    np.add.at(evidence, np.searchsorted(heads, chosen.uav[led]), own[led])
    return np.where(evidence.max(axis=1) > 0, evidence.argmax(axis=1) + 1, 0)


def _search_laws(search: _Search) -> _Answer:
    """Find the heads: first every group has a law of its own; then groups share one, of each class of features.

    A group may deviate from the shared law; a single UAV pays for it, since most of those fly by themselves. The state
    with the highest value wins. The search ends when a shared law assigns all groups but the heads.
    """
    own = search.own
    each = own.max(axis=0) - np.log(len(own))
    together = search.assign(each)
    best = begin = _Answer(search, together, each, together.value)
    alone = search.targets.sizes[search.pairs.group] == 1
    other = each - np.log(1.0 / RARE - 1.0) * alone
    gained = np.maximum(own, 0.0)
    order = np.argsort(-gained[:, search.chosen(together)].sum(axis=1), kind="stable")
    for start in (begin, None):
        start = best if start is None else start
        for some in order:
            found = _share_law(search, search.classes[some], start.assignment, other)
            if found is not None and found.value > best.value:
                best = found
                if search.explains(found.assignment):
                    return best
    return best


def _share_law(search: _Search, some: Statistics, assignment: Assignment, own: Floats) -> _Answer | None:
    """Fit the law and the heads alternately, within one class; ``own`` ``(P,)`` is the evidence of other laws."""
    best: _Answer | None = None
    axes, variance = search.targets.axes, np.ones(len(search.pairs.group))
    for turn in range(_ITERATIONS):
        used = search.chosen(assignment)
        if not len(used):
            break
        rows = float(search.targets.rows[search.pairs.target[used]].sum())
        law = fit_law(some, used, variance[used])
        shared, variance = gain_by_law(search.targets, search.pairs, some, law)
        evidence = np.maximum(shared, own)
        before, assignment = assignment, search.assign(evidence)
        value = assignment.value - 0.5 * axes * some.width * float(np.log(axes * rows))
        if best is not None and turn > 1 and value <= best.value:
            break
        if best is None or value > best.value:
            best = _Answer(search, assignment, evidence, value, some.name, law)
        if turn > 0 and np.array_equal(before.head, assignment.head):
            break
    return best


def _posterior(found: _Answer, kept: Floats) -> Floats:
    """``(n,)``: log-odds of being a head.

    Every group of two and more UAVs has one head, unless it is not in the window. A priori that is any single UAV, or
    with a smaller probability a member of a group: followers copy their head later, so that it moves with them only as
    far as its velocity predicts that of L steps later, with the autocorrelation ``kept`` ``(n,)``. A UAV that leads
    other followers already has paid the price of a head. The groups are independent. A head follows no UAV.
    """
    targets, pairs = found.search.targets, found.search.pairs
    sizes, uavs = targets.sizes, len(targets.label)
    alone = sizes[targets.label] == 1
    singles, pool, follows = _weigh_single_uavs(found)
    several = sizes > 1
    head = np.where(several, found.assignment.head, -1)
    groups = np.bincount(head[head >= 0], minlength=uavs)
    others = groups[pairs.uav] - (head[pairs.group] == pairs.uav)
    paid = np.where((others > 0) | (pool[pairs.uav] > 0), np.log(uavs), singles[pairs.uav])
    together = max(float(np.median(kept[alone] if alone.sum() > 1 else kept)), _LEAST_TOGETHER)
    prior = np.where(alone, 0.0, np.log(together / sizes[targets.label]))
    row = np.cumsum(several) - 1
    logit = np.tile(np.append(prior, np.log(RARE * np.exp(prior).sum())), (several.sum(), 1))
    some = several[pairs.group]
    logit[row[pairs.group[some]], pairs.uav[some]] += found.evidence[some] + paid[some]
    share = np.exp(logit - logit.max(axis=1, keepdims=True))
    share = share[:, :uavs] / share.sum(axis=1, keepdims=True)
    stays = np.log1p(-np.minimum(share, 1.0 - NOTHING)).sum(axis=0)  # log probability of leading no group of several
    stays -= np.logaddexp(pool, 0.0)
    with np.errstate(divide="ignore"):
        return np.asarray(np.log(-np.expm1(stays)) - stays - follows)


def _weigh_single_uavs(found: _Answer) -> tuple[Floats, Floats, Floats]:
    """What single UAVs say about the n UAVs.

    Each single UAV follows one of the heads found, or none, with equal prior probabilities. A further head is rare, and
    one of n UAVs. An unknown share of the single UAVs follows it: all shares are as probable.

    Returns:
        ``(n,)`` log-likelihood ratio of the single UAVs if this UAV is a head; ``(n,)`` log-odds that it leads single
        UAVs; ``(n,)`` log-odds of following a head itself.
    """
    targets, pairs, heads = found.search.targets, found.search.pairs, found.assignment.heads
    uavs, known = len(targets.label), len(heads)
    lone = targets.sizes[pairs.group] == 1
    candidates, column = np.unique(pairs.uav[lone], return_inverse=True)
    single, row = np.unique(pairs.group[lone], return_inverse=True)
    evidence = np.full((len(single), len(candidates)), -np.inf)
    evidence[row, column] = found.evidence[lone]
    head = np.isin(candidates, heads)
    together = np.logaddexp.reduce(evidence[:, head], axis=1, initial=0.0)  # 0: of following none
    odds = evidence - together[:, None]  # of a further head
    odds[:, head] -= np.log1p(-np.minimum(np.exp(odds[:, head]), 1.0 - NOTHING))  # instead of the other heads
    odds[np.isin(single, targets.label[heads])] = -np.inf
    follows = odds + np.log(np.maximum(known + ~head, 1))  # instead of one of the other heads, or none
    ratio = np.logaddexp(np.log1p(-SHARES), np.log(SHARES) + follows[:, :, None])
    asked = np.isfinite(odds)
    every = np.logaddexp.reduce(np.where(asked[:, :, None], ratio, 0.0).sum(axis=0) + np.log(WEIGHTS), axis=1)
    leads = np.log(np.maximum(-np.expm1(-every - np.log1p(asked.sum(axis=0))), NOTHING))  # that at least one follows
    pool = np.where(targets.sizes[targets.label] == 1, np.log(RARE / uavs), -np.inf)  # without any evidence
    singles, itself = np.zeros(uavs), np.zeros(len(targets.sizes))
    singles[candidates], pool[candidates] = every, every + leads + np.log(RARE / uavs)
    itself[single] = together - np.log1p(known)
    return singles, pool, itself[targets.label]
