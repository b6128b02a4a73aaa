"""The compiled inner loops of the field models. Conventions are those of ``kernels.py``.

The numbers of a follower are in a table ``(B, COLUMNS, N)`` float32 that is drawn for each episode. Where a model
changes over time, it does so by hashed draws from the clock, so a flight has no state but the past.
"""

from __future__ import annotations

import numpy as np

from usnet_env.compiling import compiled
from usnet_env.swarm.kernels import FOLLOWS, begin_step, displacement, end_step, finish_step, norm, split_links

COLUMNS = 7  # of the table: delay, gain, noise, salt of the hashed draws, and the three coordinates of the slot
DELAY, GAIN, NOISE, SALT, OFFSET = 0, 1, 2, 3, 4
ALWAYS, EACH_CLUSTER, EACH_FOLLOWER = range(3)  # who draws whether to answer, block by block
MIXED = 6  # the strategies that `fly_mixed` mixes: f1 to f6
MOST_LINKS = 8  # of one follower in `fly_links`

_ONE, _ZERO = np.float32(1.0), np.float32(0.0)
_MASK = np.uint64(0xFFFFFFFF)


@compiled(error_model="numpy")
def hash_draw(salt, block):
    """A number in [0, 1) from a salt and the number of a block of steps: the integer hash lowbias32 (Wellons 2018)."""
    x = (np.uint64(salt) * np.uint64(0x9E3779B1) + np.uint64(block) * np.uint64(0x85EBCA77)) & _MASK
    x = x ^ (x >> np.uint64(16))
    x = (x * np.uint64(0x7FEB352D)) & _MASK
    x = x ^ (x >> np.uint64(15))
    x = (x * np.uint64(0x846CA68B)) & _MASK
    x = x ^ (x >> np.uint64(16))
    return np.float32(x >> np.uint64(8)) * np.float32(2.0**-24)


@compiled(inner=True, error_model="numpy")
def find_top(i, motion, source):
    """The free UAV or reference at the end of the chain of sources of UAV i, or the last UAV of the chain."""
    while motion[i] == FOLLOWS and source[i] >= 0:
        i = source[i]
    return i


@compiled(error_model="numpy")
def fly_links(
    links, strength, scale, response_unit, block_steps, response_probability, idle_noise, table, root, source, clock,
    motion, start, noise, position, velocity, plan,
):  # fmt: skip
    """Followers copy up to ``links`` UAVs above them in the chain of sources, up to their head.

    Link k of follower i leads to the UAV a_k that is k steps above it, with the sum of the delays on this way.
    v_{i,t+1} = norm((1 - g_i) v_{i,t} + g_i mean_k v_{a_k,t+1-d_k} + kappa_i n). With ``strength`` > 0 it is
    norm(v_{i,t} + mean_k strength (1 + |p_{a_k} - p_i|^2 / scale^2)^-0.4 (v_{a_k,t} - v_{i,t}) + kappa_i n) instead.
    A follower that doesn't answer in a block flies on with the noise ``idle_noise``.
    """
    uavs = table.shape[2]
    copied = np.empty((uavs, MOST_LINKS), np.int64)
    delays = np.empty((uavs, MOST_LINKS), np.int64)
    count = np.empty(uavs, np.int64)
    salt = np.empty(uavs, np.float32)
    for b in range(len(motion)):
        followers, _ = split_links(motion[b], source[b])
        for i in followers:
            count[i] = 0
            a, delay = i, 0
            while count[i] < links and motion[b, a] == FOLLOWS and source[b, a] >= 0:
                if a != i and a < root.shape[1] and root[b, a] == a:  # a head, which may follow unseen UAVs
                    break
                delay += np.int64(table[b, DELAY, a])
                a = source[b, a]
                copied[i, count[i]], delays[i, count[i]] = a, delay
                count[i] += 1
            is_shared = response_unit == EACH_CLUSTER and source[b, i] >= 0  # by all that copy the same UAV
            salt[i] = table[b, SALT, source[b, i] % uavs if is_shared else i]
        for s in range(noise.shape[1]):
            t = start + s
            begin_step(b, s, t, motion, plan, noise, position, velocity)
            block = (clock[b] + s) // block_steps
            for i in followers:
                x, y, z = velocity[b, t - 1, i, 0], velocity[b, t - 1, i, 1], velocity[b, t - 1, i, 2]
                noise_scale = table[b, NOISE, i]
                if count[i] == 0 or (response_unit != ALWAYS and hash_draw(salt[i], block) >= response_probability):
                    finish_step(b, s, t, i, x, y, z, idle_noise, noise, velocity)
                    continue
                if strength > _ZERO:
                    vx, vy, vz = x, y, z
                    for k in range(count[i]):
                        a = copied[i, k]
                        dx, dy, dz = displacement(position, b, t, a, i)
                        ratio = (dx * dx + dy * dy + dz * dz) / (scale * scale)
                        weight = strength / (np.float32(count[i]) * np.float32((_ONE + ratio) ** np.float32(0.4)))
                        v = velocity[b, t - 1, a]
                        x, y, z = x + weight * (v[0] - vx), y + weight * (v[1] - vy), z + weight * (v[2] - vz)
                else:
                    gain = table[b, GAIN, i]
                    weight = gain / np.float32(count[i])
                    x, y, z = (_ONE - gain) * x, (_ONE - gain) * y, (_ONE - gain) * z
                    for k in range(count[i]):
                        v = velocity[b, t - delays[i, k], copied[i, k]]
                        x, y, z = x + weight * v[0], y + weight * v[1], z + weight * v[2]
                finish_step(b, s, t, i, x, y, z, noise_scale, noise, velocity)
            end_step(b, s, t, motion, plan, position, velocity)


