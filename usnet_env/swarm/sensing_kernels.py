"""Compiled loops of the sensors: what is missed, whose identity is taken, and what noise adds."""

from __future__ import annotations

import numpy as np

from usnet_env.compiling import compiled

_ONE, _ZERO = np.float32(1.0), np.float32(0.0)


@compiled()
def miss_in_bursts(after_hit, after_miss, drawn, detected):
    """Who is detected, ``(T, N)``, from the first instant on: the probability of a miss depends on the one before."""
    for t in range(1, drawn.shape[0]):
        for i in range(drawn.shape[1]):
            detected[t, i] = drawn[t, i] >= (after_hit if detected[t - 1, i] else after_miss)


@compiled()
def cut_tracks(share, drawn, seen):
    """Cut tracks in ``seen`` ``(T, N)`` by uniform numbers ``(3, N)``: whether, where, and which part stays."""
    last = max(len(seen) - 1, 1)
    for i in range(seen.shape[1]):
        cut = 0.2 + (0.8 - 0.2) * drawn[1, i]
        for t in range(len(seen) if drawn[0, i] < share else 0):
            seen[t, i] &= t / last <= cut if drawn[2, i] < 0.5 else t / last >= cut


@compiled(inner=True, error_model="numpy")
def _stretch(along, way, noise):
    """Add ``along`` times its part along the course to the noise ``(3 N,)`` of a flight that goes on by ``way``."""
    uavs = len(way) // 3
    e, u = np.empty((3, uavs), np.float32), np.empty((3, uavs), np.float32)
    for i in range(uavs):
        for axis in range(3):
            e[axis, i], u[axis, i] = way[3 * i + axis], noise[3 * i + axis]
    for i in range(uavs):
        x, y, z = e[0, i], e[1, i], e[2, i]
        size = max(np.sqrt(x * x + y * y + z * z), np.float32(1e-6))
        x, y, z = x / size, y / size, z / size
        part = along * (u[0, i] * x + u[1, i] * y + u[2, i] * z)
        e[0, i], e[1, i], e[2, i] = part * x, part * y, part * z
    for i in range(uavs):
        for axis in range(3):
            noise[3 * i + axis] += e[axis, i]


@compiled(inner=True, error_model="numpy")
def _add_noise(sensor, noise, t, track, first, every, now):
    """Add a sensor's noise at instant t to the positions ``now`` ``(3 N,)`` of ``track`` ``(first + T every + 1, W)``.

    With course noise the part along the course is stretched: that of the next step, or the last one at the end.
    """
    keep, along, bound, scale = sensor[0], sensor[1], sensor[2], sensor[3]
    push, s, width = np.sqrt(_ONE - keep * keep), first + t * every, len(now)
    if keep > _ZERO and t > 0:
        for n in range(width):
            noise[t, n] = keep * noise[t - 1, n] + push * noise[t, n]
    u = noise[t]
    if along != _ZERO:
        u, way = noise[t].copy(), np.empty(width, np.float32)
        for n in range(width):
            here = track[s, n]
            ahead = track[s + every, n] if t < len(noise) - 1 else np.float32(2.0) * here - track[s - every, n]
            way[n] = ahead - here
        _stretch(along, way, u)
    for n in range(width):
        now[n] += min(max(u[n], -bound), bound) * scale


@compiled()
def exchange(reach, swaps, alive, position, present):
    """Identities marked in ``swaps`` ``(T, N)`` go on with the nearest track within ``reach``, once an instant each.

    Both UAVs must be ``alive`` ``(N,)`` and present. It changes ``position`` ``(T, N, 3)`` and ``present`` ``(T, N)``,
    which are given by UAV, to those of each identity.
    """
    uavs, exchanged = len(alive), False
    holder, ready = np.arange(uavs), np.empty(uavs, np.bool_)  # the true UAV of each identity
    place, there = np.empty((uavs, 3), np.float32), np.empty(uavs, np.bool_)
    for t in range(len(swaps)):
        marked = swaps[t].any()
        if not (exchanged or marked):
            continue
        place[:], there[:] = position[t], present[t]
        for i in range(uavs if marked else 0):
            ready[i] = alive[i] and there[holder[i]]
        for i in range(uavs if marked else 0):
            if not (swaps[t, i] and ready[i]):
                continue
            nearest, best = -1, np.float32(np.inf)
            for j in range(uavs):
                if ready[j] and j != i:
                    x, y, z = place[holder[j], 0], place[holder[j], 1], place[holder[j], 2]
                    x, y, z = x - place[holder[i], 0], y - place[holder[i], 1], z - place[holder[i], 2]
                    distance = np.sqrt(x * x + y * y + z * z)
                    if distance < best:
                        nearest, best = j, distance
            if best <= reach:
                holder[i], holder[nearest] = holder[nearest], holder[i]
                ready[i] = ready[nearest] = False
                exchanged = True
        for i in range(uavs):
            if holder[i] != i:
                position[t, i], present[t, i] = place[holder[i]], there[holder[i]]


