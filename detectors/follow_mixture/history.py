"""The null: what each UAV's own history says about its next velocity. Who follows must be predicted better than so."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from detectors.follow_mixture.likelihood import concentration_of, fit_directions, log_normaliser, natural_parameters
from detectors.follow_mixture.samples import Samples, stride

__all__ = ["OwnHistory", "own_history"]

Floats = NDArray[np.float64]

_RIDGE = 1e-3
_ROWS = 2000  # that the law of all is fitted to, which has few numbers
_WHITE = 0.05  # flights that explain less of themselves than this are white: followers of one head are not independent


@dataclass(frozen=True, eq=False)
class OwnHistory:
    """The null of every UAV.

    Args:
        log_likelihood: ``(n, R)`` of every seen row, relative to uniform directions (sphere) or up to what the
            alternatives leave out as well (space: no -|y|²/2s² is left out here); 0 where unseen.
        surprise: ``(n, R, 3)`` target less its prediction; 0 where unseen.
        memory: pooled lag-1 autocorrelation of the velocities about their means, from -1 to 1.
    """

    log_likelihood: Floats
    surprise: Floats
    memory: float

    def take(self, uavs: NDArray[np.int64]) -> OwnHistory:
        """The null of some of the UAVs."""
        return OwnHistory(self.log_likelihood[uavs], self.surprise[uavs], self.memory)

    def padded(self, more: int) -> OwnHistory:
        """With ``more`` UAVs behind these, of which nothing is asked."""
        return OwnHistory(
            np.pad(self.log_likelihood, ((0, more), (0, 0))),
            np.pad(self.surprise, ((0, more), (0, 0), (0, 0))),
            self.memory,
        )


def own_history(samples: Samples) -> OwnHistory:
    """Fit the null: the best of a law that all share, a mean of one's own, and that mean with an autoregression.

    The autoregression is shared because a UAV's own would need more numbers than a short window can give, and would
    take a share of what its head explains.
    """
    seen = samples.seen[..., None].astype(np.float64)
    count = np.maximum(seen.sum(axis=1), 1.0)
    mean = (samples.target * seen).sum(axis=1) / count
    flight = (samples.target - mean[:, None]) * seen
    past = (samples.lagged - mean[:, None, None]) * samples.lag_seen[..., None]
    uavs, rows = samples.uavs, samples.rows
    features = past.reshape(uavs * rows, -1)
    flat = flight.reshape(uavs * rows, 3)
    gram = features.T @ features
    scale = np.trace(gram) / len(gram)
    weights = np.linalg.solve(gram + (_RIDGE * scale + 1e-12) * np.eye(len(gram)), features.T @ flat)
    forecast = (features @ weights).reshape(uavs, rows, 3)
    surprise = (flight - forecast) * seen
    energy = float((flight**2).sum())
    lag_one = float((flight * past[:, :, 0]).sum())
    memory = lag_one / energy if energy > 0 else 0.0
    everybody = (samples.target * seen).sum(axis=(0, 1)) / count.sum()
    common = np.broadcast_to(everybody, samples.target.shape)
    laws = [
        (_log_likelihood(samples, common, (samples.target - common) * seen, own=False), flight),
        (_log_likelihood(samples, np.broadcast_to(mean[:, None], samples.target.shape), flight), flight),
        (_log_likelihood(samples, mean[:, None] + forecast, surprise), surprise),
    ]
    if unlike_white(energy, surprise, len(gram)):
        laws.append((_shared_law(samples, np.vstack([weights, everybody])), surprise))
    best = np.argmax([law[0].sum(axis=1) for law in laws], axis=0)
    every = np.arange(uavs)
    return OwnHistory(
        np.stack([law[0] for law in laws])[best, every],
        np.stack([law[1] for law in laws])[best, every],
        memory,
    )


def unlike_white(energy: float, surprise: Floats, width: int) -> bool:
    """Whether the autoregression explains more than it would of white flight."""
    left = float((surprise**2).sum())
    chance = width / max(surprise.shape[0] * surprise.shape[1], 1)
    return bool(energy > 0 and 1.0 - left / energy > max(_WHITE, 4.0 * chance))


def _shared_law(samples: Samples, start: Floats) -> Floats:
    """``(n, R)`` log-likelihood under one law of one's own past for all: what a shared strategy without heads gives.

    So a follow strategy that uses the follower's own past contains its null, and gains by its head alone.

    Args:
        samples: n UAVs.
        start: ``(p, 3)`` coefficients to begin from.
    """
    features = np.concatenate(
        [samples.lagged.reshape(samples.uavs, samples.rows, -1), np.ones((samples.uavs, samples.rows, 1))], axis=2
    )
    keep = samples.seen & samples.lag_seen.all(axis=2)
    kept = np.flatnonzero(keep)
    some = kept[:: stride(len(kept), _ROWS, samples.rows)]
    coefficients, noise = fit_directions(
        features.reshape(-1, features.shape[2])[some],
        samples.target.reshape(-1, 3)[some],
        np.ones(len(some)),
        samples.unit,
        start=start,
    )
    theta, constant = natural_parameters(features @ coefficients, noise)
    value = np.vecdot(theta, samples.target) + constant
    if not samples.unit:
        value -= 0.5 * np.vecdot(samples.target, samples.target) / noise.spread**2
    return np.where(keep, value, 0.0)


def _log_likelihood(samples: Samples, prediction: Floats, error: Floats, own: bool = True) -> Floats:
    """``(n, R)`` with one concentration a UAV, less its price as parameters; 0 where unseen.

    ``own``: four numbers (mean and spread) were fitted to the UAV itself; else all share one spread, at no price.
    """
    seen = samples.seen
    count = np.maximum(seen.sum(axis=1), 1)
    price = np.where(seen, (2.0 * np.log(np.maximum(count, 2)) / count)[:, None], 0.0) if own else 0.0
    if not samples.unit:
        power, freedom = (error**2).sum(axis=(1, 2)), 3.0 * np.maximum(count - 1, 1)
        if not own:
            power, freedom = power.sum(keepdims=True), freedom.sum(keepdims=True)
        variance = np.maximum(power / freedom, 1e-6)[:, None]
        value = -0.5 * np.vecdot(error, error) / variance - 1.5 * np.log(variance)
        return np.where(seen, value, 0.0) - price
    length = np.sqrt(np.vecdot(prediction, prediction))
    along = np.vecdot(samples.target, prediction) / np.maximum(length, 1e-9)
    along = np.where(seen, along, 0.0)
    share = along.sum(axis=1) / count if own else along.sum(keepdims=True)[0] / count.sum()
    kappa = concentration_of(np.maximum(share, 0.0))[:, None]
    value = log_normaliser(kappa) + kappa * (along - 1.0)
    return np.where(seen, value, 0.0) - price
