"""What the neighbours of a UAV do, in a bank of radii, and how well a flock's rule with these radii foretells its flight."""

from __future__ import annotations

import numpy as np

from detectors.reader.series import multiply_series, solve_ridges
from usnet_env.compiling import compiled

RADII = np.array([6.0, 12.0, 25.0, 50.0, 100.0], np.float32)  # steps of flight at the typical speed of the window

_ZERO, _ONE, _TINY, _FAR = np.float32(0.0), np.float32(1.0), np.float32(1e-12), np.float32(1e6)
_OUTER, _STEEP = np.float32(1.1), np.float32(5.0)  # a neighbour's weight falls from 1 to 0 between .9 and 1.1 radii
_REACH = np.float32(1.0 / 9.0)  # repulsion halves at 3 steps of flight
_REGRESSORS = 12  # own last velocity, alignment and attraction in each radius, repulsion
_RELATIVE, _ABSOLUTE = np.float32(1e-3), np.float32(1e-3)


@compiled(error_model="numpy")
def survey_neighbours(p, seen, v, m, radii):
    """Sum up the neighbours of each UAV at the beginning of each step.

    Args:
        p: places ``(T + 1, 3, n)``, in steps of flight; ``seen``: ``(T + 1, n)``.
        v: velocities ``(T, 3, n)``; ``m``: ``(T, n)``. A neighbour's velocity at step t is that of step t - 1.
        radii: ``(R,)``.

    Returns:
        Mean velocity ``(R, T, 3, n)`` and mean direction ``(R, T, 3, n)`` of the neighbours within each radius, their
        number ``(R, T, n)``, repulsion ``(T, 3, n)`` and the distance of the nearest ``(T, n)``.
    """
    steps, _, n = v.shape
    align, attract = np.zeros((len(radii), steps, 3, n), np.float32), np.zeros((len(radii), steps, 3, n), np.float32)
    count, repel = np.zeros((len(radii), steps, n), np.float32), np.zeros((steps, 3, n), np.float32)
    nearest = np.full((steps, n), _FAR, np.float32)
    weight, ux, uy, uz = np.empty((4, n), np.float32)
    distance = np.empty(n, np.float32)
    for t in range(1, steps):
        x, y, z = p[t, 0], p[t, 1], p[t, 2]
        for j in range(n):
            if seen[t, j] * m[t - 1, j] == _ZERO:
                continue
            vx, vy, vz = v[t - 1, 0, j], v[t - 1, 1, j], v[t - 1, 2, j]
            for i in range(n):
                dx, dy, dz = x[j] - x[i], y[j] - y[i], z[j] - z[i]
                square = dx * dx + dy * dy + dz * dz
                d = np.sqrt(square) + _TINY
                itself = _FAR if i == j else _ZERO
                distance[i] = d + itself
                ux[i], uy[i], uz[i] = dx / d, dy / d, dz / d
                nearest[t, i] = min(nearest[t, i], distance[i])
                push = _ONE / (_ONE + square * _REACH)
                repel[t, 0, i] -= push * ux[i]
                repel[t, 1, i] -= push * uy[i]
                repel[t, 2, i] -= push * uz[i]
            for r in range(len(radii)):
                steep, outer = _STEEP / radii[r], _OUTER * radii[r]
                for i in range(n):
                    w = min(_ONE, max(_ZERO, (outer - distance[i]) * steep))
                    weight[i] = w
                    count[r, t, i] += w
                    align[r, t, 0, i] += w * vx
                    align[r, t, 1, i] += w * vy
                    align[r, t, 2, i] += w * vz
                    attract[r, t, 0, i] += w * ux[i]
                    attract[r, t, 1, i] += w * uy[i]
                    attract[r, t, 2, i] += w * uz[i]
        for r in range(len(radii)):
            for a in range(3):
                for i in range(n):
                    align[r, t, a, i] /= max(count[r, t, i], np.float32(0.3))
                    attract[r, t, a, i] /= max(count[r, t, i], np.float32(0.5))
    return align, attract, count, repel, nearest


