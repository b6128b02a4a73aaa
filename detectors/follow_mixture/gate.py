"""Surrogate test of heads: the contribution of a head, against the same in time-shifted data."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from detectors.follow_mixture.history import OwnHistory
from detectors.follow_mixture.mixture import Mixture, head_price
from detectors.follow_mixture.samples import Samples
from detectors.follow_mixture.strategy import Strategy, gain_matrix

__all__ = ["Gate", "gain_behind", "gate_heads", "judged", "wrong_times"]

Floats = NDArray[np.float64]

_SHIFTS = 3
_ASKED = 8  # sampled followers per head, if the strategy depends on pairs
_MARGIN = 3.0  # in standard deviations of the surrogates
_TIMES = 2.0  # least ratio between the contribution of a head and its value by chance


@dataclass(frozen=True, eq=False)
class Gate:
    """Result of the test of M heads. All arrays are ``(M,)`` in the order of ``mixture.heads.heads``.

    Args:
        followers: the number of followers.
        added: log-likelihood that the head adds, less its penalty.
        chance: the largest value in the surrogates, plus a margin.
        passed: whether ``added`` exceeds ``_TIMES`` times ``chance``.
    """

    followers: NDArray[np.int64]
    added: Floats
    chance: Floats
    passed: NDArray[np.bool_]

    def reasons(self) -> list[str]:
        """One sentence per head."""
        words = []
        for count, added, chance, passed in zip(self.followers, self.added, self.chance, self.passed, strict=True):
            verdict = "passed" if passed else "failed"
            words.append(f"{verdict}: {count} followers gain {added:.0f} nats by it; chance gives {chance:.0f}.")
        return words


def gate_heads(samples: Samples, history: OwnHistory, mixture: Mixture) -> Gate:
    """Test each head of a mixture.

    A surrogate shifts the velocities of all heads in time. It keeps the fitted strategy and what followers gain by
    their own pasts and by the positions of their heads, but it destroys the relation between head and follower. What
    followers still gain by their best head in the surrogate is due to chance.
    """
    heads = mixture.heads.heads
    paired = mixture.strategy.library.paired
    behind = [np.flatnonzero(mixture.heads.leader == head) for head in heads]
    count = np.array([len(every) for every in behind], np.int64)
    asked = [every[: _ASKED if paired else None] for every in behind]
    followers = np.concatenate(asked)
    price = head_price(samples.uavs)
    flights, null, leaders = samples.take(followers), history.take(followers), samples.take(heads)
    observed = _per_head(mixture.gain[followers][:, np.searchsorted(mixture.columns, heads)])
    moved = [gain_behind(flights, null, leaders.moved(shift), mixture.strategy) for shift in wrong_times(samples.rows)]
    surrogate = np.array([_per_head(gain) for gain in moved]).reshape(-1, len(heads))
    share = count / np.array([max(len(some), 1) for some in asked])
    return judged(count, observed * share - price, surrogate * share)


def judged(followers: NDArray[np.int64], added: Floats, surrogates: Floats) -> Gate:
    """Compare the contributions ``added`` ``(M,)`` of heads with those in ``surrogates`` ``(S, M)``."""
    chance = np.zeros(len(added))
    if len(surrogates):
        chance = np.maximum(surrogates.max(axis=0), 0.0) + _MARGIN * surrogates.std(axis=0)
    return Gate(followers, added, chance, added > _TIMES * chance)


def wrong_times(rows: int) -> list[int]:
    """The shifts of the surrogates in rows, evenly spaced and other than 0."""
    shifts = np.unique(np.linspace(0, rows, _SHIFTS + 2).astype(int)[1:-1])
    return [int(shift) for shift in shifts if shift > 0]


def gain_behind(flights: Samples, null: OwnHistory, leaders: Samples, strategy: Strategy) -> Floats:
    """``(v, M)``: the gain of each of v UAVs by each leader."""
    both, law = flights.beside(leaders), null.padded(leaders.uavs)
    heads = np.arange(flights.uavs, both.uavs)
    return gain_matrix(both, law, strategy, heads, np.arange(flights.uavs))


def _per_head(gain: Floats) -> Floats:
    """``(M,)``: the summed gain of followers by their best head over their second best head (or none), per head."""
    gain = np.maximum(gain, 0.0)
    ranked = np.sort(gain, axis=1)
    margin = ranked[:, -1] - (ranked[:, -2] if gain.shape[1] > 1 else 0.0)
    return np.asarray(np.bincount(gain.argmax(axis=1), weights=margin, minlength=gain.shape[1]), np.float64)
