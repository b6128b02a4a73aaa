"""The search: several first assignments, classes of growing power where the data ask for them, and the best of all."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from detectors.follow_mixture.evidence import FeatureKind, affordable_kinds, pairwise_gain
from detectors.follow_mixture.facility import LEAST_VOTERS, locate_heads
from detectors.follow_mixture.history import OwnHistory
from detectors.follow_mixture.mixture import Mixture, fit_mixture, head_price
from detectors.follow_mixture.samples import Samples
from detectors.follow_mixture.strategy import Library, Strategy, directions, fit_strategy, gain_matrix

__all__ = ["Misfit", "first_assignment", "misfit", "search"]

Floats = NDArray[np.float64]
Indices = NDArray[np.int64]

MISFIT = 1.35  # ratios above this ask for a richer class; a class that holds gives 1 within 0.1 or so
NEARLY = 2.5  # a misfit with which nobody's leader is in doubt, where nobody is left over
EXPLAINED = 0.9  # share of the UAVs that a finished explanation accounts for
_REACHES, _NEAREST = 12, 24  # distances tried at once; followers nearest to their heads on which they are tried
NETWORKS = (64, 128)  # units
PAIRED_STARTS = 2  # starts that go on to the costly classes
_WIDENINGS = 4
_MANY_LEFT = 60  # unexplained UAVs beyond which asking all of them is a search of its own
_NEW = 12
_FEW = 0.4  # share of unexplained UAVs up to which a network, the costliest class, asks everybody
_LONG = 60  # rows from which the rich class needs no poorer ones beside it


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


def search(samples: Samples, history: OwnHistory, most: int | None = None) -> Mixture | None:
    """The best explanation found, or ``None`` where nobody seems to follow anybody.

    The richest evidence and class come first, and end the search where they explain the swarm within noise. Otherwise
    every kind of evidence gives a start, classes of one strategy for all followers of a head are climbed from each,
    and the best of them go on to classes that look at the follower as well.
    """
    best: Mixture | None = None
    starts: list[tuple[float, Indices, Floats]] = []
    for place, kind in enumerate(affordable_kinds(samples.rows, samples.memory)):
        leader, evidence = first_assignment(samples, history, kind)
        if not (leader >= 0).any():
            continue
        if place == 0:
            best = shortcut(samples, history, leader, evidence, most)
            if best is not None and (finished(samples, best) or settled(samples, best)):
                return complete(samples, history, best, most)
        reached = -np.inf
        for library in shared_libraries(samples):
            found = fit_mixture(samples, history, leader, library, np.arange(samples.uavs), most)
            if found is None:
                continue
            reached = max(reached, found.value)
            if best is None or found.value > best.value:
                best = found
            if finished(samples, found):
                return complete(samples, history, found, most)
        starts.append((reached, leader, evidence))
    starts.sort(key=lambda start: -start[0])
    for _, leader, evidence in starts[:PAIRED_STARTS]:
        found = climb(samples, history, leader, evidence, best, most)
        if found is not None and (best is None or found.value > best.value):
            best = found
        if best is not None and best.strategy.library.paired and explained(samples, best):
            break
    if best is None or best.value <= 0 or not len(best.heads.heads):
        return None
    return complete(samples, history, best, most)


def settled(samples: Samples, mixture: Mixture) -> bool:
    """Whether nobody is left unexplained and the strategy holds nearly: a richer one would change nobody's leader."""
    if not len(mixture.heads.heads) or unexplained(mixture) >= LEAST_VOTERS:
        return False
    return misfit(samples, mixture.strategy, mixture.heads.leader).worst <= NEARLY


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
    if found is None or not library.paired or (finished(samples, found) and unexplained(found) < LEAST_VOTERS):
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


def shared_libraries(samples: Samples) -> list[Library]:
    """Classes of one strategy for all followers of a head, in the order in which they are tried."""
    memory = samples.memory
    if samples.rows >= _LONG and samples.whiten is None:
        return [Library(memory, squares=True)]
    poor = [Library(memory, squares=True, isotropic=True), Library(memory), Library(memory, linear=False, squares=True)]
    return [Library(memory, squares=True), *poor]


def finished(samples: Samples, mixture: Mixture) -> bool:
    """Whether a mixture of a shared class explains nearly everybody, and leaves nothing but noise."""
    if not len(mixture.heads.heads) or not explained(samples, mixture):
        return False
    return misfit(samples, mixture.strategy, mixture.heads.leader).worst <= MISFIT


def unexplained(mixture: Mixture) -> int:
    """How many UAVs are neither heads nor follow one."""
    return int((mixture.heads.leader < 0).sum()) - len(mixture.heads.heads)


def explained(samples: Samples, mixture: Mixture) -> bool:
    """Whether nearly everybody is a head or follows one."""
    followers = int((mixture.heads.leader >= 0).sum())
    return bool(followers >= EXPLAINED * (samples.uavs - len(mixture.heads.heads)))


