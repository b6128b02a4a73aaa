"""Noise of the observer: how large it is, smoothed pasts, and residuals whitened in time.

Velocities that are differences of noisy positions carry noise of spectrum 2 sigma² (1 - cos w): hardly any at low
frequencies, four times sigma² at the highest. A regression on them is attenuated and treats every frequency alike. So
the past of a candidate is replaced by its expectation given all that was seen of it (Wiener's smoother): the error of
such a regressor is uncorrelated with it (Berkson's case), and least squares stay unbiased. What a follower's flight
leaves over is the difference of its own observation noise, and that smoothing error: a covariance known but for its
scale, whose inverse square root whitens the rows.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from detectors.follow_mixture.history import OwnHistory
from detectors.follow_mixture.samples import Samples

__all__ = ["FlightSpectra", "fit_spectra", "noisy_problem"]

Floats = NDArray[np.float64]

LEAST_NOISE = 0.004  # variance of position noise per axis, relative to the squared speed, below which it is none
_SLACK = 0.02  # what a strategy leaves open of a clean flight, relative to its variance
_MEMORIES = np.concatenate([np.linspace(0.0, 0.9, 7), [0.95, 0.98]])
_POWERS = np.exp(np.linspace(np.log(0.005), np.log(2.0), 16))  # of the mean periodogram
_NOISES = np.concatenate([[1e-4], np.exp(np.linspace(np.log(0.005), 0.0, 24))])


@dataclass(frozen=True, eq=False)
class FlightSpectra:
    """Flights as AR(1) about a mean, each its own, seen with one position noise; per axis, in units of mean speed.

    Args:
        power: ``(n,)`` variance of each UAV's velocity about its mean.
        memory: ``(n,)`` its lag-1 autocorrelation.
        noise: variance of a position.
    """

    power: Floats
    memory: Floats
    noise: float

    def flight(self, steps: int) -> Floats:
        """Covariances ``(n, steps, steps)`` of the true velocities."""
        apart = np.abs(np.arange(steps)[:, None] - np.arange(steps)[None, :])
        decay = self.memory[:, None] ** np.arange(steps)
        return np.asarray(self.power[:, None, None] * decay[:, apart])

    def seen(self, steps: int) -> Floats:
        """Covariance ``(steps, steps)`` of the noise in the seen velocities."""
        return self.noise * (2.0 * np.eye(steps) - np.eye(steps, k=1) - np.eye(steps, k=-1))


def fit_spectra(velocity: Floats) -> FlightSpectra:
    """Whittle's fit to the periodograms of n UAVs ``(n, T, 3)``; one noise for all, power and memory for each."""
    uavs, steps = velocity.shape[:2]
    flight = velocity - velocity.mean(axis=1, keepdims=True)
    periodogram = (np.abs(np.fft.rfft(flight, axis=1)) ** 2).mean(axis=2)[:, 1:] / steps
    omega = 2.0 * np.pi * np.arange(1, periodogram.shape[1] + 1) / steps
    wave = 2.0 * (1.0 - np.cos(omega))
    shapes = (1.0 - _MEMORIES[:, None] ** 2) / (
        1.0 - 2.0 * _MEMORIES[:, None] * np.cos(omega) + _MEMORIES[:, None] ** 2
    )
    scale = float(periodogram.mean())
    powers = scale * _POWERS
    best, found = np.inf, FlightSpectra(np.full(uavs, scale), np.zeros(uavs), 0.0)
    for noise in 0.5 * scale * _NOISES:
        model = powers[:, None, None] * shapes[None] + noise * wave
        model = model.reshape(-1, len(omega))
        fit = np.log(model).sum(axis=1)[None] + periodogram @ (1.0 / model).T
        choice = fit.argmin(axis=1)
        total = float(fit.min(axis=1).sum())
        if total < best:
            best = total
            found = FlightSpectra(powers[choice // len(_MEMORIES)], _MEMORIES[choice % len(_MEMORIES)], float(noise))
    return found


def noisy_problem(samples: Samples, velocity: Floats) -> tuple[Samples, OwnHistory, float] | None:
    """The samples with smoothed pasts and whitened rows, and the null beside them.

    Args:
        samples: with targets in space, nothing missing.
        velocity: ``(n, T, 3)`` the velocities that they were cut from, in the same unit.

    Returns:
        Samples, null, and what a log-likelihood in whitened rows leaves out of one of the velocities seen; ``None``
        where there is no noise to speak of.
    """
    spectra = fit_spectra(velocity)
    if spectra.noise < LEAST_NOISE:
        return None
    uavs, steps = velocity.shape[:2]
    memory, rows = samples.memory, samples.rows
    flight, noise = spectra.flight(steps), spectra.seen(steps)
    mean = velocity.mean(axis=1, keepdims=True)
    # With V = L L' and z = L^-1 y, the expectation of v at s given y before t is sum over k < t of (S L'^-1)_sk z_k.
    lower_seen = np.linalg.cholesky(flight + noise)
    innovation = np.linalg.solve(lower_seen, velocity - mean)
    reach = np.linalg.solve(lower_seen, flight).transpose(0, 2, 1)
    times = np.arange(memory, steps)
    before = np.arange(steps)[None, :] < times[:, None]
    lagged = np.empty_like(samples.lagged)
    for lag in range(memory):
        lagged[:, :, lag] = mean + (reach[:, times - 1 - lag] * before) @ innovation
    # Who leads is not known yet: the error of those whose flight is least predictable stands for the heads'.
    surprise_power = spectra.power * (1.0 - spectra.memory**2)
    lively = surprise_power >= np.quantile(surprise_power, 0.75)
    there = reach[lively][:, times - 1]
    unseen = there * ~before
    error = (
        flight[lively][:, times - 1][:, :, times - 1]
        - there @ there.transpose(0, 2, 1)
        + unseen @ unseen.transpose(0, 2, 1)
    ).mean(axis=0)
    late = slice(memory, steps)
    slack = _SLACK * float(np.median(spectra.power))
    left = noise[late, late] + error + slack * np.eye(rows)
    lower = np.linalg.cholesky(left)
    whiten = solve_triangular(lower, np.eye(rows), lower=True)
    null_lower = np.linalg.cholesky(flight[:, late, late] + noise[late, late])
    null_white = np.linalg.solve(null_lower, samples.target - mean)
    # Both laws are densities of the seen velocities; the Jacobian of the whitening is left out of both.
    whitening = float(np.log(np.diag(lower)).sum())
    jacobian = np.log(np.diagonal(null_lower, axis1=1, axis2=2)).sum(axis=1) - whitening
    total = -0.5 * (null_white**2).sum(axis=(1, 2)) - 3.0 * jacobian - 2.5 * np.log(rows)
    whitened = replace(samples, target=whiten @ samples.target, lagged=lagged, whiten=whiten)
    null = OwnHistory(
        np.repeat(total[:, None] / rows, rows, axis=1),
        whiten @ (samples.target - mean),
        float(np.median(spectra.memory)),
    )
    return whitened, null, -3.0 * uavs * whitening
