"""The words and few numbers of an episode that pictures, replays and the terminal share."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from usnet_env.replay.episode import EpisodeRecord

__all__ = ["describe_outcome", "describe_round", "format_count", "rank_scores"]

_FEWEST_SCORES, _MOST_SCORES, _UNMARKED = 12, 40, 5


def format_count(number: int, noun: str) -> str:
    """Format a number with its noun: ``1 head``, ``2 heads``."""
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"


def describe_round(record: EpisodeRecord, number: int) -> str:
    """Describe a round (from 1) in a few words."""
    r = number - 1
    candidates = format_count(int(record.candidates[r].sum()), "candidate")
    if not record.labelled:
        return f"{format_count(int(record.candidates[r].sum()), 'leader')} named"
    left = f"{format_count(int(record.heads_left[r]), 'head')} left"
    if record.over_budget[r]:
        return f"{candidates}, over the shot budget: no UAV destroyed, {left}"
    hits, redundant = int(record.hits[r]), int(record.redundant[r])
    return f"{candidates} ({format_count(hits, 'head')} hit, {redundant} redundant), {left}"


def describe_outcome(record: EpisodeRecord) -> str:
    """Describe in one sentence how the episode ended, with its J."""
    heads, left = int(record.head.sum()), int(record.heads_left[-1])
    if not record.labelled:
        windows = format_count(record.rounds, "window")
        return f"{heads} of {record.uavs} named as leaders in {windows}; the truth is unknown."
    all_found = heads > 1 and not left
    found = f"All {heads} heads found" if all_found else f"{heads - left} of {format_count(heads, 'head')} found"
    redundant = format_count(int(record.redundant.sum()), "redundant candidate")
    sense = "J_m, lower is better" if record.problem == "P2" else "J_s, 0 is best"
    rounds = format_count(record.rounds, "round")
    return f"{found} in {rounds} with {redundant}: J = {record.objective[-1]:.3f} ({sense})."


def rank_scores(record: EpisodeRecord, number: int) -> NDArray[np.intp]:
    """Indices of the living UAVs that a chart of a round's scores shows (number from 1), highest score first.

    If there is not room for all, heads are preferred, then candidates. Among equal scores, candidates are first. There
    are 12 to 40 UAVs, if so many live.
    """
    r = number - 1
    scores, named = record.scores[r], record.candidates[r]
    living = np.flatnonzero(record.alive[r])
    marked = int((named | record.head)[living].sum())
    count = min(max(marked + _UNMARKED, _FEWEST_SCORES), _MOST_SCORES)
    shown = living[np.lexsort((-scores[living], ~named[living], ~record.head[living]))][:count]
    return shown[np.lexsort((shown, ~named[shown], -scores[shown]))]
