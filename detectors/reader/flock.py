"""What the neighbours of a UAV do, in a bank of radii, and how well a flock's rule with them foretells its flight."""

from __future__ import annotations

import itertools

import numpy as np

from detectors.reader.kernels import (
    BANK,
    compare_series,
    multiply_columns,
    multiply_series,
    solve_ridges,
    sum_neighbours,
)
from detectors.reader.series import delay_series
from usnet_env.arrays import Singles

_RULES = np.array([(0, 1, 2 + a, 2 + BANK + b) for a, b in itertools.product(range(BANK), repeat=2)])


def survey_neighbours(p: Singles, seen: Singles, v: Singles, m: Singles) -> tuple[Singles, Singles, Singles]:
    """What surrounds each UAV at the beginning of each step; a neighbour's velocity is that of the step before.

    Takes places (T + 1, 3, n) and velocities (T, 3, n) in steps of flight, and what is seen of both. Returns
    (T, 3, 1 + 2 R, n): repulsion; mean velocity and mean direction of the neighbours within each radius. Their number
    (T, R, n). The distance of the nearest (T, n).
    """
    sums = sum_neighbours(p, seen, v, m)
    count, bank = sums[:, :BANK, 0], np.empty((len(v), 3, 1 + 2 * BANK, v.shape[2]), np.float32)
    bank[:, :, 0] = sums[:, BANK, 1:4]
    velocity_count, direction_count = np.maximum(count, np.float32(0.3)), np.maximum(count, np.float32(0.5))
    for axis in range(3):
        np.divide(sums[:, :BANK, 1 + axis], velocity_count, out=bank[:, axis, 1 : 1 + BANK])
        np.divide(sums[:, :BANK, 4 + axis], direction_count, out=bank[:, axis, 1 + BANK :])
    return bank, count, sums[:, BANK, 0]


def fit_flock(v: Singles, complete: Singles, bank: Singles) -> dict[str, Singles]:
    """Regress velocities on the own last one, repulsion, alignment and attraction; the window chooses the two radii.

    ``bank`` is that of :func:`survey_neighbours`. Returns the residuals (T, 3, n) and the coefficients (4, n) of the
    rule that fits the window best; the mean squared residuals (n,) of that rule, of the best one for the UAV itself,
    and of the own last velocity alone.
    """
    steps, _, n = v.shape
    mask = complete[:, None]
    z = np.concatenate([delay_series(v, 1)[:, :, None], bank], 2)
    z *= mask[:, None]
    y, flat = (v * mask).reshape(3 * steps, 1, n), z.reshape(3 * steps, -1, n)
    gram, right, power = multiply_columns(flat, flat), multiply_columns(flat, y), multiply_series(y, y)
    rows = np.maximum(complete.sum(0), 1)

    def fit(rules: Singles) -> tuple[Singles, Singles]:
        """Coefficients (k, rules, n) and mean squared residuals (rules, n)."""
        k = rules.shape[1]
        g, r = gram[rules.T[:, None], rules.T].reshape(k, k, -1), right[rules.T, 0].reshape(k, 1, -1)
        b = solve_ridges(g, r, 1e-3, 1e-3)
        squares = (b * ((b[None, :, 0] * g).sum(1, keepdims=True) - 2 * r)).sum((0, 1)).reshape(len(rules), n) + power
        return b.reshape(k, len(rules), n), np.maximum(squares, 0) / rows

    b, error = fit(_RULES)
    best = int(np.log(error + np.float32(1e-4)).sum(1).argmin())
    residual = v * mask
    for q, k in enumerate(_RULES[best]):
        residual -= b[q, best] * z[:, :, k]
    rule = {"residual": residual, "coefficients": b[:, best], "error": error[best], "least": error.min(0)}
    return rule | {"last": fit(np.array([[0]]))[1][0]}


def leave_crowd(v: Singles, m: Singles, mean: Singles, count: Singles) -> Singles:
    """How a UAV's steps deviate from the common direction of itself and its neighbours in the step before, (T, 3, n).

    ``mean`` (T, 3, n) and ``count`` (T, n) are those of :func:`survey_neighbours` for one radius.
    """
    is_seen = delay_series(m, 1)
    common = (mean * count[:, None] + delay_series(v, 1)) / np.maximum(count + is_seen, 1)[:, None]
    length = np.maximum(np.sqrt((common**2).sum(1, keepdims=True)), np.float32(0.05))
    out = (v - common / length) * m[:, None]
    out[0] = 0
    return out


def find_companions(p: Singles, seen: Singles, width: int) -> tuple[Singles, Singles, Singles]:
    """Displacements in ``width`` steps (S, 3, n), where both ends are seen (S, n), and the companions' weights (n, n).

    Companions of a UAV are those whose displacements are like its own, so that their mean has little noise. A row of
    weights adds up to 1. Takes places (T + 1, 3, n), and where they are seen.
    """
    is_seen, stride = seen[width:] * seen[:-width], max(width // 4, 1)
    displacement = (p[width:] - p[:-width]) * (is_seen / np.float32(width**0.5))[:, None]
    x, x_seen = displacement[::stride], is_seen[::stride]
    flat, overlap = x.reshape(-1, x.shape[2]), x_seen.T @ x_seen
    power = (x**2).sum(1).T @ x_seen
    np.fill_diagonal(overlap, 0)
    distance = np.maximum(power + power.T - 2 * (flat.T @ flat), 0) / np.maximum(overlap, 1) + np.float32(1e-4)
    distance[overlap == 0] = 1e9
    weight = (distance.min(1, keepdims=True) / distance) ** 2
    return displacement, is_seen, weight / weight.sum(1, keepdims=True)


def average_companions(d: Singles, is_seen: Singles, weight: Singles) -> tuple[Singles, Singles]:
    """The weighted mean of those displacements (S, 3, n) that are seen, and the weight that is: (S, 3, n), (S, n)."""
    share = is_seen @ weight.T
    return (d.reshape(-1, d.shape[2]) @ weight.T).reshape(d.shape) / np.maximum(share, 0.1)[:, None], share


def compare_companions(d: Singles, is_seen: Singles, weight: Singles, lags: tuple[int, ...]) -> list[Singles]:
    """How a UAV's displacements differ from the mean of its companions', some steps later: (n,) each.

    Followers have errors of their own, so the UAV that all copy has the least distance. Returns the logarithm of the
    mean square without a lag, and for each lag its standard score among the companions' own.
    """
    mean, share = average_companions(d, is_seen, weight)
    sizes = [np.log(compare_series(mean, d, share, is_seen, lag) + np.float32(1e-4)) for lag in lags]
    scores = [size - weight @ size for size in sizes]
    return [sizes[0], *(score / np.sqrt(weight @ score**2 + np.float32(0.02)) for score in scores)]


def compare_turns(v: Singles, m: Singles, mean: Singles, lags: tuple[int, ...]) -> tuple[list[Singles], Singles]:
    """Do the neighbours turn to where a UAV deviates, and does it turn back: 2 correlations a lag, and its power."""
    v, mean, mask = v[:-1], mean[1:], m[:-1, None]
    deviation, correlations = (v - mean) * mask, []
    for lag in lags:
        d, rows = deviation[:-lag], max(len(v) - lag, 0)
        own_turn = (v[:rows] - v[lag:]) * mask[lag:] * mask[:rows]
        for x in (mean[lag:] - mean[:rows], own_turn):
            size = np.sqrt(multiply_series(x, x) * multiply_series(d, d))
            correlations.append(multiply_series(x, d) / (size + np.float32(1e-3)))
    return correlations, multiply_series(deviation, deviation)
