"""Play one episode, print a line for each round, and keep it as an episode file, a replay and a picture."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import gymnasium as gym
import numpy as np
from rich.console import Console

import usnet_env.envs  # noqa: F401  # registers the environments
from usnet_env.config import ArgumentError, quote, whole_number
from usnet_env.drawing import MissingExtraError
from usnet_env.files import as_path
from usnet_env.plugins import detector_label, make_detector
from usnet_env.replay.figure import write_picture
from usnet_env.replay.play import Round, record_episode
from usnet_env.replay.recording import write_recording
from usnet_env.replay.story import describe_outcome

__all__ = ["open_replay", "run_demo"]

_ROW = "{:>5}  {:>10}  {:>9}  {:>9}  {:>10}  {:>7}"


def _format_row(this: Round) -> str:
    row = _ROW.format(this.number, this.candidates, this.hits, this.redundant, this.heads_left, f"{this.seconds:.2f}")
    return row + ("  over the shot budget: no UAV destroyed" if this.over_budget else "")


def _find_viewer() -> str:
    """The command that opens a replay: ``rerun`` if the shell finds it, else the path of the one beside this Python."""
    beside = Path(sys.executable).with_name("rerun")
    return "rerun" if shutil.which("rerun") or not beside.exists() else os.path.relpath(beside)


def open_replay(path: str | os.PathLike[str]) -> None:
    """Open a replay in the Rerun viewer, in a process that continues after this one.

    Args:
        path: the file of the replay.
    """
    # The output is discarded, so that the viewer writes nothing into the terminal of a program that has ended.
    subprocess.Popen(
        [_find_viewer(), os.fspath(path)],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )


def run_demo(
    out: str | os.PathLike[str] = "runs/demo",
    *,
    clusters: int = 8,
    uavs: int = 185,
    follow: str = "f1",
    seed: int = 0,
    detector: str = "follow-mixture",
    console: Console | None = None,
) -> dict[str, Path]:
    """Play one episode of ``USNET/MultiCluster-v0``, print a line for each round, and keep the episode.

    Args:
        out: folder for ``episode.npz`` (the neutral record), ``replay.rrd`` (for the Rerun viewer) and ``episode.png``.
            Without its extra, a replay or picture is left out, and a line says which extra is missing.
        clusters: M.
        uavs: N.
        follow: name of the follow strategy.
        seed: seed of the swarm; the detector's seed is derived from it.
        detector: name of the detector.
        console: where to print; by default standard output.

    Returns:
        The paths of the written files, by ``"episode"``, ``"replay"`` and ``"picture"``.

    Raises:
        ArgumentError: the environment or the registry of detectors refuses an argument, or ``out`` can't be written to.
    """
    if not isinstance(console, Console | None):
        raise ArgumentError(f"console must be a Console of rich or None, got {quote(console)}.")
    console = console or Console()
    folder = as_path("out", out)

    def say(text: str = "", style: str | None = None) -> None:
        console.print(text, style=style, markup=False, highlight=False, soft_wrap=True)

    seed = whole_number("seed", seed, 0)
    player = make_detector(detector)
    env = gym.make("USNET/MultiCluster-v0", clusters=clusters, uavs=uavs, follow=follow)
    detector_seed = int(np.random.SeedSequence(seed, spawn_key=(1,)).generate_state(1)[0])
    say("Who leads this swarm?", style="bold")
    say(
        f"{uavs} UAVs in {clusters} clusters, follow strategy {follow}, seed {seed}; detector {detector_label(player)}."
    )
    say()
    say(_ROW.format("round", "candidates", "heads hit", "redundant", "heads left", "seconds"), style="dim")
    with env, console.status("playing the episode"):
        record = record_episode(env, player, int(seed), detector_seed, lambda this: say(_format_row(this)))
    say(f"\n{describe_outcome(record)}\n", style="bold")

    written = {"episode": record.save(folder / "episode.npz")}
    say(f"episode  {written['episode']}  (the whole record; read it with usnet_env.replay.EpisodeRecord.load)")
    makers = {"replay": (write_recording, "replay.rrd"), "picture": (write_picture, "episode.png")}
    for name, (make, file) in makers.items():
        try:
            with console.status(f"writing the {name}"):
                written[name] = make(record, folder / file)
        except MissingExtraError as missing:
            say(f"{name:<7}  left out. {missing}")
        else:
            say(
                f"{name:<7}  {written[name]}"
                + (f"  (open: {_find_viewer()} {written[name]})" if name == "replay" else "")
            )
    return written
