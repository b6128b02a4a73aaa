"""Heads of flocks: the UAVs whose past improves the prediction of a flock from the flock's own past.

The mean velocity of a flock contains little of its members' jitter and of the observation noise, so that a few flocks
are more informative than many noisy followers. It also gives the direction: the past of a fellow member is the flock's
own past, which the null model contains, and adds nothing; the past of a head does. When a member is tested as head of
its own flock, it is left out of the mean.
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
_ROWS_A_LAG = 12  # rows per lag of the own past in the null model (three parameters each)
_RIDGE = 1e-6
_STARTS = 3
LONELY = 12.0  # nats that a UAV in no flock must gain to be assigned to a head
_FAIR = 0.25  # least gain of a UAV in no flock, as a share of the median gain of the flocks
_SOBERED = 8  # candidates of a flock that are ranked again by the robust gain
_MOMENT = 6.0  # largest contribution of one sample, in nats
_MEDIAN = 2.366  # median of a chi-square variable with three degrees of freedom
_LEAST_SPREAD = 0.005  # least standard deviation of a velocity, in mean speeds
_NOTHING = 1e-9
_EXACT = 6  # candidates of a flock with exactly computed evidence
_LEAST_LEFT = 1e-4  # least residual share of a flock's variance


@dataclass(frozen=True, eq=False)
class Watch:
    """Innovations of the mean velocities of C flocks, and of each UAV's flock without this UAV.

    Args:
        label: ``(n,)`` the flock of each UAV.
        flight: ``(C + n, R, 3)``: residuals of each flock's mean velocity after regression on its own past; then those
            of the flocks without one member each, 0 for a flock of one.
        past: ``(C + n, R, z)``: orthonormal columns that span the own past and the mean.
    """

    label: Indices
    flight: Floats
    past: Floats

    @property
    def uavs(self) -> int:
        """Number of UAVs."""
        return len(self.label)

    @property
    def flocks(self) -> int:
        """C."""
        return len(self.flight) - self.uavs

    @property
    def freedom(self) -> int:
        """Number of rows less the number of columns of the own past."""
        return self.flight.shape[1] - self.past.shape[2]

    def watcher(self, flock: int, head: int) -> int:
        """The row of ``flight`` that tests UAV ``head`` as the head of ``flock``."""
        return self.flocks + head if self.label[head] == flock else flock

    def by_flock(self, all_of_flocks: Floats, own_of_members: Floats) -> Floats:
        """``(C, n)`` from values ``(C, n)`` of whole flocks and values ``(n,)`` of each UAV for its own flock."""
        result = all_of_flocks.copy()
        result[self.label, np.arange(self.uavs)] = own_of_members
        return result


def watch_flocks(samples: Samples, flocks: Flocks) -> Watch:
    """Compute the innovations of the flocks.

    Args:
        samples: samples of n UAVs without missing values.
        flocks: the flocks of these UAVs.
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
    """The features of all UAVs in a class of strategies.

    Args:
        library: the class.
        values: ``(n, R, p)``; ``(n, R, p, 3)`` for an isotropic class, with the same weights on all axes.
    """

    library: Library
    values: Floats

    @property
    def numbers(self) -> int:
        """Number of weights of a strategy."""
        return self.values.shape[2] * (1 if self.library.isotropic else 3)

    def predicted(self, weights: Floats) -> Floats:
        """Predictions ``(n, R, 3)`` with weights ``(p, 3)``, or ``(p,)`` for an isotropic class."""
        return np.asarray(
            np.moveaxis(self.values, 2, -1) @ weights if self.library.isotropic else self.values @ weights
        )

    def one(self, uav: int, past: Floats) -> Floats:
        """Features of one UAV after projecting out a past ``(R, z)``: ``(R, p)``, or ``(3 R, p)`` if isotropic."""
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
        shown: the class of the strategy, with its features.
        weights: weights of the shared strategy, ``(p, 3)`` or ``(p,)``; ``None``: each pair has its own regression.
        chance: the gain of a separate regression by chance, already subtracted from ``gain``; 0 for a shared strategy.
        value: the penalised gain of all flocks.
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
    """Compute the features of all UAVs, centred and without the intercept, which the null model contains."""
    values = head_features(samples, library)[0][..., :-1]
    values = values - values.mean(axis=1, keepdims=True)
    if library.isotropic:
        values = values.reshape(*values.shape[:2], -1, 3)
        if library.squares:  # at equal speeds their sum is constant; with noise it holds only noise
            squares = values[:, :, library.lags if library.linear else 0 :]
            squares -= squares.mean(axis=3, keepdims=True)
    return Shown(library, values)


