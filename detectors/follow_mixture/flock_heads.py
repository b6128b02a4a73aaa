"""Heads of flocks: whose past adds to what a flock's own past tells of its flight.

A flock's mean flight carries little of its members' jitter and of the observer's noise, so that a few flocks say what
many noisy followers could not. It also settles who leads: a fellow's past is the flock's own past, which the null
knows, and adds nothing to it; a head's does. When a member is asked whether it leads, its own flight is left out of
the flock's.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from detectors.follow_mixture.evidence import whitened
from detectors.follow_mixture.facility import locate_heads
from detectors.follow_mixture.flocks import Flocks
from detectors.follow_mixture.mixture import head_price
from detectors.follow_mixture.samples import Samples
from detectors.follow_mixture.strategy import Library, head_features

__all__ = ["FlockHeads", "Watch", "affordable", "each_by_itself", "heads_of_flocks", "shown", "watch_flocks"]

Floats = NDArray[np.float64]
Indices = NDArray[np.int64]

_ROUNDS = 8
_ROWS_A_LAG = 12  # of one's own past in the null: three numbers each
_RIDGE = 1e-6
_STARTS = 3
LONELY = 12.0  # nats that a flight like nobody else's must gain before it is said to follow somebody
_FAIR = 0.25  # share of a flock's gain that a flight like nobody else's must have to count beside it
_SOBERED = 8  # candidates of a flock whose gain is looked at moment by moment
_MOMENT = 6.0  # nats that one moment may add
_MEDIAN = 2.366  # of a chi-square with three degrees of freedom
_LEAST_SPREAD = 0.005  # of a flight, in mean speeds
_NOTHING = 1e-9
_EXACT = 6  # candidates of a flock whose evidence is computed exactly
_LEAST_LEFT = 1e-4  # share of a flock's flight that no head explains


@dataclass(frozen=True, eq=False)
class Watch:
    """The flights of C flocks, and of every UAV's flock without it; all with their own pasts taken out.

    Args:
        label: ``(n,)`` the flock of each UAV.
        flight: ``(C + n, R, 3)`` what a flock's own past leaves of its mean flight; then the same of flocks that lack
            one member each, 0 where that one was alone.
        past: ``(C + n, R, z)`` orthonormal columns that span the own pasts and the mean.
    """

    label: Indices
    flight: Floats
    past: Floats

    @property
    def uavs(self) -> int:
        """How many UAVs."""
        return len(self.label)

    @property
    def flocks(self) -> int:
        """C."""
        return len(self.flight) - self.uavs

    @property
    def freedom(self) -> int:
        """Rows less those that the own past takes."""
        return self.flight.shape[1] - self.past.shape[2]

    def watcher(self, flock: int, head: int) -> int:
        """The row of ``flight`` that tells whether UAV ``head`` leads ``flock``."""
        return self.flocks + head if self.label[head] == flock else flock

    def by_flock(self, all_of_flocks: Floats, own_of_members: Floats) -> Floats:
        """``(C, n)`` from ``(C, n)`` of whole flocks and ``(n,)`` of each UAV in its own."""
        result = all_of_flocks.copy()
        result[self.label, np.arange(self.uavs)] = own_of_members
        return result


def watch_flocks(samples: Samples, flocks: Flocks) -> Watch:
    """The flocks of a swarm as voters.

    Args:
        samples: n UAVs, as they were seen, nothing missing.
        flocks: of the same UAVs.
    """
    member = (flocks.label[None, :] == np.arange(flocks.count)[:, None]).astype(np.float64)
    without = member[flocks.label] - np.eye(samples.uavs)
    weight = np.concatenate([member, without])
    weight /= np.maximum(weight.sum(axis=1, keepdims=True), 1.0)
    flight = np.tensordot(weight, samples.target, axes=1)
    lags = int(np.clip(samples.rows // _ROWS_A_LAG, 1, samples.memory))
    own = np.tensordot(weight, samples.lagged[:, :, :lags], axes=1).reshape(len(weight), samples.rows, -1)
    past, _ = np.linalg.qr(np.concatenate([np.ones((len(weight), samples.rows, 1)), own], axis=2))
    return Watch(flocks.label, flight - past @ (past.transpose(0, 2, 1) @ flight), past)


@dataclass(frozen=True, eq=False)
class Shown:
    """What a class of strategies sees of every UAV's past.

    Args:
        library: the class.
        values: ``(n, R, p)``; ``(n, R, p, 3)`` of an isotropic class, whose weights are the same for all axes.
    """

    library: Library
    values: Floats

    @property
    def numbers(self) -> int:
        """How many weights a strategy has."""
        return self.values.shape[2] * (1 if self.library.isotropic else 3)

    def predicted(self, weights: Floats) -> Floats:
        """``(n, R, 3)`` by weights ``(p, 3)``, or ``(p,)`` of an isotropic class."""
        return np.asarray(
            np.moveaxis(self.values, 2, -1) @ weights if self.library.isotropic else self.values @ weights
        )

    def one(self, uav: int, past: Floats) -> Floats:
        """Of one UAV, with an own past ``(R, z)`` taken out: ``(R, p)``, or ``(3 R, p)`` of an isotropic class."""
        flat = self.values[uav].reshape(len(past), -1)
        flat = flat - past @ (past.T @ flat)
        if not self.library.isotropic:
            return flat
        return flat.reshape(len(past), -1, 3).transpose(0, 2, 1).reshape(3 * len(past), -1)


@dataclass(frozen=True, eq=False)
class FlockHeads:
    """Heads of flocks.

    Args:
        head: ``(C,)`` the head of each flock, -1 for none.
        gain: ``(C, n)`` log-likelihood that each flock gains over its own past by following each UAV.
        shown: the class of the strategy, and what it sees.
        weights: of the strategy that all share, ``(p, 3)`` or ``(p,)``; ``None``: every pair has its own.
        chance: what a strategy of one's own explains by chance, left out of ``gain``; 0 for a shared one.
        value: what all gain after prices.
    """

    head: Indices
    gain: Floats
    shown: Shown
    weights: Floats | None
    chance: float
    value: float

    @property
    def heads(self) -> Indices:
        """``(M,)`` ascending."""
        return np.unique(self.head[self.head >= 0])


def shown(samples: Samples, library: Library) -> Shown:
    """The features of all UAVs; the null has the intercept and the means."""
    values = head_features(samples, library)[0][..., :-1]
    values = values - values.mean(axis=1, keepdims=True)
    if library.isotropic:
        values = values.reshape(*values.shape[:2], -1, 3)
        if library.squares:  # at one speed they add up to a constant; behind noise the sum is noise alone
            squares = values[:, :, library.lags if library.linear else 0 :]
            squares -= squares.mean(axis=3, keepdims=True)
    return Shown(library, values)


def flock_libraries(lags: int) -> list[Library]:
    """Classes of strategies: functions of a head's past that differ little from flock to flock."""
    linear = [Library(lag, isotropic=same) for same in (False, True) for lag in {lags, 1}]
    squares = [replace(library, linear=False, squares=True) for library in linear]
    mixed = [Library(lags, squares=True), Library(1, squares=True, products=True)]
    if lags > 1:
        mixed.append(Library(2, squares=True, products=True, across=True))
        mixed.append(Library(2, linear=False, turns=True, isotropic=True))
    return linear + squares + mixed


