"""Confirm leaders: does a group copy its leader's velocity later, or go on its way, and the leader on nobody's?"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations, permutations
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
_NEAREST, _SHIFTS, _DEVIATIONS = 5, 9, 3.0
_LEAST_SHIFT = 3 * LAGS  # a smaller shift leaves a part of the likeness at some lag
_DEVIATION_OF_BOTH = 1.8  # of the sum of two scores: 1.7 by their correlation of 0.45; 1.9 in tracks without leaders
_LONGEST, _THIRD = 30.0, 3  # seconds, and part of a window, in which a position is reached later
_SAME_HEADING = 0.8  # the cosine of headings at one position
_SAME_WAY = 0.03  # squared distances to the way of a leader, as a share of those to where it is
_ROUNDED = 1e-9  # of the variance of all positions: what the rounding of numbers may be
_MOST_OF = 0.75  # of a group
_MOST_COMPARED = 20  # UAVs
_MOST_ALIKE = 0.999  # the logarithm of equal tracks is infinite


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
    kept = [keep_group(window, int(leader), members) for leader, members in zip(leaders, followers, strict=True)]
    leads = [confirm_lead(window, int(leader), members) for leader, members in zip(leaders, kept, strict=True)]
    confirmed = np.array(leads, bool) & ~find_followers(window, leaders, followers)
    for c in np.flatnonzero(~confirmed).tolist():
        if behind := keep_path_followers(shortest_step_window or window, int(leaders[c]), followers[c]):
            confirmed[c], kept[c] = True, behind
    return confirmed, kept


def keep_path_followers(window: Window, leader: int, followers: Sequence[int]) -> list[int]:
    """The followers that go later on the way of their leader, or of a follower that does so, or beside it.

    UAV i follows the way of UAV j if the mean square of the vector between its positions and those of j some time
    before, up to 30 s and a third of the window, is at most 3 % of the least one between its positions and those of j
    now or later; beside it, if the variance of the vector is. Empty if fewer than three quarters of the followers do,
    if the leader follows the way of any UAV, or in a window of fewer than 16 steps.
    """
    most = int(min(_LONGEST / (window.step or 1.0), window.observation_steps / _THIRD))
    if not followers or most < 1 or window.observation_steps < LEAST_STEPS:
        return []
    group = np.array([leader, *followers])
    if (_compare_ways(window, group[:1], np.arange(window.uavs), most) < _SAME_WAY).any():
        return []
    links = _compare_ways(window, group[1:], group, most) < _SAME_WAY
    reached = links[:, 0]
    while (more := reached | (links[:, 1:] & reached).any(axis=1)).sum() > reached.sum():
        reached = more
    return group[1:][reached].tolist() if reached.sum() >= _MOST_OF * len(followers) else []


def _compare_ways(window: Window, behind: Indices, ahead: Indices, most: int) -> Floats:
    """``(b, a)`` mean square of the vector to a UAV up to ``most`` steps before, as a share of that now or later.

    The same share of variances counts if it is smaller. It is infinite where both are seen in fewer than half of the
    window. What is tiny beside the variance of all positions counts as equal: on a straight way at one speed, it comes
    from rounded numbers.
    """
    seen = window.seen.astype(np.float64)
    position = np.where(window.seen[..., None], window.position - window.position[window.seen].mean(axis=0), 0.0)
    squares, instants = (position**2).sum(axis=2), len(position)
    least = _ROUNDED * squares.sum() / max(seen.sum(), 1.0)
    spread = np.empty((2, 2 * most + 1, len(behind), len(ahead)))  # mean squares and variances
    for lag in range(-most, most + 1):
        now, then = slice(max(0, lag), instants + min(0, lag)), slice(max(0, -lag), instants - max(0, lag))
        both = seen[now][:, behind].T @ seen[then][:, ahead]
        total = squares[now][:, behind].T @ seen[then][:, ahead] + seen[now][:, behind].T @ squares[then][:, ahead]
        total -= 2 * np.einsum("tbk,tak->ba", position[now][:, behind], position[then][:, ahead], optimize=True)
        apart = np.einsum("tbk,ta->bak", position[now][:, behind], seen[then][:, ahead], optimize=True)
        apart -= np.einsum("tb,tak->bak", seen[now][:, behind], position[then][:, ahead], optimize=True)
        square, mean = total / np.maximum(both, 1.0), apart / np.maximum(both, 1.0)[..., None]
        apart_by = np.maximum((square, square - (mean**2).sum(axis=2)), least)
        spread[:, lag + most] = np.where(both >= instants / 2, apart_by, np.inf)
    before, other = spread[:, most + 1 :].min(axis=1), spread[:, : most + 1].min(axis=1)
    known = np.isfinite(before) & np.isfinite(other) & (other > 0)
    return np.where(known, before / np.where(known, other, 1.0), np.inf).min(axis=0)


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
    new, left = [leader], np.array(followers, np.int64)
    group = list[int]()
    while len(new) and len(left):
        kept = _are_alike(unit[:, left], unit[:, new])
        new, left = left[kept].tolist(), left[~kept]
        group += new
    return sorted(group) or list(followers)


def _are_alike(unit: Singles, others: Singles) -> Mask:
    """Which scaled velocities ``(T, n, 3)`` are more like those of any other than chance allows; ``(n,)``."""
    late = np.linspace(_LEAST_SHIFT, len(unit) - _LEAST_SHIFT, _SHIFTS).astype(int)
    likeness = np.array([_measure_likeness(np.roll(unit, k, axis=0), others).max(axis=1) for k in (0, *late)])
    like, *by_chance = np.arctanh(np.clip(likeness, -_MOST_ALIKE, _MOST_ALIKE))
    return np.asarray(like > np.mean(by_chance, axis=0) + _DEVIATIONS * np.std(by_chance, axis=0))


def find_confound(window: Window) -> tuple[str, list[int]]:
    """What UAVs may follow where none of them leads: ``"one path"``, ``"one signal"`` or ``""``; and which UAVs.

    Two go along one path if the squared distances of the positions of each to the nearest one of the other at any time
    have a median of at most 3 % of that of the squared distances at the same time, and the cosine of their headings
    there has a median of at least 0.8. UAVs follow one signal, or each other, if their velocities and the changes of
    these are alike, as in :func:`keep_group`, to those of the UAV that is most like all. It must be more than half of
    the UAVs, of which at most 20 are looked at, in a window of at least 32 steps.
    """
    uavs = np.unique(np.linspace(0, window.uavs - 1, min(window.uavs, _MOST_COMPARED)).astype(int))
    if window.observation_steps < 2 * LEAST_STEPS:
        return "", []
    near = np.eye(len(uavs), dtype=bool)
    for i, j in combinations(range(len(uavs)), 2):
        near[i, j] = near[j, i] = all(_is_on_way(window, *pair) for pair in permutations((uavs[i], uavs[j])))
    velocity, seen = window.velocity[:, uavs], window.velocity_seen[:, uavs]
    unit, changes = _scale(velocity, seen), _scale(np.diff(velocity, axis=0), seen[1:] & seen[:-1])
    first = int(_measure_likeness(unit, unit).mean(axis=1).argmax())
    alike = _are_alike(unit, unit[:, [first]]) & _are_alike(changes, changes[:, [first]])
    alike[first] = True
    for words, who in (("one path", near[near.sum(axis=1).argmax()]), ("one signal", alike)):
        if 2 * who.sum() > len(who) and who.sum() > 1:
            return words, uavs[who].tolist()
    return "", []


def _is_on_way(window: Window, uav: int, other: int) -> bool:
    """Whether a UAV is near to positions of the other at whatever time, and headed there in the same way."""
    seen = window.seen[1:] & window.velocity_seen
    both = seen[:, [uav, other]].all(axis=1)
    if both.sum() < LEAST_STEPS:
        return False
    position, velocity = window.position[1:].astype(np.float64), window.velocity.astype(np.float64)
    mine, theirs = seen[:, uav], seen[:, other]
    squares = ((position[mine, None, uav] - position[None, theirs, other]) ** 2).sum(axis=2)
    going, there = velocity[mine, uav], velocity[theirs, other][squares.argmin(axis=1)]
    size = np.linalg.norm(going, axis=1) * np.linalg.norm(there, axis=1)
    alike = np.median((going * there).sum(axis=1) / np.where(size > 0, size, np.inf))
    apart = np.median(((position[both, uav] - position[both, other]) ** 2).sum(axis=1))
    return bool(np.median(squares.min(axis=1)) <= _SAME_WAY * apart and alike >= _SAME_HEADING)


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
    both = (count > 0) & window.velocity_seen[:, leader]
    return _is_ahead(mean, window.velocity[:, leader].astype(np.float64), both, LEVEL / (1 + len(followers)))


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
                level = LEVEL / _NEAREST if other in followers[c] else _LEVEL_OUTSIDE
                both = seen[:, uavs[c]] & seen[:, other]
                follows[c] |= _is_ahead(velocity[:, uavs[c]], velocity[:, other], both, level)
    return follows


def find_alike(window: Window, uavs: Indices, half: slice) -> list[list[int]]:
    """For each of some UAVs, those up to 5 that are more like it in a half of a window than chance allows.

    The likeness is Fisher's z of the largest correlation of both velocities at any lag up to 4. It must exceed a
    quantile of the Gumbel distribution, that of maxima, with the mean and the standard deviation of the largest z of
    the other UAVs in parts of the window that begin at 9 other times. The level is 0.05 for all ``uavs`` and halves.
    """
    length, last = half.stop - half.start, window.observation_steps - (half.stop - half.start)
    late = np.linspace(min(_LEAST_SHIFT, length), last, _SHIFTS).astype(int)
    starts = [half.start, *(late if half.start == 0 else half.start - late)]
    parts = [_scale(window.velocity[k : k + length], window.velocity_seen[k : k + length]) for k in starts]
    like = np.stack([_measure_likeness(parts[0][:, uavs], part) for part in parts])
    like[:, np.arange(len(uavs)), uavs] = 0.0
    like = np.arctanh(np.minimum(like, _MOST_ALIKE))
    limit = bound_maximum(like[1:].max(axis=2), LEVEL / (2 * len(uavs)))
    nearest = np.argsort(-like[0], axis=1, kind="stable")[:, :_NEAREST]
    return [[int(k) for k in near if like[0, c, k] > limit[c]] for c, near in enumerate(nearest)]


def _is_ahead(group: Floats, ahead: Floats, both: Mask, level: float) -> bool:
    """Whether ``group`` ``(T, 3)`` repeats ``ahead`` later: by the sum of the scores of both and of their changes.

    ``both`` ``(T,)``: where both are seen. At a strict level, each score must exceed 1, too.
    """
    group, ahead = centre_columns(group, both), centre_columns(ahead, both)
    velocity = _measure_score(group, ahead, -1.0)
    changes = _measure_score(np.diff(group, axis=0), np.diff(ahead, axis=0), 1.0)
    limit = max(0.0, -NormalDist().inv_cdf(level))
    return velocity + changes > _DEVIATION_OF_BOTH * limit and (limit == 0.0 or min(velocity, changes) > 1.0)


def _measure_score(group: Floats, ahead: Floats, sign: float) -> float:
    """The lead in standard deviations of those with time reversed in half of the blocks, with this ``sign`` there."""
    blocks = max(_BLOCKS, 2 * (len(group) // (4 * LAGS)))
    halves = np.tile(np.arange(blocks) < blocks // 2, (1 + _SURROGATES, 1))
    halves = np.random.default_rng(0).permuted(halves, axis=1)
    halves[0] = False
    order, turn = reverse_blocks(len(group), halves)
    turn = np.where(turn < 0, sign, 1.0)[..., None]
    lead, *by_chance = _compare_lags(group[order] * turn, ahead[order] * turn)
    deviation = np.sqrt(np.mean(np.square(by_chance)))
    return float(lead / deviation) if deviation else 0.0


def _compare_lags(group: Floats, ahead: Floats) -> Floats:
    """How much better each of ``(n, T, 3)`` agrees with what is ``ahead`` before than with that later; ``(n,)``."""
    later, earlier = (
        np.max([np.einsum("ntk,ntk->n", behind[:, lag:], first[:, :-lag]) for lag in range(1, LAGS + 1)], axis=0)
        for behind, first in ((group, ahead), (ahead, group))
    )
    return np.asarray(later - earlier)


def _scale(velocity: Singles, seen: Mask) -> Singles:
    """Velocities ``(T, N, 3)`` centred over time and scaled to a squared sum of 1; 0 where unseen."""
    return scale_to_unit(centre_columns(velocity, seen), least=0.0)


def _measure_likeness(first: Singles, others: Singles) -> Singles:
    """``(c, N)`` largest correlation of series ``(T, c, 3)`` with those ``(T, N, 3)`` of others at the lags -4 to 4."""
    return correlate_over_lags(first, others, LAGS, least=-LAGS)
