"""Checks that a detection depends on the window and the seed only, and not on the order of the UAVs."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.stats import rankdata

from detectors.checks.harness import SEED, copy_detector, play_windows, require, require_same, warn
from detectors.checks.windows import draw_two_rounds, draw_window, make_hovering_window, permute_uavs
from usnet_env.arrays import Floats, Mask
from usnet_env.window import Window

EPISODES = 8  # per order of the UAVs, for detectors that draw random numbers
RELABELLINGS = 1999
# Significance level: a correct detector fails by chance on 1 of 500 windows. The seeds are fixed, so the result of a
# detector never changes from run to run.
LEVEL = 0.002


def check_same_seed_same_answer(detector: Any) -> None:
    """Two copies that are reset with the same seed return bitwise equal detections over an episode."""
    first, second = (play_windows(copy_detector(detector), draw_two_rounds(detector)) for _ in range(2))
    for one, other in zip(first, second, strict=True):
        require_same(one, other, "the same seed must give the same detection, got different")


def check_episodes_start_afresh(detector: Any) -> None:
    """``reset`` removes all state of the previous episode."""
    own = copy_detector(detector)
    first = play_windows(own, draw_two_rounds(detector))
    play_windows(own, [draw_window(detector, clusters=1, uavs=20, seed=7)], seed=SEED + 1)
    for one, other in zip(first, play_windows(own, draw_two_rounds(detector)), strict=True):
        require_same(one, other, "reset must clear the previous episode, got different")


def check_permuting_uavs_permutes_the_answer(detector: Any) -> None:
    """Indices carry no meaning: permuting the UAVs permutes the detection, exactly or in distribution.

    If the detections of one seed differ by more than rounding, the detections of several episodes in each order are
    compared by a permutation test on the mean candidates and the mean ranks of the UAVs.

    A second window shows UAVs that don't move and differ in their indices only. A detector that decides by the index
    there gets a warning: it breaks ties by the index, which no data can make right or wrong.
    """
    p = _compare_orders(detector, draw_window(detector))
    require(
        p >= LEVEL,
        f"permuting the UAVs must permute the detection (in distribution), got another in a swarm (p = {p:.4f}).",
    )
    if _compare_orders(detector, make_hovering_window(detector, together=True)) < LEVEL:
        warn(
            "ties are broken by the index where nothing distinguishes the UAVs; to break them at random, rank the UAVs "
            "in the order self.rng.permutation(window.uavs)."
        )


def _compare_orders(detector: Any, window: Window) -> float:
    """p-value of equal detections for the UAVs of a window in their order and in another one; 1 if they are equal."""
    order = np.random.default_rng(SEED).permutation(window.uavs)  # the reverse order would keep pairs of neighbours
    shuffled, back = permute_uavs(window, order), np.argsort(order)

    def detect(seed: int, shuffle: bool) -> tuple[Mask, Floats]:
        """Candidates and scores in the order of the window."""
        (answer,) = play_windows(copy_detector(detector), [shuffled if shuffle else window], seed)
        return (answer.candidates[back], answer.scores[back]) if shuffle else (answer.candidates, answer.scores)

    if _are_close(*detect(SEED, shuffle=False), *detect(SEED, shuffle=True)):
        return 1.0
    here = [_summarise_detection(*detect(seed, shuffle=False)) for seed in range(EPISODES)]
    there = [_summarise_detection(*detect(seed, shuffle=True)) for seed in range(EPISODES, 2 * EPISODES)]
    return compute_p_value(np.array(here), np.array(there))


def _are_close(candidates: Mask, scores: Floats, other_candidates: Mask, other_scores: Floats) -> bool:
    """Whether two detections agree up to the rounding errors of another order of summation."""
    scale = max(float(np.abs(scores).max()), 1e-12)
    near = np.allclose(scores / scale, other_scores / scale, rtol=1e-4, atol=1e-4)
    return near and np.array_equal(candidates, other_candidates)


def _summarise_detection(candidates: Mask, scores: Floats) -> Floats:
    """``(2 N,)``: the candidates, and the ranks of the scores in (0, 1]."""
    # Scores that differ by rounding errors only must share a rank.
    scale = max(float(np.abs(scores).max()), 1e-12)
    return np.concatenate([candidates, rankdata(np.round(scores / scale, 4)) / len(scores)])


def compute_p_value(here: Floats, there: Floats) -> float:
    """p-value of a permutation test for equal means of two samples, ``(k, d)`` each."""
    pooled = np.concatenate([here, there])
    rng = np.random.default_rng(0)
    orders = np.stack([np.arange(len(pooled)), *(rng.permutation(len(pooled)) for _ in range(RELABELLINGS))])
    sign = np.where(orders < len(here), 1.0, -1.0)
    distance = ((sign @ pooled) ** 2).sum(axis=1)
    return float((distance >= distance[0] * (1 - 1e-9) - 1e-9).mean())
