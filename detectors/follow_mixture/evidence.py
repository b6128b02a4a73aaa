"""Evidence that a group follows a UAV: how much the UAV's past adds to the group's own past as a predictor.

The mean velocity y of a group is regressed on Z, a constant and the group's own past, which leaves the innovations e.
The features of a candidate's past, less what Z explains of them, explain a part of e. Two laws are compared:

* *own*: the group has a law of its own. With weights of a g-prior, whose g is estimated for each pair, the log Bayes
  factor has a closed form (Liang et al. 2008, "Mixtures of g priors for Bayesian variable selection", local empirical
  Bayes).
* *shared*: all groups have the same weights; each group has an error variance of its own.

Both need nothing but cross products of e, Z and the features, which are computed once per pair.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from detectors.follow_mixture.motion import lagged
from detectors.series.designs import sum_groups
from detectors.series.features import SCREENED, make_features
from detectors.series.projections import (
    NOTHING,
    RIDGE,
    explain_each,
    explain_exactly,
    multiply_pairs,
    orthonormalise,
    project,
)
from usnet_env.arrays import Floats, Indices, Mask

RARE = 0.05  # prior probability: a group's head is not in the window or leads single UAVs only, a UAV has its own law
_ROWS_A_LAG = 12  # rows of a window per lag of the own past in Z
_GRAIN = 1e-3  # innovations below this share of the mean speed are rounding of the positions
_ASKED = 3  # candidates of each sort that a class nominates for a group; their evidence is exact
_CHUNK = 250  # groups, candidates or pairs; bounds the memory, and larger arrays are slower
_FREEDOM = 4.0  # of the t distribution whose weights the rows have: a sharp turn counts little more than other rows
_MEDIAN = {1: 0.455, 2: 1.386, 3: 2.366}  # of a chi-square variable, by its degrees of freedom
_LEAST_SPREAD = 0.005  # least standard deviation of an innovation, in mean speeds


@dataclass(frozen=True, eq=False)
class Targets:
    """G targets, to be explained: C groups, then some of them without one member, which is a candidate."""

    label: Indices  #: ``(n,)`` the group of each UAV
    innovation: Floats  #: ``(G, a, R)`` e
    own: Floats  #: ``(G, z, R)`` orthonormal rows that span Z
    weight: Floats  #: ``(G, R)`` weight of each row, in units of which e and Z are
    rows: Floats  #: ``(G,)`` effective number of rows: R - z, less if a few hold most of |e|² or if e is not white
    least: float = 0.0  #: the least share of |e|² that a leader explains

    @cached_property
    def sizes(self) -> Indices:
        """``(C,)`` number of UAVs of each group."""
        return np.bincount(self.label)

    @property
    def axes(self) -> int:
        """Number of axes, a: each is a regression by itself."""
        return int(self.innovation.shape[1])

    @property
    def grain(self) -> float:
        """Energy of rounding."""
        return self.axes * self.innovation.shape[2] * _GRAIN**2

    @cached_property
    def energy(self) -> Floats:
        """``(G,)`` |e|², and the energy of rounding, which no candidate explains."""
        return np.asarray((self.innovation**2).sum(axis=(1, 2)) + self.grain)


@dataclass(frozen=True, eq=False)
class Pairs:
    """P pairs of a group and a candidate."""

    group: Indices
    uav: Indices  #: the candidate
    target: Indices  #: row of :class:`Targets`: the group, without the candidate if that is a member

    def join(self, others: Pairs) -> Pairs:
        """These pairs, and others."""
        return Pairs(*map(np.append, vars(self).values(), vars(others).values()))


@dataclass(frozen=True, eq=False)
class Statistics:
    """Cross products of one feature class, for P pairs."""

    name: str
    moment: Floats  #: ``(P, p, a)`` features times innovations
    gram: Floats  #: ``(P, p, p)`` features times features, less what the own past explains of them

    @property
    def width(self) -> int:
        """Number of features, p."""
        return int(self.gram.shape[1])

    def pick(self, places: slice) -> Statistics:
        """Those of some of the pairs."""
        return Statistics(self.name, self.moment[places], self.gram[places])

    def join(self, others: Statistics) -> Statistics:
        """Those of these pairs, and of others."""
        moment, gram = np.concatenate([self.moment, others.moment]), np.concatenate([self.gram, others.gram])
        return Statistics(self.name, moment, gram)


def make_targets(velocity: Floats, label: Indices, lags: int, least: float = 0.0) -> Targets:
    """Compute the innovations of the groups ``label`` ``(n,)`` of UAVs with the velocities ``(n, T, a)``.

    The rows are the steps from L, ``lags``, on. A leader explains the share ``least`` of the innovations.
    """
    sizes = np.bincount(label)
    return Targets(label, *_innovate(sum_groups(velocity, label) / sizes[:, None, None], lags), least)


def add_rests(targets: Targets, pairs: Pairs, velocity: Floats) -> tuple[Targets, Pairs]:
    """Add the groups without the members that are their candidates; the pairs of these refer to them."""
    member = np.flatnonzero(targets.label[pairs.uav] == pairs.group)
    group, uav = pairs.group[member], pairs.uav[member]
    groups, lags = len(targets.sizes), velocity.shape[1] - targets.innovation.shape[2]
    rest = sum_groups(velocity, targets.label)[group] - velocity[uav]
    added = _innovate(rest / (targets.sizes[group] - 1)[:, None, None], lags)
    four = (targets.innovation, targets.own, targets.weight, targets.rows)
    e, own, weight, rows = (np.concatenate([some[:groups], more]) for some, more in zip(four, added, strict=True))
    target = pairs.group.copy()
    target[member] = groups + np.arange(len(member))
    return Targets(targets.label, e, own, weight, rows, targets.least), Pairs(pairs.group, pairs.uav, target)


def _innovate(mean: Floats, lags: int) -> tuple[Floats, Floats, Floats, Floats]:
    """Innovations, own pasts, weights and rows, as :class:`Targets` has them, of mean velocities ``(G, T, a)``."""
    count, steps, axes = mean.shape
    rows = steps - lags
    own_lags = int(np.clip(rows // _ROWS_A_LAG, 1, lags))
    width = 1 + axes * own_lags
    innovation, own, weight = np.empty((count, axes, rows)), np.empty((count, width, rows)), np.empty((count, rows))
    for first in range(0, count, _CHUNK):
        part = slice(first, first + _CHUNK)
        target = mean[part, lags:].transpose(0, 2, 1)
        past = lagged(mean[part], lags)[:, :own_lags].reshape(len(target), -1, rows)
        known = np.concatenate([np.ones((len(past), 1, rows)), past], axis=1)
        square = (_residuals(orthonormalise(known), target) ** 2).sum(axis=1)
        scale = np.maximum(np.median(square, axis=1, keepdims=True) / _MEDIAN[axes], _LEAST_SPREAD**2)
        weight[part] = 1.0 / np.sqrt(1.0 + square / (_FREEDOM * scale))
        own[part] = orthonormalise(known * weight[part, None])
        innovation[part] = _residuals(own[part], target * weight[part, None])
    # Fewer rows count where a few sharp turns hold most of the energy, or where innovations are not white. The shares
    # of normal and white ones are a / (a + 2) and a / (a + 1).
    steady = (axes + 2) / axes * _participation((innovation**2).sum(axis=1))
    share = np.minimum(np.minimum(steady, (axes + 1) / axes * _whiteness(innovation)), 1.0)
    return innovation, own, weight, np.minimum(rows * share, rows - width)


def _whiteness(innovation: Floats) -> Floats:
    """Share of independent rows ``(G,)``, for features with the spectrum of the innovations (Bartlett's formula)."""
    return _participation((np.abs(np.fft.rfft(innovation)[:, :, 1:]) ** 2).sum(axis=1))


def _participation(values: Floats) -> Floats:
    """``(k,)``: the share of ``values`` ``(k, m)`` that hold their sum: 1 if all are equal, 1/m if one is not 0."""
    return np.asarray(values.mean(axis=1) ** 2 / np.maximum((values**2).mean(axis=1), NOTHING**2))


def _residuals(known: Floats, target: Floats) -> Floats:
    """``(k, a, R)``: what orthonormal rows ``(k, z, R)`` leave of targets."""
    return np.asarray(target - (target @ known.transpose(0, 2, 1)) @ known)


def bayes_factor(share: Floats, rows: Floats, width: int, axes: int) -> Floats:
    """Log Bayes factor of a regression of all axes on ``width`` features that explain ``share``, against none."""
    share = np.clip(np.asarray(share, np.float64), 0.0, 1.0 - NOTHING)  # in single precision, the limit would be 1
    free = np.maximum(rows - width, 1.0)
    strength = np.maximum(share * free / ((1.0 - share) * width) - 1.0, 0.0)  # g: the F ratio less 1
    factor = 0.5 * axes * free * np.log1p(strength) - 0.5 * axes * rows * np.log1p(strength * (1.0 - share))
    return np.asarray(np.where(rows > width + 1.0, factor, 0.0))


def screen(
    targets: Targets, past: Floats, names: Sequence[str], groups: Indices, only: Indices | None = None
) -> Floats:
    """``(K, c, n)``: evidence of laws of each group's own, for all candidates and K classes.

    Classes of three features are compared in single precision; for larger ones the screening ignores the weights of the
    rows and what a candidate's features share with the group's own past.

    ``past`` ``(n, L, a, R)`` are those of the candidates, and ``names`` the feature classes; those that others contain
    are left out. ``groups`` ``(c,)`` are screened. ``only`` ``(n,)`` is the single group of which each UAV is a
    candidate; -1 or ``None``: of all.
    """
    weight = targets.weight[groups][:, None]
    rows = targets.rows[groups, None]
    price = -0.5 * targets.axes * rows * np.log1p(-targets.least)  # what a leader gains that explains the least share
    # Single precision is enough to order the candidates, and this is most of the work in a large swarm.
    every_target = [
        np.ascontiguousarray(values.transpose(2, 1, 0), np.float32)  # (R, a or z, C)
        for values in (
            np.concatenate([targets.innovation[groups], targets.own[groups]], axis=1) * weight,
            targets.innovation[groups] / weight,
            weight**2,
        )
    ]
    energy = targets.energy[groups][:, None], ((every_target[1] ** 2).sum(axis=(0, 1)) + targets.grain)[:, None]
    screened = [name for name in names if name in SCREENED]
    evidence = np.zeros((len(screened), len(groups), len(past)))
    only = np.full(len(past), -1) if only is None else only
    every, uavs = np.count_nonzero(only < 0), len(past)
    order = np.argsort(only, kind="stable")
    for part in np.split(order, [*range(_CHUNK, every, _CHUNK), *range(every, uavs, _CHUNK)]):
        valid = (only[part] < 0) | (only[part] == groups[:, None])
        some = np.flatnonzero(valid.any(axis=1))
        both, plain, square = (values.take(some, axis=2) for values in every_target)
        features, columns = make_features(past[part], screened)
        large = {name: used for name, used in columns.items() if len(used) > targets.axes}
        explained = {
            name: np.square(product, out=product).sum(axis=(1, 2)).T / energy[1][some]
            for name, product in project(features, large, plain)
        }
        for number, (name, used) in enumerate(columns.items()):
            if name not in large:
                explained[name] = explain_exactly(features[:, used], both, square[:, 0]) / energy[0][some]
            gained = bayes_factor(explained[name], rows[some], len(used), targets.axes) - price[some]
            evidence[number, some[:, None], part] = np.where(valid[some], gained, 0.0)
    return evidence


def choose_pairs(targets: Targets, evidence: Floats, groups: Indices) -> Pairs:
    """The candidates of screened groups ``(c,)``: every class nominates single UAVs, members of the group and others.

    ``evidence`` ``(K, c, n)`` is that of :func:`screen` for these groups.
    """
    inside = targets.label[None] == groups[:, None]
    alone = targets.sizes[targets.label] == 1
    asked = np.zeros(evidence.shape[1:], bool)
    for sort in (alone & ~inside, ~alone & ~inside, inside):
        for values in evidence:
            some = np.flatnonzero((sort & (values > 0.0)).any(axis=0))
            asked[:, some] |= _find_highest(np.where(sort[:, some], values[:, some], 0.0))
    place, uav = np.nonzero(asked)
    return pair(groups[place], uav)


def _find_highest(values: Floats) -> Mask:
    """Which of the ``values`` ``(k, n)`` are positive and among the highest of their row."""
    if values.shape[1] <= _ASKED:
        return values > 0.0
    left, rows = values.copy(), np.arange(len(values))
    for _ in range(_ASKED - 1):
        left[rows, left.argmax(axis=1)] = -np.inf
    return (values >= left.max(axis=1, keepdims=True)) & (values > 0.0)


def pair(group: Indices, uav: Indices) -> Pairs:
    """The pairs of groups ``(P,)`` and candidates ``(P,)``; the whole group is to be explained."""
    return Pairs(group, uav, group)


def pick(pairs: Pairs, places: Indices | Mask | slice) -> Pairs:
    """Some of the pairs."""
    return Pairs(pairs.group[places], pairs.uav[places], pairs.target[places])


def gather_statistics(targets: Targets, past: Floats, pairs: Pairs, names: Sequence[str]) -> list[Statistics]:
    """Compute the cross products of the feature classes ``names`` for the pairs; ``past`` ``(n, L, a, R)``."""
    asked, place = np.unique(pairs.uav, return_inverse=True)
    features, columns = make_features(past[asked], names)
    moment, gram, power = multiply_pairs(features, targets.weight, targets.innovation, targets.own, place, pairs.target)
    found = []
    for name, used in columns.items():
        ridge = RIDGE * power[:, used].mean(axis=1) + NOTHING
        own = gram[:, used[:, None], used] + ridge[:, None, None] * np.eye(len(used))
        found.append(Statistics(name, moment[:, used], own))
    return found


def own_evidence(targets: Targets, pairs: Pairs, statistics: Statistics) -> Floats:
    """``(P,)``: log Bayes factor of each pair with a law of its own."""
    share = explain_each(statistics.gram, statistics.moment) / targets.energy[pairs.target]
    return bayes_factor(share, targets.rows[pairs.target], statistics.width, targets.axes)


def fit_law(statistics: Statistics, used: Indices, variance: Floats) -> Floats:
    """Weights ``(p, a)`` of one law for the pairs ``used`` ``(k,)``, with error variances ``(k,)``."""
    gram, moment = ((each[used].T @ (1.0 / variance)).T for each in (statistics.gram, statistics.moment))
    return np.asarray(np.linalg.solve(gram, moment))


def gain_by_law(targets: Targets, pairs: Pairs, statistics: Statistics, law: Floats) -> tuple[Floats, Floats]:
    """Log-likelihood that each pair gains by a law ``(p, a)``, or its own ``(P, p, a)``, which is given; both ``(P,)``.

    Each pair has an error variance of its own per axis and row, which is returned too.
    """
    power, rows = targets.energy[pairs.target], targets.rows[pairs.target]
    left = power + (law * (statistics.gram @ law - 2.0 * statistics.moment)).sum(axis=(1, 2))
    left, axes = np.maximum(left, targets.grain), targets.axes
    return -0.5 * axes * rows * np.log(left / power), left / (axes * np.maximum(rows, 1.0))
