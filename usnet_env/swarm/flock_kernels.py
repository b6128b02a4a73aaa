"""The compiled loop of the flocks: neighbours within ranges.

A flock is a cluster: the living UAVs with the same UAV or reference at the end of their chains of sources. Predators
and drivers belong to no flock. The time of a step grows with the squares of the sizes of flocks, its memory with N.
"""

from __future__ import annotations

import numpy as np

from usnet_env.compiling import compiled
from usnet_env.swarm.field_kernels import NOISE, find_top
from usnet_env.swarm.kernels import DESTROYED, FOLLOWS, begin_step, end_step, finish_step, norm

NO_CHASER, PREDATOR, DRIVER = range(3)

_ONE, _ZERO, _TINY = np.float32(1.0), np.float32(0.0), np.float32(1e-12)
_OWN_COUNT = np.float32(1.5)  # a UAV counts itself: with a larger count it has neighbours
_BLOCK = 128  # number of UAVs of a flock that are computed together
_SMALL = 64  # a larger flock of one block sums in the order of cells, so its episodes keep the bits that they had
# Rows of `rows`, with numbers of up to _BLOCK UAVs of a flock: position, velocity, noise, what they want; then the
# sums: repulsion, alignment, attraction, and three counts. The compiler sees from their distance that none overlap;
# at a power of two, memory would wait for stores of rows with the same low bits of their addresses.
_ROW = _BLOCK + 16
_END = 24 * _ROW
_X, _Y, _Z, _UX, _UY, _UZ, _NX, _NY, _NZ, _WX, _WY, _WZ = range(0, 12 * _ROW, _ROW)
_RX, _RY, _RZ, _OX, _OY, _OZ, _AX, _AY, _AZ, _REPELLED, _ALIGNED, _ATTRACTED = range(12 * _ROW, _END, _ROW)


@compiled(inner=True, error_model="numpy")
def _sort_by_cell(first, p, width, key, rank):
    """Sort ``rank``, the UAVs of a flock from ``first`` on, by cell."""
    for c in rank:
        key[c] = 0
        for axis in range(3):
            key[c] = (key[c] << 18) + int(np.floor(p[axis, first + c] / width))
        key[c] = (key[c] << 9) - c
    for k in range(1, len(rank)):  # few are out of order, since the order is that of the step before
        c, j = rank[k], k
        while j and key[rank[j - 1]] > key[c]:
            rank[j] = rank[j - 1]
            j -= 1
        rank[j] = c


