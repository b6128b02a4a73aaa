"""Confirm leaders: a group copies its leader's velocity later, or goes on its way, and the leader on no other's."""

from __future__ import annotations

from collections.abc import Sequence
from statistics import NormalDist
from typing import Any

import numpy as np
from numpy.typing import NDArray

from usnet_env.arrays import Floats, Indices, Mask, Singles
from usnet_env.series import bound_maximum, centre_columns, correlate_over_lags, reverse_blocks, scale_to_unit
from usnet_env.tracks.resample import LAGS
from usnet_env.window import Window

_BLOCKS, _SURROGATES = 8, 40  # the fewest blocks of a window; how often half of them are reversed
LEAST_STEPS = 2 * _BLOCKS
LEVEL = 0.05  # of a group and window: how often a leaderless group gets a leader
_LEVEL_OUTSIDE = 0.5
_MAX_ALIKE, _SHIFTS, _DEVIATIONS = 5, 9, 3.0
_MIN_SHIFT = 3 * LAGS  # a smaller shift leaves a part of the likeness at some lag
_SUM_DEVIATION = 1.8  # of the sum of two scores: 1.7 by their correlation of 0.45; 1.9 in tracks without leaders
_MAX_DELAY, _MAX_DELAY_PART = 30.0, 3  # seconds, and part of a window, in which a position is reached later
_MIN_COSINE = 0.8  # the cosine of headings at one position
_MAX_PATH_SHARE = 0.03  # squared distances to the way of a leader, as a share of those to where it is
_ROUNDING = 1e-9  # of the variance of all positions: what the rounding of numbers may be
_MIN_SHARE = 0.75  # of a group
_MAX_COMPARED = 20  # UAVs
_MAX_CORRELATION = 0.999  # the logarithm of equal tracks is infinite


def confirm_leaders(
    window: Window,
    leaders: Sequence[int] | NDArray[np.integer[Any]],
    followers: Sequence[Sequence[int]],
    shortest_step_window: Window | None = None,
) -> tuple[Mask, list[list[int]]]:
    """Which of c leaders are confirmed, ``(c,)`` bool, and the followers that each keeps.

    Its followers copy its velocity later (:func:`keep_group`, :func:`confirm_lead`) and it doesn't follow another
    (:func:`find_followers`); or else they go on its way later (:func:`keep_path_followers`), by the window with the
    shortest step, if there are several.
    """
    groups = [keep_group(window, int(leader), members) for leader, members in zip(leaders, followers, strict=True)]
    leads = [confirm_lead(window, int(leader), group) for leader, group in zip(leaders, groups, strict=True)]
    confirmed = np.array(leads, bool) & ~find_followers(window, leaders, followers)
    for c in np.flatnonzero(~confirmed).tolist():
        if path_followers := keep_path_followers(shortest_step_window or window, int(leaders[c]), followers[c]):
            confirmed[c], groups[c] = True, path_followers
    return confirmed, groups


def keep_path_followers(window: Window, leader: int, followers: Sequence[int]) -> list[int]:
    """The followers that go later on the way of their leader, or of a follower that does so, or beside it.

    UAV i follows the way of UAV j if the mean square of the vector between its positions and those of j some time
    before, up to 30 s and a third of the window, is at most 3 % of the least one between its positions and those of j
    now or later; beside it, if the variance of the vector is. Empty if fewer than three quarters of the followers do,
    if the leader follows the way of any UAV, or in a window of fewer than 16 steps.
    """
    max_lag = int(min(_MAX_DELAY / (window.step or 1.0), window.observation_steps / _MAX_DELAY_PART))
    if not followers or max_lag < 1 or window.observation_steps < LEAST_STEPS:
        return []
    group = np.array([leader, *followers])
    if (_compare_paths(window, group[:1], np.arange(window.uavs), max_lag) < _MAX_PATH_SHARE).any():
        return []
    links = _compare_paths(window, group[1:], group, max_lag) < _MAX_PATH_SHARE
    reached = links[:, 0]
    while (reachable := reached | (links[:, 1:] & reached).any(axis=1)).sum() > reached.sum():
        reached = reachable
    return group[1:][reached].tolist() if reached.sum() >= _MIN_SHARE * len(followers) else []


