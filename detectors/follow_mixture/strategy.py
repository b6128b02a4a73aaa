"""The shared follow strategy: one linear map of a head's past and place, fitted to all followers at once.

Followers of one head share its past, so a fit to thousands of flights is a regression on as many rows as the heads
have. norm(·) is undone by the fixed point D = argmin sum |D - |D| y|², whose residual is the raw noise across y.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from detectors.follow_mixture.history import OwnHistory
from detectors.follow_mixture.likelihood import Noise, fit_directions, natural_parameters
from detectors.follow_mixture.samples import Samples

__all__ = ["Library", "Strategy", "directions", "fit_strategy", "gain_matrix", "head_features", "pair_features"]

Floats = NDArray[np.float64]
Indices = NDArray[np.int64]
Mask = NDArray[np.bool_]
Pairs = tuple[Floats, Mask]

_CHUNK_ENTRIES = 2_000_000
_ODD_STEP = float(np.log(0.01))  # log-likelihood of a step that has any direction: a reach that is a little off turns
#                                  a few by a lot
_PAIRED_ROWS = 3000  # some hundred times the numbers that are fitted
_FAR = 300.0  # metres; keeps offsets near 1


@dataclass(frozen=True)
class Library:
    """Which features a shared strategy may use: a class of strategies.

    Args:
        lags: how many past velocities of the head.
        linear: the velocities.
        squares: their axis-wise squares.
        products: products of two axes of one velocity.
        towards: the direction to the head, and the offset to it.
        own: the follower's own past velocities.
        isotropic: the same law on every axis.
        reach: metres; the direction to the head counts apart within and beyond it. 0: the same everywhere.
        across: products of the last velocity and the one before, axis by axis.
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

    @property
    def name(self) -> str:
        """How the class is called in reports."""
        names = ("linear", "squares", "products", "across", "towards", "own", "isotropic")
        parts = [name for name in names if getattr(self, name)]
        if self.reach:
            parts.append(f"reach[{self.reach:.0f} m]")
        return f"{'+'.join(parts)}({self.lags})"

    @property
    def paired(self) -> bool:
        """Whether predictions depend on the follower too."""
        return self.towards or self.own


@dataclass(frozen=True, eq=False)
class Strategy:
    """A fitted shared strategy.

    Args:
        library: its class.
        coefficients: ``(p, 3)``, the last row the intercept.
        noise: what it leaves open.
        parameters: how many numbers were fitted.
        observations: how many numbers they were fitted to.
    """

    library: Library
    coefficients: Floats
    noise: Noise
    parameters: int
    observations: int

    @property
    def price(self) -> float:
        """Half the logarithm of the observations for every number fitted."""
        return 0.5 * self.parameters * float(np.log(max(self.observations, 2)))


def head_features(samples: Samples, library: Library, heads: Indices | slice = slice(None)) -> tuple[Floats, Mask]:
    """Features of the pasts of some UAVs ``(h, R, p)``, an intercept last, and the rows where all are seen."""
    past = samples.lagged[heads, :, : library.lags]
    valid = np.asarray(samples.lag_seen[heads, :, : library.lags].all(axis=2), bool)
    shape = past.shape[:2]
    parts = []
    if library.linear:
        parts.append(past.reshape(*shape, -1))
    if library.squares:
        parts.append((past * past).reshape(*shape, -1))
    if library.products:
        parts.append((past[..., [1, 2, 0]] * past[..., [2, 0, 1]]).reshape(*shape, -1))
    if library.across:
        newest, before = past[:, :, 0], past[:, :, min(1, library.lags - 1)]
        parts.append((newest[..., :, None] * before[..., None, :]).reshape(*shape, -1))
    parts.append(np.ones((*shape, 1)))
    return np.concatenate(parts, axis=2), valid


def pair_features(samples: Samples, library: Library, followers: Indices, heads: Indices) -> Pairs:
    """What depends on the follower as well: ``(..., R, p)`` for ``followers`` and ``heads`` of one shape ``(...)``."""
    parts = []
    valid = np.ones((*followers.shape, samples.rows), bool)
    if library.towards:
        gap = samples.position[heads] - samples.position[followers]
        distance = np.sqrt(np.vecdot(gap, gap))[..., None]
        towards = gap / np.maximum(distance, 1e-6)
        parts += [towards, gap / _FAR] + ([towards * (distance > library.reach)] if library.reach else [])
        valid &= samples.position_seen[heads] & samples.position_seen[followers]
    if library.own:
        parts.append(samples.lagged[followers][..., : library.lags, :].reshape(*valid.shape, -1))
        valid &= samples.lag_seen[followers][..., : library.lags].all(axis=-1)
    return np.concatenate(parts, axis=-1), valid


