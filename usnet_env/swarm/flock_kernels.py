"""The compiled loop of the flocks: neighbours within ranges, found by a cell list in large flocks.

A flock is a cluster: the living UAVs with the same UAV or reference at the end of their chains of sources. Predators
and drivers belong to no flock. Time and memory of a step are linear in N at a fixed density.
"""

from __future__ import annotations

import numpy as np

from usnet_env.compiling import compiled
from usnet_env.swarm.field_kernels import NOISE, find_top
from usnet_env.swarm.kernels import DESTROYED, FOLLOWS, UNIT, begin_step, end_step, finish_step, move, norm

NO_CHASER, PREDATOR, DRIVER = range(3)

_ONE, _ZERO, _TINY = np.float32(1.0), np.float32(0.0), np.float32(1e-12)
_SMALL, _MIDDLE = 64, 128  # sizes up to which a flock is searched as a whole: unsorted, or sorted by cell
_X, _Y, _Z, _UX, _UY, _UZ = range(0, 6 * _MIDDLE, _MIDDLE)  # rows of `members` in _sum_all
# Rows of `sums`: repulsion, alignment, attraction, and the three counts.
_RX, _RY, _RZ, _OX, _OY, _OZ, _AX, _AY, _AZ, _REPELLED, _ALIGNED, _ATTRACTED = range(0, 12 * _MIDDLE, _MIDDLE)


@compiled(inner=True, error_model="numpy")
def _hash_cell(x, y, z, size):
    """The bucket of a cell; ``size`` is a power of two. Cells above each other have buckets side by side."""
    return ((x * 73856093 ^ y * 19349663) + z) & (size - 1)


@compiled(inner=True, error_model="numpy")
def _build_cells(first, last, p, v, width, place, begin, cell, near_p, near_v):
    """Sort the UAVs first..last-1 by the bucket of their cell, so that UAVs of a cell lie side by side in memory.

    ``place`` gets the bucket of each UAV. ``begin[h]`` is where bucket h begins in ``cell``, ``near_p`` and ``near_v``.
    """
    begin[:] = 0
    for c in range(first, last):
        x, y, z = int(np.floor(p[0, c] / width)), int(np.floor(p[1, c] / width)), int(np.floor(p[2, c] / width))
        place[c] = _hash_cell(x, y, z, len(begin) - 1)
        begin[place[c]] += 1
    for h in range(1, len(begin)):
        begin[h] += begin[h - 1]
    for c in range(first, last):
        begin[place[c]] -= 1
        k = begin[place[c]]
        for axis in range(3):
            cell[axis, k] = int(np.floor(p[axis, c] / width))
            near_p[axis, k], near_v[axis, k] = p[axis, c], v[axis, c]


@compiled(inner=True, error_model="numpy")
def _sort_by_cell(low, p, width, key, rank):
    """Sort ``rank``, the UAVs of a flock that begins at ``low``, by cell as :func:`_sum_cells` does: sums are equal."""
    for c in rank:
        key[c] = 0
        for axis in range(3):
            key[c] = (key[c] << 18) + int(np.floor(p[axis, low + c] / width))
        key[c] = (key[c] << 9) - c
    for k in range(1, len(rank)):  # few are out of order, since the order is that of the step before
        c, j = rank[k], k
        while j and key[rank[j - 1]] > key[c]:
            rank[j] = rank[j - 1]
            j -= 1
        rank[j] = c


@compiled(inner=True, error_model="numpy")
def _sum_cells(x, y, z, width, repel, align, attract, begin, cell, p, v):
    """Sum over the UAVs in the 27 cells around a place: repulsion, alignment, attraction, and their three counts."""
    outer, size = max(repel, align, attract), len(begin) - 1
    cx, cy, cz = int(np.floor(x / width)), int(np.floor(y / width)), int(np.floor(z / width))
    rx, ry, rz, ox, oy, oz, ax, ay, az = _ZERO, _ZERO, _ZERO, _ZERO, _ZERO, _ZERO, _ZERO, _ZERO, _ZERO
    repelled, aligned, attracted = _ZERO, _ZERO, _ZERO
    for i in range(cx - 1, cx + 2):
        for j in range(cy - 1, cy + 2):
            for k in range(cz - 1, cz + 2):
                h = _hash_cell(i, j, k, size)
                for c in range(begin[h], begin[h + 1]):
                    dx, dy, dz = p[0, c] - x, p[1, c] - y, p[2, c] - z
                    square = dx * dx + dy * dy + dz * dz
                    # Two cells may share a bucket: a UAV counts in its own cell only.
                    if square < outer and cell[0, c] == i and cell[1, c] == j and cell[2, c] == k:
                        inverse = _ONE / np.sqrt(square + _TINY)
                        if square < repel:
                            repelled += _ONE
                            rx, ry, rz = rx - inverse * dx, ry - inverse * dy, rz - inverse * dz
                        if square < align:
                            aligned += _ONE
                            ox, oy, oz = ox + v[0, c], oy + v[1, c], oz + v[2, c]
                        if square < attract:
                            attracted += _ONE
                            ax, ay, az = ax + inverse * dx, ay + inverse * dy, az + inverse * dz
    return rx, ry, rz, ox, oy, oz, ax, ay, az, repelled, aligned, attracted


