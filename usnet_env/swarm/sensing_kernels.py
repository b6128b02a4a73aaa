"""Compiled loops of the sensors: what is missed, whose identity is taken, and what noise adds."""

from __future__ import annotations

import math

import numpy as np

from usnet_env.compiling import compiled

_ONE, _ZERO = np.float32(1.0), np.float32(0.0)


@compiled()
def miss_in_bursts(after_hit, after_miss, drawn, detected):
    """Who is detected, ``(T, N)``, from the first instant on: the probability of a miss depends on the one before."""
    for t in range(1, drawn.shape[0]):
        for i in range(drawn.shape[1]):
            detected[t, i] = drawn[t, i] >= (after_hit if detected[t - 1, i] else after_miss)


@compiled(inner=True, error_model="numpy")
def _add_noise(sensor, noise, t, alive, track, now):
    """Add a sensor's noise at instant t to the positions ``now`` ``(N, 3)`` of ``track`` ``(T + 1, N, 3)``."""
    keep, along, bound, scale = sensor[0], sensor[1], sensor[2], sensor[3]
    push, last, u, e = np.sqrt(_ONE - keep * keep), len(track) - 1, np.empty(3, np.float32), np.empty(3, np.float32)
    for i in range(len(now)):
        for axis in range(3):
            if keep > _ZERO and t > 0:
                noise[t, i, axis] = keep * noise[t - 1, i, axis] + push * noise[t, i, axis]
            u[axis] = noise[t, i, axis]
        if along != _ZERO:  # stretch the part along the course, that of the next step; at the end of the last one
            for axis in range(3):
                here = track[t, i, axis]
                ahead = track[t + 1, i, axis] if t < last else np.float32(2.0) * here - track[t - 1, i, axis]
                e[axis] = ahead - here
            size = max(np.sqrt(e[0] * e[0] + e[1] * e[1] + e[2] * e[2]), np.float32(1e-6))
            e[0], e[1], e[2] = e[0] / size, e[1] / size, e[2] / size
            part = along * (u[0] * e[0] + u[1] * e[1] + u[2] * e[2])
            u[0], u[1], u[2] = u[0] + part * e[0], u[1] + part * e[1], u[2] + part * e[2]
        for axis in range(3 if alive[i] else 0):
            now[i, axis] += min(max(u[axis], -bound), bound) * scale


@compiled()
def exchange(reach, swaps, alive, position, present):
    """Identities marked in ``swaps`` ``(T, N)`` go on with the nearest track within ``reach``, once an instant each.

    Both UAVs must be ``alive`` ``(N,)`` and present. It changes ``position`` ``(T, N, 3)`` and ``present`` ``(T, N)``,
    which are given by UAV, to those of each identity.
    """
    uavs = len(alive)
    holder, ready = np.arange(uavs), np.empty(uavs, np.bool_)  # the true UAV of each identity
    for t in range(len(swaps)):
        place, there = position[t].copy(), present[t].copy()
        for i in range(uavs):
            ready[i] = alive[i] and there[holder[i]]
        for i in range(uavs):
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
        for i in range(uavs):
            position[t, i], present[t, i] = place[holder[i]], there[holder[i]]


@compiled(error_model="numpy")
def observe(sensors, every, noisy, noise, differs, place, reach, alive, flown, moved, seen, position, velocity):
    """Write what R observers see, of which R / B watch each of B flights ``flown`` ``(B, T + 1, N, 3)``.

    ``sensors`` ``(R, 4)`` float32 are the memory of the noise, the course noise minus 1, its bound and its scale;
    ``every`` is the number of steps between two instants. ``noisy`` ``(R,)`` are the rows of ``noise``
    ``(n, T + 1, N, 3)``, which is changed in place, or -1. Velocities of observers that ``differs`` ``(R,)`` marks are
    differences of positions, the others those ``moved`` ``(B, T, N, 3)``. Observers at ``place`` ``(R, 3)`` see as far
    as ``reach`` ``(R,)``; what is too far is taken out of ``seen`` ``(R, T + 1, N)``. ``alive`` is ``(R, N)``;
    ``position`` ``(R, T + 1, N, 3)`` and ``velocity`` ``(R, T, N, 3)`` are filled.
    """
    instants, uavs = seen.shape[1], seen.shape[2]
    two = np.empty((2, uavs, 3), np.float32)  # what would be seen now and an instant before
    for r in range(len(seen)):
        b = r // (len(seen) // len(flown))
        for t in range(instants):
            now, before = two[t % 2], two[1 - t % 2]
            now[:] = flown[b, t]
            if reach[r] < np.inf:
                for i in range(uavs):
                    x, y, z = now[i, 0] - place[r, 0], now[i, 1] - place[r, 1], now[i, 2] - place[r, 2]
                    seen[r, t, i] &= math.sqrt(x * x + y * y + z * z) <= reach[r]
            if noisy[r] >= 0:
                _add_noise(sensors[r], noise[noisy[r]], t, alive[r], flown[b], now)
            for i in range(uavs):
                hit = seen[r, t, i]
                for axis in range(3):
                    position[r, t, i, axis] = now[i, axis] if hit else _ZERO
            for i in range(uavs if t else 0):
                both = seen[r, t, i] and seen[r, t - 1, i]
                for axis in range(3):
                    if differs[r]:
                        step = (now[i, axis] - before[i, axis]) / np.float32(every)
                    else:
                        step = moved[b, t - 1, i, axis]
                    velocity[r, t - 1, i, axis] = step if both else _ZERO
