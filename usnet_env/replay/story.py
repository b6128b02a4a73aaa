"""An episode in words and few numbers: what pictures, replays and the terminal say alike."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from usnet_env.replay.episode import EpisodeRecord

__all__ = ["count", "highest_scores", "outcome", "round_line"]

_FEWEST_SCORES = 40


def count(number: int, thing: str) -> str:
    """``1 head``, ``2 heads``."""
    return f"{number} {thing}" if number == 1 else f"{number} {thing}s"


def round_line(record: EpisodeRecord, number: int) -> str:
    """What happened in a round (from 1), in a few words."""
    r = number - 1
    named = int(record.candidates[r].sum())
    left = f"{count(int(record.heads_left[r]), 'head')} left"
    if record.over_budget[r]:
        return f"named {named}, over the shot budget: nobody destroyed, {left}"
    hits, redundant = int(record.hits[r]), int(record.redundant[r])
    return f"named {named} ({count(hits, 'head')} hit, {redundant} redundant), {left}"


def outcome(record: EpisodeRecord) -> str:
    """How the episode ended, in one sentence with its J."""
    heads, left = int(record.head.sum()), int(record.heads_left[-1])
    found = f"All {heads} heads found" if heads > 1 and not left else f"{heads - left} of {count(heads, 'head')} found"
    wrong = count(int(record.redundant.sum()), "redundant candidate")
    sense = "J_m, lower is better" if record.problem == "P2" else "J_s, 0 is best"
    return f"{found} in {count(record.rounds, 'round')} with {wrong}: J = {record.objective[-1]:.3f} ({sense})."


def highest_scores(record: EpisodeRecord, number: int) -> NDArray[np.intp]:
    """The living UAVs that score highest in a round (from 1), best first: enough of them to judge the candidates."""
    scores, alive = record.scores[number - 1], record.alive[number - 1]
    order = np.flatnonzero(alive)[np.argsort(-scores[alive], kind="stable")]
    return order[: max(_FEWEST_SCORES, 3 * int(record.head.sum()), int(record.candidates[number - 1].sum()) + 5)]
