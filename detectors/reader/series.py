"""Series of single tracks: ``(T, p, n)`` float32, the UAVs side by side; ``m`` ``(T, n)`` is 1 where a step is seen."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from detectors.reader.kernels import multiply_columns, multiply_series, solve_ridges
from usnet_env.arrays import Floats, Singles


def hold_positions(p: NDArray[Any], seen: Singles) -> NDArray[Any]:
    """``p`` (T + 1, 3, n) with the last seen place (before the first: the first) where a UAV isn't seen."""
    t = np.arange(len(seen))[:, None]
    last = np.maximum.accumulate(np.where(seen > 0, t, -1), 0)
    return np.take_along_axis(p, np.where(last < 0, seen.argmax(0), last)[:, None], 0)


def centre_series(x: Singles, m: Singles) -> Singles:
    """``x`` less its mean over the seen steps, 0 at the others."""
    mean = (x * m[:, None]).sum(0) / np.maximum(m.sum(0), 1)
    return (x - mean) * m[:, None]


def delay_series(x: Singles, lag: int) -> Singles:
    """``x`` some steps later, with zeros before."""
    out = np.zeros_like(x)
    out[lag:] = x[: max(len(x) - lag, 0)]
    return out


def scale_series(x: Singles, slack: float = 1e-5) -> Singles:
    """``x`` with each UAV's sum of squares 1; one far below ``slack`` squared stays near 0."""
    return np.asarray(x / (np.sqrt(multiply_series(x, x)) + np.float32(slack)))


def whiten_series(x: Singles) -> Singles:
    """``x`` in coordinates in which each UAV's p components are orthonormal over time."""
    out = solve_ridges(multiply_columns(x, x), x.transpose(1, 0, 2), 3e-3, 1e-6, whiten=True)
    return np.ascontiguousarray(out.transpose(1, 0, 2))


def find_innovations(c: Singles, complete: Singles) -> Singles:
    """What a UAV's two last velocities don't foretell of the next, at most twice the root mean square long.

    ``complete`` (T, n) is 1 where a step and the two before it are seen.
    """
    past, mask = np.concatenate([delay_series(c, 1), delay_series(c, 2)], 1), complete[:, None]
    b = solve_ridges(multiply_columns(past * mask, past), multiply_columns(past * mask, c), 1e-2, 1e-4)
    e = c.copy()
    for a in range(6):
        e -= past[:, a, None] * b[a]
    e *= mask
    square = (e**2).sum(1, keepdims=True)
    bound = 4 * square.sum(0) / np.maximum(complete.sum(0), 1)
    return e * np.sqrt(np.minimum(1, bound / np.maximum(square, np.float32(1e-18))))


def find_responses(v: Singles, complete: Singles) -> tuple[Singles, Singles]:
    """The course before each step, and how the step deviates from what a UAV by itself would do: (T, 3, n) each.

    By itself a UAV keeps its two last courses, circles about any axis and drifts. A course is the mean of two steps, so
    that the errors of a position don't look like an answer. ``complete`` is that of :func:`find_innovations`.
    """
    steps, _, n = v.shape
    mask = complete[:, None]
    course: Singles = np.float32(0.5) * (delay_series(v, 1) + delay_series(v, 2))
    predictors = np.zeros((steps, 3, 8, n), np.float32)
    predictors[:, :, 0], predictors[:, :, 1] = course, delay_series(course, 2)
    for axis in range(3):
        unit = np.zeros((1, 3, 1), np.float32)
        unit[:, axis] = 1
        predictors[:, :, 2 + axis], predictors[:, :, 5 + axis] = np.cross(unit, course, axis=1), unit
    predictors *= mask[:, None]
    response = (v - course) * mask
    flat, right = predictors.reshape(3 * steps, 8, n), response.reshape(3 * steps, 1, n)
    coefficients = solve_ridges(multiply_columns(flat, flat), multiply_columns(flat, right), 1e-3, 1e-3)
    for k in range(8):
        response -= predictors[:, :, k] * coefficients[k]
    return course, response


