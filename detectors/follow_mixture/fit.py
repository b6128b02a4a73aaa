"""Fits one window: groups, the evidence of each group for each candidate, the heads, and the posterior."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import logsumexp

from detectors.follow_mixture.assignment import Assignment, assign_groups
from detectors.follow_mixture.evidence import (
    OWN_LAW,
    Pairs,
    Statistics,
    Targets,
    choose_pairs,
    fit_law,
    gather_statistics,
    make_targets,
    own_evidence,
    screen,
    shared_evidence,
)
from detectors.follow_mixture.features import LEVELS, LONE
from detectors.follow_mixture.groups import find_groups
from detectors.follow_mixture.motion import Motion, lagged
from detectors.follow_mixture.pooling import LonePairs, ask_single_uavs
from detectors.follow_mixture.spectra import fit_spectra, smoothed_pasts
from detectors.series.votes import find_trees
from usnet_env.arrays import Floats, Indices

_CERTAIN = 7.0  # log-odds of every UAV at which the search ends
_RARE = 0.05  # prior probability: the head of a group is not in the window, leads single UAVs only, is a relay
_LEAST_TOGETHER = 0.01  # least prior probability that a head moves with its followers, relative to a single UAV
_RELAY = 1 / 3  # least share of a relay's innovations that its leader explains
_ITERATIONS = 8
_NOTHING = 1e-12


@dataclass(frozen=True, eq=False)
class Fit:
    """The result for n UAVs.

    Args:
        group: ``(n,)`` the group of each UAV.
        heads: ``(M,)`` ascending.
        leader: ``(n,)`` the UAV that each UAV follows, a head or a relay; -1 for none and for heads.
        root: ``(n,)`` the head of each UAV, at the end of its leaders; its own index for heads, -1 for none.
        log_odds: ``(n,)`` of leading, before calibration; -inf for UAVs without any evidence.
        relays: ``(2, n)`` log-odds that the UAV follows one that leads, and that a relay follows it; -inf: not asked.
        gain: ``(n,)`` log-likelihood that the UAV's group gains by its head, in nats.
        features: the class of features that the law uses.
        law: ``(p, 3)`` weights of the shared law, or ``None`` if each group has a law of its own.
        value: gain of all groups less the prices, in nats.
        noise: variance of the position noise, in squared steps of mean speed.
        lag: ``(M,)`` the most probable lag of each head's groups, in samples; 0 if no lag explains them alone.
    """

    group: Indices
    heads: Indices
    leader: Indices
    root: Indices
    log_odds: Floats
    relays: Floats
    gain: Floats
    features: str
    law: Floats | None
    value: float
    noise: float
    lag: Indices


@dataclass(frozen=True, eq=False)
class _Answer:
    """One state of the search: the evidence ``(P,)`` of all pairs, and the heads that follow from it."""

    assignment: Assignment
    evidence: Floats
    value: float
    features: str = "each its own"
    law: Floats | None = None


@dataclass(frozen=True, eq=False)
class _Search:
    """What all states of the search share: targets, pairs, and the tables that :func:`assign_groups` reads.

    Args:
        targets: the groups.
        pairs: the pairs with evidence.
        most: the largest number of heads.
    """

    targets: Targets
    pairs: Pairs
    most: int | None

    def assign(self, evidence: Floats) -> Assignment:
        """The heads that a table of evidence ``(P,)`` implies."""
        candidates, column = np.unique(self.pairs.uav, return_inverse=True)
        sizes = self.targets.sizes
        gain = np.full((len(sizes), len(candidates)), -np.inf)
        follows = np.where(sizes > 1, np.log(1.0 / _RARE - 1.0), 0.0)  # several do, unless their head is not there
        gain[self.pairs.group, column] = evidence + follows[self.pairs.group]
        own = self.targets.label[candidates]
        return assign_groups(gain, candidates, np.where(sizes[own] == 1, own, -1), sizes, self.most)

    def explains(self, assignment: Assignment, single: bool = True) -> bool:
        """Whether every group follows, but the heads that are single UAVs; or every group of several."""
        lead = np.zeros(len(self.targets.sizes), bool)
        lead[self.targets.label[assignment.heads]] = True
        alone = self.targets.sizes == 1
        return bool(((assignment.head >= 0) | (alone & (lead | (not single)))).all())

    def chosen(self, assignment: Assignment) -> Indices:
        """The pairs, each a group and its head, of an assignment."""
        return np.flatnonzero(assignment.head[self.pairs.group] == self.pairs.uav)


def fit_motion(motion: Motion, lags: int, most: int | None, rng: np.random.Generator) -> Fit | None:
    """Fit one window.

    Args:
        motion: the velocities of n UAVs.
        lags: the number of past velocities of a head that a law may use; fewer in short windows.
        most: the largest number of heads, or ``None``.
        rng: draws the UAVs that are grouped together in a large swarm.

    Returns:
        ``None`` if no UAV moves with or after another one.
    """
    velocity = motion.velocity
    lags = min(lags, velocity.shape[1] // 2)
    spectra = fit_spectra(velocity, motion.unit)
    targets = make_targets(velocity, label := find_groups(velocity, spectra, rng), lags)
    past = smoothed_pasts(velocity, spectra, lags) if spectra.noise > 0 else lagged(velocity, lags)
    several = np.flatnonzero(targets.sizes > 1)
    lone: LonePairs | None = None  # at first no single UAV follows, as heads and decoys do not
    for names in LEVELS:
        pairs = choose_pairs(targets, screen(targets, past, names, several), several)
        if lone is not None:
            pairs = Pairs(*map(np.append, vars(pairs).values(), vars(lone.pairs).values()))
        classes = gather_statistics(targets, past, pairs, names)
        own = np.array([own_evidence(targets, pairs, some) for some in classes])
        if lone is not None:
            for values, some in zip(own, classes, strict=True):
                values[len(values) - len(lone.own) :] = lone.compare(targets, pairs, some, values)
        search = _Search(targets, pairs, most)
        found = _search_laws(search, classes, own)
        log_odds = _posterior(search, found, spectra.memory**lags)
        certain = np.abs(log_odds).min() > _CERTAIN
        if lone is not None or (certain and search.explains(found.assignment)):
            break
        lone = ask_single_uavs(targets, past, LEVELS[-1], found.assignment.head)
        if certain and search.explains(found.assignment, single=False) and not lone.asks_more:
            break
    if found.assignment.value <= 0 and not (targets.sizes > 1).any():
        return None
    leads = np.union1d(found.assignment.heads, np.flatnonzero(log_odds > 0))
    leader = found.assignment.head[label]
    single = np.flatnonzero((targets.sizes[label] == 1) & (leader < 0))
    above, top, follows = _find_relays(velocity, past, leads, single)
    heads = np.unique(top[np.isin(leads, found.assignment.heads)])  # no more than the assignment has
    relay, ends = above >= 0, np.isin(above, np.setdiff1d(top, leads[above >= 0]))
    relays = np.full((2, len(leader)), -np.inf)
    relays[0, leads] = follows
    np.maximum.at(relays[1], above[ends], follows[ends])
    leader[leads[relay]] = above[relay]
    leader[np.append(heads, above[ends])] = -1
    root = np.where(leader >= 0, leader, np.arange(len(leader)))
    for _ in leads:
        root = root[root]
    chosen = search.chosen(found.assignment)
    behind = Pairs(pairs.group[chosen], pairs.uav[chosen], pairs.target[chosen])
    gain = np.zeros(len(targets.sizes))
    gain[pairs.group[chosen]] = found.evidence[chosen]
    return Fit(
        group=label,
        heads=heads,
        leader=leader,
        root=np.where(np.isin(root, heads), root, -1),
        log_odds=log_odds,
        relays=relays,
        gain=np.where(leader >= 0, gain[label], 0.0),
        features=found.features,
        law=found.law,
        value=found.value,
        noise=spectra.noise,
        lag=_find_lags(targets, past, behind, heads),
    )


def _find_relays(velocity: Floats, past: Floats, leads: Indices, others: Indices) -> tuple[Indices, Indices, Floats]:
    """Tell relays from heads: a relay leads UAVs and follows another UAV, which leads or follows none.

    Two UAVs that turn alike by chance predict each other alike. So the evidence that one follows the other counts only
    as far as it exceeds that of the reverse, and that of a leader that explains little.

    Args:
        velocity: ``(n, T, 3)``.
        past: ``(n, R, L, 3)`` pasts of the candidates.
        leads: ``(M,)`` the UAVs that lead.
        others: the UAVs that follow none.

    Returns:
        ``(M,)`` the UAV that each follows, -1 for heads, the one at the end of its leaders, and the log-odds.
    """
    above, lags = np.union1d(leads, others), velocity.shape[1] - past.shape[1]

    def compare(behind: Indices, ahead: Indices) -> tuple[Floats, Floats]:
        alone = make_targets(velocity[behind], np.arange(len(behind)), lags)
        return alone.rows[: len(behind)], screen(alone, past[ahead], LEVELS[0], alone.label).max(axis=0, initial=0.0)

    rows, best = compare(leads, above)
    reverse = best if len(above) == len(leads) else compare(above, leads)[1]
    least = -1.5 * rows[:, None] * np.log1p(-_RELAY)
    price = np.log(1.0 / _RARE - 1.0) + np.log(max(len(above) - 1, 1) * len(LEVELS[0]))
    odds = best - reverse.T - least - price
    odds[leads[:, None] == above] = -np.inf
    some = np.isin(above, leads) | (odds > 0).any(axis=0)
    wide, strength = np.full((2, some.sum(), some.sum()), -np.inf)
    place = np.searchsorted(above[some], leads)
    wide[place], strength[place] = odds[:, some], best[:, some]
    direct, root = (found[place] for found in find_trees(wide, strength, 0.0))
    return np.where(direct >= 0, above[some][direct], -1), above[some][root], odds.max(axis=1, initial=-np.inf)


def _find_lags(targets: Targets, past: Floats, chosen: Pairs, heads: Indices) -> Indices:
    """The lag at which each head's velocity, or its squares, explains best alone the groups ``chosen`` that follow it.

    Args:
        targets: the groups.
        past: ``(n, R, L, 3)`` pasts of the candidates.
        chosen: pairs of a group and its head.
        heads: ``(M,)`` ascending.

    Returns:
        ``(M,)`` lags in samples, from 1; 0 where no lag has evidence.
    """
    evidence = np.zeros((past.shape[2], len(heads)))
    for lag, gained in enumerate(evidence):
        classes = gather_statistics(targets, past[:, :, lag : lag + 1], chosen, LONE)
        own = np.max([own_evidence(targets, chosen, some) for some in classes], axis=0)
        led = np.isin(chosen.uav, heads)
        np.add.at(gained, np.searchsorted(heads, chosen.uav[led]), own[led])
    return np.where(evidence.max(axis=0) > 0, evidence.argmax(axis=0) + 1, 0)


def _search_laws(search: _Search, classes: list[Statistics], own: Floats) -> _Answer:
    """Find the heads: first every group has a law of its own; then groups share one, of each class of features.

    A group may deviate from the shared law, at a price. The state with the highest value wins. The search ends when a
    shared law assigns all groups but the heads.

    Args:
        search: the groups and pairs.
        classes: the statistics of all classes.
        own: ``(K, P)`` evidence of laws of each group's own, by class.
    """
    each = own.max(axis=0) - np.log(len(own))
    together = search.assign(each)
    best = begin = _Answer(together, each, together.value)
    gained = np.maximum(own, 0.0)
    order = np.argsort(-gained[:, search.chosen(together)].sum(axis=1), kind="stable")
    for start in (begin, None):
        start = best if start is None else start
        for some in order:
            found = _share_law(search, classes[some], start.assignment, each - OWN_LAW)
            if found is not None and found.value > best.value:
                best = found
                if search.explains(found.assignment):
                    return best
    return best


def _share_law(search: _Search, some: Statistics, assignment: Assignment, own: Floats) -> _Answer | None:
    """Fit the law and the heads alternately, within one class; ``own`` ``(P,)`` is the evidence of other laws."""
    best: _Answer | None = None
    variance = np.ones(len(search.pairs.group))
    for turn in range(_ITERATIONS):
        used = search.chosen(assignment)
        if not len(used):
            break
        rows = float(search.targets.rows[search.pairs.target[used]].sum())
        law = fit_law(some, used, variance[used])
        shared, variance = shared_evidence(search.targets, search.pairs, some, law)
        evidence = np.maximum(shared, own)
        before, assignment = assignment, search.assign(evidence)
        value = assignment.value - 1.5 * some.width * float(np.log(3.0 * rows))
        if best is not None and turn > 1 and value <= best.value:
            break
        if best is None or value > best.value:
            best = _Answer(assignment, evidence, value, some.name, law)
        if turn > 0 and np.array_equal(before.head, assignment.head):
            break
    return best


def _posterior(search: _Search, found: _Answer, kept: Floats) -> Floats:
    """``(n,)``: log-odds of being a head.

    Every group of two and more UAVs has one head, unless it is not in the window. A priori that is any single UAV, or
    with a smaller probability a member of a group: followers copy their head later, so that it moves with them only as
    far as its velocity predicts that of L steps later. A UAV that leads other followers already has paid the price of a
    head. The groups are independent. A head follows no UAV.

    Args:
        search: the groups and pairs.
        found: the heads and the evidence.
        kept: ``(n,)`` autocorrelation of each UAV's velocity at lag L.
    """
    targets, pairs = search.targets, search.pairs
    sizes, uavs = targets.sizes, len(targets.label)
    alone = sizes[targets.label] == 1
    pool, follows = _weigh_single_uavs(search, found)

    several = sizes > 1
    head = np.where(several, found.assignment.head, -1)
    groups = np.bincount(head[head >= 0], minlength=uavs)
    others = groups[pairs.uav] - (head[pairs.group] == pairs.uav)
    paid = np.where((others > 0) | (pool[pairs.uav] > 0), np.log(uavs), 0.0)
    together = max(float(np.median(kept[alone] if alone.sum() > 1 else kept)), _LEAST_TOGETHER)
    prior = np.where(alone, 0.0, np.log(together / sizes[targets.label]))
    row = np.cumsum(several) - 1
    logit = np.tile(np.append(prior, np.log(_RARE * np.exp(prior).sum())), (several.sum(), 1))
    some = several[pairs.group]  # pairs that were not chosen have no evidence
    logit[row[pairs.group[some]], pairs.uav[some]] += found.evidence[some] + paid[some]
    share = np.exp(logit - logsumexp(logit, axis=1, keepdims=True))[:, :uavs]
    stays = np.log1p(-np.minimum(share, 1.0 - _NOTHING)).sum(axis=0)  # log probability of leading no group of several
    stays -= np.logaddexp(pool, 0.0)
    with np.errstate(divide="ignore"):
        return np.asarray(np.log(-np.expm1(stays)) - stays - follows)


def _weigh_single_uavs(search: _Search, found: _Answer) -> tuple[Floats, Floats]:
    """``(n,)``: log-odds that a UAV leads two or more single UAVs; and ``(n,)``: log-odds of following a head itself.

    Each single UAV follows one of the heads found, or none, with equal prior probabilities. A further head is rare, and
    one of n UAVs.
    """
    targets, pairs, heads = search.targets, search.pairs, found.assignment.heads
    uavs, known = len(targets.label), len(heads)
    lone = targets.sizes[pairs.group] == 1
    candidates, column = np.unique(pairs.uav[lone], return_inverse=True)
    single, row = np.unique(pairs.group[lone], return_inverse=True)
    evidence = np.full((len(single), len(candidates)), -np.inf)
    evidence[row, column] = found.evidence[lone]
    head = np.isin(candidates, heads)
    together = logsumexp(np.c_[evidence[:, head], np.zeros(len(single))], axis=1)  # 0: of following none
    odds = evidence - together[:, None]  # of a further head
    odds[:, head] -= np.log1p(-np.minimum(np.exp(odds[:, head]), 1.0 - _NOTHING))  # instead of the other heads
    odds[np.isin(single, targets.label[heads])] = -np.inf
    count = np.isfinite(odds).sum(axis=0)
    every = np.logaddexp(odds, 0.0).sum(axis=0)
    fewer = np.logaddexp(np.logaddexp.reduce(odds, axis=0, initial=-np.inf), 0.0)  # none or one: no head
    led = every + np.log(np.maximum(-np.expm1(np.minimum(fewer - every, 0.0)), _NOTHING))
    led += np.log(_RARE / uavs) - count * np.log1p(1.0 / np.maximum(known + ~head, 1))
    pool = np.where(targets.sizes[targets.label] == 1, np.log(_RARE / uavs), -np.inf)  # without any evidence
    pool[candidates] = np.where(count > 1, led, -np.inf)
    itself = np.full(len(targets.sizes), 0.0)
    itself[single] = together - np.log1p(known)
    return pool, itself[targets.label]
