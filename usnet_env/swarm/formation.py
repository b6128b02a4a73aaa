"""The initial swarm: roles, cluster sizes and positions (decision (b) on docs/game.md)."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from usnet_env.arrays import Floats, Indices, Mask
from usnet_env.config import ArgumentError, quote
from usnet_env.parts import Registry

if TYPE_CHECKING:
    from usnet_env.swarm.config import SwarmConfig

ARENA = (1000.0, 1000.0, 100.0)  # metres, the box of the paper's simulations
CORRIDORS = 3  # of civil traffic
AROUND_RADIUS = 60.0  # metres; equals kappa_r of f6, so that `around` followers start within the range of their head
FARTHEST = max(ARENA) + AROUND_RADIUS  # metres, the largest initial coordinate


@dataclass(frozen=True)
class Roles:
    """The role of every UAV in one swarm of N UAVs.

    Args:
        head: ``(N,)`` bool, H_0.
        decoy: ``(N,)`` bool.
        root: ``(N,)`` int64, the head of each follower; the own index of a head, decoy or bystander; -1 for a UAV of
            a cluster that no UAV leads.
        bystander: ``(N,)`` bool, the UAVs that no head leads, decoys excluded: bystanders, traffic, and the predators
            and drivers of a follow strategy.
        traffic: ``(N,)`` bool, the bystanders that are civil traffic.
        clutter: ``(N,)`` bool, the bystanders that are false tracks, and no UAVs.
        source: ``(N,)`` int64, the UAV that each UAV copies, at first its root; from N on, a reference: a point
            that flies like a head and that no sensor sees.
        drawn: ``(M,)`` int64, the heads as drawn, in the order of the clusters.
        references: R, number of references.
    """

    head: Mask
    decoy: Mask
    root: Indices
    bystander: Mask
    traffic: Mask
    clutter: Mask
    source: Indices
    drawn: Indices
    references: int = 0

    def members(self, cluster: int) -> Indices:
        """The followers of a cluster, as drawn, in the order of their indices."""
        head = self.drawn[cluster]
        return np.flatnonzero((self.root == head) & (np.arange(len(self.root)) != head))


def random_cluster_sizes(rng: np.random.Generator, clusters: int, followers: int) -> Indices:
    """Draw the number of followers of each cluster, ``(clusters,)`` int64, each at least 2.

    The remaining ``followers - 2 * clusters`` are split at random; all splits are equally likely (stars and bars).
    """
    rest = followers - 2 * clusters
    bars = np.sort(rng.choice(rest + clusters - 1, clusters - 1, replace=False)) if clusters > 1 else np.empty(0, int)
    edges = np.concatenate([[-1], bars, [rest + clusters - 1]])
    return np.diff(edges) - 1 + 2


def draw_roles(rng: np.random.Generator, config: SwarmConfig) -> Roles:
    """Draw the roles. Indices are permuted at random, so an index carries no information about the role."""
    uavs, others = config.uavs, (config.bystanders, config.traffic, config.clutter)
    followers = uavs - config.clusters - config.decoys - sum(others)
    sizes = config.cluster_sizes or random_cluster_sizes(rng, config.clusters, followers)
    heads, decoy_indices, followed, alone, civil, false = np.split(
        rng.permutation(uavs), np.cumsum([config.clusters, config.decoys, followers, *others[:2]])
    )
    head, decoy, bystander, in_traffic, in_clutter = (np.zeros(uavs, bool) for _ in range(5))
    head[heads] = True
    decoy[decoy_indices] = True
    bystander[alone] = bystander[civil] = in_traffic[civil] = bystander[false] = in_clutter[false] = True
    root = np.arange(uavs)
    root[followed] = np.repeat(heads, sizes)
    return Roles(head, decoy, root, bystander, in_traffic, in_clutter, root.copy(), heads)


def draw_corridors(rng: np.random.Generator, uavs: int) -> tuple[Floats, Floats]:
    """Draw civil traffic: positions ``(uavs, 3)`` in metres and directions ``(uavs, 3)`` in level, straight corridors.

    Three corridors cross the arena at random places, headings and altitudes. The UAVs of a corridor fly in both
    directions, at most 400 m from its middle, 5 m apart from its axis on average.
    """
    middle = rng.uniform(0.0, ARENA, (CORRIDORS, 3))
    heading = rng.uniform(-np.pi, np.pi, CORRIDORS)
    axis = np.stack([np.cos(heading), np.sin(heading), np.zeros(CORRIDORS)], axis=1)
    corridor = rng.integers(CORRIDORS, size=uavs)
    along = rng.uniform(-400.0, 400.0, (uavs, 1))
    place = middle[corridor] + along * axis[corridor] + rng.normal(0.0, 5.0, (uavs, 3))
    return np.clip(place, -FARTHEST, FARTHEST), axis[corridor] * rng.choice([-1.0, 1.0], (uavs, 1))


def _uniform(rng: np.random.Generator, roles: Roles) -> Floats:
    """All UAVs uniform in the arena."""
    return rng.uniform(0.0, ARENA, (len(roles.root), 3))


def _around(rng: np.random.Generator, roles: Roles) -> Floats:
    """Heads and decoys uniform in the arena, followers uniform in a ball of 60 m around their head."""
    uavs = len(roles.root)
    position = rng.uniform(0.0, ARENA, (uavs, 3))
    direction = rng.standard_normal((uavs, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    offset = AROUND_RADIUS * np.cbrt(rng.uniform(size=(uavs, 1))) * direction
    followers = ~(roles.head | roles.decoy | roles.bystander)
    return np.where(followers[:, None], position[roles.root] + offset, position)


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


#: Register a formation, so that ``formation=name`` selects it; see :meth:`usnet_env.parts.Registry.register`.
register_formation = FORMATIONS.register
