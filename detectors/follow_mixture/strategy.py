"""The shared follow strategy: one linear map of a head's past and position, fitted to all followers together.

Followers of one head share its past; so the regression only has as many rows as the heads have samples. norm(·) is
inverted by the fixed point D = argmin sum |D - |D| y|², whose residual is the noise before normalisation, across y.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from detectors.follow_mixture.history import OwnHistory
from detectors.follow_mixture.likelihood import Noise, fit_directions, flight_likelihood, natural_parameters
from detectors.follow_mixture.samples import Samples, stride

__all__ = [
    "PAIRED_ROWS",
    "Library",
    "Strategy",
    "directions",
    "fit_strategy",
    "gain_matrix",
    "head_features",
    "pair_features",
    "pairs_seen",
    "rows_seen",
]

Floats = NDArray[np.float64]
Indices = NDArray[np.int64]
Mask = NDArray[np.bool_]
Pairs = tuple[Floats, Mask]

_CHUNK_ENTRIES = 2_000_000
_ODD_STEP = float(np.log(0.01))  # log-likelihood of an outlier of any direction: a slightly wrong range threshold
#                                  causes a few of them
PAIRED_ROWS = 1500  # about ten times the number of parameters
_FAR = 300.0  # metres; keeps offsets near 1


@dataclass(frozen=True)
class Library:
    """A class of strategies, defined by the features that they may use.

    Args:
        lags: the number of past velocities of the head.
        linear: use the velocities.
        squares: use their axis-wise squares.
        products: use products of two axes of one velocity.
        towards: use the direction to the head and the offset to it.
        own: use the follower's own past velocities.
        isotropic: use the same coefficients on every axis.
        reach: range threshold in metres; the direction to the head has other coefficients beyond it. 0: no threshold.
        across: use axis-wise products of the last velocity and the one before.
        turns: use the last velocity, the one before and their cross product, times powers of their cosine up to the
            second. With ``isotropic``: all rotation-equivariant functions of two velocities, to second order.
    """

    lags: int
    linear: bool = True
    squares: bool = False
    products: bool = False
    towards: bool = False
    own: bool = False
    isotropic: bool = False
    reach: float = 0.0
    across: bool = False
    turns: bool = False

    @property
    def name(self) -> str:
        """Name of the class in reports."""
        names = ("linear", "squares", "products", "across", "turns", "towards", "own", "isotropic")
        parts = [name for name in names if getattr(self, name)]
        if self.reach:
            parts.append(f"reach[{self.reach:.0f} m]")
        return f"{'+'.join(parts)}({self.lags})"

    @property
    def paired(self) -> bool:
        """Whether predictions also depend on the follower."""
        return self.towards or self.own

    @property
    def extra(self) -> int:
        """Number of features that also depend on the follower."""
        return 6 * self.towards + 3 * (self.towards and self.reach > 0) + 3 * self.lags * self.own


@dataclass(frozen=True, eq=False)
class Strategy:
    """A fitted shared strategy.

    Args:
        library: the class of the strategy.
        coefficients: ``(p, 3)``; the last row is the intercept.
        noise: the error distribution.
        parameters: the number of parameters.
        observations: the number of scalar observations.
    """

    library: Library
    coefficients: Floats
    noise: Noise
    parameters: int
    observations: int

    @property
    def price(self) -> float:
        """Penalty: half the logarithm of the number of observations, per parameter (as in the BIC)."""
        return 0.5 * self.parameters * float(np.log(max(self.observations, 2)))


def head_features(samples: Samples, library: Library, heads: Indices | slice = slice(None)) -> tuple[Floats, Mask]:
    """Features of the pasts of some UAVs ``(h, R, p)``, the intercept last, and the rows without missing values."""
    past = samples.lagged[heads, :, : library.lags]
    valid = np.asarray(samples.lag_seen[heads, :, : library.lags].all(axis=2), bool)
    shape = past.shape[:2]
    parts = []
    if library.linear:
        parts.append(past.reshape(*shape, 3 * library.lags))
    if library.squares:
        parts.append((past * past).reshape(*shape, 3 * library.lags))
    if library.products:
        parts.append((past[..., [1, 2, 0]] * past[..., [2, 0, 1]]).reshape(*shape, -1))
    newest, before = past[:, :, 0], past[:, :, min(1, library.lags - 1)]
    if library.turns:
        vectors = np.stack([newest, before, np.cross(newest, before)], axis=2)
        cosine = np.vecdot(newest, before)[..., None, None]
        parts.append(np.concatenate([vectors, cosine * vectors, cosine**2 * vectors], axis=2).reshape(*shape, 27))
    if library.across:
        parts.append((newest[..., :, None] * before[..., None, :]).reshape(*shape, -1))
    parts.append(np.ones((*shape, 1)))
    return np.concatenate(parts, axis=2), valid


def pair_features(
    samples: Samples, library: Library, followers: Indices, heads: Indices, rows: Indices | None = None
) -> Pairs:
    """Features that also depend on the follower, in single precision.

    Args:
        samples: samples of n UAVs.
        library: the class.
        followers: ``(...)`` indices.
        heads: ``(...)`` indices.
        rows: ``(...)`` the row of each; all R rows by default, as a further axis.

    Returns:
        ``(..., p)`` or ``(..., R, p)``, and a mask of the entries without missing values.
    """
    behind, ahead = ((followers,), (heads,)) if rows is None else ((followers, rows), (heads, rows))
    seen = pairs_seen(samples, library, behind, ahead)
    features = np.empty((*seen.shape, library.extra), np.float32)
    if library.towards:
        position = samples.position.astype(np.float32)
        gap = position[ahead] - position[behind]
        distance = np.sqrt(np.vecdot(gap, gap))[..., None]
        towards = np.multiply(gap, 1.0 / np.maximum(distance, 1e-6), out=features[..., :3])
        np.multiply(gap, 1.0 / _FAR, out=features[..., 3:6])
        if library.reach:
            np.multiply(towards, distance > library.reach, out=features[..., 6:9])
    if library.own:
        past = samples.lagged[behind][..., : library.lags, :]
        features[..., library.extra - 3 * library.lags :] = past.reshape(*past.shape[:-2], 3 * library.lags)
    return features, seen


def pairs_seen(samples: Samples, library: Library, behind: tuple[Indices, ...], ahead: tuple[Indices, ...]) -> Mask:
    """Mask of the entries of :func:`pair_features` without missing values, by indices of followers and heads."""
    valid = np.ones(samples.position_seen[behind].shape, bool)
    if library.towards:
        valid &= samples.position_seen[ahead] & samples.position_seen[behind]
    if library.own:
        valid &= samples.lag_seen[behind][..., : library.lags].all(axis=-1)
    return valid


def rows_seen(samples: Samples, library: Library, followers: Indices, heads: Indices) -> Mask:
    """``(f, R)``: the rows in which a follower and all features that a class uses of it and of its head were seen.

    Args:
        samples: samples of n UAVs.
        library: the class.
        followers: ``(f,)`` indices.
        heads: ``(f,)`` the head of each.
    """
    past = samples.lag_seen[heads, :, : library.lags].all(axis=2)
    return np.asarray(past & samples.seen[followers] & pairs_seen(samples, library, (followers,), (heads,)), bool)


def fit_strategy(
    samples: Samples, leader: Indices, library: Library, start: Strategy | None = None, by_head: bool = False
) -> Strategy | None:
    """Fit the strategy of a class to the followers.

    Args:
        samples: samples of n UAVs.
        leader: ``(n,)``, the head of each UAV, -1 for none.
        library: the class.
        start: initial strategy from a subclass without ``own``; it saves time.
        by_head: whether all heads have equal weight, whatever their number of followers. Followers of one head share
            the lack of fit; without equal weights the fit adapts to the heads with many followers.

    Returns:
        ``None`` if there are fewer rows than parameters.
    """
    followers = np.flatnonzero(leader >= 0)
    if not len(followers):
        return None
    if library.paired:
        features, total, weight, energy = _paired_rows(samples, leader, followers, library, by_head)
    else:
        features, total, weight, energy = _shared_rows(samples, leader, followers, library, by_head)
    width = features.shape[1]
    observations = int(weight.sum()) * (2 if samples.unit else 3)
    numbers = (width - 1) // 3 + 1 if library.isotropic else 3 * width
    if len(features) <= numbers // 3 or observations <= numbers:
        return None
    begun = None if start is None else _extended(start, width)
    coefficients, noise = fit_directions(features, total, weight, samples.unit, energy, library.isotropic, begun)
    return Strategy(library, coefficients, noise, numbers + 2, observations)


def _extended(strategy: Strategy, width: int) -> Floats:
    """``(width, 3)``: coefficients in a larger class; features that depend on the follower come first."""
    extra = strategy.library.extra
    coefficients = np.zeros((width, 3))
    coefficients[:extra] = strategy.coefficients[:extra]
    coefficients[width - len(strategy.coefficients) + extra :] = strategy.coefficients[extra:]
    return coefficients


def _shared_rows(
    samples: Samples, leader: Indices, followers: Indices, library: Library, by_head: bool
) -> tuple[Floats, Floats, Floats, float]:
    """One row per head and time: features, sum of the followers' velocities, their number, and their summed squares."""
    heads, group = np.unique(leader[followers], return_inverse=True)
    features, valid = head_features(samples, library, heads)
    member = np.zeros((len(heads), len(followers)))
    member[group, np.arange(len(followers))] = say = _say(group) if by_head else np.ones(len(followers))
    seen = samples.seen[followers].astype(np.float64)
    target = samples.target[followers]
    total = (member @ target.reshape(len(followers), -1)).reshape(len(heads), samples.rows, 3)
    weight = member @ seen
    keep = valid & (weight > 0)
    energy = float((np.vecdot(target, target) * keep[group] * say[:, None]).sum())
    return features[keep], total[keep], weight[keep], energy


