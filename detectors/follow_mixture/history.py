"""The null model: predicts each UAV from its own past. The head of a follower must predict it better."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from detectors.follow_mixture.likelihood import concentration_of, fit_directions, log_normaliser, natural_parameters
from detectors.follow_mixture.samples import Samples, stride

__all__ = ["OwnHistory", "own_history"]

Floats = NDArray[np.float64]

_RIDGE = 1e-3
_ROWS = 2000  # rows for the fit of the shared model, which has few parameters
_WHITE = 0.05  # below this explained share the velocities count as white: followers of one head are not independent


@dataclass(frozen=True, eq=False)
class OwnHistory:
    """The fitted null model of all UAVs.

    Args:
        log_likelihood: ``(n, R)``, per seen row, relative to uniform directions (sphere) or up to a constant that the
            alternatives omit too (space; the term -|y|²/2s² is included); 0 where unseen.
        surprise: ``(n, R, 3)``, the innovations: target less prediction; 0 where unseen.
        memory: pooled lag-1 autocorrelation of the velocities about their means, from -1 to 1.
    """

    log_likelihood: Floats
    surprise: Floats
    memory: float

    def take(self, uavs: NDArray[np.int64]) -> OwnHistory:
        """The null model of some of the UAVs."""
        return OwnHistory(self.log_likelihood[uavs], self.surprise[uavs], self.memory)

    def padded(self, more: int) -> OwnHistory:
        """Append ``more`` UAVs with zeros, which are not used as targets."""
        return OwnHistory(
            np.pad(self.log_likelihood, ((0, more), (0, 0))),
            np.pad(self.surprise, ((0, more), (0, 0), (0, 0))),
            self.memory,
        )


def own_history(samples: Samples) -> OwnHistory:
    """Fit the null model: per UAV the best of a shared mean, its own mean, and its own mean with an autoregression.

    All UAVs share the autoregression. One per UAV would need more parameters than a short window allows, and would
    absorb a part of what the head explains.
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
    """Whether the autoregression explains more than it would for white velocities."""
    left = float((surprise**2).sum())
    chance = width / max(surprise.shape[0] * surprise.shape[1], 1)
    return bool(energy > 0 and 1.0 - left / energy > max(_WHITE, 4.0 * chance))


def _shared_law(samples: Samples, start: Floats) -> Floats:
    """``(n, R)``: log-likelihood of a shared regression on the own past, which is a shared strategy without heads.

    A follow strategy that uses the follower's own past thus contains its null model; only its head adds a gain.

    Args:
        samples: samples of n UAVs.
        start: ``(p, 3)``, the initial coefficients.
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
    """``(n, R)``: log-likelihood with one concentration per UAV, less the penalty of its parameters; 0 where unseen.

    ``own``: four parameters (mean and spread) were fitted to the UAV; otherwise all share one spread, without penalty.
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