@compiled(inner=True, error_model="numpy")
def _sum_all(size, repel, align, attract, members, sums):
    """Fill ``sums`` for all UAVs of a small flock.

    The inner loop is over the UAVs that get a term, so the sums have the same bits with all vector instructions. Rows
    of ``members`` and ``sums`` are ``_MIDDLE`` apart, from which the compiler knows that they don't overlap.
    """
    last = (size + 3) // 4 * 4  # whole vectors of all widths; nobody reads the rest
    for row in range(0, len(sums), _MIDDLE):
        sums[row : row + last] = _ZERO
    for d in range(size):
        x, y, z = members[_X + d], members[_Y + d], members[_Z + d]
        ux, uy, uz = members[_UX + d], members[_UY + d], members[_UZ + d]
        for c in range(last):
            dx, dy, dz = x - members[_X + c], y - members[_Y + c], z - members[_Z + c]
            square = dx * dx + dy * dy + dz * dz
            o = _ONE if square < align else _ZERO
            sums[_ALIGNED + c] += o
            sums[_OX + c] += o * ux
            sums[_OY + c] += o * uy
            sums[_OZ + c] += o * uz
            r, q = _ONE if square < repel else _ZERO, _ONE if square < attract else _ZERO
            sums[_REPELLED + c] += r
            sums[_ATTRACTED + c] += q
            inverse = _ONE / np.sqrt(square + _TINY)
            r *= inverse
            sums[_RX + c] -= r * dx
            sums[_RY + c] -= r * dy
            sums[_RZ + c] -= r * dz
            q *= inverse
            sums[_AX + c] += q * dx
            sums[_AY + c] += q * dy
            sums[_AZ + c] += q * dz


@compiled(inner=True, error_model="numpy")
def _sort_members(motion, source, bystander, uavs, label, order, first):
    """Sort the living UAVs by flock: ``order[first[f]:first[f + 1]]`` are those of flock f. Return their number."""
    first[:] = 0
    for i in range(uavs):
        label[i] = -1
        if motion[i] != DESTROYED and not (bystander[i] and motion[i] == FOLLOWS):
            label[i] = find_top(i, motion, source)
            first[label[i] + 1] += 1
    for f in range(len(first) - 1):
        first[f + 1] += first[f]
    place = first.copy()
    for i in range(uavs):
        if label[i] >= 0:
            order[place[label[i]]] = i
            place[label[i]] += 1
    return first[-1]


@compiled(inner=True, error_model="numpy")
def _steer_chaser(chaser, standoff, i, first, last, top, t, p, middle, position, velocity):
    """The direction of a predator, to the nearest UAV of its flock, or of a driver, to its place behind the flock."""
    if chaser == PREDATOR:
        x, y, z, best = velocity[t - 1, i, 0], velocity[t - 1, i, 1], velocity[t - 1, i, 2], np.float32(np.inf)
        for c in range(first, last):
            dx, dy, dz = p[0, c] - position[t, i, 0], p[1, c] - position[t, i, 1], p[2, c] - position[t, i, 2]
            square = dx * dx + dy * dy + dz * dz
            if square < best:
                x, y, z, best = dx, dy, dz, square
    else:
        ux, uy, uz = velocity[t, top, 0], velocity[t, top, 1], velocity[t, top, 2]
        back = standoff / np.sqrt(ux * ux + uy * uy + uz * uz + _TINY)
        x = middle[0] - back * ux - position[t, i, 0]
        y = middle[1] - back * uy - position[t, i, 1]
        z = middle[2] - back * uz - position[t, i, 2]
    return norm(x, y, z)