@compiled(inner=True, error_model="numpy")
def _sum_all(p, v, sources, size, repel, align, attract, rows):
    """Fill the sums in ``rows`` for a block of UAVs from all ``sources``, the UAVs of their flock that are seen.

    The inner loop is over the UAVs that get a term, so the sums have the same bits with all vector instructions. It
    goes over whole vectors, and the rest is not read.
    """
    last = (size + 7) // 8 * 8
    for row in range(_RX, _END, _ROW):
        rows[row : row + last] = _ZERO
    for d in sources:
        x, y, z, ux, uy, uz = p[0, d], p[1, d], p[2, d], v[0, d], v[1, d], v[2, d]
        for c in range(last // 8 * 8):  # tells the compiler that no vector is cut
            dx, dy, dz = x - rows[_X + c], y - rows[_Y + c], z - rows[_Z + c]
            square = dx * dx + dy * dy + dz * dz
            o = _ONE if square < align else _ZERO
            rows[_ALIGNED + c] += o
            rows[_OX + c] += o * ux
            rows[_OY + c] += o * uy
            rows[_OZ + c] += o * uz
            r, q = _ONE if square < repel else _ZERO, _ONE if square < attract else _ZERO
            rows[_REPELLED + c] += r
            rows[_ATTRACTED + c] += q
            inverse = _ONE / np.sqrt(square + _TINY)
            r *= inverse
            rows[_RX + c] -= r * dx
            rows[_RY + c] -= r * dy
            rows[_RZ + c] -= r * dz
            q *= inverse
            rows[_AX + c] += q * dx
            rows[_AY + c] += q * dy
            rows[_AZ + c] += q * dz


@compiled(inner=True, error_model="numpy")
def _choose(size, weights, mx, my, mz, rows):
    """Fill ``rows`` with what UAVs want: repulsion, or else alignment and attraction, or else the middle (mx, my, mz).

    All three are computed for all UAVs, in vectors, which takes less time than to decide for each.
    """
    for k in range((size + 7) // 8 * 8):
        repelled = rows[_REPELLED + k] > _OWN_COUNT
        x = rows[_RX + k] if repelled else mx - rows[_X + k]
        y = rows[_RY + k] if repelled else my - rows[_Y + k]
        z = rows[_RZ + k] if repelled else mz - rows[_Z + k]
        x, y, z = norm(x, y, z)
        align = weights[0] / max(rows[_ALIGNED + k], _ONE)
        attract = weights[1] / max(rows[_ATTRACTED + k] - _ONE, _ONE)
        joins = not repelled and max(rows[_ALIGNED + k], rows[_ATTRACTED + k]) > _OWN_COUNT
        rows[_WX + k] = align * rows[_OX + k] + attract * rows[_AX + k] if joins else x
        rows[_WY + k] = align * rows[_OY + k] + attract * rows[_AY + k] if joins else y
        rows[_WZ + k] = align * rows[_OZ + k] + attract * rows[_AZ + k] if joins else z


@compiled(inner=True, error_model="numpy")
def _finish(size, rows):
    """Replace the velocities in ``rows`` by norm(what UAVs want + noise)."""
    for k in range((size + 7) // 8 * 8):
        x, y, z = norm(rows[_WX + k] + rows[_NX + k], rows[_WY + k] + rows[_NY + k], rows[_WZ + k] + rows[_NZ + k])
        rows[_UX + k], rows[_UY + k], rows[_UZ + k] = x, y, z


@compiled(inner=True, error_model="numpy")
def _sort_members(motion, source, not_led, uavs, label, order, first):
    """Sort the living UAVs by flock: ``order[first[f]:first[f + 1]]`` are those of flock f. Return their number."""
    first[:] = 0
    for i in range(uavs):
        label[i] = -1
        joins = motion[i] == FOLLOWS  # of the unseen UAVs all but the free ones
        if i < len(not_led):
            joins = motion[i] != DESTROYED and not (not_led[i] and joins)
        if joins:
            label[i] = find_top(i, motion, source)
            first[label[i] + 1] += 1
    for f in range(len(first) - 1):
        first[f + 1] += first[f]
    end = first.copy()
    for i in range(uavs):
        if label[i] >= 0:
            order[end[label[i]]] = i
            end[label[i]] += 1
    return first[-1]


@compiled(inner=True, error_model="numpy")
def _steer_chaser(chaser, standoff, i, first, last, top, t, p, centre, position, velocity):
    """The direction of a predator, to the nearest UAV of its flock, or of a driver, to a point behind the flock."""
    if chaser == PREDATOR:
        x, y, z, best = velocity[t - 1, i, 0], velocity[t - 1, i, 1], velocity[t - 1, i, 2], np.float32(np.inf)
        for c in range(first, last):
            dx, dy, dz = p[0, c] - position[t, i, 0], p[1, c] - position[t, i, 1], p[2, c] - position[t, i, 2]
            square = dx * dx + dy * dy + dz * dz
            if square < best:
                x, y, z, best = dx, dy, dz, square
    else:
        ux, uy, uz = velocity[t, top, 0], velocity[t, top, 1], velocity[t, top, 2]
        scale = standoff / np.sqrt(ux * ux + uy * uy + uz * uz + _TINY)
        x = centre[0] - scale * ux - position[t, i, 0]
        y = centre[1] - scale * uy - position[t, i, 1]
        z = centre[2] - scale * uz - position[t, i, 2]
    return norm(x, y, z)


@compiled(error_model="numpy")
def fly_flock(
    ranges, weights, chaser, flight_range, flight_weight, standoff, link, table, root, source, not_led,
    motion, start, noise, position, velocity, plan,
):  # fmt: skip
    """Followers fly by repulsion, or else by alignment and attraction, from the UAVs of their flock, and flee chasers.

    ``ranges`` are those of repulsion, alignment and attraction, metres; ``weights`` those of alignment and attraction.
    ``chaser`` says what a UAV is that follows and is ``not_led``.
    """
    steps, width, uavs = noise.shape[1], noise.shape[2], table.shape[2]
    label, order = np.empty(uavs, np.int64), np.empty(uavs, np.int64)
    first, has_followers = np.empty(width + 1, np.int64), np.empty(width, np.bool_)
    p, v = np.empty((3, uavs), np.float32), np.empty((3, uavs), np.float32)
    repel, align, attract = ranges[0] * ranges[0], ranges[1] * ranges[1], ranges[2] * ranges[2]
    outer = max(ranges[0], ranges[1], ranges[2])
    rank, key = np.empty(uavs, np.int64), np.empty(_BLOCK, np.int64)
    rows = np.zeros(_END, np.float32)
    centre = np.zeros((width, 3), np.float32)
    for b in range(len(motion)):
        members = _sort_members(motion[b], source[b], not_led[b], uavs, label, order, first)
        has_followers[:] = False
        for i in order[:members]:
            has_followers[label[i]] |= motion[b, i] == FOLLOWS
        flocks = np.flatnonzero(has_followers)  # no free UAV by itself
        for f in flocks:
            rank[first[f] : first[f + 1]] = np.arange(first[f + 1] - first[f])
        chasers = np.flatnonzero(not_led[b] & (motion[b, : not_led.shape[1]] == FOLLOWS))
        for s in range(steps):
            t = start + s
            begin_step(b, s, t, motion, plan, noise, position, velocity)
            for c in range(members):
                for axis in range(3):
                    p[axis, c], v[axis, c] = position[b, t, order[c], axis], velocity[b, t - 1, order[c], axis]
            for f in flocks:
                base, size = first[f], first[f + 1] - first[f]
                seen = size  # the unseen UAVs come last: they fly by the seen ones, or by the first of their own
                while seen > 1 and order[base + seen - 1] >= root.shape[1]:
                    seen -= 1
                px, py, pz = p[0, base : base + seen], p[1, base : base + seen], p[2, base : base + seen]
                mx, my, mz = px.mean(), py.mean(), pz.mean()
                centre[f, 0], centre[f, 1], centre[f, 2] = mx, my, mz
                if _SMALL < size <= _BLOCK:
                    _sort_by_cell(base, p, outer, key, rank[base : base + seen])
                sources = base + rank[base : base + seen]
                for block in range(base, base + size, _BLOCK):
                    count = min(_BLOCK, base + size - block)
                    for k in range(count):
                        c = base + rank[block + k]
                        i = order[c]
                        for axis in range(3):
                            rows[_X + axis * _ROW + k] = p[axis, c]
                            rows[_UX + axis * _ROW + k] = v[axis, c]
                            rows[_NX + axis * _ROW + k] = table[b, NOISE, i] * noise[b, s, i, axis]
                    _sum_all(p, v, sources, count, repel, align, attract, rows)
                    for k in range(max(seen - block + base, 0), count):  # an unseen UAV counts itself too
                        for row in (_REPELLED, _ALIGNED, _ATTRACTED):
                            rows[row + k] += _ONE
                        for axis in range(0, 3 * _ROW, _ROW):
                            rows[_OX + axis + k] += rows[_UX + axis + k]
                    _choose(count, weights, mx, my, mz, rows)
                    for k in range(count if link > _ZERO or len(chasers) else 0):
                        i = order[base + rank[block + k]]
                        if link > _ZERO and (i >= root.shape[1] or root[b, i] >= 0) and motion[b, i] == FOLLOWS:
                            x, y, z = norm(rows[_WX + k], rows[_WY + k], rows[_WZ + k])
                            copied = velocity[b, t - 1, source[b, i]]
                            rows[_WX + k], rows[_WY + k] = x + link * copied[0], y + link * copied[1]
                            rows[_WZ + k] = z + link * copied[2]
                        for h in chasers:
                            dx, dy = rows[_X + k] - position[b, t, h, 0], rows[_Y + k] - position[b, t, h, 1]
                            dz = rows[_Z + k] - position[b, t, h, 2]
                            square = dx * dx + dy * dy + dz * dz
                            if square < flight_range * flight_range:
                                scale = flight_weight / np.sqrt(square + _TINY)
                                rows[_WX + k] += scale * dx
                                rows[_WY + k] += scale * dy
                                rows[_WZ + k] += scale * dz
                    _finish(count, rows)
                    for k in range(count):
                        i = order[base + rank[block + k]]
                        if motion[b, i] == FOLLOWS:
                            for axis in range(3):
                                velocity[b, t, i, axis] = rows[_UX + axis * _ROW + k]
            for i in chasers:
                f = find_top(i, motion[b], source[b])
                x, y, z = _steer_chaser(
                    chaser, standoff, i, first[f], first[f + 1], f, t, p, centre[f], position[b], velocity[b]
                )
                finish_step(b, s, t, i, x, y, z, table[b, NOISE, i], noise, velocity)
            end_step(b, s, t, motion, plan, position, velocity)
