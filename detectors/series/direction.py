"""Tells UAVs that lead from UAVs that only move like others, because all of them answer to a common cause.

Members of a formation about a virtual point predict each other, but their past predicts the others no better than
their future does. The past of a head predicts its followers better than its future, which they do not know. The
followers' own past has no part in this comparison, because it holds the common cause as well.
"""

from __future__ import annotations

import numpy as np

from detectors.series.designs import sum_groups
from detectors.series.features import make_features
from detectors.series.projections import NOTHING, RIDGE, factor, solve_lower, sum_squares
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
    group = sum_groups(velocity[behind], pair) / size[:, None, None]
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

    The predictions are from the head's past and, with the sign changed, its future. All arrays are ``(P, T, a)``;
    ``turned`` is the sign that they have in reversed time.
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
    blocks, expected, energy = np.zeros((count, _BLOCKS)), np.zeros((count, 2)), np.zeros(2)
    for pair in range(count):
        total = max(sum_squares(target[pair, 0]), NOTHING)
        gram, moment = _multiply_later(features[pair, 0], target[pair, 0], longest)
        gram_back, moment_back = _multiply_later(features[pair, 1], target[pair, 1], longest)
        first, last, highest = 0, 0, -np.inf
        ahead, back = np.zeros((steps, axes)), np.zeros((steps, axes))  # the predictions by the best class
        for begin, end in ((0, axes), (2 * axes, 3 * axes), (0, features.shape[2])):
            chance = (end - begin) / (steps - 1 - (end - begin))  # the share of what is left; an adjusted R²
            law, delay, most = _fit_delay(gram[begin:end, begin:end], moment[begin:end], longest)
            law_back, delay_back, most_back = _fit_delay(
                gram_back[begin:end, begin:end], moment_back[begin:end], longest
            )
            most, most_back = most - chance * (total - most), most_back - chance * (total - most_back)
            if max(most, most_back) > highest:
                first, last, highest = begin, end, max(most, most_back)
                energy[0], energy[1] = most, most_back
                ahead = _predict(features[pair, 0, begin:end], law, delay)
                back = _predict(features[pair, 1, begin:end], law_back, delay_back)
        for step in range(steps):
            for axis in range(axes):
                gained = (ahead[step, axis] - turned * back[steps - 1 - step, axis]) * target[pair, 0, step, axis]
                blocks[pair, (_BLOCKS * (step + 1) - 1) // steps] += gained / total
        for way, known in enumerate((ahead, back)):
            gram, moment = _multiply_later(features[pair, 1 - way, first:last], turned * known[::-1], longest)
            expected[pair, way] = (energy[way] - _fit_delay(gram, moment, longest)[2]) / total
    return blocks, expected


@compiled()
def _multiply_later(features: Floats, target: Floats, longest: int) -> tuple[Floats, Floats]:
    """Products of features ``(p, T)``: ``(p, p)`` with each other, ``(p, D a)`` with the next D targets ``(T, a)``."""
    steps, axes = target.shape
    later = np.zeros((steps, longest * axes))
    for step in range(steps):
        for lag in range(1, min(longest, steps - 1 - step) + 1):
            for axis in range(axes):
                later[step, (lag - 1) * axes + axis] = target[step + lag, axis]
    gram = features @ features.T
    for p in range(len(gram)):
        gram[p, p] += RIDGE * gram[p, p] + NOTHING
    return gram, features @ later


@compiled()
def _predict(features: Floats, law: Floats, delay: int) -> Floats:
    """``(T, a)``: what a law ``(p, a)`` predicts from features ``(p, T)``; 0 in the first steps."""
    steps, axes = features.shape[1], law.shape[1]
    predicted = np.zeros((steps, axes))
    for step in range(delay, steps):
        for p in range(len(law)):
            for axis in range(axes):
                predicted[step, axis] += features[p, step - delay] * law[p, axis]
    return predicted


@compiled()
def _fit_delay(gram: Floats, moment: Floats, longest: int) -> tuple[Floats, int, float]:
    """The law ``(p, a)``, the delay of 1 to D steps and the energy of the delay that explains most."""
    lower, left = gram.copy(), moment.copy()
    factor(lower, 0.0)
    solve_lower(lower, left)
    width, axes, energy = len(left), left.shape[1] // longest, np.zeros(longest)
    for p in range(width):
        for column in range(left.shape[1]):
            energy[column // axes] += left[p, column] ** 2
    best = energy.argmax()
    law = left[:, best * axes : (best + 1) * axes].copy()
    for p in range(width - 1, -1, -1):  # L' law = left
        for axis in range(axes):
            law[p, axis] /= lower[p, p]
            for q in range(p):
                law[q, axis] -= lower[p, q] * law[p, axis]
    return law, int(best) + 1, float(energy[best])
