"""Compiled loops over pairs of UAVs. Answers are ``(features, n, n)``: entry (i, j) says how i relates to j."""

from __future__ import annotations

import numpy as np

from usnet_env.compiling import compiled

STRIDE = 4  # geometry looks at every fourth instant
BLOCK = 8  # steps of a block in which one leader is supposed

_ZERO, _ONE, _TINY, _FAR = np.float32(0.0), np.float32(1.0), np.float32(1e-12), np.float32(1e6)
_HALF, _THIRD, _SMALL = np.float32(0.5), np.float32(0.3), np.float32(1e-3)
_UNIT, _LEAST = np.float32(20.0), np.float32(0.05)  # distances are told as log(distance / 20 steps of flight + .05)


@compiled(error_model="numpy")
def measure_geometry(p, mean, moving, radii, out, own):
    """Bearings and distances at every fourth instant.

    Args:
        p: places ``(K, 3, n)``; mean: mean velocity of the steps that follow ``(K, 3, n)``; moving: ``(K, n)``, whether
            any of them is seen.
        radii: ``(R,)``.
        out: gets ``(6 + R, n, n)``: cosine between i's velocity and the direction to j, its size, turns towards j, mean
            and least log distance, change of the distance, share of the instants within each radius.
        own: gets ``(4, n)``: cosine to the nearest UAV, its size, log distance of the nearest, cosine to all in reach.
    """
    instants, _, n = p.shape
    half, bank = instants // 2, len(radii)
    cosine, distance, reach = np.empty(n, np.float32), np.empty(n, np.float32), np.empty(n, np.float32)
    for i in range(n):
        total = np.zeros((8 + bank, n), np.float32)
        least = np.full(n, _FAR, np.float32)
        ahead, near_sum, seen_sum = np.zeros(n, np.float32), np.zeros(n, np.float32), _ZERO
        for k in range(instants):
            if moving[k, i] == _ZERO:
                continue
            turns = _ONE if k + 1 < instants and moving[k + 1, i] > _ZERO else _ZERO
            after = min(k + 1, instants - 1)
            vx, vy, vz = mean[k, 0, i], mean[k, 1, i], mean[k, 2, i]
            ax = turns * (mean[after, 0, i] - vx)
            ay = turns * (mean[after, 1, i] - vy)
            az = turns * (mean[after, 2, i] - vz)
            late = _ONE if k >= half else _ZERO
            for j in range(n):
                dx, dy, dz = p[k, 0, j] - p[k, 0, i], p[k, 1, j] - p[k, 1, i], p[k, 2, j] - p[k, 2, i]
                d = np.sqrt(dx * dx + dy * dy + dz * dz) + _TINY
                b = moving[k, j]
                c = (dx * vx + dy * vy + dz * vz) / d * b
                cosine[j], distance[j], reach[j] = c, d + (_ONE - b) * _FAR, b
                total[0, j] += c
                total[1, j] += abs(c)
                total[2, j] += (dx * ax + dy * ay + dz * az) / d * b
                total[3, j] += d * b
                total[4, j] += b
                total[5, j] += late * d * b
                total[6, j] += late * b
                least[j] = min(least[j], distance[j])
            distance[i] = _FAR
            for r in range(bank):
                for j in range(n):
                    w = min(_ONE, max(_ZERO, np.float32(5.5) - np.float32(5.0) * distance[j] / radii[r])) * reach[j]
                    total[8 + r, j] += w
            for j in range(n):
                w = min(_ONE, max(_ZERO, np.float32(5.5) - np.float32(5.0) * distance[j] / radii[bank - 1])) * reach[j]
                ahead[j] += cosine[j] * w
                near_sum[j] += w
            nearest = 0
            for j in range(n):
                if distance[j] < distance[nearest]:
                    nearest = j
            if distance[nearest] < _FAR:
                own[0, i] += cosine[nearest]
                own[1, i] += abs(cosine[nearest])
                own[2, i] += np.log(distance[nearest] / _UNIT + _LEAST)
                seen_sum += _ONE
        for a in range(3):
            own[a, i] /= max(seen_sum, _ONE)
        own[3, i] = ahead.sum() / max(near_sum.sum(), _HALF)
        for j in range(n):
            count = max(total[4, j], _ONE)
            early = (total[3, j] - total[5, j]) / max(total[4, j] - total[6, j], _ONE)
            late_mean = total[5, j] / max(total[6, j], _ONE)
            both = _ONE if total[6, j] > _ZERO and total[4, j] > total[6, j] else _ZERO
            out[0, i, j], out[1, i, j], out[2, i, j] = total[0, j] / count, total[1, j] / count, total[2, j] / count
            out[3, i, j] = np.log(total[3, j] / count / _UNIT + _LEAST)
            out[4, i, j] = min(np.log(least[j] / _UNIT + _LEAST), np.float32(4.0))
            out[5, i, j] = both * np.log((late_mean / _UNIT + _LEAST) / (early / _UNIT + _LEAST))
            for r in range(bank):
                out[6 + r, i, j] = total[8 + r, j] / count


