"""Tells UAVs that lead from UAVs that only move like others, because all of them answer to a common cause.

Members of a formation about a virtual point predict each other: each is one more measurement of the point. So do
animals of a herd that a shepherd drives. But their past predicts the others no better than their future does. The past
of a head predicts its followers better than its future, which they do not know. The followers' own past has no part in
this comparison, because it holds the common cause as well.
"""

from __future__ import annotations

import numpy as np
from scipy.special import logsumexp

from detectors.series.features import make_features
from usnet_env.arrays import Floats, Indices

_CLASSES = ("v(1)", "v²(1)", "v+v²+v×v(2)")
_LEAST_STEPS = 32  # 4 in each block
_BLOCKS = 8
_CHUNK = 500  # pairs; bounds the memory
_RIDGE = 1e-6  # of the square of each feature
_NOTHING = 1e-12
_REVERSED = ((0, -1.0), (1, 1.0))  # the sign of velocities in reversed time, and that of their changes
SHARES, WEIGHTS = (np.polynomial.legendre.leggauss(24) + np.array([[1.0], [0.0]])) / 2.0  # of an integral from 0 to 1


def compare_directions(
    velocity: Floats, label: Indices, root: Indices, heads: Indices, longest: int, noisy: bool
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
    ahead = code // len(label)
    lead, whole = np.zeros((len(heads), _BLOCKS)), np.zeros((len(heads), 2))
    for first in range(0, len(code), _CHUNK):
        part = slice(first, first + _CHUNK)
        place, weight = np.searchsorted(heads, ahead[part]), size[part]
        for order, turned in _REVERSED[: 1 if noisy else 2]:
            some, head = (np.diff(values, order, axis=1) for values in (group[part], velocity[ahead[part]]))
            blocks, most = _measure_leads(_bound(some), head, min(longest, steps // 4), turned)
            np.add.at(lead, place, weight[:, None] * blocks)
            np.add.at(whole, place, weight[:, None] * most)
    error = np.sqrt(_BLOCKS) * lead.std(axis=1, ddof=1) + _NOTHING
    found, expected = lead.sum(axis=1) / error, np.maximum(whole, 0.0) / error[:, None]
    leads, follows = (
        logsumexp(_log_density(sign * found[:, None] - most[:, None] * SHARES), b=WEIGHTS, axis=1)
        for sign, most in zip((1.0, -1.0), expected.T, strict=True)
    )
    return np.asarray(leads - np.maximum(_log_density(found), follows))


def _log_density(values: Floats) -> Floats:
    """Logarithm of the density of the t distribution with 7 degrees of freedom, less a constant."""
    return np.asarray(-0.5 * _BLOCKS * np.log1p(values**2 / (_BLOCKS - 1)))


def _bound(values: Floats) -> Floats:
    """``(k, T, a)`` about their mean, none longer than the median, so that a sharp turn is one event among others."""
    values = values - values.mean(axis=1, keepdims=True)
    length = np.sqrt((values**2).sum(axis=2, keepdims=True))
    values = values * np.minimum(np.median(length, axis=1, keepdims=True) / np.maximum(length, _NOTHING), 1.0)
    return np.asarray(values - values.mean(axis=1, keepdims=True))


def _measure_leads(group: Floats, head: Floats, longest: int, turned: float) -> tuple[Floats, Floats]:
    """Contributions ``(P, 8)`` of the blocks to the lead of P pairs; the leads ``(P, 2)`` of the predictions.

    These are the lead that the group's prediction from the head's past has in place of the group, and, with its sign
    changed, that of the prediction from the head's future. All are shares of the group's energy. The class of features
    is the one that explains most in either direction, less what as many features explain by chance.

    Args:
        group: ``(P, T, a)`` mean velocities of followers, or their changes.
        head: ``(P, T, a)`` velocities of the UAV that they follow, or their changes.
        longest: the longest delay in steps.
        turned: the sign that they have in reversed time.
    """
    count, steps, _ = group.shape
    total = np.maximum((group**2).sum(axis=(1, 2)), _NOTHING)
    best, blocks, expected = np.full(count, -np.inf), np.zeros((count, _BLOCKS)), np.zeros((count, 2))
    starts = np.arange(_BLOCKS) * steps // _BLOCKS

    def reverse(values: Floats) -> Floats:
        return turned * values[:, ::-1]

    both = (make_features(_look_back(values), _CLASSES) for values in (head, reverse(head)))
    for (_, past), (_, future) in zip(*both, strict=True):
        forward, ahead = _predict(past, group, longest)
        backward, back = _predict(future, reverse(group), longest)
        chance = past.shape[2] / (steps - 1 - past.shape[2])  # of what is left; an adjusted R²
        share = np.maximum(ahead, back) / total
        adjusted = share - chance * (1.0 - share)
        some = np.flatnonzero(adjusted > best)
        best[some] = adjusted[some]
        gained = ((forward - reverse(backward))[some] * group[some]).sum(axis=2)
        blocks[some] = np.add.reduceat(gained, starts, axis=1) / total[some, None]
        for side, energy, other in (
            (0, ahead, _predict(future[some], reverse(forward[some]), longest)[1]),
            (1, back, _predict(past[some], reverse(backward[some]), longest)[1]),
        ):
            expected[some, side] = ((energy - chance * (total - energy))[some] - other) / total[some]
    return blocks, expected


def _look_back(values: Floats) -> Floats:
    """``(k, T, 2, a)``: the values of each step and of the one before it."""
    return np.stack([values, np.concatenate([values[:, :1], values[:, :-1]], axis=1)], axis=2)


def _predict(features: Floats, group: Floats, longest: int) -> tuple[Floats, Floats]:
    """Predict groups ``(P, T, a)`` from features ``(P, T, p)`` at the best delay, from 1 to ``longest`` steps.

    Returns:
        The predictions ``(P, T, a)``, and the energy that they explain ``(P,)``.
    """
    across = features.transpose(0, 2, 1)
    gram, width = across @ features, features.shape[2]
    gram += np.eye(width) * (_RIDGE * gram + _NOTHING)
    inverse = np.linalg.inv(gram)
    best, delay = np.full(len(group), -np.inf), np.zeros(len(group), np.int64)
    law = np.zeros((len(group), width, group.shape[2]))
    for lag in range(1, longest + 1):
        moment = across[:, :, :-lag] @ group[:, lag:]
        weights = inverse @ moment
        energy = (moment * weights).sum(axis=(1, 2))
        better = energy > best
        best[better], law[better], delay[better] = energy[better], weights[better], lag
    source = np.arange(group.shape[1]) - delay[:, None]
    predicted = np.take_along_axis(features @ law, np.maximum(source, 0)[:, :, None], axis=1)
    return np.where((source >= 0)[:, :, None], predicted, 0.0), best
