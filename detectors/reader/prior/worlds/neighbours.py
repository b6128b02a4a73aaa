"""The compiled loops over pairs of UAVs."""

from __future__ import annotations

import numpy as np

from usnet_env.arrays import Floats
from usnet_env.compiling import compiled


@compiled(error_model="numpy")
def sum_neighbours(position: Floats, velocity: Floats, weight: Floats, radius: Floats) -> Floats:
    """What the neighbours of each UAV do to it, ``(3, B, n, 3)``: push, mean velocity, mean direction to them.

    ``weight`` ``(B, n, n)`` is the influence of UAV j on UAV i, 0 on the diagonal; means are in units of the sum of its
    sizes. ``radius`` ``(B, 3)``: a push comes from within the first, and so on. A push falls with the distance.
    """
    windows, uavs = position.shape[0], position.shape[1]
    out = np.zeros((3, windows, uavs, 3))
    for b in range(windows):
        for i in range(uavs):
            near_weight, far_weight = 1e-9, 1e-9
            for j in range(uavs):
                w = weight[b, i, j]
                if w == 0.0:
                    continue
                x = position[b, j, 0] - position[b, i, 0]
                y = position[b, j, 1] - position[b, i, 1]
                z = position[b, j, 2] - position[b, i, 2]
                distance = np.sqrt(x * x + y * y + z * z) + 1e-9
                if distance < radius[b, 0]:
                    push = abs(w) * (distance - radius[b, 0]) / (radius[b, 0] * distance)
                    out[0, b, i, 0] += push * x
                    out[0, b, i, 1] += push * y
                    out[0, b, i, 2] += push * z
                if distance < radius[b, 1]:
                    near_weight += abs(w)
                    for k in range(3):
                        out[1, b, i, k] += w * velocity[b, j, k]
                if distance < radius[b, 2]:
                    far_weight += abs(w)
                    out[2, b, i, 0] += w * x / distance
                    out[2, b, i, 1] += w * y / distance
                    out[2, b, i, 2] += w * z / distance
            for k in range(3):
                out[1, b, i, k] /= near_weight
                out[2, b, i, k] /= far_weight
    return out


@compiled(error_model="numpy")
def fly_springs(
    position: Floats, velocity: Floats, spring: Floats, drag: Floats, push: Floats, wall: float, parts: int
) -> None:
    """Fill ``position`` ``(B, T + 1, n, 3)``, the first instant given, from velocities ``(B, n, 3)`` of its start.

    UAV i is pulled towards UAV j by ``spring`` ``(B, n, n)`` times their distance, braked by ``drag`` ``(B,)``, pushed
    by ``push`` ``(B, T, n, 3)``, and reflected by walls at the distance ``wall``. A step has so many parts.
    """
    windows, steps, uavs = push.shape[0], push.shape[1], push.shape[2]
    force, place, step = np.empty((uavs, 3)), np.empty((uavs, 3)), 1.0 / parts
    for b in range(windows):
        place[:] = position[b, 0]
        for t in range(steps):
            for _ in range(parts):
                force[:] = push[b, t] - drag[b] * velocity[b]
                for i in range(uavs):
                    for j in range(uavs):
                        for k in range(3):
                            force[i, k] += spring[b, i, j] * (place[j, k] - place[i, k])
                for i in range(uavs):
                    for k in range(3):
                        velocity[b, i, k] += step * force[i, k]
                        place[i, k] += step * velocity[b, i, k]
                        if abs(place[i, k]) > wall:
                            place[i, k] = np.sign(place[i, k]) * 2.0 * wall - place[i, k]
                            velocity[b, i, k] = -velocity[b, i, k]
            position[b, t + 1] = place