def fit_strategy(samples: Samples, leader: Indices, library: Library) -> Strategy | None:
    """The strategy of a class that fits the followers best.

    Args:
        samples: n UAVs.
        leader: ``(n,)`` the head that each follows, -1 for none.
        library: the class.

    Returns:
        ``None`` where there are fewer rows than numbers to fit.
    """
    followers = np.flatnonzero(leader >= 0)
    if not len(followers):
        return None
    features, total, weight, energy = (_paired_rows if library.paired else _shared_rows)(
        samples, leader, followers, library
    )
    width = features.shape[1]
    observations = int(weight.sum()) * (2 if samples.unit else 3)
    numbers = (width - 1) // 3 + 1 if library.isotropic else 3 * width
    if len(features) <= numbers // 3 or observations <= numbers:
        return None
    coefficients, noise = fit_directions(features, total, weight, samples.unit, energy, library.isotropic)
    return Strategy(library, coefficients, noise, numbers + 2, observations)


def _shared_rows(
    samples: Samples, leader: Indices, followers: Indices, library: Library
) -> tuple[Floats, Floats, Floats, float]:
    """One row a head and time: features, sum of the followers' flights, how many, and their summed squares."""
    heads, group = np.unique(leader[followers], return_inverse=True)
    features, valid = head_features(samples, library, heads)
    member = np.zeros((len(heads), len(followers)))
    member[group, np.arange(len(followers))] = 1.0
    seen = samples.seen[followers].astype(np.float64)
    target = samples.target[followers]
    total = (member @ target.reshape(len(followers), -1)).reshape(len(heads), samples.rows, 3)
    weight = member @ seen
    keep = valid & (weight > 0)
    energy = float((np.vecdot(target, target) * keep[group]).sum())
    return features[keep], total[keep], weight[keep], energy


def _paired_rows(
    samples: Samples, leader: Indices, followers: Indices, library: Library
) -> tuple[Floats, Floats, Floats, float]:
    """One row a follower and time, of many a part: ``_PAIRED_ROWS`` at most."""
    heads = leader[followers]
    unique, group = np.unique(heads, return_inverse=True)
    shared, valid = head_features(samples, library, unique)
    extra, also = pair_features(samples, library, followers, heads)
    who, when = np.nonzero(valid[group] & also & samples.seen[followers])
    every = -(-len(who) // _PAIRED_ROWS) or 1
    who, when = who[::every], when[::every]
    target = samples.target[followers[who], when]
    features = np.concatenate([extra[who, when], shared[group[who], when]], axis=1)
    return features, target, np.ones(len(target)), float((target**2).sum())


def directions(samples: Samples, strategy: Strategy, followers: Indices, heads: Indices) -> tuple[Floats, Mask]:
    """Predicted directions ``(f, R, 3)`` of followers behind one head each, and the rows where they can be known."""
    unique, group = np.unique(heads, return_inverse=True)
    features, valid = head_features(samples, strategy.library, unique)
    extra = len(strategy.coefficients) - features.shape[2]
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
    pairs: Pairs | None = None,
) -> Floats:
    """Log-likelihood that each UAV gains over its own history by following each of ``columns``.

    A time at which the candidate's past was not seen counts for neither.

    Args:
        samples: n UAVs.
        history: the null.
        strategy: fitted.
        columns: ``(c,)`` indices of candidates.
        voters: ``(v,)`` indices of the UAVs that are asked; all by default.
        pairs: :func:`pair_features` of voters and columns, where they are known already.

    Returns:
        ``(v, c)``; 0 where a UAV meets itself.
    """
    voters = np.arange(samples.uavs) if voters is None else voters
    if strategy.library.paired:
        matrix = _paired_gain(samples, history, strategy, columns, voters, pairs)
    else:
        matrix = _shared_gain(samples, history, strategy, columns, voters)
    matrix[voters[:, None] == columns[None, :]] = 0.0
    return matrix


def _null(samples: Samples, history: OwnHistory, strategy: Strategy, voters: Indices) -> Floats:
    """``(v, R)`` log-likelihood of the null, plus what the natural parameters leave out of y in space."""
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
    samples: Samples,
    history: OwnHistory,
    strategy: Strategy,
    columns: Indices,
    voters: Indices,
    pairs: Pairs | None,
) -> Floats:
    features, valid = head_features(samples, strategy.library, columns)
    extra = len(strategy.coefficients) - features.shape[2]
    shared = features @ strategy.coefficients[extra:]
    result = np.empty((len(voters), len(columns)))
    step = max(1, _CHUNK_ENTRIES // (len(columns) * samples.rows * (extra + 6)))
    for first in range(0, len(voters), step):
        some = voters[first : first + step]
        grid = np.broadcast_arrays(some[:, None], columns[None, :])
        own, also = pair_features(samples, strategy.library, *grid) if pairs is None else pairs
        if pairs is not None:
            own, also = own[first : first + step], also[first : first + step]
        direction = shared[None] + (own.reshape(-1, extra) @ strategy.coefficients[:extra]).reshape(*also.shape, 3)
        theta, constant = natural_parameters(direction, strategy.noise)
        value = np.vecdot(theta, samples.target[some][:, None]) + constant
        if samples.unit:
            value = np.maximum(value, _ODD_STEP)
        value -= _null(samples, history, strategy, some)[:, None]
        counts = also & valid[None] & samples.seen[some][:, None]
        result[first : first + step] = np.where(counts, value, 0.0).sum(axis=2)
    return result