def _paired_rows(
    samples: Samples, leader: Indices, followers: Indices, library: Library, by_head: bool
) -> tuple[Floats, Floats, Floats, float]:
    """One row per follower and time; a subsample if there are many."""
    heads = leader[followers]
    unique, group = np.unique(heads, return_inverse=True)
    shared, _ = head_features(samples, library, unique)
    who, when = np.nonzero(rows_seen(samples, library, followers, heads))
    every = stride(len(who), PAIRED_ROWS, samples.rows)
    who, when = who[::every], when[::every]
    extra, _ = pair_features(samples, library, followers[who], heads[who], when)
    target = samples.target[followers[who], when]
    features = np.concatenate([extra, shared[group[who], when]], axis=1)
    say = _say(group[who]) if by_head else np.ones(len(target))
    return features, target * say[:, None], say, float((target**2).sum(axis=1) @ say)


def _say(group: Indices) -> Floats:
    """``(f,)``: weights that give all groups equal weight, with mean 1."""
    say = 1.0 / np.bincount(group)[group]
    return np.asarray(say / say.mean(), np.float64)


def directions(samples: Samples, strategy: Strategy, followers: Indices, heads: Indices) -> tuple[Floats, Mask]:
    """Predicted directions ``(f, R, 3)`` of followers with one head each, and the rows without missing values."""
    unique, group = np.unique(heads, return_inverse=True)
    features, valid = head_features(samples, strategy.library, unique)
    extra = strategy.library.extra
    shared = (features @ strategy.coefficients[extra:])[group]
    if not strategy.library.paired:
        return shared, valid[group]
    own, also = pair_features(samples, strategy.library, followers, heads)
    return shared + own @ strategy.coefficients[:extra], valid[group] & also


