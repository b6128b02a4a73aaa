"""Assigns followers by one regression per pair of UAVs, without a shared strategy."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from detectors.follow_mixture.evidence import FeatureKind, affordable_kinds, gain_and_chance, pairwise_gain
from detectors.follow_mixture.explanation import KINDS, Explanation
from detectors.follow_mixture.facility import LEAST_VOTERS, locate_heads
from detectors.follow_mixture.gate import gain_behind, judged, wrong_times
from detectors.follow_mixture.history import OwnHistory
from detectors.follow_mixture.mixture import head_price
from detectors.follow_mixture.samples import Samples
from detectors.follow_mixture.strategy import Library, fit_strategy

__all__ = ["PairEvidence", "explained_by_pairs", "flies_with", "fly_alone", "led_by", "pair_evidence"]

Floats = NDArray[np.float64]
Indices = NDArray[np.int64]

_BY_CHANCE = 0.99  # quantile of the best gain over the heads in time-shifted data
_TIMES, _LEAST_TIMES = 9, 4  # number of time shifts, 0 included; least number of them
_JOININGS = 4
_FELLOWS = 0.6  # lag-0 correlation of two followers of one head with the same delay
_CHANCE = 5.0  # in standard deviations of the correlation of independent UAVs


@dataclass(frozen=True, eq=False)
class PairEvidence:
    """How well each UAV's past predicts each other UAV's next velocity.

    Args:
        kind: the features.
        gain: ``(n, n)``; entry (i, j) is the log-likelihood that j's past adds to i's own past.
        chance: the median of a UAV's largest gain in time-shifted data.
        leader: ``(n,)``, the assignment that follows, -1 for none.
    """

    kind: FeatureKind
    gain: Floats
    chance: float
    leader: Indices

    @property
    def heads(self) -> Indices:
        """``(M,)``: the UAVs with followers, ascending."""
        return np.unique(self.leader[self.leader >= 0])

    @property
    def above_chance(self) -> Floats:
        """``(n, n)``: the gain less its value by chance."""
        return self.gain - self.chance


def pair_evidence(
    samples: Samples, history: OwnHistory, most: int | None = None, kind: FeatureKind | None = None
) -> PairEvidence:
    """Compute the evidence and the heads, at most ``most``, that follow from it.

    The default features are the richest that the length of the window allows.
    """
    kind = kind or affordable_kinds(samples.rows, samples.memory)[0]
    gain, chance = gain_and_chance(samples, history.surprise, kind)
    found = locate_heads(gain - chance, np.arange(samples.uavs), 0.5 * chance, most)
    return PairEvidence(kind, gain, chance, found.leader)


def plain_evidence(samples: Samples, history: OwnHistory, pairs: PairEvidence, most: int | None = None) -> PairEvidence:
    """Evidence from the same lags without squares, if it is stronger: half the features gain less by chance."""
    if not pairs.kind.squares:
        return pairs
    plain = pair_evidence(samples, history, most, replace(pairs.kind, squares=False))
    return max(pairs, plain, key=lambda some: float(np.maximum(some.above_chance, 0.0).max(axis=1).sum()))


def led_by(samples: Samples, history: OwnHistory, pairs: PairEvidence, heads: Indices) -> tuple[Indices, list[Floats]]:
    """Assign UAVs to given heads; -1 for heads and for UAVs with no higher gain than in time-shifted data.

    Returns:
        The leaders ``(n,)``; and the gains ``(n, M)`` at several time shifts.
    """
    gain = pairs.gain[:, heads]
    others = np.setdiff1d(np.arange(samples.uavs), heads)
    moved = [
        pairwise_gain(samples, history.surprise, pairs.kind, shift, columns=heads)
        for shift in wrong_times(samples.rows)
    ]
    least = np.quantile([wrong[others].max(axis=1) for wrong in moved], _BY_CHANCE) if moved else 0.0
    leader = np.where(gain.max(axis=1) > least, heads[gain.argmax(axis=1)], -1)
    leader[heads] = -1
    return leader, moved


def led_by_laws(samples: Samples, history: OwnHistory, heads: Indices, leader: Indices) -> Indices:
    """Assign the remaining UAVs with one regression per head, fitted on its confident followers.

    The regression has no parameter to fit to the remaining UAVs; so weaker evidence is significant for them.
    """
    for _ in range(_JOININGS):
        before, leader = leader, joined(samples, history, heads, leader)
        if np.array_equal(before, leader):
            break
    return leader


def joined(samples: Samples, history: OwnHistory, heads: Indices, leader: Indices) -> Indices:
    """Add the unassigned UAVs that the regression of their best head predicts better than by chance.

    A regression also predicts the mean velocity of its followers, at any time shift. So the score is the gain at
    shift 0 less the mean gain at other shifts. Its distribution by chance is that of the other shifts among themselves.
    """
    left = np.setdiff1d(np.flatnonzero(leader < 0), heads)
    shifts = np.unique(np.linspace(0, samples.rows, _TIMES + 1).astype(int)[:-1])
    if not len(left) or len(shifts) < _LEAST_TIMES:
        return leader
    every = np.arange(len(left))
    flights, null = samples.take(left), history.take(left)
    gain = np.empty((len(shifts), len(left), len(heads)))
    for place, head in enumerate(heads):
        law = fit_strategy(samples, np.where(leader == head, head, -1), Library(samples.memory, own=True))
        if law is None:
            return leader
        for time, shift in enumerate(shifts):
            moved = samples.take(heads[[place]]).moved(int(shift))
            gain[time, :, place] = gain_behind(flights, null, moved, law)[:, 0]

    def rise(time: int) -> Floats:
        liked = gain[:, every, gain[time].argmax(axis=1)]
        return np.asarray(liked[time] - np.delete(liked, [0, time], axis=0).mean(axis=0))

    least = np.quantile([rise(time) for time in range(1, len(shifts))], _BY_CHANCE)
    found = leader.copy()
    found[left] = np.where(rise(0) > max(least, 0.0), heads[gain[0].argmax(axis=1)], -1)
    return found


def fly_alone(samples: Samples, history: OwnHistory, heads: Indices, leader: Indices) -> bool:
    """Whether no head is coupled at lag 0 with other UAVs, after removing what their own pasts predict.

    If followers have different delays, an early follower predicts a later one as well as their head does. But an early
    follower is correlated at lag 0 with followers of the same delay, which are assigned to another head. A follower
    that is taken for the head of its fellow followers is correlated with them at lag 0; a true head leads them.
    """
    together = simultaneous(samples, history, heads) > max(_FELLOWS, _CHANCE / np.sqrt(3.0 * samples.rows))
    behind = leader[None] == heads[:, None]
    own, elsewhere = (together & behind).sum(axis=1), (together & ~behind).sum(axis=1)
    return not ((2 * elsewhere > own + elsewhere) | (2 * own > behind.sum(axis=1))).any()


def flies_with(samples: Samples, history: OwnHistory, uav: int, others: Indices) -> bool:
    """Whether the median lag-0 correlation of a UAV with the others is significant."""
    if not len(others):
        return False
    together = simultaneous(samples, history, np.array([uav]))[0, others]
    return float(np.median(together)) > _CHANCE / np.sqrt(3.0 * samples.rows)


def simultaneous(samples: Samples, history: OwnHistory, uavs: Indices) -> Floats:
    """``(k, n)``: lag-0 correlation of the innovations of ``uavs`` with those of all UAVs; 0 on the diagonal."""
    surprise = history.surprise.reshape(samples.uavs, -1)
    surprise = surprise / np.maximum(np.sqrt(np.vecdot(surprise, surprise)), 1e-12)[:, None]
    correlation = surprise[uavs] @ surprise.T
    correlation[np.arange(len(uavs)), uavs] = 0.0
    return np.asarray(correlation)


def explained_by_pairs(samples: Samples, history: OwnHistory, pairs: PairEvidence) -> Explanation | None:
    """Fit by pairwise regressions; ``None`` unless all heads pass their tests and have no coupling at lag 0.

    The contribution of a head is the gain of its followers, less the mean gain of the same followers by their best head
    in time-shifted data.
    """
    heads = pairs.heads
    if not len(heads):
        return None
    sure, moved = led_by(samples, history, pairs, heads)
    count = np.array([(sure == head).sum() for head in heads])
    if (count < LEAST_VOTERS).any():
        return None
    gain = pairs.gain[:, heads]
    behind = sure[None] == heads[:, None]
    right, *wrong = [behind @ table.max(axis=1) for table in (gain, *moved)]
    usual = np.mean(wrong, axis=0)
    gate = judged(count, right - usual - head_price(samples.uavs), np.array(wrong) - usual)
    leader = led_by_laws(samples, history, heads, sure)
    if not gate.passed.all() or not fly_alone(samples, history, heads, leader):
        return None
    kind = np.where(leader >= 0, KINDS.index("follower"), KINDS.index("missing"))
    kind[heads] = KINDS.index("passed")
    nats = np.where(leader >= 0, gain.max(axis=1), 0.0)
    return Explanation(
        heads=heads,
        leader=leader,
        probability=np.zeros(samples.uavs),
        given=np.zeros(samples.uavs),
        gain=nats,
        explained=-np.expm1(-nats / samples.rows),
        reasons=gate.reasons(),
        strategy={"class": f"each its own{pairs.kind.name}", "shared": False, "unit_speed": samples.unit},
        value=float(gate.added.sum()),
        kind=kind,
        passed=gate.passed,
    )
