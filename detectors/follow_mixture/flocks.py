"""Flocks: groups of UAVs that move simultaneously, such as the followers of one head (clustering by lag-0 co-movement).

The velocity of a UAV is a signal that its flock shares, plus its own jitter and observation noise. In Fourier
coordinates all three are independent between frequencies. Differences of noisy positions have noise with the spectrum
2 sigma² (1 - cos w), which is small at low frequencies. With the shared signal integrated out, a flock of m UAVs with
summed coordinates S, each with noise N and signal power P times N, has the log-likelihood

    sum over frequencies and axes of  1/2 |S|² P / (1 + m P) - 1/2 log(1 + m P)

relative to independent members, with S in units of the square root of N. Flocks merge as long as the total rises; so no
other rule for their number is needed. A UAV that moves like no other UAV at the same time remains single: a head, whose
followers copy it later, or a decoy.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from detectors.follow_mixture.noise import FlightSpectra

__all__ = ["Flocks", "flocks_of", "fourier_coordinates"]

Floats = NDArray[np.float64]
Indices = NDArray[np.int64]

_JITTERS = (0.01, 0.03, 0.1, 0.3)  # share of the power that is a UAV's own jitter


@dataclass(frozen=True, eq=False)
class Flocks:
    """A partition of the UAVs by simultaneous motion.

    Args:
        label: ``(n,)`` from 0 to the number of flocks less 1, in the order of their first members.
        jitter: the share of a UAV's power that its flock doesn't share.
        value: log-likelihood, up to a constant of the window.
    """

    label: Indices
    jitter: float
    value: float

    @property
    def count(self) -> int:
        """Number of flocks, including those of one UAV."""
        return int(self.label.max()) + 1

    @property
    def several(self) -> Indices:
        """Labels of the flocks of two or more UAVs."""
        return np.flatnonzero(np.bincount(self.label) > 1)


def fourier_coordinates(velocity: Floats) -> tuple[Floats, Floats]:
    """Orthonormal real Fourier coordinates without the mean.

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
    """Find the flocks of a window by greedy merging.

    Args:
        velocity: ``(n, T, 3)`` in units of the mean speed, without missing values.
        spectra: the spectra of these velocities.

    Returns:
        The most likely partition over a grid of jitter shares.
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
    """``(m,)``: log-likelihood of flocks with sums ``(m, K, 3)`` and ``(m,)`` members, over independent UAVs."""
    spread = 1.0 + size[:, None] * ratio
    return np.asarray(
        0.5 * ((total * total).sum(axis=2) * (ratio / spread)).sum(axis=1) - 1.5 * np.log(spread).sum(axis=1)
    )


def _merged(scaled: Floats, ratio: Floats) -> tuple[Indices, float]:
    """Labels ``(n,)`` and their log-likelihood, by merging the best pair of flocks until no merger gains.

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
    # All pairs of single UAVs in one product: |a + b|² = |a|² + |b|² + 2 a·b.
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
