"""Play one episode, print a line for each round, and keep it as an episode file, a replay, a picture and a page."""

from __future__ import annotations

import os
from contextlib import closing
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

import usnet_env.envs  # noqa: F401  # registers the environments
from usnet_env.config import MissingExtraError, whole_number
from usnet_env.files import as_path, reserve_folder
from usnet_env.plugins import detector_label, make_detector
from usnet_env.replay.figure import write_picture
from usnet_env.replay.page import write_page
from usnet_env.replay.record import record_episode
from usnet_env.replay.rerun import find_viewer, write_recording
from usnet_env.replay.story import describe_outcome, describe_round

#: The game of the demo: five clusters of UAVs that fly smoothly. The detector finds three heads in round 1 and names a
#: follower, too; it needs two more rounds for the other heads.
DEMO: dict[str, Any] = {"clusters": 5, "uavs": 60, "follow": "f3", "formation": "around", "observation_steps": 60}
DEMO |= {"mobility": "gauss_markov", "head_jitter": True}


def run_demo(
    out: str | os.PathLike[str] = "runs/demo", *, seed: int = 3, detector: str = "lagged-correlation", **arguments: Any
) -> dict[str, Path]:
    """Play and print one episode of ``USNET/MultiCluster-v0``, and return the paths of its files by what they are.

    Args:
        out: folder for ``episode.npz``, ``replay.rrd``, ``episode.png`` and ``report.html``. A file whose extra is not
            installed is left out, and a line says so.
        seed: seed of the swarm; the detector's seed is derived from it.
        detector: name of the detector.
        arguments: of the environment, such as ``clusters``, instead of those of :data:`DEMO`.
    """
    folder, game, seed = as_path("out", out), DEMO | arguments, whole_number("seed", seed, 0)
    player = make_detector(detector)
    detector_seed = int(np.random.SeedSequence(seed, spawn_key=(1,)).generate_state(1)[0])
    with closing(gym.make("USNET/MultiCluster-v0", **game)) as env:
        reserve_folder(folder)
        swarm = f"{game['uavs']} UAVs in {game['clusters']} clusters, follow strategy {game['follow']}, seed {seed}"
        print(f"Who leads this swarm?\n{swarm}; detector {detector_label(player)}.\n")
        record = record_episode(env, player, seed, detector_seed)
    for number, seconds in enumerate(record.seconds, start=1):
        print(f"round {number}: {describe_round(record, number)}; {seconds:.2f} s")
    print(f"\n{describe_outcome(record)}\n")
    paths = {"episode": record.save(folder / "episode.npz")}
    print(f"episode  {paths['episode']}  (the whole record; read it with usnet_env.replay.EpisodeRecord.load)")
    writers = (("replay", write_recording), ("picture", write_picture), ("page", write_page))
    for (name, write), file in zip(writers, ("replay.rrd", "episode.png", "report.html"), strict=True):
        try:
            paths[name] = write(record, folder / file)
        except MissingExtraError as error:
            print(f"{name:<7}  left out. {error}")
        else:
            hint = f"  (open: {find_viewer()} {paths[name]})" if name == "replay" else ""
            print(f"{name:<7}  {paths[name]}{hint}")
    return paths
