"""Compiled loops. A series is ``(T, p, n)`` float32, the UAVs side by side; entry (i, j) of a pair: how i sees j.

The innermost loops run over UAVs. Where they do much, their number is rounded up, so that no UAV is left to slow code.
Loops fill arrays that NumPy has made, as code that makes arrays takes seconds to compile.
"""

from __future__ import annotations

import numpy as np

from usnet_env.arrays import Indices, Singles
from usnet_env.compiling import compiled

RADII = np.array([6.0, 12.0, 25.0, 50.0, 100.0], np.float32)  # steps of flight at the typical speed of the window
BANK = len(RADII)

_FAST = {"error_model": "numpy", "fastmath": {"contract"}, "_nrt": False}
_ZERO, _ONE, _TINY, _FAR = np.float32(0.0), np.float32(1.0), np.float32(1e-12), np.float32(1e6)
_OUTER, _STEEP = np.float32(1.1), np.float32(5.0)  # a neighbour's weight falls from 1 to 0 between .9 and 1.1 radii
_SLACK, _CLOSE, _SIMILAR = np.float32(3e-3), np.float32(1 / 0.03), np.float32(1 / 0.2)  # of squared differences
_REACH = np.float32(1.0 / 9.0)  # repulsion halves at 3 steps of flight
_LANES = 16  # numbers that a processor handles at once
_W, _HALF = 128, 64  # rows of sums are a constant apart, known not to overlap, so that loops become vector code
_ROWS = 7  # sums of a radius: weight, velocity, direction; one more radius holds the nearest distance and the repulsion


def multiply_series(x: Singles, y: Singles, lag: int = 0) -> Singles:
    """The sums over steps and axes of x(t + lag) y(t): (n,)."""
    total = np.zeros(x.shape[2], np.float32)
    _multiply_series(np.ascontiguousarray(x), np.ascontiguousarray(y), lag, total)
    return total


@compiled(**_FAST)
def _multiply_series(x, y, lag, total):
    for t in range(lag, len(x)):
        for a in range(x.shape[1]):
            for i in range(x.shape[2]):
                total[i] += x[t, a, i] * y[t - lag, a, i]


def compare_series(later: Singles, earlier: Singles, share: Singles, valid: Singles, lag: int) -> Singles:
    """The mean square (n,) of later(t + lag) - earlier(t) where ``share`` (T, n) > .1 and ``valid`` (T, n) is 1."""
    total, count, weight = np.zeros((3, later.shape[2]), np.float32)
    _compare_series(later, earlier, share, valid, lag, total, count, weight)
    return np.asarray(total / np.maximum(count, _ONE))


@compiled(**_FAST)
def _compare_series(later, earlier, share, valid, lag, total, count, weight):
    for t in range(len(later) - lag):
        for i in range(later.shape[2]):
            weight[i] = valid[t, i] if share[t + lag, i] > np.float32(0.1) else _ZERO
            count[i] += weight[i]
        for a in range(later.shape[1]):
            for i in range(later.shape[2]):
                difference = later[t + lag, a, i] - earlier[t, a, i]
                total[i] += weight[i] * difference * difference


def multiply_columns(x: Singles, y: Singles) -> Singles:
    """The sums over rows of x (S, k, n) times y (S, q, n): (k, q, n)."""
    out = np.zeros((x.shape[1], y.shape[1], x.shape[2]), np.float32)
    _multiply_columns(np.ascontiguousarray(x), np.ascontiguousarray(y), out)
    return out


@compiled(**_FAST)
def _multiply_columns(x, y, out):
    for s in range(len(x)):
        for a in range(x.shape[1]):
            for b in range(y.shape[1]):
                for i in range(x.shape[2]):
                    out[a, b, i] += x[s, a, i] * y[s, b, i]


def solve_ridges(gram: Singles, right: Singles, relative: float, absolute: float, whiten: bool = False) -> Singles:
    """Solve (gram + ridge) x = right (k, r, n) for each UAV; ``gram`` (k, k, n).

    If ``whiten``, stop halfway: rows with the covariance ``gram`` become orthonormal.
    """
    solution, trace = np.array(right, np.float32, order="C"), np.zeros(right.shape[2], np.float32)
    ridge = np.float32(relative), np.float32(absolute)
    _solve_ridges(np.array(gram, np.float32, order="C"), solution, *ridge, whiten, trace)
    return solution