def gain_matrix(
    samples: Samples,
    history: OwnHistory,
    strategy: Strategy,
    columns: Indices,
    voters: Indices | None = None,
) -> Floats:
    """Log-likelihood that each UAV gains over its null model by following each of ``columns``.

    Rows with a missing past of the candidate are left out of both likelihoods.

    Args:
        samples: samples of n UAVs.
        history: the null model.
        strategy: the fitted strategy.
        columns: ``(c,)`` indices of the candidates.
        voters: ``(v,)`` indices of the voters; all UAVs by default.

    Returns:
        ``(v, c)``; 0 for a UAV with itself.
    """
    voters = np.arange(samples.uavs) if voters is None else voters
    if strategy.library.paired:
        matrix = _paired_gain(samples, history, strategy, columns, voters)
    else:
        matrix = _shared_gain(samples, history, strategy, columns, voters)
    matrix[voters[:, None] == columns[None, :]] = 0.0
    return matrix


def _null(samples: Samples, history: OwnHistory, strategy: Strategy, voters: Indices) -> Floats:
    """``(v, R)``: log-likelihood of the null model, plus the term of y that the natural parameters omit in space."""
    null = history.log_likelihood[voters]
    if not samples.unit:
        null = null + 0.5 * np.vecdot(samples.target[voters], samples.target[voters]) / strategy.noise.spread**2
    return null