def flock_libraries(lags: int) -> list[Library]:
    """The classes of strategies: functions of a head's past."""
    linear = [Library(lag, isotropic=same) for same in (False, True) for lag in {lags, 1}]
    squares = [replace(library, linear=False, squares=True) for library in linear]
    mixed = [Library(lags, squares=True), Library(1, squares=True, products=True)]
    if lags > 1:
        mixed.append(Library(2, squares=True, products=True, across=True))
        mixed.append(Library(2, linear=False, turns=True, isotropic=True))
    return linear + squares + mixed


def heads_of_flocks(samples: Samples, watch: Watch, most: int | None = None) -> FlockHeads | None:
    """Find the heads that explain the flocks best.

    In each class, one regression per pair of a flock and a UAV gives a start. From the best starts, and from the best
    state after these, one shared strategy is fitted in every class.

    Args:
        samples: samples of n UAVs, whose pasts may be smoothed.
        watch: their flocks.
        most: the largest number of heads.

    Returns:
        ``None`` if no flock seems to follow a UAV.
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
    """Whether the window is long enough for one regression per pair."""
    return some.numbers <= 2.0 * watch.freedom


def each_by_itself(watch: Watch, some: Shown, most: int | None) -> FlockHeads:
    """Find heads with one regression per pair of a flock and a UAV (no pooling).

    All pairs are screened by matrix products. These ignore what a UAV's past shares with the flock's own past, which
    can only lower the evidence; the best pairs are computed exactly. The largest gain in time-shifted data is
    subtracted as the penalty of the many parameters.
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
    # An exact regression has fewer degrees of freedom than the screening, and explains more by chance.
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
    """Find heads from unpooled gains after reducing those of UAVs in no flock, see :func:`lone_votes`."""
    gain = lone_votes(watch, found.gain)
    head = locate(watch, gain, head_price(watch.uavs), most)
    return replace(found, head=head, gain=gain, value=worth(watch, gain, head))


def lone_votes(watch: Watch, gain: Floats) -> Floats:
    """Reduce the unpooled gains ``(C, n)`` of UAVs in no flock.

    Such a UAV only keeps a gain that is a fair share of what flocks gain by their heads; without such flocks it keeps
    none.
    """
    alone = np.bincount(watch.label, minlength=watch.flocks) == 1
    best = gain[~alone].max(axis=1, initial=0.0)
    led = best[best > LONELY]
    least = max(LONELY, _FAIR * float(np.median(led))) if len(led) else np.inf
    return np.where(alone[:, None] & (gain < least), np.minimum(gain, 0.0), gain)


def exact_gain(watch: Watch, some: Shown, flock: int, uav: int) -> float:
    """Log-likelihood that a UAV's features add to a flock's own past, by the exact regression."""
    flight, error = by_regression(watch, some, flock, uav)
    power = float((flight**2).sum())
    if power <= _NOTHING:
        return 0.0
    return -1.5 * watch.freedom * float(np.log(max(float((error**2).sum()) / power, _LEAST_LEFT)))


def by_regression(watch: Watch, some: Shown, flock: int, uav: int) -> tuple[Floats, Floats]:
    """Innovations ``(R, 3)`` of a flock, and their residuals after the regression on a UAV's features."""
    row = watch.watcher(flock, uav)
    seen = some.one(uav, watch.past[row])
    flight = watch.flight[row]
    target = flight.reshape(len(seen), -1)
    gram = seen.T @ seen
    gram[np.diag_indices(len(gram))] += _RIDGE * np.trace(gram) / len(gram) + 1e-12
    return flight, (target - seen @ np.linalg.solve(gram, seen.T @ target)).reshape(flight.shape)


def sober_gain(flight: Floats, error: Floats, freedom: int) -> float:
    """Log-likelihood gain under a Student-t error model, in which no single sample has much weight.

    Rows ``(R, 3)`` have a t distribution with four degrees of freedom and a robust scale. With a few sharp turns
    between straight lines, a normal distribution would give a thousand nats for two turns shortly after each other.
    """

    def rows(values: Floats) -> Floats:
        square = (values**2).sum(axis=1)
        spread = max(float(np.sqrt(np.median(square) / _MEDIAN)), _LEAST_SPREAD)
        return np.asarray(-3.0 * np.log(spread) - 3.5 * np.log1p(square / (4.0 * spread**2)))

    return freedom / len(flight) * float(np.minimum(rows(error) - rows(flight), _MOMENT).sum())


