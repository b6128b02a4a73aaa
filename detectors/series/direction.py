"""Tells UAVs that lead from UAVs that only move like others, because all of them answer to a common cause.

Members of a formation about a virtual point predict each other: each is one more measurement of the point. So do
animals of a herd that a shepherd drives. But their past predicts the others no better than their future does. The past
of a head predicts its followers better than its future, which they do not know. The followers' own past has no part in
this comparison, because it holds the common cause as well.
"""

from __future__ import annotations

import numpy as np

from detectors.series.features import make_features
from detectors.series.projections import NOTHING, RIDGE, factor, solve_lower
from usnet_env.arrays import Floats, Indices
from usnet_env.compiling import compiled

_CLASS = "v+v²+v×v(2)"  # with a axes, the newest velocity is its first a columns, and the squares begin at column 2 a
_LEAST_STEPS = 32  # 4 in each block
_BLOCKS = 8
_CHUNK = 500  # pairs; bounds the memory
_CERTAIN = 100.0  # of a logarithm: more is the same
_REVERSED = ((0, -1.0), (1, 1.0))  # the sign of velocities in reversed time, and that of their changes
SHARES, WEIGHTS = (np.polynomial.legendre.leggauss(24) + np.array([[1.0], [0.0]])) / 2.0  # of an integral from 0 to 1


