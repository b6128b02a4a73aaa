"""The initial swarm: roles, cluster sizes and positions (decision (b) on docs/game.md)."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from usnet_env.config import unknown_name

__all__ = ["ARENA", "AROUND_RADIUS", "Roles", "draw_roles", "formation", "formations", "random_cluster_sizes"]

ARENA = (1000.0, 1000.0, 100.0)  # metres, the box of the paper's simulations
AROUND_RADIUS = 60.0  # metres; equals kappa_r of f6, so that `around` followers start within the range of their head


@dataclass(frozen=True)
class Roles:
    """The role of every UAV in one swarm of N UAVs.

    Args:
        head: ``(N,)`` bool, H_0.
        decoy: ``(N,)`` bool.
        leader: ``(N,)`` int64, the head of each follower; a head's and a decoy's own index.
    """

    head: NDArray[np.bool_]
    decoy: NDArray[np.bool_]
    leader: NDArray[np.int64]


def random_cluster_sizes(rng: np.random.Generator, clusters: int, followers: int) -> NDArray[np.int64]:
    """Draw the number of followers of each cluster, ``(clusters,)`` int64, each at least 2.

    The remaining ``followers - 2 * clusters`` are split at random; all splits are equally likely (stars and bars).
    """
    rest = followers - 2 * clusters
    bars = np.sort(rng.choice(rest + clusters - 1, clusters - 1, replace=False)) if clusters > 1 else np.empty(0, int)
    edges = np.concatenate([[-1], bars, [rest + clusters - 1]])
    return np.diff(edges) - 1 + 2


def draw_roles(
    rng: np.random.Generator, clusters: int, uavs: int, decoys: int, cluster_sizes: tuple[int, ...] | None
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


def _uniform(rng: np.random.Generator, roles: Roles) -> NDArray[np.float64]:
    """All UAVs uniform in the arena."""
    return rng.uniform(0.0, ARENA, (len(roles.leader), 3))


def _around(rng: np.random.Generator, roles: Roles) -> NDArray[np.float64]:
    """Heads and decoys uniform in the arena, followers uniform in a ball of 60 m around their head."""
    uavs = len(roles.leader)
    position = rng.uniform(0.0, ARENA, (uavs, 3))
    direction = rng.standard_normal((uavs, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    offset = AROUND_RADIUS * np.cbrt(rng.uniform(size=(uavs, 1))) * direction
    followers = ~(roles.head | roles.decoy)
    return np.where(followers[:, None], position[roles.leader] + offset, position)


_FORMATIONS: dict[str, Callable[[np.random.Generator, Roles], NDArray[np.float64]]] = {
    "uniform": _uniform,
    "around": _around,
}


def formations() -> Mapping[str, Callable[[np.random.Generator, Roles], NDArray[np.float64]]]:
    """All formations by name (a read-only view)."""
    return MappingProxyType(_FORMATIONS)


def formation(name: str) -> Callable[[np.random.Generator, Roles], NDArray[np.float64]]:
    """The formation called ``name``: a function ``(rng, roles) -> (N, 3)`` positions in metres.

    Raises:
        ArgumentError: there is no formation of this name.
    """
    if not isinstance(name, str) or name not in _FORMATIONS:
        raise unknown_name("formation", name, _FORMATIONS)
    return _FORMATIONS[name]
