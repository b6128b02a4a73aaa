"""A small episode, made by hand: two rounds, two clusters and a decoy."""

from typing import Any

import numpy as np

from usnet_env.replay import EpisodeRecord

ROUNDS, SAMPLES, UAVS = 2, 21, 12
HEADS, DECOY = (0, 5), 11
#: Fields of what the detector thought, with one value for each round.
MIND = ("clusters", "leader_estimate", "attention", "probability", "reasons")


def small_episode(**changes: Any) -> EpisodeRecord:
    """Round 1 names head 0 and follower 3; round 2 names head 5. UAV 7 is unseen in half of round 2."""
    rng = np.random.default_rng(3)
    head = np.isin(np.arange(UAVS), HEADS)
    decoy = np.arange(UAVS) == DECOY
    leader = np.array([[0, 0, 0, 0, 0, 5, 5, 5, 5, 5, 5, DECOY], [0, 5, 5, 0, 5, 5, 5, 5, 5, 5, 5, DECOY]])
    candidates = np.zeros((ROUNDS, UAVS), bool)
    candidates[0, [0, 3]] = candidates[1, 5] = True
    alive = np.stack([np.ones(UAVS, bool), ~candidates[0]])
    seen = np.repeat(alive[:, None], SAMPLES, axis=1)
    seen[1, ::2, 7] = False
    velocity = rng.normal(size=(ROUNDS, SAMPLES - 1, UAVS, 3)).astype(np.float32)
    start = rng.uniform((0, 0, 0), (400, 400, 60), (ROUNDS, 1, UAVS, 3)).astype(np.float32)
    position = np.concatenate([start, start + np.cumsum(velocity, axis=1)], axis=1)
    clusters = np.where(leader == DECOY, -1, leader)
    attention = np.where(leader[:, :, None] == np.arange(UAVS), 0.5, 0.0)  # each UAV attends to its leader
    values: dict[str, Any] = {
        "position": position * seen[..., None],
        "velocity": velocity * (seen[:, 1:] & seen[:, :-1])[..., None],
        "seen": seen,
        "alive": alive,
        "root": leader,
        "candidates": candidates,
        "scores": rng.random((ROUNDS, UAVS)) + head,
        "objective": [1 + 1 / UAVS, 2 + 1 / UAVS],
        "head": head,
        "decoy": decoy,
        "over_budget": [False, False],
        "seconds": [0.25, 0.125],
        "clusters": clusters,
        "leader_estimate": leader,
        "attention": attention,
        "probability": 0.1 + 0.8 * head * np.ones((ROUNDS, 1)),
        "reasons": [{"0": "Adds 21 nats to 4 followers.", "3": "Adds 2 nats."}, {"5": "Adds 30 nats."}],
        "problem": "P2",
        "env_id": "USNET/MultiCluster-v0",
        "seed": 0,
        "detector": "by hand",
        "detector_seed": 2**60 + 1,
        "config": {"follow": "f1", "memory": 4, "sample_every": 2, "cluster_sizes": (4, 5), "miss_rate": 0.1},
        "versions": {"numpy": np.__version__},
    }
    return EpisodeRecord(**{**values, **changes})


def large_episode(**changes: Any) -> EpisodeRecord:
    """A round with 60 UAVs; 30, 31 and 40 are heads, 40 and 55 are candidates."""
    head, named = (np.isin(np.arange(60), uavs) for uavs in ((30, 31, 40), (40, 55)))
    shapes = {"position": (1, 21, 60, 3), "velocity": (1, 20, 60, 3), "scores": (1, 60), "decoy": 60, "over_budget": 1}
    values: dict[str, Any] = {name: np.zeros(shape) for name, shape in shapes.items()} | dict.fromkeys(MIND)
    values |= {"seen": np.ones((1, 21, 60)), "alive": np.ones((1, 60)), "objective": [1.0], "seconds": [0.1]}
    values |= {"root": np.where(head, np.arange(60), 30)[None], "candidates": named[None], "head": head}
    return small_episode(**values | changes)
