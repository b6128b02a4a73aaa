"""Confirm leaders: does a group follow its leader later, or do they merely move alike?"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations
from statistics import NormalDist

import numpy as np

from usnet_env.arrays import Floats
from usnet_env.window import Window

__all__ = ["confirm_lead"]

_LAGS = 4  # steps; the step of resampled tracks puts delays at 1 to 4 of them
_BLOCKS = 8
_LEAST_STEPS = 2 * _BLOCKS
_LEVEL = 0.05


def confirm_lead(window: Window, leader: int, followers: Sequence[int]) -> bool:
    """Whether the mean velocity of the followers repeats that of the leader later, more than the reverse.

    The lead is max_τ C(τ) - max_τ C(-τ), τ = 1, ..., 4, where C is the correlation of the followers' mean velocity with
    the leader's velocity τ steps earlier, both centred over the window. It is compared with the leads of 35 surrogates
    in which time is reversed in 4 of 8 blocks: these keep what both do at the same time, and cancel leads. It must
    exceed their standard deviation z times; z is the quantile of a normal distribution at 0.05 / N, because the leader
    was chosen from N. An animal that drives a herd and a flock with a common route have no such lead.

    Args:
        window: the window.
        leader: index of the leader.
        followers: indices of those that follow it.

    Returns:
        Whether the lead is confirmed; false without followers, and true in a window of fewer than 16 steps, which is
        too short for the test.
    """
    if not followers or window.observation_steps < _LEAST_STEPS:
        return bool(followers)
    seen = window.velocity_seen[:, followers]
    count = seen.sum(axis=1)
    both = (count > 0) & window.velocity_seen[:, leader]
    mean = (window.velocity[:, followers] * seen[..., None]).sum(axis=1, dtype=np.float64)
    group, ahead = (
        np.where(both[:, None], values - values[both].mean(axis=0), 0.0) if both.any() else np.zeros_like(values)
        for values in (mean / np.maximum(count, 1)[:, None], window.velocity[:, leader].astype(np.float64))
    )
    parts = np.array_split(np.arange(len(mean)), _BLOCKS)
    by_chance = []
    for reversed_blocks in combinations(range(_BLOCKS), _BLOCKS // 2):
        if 0 in reversed_blocks:
            order = np.concatenate([part[::-1] if b in reversed_blocks else part for b, part in enumerate(parts)])
            sign = np.where(
                np.isin(np.repeat(np.arange(_BLOCKS), [len(part) for part in parts]), reversed_blocks), -1, 1
            )
            by_chance.append(_measure_lead(group[order] * sign[:, None], ahead[order] * sign[:, None]))
    lead, deviation = _measure_lead(group, ahead), float(np.sqrt(np.mean(np.square(by_chance))))
    return lead > max(0.0, -NormalDist().inv_cdf(_LEVEL / window.uavs) * deviation)


def _measure_lead(group: Floats, ahead: Floats) -> float:
    """The lead in units of the product of both standard deviations."""
    size = float(np.sqrt((group**2).sum() * (ahead**2).sum()))
    if not size:
        return 0.0
    later = [float((group[lag:] * ahead[:-lag]).sum()) for lag in range(1, _LAGS + 1)]
    earlier = [float((ahead[lag:] * group[:-lag]).sum()) for lag in range(1, _LAGS + 1)]
    return (max(later) - max(earlier)) / size