def find_turns(v: Singles, m: Singles, back: int) -> tuple[Singles, Singles]:
    """A UAV's turns in ``back`` steps, as vectors along their axes, and its changes of direction: (T, 3, n) each."""
    mean_velocity, enough = (delay_series(x, 1) for x in average_series(v, m, 2))
    direction = mean_velocity / np.maximum(np.sqrt((mean_velocity**2).sum(1, keepdims=True)), np.float32(1e-6))
    past_direction = delay_series(direction, back)
    known = enough * delay_series(enough, back)
    turn, change = np.cross(past_direction, direction, axis=1), direction - past_direction
    return centre_series(turn * known[:, None], known), centre_series(change * known[:, None], known)


def average_series(x: Singles, m: Singles, width: int) -> tuple[Singles, Singles]:
    """Mean over the seen ones of the steps t to t + width - 1, and whether at least two are: (T, 3, n), (T, n)."""
    total, count, enough = np.zeros_like(x), np.zeros_like(m), np.zeros_like(m)
    rows = max(len(x) - width + 1, 0)
    for k in range(width if rows else 0):
        total[:rows] += x[k : k + rows] * m[k : k + rows, None]
        count[:rows] += m[k : k + rows]
    enough[count >= 2] = 1
    total /= np.maximum(count, 1)[:, None]
    return total, enough


def change_series(x: Singles, m: Singles, lag: int) -> Singles:
    """x(t + lag) - x(t) where both are seen, else 0."""
    out, rows = np.zeros_like(x), max(len(x) - lag, 0)
    out[:rows] = (x[lag:] - x[:rows]) * (m[lag:] * m[:rows])[:, None]
    return out


def square_series(v: Singles) -> Singles:
    """The products of a velocity's components, (T, 6, n); their inner product doesn't depend on the axes."""
    return v[:, [0, 1, 2, 0, 1, 2]] * v[:, [0, 1, 2, 1, 2, 0]] * np.sqrt([[1], [1], [1], [2], [2], [2]]).astype("f4")


def regress_jointly(
    series: Floats, models: Sequence[tuple[int, int, tuple[float, ...]]]
) -> list[tuple[Floats, Floats]]:
    """Regress column i of the last of some ``series`` (R, S, n) on all columns of a first one and column i of a second.

    Columns have the length 1 in a ridge regression; a model is the first series, the second one, and ridges. Returns
    for each model and ridge, and for i and j, the t statistic of j's column, and its coefficient in the units of the
    data, (n, n) each. All i have one inverse, which the column of their own extends (Frisch and Waugh 1933).
    """
    (rows, _, n), scale, results = series.shape, np.sqrt((series**2).sum(0)) + 1e-9, []
    flat = (series / scale).reshape(rows, -1)
    products = (flat.T @ flat).reshape(*scale.shape, *scale.shape)
    for first, second, ridges in models:
        gram, across, target = (np.ascontiguousarray(products[first, :, k]) for k in (first, second, -1))
        fitted = products[second, :, -1].diagonal()
        freedom = max(rows - int((scale[first] > 1e-8).sum()) - 1, rows / 4)
        for ridge in ridges:
            half = np.tril(linalg.lapack.dpotri(linalg.lapack.dpotrf(gram + ridge * np.eye(n))[0])[0].T)
            inverse = half + np.tril(half, -1).T
            solved, solution = inverse @ across, inverse @ target
            pivot = np.maximum(1.0 + ridge - (across * solved).sum(0), 1e-9)
            second_b = (fitted - (across * solution).sum(0)) / pivot  # coefficients of the second series
            b = solution - solved * second_b
            # what is left of y'y = 1, by the normal equations of a ridge regression
            errors = 1.0 - (b * target).sum(0) - second_b * fitted - ridge * ((b**2).sum(0) + second_b**2)
            variance = np.maximum(errors, 0.0) / freedom + 1e-12
            spread = np.diag(inverse)[:, None] + solved**2 / pivot
            results.append(((b / np.sqrt(variance * spread)).T, (b * scale[-1] / scale[first][:, None]).T))
    return results
