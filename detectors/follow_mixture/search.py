"""The quick way: pairwise evidence, and the class of strategies that the misfit of a first fit asks for."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from detectors.follow_mixture.evidence import FeatureKind, affordable_kinds, pairwise_gain
from detectors.follow_mixture.facility import LEAST_VOTERS, locate_heads
from detectors.follow_mixture.history import OwnHistory
from detectors.follow_mixture.mixture import Mixture, fit_mixture
from detectors.follow_mixture.samples import Samples
from detectors.follow_mixture.strategy import Library, Strategy, directions, fit_strategy

__all__ = ["Misfit", "first_assignment", "led", "misfit", "quick"]

Floats = NDArray[np.float64]
Indices = NDArray[np.int64]

MISFIT = 1.35  # ratios above this ask for a richer class; a class that holds gives 1 within 0.1 or so
NEARLY = 2.5  # a misfit with which nobody's leader is in doubt, where nobody is left over
EXPLAINED = 0.9  # share of the UAVs that a finished explanation accounts for
_REACHES, _NEAREST = 12, 24  # distances tried at once; followers nearest to their heads on which they are tried


@dataclass(frozen=True)
class Misfit:
    """What a shared strategy leaves over, as ratios that are 1 where it holds.

    Args:
        follower: of the part of each follower's residuals that lasts: something depends on the follower.
        head: of the part that followers of one head share: something of the head's past is not in the class.
    """

    follower: float
    head: float

    @property
    def worst(self) -> float:
        """The larger of the two."""
        return max(self.follower, self.head)


def misfit(samples: Samples, strategy: Strategy, leader: Indices) -> Misfit:
    """Test a strategy for lack of fit, without a richer one beside it: an analysis of variance."""
    followers = np.flatnonzero(leader >= 0)
    heads, group = np.unique(leader[followers], return_inverse=True)
    direction, valid = directions(samples, strategy, followers, leader[followers])
    target = samples.target[followers]
    weight = (valid & samples.seen[followers]).astype(np.float64)
    if samples.unit:
        length = np.sqrt(np.maximum((direction**2).sum(axis=2), 1e-12))
        mean = direction / length[..., None]
        error = target - mean
        error = error - (error * mean).sum(axis=2, keepdims=True) * mean
        noise = strategy.noise
        error = error / np.sqrt(noise.floor**2 + (noise.spread / length) ** 2)[..., None]
    else:
        error = target - direction
    error *= weight[..., None]
    power = float((error**2).sum()) / max(float(weight.sum()), 1.0)
    lasting = (error.sum(axis=1) ** 2).sum(axis=1) / np.maximum(weight.sum(axis=1), 1.0)
    member = np.zeros((len(heads), len(followers)))
    member[group, np.arange(len(followers))] = 1.0
    count = member @ weight
    shared = ((member @ error.reshape(len(followers), -1)) ** 2).reshape(len(heads), samples.rows, 3).sum(axis=2)
    met = count > 1
    together = float((shared[met] / count[met]).mean()) if met.any() else power
    return Misfit(float(lasting.mean()) / max(power, 1e-12), together / max(power, 1e-12))


def first_assignment(samples: Samples, history: OwnHistory, kind: FeatureKind) -> tuple[Indices, Floats]:
    """Whom everybody seems to follow by pairwise evidence alone, and that evidence above chance, ``(n, n)``."""
    observed, surrogate = pairwise_gain(samples, history.surprise, kind, (0, samples.rows // 2))
    chance = float(np.median(surrogate.max(axis=1)))
    evidence = observed - chance
    found = locate_heads(evidence, np.arange(samples.uavs), 0.5 * chance)
    return found.leader, evidence


def quick(samples: Samples, history: OwnHistory, most: int | None = None) -> Mixture | None:
    """The explanation that the richest evidence leads to at once, or ``None`` where it does not explain the swarm."""
    kind = affordable_kinds(samples.rows, samples.memory)[0]
    leader, evidence = first_assignment(samples, history, kind)
    if not (leader >= 0).any():
        return None
    found = shortcut(samples, history, leader, evidence, most)
    if found is None or not len(found.heads.heads) or unexplained(found) >= LEAST_VOTERS:
        return None
    return found if misfit(samples, found.strategy, found.heads.leader).worst <= NEARLY else None


def shortcut(
    samples: Samples, history: OwnHistory, leader: Indices, evidence: Floats, most: int | None
) -> Mixture | None:
    """Where pairwise evidence assigns nearly everybody, the class that the misfit asks for, from there."""
    heads = np.unique(leader[leader >= 0])
    if (leader >= 0).sum() < EXPLAINED * (samples.uavs - len(heads)):
        return None
    library = Library(samples.memory, squares=True)
    strategy = fit_strategy(samples, leader, library)
    if strategy is None:
        return None
    columns = np.arange(samples.uavs)
    if misfit(samples, strategy, leader).follower > MISFIT:
        library = Library(samples.memory, squares=True, towards=True)
        worth = np.maximum(evidence, 0.0).sum(axis=0)
        columns = np.union1d(np.argsort(-worth, kind="stable")[: 2 * len(heads)], heads)
    found = fit_mixture(samples, history, leader, library, columns, most)
    if found is None or not library.paired:
        return found
    if unexplained(found) < LEAST_VOTERS and misfit(samples, found.strategy, found.heads.leader).worst <= MISFIT:
        return found
    ranged = within_reach(samples, leader, library)
    other = None if ranged is None else fit_mixture(samples, history, leader, ranged, columns, most)
    return other if other is not None and other.value > found.value else found


def within_reach(samples: Samples, leader: Indices, library: Library) -> Library | None:
    """The class with the reach that fits the followers best, of the distances at which they are seen to fly."""
    followers = np.flatnonzero(leader >= 0)
    gap = samples.position[leader[followers]] - samples.position[followers]
    distance = np.sqrt((gap * gap).sum(axis=2))
    near = np.argsort(distance.min(axis=1), kind="stable")[:_NEAREST]  # a reach shows where somebody crosses it
    some = np.full_like(leader, -1)
    some[followers[near]] = leader[followers[near]]
    spreads: dict[float, float] = {}
    low, high = max(float(distance[near].min()), 1.0), max(float(np.median(distance[near])), 2.0)
    for _ in range(2):  # coarse, then between the neighbours of the best
        for reach in np.geomspace(low, high, _REACHES):
            strategy = fit_strategy(samples, some, replace(library, reach=float(reach)))
            if strategy is not None:
                spreads[float(reach)] = strategy.noise.spread + strategy.noise.floor
        if not spreads:
            return None
        tried = sorted(spreads)
        place = tried.index(min(spreads, key=spreads.__getitem__))
        low, high = tried[max(place - 1, 0)], tried[min(place + 1, len(tried) - 1)]
    return replace(library, reach=min(spreads, key=spreads.__getitem__))


def led(samples: Samples, history: OwnHistory, leader: Indices, most: int | None = None) -> Mixture | None:
    """The mixture that explains best who follows whom, where the heads are known.

    Args:
        samples: n UAVs.
        history: the null.
        leader: ``(n,)`` whom each follows, -1 for nobody.
        most: the largest number of heads.
    """
    heads = np.unique(leader[leader >= 0])
    found = [
        fit_mixture(samples, history, leader, library, heads, most)
        for library in (
            Library(samples.memory, squares=True),
            Library(samples.memory, squares=True, towards=True),
            Library(samples.memory, squares=True, towards=True, own=True),
        )
    ]
    worthy = [mixture for mixture in found if mixture is not None and mixture.value > 0]
    return max(worthy, key=lambda mixture: mixture.value, default=None)


def unexplained(mixture: Mixture) -> int:
    """How many UAVs are neither heads nor follow one."""
    return int((mixture.heads.leader < 0).sum()) - len(mixture.heads.heads)