def sobered(watch: Watch, found: FlockHeads, most: int | None) -> FlockHeads:
    """Rank each flock's best candidates again by the robust gain; no candidates are added."""
    predicted = None if found.weights is None else found.shown.predicted(found.weights)
    gain = np.minimum(found.gain, 0.0)
    for flock in range(watch.flocks):
        for uav in np.union1d(np.argsort(-found.gain[flock], kind="stable")[:_SOBERED], found.heads):
            if found.gain[flock, uav] > 0:
                gain[flock, uav] = min(pair_gain(watch, found, predicted, flock, int(uav)), found.gain[flock, uav])
        best = int(gain[flock].argmax())  # the cap on samples must not move distant candidates close to the best
        behind = found.gain[flock] - found.gain[flock, best]
        gain[flock] = np.minimum(gain[flock], gain[flock, best] + np.minimum(behind, 0.0))
    if found.weights is None:
        gain = lone_votes(watch, gain)
    head = locate(watch, gain, head_price(watch.uavs), most)
    return replace(found, head=head, gain=gain, value=worth(watch, gain, head))


def pair_gain(watch: Watch, found: FlockHeads, predicted: Floats | None, flock: int, uav: int, shift: int = 0) -> float:
    """Robust gain of a flock by one UAV, whose past may be shifted; less ``chance`` if the pair has a regression."""
    if predicted is None:
        moved = found.shown if shift == 0 else Shown(found.shown.library, np.roll(found.shown.values, shift, axis=1))
        flight, error = by_regression(watch, moved, flock, uav)
        return sober_gain(flight, error, watch.freedom) - found.chance
    row = watch.watcher(flock, uav)
    past, flight = watch.past[row], watch.flight[row]
    shown_now = np.roll(predicted[uav], shift, axis=0)
    return sober_gain(flight, flight - shown_now + past @ (past.T @ shown_now), watch.freedom)


def worth(watch: Watch, gain: Floats, head: Indices) -> float:
    """The gain of the flocks by their heads, less the penalty of the heads."""
    followed = np.flatnonzero(head >= 0)
    single = np.bincount(watch.label, minlength=watch.flocks)[followed] == 1
    named = LONELY * single.sum() + head_price(watch.uavs) * len(np.unique(head[followed]))
    return float(gain[followed, head[followed]].sum()) - named


def fit_flocks(watch: Watch, some: Shown, head: Indices, most: int | None = None) -> FlockHeads | None:
    """Fit one shared strategy and the heads ``(C,)`` of the flocks alternately, within one class."""
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
        if turn > 0 and np.array_equal(head, before):  # the first iteration has no estimated spreads
            break
    return best


def shared_gain(watch: Watch, predicted: Floats) -> tuple[Floats, Floats]:
    """``(C, n)``: squared error of the predictions ``(n, R, 3)``, and the log-likelihood that they gain.

    Each flock has its own spread, which depends on its size and its members' jitter.
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
    """``(C, n)``: squared error of each UAV's prediction ``(n, R, 3)`` of each flock, after projecting out own pasts.

    With the projection P onto the own past and P y = 0, |(1 - P)(y - f)|² = |y|² - 2 y·f + |f|² - |Q' f|².
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
    """The head ``(C,)`` of each flock, -1 for none; a head that is in no flock follows no UAV."""
    sizes = np.bincount(watch.label, minlength=watch.flocks)
    alone = sizes[watch.label] == 1
    gain = np.where(sizes[:, None] == 1, gain - LONELY, gain)
    # Each candidate needs a row that is ignored if it is a head: its own if it is in no flock, else an empty one.
    place = np.where(alone, watch.label, watch.flocks + np.arange(watch.uavs))
    rows = np.concatenate([gain, np.zeros((watch.uavs, watch.uavs))])
    votes = np.concatenate([sizes, np.zeros(watch.uavs, np.int64)])
    found = locate_heads(rows, place, price, most, votes=votes)
    candidate = np.full(len(rows), -1)
    candidate[place] = np.arange(watch.uavs)
    leader = found.leader[: watch.flocks]
    return np.where(leader >= 0, candidate[np.maximum(leader, 0)], -1)
