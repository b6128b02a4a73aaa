"""Compiled loops over pairs of UAVs. Answers are ``(features, n, n)``: entry (i, j) says how i relates to j."""

from __future__ import annotations

import numpy as np

from detectors.reader.flock import BANK, RADII
from usnet_env.compiling import compiled

STRIDE = 2  # bearings are taken every second instant

_ZERO, _ONE, _TINY, _FAR = np.float32(0.0), np.float32(1.0), np.float32(1e-12), np.float32(1e6)
_HALF, _SMALL, _ENOUGH = np.float32(0.5), np.float32(1e-3), np.float32(1.5)
_UNIT, _LEAST = np.float32(20.0), np.float32(0.05)  # distances are told as log(distance / 20 steps of flight + .05)
_TIGHT, _LOOSE, _FLOOR = np.float32(0.03), np.float32(0.2), np.float32(3e-3)
_W = 128  # rows of sums are a constant apart, so that the loops become vector code
_CROWD, _BEARINGS = 18 * _W, 19


@compiled(error_model="numpy")
def measure_bearings(p, mean, moving, out, own):
    """Where the others are, and whether i flies or accelerates there.

    Args:
        p: places ``(K, 3, n)`` at every second instant.
        mean: mean velocity of the steps that follow ``(K, 3, n)``.
        moving: ``(K, n)``, 1 where any of them is seen.
        out: gets ``(11 + R, n, n)``: cosine between i's velocity and the direction to j, its size, acceleration to j,
            mean and least log distance, change of the distance, share of the instants within each radius; correlation
            of i's acceleration with the direction to j, its size, with the gap, with the gap less its mean, and with
            the difference of the velocities.
        own: gets ``(4, n)``: cosine to the nearest UAV, its size, log distance of the nearest, cosine to all in reach.
    """
    instants, _, n = p.shape
    total, now = np.empty((_BEARINGS + BANK) * _W, np.float32), np.empty(2 * _W, np.float32)
    for i in range(n):
        pushed, met, reached, ahead = np.zeros(5, np.float32), _ZERO, _ZERO, _ZERO
        closest, facing = np.full(instants, _FAR), np.zeros(instants, np.float32)
        for start in range(0, n, _W):
            end, width = min(start + _W, n), min(_W, n - start)
            total[:] = _ZERO
            total[7 * _W : 8 * _W] = _FAR
            pushed[:] = _ZERO
            for k in range(instants):
                if moving[k, i] == _ZERO:
                    continue
                after = min(k + 1, instants - 1)
                turns, late = moving[after, i] if after > k else _ZERO, _ONE if 2 * k >= instants else _ZERO
                x, y, z, vx, vy, vz = p[k, 0, i], p[k, 1, i], p[k, 2, i], mean[k, 0, i], mean[k, 1, i], mean[k, 2, i]
                ax, ay, az = turns * (mean[after, 0, i] - vx), turns * (mean[after, 1, i] - vy), mean[after, 2, i] - vz
                az *= turns
                power = ax * ax + ay * ay + az * az
                pushed[0] += ax
                pushed[1] += ay
                pushed[2] += az
                px, py, pz, shown = p[k, 0, start:end], p[k, 1, start:end], p[k, 2, start:end], moving[k, start:end]
                qx, qy, qz = mean[k, 0, start:end], mean[k, 1, start:end], mean[k, 2, start:end]
                for j in range(width):
                    b = shown[j]
                    dx, dy, dz = (px[j] - x) * b, (py[j] - y) * b, (pz[j] - z) * b
                    ux, uy, uz = (qx[j] - vx) * b, (qy[j] - vy) * b, (qz[j] - vz) * b
                    square = dx * dx + dy * dy + dz * dz
                    d = np.sqrt(square) + _TINY
                    c, pull = (dx * vx + dy * vy + dz * vz) / d, ax * dx + ay * dy + az * dz
                    far = d + (_ONE - b) * _FAR
                    now[j], now[_W + j] = c, far
                    total[j] += c
                    total[_W + j] += abs(c)
                    total[2 * _W + j] += pull / d
                    total[3 * _W + j] += d * b
                    total[4 * _W + j] += b
                    total[5 * _W + j] += late * d * b
                    total[6 * _W + j] += late * b
                    total[7 * _W + j] = min(total[7 * _W + j], far)
                    total[8 * _W + j] += abs(pull / d)
                    total[9 * _W + j] += pull
                    total[10 * _W + j] += square * turns
                    total[11 * _W + j] += power * b
                    total[12 * _W + j] += turns * b
                    total[13 * _W + j] += dx * turns
                    total[14 * _W + j] += dy * turns
                    total[15 * _W + j] += dz * turns
                    total[16 * _W + j] += ax * ux + ay * uy + az * uz
                    total[17 * _W + j] += (ux * ux + uy * uy + uz * uz) * turns
                for r in range(BANK):
                    row, near = (_BEARINGS + r) * _W, np.float32(5.0) / RADII[r]
                    for j in range(width):
                        w = min(_ONE, max(_ZERO, np.float32(5.5) - near * now[_W + j]))
                        total[row + j] += w
                        total[_CROWD + j] += w * now[j] if r == BANK - 1 else _ZERO
                for j in range(width):
                    if now[_W + j] < closest[k] and j + start != i:
                        closest[k], facing[k] = now[_W + j], now[j]
            for j in range(width):
                count, turned = max(total[4 * _W + j], _ONE), max(total[12 * _W + j], _ONE)
                gx, gy, gz, gaps = total[13 * _W + j], total[14 * _W + j], total[15 * _W + j], total[10 * _W + j]
                late, b = total[6 * _W + j], start + j
                early = (total[3 * _W + j] - total[5 * _W + j]) / max(total[4 * _W + j] - late, _ONE)
                both = _ONE if late > _ZERO and total[4 * _W + j] > late else _ZERO
                size = np.sqrt(total[11 * _W + j])
                moved = max(gaps - (gx * gx + gy * gy + gz * gz) / turned, _ZERO) + _SMALL * gaps
                pull = total[9 * _W + j] - (gx * pushed[0] + gy * pushed[1] + gz * pushed[2]) / turned
                for f in range(3):
                    out[f, i, b] = total[f * _W + j] / count
                out[3, i, b] = np.log(total[3 * _W + j] / count / _UNIT + _LEAST)
                out[4, i, b] = min(np.log(total[7 * _W + j] / _UNIT + _LEAST), np.float32(4.0))
                change = (total[5 * _W + j] / max(late, _ONE) / _UNIT + _LEAST) / (early / _UNIT + _LEAST)
                out[5, i, b] = both * np.log(change)
                for r in range(BANK):
                    out[6 + r, i, b] = total[(_BEARINGS + r) * _W + j] / count
                out[6 + BANK, i, b] = total[2 * _W + j] / (size * np.sqrt(turned) + _SMALL)
                out[7 + BANK, i, b] = total[8 * _W + j] / (size * np.sqrt(turned) + _SMALL)
                out[8 + BANK, i, b] = total[9 * _W + j] / (size * np.sqrt(gaps) + _SMALL)
                out[9 + BANK, i, b] = pull / (size * np.sqrt(moved) + _SMALL)
                out[10 + BANK, i, b] = total[16 * _W + j] / (size * np.sqrt(total[17 * _W + j]) + _SMALL)
                if b != i:
                    reached += total[(_BEARINGS + BANK - 1) * _W + j]
                    ahead += total[_CROWD + j]
        for k in range(instants):
            if closest[k] < _FAR:
                own[0, i] += facing[k]
                own[1, i] += abs(facing[k])
                own[2, i] += np.log(closest[k] / _UNIT + _LEAST)
                met += _ONE
        for f in range(3):
            own[f, i] /= max(met, _ONE)
        own[3, i] = ahead / max(reached, _HALF)


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
