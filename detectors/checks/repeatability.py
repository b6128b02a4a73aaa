"""Checks that an answer comes from the window and the seed alone, and not from the order of the UAVs."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import rankdata

from detectors.checks.harness import SEED, compare_detections, copy_detector, play_windows, require
from detectors.checks.windows import make_hovering_window, permute_uavs, simulate_window
from usnet_env.detection import Detection
from usnet_env.window import Window

__all__ = ["check_episodes_start_afresh", "check_permuting_uavs_permutes_the_answer", "check_same_seed_same_answer"]

EPISODES = 8  # in each order of the UAVs, where chance plays
RELABELLINGS = 1999
LEVEL = (
    0.002  # a sound detector fails by chance once in 500 windows; the seeds are fixed, so it does so always or never
)


def check_same_seed_same_answer(detector: Any) -> None:
    """Two copies that are reset with the same seed answer a whole episode alike, bit by bit."""
    first, second = (play_windows(copy_detector(detector), _make_windows()) for _ in range(2))
    for one, other in zip(first, second, strict=True):
        different = compare_detections(one, other)
        require(not different, f"the same seed must give the same answer, got two in {different}.")


def check_episodes_start_afresh(detector: Any) -> None:
    """After ``reset`` nothing is left of the episode before."""
    own = copy_detector(detector)
    first = play_windows(own, _make_windows())
    play_windows(own, [simulate_window(clusters=1, uavs=20, seed=7)], seed=SEED + 1)
    for one, other in zip(first, play_windows(own, _make_windows()), strict=True):
        different = compare_detections(one, other)
        require(not different, f"reset must forget the episode before, got another answer in {different}.")


def check_permuting_uavs_permutes_the_answer(detector: Any) -> None:
    """Indices carry no meaning: permuted UAVs get permuted answers, exactly or else in distribution.

    Where the answers of one seed do not agree (up to rounding), the answers of some episodes in either order are
    compared by a permutation test of the mean candidates and ranks of the UAVs. In one of the two windows nobody
    moves, and nothing but the index tells the UAVs apart: there, ties that favour low indices show.
    """
    for window, about in (
        (simulate_window(), "in a swarm"),
        (make_hovering_window(together=True), "where nobody moves"),
    ):
        order = np.arange(window.uavs)[::-1]
        turned = permute_uavs(window, order)
        if _are_close(
            _detect_once(detector, window, SEED), _restore_order(_detect_once(detector, turned, SEED), order)
        ):
            continue
        here = [_summarise_detection(_detect_once(detector, window, seed)) for seed in range(EPISODES)]
        there = [
            _summarise_detection(_restore_order(_detect_once(detector, turned, seed), order))
            for seed in range(EPISODES, 2 * EPISODES)
        ]
        p = compute_p_value(np.array(here), np.array(there))
        require(
            p >= LEVEL,
            f"permuted UAVs must get the permuted answer, at least in distribution, got others {about} (p = {p:.4f}).",
        )


def _make_windows() -> list[Window]:
    """Two rounds; made anew each time, so that a detector that writes into windows fails the check about that."""
    return [simulate_window(), simulate_window(seed=1, destroyed=3, round=2)]


def _detect_once(detector: Any, window: Window, seed: int) -> Detection:
    return play_windows(copy_detector(detector), [window], seed)[0]


def _restore_order(answer: Detection, order: NDArray[np.intp]) -> Detection:
    """The candidates and scores of the permuted window in the order of the first."""
    inverse = np.argsort(order)
    return Detection(answer.candidates[inverse], answer.scores[inverse])


def _are_close(one: Detection, other: Detection) -> bool:
    """Equal up to the rounding of sums in another order."""
    scale = max(float(np.abs(one.scores).max()), 1e-12)
    return np.array_equal(one.candidates, other.candidates) and np.allclose(
        one.scores / scale, other.scores / scale, rtol=1e-4, atol=1e-4
    )


def _summarise_detection(answer: Detection) -> NDArray[np.float64]:
    """``(2 N,)``: candidates, and ranks of the scores in (0, 1]."""
    uavs = len(answer.scores)
    # Rounded, so that scores that only rounding tells apart share a rank.
    scale = max(float(np.abs(answer.scores).max()), 1e-12)
    return np.concatenate([answer.candidates, rankdata(np.round(answer.scores / scale, 4)) / uavs])


def compute_p_value(here: NDArray[np.float64], there: NDArray[np.float64]) -> float:
    """Probability that two samples of one distribution have means that differ as much: a permutation test.

    Args:
        here: ``(k, d)``.
        there: ``(k, d)``.
    """
    pooled = np.concatenate([here, there])
    count = len(here)
    rng = np.random.default_rng(0)
    orders = np.stack([np.arange(len(pooled)), *(rng.permutation(len(pooled)) for _ in range(RELABELLINGS))])
    sign = np.where(orders < count, 1.0, -1.0)
    distance = ((sign @ pooled) ** 2).sum(axis=1)
    return float((distance >= distance[0] * (1 - 1e-9) - 1e-9).mean())