@compiled(**_FAST)
def _solve_ridges(gram, right, relative, absolute, whiten, trace):
    k, r, n = right.shape
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
            for i in range(n):
                gram[a, b, i] = np.sqrt(max(gram[a, a, i], _TINY)) if a == b else gram[a, b, i] / gram[b, b, i]
    for q in range(r):
        for a in range(k):
            for c in range(a):
                for i in range(n):
                    right[a, q, i] -= gram[a, c, i] * right[c, q, i]
            for i in range(n):
                right[a, q, i] /= gram[a, a, i]
        for a in range(k - 1, -1 if not whiten else k - 1, -1):
            for c in range(a + 1, k):
                for i in range(n):
                    right[a, q, i] -= gram[c, a, i] * right[c, q, i]
            for i in range(n):
                right[a, q, i] /= gram[a, a, i]


def _pad(x: Singles) -> Singles:
    """A series with UAVs added, all zeros, up to a multiple of what a processor handles at once."""
    out = np.zeros((*x.shape[:-1], -(-x.shape[-1] // _LANES) * _LANES), np.float32)
    out[..., : x.shape[-1]] = x
    return out


def sum_neighbours(p: Singles, seen: Singles, v: Singles, m: Singles) -> Singles:
    """Weighted sums over the neighbours in each radius at the beginning of each step: (T, R + 1, 7, n)."""
    padded, sums = _pad(p), np.empty(((BANK + 1) * _ROWS, _HALF), np.float32)
    out = np.zeros((len(v), len(sums), padded.shape[2]), np.float32)
    _sum_neighbours(p, padded, seen, v, m, sums.reshape(-1), *np.empty((2, 4 * _HALF), np.float32), out)
    return np.ascontiguousarray(out.reshape(len(v), BANK + 1, _ROWS, -1)[..., : v.shape[2]])


@compiled(**_FAST)
def _sum_neighbours(p, padded, seen, v, m, sums, offset, centre, out):
    steps, _, n = v.shape
    last = BANK * _ROWS * _HALF
    for start in range(0, n, _HALF):
        width = min(_HALF, padded.shape[2] - start)
        for t in range(1, steps):
            for k in range(len(sums)):
                sums[k] = _FAR if last <= k < last + _HALF else _ZERO
            for a in range(3):
                for i in range(width):
                    centre[a * _HALF + i] = padded[t, a, start + i]
            for j in range(n):
                if seen[t, j] * m[t - 1, j] == _ZERO:
                    continue
                x, y, z, vx, vy, vz = p[t, 0, j], p[t, 1, j], p[t, 2, j], v[t - 1, 0, j], v[t - 1, 1, j], v[t - 1, 2, j]
                for i in range(width):
                    dx, dy, dz = x - centre[i], y - centre[_HALF + i], z - centre[2 * _HALF + i]
                    d = np.sqrt(dx * dx + dy * dy + dz * dz) + _TINY
                    inverse = _ONE / d
                    offset[i], offset[_HALF + i] = d, dx * inverse
                    offset[2 * _HALF + i], offset[3 * _HALF + i] = dy * inverse, dz * inverse
                if start <= j < start + width:
                    offset[j - start] = _FAR
                for i in range(width):
                    push = _ONE / (_ONE + offset[i] * offset[i] * _REACH)
                    sums[last + i] = min(sums[last + i], offset[i])
                    sums[last + _HALF + i] -= push * offset[_HALF + i]
                    sums[last + 2 * _HALF + i] -= push * offset[2 * _HALF + i]
                    sums[last + 3 * _HALF + i] -= push * offset[3 * _HALF + i]
                for r in range(BANK):
                    steep, outer, k = _STEEP / RADII[r], _OUTER * RADII[r], r * _ROWS * _HALF
                    for i in range(width):
                        w = min(_ONE, max(_ZERO, (outer - offset[i]) * steep))
                        sums[k + i] += w
                        sums[k + _HALF + i] += w * vx
                        sums[k + 2 * _HALF + i] += w * vy
                        sums[k + 3 * _HALF + i] += w * vz
                        sums[k + 4 * _HALF + i] += w * offset[_HALF + i]
                        sums[k + 5 * _HALF + i] += w * offset[2 * _HALF + i]
                        sums[k + 6 * _HALF + i] += w * offset[3 * _HALF + i]
            for row in range(out.shape[1]):
                for i in range(width):
                    out[t, row, start + i] = sums[row * _HALF + i]


def measure_bearings(p: Singles, v: Singles, a: Singles, moving: Singles, turns: Singles) -> tuple[Singles, Singles]:
    """Sum up over K instants where the others are, and whether i flies or accelerates there.

    ``p``, ``v`` and ``a`` are places, velocities and accelerations, ``(K, 3, n)``; ``moving`` and ``turns`` ``(K, n)``
    are 1 where v and a are known. Returns ``(24, n, n)``, a row for each ``total`` below, and ``(2, K, n)``: i's
    distance from the nearest UAV, and the cosine between i's velocity and the direction to it.
    """
    instants, _, n = p.shape
    p, v, moving, turns = _pad(p), _pad(v), _pad(moving), _pad(turns)
    sums, nearest = np.empty((19 + BANK, n, p.shape[2]), np.float32), np.full((2, instants, n), _FAR)
    total, instant = np.empty((19 + BANK) * _W, np.float32), np.empty(2 * _W, np.float32)
    _measure_bearings(p, v, a, moving, turns, total, instant, sums, nearest)
    return np.ascontiguousarray(sums[..., :n]), nearest


@compiled(**_FAST)
def _measure_bearings(p, v, a, moving, turns, total, instant, sums, nearest):
    instants, n = len(p), a.shape[2]
    for i in range(n):
        for start in range(0, n, _W):
            end = min(start + _W, p.shape[2])
            width = end - start
            for k in range(len(total)):
                total[k] = _FAR if 7 * _W <= k < 8 * _W else _ZERO
            for k in range(instants):
                if moving[k, i] == _ZERO:
                    continue
                turn, is_late = turns[k, i], _ONE if 2 * k >= instants else _ZERO
                x, y, z, vx, vy, vz = p[k, 0, i], p[k, 1, i], p[k, 2, i], v[k, 0, i], v[k, 1, i], v[k, 2, i]
                ax, ay, az = a[k, 0, i], a[k, 1, i], a[k, 2, i]
                power = ax * ax + ay * ay + az * az
                px, py, pz, shown = p[k, 0, start:end], p[k, 1, start:end], p[k, 2, start:end], moving[k, start:end]
                qx, qy, qz = v[k, 0, start:end], v[k, 1, start:end], v[k, 2, start:end]
                for j in range(width):
                    b = shown[j]
                    dx, dy, dz = (px[j] - x) * b, (py[j] - y) * b, (pz[j] - z) * b
                    ux, uy, uz = (qx[j] - vx) * b, (qy[j] - vy) * b, (qz[j] - vz) * b
                    square = dx * dx + dy * dy + dz * dz
                    d = np.sqrt(square) + _TINY
                    inverse, pull = _ONE / d, ax * dx + ay * dy + az * dz
                    c, along = (dx * vx + dy * vy + dz * vz) * inverse, pull * inverse
                    instant[j], instant[_W + j] = c, d + (_ONE - b) * _FAR
                    total[j] += c
                    total[_W + j] += abs(c)
                    total[2 * _W + j] += along
                    total[3 * _W + j] += d * b
                    total[4 * _W + j] += b
                    total[5 * _W + j] += is_late * d * b
                    total[6 * _W + j] += is_late * b
                    total[7 * _W + j] = min(total[7 * _W + j], instant[_W + j])
                    total[8 * _W + j] += abs(along)
                    total[9 * _W + j] += pull
                    total[10 * _W + j] += square * turn
                    total[11 * _W + j] += power * b
                    total[12 * _W + j] += turn * b
                    total[13 * _W + j] += dx * turn
                    total[14 * _W + j] += dy * turn
                    total[15 * _W + j] += dz * turn
                    total[16 * _W + j] += ax * ux + ay * uy + az * uz
                    total[17 * _W + j] += (ux * ux + uy * uy + uz * uz) * turn
                for r in range(BANK):
                    row, steep = (18 + r) * _W, np.float32(5.0) / RADII[r]
                    for j in range(width):
                        w = min(_ONE, max(_ZERO, np.float32(5.5) - steep * instant[_W + j]))
                        total[row + j] += w
                for j in range(width):
                    w = min(_ONE, max(_ZERO, np.float32(5.5) - _STEEP / RADII[BANK - 1] * instant[_W + j]))
                    total[(18 + BANK) * _W + j] += w * instant[j]
                for j in range(min(width, n - start)):
                    if instant[_W + j] < nearest[0, k, i] and j + start != i:
                        nearest[0, k, i], nearest[1, k, i] = instant[_W + j], instant[j]
            for row in range(len(sums)):
                for j in range(width):
                    sums[row, i, start + j] = total[row * _W + j]


def measure_places(p: Singles, seen: Singles, lags: Indices, stride: int, out: Singles) -> None:
    """How close i comes to where j was ``lags`` (L,) instants before, the first of them 0: into ``out`` (L + 3, n, n).

    ``p`` is ``(T + 1, 3, n)``, ``seen`` ``(T + 1, n)``; one of ``stride`` instants is looked at. Rows: mean distance
    for each lag; of the nearest of these places the mean distance, how often it is behind j, and its mean place in
    ``lags``, 0 to 1.
    """
    p, seen = _pad(p), _pad(seen)
    buffers = np.empty((3, p.shape[2]), np.float32), np.empty((2, len(lags) + 3, p.shape[2]), np.float32)
    _measure_places(p, seen, lags, stride, *buffers[0], *buffers[1], out)


@compiled(**_FAST)
def _measure_places(p, seen, lags, stride, nearest, best_lag, times, total, count, out):
    instants, width, last, n = len(p), p.shape[2], len(lags) - 1, out.shape[2]
    for i in range(n):
        for j in range(width):
            times[j] = _ZERO
            for k in range(len(total)):
                total[k, j] = count[k, j] = _ZERO
        for t in range(0, instants, stride):
            if seen[t, i] == _ZERO:
                continue
            x, y, z = p[t, 0, i], p[t, 1, i], p[t, 2, i]
            for j in range(width):
                nearest[j], best_lag[j] = _FAR, _ZERO
            for k in range(last + 1):
                if lags[k] > t:
                    break
                lag, sums, counts = np.float32(k) / np.float32(max(last, 1)), total[k], count[k]
                px, py, pz, shown = p[t - lags[k], 0], p[t - lags[k], 1], p[t - lags[k], 2], seen[t - lags[k]]
                for j in range(width):
                    dx, dy, dz, b = px[j] - x, py[j] - y, pz[j] - z, shown[j]
                    d = np.sqrt(dx * dx + dy * dy + dz * dz)
                    sums[j] += d * b
                    counts[j] += b
                    d += (_ONE - b) * _FAR
                    best_lag[j] = lag if d < nearest[j] else best_lag[j]
                    nearest[j] = min(d, nearest[j])
            for j in range(width if t >= lags[last] else 0):
                w = _ONE if nearest[j] < _FAR else _ZERO
                total[last + 1, j] += nearest[j] * w
                total[last + 2, j] += w if best_lag[j] > _ZERO else _ZERO
                total[last + 3, j] += best_lag[j] * w
                times[j] += w
        for k in range(last + 4):
            for j in range(n):
                out[k, i, j] = total[k, j] / max(count[k, j] if k <= last else times[j], _ONE)


def judge_blocks(square: Singles, overlap: Singles, product: Singles, persistence: Singles, out: Singles) -> None:
    """How i's motion in some of B blocks is j's: into ``out`` (6, n, n), or (4, n, n) where j's isn't delayed.

    Of each block and pair, ``(B, n, n)``: the sum of squared differences of velocity, the steps in which both are seen,
    the product of innovations; ``persistence`` ``(B, n)`` is the mean square of i's own change in a step. Rows: share
    of the blocks with small differences, by two measures; the greatest product, and the root of the sum of squares of
    all above 0; share of the blocks in which j predicts i better than i's own last step does, by two measures.
    """
    total = np.empty((7, square.shape[1]), np.float32)
    _judge_blocks(square, overlap, product, persistence, total[6], total, out)


@compiled(**_FAST)
def _judge_blocks(square, overlap, product, persistence, count, total, out):
    blocks, n, _ = square.shape
    for i in range(n):
        for j in range(n):
            for k in range(len(total)):
                total[k, j] = -_FAR if k == 2 else _ZERO
        for b in range(blocks):
            calm = _ONE / (persistence[b, i] + _SLACK)
            squares, steps, products = square[b, i], overlap[b, i], product[b, i]
            for j in range(n):
                valid = _ONE if steps[j] > np.float32(1.5) else _ZERO
                d = max(squares[j], _ZERO) / max(steps[j], _ONE) + _SLACK
                close, similar, positive = d * _CLOSE, d * _SIMILAR, max(products[j], _ZERO)
                count[j] += valid
                total[0, j] += valid / (_ONE + close * close)
                total[1, j] += valid / (_ONE + similar * similar)
                total[2, j] = max(total[2, j], products[j])
                total[3, j] += positive * positive
                d *= calm
                total[4, j] += valid / (_ONE + d * d * d)
                total[5, j] += valid * max(_ZERO, _ONE - d)
        for k in range(len(out)):
            for j in range(n):
                out[k, i, j] = (
                    np.sqrt(total[3, j]) if k == 3 else total[k, j] / (_ONE if k == 2 else max(count[j], _ONE))
                )


@compiled(**_FAST)
def sum_squares(x, out):
    """The sums of squares of x (a, n, b, n) over both axes: added to ``out`` (n, n)."""
    for a in range(x.shape[0]):
        for i in range(x.shape[1]):
            for b in range(x.shape[2]):
                for j in range(x.shape[3]):
                    out[i, j] += x[a, i, b, j] * x[a, i, b, j]
