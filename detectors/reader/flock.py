"""What the neighbours of a UAV do, in a bank of radii, and how well a flock's rule with them foretells its flight."""

from __future__ import annotations

import itertools

import numpy as np

from detectors.reader.series import delay_series, multiply_columns, multiply_series, solve_ridges
from usnet_env.arrays import Singles
from usnet_env.compiling import compiled

RADII = np.array([6.0, 12.0, 25.0, 50.0, 100.0], np.float32)  # steps of flight at the typical speed of the window
BANK = len(RADII)
_RULES = np.array([(0, 1, 2 + a, 2 + BANK + b) for a, b in itertools.product(range(BANK), repeat=2)])

_ZERO, _ONE, _TINY, _FAR = np.float32(0.0), np.float32(1.0), np.float32(1e-12), np.float32(1e6)
_OUTER, _STEEP = np.float32(1.1), np.float32(5.0)  # a neighbour's weight falls from 1 to 0 between .9 and 1.1 radii
_REACH = np.float32(1.0 / 9.0)  # repulsion halves at 3 steps of flight
_W = 64  # UAVs side by side; rows a constant apart are known not to overlap, so that loops become vector code
_ROWS = 7  # sums of a radius: weight, velocity, direction; one more radius holds the nearest distance and the repulsion


@compiled(error_model="numpy")
def _sum_neighbours(p, seen, v, m):
    """Weighted sums over the neighbours in each radius at the beginning of each step: (T, R + 1, 7, n)."""
    steps, _, n = v.shape
    out = np.zeros((steps, (BANK + 1) * _ROWS, n), np.float32)
    sums, one, here = (
        np.empty((BANK + 1) * _ROWS * _W, np.float32),
        np.empty(4 * _W, np.float32),
        np.empty(3 * _W, np.float32),
    )
    last = BANK * _ROWS * _W
    for start in range(0, n, _W):
        width = min(_W, n - start)
        for t in range(1, steps):
            sums[:] = _ZERO
            sums[last : last + _W] = _FAR
            for a in range(3):
                here[a * _W : a * _W + width] = p[t, a, start : start + width]
            for j in range(n):
                if seen[t, j] * m[t - 1, j] == _ZERO:
                    continue
                x, y, z, vx, vy, vz = p[t, 0, j], p[t, 1, j], p[t, 2, j], v[t - 1, 0, j], v[t - 1, 1, j], v[t - 1, 2, j]
                for i in range(width):
                    dx, dy, dz = x - here[i], y - here[_W + i], z - here[2 * _W + i]
                    d = np.sqrt(dx * dx + dy * dy + dz * dz) + _TINY
                    one[i], one[_W + i], one[2 * _W + i], one[3 * _W + i] = d, dx / d, dy / d, dz / d
                if start <= j < start + width:
                    one[j - start] = _FAR
                for i in range(width):
                    push = _ONE / (_ONE + one[i] * one[i] * _REACH)
                    sums[last + i] = min(sums[last + i], one[i])
                    sums[last + _W + i] -= push * one[_W + i]
                    sums[last + 2 * _W + i] -= push * one[2 * _W + i]
                    sums[last + 3 * _W + i] -= push * one[3 * _W + i]
                for r in range(BANK):
                    steep, outer, k = _STEEP / RADII[r], _OUTER * RADII[r], r * _ROWS * _W
                    for i in range(width):
                        w = min(_ONE, max(_ZERO, (outer - one[i]) * steep))
                        sums[k + i] += w
                        sums[k + _W + i] += w * vx
                        sums[k + 2 * _W + i] += w * vy
                        sums[k + 3 * _W + i] += w * vz
                        sums[k + 4 * _W + i] += w * one[_W + i]
                        sums[k + 5 * _W + i] += w * one[2 * _W + i]
                        sums[k + 6 * _W + i] += w * one[3 * _W + i]
            out[t, :, start : start + width] = sums.reshape(-1, _W)[:, :width]
    return out.reshape(steps, BANK + 1, _ROWS, n)


