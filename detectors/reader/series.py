"""Compiled loops over single tracks. A series is ``(T, p, n)`` float32, so that the loops run over UAVs side by side."""

from __future__ import annotations

import numpy as np

from usnet_env.compiling import compiled

_ZERO, _ONE, _TINY, _SLACK = np.float32(0.0), np.float32(1.0), np.float32(1e-12), np.float32(1e-5)
_BOUND = np.float32(2.0)  # an innovation is at most this many root mean squares long


@compiled(error_model="numpy")
def hold_positions(p, seen):
    """Put the last seen place (before the first: the first) where a UAV isn't seen; ``p`` (T + 1, 3, n) in place."""
    for i in range(p.shape[2]):
        first = 0
        while first < len(seen) and seen[first, i] == _ZERO:
            first += 1
        for t in range(len(seen)):
            if seen[t, i] == _ZERO:
                source = first if t < first else t - 1
                for axis in range(3):
                    p[t, axis, i] = p[source, axis, i] if source < len(seen) else _ZERO


@compiled(error_model="numpy")
def centre_series(x, m):
    """Subtract the mean over the steps with ``m`` (T, n) = 1, and set the others to 0; in place."""
    n = x.shape[2]
    for a in range(x.shape[1]):
        mean, count = np.zeros(n, np.float32), np.zeros(n, np.float32)
        for t in range(len(x)):
            for i in range(n):
                mean[i] += x[t, a, i] * m[t, i]
                count[i] += m[t, i]
        for i in range(n):
            mean[i] /= max(count[i], _ONE)
        for t in range(len(x)):
            for i in range(n):
                x[t, a, i] = (x[t, a, i] - mean[i]) * m[t, i]


@compiled(error_model="numpy")
def multiply_series(x, y, lag):
    """The sums over steps and axes of x(t + lag) y(t): (n,)."""
    n = x.shape[2]
    total = np.zeros(n, np.float32)
    for t in range(lag, len(x)):
        for a in range(x.shape[1]):
            for i in range(n):
                total[i] += x[t, a, i] * y[t - lag, a, i]
    return total


@compiled(error_model="numpy")
def scale_series(x, slack):
    """Return ``x`` with each UAV's sum of squares 1; a sum below ``slack`` squared stays near 0."""
    scale = np.sqrt(multiply_series(x, x, 0)) + slack
    out = np.empty_like(x)
    for t in range(len(x)):
        for a in range(x.shape[1]):
            for i in range(x.shape[2]):
                out[t, a, i] = x[t, a, i] / scale[i]
    return out


@compiled(error_model="numpy")
def factor_ridges(gram, relative, absolute):
    """Cholesky factors of ``gram`` (k, k, n) plus a ridge, in place (lower triangles)."""
    k, _, n = gram.shape
    trace = np.zeros(n, np.float32)
    for a in range(k):
        for i in range(n):
            trace[i] += gram[a, a, i]
    for a in range(k):
        for i in range(n):
            gram[a, a, i] += relative * trace[i] / np.float32(k) + absolute
        for b in range(a + 1):
            for c in range(b):
                for i in range(n):
                    gram[a, b, i] -= gram[a, c, i] * gram[b, c, i]
            if a == b:
                for i in range(n):
                    gram[a, a, i] = np.sqrt(max(gram[a, a, i], _TINY))
            else:
                for i in range(n):
                    gram[a, b, i] /= gram[b, b, i]


@compiled(error_model="numpy")
def solve_ridges(gram, right, relative, absolute):
    """Solve (gram + ridge) x = right for each UAV: ``gram`` (k, k, n) and ``right`` (k, r, n) are overwritten."""
    k, r, n = right.shape
    factor_ridges(gram, relative, absolute)
    for q in range(r):
        for a in range(k):
            for c in range(a):
                for i in range(n):
                    right[a, q, i] -= gram[a, c, i] * right[c, q, i]
            for i in range(n):
                right[a, q, i] /= gram[a, a, i]
        for a in range(k - 1, -1, -1):
            for c in range(a + 1, k):
                for i in range(n):
                    right[a, q, i] -= gram[c, a, i] * right[c, q, i]
            for i in range(n):
                right[a, q, i] /= gram[a, a, i]


@compiled(error_model="numpy")
def whiten_series(x, relative, absolute):
    """Return ``x`` (T, p, n) in coordinates in which each UAV's p components are orthonormal over time."""
    steps, p, n = x.shape
    gram = np.zeros((p, p, n), np.float32)
    for t in range(steps):
        for a in range(p):
            for b in range(a + 1):
                for i in range(n):
                    gram[a, b, i] += x[t, a, i] * x[t, b, i]
    factor_ridges(gram, relative, absolute)
    out = np.empty_like(x)
    for t in range(steps):
        for a in range(p):
            for i in range(n):
                out[t, a, i] = x[t, a, i]
            for c in range(a):
                for i in range(n):
                    out[t, a, i] -= gram[a, c, i] * out[t, c, i]
            for i in range(n):
                out[t, a, i] /= gram[a, a, i]
    return out


