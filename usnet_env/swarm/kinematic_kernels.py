"""The compiled step of the kinematics models. Conventions are those of ``kernels.py``."""

from __future__ import annotations

import math

import numpy as np

from usnet_env.compiling import compiled
from usnet_env.swarm.kernels import DESTROYED, norm

__all__ = ["LAGGED", "LAYERED", "LIMITED", "VARIED_SPEED", "fly_step"]

VARIED_SPEED, LAGGED, LIMITED, LAYERED = range(4)
_ONE, _ZERO, _TINY = np.float32(1.0), np.float32(0.0), np.float32(1e-12)


@compiled(error_model="numpy")
def _turn(x, y, z, u, v, w, limit):
    """Turn the unit vector (x, y, z) towards the unit vector (u, v, w) by at most ``limit``; also return the cosine."""
    cosine = min(max(x * u + y * v + z * w, -_ONE), _ONE)
    angle = min(np.float32(math.acos(cosine)), limit)
    u, v, w = u - cosine * x, v - cosine * y, w - cosine * z
    size = np.sqrt(u * u + v * v + w * w)
    if size < np.float32(1e-4):  # ahead or behind: turn in the level plane
        u, v, w = -y, x, _ZERO
        size = np.sqrt(u * u + v * v) + _TINY
    c, s = np.float32(math.cos(angle)), np.float32(math.sin(angle)) / size
    x, y, z = norm(c * x + s * u, c * y + s * v, c * z + s * w)
    return x, y, z, cosine


@compiled(error_model="numpy")
def fly_step(code, numbers, t, motion, normals, state, position, velocity):
    """One step of all models but ``unit``; the arguments are those of ``Kinematics.fly``."""
    episodes, uavs = motion.shape
    for b in range(episodes):
        for i in range(uavs):
            if motion[b, i] == DESTROYED:
                velocity[b, t, i, 0] = velocity[b, t, i, 1] = velocity[b, t, i, 2] = _ZERO
                continue
            x, y, z = velocity[b, t, i, 0], velocity[b, t, i, 1], velocity[b, t, i, 2]
            bx, by, bz = velocity[b, t - 1, i, 0], velocity[b, t - 1, i, 1], velocity[b, t - 1, i, 2]
            if code == VARIED_SPEED:
                state[b, i, 1] = numbers[0] * state[b, i, 1] + numbers[1] * normals[b, i, 0]
                speed = min(max(state[b, i, 0] * (_ONE + state[b, i, 1]), numbers[2]), numbers[3])
                x, y, z = x * speed, y * speed, z * speed
            elif code == LAGGED:
                share = state[b, i, 0]
                x, y, z = bx + (x - bx) * share, by + (y - by) * share, bz + (z - bz) * share
            elif code == LIMITED:
                speed = np.sqrt(bx * bx + by * by + bz * bz)
                scale = _ONE / max(speed, np.float32(1e-6))
                x, y, z, cosine = _turn(bx * scale, by * scale, bz * scale, x, y, z, state[b, i, 0])
                goal = numbers[0] + (_ONE - numbers[0]) * np.float32(0.5) * (_ONE + cosine)
                speed = min(max(goal, speed - numbers[1]), speed + numbers[1])
                speed = min(max(speed, _ZERO), _ONE)
                x, y, z = x * speed, y * speed, z * speed
            else:
                rise = (state[b, i, 0] - position[b, t, i, 2]) / np.float32(10.0)
                z = min(max(rise, -numbers[0]), numbers[0])
                scale = np.sqrt(_ONE - z * z) / np.sqrt(x * x + y * y + _TINY)
                x, y = x * scale, y * scale
            velocity[b, t, i, 0], velocity[b, t, i, 1], velocity[b, t, i, 2] = x, y, z
            for axis in range(3):
                position[b, t + 1, i, axis] = position[b, t, i, axis] + velocity[b, t, i, axis]