@compiled(error_model="numpy")
def measure_forces(p, v, a, pushed, out):
    """How i's acceleration ``a`` (T, 3, n), seen where ``pushed`` (T, n) is 1, points to j.

    Args:
        p, v: place and velocity before the change, ``(T, 3, n)``.
        out: gets ``(5, n, n)``: correlation with the direction to j, its size, with the gap, with the gap less its mean,
            and with the difference of the velocities.
    """
    steps, _, n = a.shape
    for i in range(n):
        total = np.zeros((14, n), np.float32)
        for t in range(steps):
            if pushed[t, i] == _ZERO:
                continue
            ax, ay, az = a[t, 0, i], a[t, 1, i], a[t, 2, i]
            power = ax * ax + ay * ay + az * az
            for j in range(n):
                b = pushed[t, j]
                dx, dy, dz = (p[t, 0, j] - p[t, 0, i]) * b, (p[t, 1, j] - p[t, 1, i]) * b, (p[t, 2, j] - p[t, 2, i]) * b
                ux, uy, uz = (v[t, 0, j] - v[t, 0, i]) * b, (v[t, 1, j] - v[t, 1, i]) * b, (v[t, 2, j] - v[t, 2, i]) * b
                square = dx * dx + dy * dy + dz * dz
                pull = ax * dx + ay * dy + az * dz
                c = pull / (np.sqrt(square) + _TINY)
                total[0, j] += c
                total[1, j] += abs(c)
                total[2, j] += pull
                total[3, j] += square
                total[4, j] += power * b
                total[5, j] += b
                total[6, j] += ax * ux + ay * uy + az * uz
                total[7, j] += ux * ux + uy * uy + uz * uz
                total[8, j] += dx
                total[9, j] += dy
                total[10, j] += dz
                total[11, j] += ax * b
                total[12, j] += ay * b
                total[13, j] += az * b
        for j in range(n):
            count, size = max(total[5, j], _ONE), np.sqrt(total[4, j])
            gx, gy, gz = total[8, j], total[9, j], total[10, j]
            square = max(total[3, j] - (gx * gx + gy * gy + gz * gz) / count, _ZERO) + _SMALL * total[3, j]
            pull = total[2, j] - (gx * total[11, j] + gy * total[12, j] + gz * total[13, j]) / count
            out[0, i, j] = total[0, j] / (size * np.sqrt(count) + _SMALL)
            out[1, i, j] = total[1, j] / (size * np.sqrt(count) + _SMALL)
            out[2, i, j] = total[2, j] / (size * np.sqrt(total[3, j]) + _SMALL)
            out[3, i, j] = pull / (size * np.sqrt(square) + _SMALL)
            out[4, i, j] = total[6, j] / (size * np.sqrt(total[7, j]) + _SMALL)


@compiled(error_model="numpy")
def measure_places(p, seen, lags, stride, out):
    """How close UAV i comes to where j was: ``p`` (T + 1, 3, n), ``seen`` (T + 1, n).

    Args:
        lags: ``(L,)``, the first is 0; ``stride``: the instants that are looked at.
        out: gets ``(L + 3, n, n)``: mean distance from i to where j was each lag before; mean distance of the nearest
            such place; share of the instants at which it is behind j; mean log lag of it.
    """
    instants, _, n = p.shape
    last = len(lags) - 1
    for i in range(n):
        total, count = np.zeros((last + 1, n), np.float32), np.zeros((last + 1, n), np.float32)
        extra, instants_seen = np.zeros((3, n), np.float32), np.zeros(n, np.float32)
        nearest, best, weight = np.empty(n, np.float32), np.empty(n, np.float32), np.empty(n, np.float32)
        for t in range(0, instants, stride):
            if seen[t, i] == _ZERO:
                continue
            x, y, z = p[t, 0, i], p[t, 1, i], p[t, 2, i]
            nearest[:] = _FAR
            best[:] = _ZERO
            for k in range(last + 1):
                if lags[k] > t:
                    break
                source, lag = t - lags[k], np.float32(k) / np.float32(max(last, 1))
                for j in range(n):
                    dx, dy, dz = p[source, 0, j] - x, p[source, 1, j] - y, p[source, 2, j] - z
                    b = seen[source, j]
                    d = np.sqrt(dx * dx + dy * dy + dz * dz)
                    total[k, j] += d * b
                    count[k, j] += b
                    shown = d + (_ONE - b) * _FAR
                    best[j] = lag if shown < nearest[j] else best[j]
                    nearest[j] = min(shown, nearest[j])
            if t >= lags[last]:
                for j in range(n):
                    weight[j] = _ONE if nearest[j] < _FAR else _ZERO
                    extra[0, j] += nearest[j] * weight[j]
                    extra[1, j] += weight[j] if best[j] > _ZERO else _ZERO
                    extra[2, j] += best[j] * weight[j]
                    instants_seen[j] += weight[j]
        for k in range(last + 1):
            for j in range(n):
                out[k, i, j] = total[k, j] / max(count[k, j], _ONE)
        for k in range(3):
            for j in range(n):
                out[last + 1 + k, i, j] = extra[k, j] / max(instants_seen[j], _ONE)