def _compare_paths(window: Window, followers: Indices, leaders: Indices, max_lag: int) -> Floats:
    """``(f, l)`` mean square of the vector to a UAV up to ``max_lag`` steps before, as a share of that now or later.

    The same share of variances counts if it is smaller. It is infinite where both are seen in fewer than half of the
    window. What is tiny beside the variance of all positions counts as equal: on a straight way at one speed, it comes
    from rounded numbers.
    """
    seen = window.seen.astype(np.float64)
    position = np.where(window.seen[..., None], window.position - window.position[window.seen].mean(axis=0), 0.0)
    squares, instants = (position**2).sum(axis=2), len(position)
    least_square = _ROUNDING * squares.sum() / max(seen.sum(), 1.0)
    spread = np.empty((2, 2 * max_lag + 1, len(followers), len(leaders)))  # mean squares and variances
    for lag in range(-max_lag, max_lag + 1):
        present, past = slice(max(0, lag), instants + min(0, lag)), slice(max(0, -lag), instants - max(0, lag))
        seen_f, square_f, position_f = (values[present][:, followers] for values in (seen, squares, position))
        seen_l, square_l, position_l = (values[past][:, leaders] for values in (seen, squares, position))
        times_seen = seen_f.T @ seen_l
        square = square_f.T @ seen_l + seen_f.T @ square_l
        square -= 2 * np.einsum("tfk,tlk->fl", position_f, position_l, optimize=True)
        offset = np.einsum("tfk,tl->flk", position_f, seen_l, optimize=True)
        offset -= np.einsum("tf,tlk->flk", seen_f, position_l, optimize=True)
        square, offset = square / np.maximum(times_seen, 1.0), offset / np.maximum(times_seen, 1.0)[..., None]
        spread_at_lag = np.maximum((square, square - (offset**2).sum(axis=2)), least_square)
        spread[:, lag + max_lag] = np.where(times_seen >= instants / 2, spread_at_lag, np.inf)
    spread_before, spread_after = spread[:, max_lag + 1 :].min(axis=1), spread[:, : max_lag + 1].min(axis=1)
    is_known = np.isfinite(spread_before) & np.isfinite(spread_after) & (spread_after > 0)
    return np.where(is_known, spread_before / np.where(is_known, spread_after, 1.0), np.inf).min(axis=0)


def keep_group(window: Window, leader: int, followers: Sequence[int]) -> list[int]:
    """The followers that move like their leader, or like others that do.

    The likeness of a follower is Fisher's z of the largest correlation of its velocity with those of the leader and of
    the followers kept so far, at any lag up to 4, so it does not depend on who is first. It must exceed the mean of
    those after 9 circular shifts in time by 3 of their standard deviations. All stay in a window of fewer than 32
    steps, and where none is kept.
    """
    if window.observation_steps < 2 * LEAST_STEPS:
        return list(followers)
    unit = _scale(window.velocity, window.velocity_seen)
    added, candidates = [leader], np.array(followers, np.int64)
    group = list[int]()
    while len(added) and len(candidates):
        is_alike = _are_alike(unit[:, candidates], unit[:, added])
        added, candidates = candidates[is_alike].tolist(), candidates[~is_alike]
        group += added
    return sorted(group) or list(followers)


def _are_alike(unit: Singles, other_unit: Singles) -> Mask:
    """Which scaled velocities ``(T, n, 3)`` are more like those of any other than chance allows; ``(n,)``."""
    shifts = np.linspace(_MIN_SHIFT, len(unit) - _MIN_SHIFT, _SHIFTS).astype(int)
    likeness = np.array([_measure_likeness(np.roll(unit, k, axis=0), other_unit).max(axis=1) for k in (0, *shifts)])
    observed, *shifted = np.arctanh(np.clip(likeness, -_MAX_CORRELATION, _MAX_CORRELATION))
    return np.asarray(observed > np.mean(shifted, axis=0) + _DEVIATIONS * np.std(shifted, axis=0))