@compiled(error_model="numpy")
def find_innovations(c, complete):
    """What a UAV's two last velocities don't foretell of the next, bounded: ``c`` and answer (T, 3, n).

    ``complete`` (T, n) is 1 where a step and the two before it are seen.
    """
    steps, _, n = c.shape
    gram, right = np.zeros((6, 6, n), np.float32), np.zeros((6, 3, n), np.float32)
    for t in range(2, steps):
        for a in range(6):
            x = c[t - 1 - a // 3, a % 3]
            for b in range(a + 1):
                y = c[t - 1 - b // 3, b % 3]
                for i in range(n):
                    gram[a, b, i] += x[i] * y[i] * complete[t, i]
            for b in range(3):
                for i in range(n):
                    right[a, b, i] += x[i] * c[t, b, i] * complete[t, i]
    solve_ridges(gram, right, np.float32(1e-2), np.float32(1e-4))
    e = np.zeros_like(c)
    for t in range(2, steps):
        for b in range(3):
            for i in range(n):
                e[t, b, i] = c[t, b, i]
            for a in range(6):
                for i in range(n):
                    e[t, b, i] -= right[a, b, i] * c[t - 1 - a // 3, a % 3, i]
            for i in range(n):
                e[t, b, i] *= complete[t, i]
    bound, count = multiply_series(e, e, 0), np.zeros(n, np.float32)
    for t in range(steps):
        for i in range(n):
            count[i] += complete[t, i]
    for i in range(n):
        bound[i] = _BOUND * np.sqrt(bound[i] / max(count[i], _ONE))
    for t in range(steps):
        for i in range(n):
            length = np.sqrt(e[t, 0, i] ** 2 + e[t, 1, i] ** 2 + e[t, 2, i] ** 2)
            ratio = min(_ONE, bound[i] / max(length, _TINY))
            for b in range(3):
                e[t, b, i] *= ratio
    return e


@compiled(error_model="numpy")
def average_series(x, m, width):
    """Mean over the steps t to t + width - 1 that are seen, and whether at least two are: (T, 3, n), (T, n)."""
    steps, p, n = x.shape
    mean, enough = np.zeros_like(x), np.zeros_like(m)
    for t in range(steps - width + 1):
        count = np.zeros(n, np.float32)
        for k in range(t, t + width):
            for i in range(n):
                count[i] += m[k, i]
            for a in range(p):
                for i in range(n):
                    mean[t, a, i] += x[k, a, i] * m[k, i]
        for i in range(n):
            enough[t, i] = _ONE if count[i] > _ONE else _ZERO
        for a in range(p):
            for i in range(n):
                mean[t, a, i] /= max(count[i], _ONE)
    return mean, enough


@compiled(error_model="numpy")
def change_series(x, m, lag):
    """x(t + lag) - x(t) where both are seen, else 0: (T, 3, n)."""
    out = np.zeros_like(x)
    for t in range(len(x) - lag):
        for a in range(x.shape[1]):
            for i in range(x.shape[2]):
                out[t, a, i] = (x[t + lag, a, i] - x[t, a, i]) * m[t, i] * m[t + lag, i]
    return out


@compiled(error_model="numpy")
def square_series(v):
    """The products of a velocity's components, (T, 6, n), in a basis whose inner product doesn't depend on the axes."""
    root = np.float32(np.sqrt(2.0))
    out = np.empty((len(v), 6, v.shape[2]), np.float32)
    for t in range(len(v)):
        for a in range(3):
            for i in range(v.shape[2]):
                out[t, a, i] = v[t, a, i] * v[t, a, i]
                out[t, 3 + a, i] = root * v[t, a, i] * v[t, (a + 1) % 3, i]
    return out


@compiled(error_model="numpy")
def remove_past(c, complete):
    """Split a track by its own past: (rest, first, second), unit series (T, 3, n) that are orthogonal to each other.

    ``first`` and ``second`` span the last two velocities; ``rest`` is what they leave of the velocity.
    """
    steps, _, n = c.shape
    past = np.zeros((3, steps, 3, n), np.float32)
    for k in range(3):
        for t in range(2, steps):
            for a in range(3):
                for i in range(n):
                    past[k, t, a, i] = c[t - k, a, i] * complete[t, i]
    first = scale_series(past[1], _SLACK)
    second = past[2]
    subtract_share(second, first)
    second = scale_series(second, np.float32(1e-3))
    rest = past[0]
    subtract_share(rest, first)
    subtract_share(rest, second)
    return scale_series(rest, np.float32(1e-3)), first, second


@compiled(error_model="numpy")
def subtract_share(x, unit):
    """Make ``x`` (T, 3, n) orthogonal to ``unit`` for each UAV, in place."""
    share = multiply_series(x, unit, 0)
    for t in range(len(x)):
        for a in range(x.shape[1]):
            for i in range(x.shape[2]):
                x[t, a, i] -= share[i] * unit[t, a, i]
