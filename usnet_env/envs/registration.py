"""The registered ids: environments, and presets of their arguments."""

from __future__ import annotations

from typing import Any

import gymnasium as gym

TRACKS = "USNET/Tracks-v0"  # replays a file, which is a required argument; so it has no presets
PROBING = "USNET/Probing-v0"  # its agent also steers intruders
OTHERS = {TRACKS: "usnet_env.tracks.env:TracksEnv", PROBING: "usnet_env.envs.probing:ProbingEnv"}

# id -> (class, arguments). The arguments are plain names and numbers, so that `env.spec.to_json()` is complete.
ENVIRONMENTS: dict[str, tuple[str, dict[str, Any]]] = {
    "USNET/SingleCluster-v0": ("SingleCluster", {}),
    "USNET/SingleCluster-Decoy-v0": ("SingleCluster", {"followers": 5, "decoys": 1}),
    "USNET/MultiCluster-v0": ("MultiCluster", {}),
    "USNET/MultiCluster-M8-v0": ("MultiCluster", {"clusters": 8, "uavs": 185}),
    "USNET/MultiCluster-Smooth-v0": ("MultiCluster", {"mobility": "gauss_markov", "head_jitter": True}),
    "USNET/MultiCluster-NoFollowers-v0": ("MultiCluster", {"follow": "none"}),
    "USNET/Field-v0": ("Field", {}),
    "USNET/Field-v1": ("Field", {"distribution": 2}),
    "USNET/Field-Delays-v0": ("Field", {"follow": "unequal_delays"}),
    "USNET/Field-Chain-v0": ("Field", {"follow": "chain"}),
    "USNET/Field-Pigeons-v0": ("Field", {"follow": "pigeons"}),
    "USNET/Field-Flock-v0": ("Field", {"follow": "couzin"}),
    "USNET/Field-Shepherd-v0": ("Field", {"follow": "shepherd"}),
}


def register_environments() -> None:
    """Register all ids with Gymnasium; a second call has no effect."""
    for name, (problem, arguments) in ENVIRONMENTS.items():
        if name not in gym.registry:
            gym.register(
                id=name,
                entry_point=f"usnet_env.envs:{problem}Env",
                vector_entry_point=f"usnet_env.envs:{problem}VectorEnv",
                kwargs=dict(arguments),
            )
    for name, entry_point in OTHERS.items():
        if name not in gym.registry:
            gym.register(id=name, entry_point=entry_point)
