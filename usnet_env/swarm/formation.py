"""Where a swarm starts: formations, and the corridors of civil traffic (decision (b) on docs/game.md)."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from usnet_env.arrays import Floats
from usnet_env.parts import Registry, check_factory
from usnet_env.swarm.state import Roles

ARENA = (1000.0, 1000.0, 100.0)  # metres, the box of the paper's simulations
_SIZE = np.array(ARENA)
CORRIDORS = 3  # of civil traffic
AROUND_RADIUS = 60.0  # metres; equals kappa_r of f6, so that `around` followers start within the range of their head
FARTHEST = max(ARENA) + AROUND_RADIUS  # metres, the largest initial coordinate


def draw_corridors(rng: np.random.Generator, uavs: int) -> tuple[Floats, Floats]:
    """Draw civil traffic: positions ``(uavs, 3)`` in metres and directions ``(uavs, 3)`` in level, straight corridors.

    The UAVs of a corridor fly in both directions, at most 400 m from its middle, 5 m apart from its axis on average.
    """
    centre = rng.random((CORRIDORS, 3)) * _SIZE
    heading = rng.uniform(-np.pi, np.pi, CORRIDORS)
    axis = np.array([np.cos(heading), np.sin(heading), np.zeros(CORRIDORS)]).T
    corridor = rng.integers(CORRIDORS, size=uavs)
    distance = rng.uniform(-400.0, 400.0, (uavs, 1))
    position = centre[corridor] + distance * axis[corridor] + rng.normal(0.0, 5.0, (uavs, 3))
    position = np.minimum(np.maximum(position, -FARTHEST), FARTHEST)
    return position, axis[corridor] * (2.0 * rng.integers(2, size=(uavs, 1)) - 1.0)


def _uniform(rng: np.random.Generator, roles: Roles) -> Floats:
    """All UAVs uniform in the arena."""
    return np.asarray(rng.random((len(roles.root), 3)) * _SIZE)


def draw_offsets(rng: np.random.Generator, uavs: int) -> Floats:
    """Draw points ``(uavs, 3)`` uniform in a ball of 60 m around the origin."""
    direction = rng.standard_normal((uavs, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    return np.asarray(AROUND_RADIUS * np.cbrt(rng.uniform(size=(uavs, 1))) * direction)


def _around(rng: np.random.Generator, roles: Roles) -> Floats:
    """Heads and decoys uniform in the arena, followers uniform in a ball of 60 m around their head."""
    uavs = len(roles.root)
    position = rng.random((uavs, 3)) * _SIZE
    offset = draw_offsets(rng, uavs)
    followers = ~(roles.head | roles.decoy | roles.not_led)
    return np.where(followers[:, None], position[roles.root] + offset, position)


def _gathered(rng: np.random.Generator, roles: Roles) -> Floats:
    """All UAVs of a cluster, the head too, uniform in one ball of 60 m, decoys and bystanders in that of any cluster.

    The middles of the balls are uniform in the arena, and so are traffic and false tracks. Unlike in ``around``, no
    position tells a head from its followers.
    """
    uavs, heads = len(roles.root), roles.initial_heads
    position, offset = rng.random((uavs, 3)) * _SIZE, draw_offsets(rng, uavs)
    ball = np.where(roles.decoy | roles.not_led, heads[rng.integers(len(heads), size=uavs)], roles.root)
    return np.where((roles.traffic | roles.clutter)[:, None], position, offset + position[ball])


Formation = Callable[[np.random.Generator, Roles], Floats]
_BUILT_IN: dict[str, Formation] = {"uniform": _uniform, "around": _around, "gathered": _gathered}

#: All formations by name: functions ``(rng, roles) -> (N, 3)``, positions in metres, at most 1060 m on each axis.
FORMATIONS = Registry[Formation]("formation", "formation", "usnet.formations", __name__, check_factory, _BUILT_IN)

#: Register a formation, so that ``formation=name`` selects it; see :meth:`usnet_env.parts.Registry.register`.
register_formation = FORMATIONS.register
