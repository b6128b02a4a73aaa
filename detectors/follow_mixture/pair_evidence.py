"""Who follows whom by pairwise evidence alone: every pair has a law of its own, as where no strategy is shared."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from detectors.follow_mixture.evidence import FeatureKind, affordable_kinds, gain_and_chance, pairwise_gain
from detectors.follow_mixture.explanation import KINDS, Explanation
from detectors.follow_mixture.facility import LEAST_VOTERS, locate_heads
from detectors.follow_mixture.gate import judged, wrong_times
from detectors.follow_mixture.history import OwnHistory
from detectors.follow_mixture.mixture import head_price
from detectors.follow_mixture.samples import Samples

__all__ = ["PairEvidence", "explained_by_pairs", "fly_alone", "led_by", "pair_evidence"]

Floats = NDArray[np.float64]
Indices = NDArray[np.int64]

_BY_CHANCE = 0.99  # quantile of the best of some heads at wrong times
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


def pair_evidence(samples: Samples, history: OwnHistory, most: int | None = None) -> PairEvidence:
    """The evidence by the richest features that the window can feed, and the heads that it names, ``most`` at most."""
    kind = affordable_kinds(samples.rows, samples.memory)[0]
    gain, chance = gain_and_chance(samples, history.surprise, kind)
    found = locate_heads(gain - chance, np.arange(samples.uavs), 0.5 * chance, most)
    return PairEvidence(kind, gain, chance, found.leader)


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


def fly_alone(samples: Samples, history: OwnHistory, heads: Indices, leader: Indices) -> bool:
    """Whether nobody flies at once with a head but its own followers, beyond what the own past of both foretells.

    Where delays differ from follower to follower the earlier explain the later as well as their head does. But such a
    one has fellows: those with the same delay, who follow somebody else.
    """
    surprise = history.surprise.reshape(samples.uavs, -1)
    surprise = surprise / np.maximum(np.sqrt(np.vecdot(surprise, surprise)), 1e-12)[:, None]
    together = surprise[heads] @ surprise.T > max(_FELLOWS, _CHANCE / np.sqrt(3.0 * samples.rows))
    together[np.arange(len(heads)), heads] = False
    elsewhere = together & (leader[None] != heads[:, None])
    return not (2 * elsewhere.sum(axis=1) > together.sum(axis=1)).any()


def explained_by_pairs(samples: Samples, history: OwnHistory, pairs: PairEvidence) -> Explanation | None:
    """The explanation that pairs give, if all its heads pass their gates and fly alone.

    A head adds what its followers gain over what they usually gain at wrong times, by whom of the heads they gain most
    by then.
    """
    heads = pairs.heads
    if not len(heads):
        return None
    leader, moved = led_by(samples, history, pairs, heads)
    count = np.array([(leader == head).sum() for head in heads])
    if (count < LEAST_VOTERS).any() or not fly_alone(samples, history, heads, leader):
        return None
    gain = pairs.gain[:, heads]
    behind = leader[None] == heads[:, None]
    right, *wrong = [behind @ table.max(axis=1) for table in (gain, *moved)]
    usual = np.mean(wrong, axis=0)
    gate = judged(count, right - usual - head_price(samples.uavs), np.array(wrong) - usual)
    if not gate.passed.all():
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
