"""The initial swarm: roles, cluster sizes and positions (decision (b) on docs/game.md)."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from usnet_env.arrays import Floats, Indices, Mask
from usnet_env.config import ArgumentError, quote
from usnet_env.registry import Registry

__all__ = [
    "ARENA",
    "AROUND_RADIUS",
    "FORMATIONS",
    "Formation",
    "Roles",
    "check_place",
    "draw_roles",
    "formations",
    "random_cluster_sizes",
    "register_formation",
]

ARENA = (1000.0, 1000.0, 100.0)  # metres, the box of the paper's simulations
AROUND_RADIUS = 60.0  # metres; equals kappa_r of f6, so that `around` followers start within the range of their head
FARTHEST = max(ARENA) + AROUND_RADIUS  # metres, the largest initial coordinate


@dataclass(frozen=True)
class Roles:
    """The role of every UAV in one swarm of N UAVs.

    Args:
        head: ``(N,)`` bool, H_0.
        decoy: ``(N,)`` bool.
        leader: ``(N,)`` int64, the head of each follower; a head's and a decoy's own index.
    """

    head: Mask
    decoy: Mask
    leader: Indices


def random_cluster_sizes(rng: np.random.Generator, clusters: int, followers: int) -> Indices:
    """Draw the number of followers of each cluster, ``(clusters,)`` int64, each at least 2.

    The remaining ``followers - 2 * clusters`` are split at random; all splits are equally likely (stars and bars).
    """
    rest = followers - 2 * clusters
    bars = np.sort(rng.choice(rest + clusters - 1, clusters - 1, replace=False)) if clusters > 1 else np.empty(0, int)
    edges = np.concatenate([[-1], bars, [rest + clusters - 1]])
    return np.diff(edges) - 1 + 2


def draw_roles(
    rng: np.random.Generator, clusters: int, uavs: int, decoys: int, cluster_sizes: Sequence[int] | None
) -> Roles:
    """Draw the roles. Indices are permuted at random, so an index carries no information about the role.

    Args:
        rng: the episode's generator.
        clusters: M.
        uavs: N, decoys included.
        decoys: number of UAVs that move like heads but have no followers.
        cluster_sizes: m_j, number of followers of each cluster, or ``None``: drawn at random.
    """
    sizes = (
        np.asarray(cluster_sizes)
        if cluster_sizes is not None
        else random_cluster_sizes(rng, clusters, uavs - clusters - decoys)
    )
    order = rng.permutation(uavs)
    heads, decoy_indices, followers = order[:clusters], order[clusters : clusters + decoys], order[clusters + decoys :]
    head, decoy = np.zeros(uavs, bool), np.zeros(uavs, bool)
    head[heads] = True
    decoy[decoy_indices] = True
    leader = np.arange(uavs)
    leader[followers] = np.repeat(heads, sizes)
    return Roles(head, decoy, leader)


def _uniform(rng: np.random.Generator, roles: Roles) -> Floats:
    """All UAVs uniform in the arena."""
    return rng.uniform(0.0, ARENA, (len(roles.leader), 3))


def _around(rng: np.random.Generator, roles: Roles) -> Floats:
    """Heads and decoys uniform in the arena, followers uniform in a ball of 60 m around their head."""
    uavs = len(roles.leader)
    position = rng.uniform(0.0, ARENA, (uavs, 3))
    direction = rng.standard_normal((uavs, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    offset = AROUND_RADIUS * np.cbrt(rng.uniform(size=(uavs, 1))) * direction
    followers = ~(roles.head | roles.decoy)
    return np.where(followers[:, None], position[roles.leader] + offset, position)


Formation = Callable[[np.random.Generator, Roles], Floats]


def check_place(what: str, place: Any, count: int) -> Floats:
    """Return the positions ``(count, 3)`` that a formation or placement has drawn.

    Raises:
        ArgumentError: another shape, or a coordinate that is not finite or is beyond the bounds of observations.
    """
    values = np.asarray(place, np.float64)
    if values.shape != (count, 3):
        raise ArgumentError(f"{what} function must return an array of shape {(count, 3)}, got {values.shape}.")
    if not (np.abs(values) <= FARTHEST).all():
        raise ArgumentError(f"{what} function must return coordinates from -{FARTHEST:g} to {FARTHEST:g} m.")
    return values


def _check_formation(function: Any, subject: str = "function") -> Any:
    if not callable(function) or isinstance(function, type):
        raise ArgumentError(f"{subject} must be a function (rng, roles) -> (N, 3), got {quote(function)}.")
    return function


#: All formations by name: functions ``(rng, roles) -> (N, 3)``, positions in metres.
FORMATIONS = Registry[Formation](
    "formation",
    "formation",
    "usnet.formations",
    __name__,
    _check_formation,
    {"uniform": _uniform, "around": _around},
)


def formations() -> Mapping[str, Formation]:
    """All formations by name (a read-only view)."""
    return FORMATIONS


#: Register a formation, so that ``formation=name`` selects it; see :meth:`usnet_env.registry.Registry.register`.
register_formation = FORMATIONS.register