@compiled(error_model="numpy")
def summarise_lags(x, lags, out):
    """Of correlations ``x`` (L, n, n): the greatest, the mean place of the lag (0 to 1), and the sum, into (3, n, n)."""
    count, n, _ = x.shape
    top, last = np.empty((3, n), np.float32), np.float32(lags[-1])
    for i in range(n):
        out[:, i] = _ZERO
        top[:] = _ZERO
        for k in range(count):
            lag = np.float32(lags[k]) / last
            for j in range(n):
                c = x[k, i, j]
                top[0, j] = c if k == 0 else max(top[0, j], c)
                w = c * c if c > _ZERO else _ZERO
                w = w * w * w + np.float32(1e-9)
                top[1, j] += w
                top[2, j] += w * lag
                out[2, i, j] += c
        for j in range(n):
            out[0, i, j], out[1, i, j] = top[0, j], top[2, j] / top[1, j]


@compiled(error_model="numpy")
def add_own_past(x, length, steps, out):
    """Partial correlations given i's own past, from products with its unit series.

    Args:
        x: ``(L, 3, n, n)``, products of i's (rest, first, second) with j's velocity L lags earlier.
        length: ``(L, n, n)``, j's squared velocity over the same steps.
        steps: ``(n,)``, seen steps of each UAV.
        out: gets ``(L + 4, n, n)``: the correlations, the greatest, its lag, a place for the difference, the log gain.
    """
    lags, _, n, _ = x.shape
    top = np.empty((3, n), np.float32)
    for i in range(n):
        top[:] = _ZERO
        for k in range(lags):
            for j in range(n):
                a, b, whole = x[k, 1, i, j], x[k, 2, i, j], length[k, i, j]
                left = max(whole - a * a - b * b, _ZERO) + _SMALL * whole + np.float32(1e-5)
                c = x[k, 0, i, j] / np.sqrt(left)
                out[k, i, j] = c
                size = abs(c)
                top[0, j] = max(top[0, j], size)
                w = size * size * size
                w = w * w + np.float32(1e-9)
                top[1, j] += w
                top[2, j] += w * np.float32(k + 1) / np.float32(lags)
        for j in range(n):
            out[lags, i, j], out[lags + 1, i, j] = top[0, j], top[2, j] / top[1, j]
            gain = -np.log(max(_ONE - top[0, j] * top[0, j], _SMALL)) * max(steps[i], np.float32(4.0))
            out[lags + 3, i, j] = np.log(gain + _HALF)


@compiled(error_model="numpy")
def judge_blocks(square, overlap, product, persistence, out):
    """How well i's velocity is j's of some steps before, block by block.

    Args:
        square, overlap, product: ``(blocks, n, n)``: sum of squared differences, number of steps, product of innovations.
        persistence: ``(blocks, n)``, i's mean squared change of velocity in a step.
        out: gets ``(6, n, n)``: share of the blocks with a small difference, with a fair one, greatest product, root of
            the squares of positive ones, share with a difference below i's own change, and how far below.
    """
    blocks, n, _ = square.shape
    tight, loose = np.float32(0.03), np.float32(0.2)
    for i in range(n):
        total = np.zeros((6, n), np.float32)
        total[2, :] = -_ONE
        for b in range(blocks):
            change = persistence[b, i] + np.float32(3e-3)
            for j in range(n):
                valid = _ONE if overlap[b, i, j] > np.float32(1.5) else _ZERO
                d = max(square[b, i, j], _ZERO) / max(overlap[b, i, j], _ONE) + np.float32(3e-3)
                ratio = d / change
                ratio3 = ratio * ratio * ratio
                c = product[b, i, j]
                total[0, j] += valid / (_ONE + (d / tight) * (d / tight))
                total[1, j] += valid / (_ONE + (d / loose) * (d / loose))
                total[2, j] = max(total[2, j], c)
                total[3, j] += max(c, _ZERO) * max(c, _ZERO)
                total[4, j] += valid / (_ONE + ratio3)
                total[5, j] += valid * max(_ZERO, _ONE - ratio)
        for j in range(n):
            count = _ZERO
            for b in range(blocks):
                count += _ONE if overlap[b, i, j] > np.float32(1.5) else _ZERO
            count = max(count, _ONE)
            out[0, i, j], out[1, i, j], out[2, i, j] = total[0, j] / count, total[1, j] / count, total[2, j]
            out[3, i, j] = np.sqrt(total[3, j])
            out[4, i, j], out[5, i, j] = total[4, j] / count, total[5, j] / count


@compiled(error_model="numpy")
def sum_shares(product, p, allowance, out):
    """Out (n, n): the summed squares of ``product`` (3 n, p n), i's axes by j's whitened components, less a mean."""
    n = len(out)
    for i in range(n):
        for j in range(n):
            out[i, j] = -allowance
        for a in range(3):
            for c in range(p):
                for j in range(n):
                    x = product[a * n + i, c * n + j]
                    out[i, j] += x * x