def find_confound(window: Window) -> tuple[str, list[int]]:
    """What UAVs may follow where none of them leads: ``"one path"``, ``"one signal"`` or ``""``; and which UAVs.

    Two go along one path if the squared distances of the positions of each to the nearest one of the other at any time
    have a median of at most 3 % of that of the squared distances at the same time, and the cosine of their headings
    there has a median of at least 0.8. UAVs follow one signal, or each other, if their velocities and the changes of
    these are alike, as in :func:`keep_group`, to those of the UAV that is most like all. It must be more than half of
    the UAVs, of which at most 20 are looked at, in a window of at least 32 steps.
    """
    uavs = np.unique(np.linspace(0, window.uavs - 1, min(window.uavs, _MAX_COMPARED)).astype(int))
    if window.observation_steps < 2 * LEAST_STEPS:
        return "", []
    on_path = np.array([[i == j or _is_on_path(window, i, j) for j in uavs.tolist()] for i in uavs.tolist()])
    velocity, seen = window.velocity[:, uavs], window.velocity_seen[:, uavs]
    unit, changes = _scale(velocity, seen), _scale(np.diff(velocity, axis=0), seen[1:] & seen[:-1])
    centre = int(_measure_likeness(unit, unit).mean(axis=1).argmax())
    shares_signal = _are_alike(unit, unit[:, [centre]]) & _are_alike(changes, changes[:, [centre]])
    shares_signal[centre] = True
    for confound, members in (("one path", max(on_path & on_path.T, key=np.sum)), ("one signal", shares_signal)):
        if 2 * members.sum() > len(members) and members.sum() > 1:
            return confound, uavs[members].tolist()
    return "", []


def _is_on_path(window: Window, uav: int, other: int) -> bool:
    """Whether a UAV is near to positions of the other at whatever time, and headed there in the same way."""
    seen = window.seen[1:] & window.velocity_seen
    both_seen = seen[:, [uav, other]].all(axis=1)
    if both_seen.sum() < LEAST_STEPS:
        return False
    position, velocity = window.position[1:].astype(np.float64), window.velocity.astype(np.float64)
    uav_seen, other_seen = seen[:, uav], seen[:, other]
    squares = ((position[uav_seen, None, uav] - position[None, other_seen, other]) ** 2).sum(axis=2)
    heading, other_heading = velocity[uav_seen, uav], velocity[other_seen, other][squares.argmin(axis=1)]
    norms = np.linalg.norm(heading, axis=1) * np.linalg.norm(other_heading, axis=1)
    cosine = np.median((heading * other_heading).sum(axis=1) / np.where(norms > 0, norms, np.inf))
    square_now = np.median(((position[both_seen, uav] - position[both_seen, other]) ** 2).sum(axis=1))
    return bool(np.median(squares.min(axis=1)) <= _MAX_PATH_SHARE * square_now and cosine >= _MIN_COSINE)


def confirm_lead(window: Window, leader: int, followers: Sequence[int]) -> bool:
    """Whether the mean velocity of the followers repeats that of the leader later, more than the reverse.

    The lead is max_τ C(τ) - max_τ C(-τ), τ = 1, ..., 4, where C is the correlation of the followers' mean velocity with
    the leader's velocity τ steps earlier, both centred over the window. Its score is the lead in standard deviations of
    those of 40 surrogates, in which time is reversed in half of the blocks, of about 8 steps each: these keep what both
    do at the same time, and cancel leads. The scores of the velocities and of their changes must exceed 1, and their
    sum z times its standard deviation, 1.8; z is the quantile of a normal distribution at 0.05 / n, because the leader
    was chosen from the n members of its group. It is false without followers, and true in a window of fewer than 16
    steps, which is too short for the test.
    """
    if not followers or window.observation_steps < LEAST_STEPS:
        return bool(followers)
    seen = window.velocity_seen[:, followers]
    count = seen.sum(axis=1)
    mean = (window.velocity[:, followers] * seen[..., None]).sum(axis=1, dtype=np.float64)
    mean /= np.maximum(count, 1)[:, None]
    both_seen = (count > 0) & window.velocity_seen[:, leader]
    return _is_ahead(mean, window.velocity[:, leader].astype(np.float64), both_seen, LEVEL / (1 + len(followers)))


