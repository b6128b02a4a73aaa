"""Compiled loops over pairs of UAVs. Answers are ``(features, n, n)``: entry (i, j) says how i relates to j."""

from __future__ import annotations

import numpy as np

from detectors.reader.flock import BANK, RADII
from usnet_env.compiling import compiled

_ZERO, _ONE, _TINY, _FAR = np.float32(0.0), np.float32(1.0), np.float32(1e-12), np.float32(1e6)
_TIGHT, _LOOSE, _FLOOR, _ENOUGH = np.float32(0.03), np.float32(0.2), np.float32(3e-3), np.float32(1.5)
_W = 128  # rows of sums are a constant apart, so that the loops become vector code


@compiled(error_model="numpy")
def measure_bearings(p, v, a, moving, turns):
    """Sum up over instants where the others are, and whether i flies or accelerates there.

    Args:
        p: places ``(K, 3, n)``.
        v: velocities ``(K, 3, n)``.
        a: accelerations ``(K, 3, n)``, 0 where unknown.
        moving: ``(K, n)``, 1 where v is known.
        turns: ``(K, n)``, 1 where a is known.

    Returns:
        ``(24, n, n)`` sums, one row for each ``total`` below; ``(2, K, n)``: distance of i's nearest UAV, and the cosine
        between i's velocity and the direction to it.
    """
    instants, _, n = p.shape
    sums, nearest = np.empty((19 + BANK, n, n), np.float32), np.full((2, instants, n), _FAR)
    total, now = np.empty((19 + BANK) * _W, np.float32), np.empty(2 * _W, np.float32)
    for i in range(n):
        for start in range(0, n, _W):
            end, width = min(start + _W, n), min(_W, n - start)
            total[:] = _ZERO
            total[7 * _W : 8 * _W] = _FAR
            for k in range(instants):
                if moving[k, i] == _ZERO:
                    continue
                turn, late = turns[k, i], _ONE if 2 * k >= instants else _ZERO
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
                    c, pull = (dx * vx + dy * vy + dz * vz) / d, ax * dx + ay * dy + az * dz
                    now[j], now[_W + j] = c, d + (_ONE - b) * _FAR
                    total[j] += c
                    total[_W + j] += abs(c)
                    total[2 * _W + j] += pull / d
                    total[3 * _W + j] += d * b
                    total[4 * _W + j] += b
                    total[5 * _W + j] += late * d * b
                    total[6 * _W + j] += late * b
                    total[7 * _W + j] = min(total[7 * _W + j], now[_W + j])
                    total[8 * _W + j] += abs(pull / d)
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
                        w = min(_ONE, max(_ZERO, np.float32(5.5) - steep * now[_W + j]))
                        total[row + j] += w
                        total[(18 + BANK) * _W + j] += w * now[j] if r == BANK - 1 else _ZERO
                for j in range(width):
                    if now[_W + j] < nearest[0, k, i] and j + start != i:
                        nearest[0, k, i], nearest[1, k, i] = now[_W + j], now[j]
            sums[:, i, start:end] = total.reshape(-1, _W)[:, :width]
    return sums, nearest


@compiled(error_model="numpy")
def measure_places(p, seen, lags, stride, out):
    """How close UAV i comes to where j was.

    Args:
        p: places ``(T + 1, 3, n)``.
        seen: ``(T + 1, n)``.
        lags: ``(L,)``, the first is 0.
        stride: one of so many instants is looked at.
        out: gets ``(L + 3, n, n)``: mean distance from i to where j was each lag before; mean distance of the nearest
            such place; share of the instants at which it is behind j; mean place of its lag in ``lags``, 0 to 1.
    """
    instants, _, n = p.shape
    last = len(lags) - 1
    for i in range(n):
        total, count = np.zeros((last + 4, n), np.float32), np.zeros((last + 1, n), np.float32)
        nearest, best, times = np.empty(n, np.float32), np.empty(n, np.float32), np.zeros(n, np.float32)
        for t in range(0, instants, stride):
            if seen[t, i] == _ZERO:
                continue
            x, y, z = p[t, 0, i], p[t, 1, i], p[t, 2, i]
            nearest[:] = _FAR
            best[:] = _ZERO
            for k in range(last + 1):
                if lags[k] > t:
                    break
                lag, sums, counts = np.float32(k) / np.float32(max(last, 1)), total[k], count[k]
                px, py, pz, shown = p[t - lags[k], 0], p[t - lags[k], 1], p[t - lags[k], 2], seen[t - lags[k]]
                for j in range(n):
                    dx, dy, dz, b = px[j] - x, py[j] - y, pz[j] - z, shown[j]
                    d = np.sqrt(dx * dx + dy * dy + dz * dz)
                    sums[j] += d * b
                    counts[j] += b
                    d += (_ONE - b) * _FAR
                    best[j] = lag if d < nearest[j] else best[j]
                    nearest[j] = min(d, nearest[j])
            if t >= lags[last]:
                for j in range(n):
                    w = _ONE if nearest[j] < _FAR else _ZERO
                    total[last + 1, j] += nearest[j] * w
                    total[last + 2, j] += w if best[j] > _ZERO else _ZERO
                    total[last + 3, j] += best[j] * w
                    times[j] += w
        for k in range(last + 4):
            out[k, i] = total[k] / np.maximum(count[k] if k <= last else times, _ONE)


@compiled(error_model="numpy")
def judge_blocks(square, overlap, product, persistence, out):
    """How well i's velocity is j's of some steps before, block by block.

    Args:
        square: sums of squared differences, ``(blocks, n, n)``.
        overlap: number of steps, ``(blocks, n, n)``.
        product: products of innovations, ``(blocks, n, n)``.
        persistence: ``(blocks, n)``, i's mean squared change of velocity in a step.
        out: gets ``(6, n, n)``: share of the blocks with a small difference, with a fair one, greatest product, root of
            the squares of positive ones, share with a difference below i's own change, and how far below.
    """
    blocks, n, _ = square.shape
    total = np.empty(8 * _W, np.float32)
    for i in range(n):
        for start in range(0, n, _W):
            end, width = min(start + _W, n), min(_W, n - start)
            total[:] = _ZERO
            total[2 * _W : 3 * _W] = -_ONE
            for b in range(blocks):
                change = _ONE / (persistence[b, i] + _FLOOR)
                squares, steps, products = square[b, i, start:end], overlap[b, i, start:end], product[b, i, start:end]
                for j in range(width):
                    valid = _ONE if steps[j] > _ENOUGH else _ZERO
                    d = max(squares[j], _ZERO) / max(steps[j], _ONE) + _FLOOR
                    ratio, positive, tight, loose = d * change, max(products[j], _ZERO), d / _TIGHT, d / _LOOSE
                    total[j] += valid / (_ONE + tight * tight)
                    total[_W + j] += valid / (_ONE + loose * loose)
                    total[2 * _W + j] = max(total[2 * _W + j], products[j])
                    total[3 * _W + j] += positive * positive
                    total[4 * _W + j] += valid / (_ONE + ratio * ratio * ratio)
                    total[5 * _W + j] += valid * max(_ZERO, _ONE - ratio)
                    total[6 * _W + j] += valid
            for j in range(width):
                for f in (0, 1, 4, 5):
                    out[f, i, start + j] = total[f * _W + j] / max(total[6 * _W + j], _ONE)
                out[2, i, start + j], out[3, i, start + j] = total[2 * _W + j], np.sqrt(total[3 * _W + j])