@compiled(error_model="numpy")
def fly_flock(
    ranges, weights, chaser, flight_range, flight_weight, standoff, preference, table, root, source, bystander,
    motion, start, noise, position, velocity, craft,
):  # fmt: skip
    """Followers fly by repulsion, or else by alignment and attraction, from the UAVs of their flock, and flee chasers.

    ``ranges`` are those of repulsion, alignment and attraction, metres; ``weights`` those of alignment and attraction.
    ``chaser`` says what a bystander that follows is.
    """
    episodes, steps, width, uavs = noise.shape[0], noise.shape[1], noise.shape[2], table.shape[2]
    label, order = np.empty(uavs, np.int64), np.empty(uavs, np.int64)
    first = np.empty(width + 1, np.int64)
    p, v = np.empty((3, uavs), np.float32), np.empty((3, uavs), np.float32)
    repel, align, attract = ranges[0] * ranges[0], ranges[1] * ranges[1], ranges[2] * ranges[2]
    outer = max(ranges[0], ranges[1], ranges[2])
    cell, place = np.empty((3, uavs), np.int64), np.empty(uavs, np.int64)
    near_p, near_v = np.empty((3, uavs), np.float32), np.empty((3, uavs), np.float32)
    buckets = 1
    while buckets < 2 * uavs:
        buckets *= 2
    begin = np.empty(buckets + 1, np.int64)
    rank, key = np.empty(uavs, np.int64), np.empty(_MIDDLE, np.int64)
    few, sums = np.zeros(6 * _MIDDLE, np.float32), np.empty(12 * _MIDDLE, np.float32)
    middle = np.zeros((width, 3), np.float32)
    for b in range(episodes):
        members = _sort_members(motion[b], source[b], bystander[b], uavs, label, order, first)
        flocks = np.flatnonzero(first[1:] > first[:-1])
        for f in flocks:
            rank[first[f] : first[f + 1]] = np.arange(first[f + 1] - first[f])
        chasers = np.flatnonzero(bystander[b] & (motion[b, :uavs] == FOLLOWS))
        for s in range(steps):
            t = start + s
            if craft.kinematics != UNIT:
                begin_step(b, s, t, motion, craft, noise, position, velocity)
            for c in range(members):
                for axis in range(3):
                    p[axis, c], v[axis, c] = position[b, t, order[c], axis], velocity[b, t - 1, order[c], axis]
            for f in flocks:
                low, size = first[f], first[f + 1] - first[f]
                px, py, pz = p[0, low : low + size], p[1, low : low + size], p[2, low : low + size]
                if chaser == DRIVER:
                    middle[f, 0], middle[f, 1], middle[f, 2] = px.mean(), py.mean(), pz.mean()
                small = 1
                if _SMALL < size <= _MIDDLE:
                    _sort_by_cell(low, p, outer, key, rank[low : low + size])
                if size > _MIDDLE:
                    while small < 2 * size:
                        small *= 2
                    _build_cells(low, low + size, p, v, outer, place, begin[: small + 1], cell, near_p, near_v)
                else:
                    for axis in range(3):
                        for k in range(size):
                            few[_X + axis * _MIDDLE + k] = p[axis, low + rank[low + k]]
                            few[_UX + axis * _MIDDLE + k] = v[axis, low + rank[low + k]]
                    _sum_all(size, repel, align, attract, few, sums)
                for k in range(size):
                    c = rank[low + k]
                    i = order[low + c]
                    if motion[b, i] != FOLLOWS:
                        continue
                    if size > _MIDDLE:
                        rx, ry, rz, ox, oy, oz, ax, ay, az, repelled, aligned, attracted = _sum_cells(
                            px[c], py[c], pz[c], outer, repel, align, attract, begin[: small + 1], cell, near_p, near_v
                        )
                    else:
                        rx, ry, rz = sums[_RX + k], sums[_RY + k], sums[_RZ + k]
                        ox, oy, oz = sums[_OX + k], sums[_OY + k], sums[_OZ + k]
                        ax, ay, az = sums[_AX + k], sums[_AY + k], sums[_AZ + k]
                        repelled, aligned, attracted = sums[_REPELLED + k], sums[_ALIGNED + k], sums[_ATTRACTED + k]
                    if repelled > np.float32(1.5):  # the UAV itself is counted
                        x, y, z = norm(rx, ry, rz)
                    elif max(aligned, attracted) > np.float32(1.5):
                        align_scale = weights[0] / max(aligned, _ONE)
                        attract_scale = weights[1] / max(attracted - _ONE, _ONE)
                        x = align_scale * ox + attract_scale * ax
                        y = align_scale * oy + attract_scale * ay
                        z = align_scale * oz + attract_scale * az
                    else:
                        x, y, z = norm(px.mean() - px[c], py.mean() - py[c], pz.mean() - pz[c])
                    if preference > _ZERO and root[b, i] == i:
                        x, y, z = norm(x, y, z)
                        x += preference * velocity[b, t - 1, f, 0]
                        y += preference * velocity[b, t - 1, f, 1]
                        z += preference * velocity[b, t - 1, f, 2]
                    for h in chasers:
                        dx, dy = px[c] - position[b, t, h, 0], py[c] - position[b, t, h, 1]
                        dz = pz[c] - position[b, t, h, 2]
                        square = dx * dx + dy * dy + dz * dz
                        if square < flight_range * flight_range:
                            scale = flight_weight / np.sqrt(square + _TINY)
                            x, y, z = x + scale * dx, y + scale * dy, z + scale * dz
                    finish_step(b, s, t, i, x, y, z, table[b, NOISE, i], noise, velocity)
            for i in chasers:
                f = find_top(i, motion[b], source[b])
                x, y, z = _steer_chaser(
                    chaser, standoff, i, first[f], first[f + 1], f, t, p, middle[f], position[b], velocity[b]
                )
                finish_step(b, s, t, i, x, y, z, table[b, NOISE, i], noise, velocity)
            if craft.kinematics != UNIT:
                end_step(b, s, t, motion, craft, position, velocity)
            move(b, t, position, velocity)