def heads_of_flocks(samples: Samples, watch: Watch, most: int | None = None) -> FlockHeads | None:
    """The heads that explain the flocks best.

    Every class gives a start by itself, in which every pair of a flock and a UAV has a strategy of its own. From the
    best start, and from the best state after that, all classes are climbed with one strategy for all.

    Args:
        samples: n UAVs with the pasts that candidates show: as they were seen, or smoothed.
        watch: their flocks.
        most: the largest number of heads.

    Returns:
        ``None`` where no flock seems to follow anybody.
    """
    classes = [shown(samples, library) for library in flock_libraries(samples.memory)]
    starts = [each_by_itself(watch, some, most) for some in classes if affordable(watch, some)]
    if not starts:
        return None
    starts.sort(key=lambda start: -start.value)
    best = max((in_company(watch, start, most) for start in starts), key=lambda found: found.value)
    waiting = [start.head for start in starts[:_STARTS]]
    climbed: set[bytes] = set()
    while waiting:
        start = waiting.pop(0)
        if start.tobytes() in climbed:
            continue
        climbed.add(start.tobytes())
        for some in classes:
            found = fit_flocks(watch, some, start, most)
            if found is not None and found.value > best.value + 1e-6:
                best = found
        waiting.append(best.head)
    best = sobered(watch, best, most)
    return best if len(best.heads) else None


def affordable(watch: Watch, some: Shown) -> bool:
    """Whether there are moments enough for every pair to have a strategy of its own."""
    return some.numbers <= 2.0 * watch.freedom


