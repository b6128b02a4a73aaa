"""The first search: starts from pairwise evidence; the lack of fit of a first fit selects the class of strategies."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from detectors.follow_mixture.facility import LEAST_VOTERS, locate_heads
from detectors.follow_mixture.history import OwnHistory
from detectors.follow_mixture.mixture import Mixture, fit_mixture
from detectors.follow_mixture.pair_evidence import PairEvidence, fly_alone, led_by
from detectors.follow_mixture.samples import Samples
from detectors.follow_mixture.strategy import (
    Library,
    Strategy,
    directions,
    fit_strategy,
    gain_matrix,
    head_features,
    pair_features,
    rows_seen,
)

__all__ = [
    "LEFT_OUT",
    "Misfit",
    "climb_together",
    "climbed",
    "explains",
    "led",
    "misfit",
    "quick",
    "unexplained",
]

Floats = NDArray[np.float64]
Indices = NDArray[np.int64]
Mask = NDArray[np.bool_]

MISFIT = 1.35  # a lack-of-fit ratio above this requires a richer class; a class that fits gives about 1 ± 0.1
_NEARLY = 5.0  # below this lack-of-fit ratio an unassigned UAV is a decoy, not evidence against the model
_SHARED = 1.9  # the same for the part that followers of one head share
EXPLAINED = 0.4  # share of the UAVs that a first assignment must cover to be used as a start
_SETTLING = 6
LEFT_OUT = 0.05  # share of a swarm that may be unassigned in a fit that explains the whole swarm
_AGAIN = 3  # repetitions of the assignment, if many UAVs are unassigned
_REACHES, _NEAREST = 200, 16  # number of distances to try; number of followers, nearest to their heads
_RIDGE = 1e-9


@dataclass(frozen=True)
class Misfit:
    """Lack of fit of a shared strategy, as two ratios that are 1 if it fits.

    Args:
        follower: for the constant part of each follower's residuals: something depends on the follower.
        head: for the part that followers of one head share: the class lacks a function of the head's past.
    """

    follower: float
    head: float

    @property
    def worst(self) -> float:
        """The larger of the two."""
        return max(self.follower, self.head)

    @property
    def nearly_holds(self) -> bool:
        """Whether a UAV that the strategy does not explain may be taken as a UAV without a head."""
        return self.follower <= _NEARLY and self.head <= _SHARED


def misfit(
    samples: Samples, strategy: Strategy, leader: Indices, predicted: tuple[Floats, Mask] | None = None
) -> Misfit:
    """Test a strategy for lack of fit by an analysis of variance of its residuals.

    Args:
        samples: samples of n UAVs.
        strategy: the fitted strategy.
        leader: ``(n,)``, the head of each UAV, -1 for none.
        predicted: :func:`directions` of all followers, if they are known already.
    """
    followers = np.flatnonzero(leader >= 0)
    heads, group = np.unique(leader[followers], return_inverse=True)
    direction, valid = predicted or directions(samples, strategy, followers, leader[followers])
    target = samples.target[followers]
    weight = (valid & samples.seen[followers]).astype(np.float64)
    if samples.unit:
        length = np.sqrt(np.maximum(np.vecdot(direction, direction), 1e-12))
        mean = direction / length[..., None]
        error = target - mean
        error = error - np.vecdot(error, mean)[..., None] * mean
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


def quick(samples: Samples, history: OwnHistory, pairs: PairEvidence, most: int | None = None) -> Mixture | None:
    """Fit from the pairwise evidence of the richest features; ``None`` if the result does not explain the swarm."""
    found = climbed(samples, history, pairs, most)
    return found if found is not None and explains(samples, history, found) else None


def climbed(samples: Samples, history: OwnHistory, pairs: PairEvidence, most: int | None = None) -> Mixture | None:
    """Fit from the pairwise evidence of the richest features, with any number unassigned; ``None`` without a head."""
    found = shortcut(samples, history, pairs, most) if len(pairs.heads) else None
    for _ in range(_AGAIN):
        if found is None or not 0 < unexplained(found) <= samples.uavs / 2:
            break
        better = again(samples, history, pairs, found, most)
        if better is None:
            break
        found = better
    if found is None or not len(found.heads.heads):
        return None
    few = 0 < unexplained(found) <= max(LEAST_VOTERS, LEFT_OUT * samples.uavs)
    return with_led(samples, history, pairs, found) if few else found


def explains(samples: Samples, history: OwnHistory, found: Mixture) -> bool:
    """Whether a mixture explains the swarm.

    All UAVs must be assigned, or all but one if the strategy nearly fits and no sample is missing (an unassigned UAV
    may have been seen too rarely). No head may correlate with other UAVs at lag 0.
    """
    left = unexplained(found)
    if left and (left >= LEAST_VOTERS or not samples.complete):
        return False
    if left and not misfit(samples, found.strategy, found.heads.leader).nearly_holds:
        return False
    return fly_alone(samples, history, found.heads.heads, found.heads.leader)


def with_led(samples: Samples, history: OwnHistory, pairs: PairEvidence, found: Mixture) -> Mixture:
    """Assign the UAVs that the strategy does not explain by pairwise evidence, if it is significant."""
    named, _ = led_by(samples, history, pairs, found.heads.heads)
    return replace(
        found, heads=replace(found.heads, leader=np.where(found.heads.leader >= 0, found.heads.leader, named))
    )


def shortcut(samples: Samples, history: OwnHistory, pairs: PairEvidence, most: int | None) -> Mixture | None:
    """Fit from the assignment by pairwise evidence, in a class of strategies that the lack of fit selects."""
    heads, leader = pairs.heads, pairs.leader
    if (leader >= 0).sum() < EXPLAINED * (samples.uavs - len(heads)):
        return None
    library = Library(samples.memory, squares=True)
    strategy = fit_strategy(samples, leader, library)
    if strategy is None:
        return None
    if misfit(samples, strategy, leader).follower <= MISFIT:
        return fit_mixture(samples, history, leader, library, np.arange(samples.uavs), most, strategy)
    library = replace(library, towards=True)
    worth = np.maximum(pairs.above_chance, 0.0).sum(axis=0)
    worthy = np.argsort(-worth, kind="stable")[: 2 * len(heads)]
    columns = np.union1d(worthy[worth[worthy] >= worth[heads].min()], heads)
    strategy = within_reach(samples, leader, library, strategy)
    if strategy is None:
        return None
    found = fit_mixture(samples, history, leader, strategy.library, columns, most, strategy)
    if found is not None and 2 * unexplained(found) > samples.uavs:
        strategy = within_reach(samples, settled(samples, history, leader, strategy), library) or strategy
        found = fit_mixture(samples, history, leader, strategy.library, columns, most, strategy)
    return found


def settled(samples: Samples, history: OwnHistory, leader: Indices, strategy: Strategy) -> Indices:
    """Assign all UAVs to the most likely of the heads of a poor first assignment, without a threshold."""
    heads = np.unique(leader[leader >= 0])
    for _ in range(_SETTLING):
        before = leader
        leader = heads[gain_matrix(samples, history, strategy, heads).argmax(axis=1)]
        leader[heads] = -1
        strategy = fit_strategy(samples, leader, strategy.library) or strategy
        if np.array_equal(leader, before):
            break
    return leader


def again(
    samples: Samples, history: OwnHistory, pairs: PairEvidence, found: Mixture, most: int | None
) -> Mixture | None:
    """Fit again with all UAVs as candidates and a new range threshold, since some UAVs are unassigned.

    A wrong range threshold may be the reason. So the unassigned UAVs are first left out, then assigned to the most
    likely candidate, then to the head that pairwise evidence prefers; the best fit is returned.
    """
    if not found.strategy.library.towards:
        return None
    library, everybody = replace(found.strategy.library, reach=0.0), np.arange(samples.uavs)
    heads, leader = found.heads.heads, found.heads.leader
    likeliest = found.columns[found.gain.argmax(axis=1)]
    named = heads[pairs.gain[:, heads].argmax(axis=1)]
    best = found
    for guess in (-1, likeliest, named):
        start = np.where(leader >= 0, leader, guess)
        start[heads] = -1
        strategy = found.strategy if np.array_equal(start, leader) else within_reach(samples, start, library)
        if strategy is not None:
            other = fit_mixture(samples, history, start, strategy.library, everybody, most, strategy)
            best = other if other is not None and other.value > best.value else best
    return None if best is found else best


def within_reach(samples: Samples, leader: Indices, library: Library, start: Strategy | None = None) -> Strategy | None:
    """Fit the strategy of a class, with a range threshold if it improves the fit; ``start`` is the initial strategy.

    The threshold is visible only if a follower crosses it. So it is searched among the distances of the followers that
    are nearest to their heads.
    """
    plain = fit_strategy(samples, leader, library, start=start)
    if plain is None:
        return None
    followers = np.flatnonzero(leader >= 0)
    # A follower that is never seen together with its head has no distance to it.
    followers = followers[rows_seen(samples, library, followers, leader[followers]).any(axis=1)]
    gap = samples.position[leader[followers]] - samples.position[followers]
    distance = np.sqrt(np.vecdot(gap, gap))
    near = np.argsort(distance.min(axis=1), kind="stable")[:_NEAREST]
    low, high = max(float(distance[near].min()), 1.0), max(float(np.median(distance[near])), 2.0)
    reaches = np.geomspace(low, high, _REACHES)
    explained = explained_by_reach(samples, plain, followers[near], leader[followers[near]], reaches)
    price = 9.0 * float(np.log(samples.rows * len(near))) * plain.noise.spread**2  # for nine more parameters
    if explained.max() <= price:
        return plain
    reach = float(reaches[explained.argmax()])
    return fit_strategy(samples, leader, replace(library, reach=reach), start=plain)


def explained_by_reach(
    samples: Samples, strategy: Strategy, followers: Indices, heads: Indices, reaches: Floats
) -> Floats:
    """``(K,)``: how much of the residual the direction to the head explains beyond each range threshold.

    These are linear regressions that share all but three columns; the target has the length that the strategy predicts
    before norm(·). The cross products of the three columns are sums over the samples beyond a threshold. They are
    computed between neighbouring thresholds and accumulated from the farthest one.
    """
    plain = replace(strategy.library, reach=0.0)
    unique, group = np.unique(heads, return_inverse=True)
    shared, _ = head_features(samples, plain, unique)
    extra, _ = pair_features(samples, plain, followers, heads)
    predicted, _ = directions(samples, strategy, followers, heads)
    keep = rows_seen(samples, plain, followers, heads)
    known = np.concatenate([extra, shared[group]], axis=2)[keep]
    predicted = predicted[keep]
    target = samples.target[followers][keep] * np.sqrt(np.vecdot(predicted, predicted))[:, None]
    gap = (samples.position[heads] - samples.position[followers])[keep]
    distance = np.sqrt(np.vecdot(gap, gap))
    towards = gap / np.maximum(distance, 1e-6)[:, None]
    gram = known.T @ known
    gram[np.diag_indices(len(gram))] += _RIDGE * np.trace(gram) / len(gram)
    everything = np.concatenate([known, target, towards], axis=1)
    among = np.asarray(np.searchsorted(reaches, distance), np.int64)  # number of smaller thresholds
    beyond = np.zeros((len(reaches) + 1, everything.shape[1], 3))
    order = np.argsort(among, kind="stable")
    among, everything, towards = among[order], everything[order], towards[order]
    edges = np.flatnonzero(np.diff(among, prepend=-1, append=-1)).tolist()
    for first, last in pairwise(edges):
        beyond[among[first]] = everything[first:last].T @ towards[first:last]
    beyond = beyond[:0:-1].cumsum(axis=0)[::-1]
    width = known.shape[1]
    mixed = beyond[:, :width]
    solved = np.linalg.solve(gram, mixed.transpose(1, 0, 2).reshape(width, -1)).reshape(width, -1, 3)
    solved = solved.transpose(1, 2, 0)
    left = beyond[:, width + 3 :] - solved @ mixed
    moment = beyond[:, width : width + 3].transpose(0, 2, 1) - solved @ (known.T @ target)
    left[:, np.arange(3), np.arange(3)] += 1e-9 * max(len(target), 1)
    return np.asarray((moment * np.linalg.solve(left, moment)).sum(axis=(1, 2)))


def led(samples: Samples, history: OwnHistory, leader: Indices, most: int | None = None) -> Mixture | None:
    """Fit a mixture from a given assignment, in classes of increasing size, and return the best.

    Args:
        samples: samples of n UAVs.
        history: the null model.
        leader: ``(n,)``, the head of each UAV, -1 for none.
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