@compiled(error_model="numpy")
def fly_mixed(response_unit, block_steps, reach, table, source, clock, motion, start, noise, position, velocity, plan):
    """Each follower flies by one of f1 to f6 at a time, drawn once or, for each cluster, again in every block.

    f_k with lags l: norm(sum_{tau<l} v_{iL,t-tau} + kappa_i n), squares for f4 and f5; f6 adds the pull of its row.
    """
    uavs = table.shape[2]
    salt = np.empty(uavs, np.float32)
    for b in range(len(motion)):
        followers, _ = split_links(motion[b], source[b])
        for i in followers:
            is_shared = response_unit == EACH_CLUSTER and source[b, i] >= 0  # by all that copy the same UAV
            salt[i] = table[b, SALT, source[b, i] % uavs if is_shared else i]
        for s in range(noise.shape[1]):
            t = start + s
            begin_step(b, s, t, motion, plan, noise, position, velocity)
            block = (clock[b] + s) // block_steps if response_unit == EACH_CLUSTER else 0
            for i in followers:
                h = source[b, i]
                kind = int(np.float32(MIXED) * hash_draw(salt[i], block))
                x, y, z = _ZERO, _ZERO, _ZERO
                square = kind == 3 or kind == 4
                lags = kind - 1 if square else (1 if kind == 5 else kind + 1)
                for lag in range(lags):
                    v = velocity[b, t - 1 - lag, h]
                    if square:
                        x, y, z = x + v[0] * v[0], y + v[1] * v[1], z + v[2] * v[2]
                    else:
                        x, y, z = x + v[0], y + v[1], z + v[2]
                if kind == 5:
                    dx, dy, dz = displacement(position, b, t - 1, h, i)
                    distance = np.sqrt(dx * dx + dy * dy + dz * dz)
                    if distance > reach:
                        x, y, z = x + dx / distance, y + dy / distance, z + dz / distance
                finish_step(b, s, t, i, x, y, z, table[b, NOISE, i], noise, velocity)
            end_step(b, s, t, motion, plan, position, velocity)


@compiled(error_model="numpy")
def fly_slots(lags, pull, near, table, source, motion, start, noise, position, velocity, plan):
    """Followers keep a slot in the frame of their source, whose course is its mean velocity over ``lags`` steps.

    v_{i,t+1} = norm(v_{L,t+1-d_i} + pull g / max(|g|, near) + kappa_i n), g = p_L + R(course) o_i - p_i, where R turns
    the x axis into the course and keeps the y axis level.
    """
    frame = np.empty((noise.shape[2], 8), np.float32)
    for b in range(len(motion)):
        followers, sources = split_links(motion[b], source[b])
        for s in range(noise.shape[1]):
            t = start + s
            begin_step(b, s, t, motion, plan, noise, position, velocity)
            for h in sources:
                x, y, z = _ZERO, _ZERO, _ZERO
                for lag in range(lags):
                    v = velocity[b, t - 1 - lag, h]
                    x, y, z = x + v[0], y + v[1], z + v[2]
                x, y, z = norm(x, y, z)
                level = np.sqrt(x * x + y * y)
                cx, cy = (x / level, y / level) if level > np.float32(1e-6) else (_ONE, _ZERO)
                row = frame[h]
                row[0], row[1], row[2], row[3], row[4] = x, y, z, -cy, cx
                row[5], row[6], row[7] = -z * cx, -z * cy, level
            for i in followers:
                h = source[b, i]
                row = frame[h]
                along, across, up = table[b, OFFSET, i], table[b, OFFSET + 1, i], table[b, OFFSET + 2, i]
                head, follower = position[b, t, h], position[b, t, i]
                gx = along * row[0] + across * row[3] + up * row[5] + head[0] - follower[0]
                gy = along * row[1] + across * row[4] + up * row[6] + head[1] - follower[1]
                gz = along * row[2] + up * row[7] + head[2] - follower[2]
                weight = pull / max(np.sqrt(gx * gx + gy * gy + gz * gz), near)
                v = velocity[b, t - np.int64(table[b, DELAY, i]), h]
                x, y, z = v[0] + weight * gx, v[1] + weight * gy, v[2] + weight * gz
                finish_step(b, s, t, i, x, y, z, table[b, NOISE, i], noise, velocity)
            end_step(b, s, t, motion, plan, position, velocity)
