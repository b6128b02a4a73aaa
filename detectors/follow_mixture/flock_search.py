"""Finds the heads of the flocks of a window, with or without observation noise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from detectors.follow_mixture.flock_heads import (
    FlockHeads,
    Watch,
    affordable,
    each_by_itself,
    heads_of_flocks,
    shown,
    watch_flocks,
)
from detectors.follow_mixture.flocks import Flocks
from detectors.follow_mixture.noise import LEAST_NOISE, FlightSpectra, fit_spectra, smoothed_pasts
from detectors.follow_mixture.samples import Samples
from detectors.follow_mixture.strategy import Library

__all__ = ["first_guesses", "flights", "flock_search", "seen_spectra"]

Floats = NDArray[np.float64]
Indices = NDArray[np.int64]


def flights(samples: Samples) -> Floats:
    """``(n, T, 3)``: the velocities behind the samples, in units of the mean speed; 0 where unseen."""
    return np.concatenate([samples.lagged[:, 0, ::-1], samples.target], axis=1)


def seen_spectra(samples: Samples) -> FlightSpectra:
    """Fit the spectra of motion and observation noise; equal speeds imply that there is no noise."""
    spectra = fit_spectra(flights(samples))
    return replace(spectra, noise=0.0) if samples.unit or spectra.noise < LEAST_NOISE else spectra


def flock_search(
    samples: Samples, spectra: FlightSpectra, flocks: Flocks, most: int | None = None
) -> tuple[Watch, FlockHeads | None]:
    """Compute the innovations of the flocks, and find their heads.

    Args:
        samples: samples of n UAVs without missing values.
        spectra: the spectra of these velocities; ``noise`` is 0 if there is none.
        flocks: the flocks of these UAVs.
        most: the largest number of heads.

    Returns:
        The innovations of the flocks, and the heads that explain them best or ``None``.
    """
    watch = watch_flocks(samples, flocks)
    candidates = samples
    if spectra.noise > 0:
        candidates = replace(samples, lagged=smoothed_pasts(samples, flights(samples), spectra))
    return watch, heads_of_flocks(candidates, watch, most)


def first_guesses(samples: Samples, watch: Watch, most: int | None = None) -> list[Indices]:
    """Assignments ``(n,)`` with one regression per pair of a flock and a UAV; starts for a joint fit."""
    guesses = []
    for some in (shown(samples, Library(lags)) for lags in {samples.memory, 1}):
        if not affordable(watch, some):
            continue
        head = each_by_itself(watch, some, most).head
        leader = head[watch.label]
        leader[head[head >= 0]] = -1
        guesses.append(leader)
    return guesses
