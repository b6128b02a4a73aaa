"""The quick way: pairwise evidence, and the class of strategies that the misfit of a first fit asks for."""

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

MISFIT = 1.35  # ratios above this ask for a richer class; a class that holds gives 1 within 0.1 or so
_NEARLY = 5.0  # a misfit with which somebody whom nobody explains is alone, perhaps, and not led by what was not fitted
_SHARED = 1.9  # the same of what followers of one head share
EXPLAINED = 0.4  # share of the UAVs that a first assignment accounts for where it is worth climbing from
_SETTLING = 6
LEFT_OUT = 0.05  # share of a swarm that one who explains everybody may leave out
_AGAIN = 3  # times that everybody is assigned anew, where many were left out
_REACHES, _NEAREST = 200, 16  # distances tried at once; followers nearest to their heads on which they are tried
_RIDGE = 1e-9


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

    @property
    def nearly_holds(self) -> bool:
        """Whether somebody whom the strategy does not explain may be thought to follow nobody."""
        return self.follower <= _NEARLY and self.head <= _SHARED


def misfit(
    samples: Samples, strategy: Strategy, leader: Indices, predicted: tuple[Floats, Mask] | None = None
) -> Misfit:
    """Test a strategy for lack of fit, without a richer one beside it: an analysis of variance.

    Args:
        samples: n UAVs.
        strategy: fitted.
        leader: ``(n,)``, -1 for nobody.
        predicted: :func:`directions` of all followers, where they are known already.
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
    """The explanation that the richest evidence leads to at once; ``None`` where it does not explain the swarm."""
    found = climbed(samples, history, pairs, most)
    return found if found is not None and explains(samples, history, found) else None


def climbed(samples: Samples, history: OwnHistory, pairs: PairEvidence, most: int | None = None) -> Mixture | None:
    """The mixture that the richest evidence leads to, whomever it leaves over; ``None`` where it leads to no head."""
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
    """Whether a mixture leaves nobody over, or one beside a strategy that nearly holds, and its heads fly alone.

    Where moments are missing somebody left over was seen too little, perhaps.
    """
    left = unexplained(found)
    if left and (left >= LEAST_VOTERS or not samples.complete):
        return False
    if left and not misfit(samples, found.strategy, found.heads.leader).nearly_holds:
        return False
    return fly_alone(samples, history, found.heads.heads, found.heads.leader)


def with_led(samples: Samples, history: OwnHistory, pairs: PairEvidence, found: Mixture) -> Mixture:
    """With those whom the strategy does not explain behind the head that pairwise evidence names, if it names one."""
    named, _ = led_by(samples, history, pairs, found.heads.heads)
    return replace(
        found, heads=replace(found.heads, leader=np.where(found.heads.leader >= 0, found.heads.leader, named))
    )


def shortcut(samples: Samples, history: OwnHistory, pairs: PairEvidence, most: int | None) -> Mixture | None:
    """Where pairwise evidence assigns nearly everybody, the class that the misfit asks for, from there."""
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
    """Whom everybody follows of the heads of a poor first assignment, each the likeliest, however unlikely."""
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
    """A better mixture of those who were left: behind somebody who was no candidate, or a head by another reach.

    As they were left for a reach that is off, perhaps, they are put behind whom they are likeliest to follow, or behind
    the one of the heads found that pairwise evidence names.
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
    """The strategy of a class that fits best, with a reach if it is the better for one; ``start``: to begin from.

    A reach shows where somebody crosses it: it is sought among the distances of the followers nearest to their heads.
    """
    plain = fit_strategy(samples, leader, library, start=start)
    if plain is None:
        return None
    followers = np.flatnonzero(leader >= 0)
    gap = samples.position[leader[followers]] - samples.position[followers]
    distance = np.sqrt(np.vecdot(gap, gap))
    near = np.argsort(distance.min(axis=1), kind="stable")[:_NEAREST]
    low, high = max(float(distance[near].min()), 1.0), max(float(np.median(distance[near])), 2.0)
    reaches = np.geomspace(low, high, _REACHES)
    explained = explained_by_reach(samples, plain, followers[near], leader[followers[near]], reaches)
    price = 9.0 * float(np.log(samples.rows * len(near))) * plain.noise.spread**2  # of nine numbers more
    if explained.max() <= price:
        return plain
    reach = float(reaches[explained.argmax()])
    return fit_strategy(samples, leader, replace(library, reach=reach), start=plain)


def explained_by_reach(
    samples: Samples, strategy: Strategy, followers: Indices, heads: Indices, reaches: Floats
) -> Floats:
    """``(K,)`` what the direction to the head beyond each reach explains of what the class leaves without one.

    Linear regressions that share all but three columns, of flights as long as the strategy says they are before norm.
    What these three share with the rest and with the flights are sums over the moments beyond a reach: of all sums
    between two reaches, added up from the farthest.
    """
    plain = replace(strategy.library, reach=0.0)
    unique, group = np.unique(heads, return_inverse=True)
    shared, valid = head_features(samples, plain, unique)
    extra, also = pair_features(samples, plain, followers, heads)
    predicted, _ = directions(samples, strategy, followers, heads)
    keep = valid[group] & also & samples.seen[followers]
    known = np.concatenate([extra, shared[group]], axis=2)[keep]
    predicted = predicted[keep]
    target = samples.target[followers][keep] * np.sqrt(np.vecdot(predicted, predicted))[:, None]
    gap = (samples.position[heads] - samples.position[followers])[keep]
    distance = np.sqrt(np.vecdot(gap, gap))
    towards = gap / np.maximum(distance, 1e-6)[:, None]
    gram = known.T @ known
    gram[np.diag_indices(len(gram))] += _RIDGE * np.trace(gram) / len(gram)
    everything = np.concatenate([known, target, towards], axis=1)
    among = np.asarray(np.searchsorted(reaches, distance), np.int64)  # how many reaches are nearer
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


def climb_together(
    samples: Samples, history: OwnHistory, pairs: PairEvidence, starts: list[Indices], most: int | None = None
) -> list[Mixture]:
    """Mixtures that leave hardly anybody unexplained, the fewest first, and whose heads fly alone.

    Their strategy looks at the head's place and the follower's own past too. The more of an assignment is right the
    better it fits, so that a third of it may do. Where the strategy leaves something that all followers of one head
    share, it is fitted anew with the same say for every head: the heads of many would have it explain what they did by
    chance, and refuse those of few.

    Args:
        samples: n UAVs.
        history: the null.
        pairs: whom everybody seems to follow by itself: to start from as well.
        starts: assignments ``(n,)``, -1 for nobody.
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
    """What mixtures are ordered by: those first that leave the fewest unexplained, of these the likeliest."""
    return unexplained(mixture), -mixture.value


def likely(pairs: PairEvidence, most: int | None) -> Indices:
    """``(n,)`` whom everybody seems to follow where half of chance is enough."""
    return locate_heads(pairs.gain - 0.5 * pairs.chance, np.arange(len(pairs.gain)), 0.5 * pairs.chance, most).leader


def unexplained(mixture: Mixture) -> int:
    """How many UAVs are neither heads nor follow one."""
    return int((mixture.heads.leader < 0).sum()) - len(mixture.heads.heads)