def each_by_itself(watch: Watch, some: Shown, most: int | None) -> FlockHeads:
    """Heads by what each UAV's features explain of each flock, with a strategy of its own for every pair.

    All pairs are screened by matrix products that leave out what a UAV's past shares with the flock's own, which can
    only lower the evidence; the best are computed exactly. The price of so many numbers is what the best UAV explains
    of a flock that was moved in time.
    """
    rows, count, uavs = watch.flight.shape[1], watch.flocks, watch.uavs
    power = np.maximum((watch.flight**2).sum(axis=(1, 2)), 1e-12)
    values = some.values
    if some.library.isotropic:
        values = values.transpose(0, 1, 3, 2).reshape(uavs, 3 * rows, -1)
    white = whitened(values, _RIDGE)
    width = white.shape[2]
    flat = white.transpose(0, 2, 1).reshape(uavs * width, -1)

    def gain(flight: Floats) -> Floats:
        targets = flight.reshape(len(flight), white.shape[1], -1)
        axes = targets.shape[2]
        product = flat @ targets[:count].transpose(1, 0, 2).reshape(white.shape[1], count * axes)
        squares = (product.reshape(uavs, width, count, axes) ** 2).sum(axis=(1, 3)).T
        own = ((white.transpose(0, 2, 1) @ targets[count:]) ** 2).sum(axis=(1, 2))
        share = watch.by_flock(squares / power[:count, None], own / power[count:])
        return np.asarray(-1.5 * watch.freedom * np.log1p(-np.clip(share, 0.0, 1.0 - _LEAST_LEFT)))

    surrogate = gain(np.roll(watch.flight, rows // 2, axis=1))
    evidence = gain(watch.flight)
    best = np.argsort(-evidence, axis=1, kind="stable")[:, :_EXACT]
    evidence -= float(np.median(surrogate.max(axis=1)))
    # An exact regression has less freedom than the screen, and explains more by chance.
    chance = float(np.median(surrogate.max(axis=1))) + 1.5 * watch.freedom * float(
        np.log((1.0 - width / white.shape[1]) / (1.0 - width / (white.shape[1] - 3.0 * (rows - watch.freedom))))
        if some.library.isotropic
        else np.log((1.0 - width / rows) / (1.0 - width / watch.freedom))
    )
    done = np.zeros(evidence.shape, bool)
    wanted = [(flock, int(uav)) for flock in range(count) for uav in best[flock]]
    for _ in range(_ROUNDS):
        for flock, uav in wanted:
            evidence[flock, uav] = exact_gain(watch, some, flock, uav) - chance
            done[flock, uav] = True
        head = locate(watch, evidence, head_price(uavs), most)
        heads = np.unique(head[head >= 0])
        wanted = [(flock, int(uav)) for flock in range(count) for uav in heads if not done[flock, uav]]
        if not wanted:
            break
    return FlockHeads(head, evidence, some, None, chance, worth(watch, evidence, head))


def in_company(watch: Watch, found: FlockHeads, most: int | None) -> FlockHeads:
    """The heads by gains of strategies that pairs have of their own, with :func:`lone_votes` for who flies alone."""
    gain = lone_votes(watch, found.gain)
    head = locate(watch, gain, head_price(watch.uavs), most)
    return replace(found, head=head, gain=gain, value=worth(watch, gain, head))


def lone_votes(watch: Watch, gain: Floats) -> Floats:
    """Gains ``(C, n)`` of strategies of one's own, in which one flight alone has little voice.

    Who flies alone must gain a fair share of what flocks gain by their heads; where no flock has one, nothing counts.
    """
    alone = np.bincount(watch.label, minlength=watch.flocks) == 1
    best = gain[~alone].max(axis=1, initial=0.0)
    led = best[best > LONELY]
    least = max(LONELY, _FAIR * float(np.median(led))) if len(led) else np.inf
    return np.where(alone[:, None] & (gain < least), np.minimum(gain, 0.0), gain)


def exact_gain(watch: Watch, some: Shown, flock: int, uav: int) -> float:
    """Log-likelihood that a UAV's features add to a flock's own past, by a regression on both."""
    flight, error = by_regression(watch, some, flock, uav)
    power = float((flight**2).sum())
    if power <= _NOTHING:
        return 0.0
    return -1.5 * watch.freedom * float(np.log(max(float((error**2).sum()) / power, _LEAST_LEFT)))


def by_regression(watch: Watch, some: Shown, flock: int, uav: int) -> tuple[Floats, Floats]:
    """``(R, 3)`` flight, and what a strategy of the pair's own leaves of it."""
    row = watch.watcher(flock, uav)
    seen = some.one(uav, watch.past[row])
    flight = watch.flight[row]
    target = flight.reshape(len(seen), -1)
    gram = seen.T @ seen
    gram[np.diag_indices(len(gram))] += _RIDGE * np.trace(gram) / len(gram) + 1e-12
    return flight, (target - seen @ np.linalg.solve(gram, seen.T @ target)).reshape(flight.shape)


def sober_gain(flight: Floats, error: Floats, freedom: int) -> float:
    """What an explanation gains when no moment may count for much.

    Rows ``(R, 3)`` are judged by Student's law with four degrees of freedom about a robust spread. Where flight is a
    few sharp turns between straight lines, a normal law takes one turn soon after another for a thousand nats.
    """

    def rows(values: Floats) -> Floats:
        square = (values**2).sum(axis=1)
        spread = max(float(np.sqrt(np.median(square) / _MEDIAN)), _LEAST_SPREAD)
        return np.asarray(-3.0 * np.log(spread) - 3.5 * np.log1p(square / (4.0 * spread**2)))

    return freedom / len(flight) * float(np.minimum(rows(error) - rows(flight), _MOMENT).sum())


def sobered(watch: Watch, found: FlockHeads, most: int | None) -> FlockHeads:
    """The heads again, by sober gains of every flock's best candidates; who was none is none."""
    predicted = None if found.weights is None else found.shown.predicted(found.weights)
    gain = np.minimum(found.gain, 0.0)
    for flock in range(watch.flocks):
        for uav in np.union1d(np.argsort(-found.gain[flock], kind="stable")[:_SOBERED], found.heads):
            if found.gain[flock, uav] > 0:
                gain[flock, uav] = min(pair_gain(watch, found, predicted, flock, int(uav)), found.gain[flock, uav])
        best = int(gain[flock].argmax())  # a cap on moments must not make near misses of those far behind the best
        behind = found.gain[flock] - found.gain[flock, best]
        gain[flock] = np.minimum(gain[flock], gain[flock, best] + np.minimum(behind, 0.0))
    if found.weights is None:
        gain = lone_votes(watch, gain)
    head = locate(watch, gain, head_price(watch.uavs), most)
    return replace(found, head=head, gain=gain, value=worth(watch, gain, head))


def pair_gain(watch: Watch, found: FlockHeads, predicted: Floats | None, flock: int, uav: int, shift: int = 0) -> float:
    """Sober gain of a flock by one UAV, whose past may be moved in time; above chance where the pair has its own."""
    if predicted is None:
        moved = found.shown if shift == 0 else Shown(found.shown.library, np.roll(found.shown.values, shift, axis=1))
        flight, error = by_regression(watch, moved, flock, uav)
        return sober_gain(flight, error, watch.freedom) - found.chance
    row = watch.watcher(flock, uav)
    past, flight = watch.past[row], watch.flight[row]
    shown_now = np.roll(predicted[uav], shift, axis=0)
    return sober_gain(flight, flight - shown_now + past @ (past.T @ shown_now), watch.freedom)


def worth(watch: Watch, gain: Floats, head: Indices) -> float:
    """What flocks gain by their heads, less the price of naming these."""
    followed = np.flatnonzero(head >= 0)
    single = np.bincount(watch.label, minlength=watch.flocks)[followed] == 1
    named = LONELY * single.sum() + head_price(watch.uavs) * len(np.unique(head[followed]))
    return float(gain[followed, head[followed]].sum()) - named


def fit_flocks(watch: Watch, some: Shown, head: Indices, most: int | None = None) -> FlockHeads | None:
    """Climb from the heads ``(C,)`` of the flocks within one class, with one strategy for all."""
    best: FlockHeads | None = None
    spread = np.ones(watch.flocks)
    for turn in range(_ROUNDS):
        followed = np.flatnonzero(head >= 0)
        observations = 3 * watch.freedom * len(followed)
        if observations <= 2 * some.numbers:
            break
        weights = fit_weights(watch, some, head, spread)
        left, gain = shared_gain(watch, some.predicted(weights))
        before, head = head, locate(watch, gain, head_price(watch.uavs), most)
        followed = np.flatnonzero(head >= 0)
        if not len(followed):
            break
        spread[followed] = np.sqrt(left[followed, head[followed]] / (3.0 * watch.freedom))
        value = worth(watch, gain, head) - 0.5 * some.numbers * float(np.log(observations))
        if best is not None and value <= best.value + 1e-6:
            break
        best = FlockHeads(head, gain, some, weights, 0.0, value)
        if turn > 0 and np.array_equal(head, before):  # the first turn knows no spreads yet
            break
    return best


def shared_gain(watch: Watch, predicted: Floats) -> tuple[Floats, Floats]:
    """``(C, n)`` squared error that predictions ``(n, R, 3)`` leave, and the log-likelihood that they gain.

    Every flock has a spread of its own, which its size and its members' jitter give it.
    """
    own = (watch.flight**2).sum(axis=(1, 2))
    null = watch.by_flock(np.repeat(own[: watch.flocks, None], watch.uavs, axis=1), own[watch.flocks :])
    left = np.maximum(squared_error(watch, predicted), _LEAST_LEFT * null)
    gain = np.zeros_like(null)
    flies = null > 1e-9
    gain[flies] = -1.5 * watch.freedom * np.log(left[flies] / null[flies])
    return left, gain


def fit_weights(watch: Watch, some: Shown, head: Indices, spread: Floats) -> Floats:
    """Weights of the strategy that all flocks share, each flock weighted by the inverse square of its spread.

    Returns:
        ``(p, 3)``, or ``(p,)`` of an isotropic class.
    """
    width = some.values.shape[2]
    gram: Floats = np.zeros((width, width))
    moment: Floats = np.zeros((width, 1 if some.library.isotropic else 3))
    for flock in np.flatnonzero(head >= 0):
        watcher = watch.watcher(int(flock), int(head[flock]))
        seen = some.one(int(head[flock]), watch.past[watcher])
        flight = watch.flight[watcher].reshape(len(seen), -1)
        gram = gram + seen.T @ seen / spread[flock] ** 2
        moment = moment + seen.T @ flight / spread[flock] ** 2
    gram[np.diag_indices(len(gram))] += _RIDGE * np.trace(gram) / len(gram) + 1e-12
    weights = np.asarray(np.linalg.solve(gram, moment))
    return weights[:, 0] if some.library.isotropic else weights


def squared_error(watch: Watch, predicted: Floats) -> Floats:
    """``(C, n)`` what each UAV's prediction ``(n, R, 3)`` leaves of each flock's flight, own pasts taken out of both.

    With P the projection onto the own past, |(1 - P)(y - f)|² = |y|² - 2 y·f + |f|² - |Q' f|² as y has none of it.
    """
    count, flock = watch.flocks, slice(0, watch.flocks)
    whole = predicted.reshape(watch.uavs, -1)
    cross = watch.flight[flock].reshape(count, -1) @ whole.T
    within = np.einsum("crz,jra->cjza", watch.past[flock], predicted, optimize=True)
    power = (whole * whole).sum(axis=1)
    flights = (watch.flight**2).sum(axis=(1, 2))
    flocks = flights[flock, None] - 2.0 * cross + power[None] - (within**2).sum(axis=(2, 3))
    own = np.einsum("jrz,jra->jza", watch.past[count:], predicted, optimize=True)
    cross_own = (watch.flight[count:] * predicted).sum(axis=(1, 2))
    members = flights[count:] - 2.0 * cross_own + power - (own**2).sum(axis=(1, 2))
    return watch.by_flock(flocks, members)


def locate(watch: Watch, gain: Floats, price: float, most: int | None) -> Indices:
    """The head ``(C,)`` of each flock, -1 for none; a UAV that flies alone and leads follows nobody."""
    sizes = np.bincount(watch.label, minlength=watch.flocks)
    alone = sizes[watch.label] == 1
    gain = np.where(sizes[:, None] == 1, gain - LONELY, gain)
    # Every candidate needs a row that falls silent when it leads: its own where it is alone, else an empty one.
    place = np.where(alone, watch.label, watch.flocks + np.arange(watch.uavs))
    rows = np.concatenate([gain, np.zeros((watch.uavs, watch.uavs))])
    votes = np.concatenate([sizes, np.zeros(watch.uavs, np.int64)])
    found = locate_heads(rows, place, price, most, votes=votes)
    candidate = np.full(len(rows), -1)
    candidate[place] = np.arange(watch.uavs)
    leader = found.leader[: watch.flocks]
    return np.where(leader >= 0, candidate[np.maximum(leader, 0)], -1)
