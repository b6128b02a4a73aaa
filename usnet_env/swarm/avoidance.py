"""Avoidance: UAVs turn away from intruders, points that fly through the swarm and that are none of its UAVs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from usnet_env.arrays import Singles
from usnet_env.swarm import kernels
from usnet_env.swarm.kinematics import Kinematics


@dataclass(eq=False)
class Avoidance(Kinematics):
    """The kinematics of UAVs that avoid K intruders, on top of another model.

    In place of the direction u a UAV flies norm(u + push Σ_k max(0, 1 − d_k / reach) e_k), where d_k is its distance to
    intruder k and e_k the direction from there (the repulsion zone of Couzin et al. 2002, made soft).

    Args:
        model: how the UAVs fly what they want.
        place: ``(B, K, 3)`` metres, where the intruders are; every step moves them.
        velocity: ``(B, K, 3)``, metres per step.
        reach: metres, the distance from which a UAV avoids an intruder.
        push: weight of the avoidance beside the wanted direction, which has length 1.
        uavs: N; the references of a swarm, which have higher indices, avoid nothing.
    """

    model: Kinematics
    place: Singles
    velocity: Singles
    reach: float
    push: float
    uavs: int

    def __post_init__(self) -> None:
        self.values, self.normals, self.top_speed = self.model.values, self.model.normals, self.model.top_speed

    def fly(
        self, t: int, motion: NDArray[np.int8], normals: Singles, state: Singles, position: Singles, velocity: Singles
    ) -> None:
        """Turn the wanted directions of step ``t``, fly them by the model, and move the intruders."""
        wanted = velocity[:, t, : self.uavs]
        push = find_push(position[:, t, : self.uavs], self.place, self.reach)
        turned = wanted + np.float32(self.push) * push
        turned /= np.maximum(np.linalg.norm(turned, axis=-1, keepdims=True), np.float32(1e-6))
        near = push.any(axis=-1) & (motion[:, : self.uavs] != kernels.DESTROYED)
        wanted[near] = turned[near]
        self.place = self.place + self.velocity
        self.model.fly(t, motion, normals, state, position, velocity)


def find_push(position: Singles, intruders: Singles, reach: float) -> Singles:
    """Σ_k max(0, 1 − d_k / reach) e_k at positions ``(…, N, 3)`` near intruders ``(…, K, 3)``: ``(…, N, 3)``."""
    gap = position[..., :, None, :] - intruders[..., None, :, :]
    distance = np.maximum(np.linalg.norm(gap, axis=-1, keepdims=True), np.float32(1e-6))
    return np.asarray((np.maximum(1 - distance / np.float32(reach), 0) * gap / distance).sum(axis=-2))