@compiled(error_model="numpy")
def fit_flock(v, complete, align, attract, repel):
    """Regress each velocity on the own last one, alignment, attraction and repulsion; the window chooses the two radii.

    Returns:
        The residuals ``(T, 3, n)`` of the rule that fits the window best, its coefficients ``(4, n)``, the mean squared
        residuals of that rule, of the rule that fits the UAV itself best, and of the own last velocity alone
        ``(n,)``.
    """
    steps, _, n = v.shape
    bank = len(align)
    z = np.zeros((_REGRESSORS, steps, 3, n), np.float32)
    for t in range(2, steps):
        for a in range(3):
            for i in range(n):
                z[0, t, a, i] = v[t - 1, a, i] * complete[t, i]
                z[1, t, a, i] = repel[t, a, i] * complete[t, i]
            for r in range(bank):
                for i in range(n):
                    z[2 + r, t, a, i] = align[r, t, a, i] * complete[t, i]
                    z[2 + bank + r, t, a, i] = attract[r, t, a, i] * complete[t, i]
    gram, right = np.zeros((_REGRESSORS, _REGRESSORS, n), np.float32), np.zeros((_REGRESSORS, n), np.float32)
    power, rows = np.zeros(n, np.float32), np.zeros(n, np.float32)
    for t in range(2, steps):
        for i in range(n):
            rows[i] += complete[t, i]
        for a in range(3):
            for i in range(n):
                power[i] += v[t, a, i] * v[t, a, i] * complete[t, i]
            for k in range(_REGRESSORS):
                for q in range(k + 1):
                    for i in range(n):
                        gram[k, q, i] += z[k, t, a, i] * z[q, t, a, i]
                for i in range(n):
                    right[k, i] += z[k, t, a, i] * v[t, a, i]
    for k in range(_REGRESSORS):
        for q in range(k):
            gram[q, k] = gram[k, q]
    least, best_total = np.full(n, _FAR, np.float32), np.float32(1e30)
    error, best, picked = np.zeros(n, np.float32), np.zeros((4, n), np.float32), (0, 0)
    for near in range(bank):
        for far in range(bank):
            b, rest = _fit_rule(gram, right, power, rows, np.array([0, 1, 2 + near, 2 + bank + far]))
            total = np.float32(0.0)
            for i in range(n):
                least[i] = min(least[i], rest[i])
                if rows[i] > _ZERO:
                    total += np.log(rest[i] + np.float32(1e-4))
            if total < best_total:
                best_total, error, best, picked = total, rest, b, (near, far)
    _, persistence = _fit_rule(gram, right, power, rows, np.array([0]))
    residual = np.zeros_like(v)
    for t in range(2, steps):
        for a in range(3):
            for i in range(n):
                residual[t, a, i] = (
                    v[t, a, i] * complete[t, i]
                    - best[0, i] * z[0, t, a, i]
                    - best[1, i] * z[1, t, a, i]
                    - best[2, i] * z[2 + picked[0], t, a, i]
                    - best[3, i] * z[2 + bank + picked[1], t, a, i]
                )
    return residual, best, error, least, persistence


@compiled(error_model="numpy")
def _fit_rule(gram, right, power, rows, which):
    """Coefficients (k, n) and mean squared residuals (n,) of the regression on the regressors ``which`` (k,)."""
    k, n = len(which), gram.shape[2]
    part, b = np.empty((k, k, n), np.float32), np.empty((k, 1, n), np.float32)
    for x in range(k):
        b[x, 0] = right[which[x]]
        for y in range(k):
            part[x, y] = gram[which[x], which[y]]
    solve_ridges(part, b, _RELATIVE, _ABSOLUTE)
    rest = power.copy()
    for x in range(k):
        for i in range(n):
            rest[i] -= np.float32(2.0) * b[x, 0, i] * right[which[x], i]
        for y in range(k):
            for i in range(n):
                rest[i] += b[x, 0, i] * b[y, 0, i] * gram[which[x], which[y], i]
    for i in range(n):
        rest[i] = max(rest[i], _ZERO) / max(rows[i], _ONE)
    return b[:, 0].copy(), rest


@compiled(error_model="numpy")
def leave_crowd(v, m, mean, count):
    """How a UAV deviates from its neighbours: the steps it takes beside their common direction, (T, 3, n).

    ``mean`` (T, 3, n) and ``count`` (T, n) are those of :func:`survey_neighbours` for one radius.
    """
    steps, _, n = v.shape
    out = np.zeros_like(v)
    for t in range(1, steps):
        for i in range(n):
            k, own = count[t, i], m[t - 1, i]
            scale = _ONE / max(k + own, _ONE)
            x = (mean[t, 0, i] * k + v[t - 1, 0, i] * own) * scale
            y = (mean[t, 1, i] * k + v[t - 1, 1, i] * own) * scale
            z = (mean[t, 2, i] * k + v[t - 1, 2, i] * own) * scale
            length = max(np.sqrt(x * x + y * y + z * z), np.float32(0.05))
            out[t, 0, i] = (v[t, 0, i] - x / length) * m[t, i]
            out[t, 1, i] = (v[t, 1, i] - y / length) * m[t, i]
            out[t, 2, i] = (v[t, 2, i] - z / length) * m[t, i]
    return out


@compiled(error_model="numpy")
def compare_turns(v, m, mean, lags):
    """Do the neighbours turn to where a UAV deviates, and does it turn back: (2 lags, n) correlations, and (n,) power."""
    steps, _, n = v.shape
    out = np.zeros((2 * len(lags), n), np.float32)
    deviation = np.zeros_like(v)
    for t in range(1, steps):
        for a in range(3):
            for i in range(n):
                deviation[t, a, i] = (v[t - 1, a, i] - mean[t, a, i]) * m[t - 1, i]
    for k in range(len(lags)):
        sums = np.zeros((5, n), np.float32)
        for t in range(1, steps - lags[k]):
            later = t + lags[k]
            for a in range(3):
                for i in range(n):
                    turn = mean[later, a, i] - mean[t, a, i]
                    own = (v[later - 1, a, i] - v[t - 1, a, i]) * m[later - 1, i] * m[t - 1, i]
                    d = deviation[t, a, i]
                    sums[0, i] += turn * d
                    sums[1, i] += turn * turn
                    sums[2, i] -= own * d
                    sums[3, i] += own * own
                    sums[4, i] += d * d
        for i in range(n):
            out[2 * k, i] = sums[0, i] / (np.sqrt(sums[1, i] * sums[4, i]) + np.float32(1e-3))
            out[2 * k + 1, i] = sums[2, i] / (np.sqrt(sums[3, i] * sums[4, i]) + np.float32(1e-3))
    return out, multiply_series(deviation, deviation, 0)
