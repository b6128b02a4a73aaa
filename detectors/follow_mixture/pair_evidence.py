"""Who follows whom by pairwise evidence alone: every pair has a law of its own, as where no strategy is shared."""

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

_BY_CHANCE = 0.99  # quantile of the best of some heads at wrong times
_TIMES, _LEAST_TIMES = 9, 4  # at which laws foretell: one is right
_JOININGS = 4
_FELLOWS = 0.6  # correlation of two who fly at once because they follow the same head with the same delay
_CHANCE = 5.0  # times the standard deviation of the correlation of strangers


@dataclass(frozen=True, eq=False)
class PairEvidence:
    """What everybody's past says of everybody's next velocity.

    Args:
        kind: by which features.
        gain: ``(n, n)`` entry (i, j): log-likelihood that j's past adds to i's own history.
        chance: the most that somebody gains by anybody at a wrong time, in the median.
        leader: ``(n,)`` whom each seems to follow, -1 for nobody.
    """

    kind: FeatureKind
    gain: Floats
    chance: float
    leader: Indices

    @property
    def heads(self) -> Indices:
        """``(M,)`` who seems to be followed, ascending."""
        return np.unique(self.leader[self.leader >= 0])

    @property
    def above_chance(self) -> Floats:
        """``(n, n)``."""
        return self.gain - self.chance


def pair_evidence(
    samples: Samples, history: OwnHistory, most: int | None = None, kind: FeatureKind | None = None
) -> PairEvidence:
    """The evidence by some features, the richest that the window can feed by default, and the heads that it names.

    These are ``most`` at most.
    """
    kind = kind or affordable_kinds(samples.rows, samples.memory)[0]
    gain, chance = gain_and_chance(samples, history.surprise, kind)
    found = locate_heads(gain - chance, np.arange(samples.uavs), 0.5 * chance, most)
    return PairEvidence(kind, gain, chance, found.leader)


def plain_evidence(samples: Samples, history: OwnHistory, pairs: PairEvidence, most: int | None = None) -> PairEvidence:
    """The evidence by as many lags without squares, if it is the stronger: half the features gain less by chance."""
    if not pairs.kind.squares:
        return pairs
    plain = pair_evidence(samples, history, most, replace(pairs.kind, squares=False))
    return max(pairs, plain, key=lambda some: float(np.maximum(some.above_chance, 0.0).max(axis=1).sum()))


def led_by(samples: Samples, history: OwnHistory, pairs: PairEvidence, heads: Indices) -> tuple[Indices, list[Floats]]:
    """Whom everybody follows of some heads, ``(n,)``: -1 for heads, and for who gains no more than at wrong times.

    Returns:
        The leaders; and the gains ``(n, M)`` at some wrong times.
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
    """Whom those follow as well whom :func:`led_by` leaves over, ``(n,)``: by laws that followers of one head share.

    A law that the surest followers show has no number to fit to the others, so that less is enough to show in these.
    """
    for _ in range(_JOININGS):
        before, leader = leader, joined(samples, history, heads, leader)
        if np.array_equal(before, leader):
            break
    return leader


def joined(samples: Samples, history: OwnHistory, heads: Indices, leader: Indices) -> Indices:
    """``leader``, and those left over whom the law of the head that likes them best foretells better than chance.

    A law foretells where its followers fly to in the mean, at any time. What counts is how much more it foretells at
    the right time than at wrong ones; and how much that can be by chance, the wrong times tell of each other.
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
    """Whether no head flies at once with others, its own followers or anybody's, beyond what their own pasts foretell.

    Where delays differ from follower to follower the earlier explain the later as well as their head does. But such a
    one has fellows: those with the same delay, who follow somebody else. And who is taken for the head of its fellows
    flies at once with them; a head flies before them.
    """
    together = simultaneous(samples, history, heads) > max(_FELLOWS, _CHANCE / np.sqrt(3.0 * samples.rows))
    behind = leader[None] == heads[:, None]
    own, elsewhere = (together & behind).sum(axis=1), (together & ~behind).sum(axis=1)
    return not ((2 * elsewhere > own + elsewhere) | (2 * own > behind.sum(axis=1))).any()


def flies_with(samples: Samples, history: OwnHistory, uav: int, others: Indices) -> bool:
    """Whether most of the others fly at once with a UAV more than strangers do."""
    if not len(others):
        return False
    together = simultaneous(samples, history, np.array([uav]))[0, others]
    return float(np.median(together)) > _CHANCE / np.sqrt(3.0 * samples.rows)


def simultaneous(samples: Samples, history: OwnHistory, uavs: Indices) -> Floats:
    """``(k, n)`` correlation of what the own pasts of some, and of everybody, do not foretell; 0 with oneself."""
    surprise = history.surprise.reshape(samples.uavs, -1)
    surprise = surprise / np.maximum(np.sqrt(np.vecdot(surprise, surprise)), 1e-12)[:, None]
    correlation = surprise[uavs] @ surprise.T
    correlation[np.arange(len(uavs)), uavs] = 0.0
    return np.asarray(correlation)


def explained_by_pairs(samples: Samples, history: OwnHistory, pairs: PairEvidence) -> Explanation | None:
    """The explanation that pairs give, if all its heads pass their gates and fly alone.

    A head adds what its followers gain over what they usually gain at wrong times, by whom of the heads they gain most
    by then.
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
