"""Compiled loops of the sensors: what is missed, whose identity is taken, and what noise adds."""

from __future__ import annotations

import numpy as np

from usnet_env.compiling import compiled

_ONE, _ZERO = np.float32(1.0), np.float32(0.0)


@compiled()
def miss_in_bursts(after_hit, after_miss, uniform, detected):
    """Who is detected, ``(T, N)``, from the first instant on: the probability of a miss depends on the one before."""
    for t in range(1, uniform.shape[0]):
        for i in range(uniform.shape[1]):
            detected[t, i] = uniform[t, i] >= (after_hit if detected[t - 1, i] else after_miss)


@compiled()
def cut_tracks(share, uniform, seen):
    """Cut tracks in ``seen`` ``(T, N)`` by uniform numbers ``(3, N)``: whether, where, and which part stays."""
    last = max(len(seen) - 1, 1)
    for i in range(seen.shape[1]):
        end = 0.2 + (0.8 - 0.2) * uniform[1, i]
        for t in range(len(seen) if uniform[0, i] < share else 0):
            seen[t, i] &= t / last <= end if uniform[2, i] < 0.5 else t / last >= end


@compiled(inner=True, error_model="numpy")
def _add_noise(sensor, noise, t, track, first, every, position):
    """Add a sensor's noise at instant t to ``position`` ``(3 N,)``, that of ``track`` ``(first + T every + 1, W)``.

    With course noise the part along the course is stretched: that of the next step, or the last one at the end.
    """
    phi, along, bound, scale = sensor[0], sensor[1], sensor[2], sensor[3]
    sigma, s, width = np.sqrt(_ONE - phi * phi), first + t * every, len(position)
    if phi > _ZERO and t > 0:
        for n in range(width):
            noise[t, n] = phi * noise[t - 1, n] + sigma * noise[t, n]
    u = noise[t]
    if along != _ZERO:
        u, step = noise[t].copy(), np.empty(width, np.float32)
        for n in range(width):
            present = track[s, n]
            later = track[s + every, n] if t < len(noise) - 1 else np.float32(2.0) * present - track[s - every, n]
            step[n] = later - present
        for n in range(0, width, 3):
            x, y, z = step[n], step[n + 1], step[n + 2]
            size = max(np.sqrt(x * x + y * y + z * z), np.float32(1e-6))
            x, y, z = x / size, y / size, z / size
            size = along * (u[n] * x + u[n + 1] * y + u[n + 2] * z)
            u[n], u[n + 1], u[n + 2] = u[n] + size * x, u[n + 1] + size * y, u[n + 2] + size * z
    for n in range(width):
        position[n] += min(max(u[n], -bound), bound) * scale


@compiled()
def exchange(reach, swaps, alive, position, present):
    """Identities marked in ``swaps`` ``(T, N)`` go on with the nearest track within ``reach``, once an instant each.

    Both UAVs must be ``alive`` ``(N,)`` and present. It changes ``position`` ``(T, N, 3)`` and ``present`` ``(T, N)``,
    which are given by UAV, to those of each identity.
    """
    uavs, exchanged = len(alive), False
    holder, ready = np.arange(uavs), np.empty(uavs, np.bool_)  # the true UAV of each identity
    by_uav, was_present = np.empty((uavs, 3), np.float32), np.empty(uavs, np.bool_)
    for t in range(len(swaps)):
        marked = swaps[t].any()
        if not (exchanged or marked):
            continue
        by_uav[:], was_present[:] = position[t], present[t]
        for i in range(uavs if marked else 0):
            ready[i] = alive[i] and was_present[holder[i]]
        for i in range(uavs if marked else 0):
            if not (swaps[t, i] and ready[i]):
                continue
            nearest, best = -1, np.float32(np.inf)
            for j in range(uavs):
                if ready[j] and j != i:
                    x, y, z = by_uav[holder[j], 0], by_uav[holder[j], 1], by_uav[holder[j], 2]
                    x, y, z = x - by_uav[holder[i], 0], y - by_uav[holder[i], 1], z - by_uav[holder[i], 2]
                    distance = np.sqrt(x * x + y * y + z * z)
                    if distance < best:
                        nearest, best = j, distance
            if best <= reach:
                holder[i], holder[nearest] = holder[nearest], holder[i]
                ready[i] = ready[nearest] = False
                exchanged = True
        for i in range(uavs):
            if holder[i] != i:
                position[t, i], present[t, i] = by_uav[holder[i]], was_present[holder[i]]