def find_followers(
    window: Window, leaders: Sequence[int] | NDArray[np.integer[Any]], followers: Sequence[Sequence[int]]
) -> Mask:
    """Which of the leaders follow another UAV in the first or the second half of a window.

    A UAV that follows one head after another moves like neither through the whole window, and may look like a head. In
    each half, it is tested by :func:`confirm_lead` with the UAVs of :func:`find_alike`, at a level of 0.05 for all
    five; for a UAV outside of its group, any lead is enough. ``(c,)`` bool; false in a window of fewer than 32 steps.
    """
    steps, follows, uavs = window.observation_steps, np.zeros(len(leaders), bool), np.asarray(leaders, np.int64)
    if steps < 2 * LEAST_STEPS or not len(uavs):
        return follows
    for begin in (0, steps - steps // 2):
        half = slice(begin, begin + steps // 2)
        velocity, seen = window.velocity[half].astype(np.float64), window.velocity_seen[half]
        for c, alike in enumerate(find_alike(window, uavs, half)):
            for other in () if follows[c] else alike:
                level = LEVEL / _MAX_ALIKE if other in followers[c] else _LEVEL_OUTSIDE
                both_seen = seen[:, uavs[c]] & seen[:, other]
                follows[c] |= _is_ahead(velocity[:, uavs[c]], velocity[:, other], both_seen, level)
    return follows


def find_alike(window: Window, uavs: Indices, half: slice) -> list[list[int]]:
    """For each of some UAVs, those up to 5 that are more like it in a half of a window than chance allows.

    The likeness is Fisher's z of the largest correlation of both velocities at any lag up to 4. It must exceed a
    quantile of the Gumbel distribution, that of maxima, with the mean and the standard deviation of the largest z of
    the other UAVs in parts of the window that begin at 9 other times. The level is 0.05 for all ``uavs`` and halves.
    """
    length, last_start = half.stop - half.start, window.observation_steps - (half.stop - half.start)
    shifts = np.linspace(min(_MIN_SHIFT, length), last_start, _SHIFTS).astype(int)
    starts = [half.start, *(shifts if half.start == 0 else half.start - shifts)]
    parts = [_scale(window.velocity[k : k + length], window.velocity_seen[k : k + length]) for k in starts]
    similarity = np.stack([_measure_likeness(parts[0][:, uavs], part) for part in parts])
    similarity[:, np.arange(len(uavs)), uavs] = 0.0
    similarity = np.arctanh(np.minimum(similarity, _MAX_CORRELATION))
    limit = bound_maximum(similarity[1:].max(axis=2), LEVEL / (2 * len(uavs)))
    nearest = np.argsort(-similarity[0], axis=1, kind="stable")[:, :_MAX_ALIKE]
    return [[int(k) for k in similar if similarity[0, c, k] > limit[c]] for c, similar in enumerate(nearest)]


def _is_ahead(followers: Floats, leader: Floats, both_seen: Mask, level: float) -> bool:
    """Whether ``followers`` ``(T, 3)`` repeat ``leader`` later: by the sum of the scores of both and of their changes.

    ``both_seen`` ``(T,)``: where both are seen. At a strict level, each score must exceed 1, too.
    """
    followers, leader = centre_columns(followers, both_seen), centre_columns(leader, both_seen)
    velocity = _measure_score(followers, leader, -1.0)
    changes = _measure_score(np.diff(followers, axis=0), np.diff(leader, axis=0), 1.0)
    limit = max(0.0, -NormalDist().inv_cdf(level))
    return velocity + changes > _SUM_DEVIATION * limit and (limit == 0.0 or min(velocity, changes) > 1.0)


def _measure_score(followers: Floats, leader: Floats, sign: float) -> float:
    """The lead in standard deviations of those with time reversed in half of the blocks, with this ``sign`` there."""
    blocks = max(_BLOCKS, 2 * (len(followers) // (4 * LAGS)))
    halves = np.tile(np.arange(blocks) < blocks // 2, (1 + _SURROGATES, 1))
    halves = np.random.default_rng(0).permuted(halves, axis=1)
    halves[0] = False
    order, signs = reverse_blocks(len(followers), halves)
    signs = np.where(signs < 0, sign, 1.0)[..., None]
    lead, *reversed_leads = _compare_lags(followers[order] * signs, leader[order] * signs)
    deviation = np.sqrt(np.mean(np.square(reversed_leads)))
    return float(lead / deviation) if deviation else 0.0


def _compare_lags(followers: Floats, leader: Floats) -> Floats:
    """How much better each of ``(n, T, 3)`` agrees with the ``leader`` before than with that later; ``(n,)``."""
    leads, lags = (
        np.max([np.einsum("ntk,ntk->n", second[:, lag:], first[:, :-lag]) for lag in range(1, LAGS + 1)], axis=0)
        for second, first in ((followers, leader), (leader, followers))
    )
    return np.asarray(leads - lags)


def _scale(velocity: Singles, seen: Mask) -> Singles:
    """Velocities ``(T, N, 3)`` centred over time and scaled to a squared sum of 1; 0 where unseen."""
    return scale_to_unit(centre_columns(velocity, seen), least=0.0)


def _measure_likeness(first: Singles, others: Singles) -> Singles:
    """``(c, N)`` largest correlation of series ``(T, c, 3)`` with those ``(T, N, 3)`` of others at the lags -4 to 4."""
    return correlate_over_lags(first, others, LAGS, least=-LAGS)
