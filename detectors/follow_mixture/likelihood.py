"""Likelihood of velocities for a predicted direction: von Mises-Fisher on the sphere, or normal in space.

If all UAVs have the same speed, a velocity is a point on the sphere. A normal distribution in space would count the
radius, which every model predicts, as evidence. So equal speeds use the von Mises-Fisher distribution, with the density
kappa / sinh(kappa) exp(kappa mu·y) relative to the uniform one. Let D be the direction before norm(·), and sigma the
standard deviation of the noise per axis. Then the direction of D + noise has the standard deviation sigma / |D|: if the
terms of a strategy cancel, kappa is small and the step carries little information. ``floor`` is the error of the class
of strategies itself.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

__all__ = [
    "Noise",
    "concentration_of",
    "fit_directions",
    "fit_noise",
    "flight_likelihood",
    "log_normaliser",
    "natural_parameters",
]

Floats = NDArray[np.float64]
RealT = TypeVar("RealT", np.float32, np.float64)

_FLOORS = (0.0, 0.25, 1.0)  # floor as a multiple of the spread
_LEAST_SPREAD = 5e-3
_RIDGE = 1e-7
_NOISE_ROWS = 400  # enough rows to fit two parameters
_FIXED_POINTS = 12
_MORE_POINTS = 5  # iterations from a good start


@dataclass(frozen=True)
class Noise:
    """The error distribution of a prediction.

    Args:
        spread: sigma, per axis, relative to the root mean square of |D| (sphere) or to the mean speed (space).
        floor: an additional spread that does not shrink where |D| is large; 0 in space.
        unit: sphere or space.
    """

    spread: float
    floor: float
    unit: bool


def log_normaliser(kappa: Floats) -> Floats:
    """Logarithm of kappa / sinh(kappa) e^kappa: the density relative to uniform is exp(this + kappa (mu·y - 1))."""
    small = kappa < 1e-4
    safe = np.where(small, 1.0, kappa)
    value: Floats = np.where(small, kappa, np.log(2.0 * safe) - np.log(-np.expm1(-2.0 * safe)))
    return value


def natural_parameters(direction: Floats, noise: Noise) -> tuple[Floats, Floats]:
    """Theta and c such that the log-likelihood of y is theta·y + c (space: less |y|²/(2 sigma²), which is y's own).

    Args:
        direction: ``(..., 3)`` D.
        noise: fitted.

    Returns:
        theta ``(..., 3)`` and c ``(...)``.
    """
    square = np.vecdot(direction, direction)
    if not noise.unit:
        precision = 1.0 / noise.spread**2
        return direction * precision, -0.5 * precision * square - 3.0 * np.log(noise.spread)
    square = np.maximum(square, 1e-12)
    kappa = 1.0 / (noise.floor**2 + noise.spread**2 / square)
    return direction * (kappa / np.sqrt(square))[..., None], log_normaliser(kappa) - kappa


def flight_likelihood(direction: NDArray[RealT], flight: NDArray[RealT], noise: Noise) -> NDArray[RealT]:
    """theta·y + c of :func:`natural_parameters`, for directions D ``(3, ...)`` and flights y that fit their shape."""
    square = direction[0] * direction[0] + direction[1] * direction[1] + direction[2] * direction[2]
    along = direction[0] * flight[0] + direction[1] * flight[1] + direction[2] * flight[2]
    if not noise.unit:
        value = (along - 0.5 * square) / noise.spread**2 - 3.0 * np.log(noise.spread)
        return np.asarray(value, direction.dtype)
    square = np.maximum(square, 1e-12)
    kappa = 1.0 / (noise.floor**2 + noise.spread**2 / square)
    value = kappa * (along / np.sqrt(square) - 1.0) + log_normaliser(kappa)
    return np.asarray(value, direction.dtype)


def fit_noise(square: Floats, along: Floats, weight: Floats, error: float, unit: bool) -> Noise:
    """Fit the noise by maximum likelihood.

    Args:
        square: ``(rows,)`` |D|².
        along: ``(rows,)`` mean of mu·y over the UAVs that share the row.
        weight: ``(rows,)`` how many share it.
        error: mean square of (y - D) per axis over all; used in space.
        unit: sphere or space.
    """
    if not unit:
        return Noise(max(float(np.sqrt(error)), _LEAST_SPREAD), 0.0, False)
    every = max(1, len(square) // _NOISE_ROWS)
    square, along, weight = square[::every], along[::every], weight[::every]
    total = max(float(weight.sum()), 1.0)
    # The tangential spread at large kappa is a good centre for the search; the grid covers the rest.
    ratio = 1.0 / np.maximum(square, 1e-12)
    # (1 - mu·y) is about spread² / |D|²: chi-square with two degrees of freedom.
    guess = np.sqrt(max(float((weight * (1.0 - along)).sum() / max((weight * ratio).sum(), 1e-12)), 1e-8))
    spreads = np.clip(guess * np.array([0.5, 0.7, 0.85, 1.0, 1.2, 1.5, 2.0, 3.0, 5.0]), _LEAST_SPREAD, 20.0)
    best, found = -np.inf, Noise(4.0, 0.0, True)
    for floor in _FLOORS:
        variance = spreads[:, None] ** 2 * (floor**2 + ratio[None])
        kappa = 1.0 / variance
        value = ((log_normaliser(kappa) + kappa * (along - 1.0)[None]) * weight[None]).sum(axis=1) / total
        top = int(value.argmax())
        if value[top] > best + 1e-9:
            best, found = float(value[top]), Noise(float(spreads[top]), float(floor * spreads[top]), True)
    return found


def fit_directions(
    features: Floats,
    total: Floats,
    weight: Floats,
    unit: bool,
    energy: float | None = None,
    isotropic: bool = False,
    start: Floats | None = None,
) -> tuple[Floats, Noise]:
    """Fit the coefficients ``(p, 3)`` of a linear model of the direction, and its noise.

    norm(.) is undone by the fixed point D = argmin sum |D - |D| y|^2, whose residual is the raw noise across y.

    Args:
        features: ``(rows, p)``.
        total: ``(rows, 3)`` sum of the flights y that share a row.
        weight: ``(rows,)`` the number of velocities that share the row.
        unit: whether the velocities are directions.
        energy: summed squares of all velocities; ``None`` if each row has one velocity.
        isotropic: the same coefficients on every axis; all features but the last, the intercept, are triples.
        start: ``(p, 3)`` initial coefficients, by default those of a model without norm(.).
    """
    coefficients = _solve_direction(features, total, weight, unit, isotropic, start)
    direction = features @ coefficients
    square = np.maximum(np.vecdot(direction, direction), 1e-12)
    across = np.vecdot(direction, total)
    along = across / (np.sqrt(square) * np.maximum(weight, 1e-12))
    energy = float((total**2).sum()) if energy is None else energy
    left = energy - 2.0 * float(across.sum()) + float((weight * square).sum())
    return coefficients, fit_noise(square, along, weight, max(left, 0.0) / max(3.0 * float(weight.sum()), 1.0), unit)


class _Regression:
    """Least squares with one factorisation and many right-hand sides; ``isotropic``: the same law on every axis.

    Features then come in triples, one for each axis, and an intercept; a triple has one coefficient.
    """

    def __init__(self, features: Floats, weight: Floats, isotropic: bool) -> None:
        self.features, self.isotropic = features, isotropic
        rows, width = features.shape
        if isotropic:
            ones = np.ones((rows, 1, 3))
            self.triples = np.concatenate([features[:, :-1].reshape(rows, -1, 3), ones], axis=1)
            flat = self.triples.transpose(0, 2, 1).reshape(3 * rows, -1)
            gram = flat.T @ (flat * np.repeat(weight, 3)[:, None])
        else:
            gram = features.T @ (features * weight[:, None])
        power = np.trace(gram) / len(gram)
        gram[np.diag_indices(len(gram))] += _RIDGE * power + 1e-9
        self.inverse = np.linalg.inv(gram)
        self.width = width

    def solve(self, total: Floats) -> Floats:
        """Coefficients ``(p, 3)`` for weighted targets ``(rows, 3)``."""
        if not self.isotropic:
            return np.asarray(self.inverse @ (self.features.T @ total))
        single = self.inverse @ np.einsum("rka,ra->k", self.triples, total)
        coefficients = np.zeros((self.width, 3))
        for axis in range(3):
            coefficients[axis:-1:3, axis] = single[:-1]
        coefficients[-1] = single[-1]
        return coefficients


def _solve_direction(
    features: Floats, total: Floats, weight: Floats, unit: bool, isotropic: bool, start: Floats | None
) -> Floats:
    """Coefficients ``(p, 3)``: rows of ``features`` predict y, whose sum over the row's followers is ``total``."""
    regression = _Regression(features, weight, isotropic)
    coefficients = regression.solve(total) if start is None or not unit else start
    if not unit:
        return coefficients
    amount = max(float(weight.sum()), 1e-12)
    for _ in range(_FIXED_POINTS if start is None else _MORE_POINTS):
        direction = features @ coefficients
        length = np.sqrt(np.vecdot(direction, direction))
        size = np.sqrt(float((weight * length**2).sum()) / amount)
        if size < 1e-9:
            break
        updated = regression.solve(total * (length / size)[:, None])
        # Up to a factor, which the norm takes out: chance agreement shortens D a little in every round.
        factor = np.vdot(updated, coefficients) / max(float(np.vdot(coefficients, coefficients)), 1e-12)
        done = np.abs(updated - factor * coefficients).max() < 1e-3 * np.abs(updated).max()
        coefficients = updated
        if done:
            break
    direction = features @ coefficients
    size = np.sqrt(float((weight * np.vecdot(direction, direction)).sum()) / amount)
    return np.asarray(coefficients / max(size, 1e-9))


def concentration_of(resultant: Floats) -> Floats:
    """Kappa of the von Mises-Fisher law on the sphere from the mean resultant length (Banerjee et al., 2005)."""
    length = np.clip(resultant, 0.0, 0.9999)
    kappa: Floats = length * (3.0 - length**2) / (1.0 - length**2)
    return kappa