def climb_together(
    samples: Samples, history: OwnHistory, pairs: PairEvidence, starts: list[Indices], most: int | None = None
) -> list[Mixture]:
    """Fit mixtures from several starts; return those with few unassigned UAVs and no coupling at lag 0, best first.

    The strategy may also use the head's position and the follower's own past. An assignment that is right for a third
    of the UAVs can suffice as a start. If followers of one head share a residual, the strategy is fitted again with
    equal weights for all heads; otherwise heads with many followers dominate it.

    Args:
        samples: samples of n UAVs.
        history: the null model.
        pairs: the pairwise evidence, which gives further starts.
        starts: assignments ``(n,)``, -1 for none.
        most: the largest number of heads.
    """
    library, everybody = Library(samples.memory, towards=True, own=True), np.arange(samples.uavs)

    def climb(starts: list[Indices], by_head: bool) -> list[Mixture]:
        unlike = {start.tobytes(): start for start in starts}.values()
        found = [fit_mixture(samples, history, start, library, everybody, most, by_head=by_head) for start in unlike]
        return sorted((some for some in found if some is not None and len(some.heads.heads)), key=least_left)

    best = pairs.gain.argmax(axis=1)
    starts = [*starts, pairs.leader, likely(pairs, most)]
    found = climb([*starts, best], by_head=False)
    if found and misfit(samples, found[0].strategy, found[0].heads.leader).head > _SHARED:
        leader = found[0].heads.leader
        left = leader < 0
        left[found[0].heads.heads] = False
        found += climb([*starts, leader, np.where(left, best, leader)], by_head=True)
    few = [some for some in found if unexplained(some) <= LEFT_OUT * samples.uavs]
    alone = [some for some in few if fly_alone(samples, history, some.heads.heads, some.heads.leader)]
    return sorted(alone, key=least_left)


def least_left(mixture: Mixture) -> tuple[int, float]:
    """Sort key of mixtures: fewest unassigned UAVs first, then highest value."""
    return unexplained(mixture), -mixture.value


def likely(pairs: PairEvidence, most: int | None) -> Indices:
    """``(n,)``: the assignment by pairwise evidence with half of the usual threshold."""
    return locate_heads(pairs.gain - 0.5 * pairs.chance, np.arange(len(pairs.gain)), 0.5 * pairs.chance, most).leader


def unexplained(mixture: Mixture) -> int:
    """Number of unassigned UAVs: neither heads nor followers."""
    return int((mixture.heads.leader < 0).sum()) - len(mixture.heads.heads)
