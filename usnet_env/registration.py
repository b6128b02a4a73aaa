"""The registered ids: environments, and presets of their arguments."""

from __future__ import annotations

from typing import Any

import gymnasium as gym

_LAWS = ["f1", "f2", "f3", "f4", "f5", "f6", "f7"]
_HARD = {
    "follow": "random", "mobility": ["gauss_markov", "smooth_turn", "waypoint"], "head_jitter": True, "decoys": [0, 3],
    "formation": "gathered", "position_noise": 0.1, "observation_steps": 60,
}  # fmt: skip
#: The ladder of games to train on: P1 and P2, from the easiest to the hardest.
LADDER: dict[str, tuple[str, dict[str, Any]]] = {
    "USNET/SingleCluster-Tiny-v0": ("SingleCluster", {"followers": 7, "observation_steps": 20}),
    "USNET/SingleCluster-Small-v0": (
        "SingleCluster",
        {"followers": [5, 9], "decoys": [0, 1], "follow": _LAWS, "observation_steps": 30},
    ),
    "USNET/SingleCluster-Paper-v0": ("SingleCluster", {"follow": _LAWS}),
    "USNET/SingleCluster-Hard-v0": ("SingleCluster", {"followers": [5, 20], **_HARD}),
    "USNET/SingleCluster-Field-v0": (
        "SingleCluster",
        {"distribution": "cluster-field-v1", "followers": [5, 20], "memory": 12},
    ),
    "USNET/MultiCluster-Tiny-v0": (
        "MultiCluster",
        {"clusters": 2, "uavs": 12, "observation_steps": 20, "max_rounds": 5},
    ),
    "USNET/MultiCluster-Small-v0": (
        "MultiCluster",
        {"clusters": [2, 3], "uavs": [16, 24], "follow": _LAWS, "observation_steps": 30, "max_rounds": 5},
    ),
    "USNET/MultiCluster-Paper-v0": ("MultiCluster", {"follow": _LAWS}),
    "USNET/MultiCluster-Hard-v0": ("MultiCluster", {"clusters": [3, 6], "uavs": [40, 60], **_HARD}),
    "USNET/SingleCluster-Led-v0": ("SingleCluster", {"followers": [5, 20], **_HARD, "led_by": (1, 4)}),
    "USNET/MultiCluster-Led-v0": ("MultiCluster", {"clusters": [3, 6], "uavs": [40, 60], **_HARD, "led_by": (1, 4)}),
}
_FIELD: dict[str, Any] = {"distribution": "field-v1", "memory": 12}
_AROUND: dict[str, Any] = _FIELD | {"formation": {"around": 3.0, "uniform": 1.0}}  # heads in the middle
TRACKS = "USNET/Tracks-v0"  # replays a file, which is a required argument; so it has no presets
PROBING = "USNET/Probing-v1"  # its agent also steers intruders
OTHERS = {TRACKS: "usnet_env.tracks.env:TracksEnv", PROBING: "usnet_env.envs.probing:ProbingEnv"}

# id -> (class, arguments). The arguments are what JSON can hold, so that `env.spec.to_json()` is complete.
ENVIRONMENTS: dict[str, tuple[str, dict[str, Any]]] = {
    "USNET/SingleCluster-v0": ("SingleCluster", {}),
    "USNET/SingleCluster-Decoy-v0": ("SingleCluster", {"followers": 5, "decoys": 1}),
    "USNET/MultiCluster-v0": ("MultiCluster", {}),
    "USNET/MultiCluster-M8-v0": ("MultiCluster", {"clusters": 8, "uavs": 185}),
    "USNET/MultiCluster-Smooth-v0": ("MultiCluster", {"mobility": "gauss_markov", "head_jitter": True}),
    "USNET/MultiCluster-NoFollowers-v0": ("MultiCluster", {"follow": "none"}),
    **LADDER,
    "USNET/Field-v1": ("MultiCluster", _FIELD),
    "USNET/Field-Led-v0": ("MultiCluster", _FIELD | {"distribution": "field-led-v1", "led_by": (1, 4)}),
    "USNET/Field-Delays-v0": ("MultiCluster", _AROUND | {"follow": "unequal_delays"}),
    "USNET/Field-Chain-v0": ("MultiCluster", _AROUND | {"follow": "chain"}),
    "USNET/Field-Pigeons-v0": ("MultiCluster", _AROUND | {"follow": "pigeons"}),
    "USNET/Field-Flock-v0": ("MultiCluster", _AROUND | {"follow": "couzin"}),
    "USNET/Field-Shepherd-v0": ("MultiCluster", _AROUND | {"follow": "shepherd"}),
}


def register_environments() -> None:
    """Register all ids with Gymnasium; a second call has no effect."""
    points = {name: (f"usnet_env.envs:{problem}Env", kwargs) for name, (problem, kwargs) in ENVIRONMENTS.items()}
    points |= {name: (point, {}) for name, point in OTHERS.items()}
    for name, (point, kwargs) in points.items():
        if name not in gym.registry:
            batch = point.replace("Env", "VectorEnv")
            gym.register(id=name, entry_point=point, vector_entry_point=batch, kwargs=dict(kwargs))