def survey_neighbours(p: Singles, seen: Singles, v: Singles, m: Singles) -> tuple[Singles, Singles, Singles]:
    """What surrounds each UAV at the beginning of each step; a neighbour's velocity is that of the step before.

    Args:
        p: places ``(T + 1, 3, n)``, in steps of flight.
        seen: ``(T + 1, n)``.
        v: velocities ``(T, 3, n)``.
        m: ``(T, n)``.

    Returns:
        ``(T, 3, 1 + 2 R, n)``: repulsion; mean velocity and mean direction of the neighbours within each radius. Their
        number ``(T, R, n)``. The distance of the nearest ``(T, n)``.
    """
    sums = _sum_neighbours(p, seen, v, m)
    count, bank = sums[:, :BANK, 0], np.empty((len(v), 3, 1 + 2 * BANK, v.shape[2]), np.float32)
    bank[:, :, 0] = sums[:, BANK, 1:4]
    for axis in range(3):
        bank[:, axis, 1 : 1 + BANK] = sums[:, :BANK, 1 + axis] / np.maximum(count, np.float32(0.3))
        bank[:, axis, 1 + BANK :] = sums[:, :BANK, 4 + axis] / np.maximum(count, np.float32(0.5))
    return bank, count, sums[:, BANK, 0]


def fit_flock(v: Singles, complete: Singles, bank: Singles) -> tuple[Singles, Singles, Singles, Singles, Singles]:
    """Regress velocities on the own last one, repulsion, alignment and attraction; the window chooses the two radii.

    ``bank`` is that of :func:`survey_neighbours`. Returns the residuals (T, 3, n) and the coefficients (4, n) of the
    rule that fits the window best; the mean squared residuals (n,) of that rule, of the best one for the UAV itself,
    and of the own last velocity alone.
    """
    steps, _, n = v.shape
    mask = complete[:, None]
    z = np.concatenate([delay_series(v, 1)[:, :, None], bank], 2) * mask[:, None]
    y, flat = (v * mask).reshape(3 * steps, 1, n), z.reshape(3 * steps, -1, n)
    gram, right, power = multiply_columns(flat, flat), multiply_columns(flat, y), multiply_series(y, y)
    rows = np.maximum(complete.sum(0), 1)

    def fit(rules: Singles) -> tuple[Singles, Singles]:
        """Coefficients (k, rules, n) and mean squared residuals (rules, n)."""
        k = rules.shape[1]
        g, r = gram[rules.T[:, None], rules.T].reshape(k, k, -1), right[rules.T, 0].reshape(k, 1, -1)
        b = r.copy()
        solve_ridges(g.copy(), b, np.float32(1e-3), np.float32(1e-3))
        rest = (b * ((b[None, :, 0] * g).sum(1, keepdims=True) - 2 * r)).sum((0, 1)).reshape(len(rules), n) + power
        return b.reshape(k, len(rules), n), np.maximum(rest, 0) / rows

    b, error = fit(_RULES)
    best = int(np.log(error + np.float32(1e-4)).sum(1).argmin())
    residual = v * mask
    for q, k in enumerate(_RULES[best]):
        residual -= b[q, best] * z[:, :, k]
    return residual, b[:, best], error[best], error.min(0), fit(np.array([[0]]))[1][0]


def leave_crowd(v: Singles, m: Singles, mean: Singles, count: Singles) -> Singles:
    """How a UAV's steps deviate from the common direction of itself and its neighbours in the step before, (T, 3, n).

    ``mean`` (T, 3, n) and ``count`` (T, n) are those of :func:`survey_neighbours` for one radius.
    """
    own = delay_series(m, 1)
    common = (mean * count[:, None] + delay_series(v, 1)) / np.maximum(count + own, 1)[:, None]
    length = np.maximum(np.sqrt((common**2).sum(1, keepdims=True)), np.float32(0.05))
    out = (v - common / length) * m[:, None]
    out[0] = 0
    return out


def compare_turns(v: Singles, m: Singles, mean: Singles, lags: tuple[int, ...]) -> tuple[list[Singles], Singles]:
    """Do the neighbours turn to where a UAV deviates, and does it turn back: 2 correlations a lag, and its power."""
    v, mean, mask = v[:-1], mean[1:], m[:-1, None]
    deviation, found = (v - mean) * mask, []
    for lag in lags:
        d, rows = deviation[:-lag], max(len(v) - lag, 0)
        own = (v[:rows] - v[lag:]) * mask[lag:] * mask[:rows]
        for x in (mean[lag:] - mean[:rows], own):
            size = np.sqrt(multiply_series(x, x) * multiply_series(d, d))
            found.append(multiply_series(x, d) / (size + np.float32(1e-3)))
    return found, multiply_series(deviation, deviation)
