"""Flocks: UAVs that do the same at the same time. All followers of one head do, whatever their strategy is.

Every UAV's flight is a signal that its flock shares, plus jitter of its own and the observer's noise. In Fourier
coordinates all three are independent from frequency to frequency, and position noise, whose differences have spectrum
2 sigma² (1 - cos w), hardly hides the low ones. With the shared signal integrated out, a flock of m with summed
coordinates S, each of noise N and signal power P times N, has log-likelihood

    sum over frequencies and axes of  1/2 |S|² P / (1 + m P) - 1/2 log(1 + m P)

over its members flying alone, with S in units of the square root of N. Flocks merge as long as that sum rises, so that
their number needs no other rule, and who flies like nobody else stays alone: a head that its followers copy later, a
decoy.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from detectors.follow_mixture.noise import FlightSpectra

__all__ = ["Flocks", "flocks_of", "fourier_coordinates"]

Floats = NDArray[np.float64]
Indices = NDArray[np.int64]

_JITTERS = (0.01, 0.03, 0.1, 0.3)  # share of a flight's power that is its own


@dataclass(frozen=True, eq=False)
class Flocks:
    """A partition by simultaneous flight.

    Args:
        label: ``(n,)`` from 0 to the number of flocks less 1, in the order of their first members.
        jitter: the share of a flight's power that is not its flock's.
        value: log-likelihood, up to a constant of the window.
    """

    label: Indices
    jitter: float
    value: float

    @property
    def count(self) -> int:
        """How many flocks, those of one included."""
        return int(self.label.max()) + 1

    @property
    def several(self) -> Indices:
        """Labels of the flocks of two and more."""
        return np.flatnonzero(np.bincount(self.label) > 1)


def fourier_coordinates(velocity: Floats) -> tuple[Floats, Floats]:
    """Orthonormal real coordinates without the mean.

    Args:
        velocity: ``(n, T, 3)``.

    Returns:
        ``(n, K, 3)`` and the angular frequency ``(K,)`` of each; K = T - 1.
    """
    steps = velocity.shape[1]
    transformed = np.fft.rfft(velocity, axis=1, norm="ortho")[:, 1:]
    omega = 2.0 * np.pi * np.arange(1, transformed.shape[1] + 1) / steps
    real, imaginary = np.sqrt(2.0) * transformed.real, np.sqrt(2.0) * transformed.imag
    if steps % 2 == 0:  # the highest frequency of an even number of samples is real
        real[:, -1] /= np.sqrt(2.0)
        imaginary = imaginary[:, :-1]
    return np.concatenate([real, imaginary], axis=1), np.concatenate([omega, omega[: imaginary.shape[1]]])


def flocks_of(velocity: Floats, spectra: FlightSpectra) -> Flocks:
    """The flocks of a window.

    Args:
        velocity: ``(n, T, 3)`` in units of the mean speed, nothing missing.
        spectra: of the same flights.

    Returns:
        The likeliest partition that greedy merging finds, over a few shares of jitter.
    """
    coordinates, omega = fourier_coordinates(velocity)
    power, flight = float(np.median(spectra.power)), spectra.typical(omega)
    wave = 2.0 * (1.0 - np.cos(omega))
    found = []
    for jitter in _JITTERS:
        noise = spectra.noise * wave + jitter * power
        scaled = coordinates / np.sqrt(noise)[:, None]
        label, gained = _merged(scaled, (1.0 - jitter) * flight / noise)
        alone = -0.5 * float((scaled * scaled).sum()) - 1.5 * len(velocity) * float(np.log(noise).sum())
        found.append(Flocks(label, jitter, alone + gained))
    return max(found, key=lambda flocks: flocks.value)


def _worth(total: Floats, size: Floats, ratio: Floats) -> Floats:
    """``(m,)`` log-likelihood of flocks with sums ``(m, K, 3)`` and ``(m,)`` members, over flying alone."""
    spread = 1.0 + size[:, None] * ratio
    return np.asarray(
        0.5 * ((total * total).sum(axis=2) * (ratio / spread)).sum(axis=1) - 1.5 * np.log(spread).sum(axis=1)
    )


def _merged(scaled: Floats, ratio: Floats) -> tuple[Indices, float]:
    """Labels ``(n,)`` and what they are worth, by merging the two flocks that gain most until none gains.

    Args:
        scaled: ``(n, K, 3)`` in units of the noise.
        ratio: ``(K,)`` P.
    """
    uavs = len(scaled)
    total, size = scaled.copy(), np.ones(uavs)
    worth = _worth(total, size, ratio)
    there = np.ones(uavs, bool)
    label = np.arange(uavs)
    value = float(worth.sum())
    # All pairs of single UAVs at once: |a + b|² = |a|² + |b|² + 2 a·b.
    weight = ratio / (1.0 + 2.0 * ratio)
    heavy = (scaled * np.sqrt(weight)[:, None]).reshape(uavs, -1)
    square = (heavy * heavy).sum(axis=1)
    rise = 0.5 * (square[:, None] + square[None]) + heavy @ heavy.T - 1.5 * float(np.log1p(2.0 * ratio).sum())
    rise -= worth[:, None] + worth[None]
    np.fill_diagonal(rise, -np.inf)
    for _ in range(uavs - 1):
        one, other = np.unravel_index(rise.argmax(), rise.shape)
        if rise[one, other] <= 0:
            break
        value += float(rise[one, other])
        total[one] += total[other]
        size[one] += size[other]
        there[other] = False
        label[label == other] = one
        worth[one] = _worth(total[[one]], size[[one]], ratio)[0]
        rise[other], rise[:, other] = -np.inf, -np.inf
        rest = np.flatnonzero(there)
        row = _worth(total[rest] + total[one], size[rest] + size[one], ratio) - worth[rest] - worth[one]
        rise[one, rest] = row
        rise[rest, one] = row
        rise[one, one] = -np.inf
    return _in_order(label), value


def _in_order(label: Indices) -> Indices:
    """Labels renamed by the order of their first members."""
    _, first, place = np.unique(label, return_index=True, return_inverse=True)
    rank = np.empty(len(first), np.int64)
    rank[np.argsort(first)] = np.arange(len(first))
    return np.asarray(rank[place], np.int64)