@compiled(error_model="numpy")
def observe(
    first, every, sensors, noisy, noise, differs, observer, reach, true_position, true_velocity,
    seen, position, velocity,
):  # fmt: skip
    """Write what R observers see, of which R / B watch each of B flights.

    The flights are ``true_position`` ``(B, first + T every + 1, W)`` and ``true_velocity`` ``(B, first + T, W)``. The
    window begins at the instant ``first``, ``every`` is the number of steps between two instants, and 3 N of the W
    coordinates are seen. ``sensors`` ``(R, 4)`` float32 are the memory of the noise, the course noise minus 1, the
    bound and the scale. ``noisy`` ``(R,)`` are the rows of ``noise`` ``(n, T + 1, 3 N)``, which is changed in place,
    or -1. Velocities of observers that ``differs`` ``(R,)`` marks are differences of positions, the others
    true ones. Observers at ``observer`` ``(R, T + 1, 3)``, or ``(R, 1, 3)`` if they stand, see as far as ``reach``
    ``(R,)``; what is too far is taken out of ``seen`` ``(R, T + 1, N)``. ``position`` ``(R, T + 1, 3 N)`` and
    ``velocity`` ``(R, T, 3 N)`` are filled.
    Loops over all coordinates become vector instructions, and so does a bitwise and with a mask, which hides a number.
    """
    instants, uavs = seen.shape[1], seen.shape[2]
    width, observers_each = 3 * uavs, len(seen) // len(true_position)
    buffers, change = np.empty((2, width), np.float32), np.empty(width, np.float32)  # positions of two instants
    mask = np.empty((instants, width), np.int32)
    flat = mask.reshape(-1)
    shown, shown_change = position.view(np.int32), velocity.view(np.int32)
    for r in range(len(seen)):
        b, square_reach = r // observers_each, reach[r] * reach[r]
        is_seen = seen[r].reshape(-1)
        for t in range(instants if square_reach < np.inf else 0):
            current, centre = true_position[b, first + t * every], observer[r, t % observer.shape[1]]
            for i in range(uavs):
                dx, dy, dz = current[3 * i] - centre[0], current[3 * i + 1] - centre[1], current[3 * i + 2] - centre[2]
                seen[r, t, i] &= dx * dx + dy * dy + dz * dz <= square_reach
        for m in range(len(is_seen)):
            flat[3 * m] = flat[3 * m + 1] = flat[3 * m + 2] = -1 if is_seen[m] else 0
        for t in range(instants):
            current = true_position[b, first + t * every, :width]
            if differs[r]:
                truth, current, last_position = current, buffers[t % 2], buffers[1 - t % 2]
                for n in range(width):
                    current[n] = truth[n]
                if noisy[r] >= 0:
                    _add_noise(sensors[r], noise[noisy[r]], t, true_position[b], first, every, current)
                for n in range(width):
                    change[n] = (current[n] - last_position[n]) / np.float32(every)
            bits = current.view(np.int32)
            for n in range(width):
                shown[r, t, n] = bits[n] & mask[t, n]
            if t:
                change_seen = change if differs[r] else true_velocity[b, first + t - 1, :width]
                bits = change_seen.view(np.int32)
                for n in range(width):
                    shown_change[r, t - 1, n] = bits[n] & mask[t, n] & mask[t - 1, n]