def _shared_gain(
    samples: Samples, history: OwnHistory, strategy: Strategy, columns: Indices, voters: Indices
) -> Floats:
    features, valid = head_features(samples, strategy.library, columns)
    theta, constant = natural_parameters(features @ strategy.coefficients, strategy.noise)
    complete = samples.complete
    if not complete:
        theta = theta * valid[..., None]
        constant = constant * valid
    target = samples.target[voters].reshape(len(voters), -1)
    null = _null(samples, history, strategy, voters)
    value = target @ theta.reshape(len(columns), -1).T
    if complete:
        return value + constant.sum(axis=1)[None] - null.sum(axis=1)[:, None]
    seen = samples.seen[voters].astype(np.float64)
    return value + seen @ constant.T - (null * seen) @ valid.T.astype(np.float64)


def _paired_gain(
    samples: Samples, history: OwnHistory, strategy: Strategy, columns: Indices, voters: Indices
) -> Floats:
    """Single precision, with the axes of space first: most of the computing time is spent here."""
    library, extra = strategy.library, strategy.library.extra
    features, valid = head_features(samples, library, columns)
    shared = _axes_first(features @ strategy.coefficients[extra:])
    alone = np.zeros((3, len(voters), 1, 1), np.float32)
    if library.own:
        past = samples.lagged[voters][:, :, : library.lags].reshape(len(voters), samples.rows, 3 * library.lags)
        alone = _axes_first(past @ strategy.coefficients[extra - 3 * library.lags : extra])[:, :, None]
    toward = strategy.coefficients[:extra].astype(np.float32)
    position = _axes_first(samples.position)
    target = _axes_first(samples.target[voters])
    null = _null(samples, history, strategy, voters)
    seen = samples.seen[voters] & pairs_seen(samples, library, (voters,), (voters,))
    ahead = valid & samples.position_seen[columns] if library.towards else valid
    everything = bool(seen.all() and ahead.all())
    result = np.empty((len(voters), len(columns)))
    step = max(1, _CHUNK_ENTRIES // (len(columns) * samples.rows * 8))
    for first in range(0, len(voters), step):
        some = slice(first, first + step)
        direction = shared[:, None] + alone[:, some]
        if library.towards:
            gap = position[:, columns][:, None] - position[:, voters[some]][:, :, None]
            direction = direction + _pull(library, toward, gap)
        value = flight_likelihood(direction, target[:, some, None], strategy.noise)
        if samples.unit:
            np.maximum(value, _ODD_STEP, out=value)
        value -= null[some, None]
        if not everything:
            value[~(seen[some, None] & ahead[None])] = 0.0
        result[some] = value.sum(axis=2, dtype=np.float64)
    return result


def _axes_first(flights: Floats) -> NDArray[np.float32]:
    """``(n, R, 3)`` as ``(3, n, R)``, in single precision."""
    return np.ascontiguousarray(flights.transpose(2, 0, 1), np.float32)


def _pull(library: Library, toward: NDArray[np.float32], gap: NDArray[np.float32]) -> NDArray[np.float32]:
    """Contribution of the head's position to a direction ``(3, v, c, R)``, for offsets of the same shape."""
    shape = gap.shape
    distance = np.sqrt(gap[0] * gap[0] + gap[1] * gap[1] + gap[2] * gap[2])
    unit = gap / np.maximum(distance, 1e-6)
    pull = toward[:3].T @ unit.reshape(3, -1) + (toward[3:6].T / np.float32(_FAR)) @ gap.reshape(3, -1)
    if library.reach:
        pull += toward[6:9].T @ (unit * (distance > library.reach)).reshape(3, -1)
    return pull.reshape(shape)