def climb(
    samples: Samples, history: OwnHistory, leader: Indices, evidence: Floats, known: Mixture | None, most: int | None
) -> Mixture | None:
    """From a first assignment, and from the best mixture so far, through classes that look at the follower too."""
    best = known
    for library in (
        Library(samples.memory, squares=True, products=True),
        Library(samples.memory, squares=True, towards=True),
        Library(samples.memory, squares=True, towards=True, own=True),
        Library(samples.memory, squares=True, centred=True),
        Library(samples.memory, squares=True, centred=True, own=True),
        *(Library(samples.memory, towards=True, own=True, units=units) for units in NETWORKS),
    ):
        if samples.whiten is not None and (library.own or library.centred):
            continue  # the null behind noise knows one's own past and mean already
        if (library.units or library.centred) and best is not None and unexplained(best) < LEAST_VOTERS:
            continue  # nobody is left whom a richer class could win
        if library.units and (best is None or best.value <= 0):
            continue  # a network is for a following that is there and not understood
        columns = np.arange(samples.uavs)
        if library.paired:
            columns = candidates(evidence, leader if best is None else np.append(leader, best.heads.heads))
        lost = best is None or unexplained(best) > _FEW * samples.uavs
        starts = [] if library.units and lost else [leader]
        if best is not None and len(best.heads.heads):
            starts.append(best.heads.leader)
        for start in starts:
            found = fit_mixture(samples, history, start, library, columns, most)
            for _ in range(_WIDENINGS):
                if found is None or not library.paired or explained(samples, found):
                    break
                if library.units and unexplained(found) > _FEW * samples.uavs:
                    break
                wider = widen(samples, history, found, most)
                if wider is None or wider.value <= found.value + 1e-6:
                    break
                found = wider
            if found is not None and (best is None or found.value > best.value):
                best = found
    return best


def trim(samples: Samples, history: OwnHistory, mixture: Mixture, most: int | None) -> Mixture:
    """Drop the oldest lag as long as all is likelier without: a row counts where all lags were seen."""
    while mixture.strategy.library.lags > 1:
        shorter = replace(mixture.strategy.library, lags=mixture.strategy.library.lags - 1)
        found = fit_mixture(samples, history, mixture.heads.leader, shorter, mixture.columns, most)
        if found is None or found.value <= mixture.value:
            break
        mixture = found
    return mixture


def complete(samples: Samples, history: OwnHistory, mixture: Mixture, most: int | None) -> Mixture:
    """Ask those who are left unexplained about everybody, as a small cluster's head may never have been a candidate.

    Where nobody explains two of them under the strategy found, which was fitted without them, they are made to follow
    whoever does best, and the strategy is fitted again: it stays so if all is likelier then.
    """
    everybody = np.arange(samples.uavs)
    if not samples.complete or samples.rows < _LONG:
        mixture = trim(samples, history, mixture, most)
    for _ in range(_WIDENINGS):
        left = np.setdiff1d(np.flatnonzero(mixture.heads.leader < 0), mixture.heads.heads)
        if len(left) < LEAST_VOTERS or len(left) > _MANY_LEFT:
            break
        gain = gain_matrix(samples, history, mixture.strategy, everybody, left)
        worth = np.maximum(gain, 0.0)
        enough = (worth > 0).sum(axis=0) >= LEAST_VOTERS
        new = np.flatnonzero(enough & (worth.sum(axis=0) > head_price(samples.uavs)))
        new = new[np.argsort(-worth.sum(axis=0)[new], kind="stable")][:_NEW]
        leaders = [mixture.heads.leader]
        if len(left) <= _NEW:
            taken = np.isin(everybody, np.flatnonzero(mixture.heads.leader >= 0))
            chief = int(np.where(taken, -np.inf, gain.sum(axis=0)).argmax())
            forced = mixture.heads.leader.copy()
            forced[left[left != chief]] = chief
            leaders.append(forced)
            new = np.append(new, chief)
        columns = np.union1d(mixture.columns, new)
        before = mixture
        for leader in leaders:
            for library in dict.fromkeys(
                (before.strategy.library, Library(before.strategy.library.lags, squares=True))
            ):
                found = fit_mixture(samples, history, leader, library, columns, most)
                if found is not None and found.value > mixture.value + 1e-6:
                    mixture = found
        if mixture is before:
            break
    return mixture


def widen(samples: Samples, history: OwnHistory, mixture: Mixture, most: int | None) -> Mixture | None:
    """Ask everybody whether they are a head under the strategy found, and climb on with the best."""
    everybody = np.arange(samples.uavs)
    gain = gain_matrix(samples, history, mixture.strategy, everybody)
    heads = locate_heads(gain, everybody, head_price(samples.uavs), most, mixture.heads.heads)
    if not len(heads.heads):
        return None
    columns = candidates(gain, heads.heads)
    return fit_mixture(samples, history, heads.leader, mixture.strategy.library, columns, most)


def candidates(evidence: Floats, present: Indices) -> Indices:
    """Who may be a head where pairs are costly: the present heads and those with the most evidence."""
    worth = np.maximum(evidence, 0.0).sum(axis=0)
    present = np.unique(present[present >= 0])
    best = np.argsort(-worth, kind="stable")[: max(16, 3 * len(present))]
    return np.union1d(best, present)