def compare_directions(
    velocity: Floats,
    known: tuple[Floats, Floats],
    label: Indices,
    root: Indices,
    heads: Indices,
    longest: int,
    noisy: bool,
) -> Floats:
    """Log-likelihood ratio ``(M,)`` of each head: that it leads its followers, against a common cause of both.

    The mean velocity of each group of followers is regressed on features of the head at one earlier time, and at one
    later time. The *lead* is the share that the past explains less that of the future. It is also computed for the
    changes of the velocities, and summed over both and over the followers. With a common cause it is 0 on average. If
    the head leads, it is the lead that the group's prediction from the head's past would have in place of the group. If
    the head leads for a part of the time, it is that part; all parts are as probable. If it follows the group, the lead
    is negative; this is compared in place of the common cause where it is more likely. Blocks of time give the standard
    error: in units of it, the lead has a t distribution.

    Args:
        velocity: ``(n, T, a)``.
        known: ``(M, T, a)`` twice: the velocities of the heads as they are known at each step from what was seen until
            then, and from what is seen from then on. Both are the velocities if there is no noise.
        label: ``(n,)`` the group of each UAV.
        root: ``(n,)`` the head of each UAV, -1 for none.
        heads: ``(M,)`` ascending.
        longest: the longest delay in steps; a quarter of the window at most.
        noisy: whether positions are seen with noise. The changes of velocities are mostly noise then, and left out.

    Returns:
        Infinite where nothing is compared: in a window of fewer than 32 steps.
    """
    steps = velocity.shape[1]
    behind = np.flatnonzero(np.isin(root, heads) & (root != np.arange(len(root))))
    if steps < _LEAST_STEPS or not len(behind):
        return np.full(len(heads), np.inf)
    code, pair = np.unique(root[behind] * len(label) + label[behind], return_inverse=True)
    size = np.bincount(pair).astype(np.float64)
    group = np.zeros((len(code), *velocity.shape[1:]))
    np.add.at(group, pair, velocity[behind] / size[pair, None, None])
    place = np.searchsorted(heads, code // len(label))
    lead, whole = np.zeros((len(heads), _BLOCKS)), np.zeros((len(heads), 2))
    for first in range(0, len(code), _CHUNK):
        part = slice(first, first + _CHUNK)
        led, weight = place[part], size[part, None]
        for order, turned in _REVERSED[: 1 if noisy else 2]:
            some, past, future = (np.diff(v, order, axis=1) for v in (group[part], known[0][led], known[1][led]))
            blocks, most = _measure_leads(_bound(some), past, future, min(longest, steps // 4), turned)
            np.add.at(lead, led, weight * blocks)
            np.add.at(whole, led, weight * most)
    error = np.sqrt(_BLOCKS) * lead.std(axis=1, ddof=1) + NOTHING
    found, expected = lead.sum(axis=1) / error, np.maximum(whole, 0.0) / error[:, None]
    leads, follows = (
        np.logaddexp.reduce(np.log(WEIGHTS) + _log_density(sign * found[:, None] - most[:, None] * SHARES), axis=1)
        for sign, most in zip((1.0, -1.0), expected.T, strict=True)
    )
    return np.asarray(leads - np.maximum(_log_density(found), follows))


def lead_probabilities(ratio: Floats) -> Floats:
    """Probabilities ``(M,)`` that heads lead, by the log-likelihood ratios ``(M,)`` of :func:`compare_directions`.

    An unknown share of the heads of a window lead their followers, and the others have a common cause with them: all
    shares are as probable. So a head with a doubtful direction is a leader rather where the other heads are leaders.
    """
    ratio = np.minimum(ratio, _CERTAIN)
    each = np.logaddexp(np.log1p(-SHARES)[:, None], np.log(SHARES)[:, None] + ratio)  # (K, M)
    whole = np.log(WEIGHTS) + each.sum(axis=1)
    given = np.log(SHARES)[:, None] + ratio - each
    return np.asarray(np.exp(np.logaddexp.reduce((whole - np.logaddexp.reduce(whole))[:, None] + given, axis=0)))


def _log_density(values: Floats) -> Floats:
    """Logarithm of the density of the t distribution with 7 degrees of freedom, less a constant."""
    return np.asarray(-0.5 * _BLOCKS * np.log1p(values**2 / (_BLOCKS - 1)))


def _bound(values: Floats) -> Floats:
    """``(k, T, a)`` about their mean, none longer than the median, so that a sharp turn is one event among others."""
    values = values - values.mean(axis=1, keepdims=True)
    length = np.sqrt((values**2).sum(axis=2, keepdims=True))
    values = values * np.minimum(np.median(length, axis=1, keepdims=True) / np.maximum(length, NOTHING), 1.0)
    return np.asarray(values - values.mean(axis=1, keepdims=True))


def _measure_leads(group: Floats, past: Floats, future: Floats, longest: int, turned: float) -> tuple[Floats, Floats]:
    """Contributions ``(P, 8)`` of the blocks to the lead of P pairs; the leads ``(P, 2)`` of the predictions.

    These are the lead that the group's prediction from the head's past has in place of the group, and, with its sign
    changed, that of the prediction from the head's future. All are shares of the group's energy.

    Args:
        group: ``(P, T, a)`` mean velocities of followers, or their changes.
        past: ``(P, T, a)`` velocities of the UAV that they follow, as known from before, or their changes.
        future: ``(P, T, a)`` as known from afterwards.
        longest: the longest delay in steps.
        turned: the sign that they have in reversed time.
    """
    pair = np.stack([past, turned * future[:, ::-1]], axis=1)  # (P, 2, T, a): in both directions of time
    across = pair.reshape(-1, *group.shape[1:]).swapaxes(1, 2)
    before = np.concatenate([across[:, :, :1], across[:, :, :-1]], axis=2)
    features, _ = make_features(np.stack([across, before], axis=1), [_CLASS])
    features = features.reshape(len(group), 2, *features.shape[1:])
    return _compare_both_ways(features, np.stack([group, turned * group[:, ::-1]], axis=1), longest, turned)


@compiled()
def _compare_both_ways(features: Floats, target: Floats, longest: int, turned: float) -> tuple[Floats, Floats]:
    """:func:`_measure_leads` of features ``(P, 2, p, T)`` and groups ``(P, 2, T, a)``, in time and in reversed time.

    The features are those of the newest velocity, of its squares, or all: the class that explains most in either
    direction, less what as many features explain by chance.
    """
    count, _, steps, axes = target.shape
    blocks, expected = np.zeros((count, _BLOCKS)), np.zeros((count, 2))
    for pair in range(count):
        total = max((target[pair, 0] ** 2).sum(), NOTHING)
        products = [_multiply_later(features[pair, way], target[pair, way], longest) for way in range(2)]
        adjusted, first, last, highest = np.zeros(2), 0, 0, -np.inf
        predicted = np.zeros((2, steps, axes))
        for begin, end in ((0, axes), (2 * axes, 3 * axes), (0, features.shape[2])):
            chance = (end - begin) / (steps - 1 - (end - begin))  # the share of what is left; an adjusted R²
            fits = [_fit_delay(gram[begin:end, begin:end], moment[begin:end], longest) for gram, moment in products]
            more = [energy - chance * (total - energy) for _, _, energy in fits]
            if max(more[0], more[1]) > highest:
                first, last, highest = begin, end, max(more[0], more[1])
                for way in range(2):
                    law, delay, _ = fits[way]
                    adjusted[way] = more[way]
                    predicted[way] = 0.0
                    predicted[way, delay:] = (features[pair, way, begin:end].T @ law)[: steps - delay]
        gained = ((predicted[0] - turned * predicted[1, ::-1]) * target[pair, 0]).sum(axis=1) / total
        for block in range(_BLOCKS):
            blocks[pair, block] = gained[block * steps // _BLOCKS : (block + 1) * steps // _BLOCKS].sum()
        for way in range(2):
            back = turned * predicted[way, ::-1]
            gram, moment = _multiply_later(features[pair, 1 - way, first:last], back, longest)
            expected[pair, way] = (adjusted[way] - _fit_delay(gram, moment, longest)[2]) / total
    return blocks, expected


@compiled()
def _multiply_later(features: Floats, target: Floats, longest: int) -> tuple[Floats, Floats]:
    """Products of features ``(p, T)``: ``(p, p)`` with each other, ``(p, D a)`` with the next D targets ``(T, a)``."""
    steps, axes = target.shape
    later = np.zeros((steps, longest * axes))
    for step in range(steps):
        some = target[step + 1 : step + 1 + longest].ravel()
        later[step, : len(some)] = some
    gram = features @ features.T
    for p in range(len(gram)):
        gram[p, p] += RIDGE * gram[p, p] + NOTHING
    return gram, features @ later


@compiled()
def _fit_delay(gram: Floats, moment: Floats, longest: int) -> tuple[Floats, int, float]:
    """The law ``(p, a)``, the delay of 1 to D steps and the energy of the delay that explains most."""
    lower, left = gram.copy(), moment.copy()
    factor(lower, 0.0)
    solve_lower(lower, left)
    energy = (left**2).sum(axis=0).reshape(longest, -1).sum(axis=1)
    best, axes = energy.argmax(), left.shape[1] // longest
    law = left[:, best * axes : (best + 1) * axes].copy()
    for p in range(len(law) - 1, -1, -1):  # L' law = left
        law[p] /= lower[p, p]
        for q in range(p):
            law[q] -= lower[p, q] * law[p]
    return law, int(best) + 1, float(energy[best])