@compiled(error_model="numpy")
def observe(first, every, sensors, noisy, noise, differs, place, reach, flown, moved, seen, position, velocity):
    """Write what R observers see, of which R / B watch each of B flights ``flown`` ``(B, first + T every + 1, W)``.

    The window begins at the instant ``first``, ``every`` is the number of steps between two instants, and 3 N of the W
    coordinates are seen. ``sensors`` ``(R, 4)`` float32 are the memory of the noise, the course noise minus 1, the
    bound and the scale. ``noisy`` ``(R,)`` are the rows of ``noise`` ``(n, T + 1, 3 N)``, which is changed in place,
    or -1. Velocities of observers that ``differs`` ``(R,)`` marks are differences of positions, the others those
    ``moved`` ``(B, first + T, W)``. Observers at ``place`` ``(R, 3)`` see as far as ``reach`` ``(R,)``; what is too
    far is taken out of ``seen`` ``(R, T + 1, N)``. ``position`` ``(R, T + 1, 3 N)`` and ``velocity`` ``(R, T, 3 N)``
    are filled.
    Loops over all coordinates become vector instructions, and so does a bitwise and with a mask, which hides a number.
    """
    instants, uavs = seen.shape[1], seen.shape[2]
    width, each = 3 * uavs, len(seen) // len(flown)
    two, way = np.empty((2, width), np.float32), np.empty(width, np.float32)  # positions now and an instant before
    x, y, z = np.empty(instants * uavs), np.empty(instants * uavs), np.empty(instants * uavs)
    mask = np.empty((instants, width), np.int32)
    flat = mask.reshape(-1)
    shown, shown_way = position.view(np.int32), velocity.view(np.int32)
    limited = reach.min() < np.inf
    for r in range(len(seen)):
        b, near, far = r // each, place[r], reach[r] * reach[r]
        sees = seen[r].reshape(-1)
        if limited and r % each == 0:
            for t in range(instants):
                for i in range(uavs):
                    now, m = flown[b, first + t * every], t * uavs + i
                    x[m], y[m], z[m] = now[3 * i], now[3 * i + 1], now[3 * i + 2]
        if far < np.inf:
            for m in range(len(sees)):
                dx, dy, dz = x[m] - near[0], y[m] - near[1], z[m] - near[2]
                sees[m] &= dx * dx + dy * dy + dz * dz <= far
        for m in range(len(sees)):
            flat[3 * m] = flat[3 * m + 1] = flat[3 * m + 2] = -1 if sees[m] else 0
        for t in range(instants):
            now = flown[b, first + t * every, :width]
            if differs[r]:
                flies, now, before = now, two[t % 2], two[1 - t % 2]
                for n in range(width):
                    now[n] = flies[n]
                if noisy[r] >= 0:
                    _add_noise(sensors[r], noise[noisy[r]], t, flown[b], first, every, now)
                for n in range(width):
                    way[n] = (now[n] - before[n]) / np.float32(every)
            bits = now.view(np.int32)
            for n in range(width):
                shown[r, t, n] = bits[n] & mask[t, n]
            if t:
                moves = way if differs[r] else moved[b, first + t - 1, :width]
                bits = moves.view(np.int32)
                for n in range(width):
                    shown_way[r, t - 1, n] = bits[n] & mask[t, n] & mask[t - 1, n]
