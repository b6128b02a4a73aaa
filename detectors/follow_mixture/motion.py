"""Converts a window to the velocities of its living UAVs: without a common drift, in units of speed, without gaps.

Observed velocities are differences of noisy positions; their noise has the spectrum 2 sigma² (1 - cos w), which is
small at low frequencies and four times sigma² at the highest. It attenuates a regression on them. So the variance of
the noise is estimated, and the past of a candidate is replaced by its conditional expectation given the observations
(Wiener smoothing). The error of this regressor is uncorrelated with it (Berkson errors), so that least squares remain
unbiased.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from detectors.series.gaps import fill_gaps
from usnet_env.arrays import Floats, Indices
from usnet_env.window import Window

LEAST_STEPS = 5  # velocities; a shorter window has no past to compare with
# Speeds count as equal if their standard deviation is below this share of the velocities' scatter about their mean: the
# speeds of a swarm that drifts fast as a whole hardly differ either.
_UNIT_SPREAD = 0.02
_ROUNDING = 1e-5  # of the speed; speeds that differ less are equal in single precision
_DRIFT = 3.0  # a mean velocity of more than this many times the scatter is a drift of the swarm and taken off
_LEAST_NOISE = 0.004  # smaller variances of position noise per axis, relative to the squared speed, count as 0
_MEMORIES = np.concatenate([np.linspace(0.0, 0.9, 7), [0.95, 0.98]])
_POWERS = np.exp(np.linspace(np.log(0.005), np.log(2.0), 16))  # of the mean periodogram
_NOISES = np.concatenate([[1e-4], np.exp(np.linspace(np.log(0.005), 0.0, 24))])
_NOTHING = 1e-12  # least scale, in squared mean speeds: straight motion without noise has no spectrum


@dataclass(frozen=True, eq=False)
class Motion:
    """The velocities of n UAVs at T steps, along the a axes along which any of them moves."""

    velocity: Floats  #: ``(n, T, a)`` in units of the mean speed, without the drift; gaps are filled
    speed: float  #: mean speed without the drift, in metres per step
    unit: bool  #: every UAV flies at the same constant speed; then positions are seen without noise
    drift: Floats  #: ``(3,)`` metres per step, the velocity of the whole swarm that was taken off


def read_motion(window: Window, living: Indices) -> Motion | None:
    """Read the motion of the ``living`` UAVs ``(n,)``.

    ``None`` for fewer than 2 UAVs, fewer than :data:`LEAST_STEPS` velocities, or if no UAV is seen to move.
    """
    if len(living) < 2 or window.observation_steps < LEAST_STEPS:
        return None
    seen = window.velocity_seen[:, living]
    found = window.velocity[:, living].astype(np.float64)
    found = found.reshape(-1, 3) if seen.all() else found[seen]
    flown = np.sqrt(np.vecdot(found, found))
    if not flown.sum() > 0:
        return None
    drift, unit = common_drift(found, flown)
    velocity: Floats = window.velocity - drift
    if not seen.all():
        position = window.position - np.arange(window.observation_steps + 1)[:, None, None] * drift
        track, steps = position.astype(np.float32), velocity.astype(np.float32)
        filled = fill_gaps(Window(track, steps, window.seen, window.alive, window.round))
        velocity = filled.velocity.astype(np.float64)
    velocity = np.ascontiguousarray(velocity[:, living].swapaxes(0, 1))
    speed = float(np.sqrt(np.vecdot(velocity, velocity))[seen.T].mean())
    # Tracks in a plane are evidence of two axes, not three.
    moves = np.array([np.ptp(along) for along in np.moveaxis(velocity, 2, 0)]) > _ROUNDING * speed
    moves |= not moves.any()
    return Motion(np.ascontiguousarray(velocity[:, :, moves]) / speed, speed, unit, drift)


def common_drift(velocity: Floats, speeds: Floats) -> tuple[Floats, bool]:
    """The drift ``(3,)`` of a swarm, and whether all its UAVs fly at one speed relative to it.

    It is 0 if the swarm flies at one speed or does not drift fast as a whole; else the centre of the sphere of
    velocities ``(k, 3)`` of one speed, or the mean velocity. ``speeds`` ``(k,)`` are the lengths of velocities.
    """
    none, mean = np.zeros(3), np.full(len(velocity), 1.0 / len(velocity)) @ velocity
    about = velocity - mean
    scatter = float(np.sqrt(np.vdot(about, about) / len(about)))
    if speeds.std() < max(_UNIT_SPREAD * scatter, _ROUNDING * float(speeds.mean())):
        return none, True
    if not np.sqrt(mean @ mean) > _DRIFT * scatter > 0:
        return none, False
    # On a sphere about c, |u|² = 2 (c - mean)·u + constant holds for u = v - mean: a linear regression.
    squares = (about**2).sum(axis=1)
    half, *_ = np.linalg.lstsq(2.0 * about, squares - squares.mean(), rcond=1e-6)
    relative = np.sqrt(((about - half) ** 2).sum(axis=1))
    unit = bool(relative.std() < _UNIT_SPREAD * scatter)
    return (mean + half if unit else mean), unit


def lagged(velocity: Floats, lags: int) -> Floats:
    """The velocities ``(n, T, a)`` before each step from ``lags`` on: ``(n, lags, a, T - lags)``, newest first."""
    across = np.ascontiguousarray(velocity.transpose(0, 2, 1))
    return np.stack([across[:, :, lag : lag - lags] for lag in reversed(range(lags))], axis=1)


@dataclass(frozen=True, eq=False)
class FlightSpectra:
    """AR(1) models of the velocities, one per UAV, with one common position noise; per axis, in units of mean speed."""

    power: Floats  #: ``(n,)`` variance of each UAV's velocity about its mean
    memory: Floats  #: ``(n,)`` its lag-1 autocorrelation
    noise: float  #: variance of a position

    def typical(self, omega: Floats) -> Floats:
        """Spectrum ``(K,)`` at angular frequencies, for the median power and autocorrelation."""
        memory = float(np.median(self.memory))
        shape = (1.0 - memory**2) / (1.0 - 2.0 * memory * np.cos(omega) + memory**2)
        return np.asarray(float(np.median(self.power)) * shape)


def fit_spectra(velocity: Floats, noiseless: bool) -> FlightSpectra:
    """Fit the spectra of velocities ``(n, T, a)`` by Whittle's likelihood of the periodograms."""
    uavs, steps = velocity.shape[:2]
    flight = velocity - velocity.mean(axis=1, keepdims=True)
    transformed = np.fft.rfft(flight.transpose(0, 2, 1))[:, :, 1:]
    periodogram = (transformed.real**2 + transformed.imag**2).mean(axis=1) / steps
    omega = 2.0 * np.pi * np.arange(1, periodogram.shape[1] + 1) / steps
    wave = 2.0 * (1.0 - np.cos(omega))
    scale = max(float(periodogram.mean()), _NOTHING)
    powers = scale * _POWERS
    memory = _MEMORIES[:, None]
    shapes = (1.0 - memory**2) / (1.0 - 2.0 * memory * np.cos(omega) + memory**2)
    best, found = np.inf, FlightSpectra(np.full(uavs, scale), np.zeros(uavs), 0.0)
    for noise in 0.5 * scale * (_NOISES[:1] if noiseless else _NOISES):
        model = powers[:, None, None] * shapes[None] + noise * wave
        model = model.reshape(-1, len(omega))
        fit = np.log(model).sum(axis=1)[None] + periodogram @ (1.0 / model).T
        choice = fit.argmin(axis=1)
        total = float(fit.min(axis=1).sum())
        if total < best:
            best, seen = total, 0.0 if noise < _LEAST_NOISE else float(noise)
            found = FlightSpectra(powers[choice // len(_MEMORIES)], _MEMORIES[choice % len(_MEMORIES)], seen)
    return found


def smoothed_pasts(velocity: Floats, spectra: FlightSpectra, lags: int) -> Floats:
    """Expectation of each UAV's past velocities, given its observations before the row's time; these, if without noise.

    Only earlier observations are used: with noise, a fellow follower smoothed with its future would predict a follower
    better than their head does. The result ``(n, L, a, T - L)``, newest first, takes the place of :func:`lagged`.
    """
    if not spectra.noise > 0:
        return lagged(velocity, lags)
    uavs, steps = velocity.shape[:2]
    mean, innovation, reach, kind = _whiten_tracks(velocity, spectra)
    times = np.arange(lags, steps)
    before = np.arange(steps)[None, :] < times[:, None]
    past = np.empty((uavs, lags, velocity.shape[2], steps - lags))
    for lag in range(lags):
        known = (reach[:, times - 1 - lag] * before)[kind]
        past[:, lag] = (mean + known @ innovation).transpose(0, 2, 1)
    return past


def filter_tracks(velocity: Floats, spectra: FlightSpectra, uavs: Indices) -> tuple[Floats, Floats]:
    """Expectation ``(M, T, a)`` of some UAVs' velocities, given what is seen until each step; and from each step on."""
    tracks = velocity[uavs]
    if not spectra.noise > 0:
        return tracks, tracks
    some = FlightSpectra(spectra.power[uavs], spectra.memory[uavs], spectra.noise)

    def look_back(values: Floats) -> Floats:
        mean, innovation, reach, kind = _whiten_tracks(values, some)
        return np.asarray(mean + np.tril(reach)[kind] @ innovation)

    return look_back(tracks), look_back(tracks[:, ::-1])[:, ::-1]


def _whiten_tracks(velocity: Floats, spectra: FlightSpectra) -> tuple[Floats, Floats, Floats, Indices]:
    """Mean ``(n, 1, a)`` and innovations ``(n, T, a)`` of tracks, what these tell by kind of spectrum, and the kinds.

    With V = S + noise = L L' and z = L^-1 y, the expectation of v at s given y before t is the sum over k < t of
    (S L'^-1)_sk z_k, where S are the covariances of the true velocities: ``(u, T, T)`` for u different spectra, of
    which each track has one ``(n,)``.
    """
    steps = np.arange(velocity.shape[1])
    kinds, kind = np.unique(np.stack([spectra.power, spectra.memory], axis=1), axis=0, return_inverse=True)
    flight = kinds[:, :1, None] * (kinds[:, 1:] ** steps)[:, np.abs(steps[:, None] - steps)]
    noise = spectra.noise * (2.0 * np.eye(len(steps)) - np.eye(len(steps), k=1) - np.eye(len(steps), k=-1))
    mean = velocity.mean(axis=1, keepdims=True)
    inverse = np.linalg.inv(np.linalg.cholesky(flight + noise))
    kind = kind.ravel()
    return mean, inverse[kind] @ (velocity - mean), flight @ inverse.transpose(0, 2, 1), kind
