"""Play one episode, print a line for each round, and keep it as an episode file, a replay and a picture."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from contextlib import closing
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from rich.console import Console

import usnet_env.envs  # noqa: F401  # registers the environments
from usnet_env.config import ArgumentError, quote, whole_number
from usnet_env.drawing import MissingExtraError
from usnet_env.files import as_path, reserve_folder
from usnet_env.plugins import DetectorLike, detector_label, make_detector
from usnet_env.replay.figure import write_picture
from usnet_env.replay.page import write_episode_page
from usnet_env.replay.play import Round, record_episode
from usnet_env.replay.recording import write_recording
from usnet_env.replay.story import describe_outcome
from usnet_env.replay.viewer import find_viewer

_ROW = "{:>5}  {:>10}  {:>9}  {:>9}  {:>10}  {:>7}"


def _format_row(this: Round) -> str:
    row = _ROW.format(this.number, this.candidates, this.hits, this.redundant, this.heads_left, f"{this.seconds:.2f}")
    return row + ("  over the shot budget: no UAV destroyed" if this.over_budget else "")


#: The game of the demo: five clusters of UAVs that fly smoothly. The detector finds three heads in round 1 and names a
#: follower, too; it needs two more rounds for the other heads.
DEMO: dict[str, Any] = {
    "clusters": 5,
    "uavs": 60,
    "follow": "f3",
    "mobility": "gauss_markov",
    "head_jitter": True,
    "formation": "around",
    "observation_steps": 60,
}
#: The paper's example: Algorithm 2 on 8 clusters of 185 UAVs.
PAPER_EXAMPLE: dict[str, Any] = {"clusters": 8, "uavs": 185, "follow": "f1"}
SEED, PAPER_SEED = 3, 1


def run_demo(
    out: str | os.PathLike[str] = "runs/demo",
    *,
    seed: int | None = None,
    detector: str | None = None,
    paper_example: bool = False,
    console: Console | None = None,
    **arguments: Any,
) -> dict[str, Path]:
    """Play one episode of ``USNET/MultiCluster-v0``, print a line for each round, and keep the episode.

    Args:
        out: folder for ``episode.npz`` (the neutral record), ``replay.rrd`` (for the Rerun viewer), ``episode.png`` and
            ``report.html``. Without its extra, a file is left out, and a line says which extra is missing.
        seed: seed of the swarm; the detector's seed is derived from it. ``None``: the seed of the game that shows most.
        detector: name of the detector; ``None``: ``lagged-correlation``, or ``mc-gassl`` with ``paper_example``.
        paper_example: play the paper's example, M = 8 and N = 185 with f1, by Algorithm 2; this takes minutes.
        console: where to print; by default standard output.
        arguments: of the environment, such as ``clusters``, instead of those of :data:`DEMO`.

    Returns:
        The paths of the written files, by ``"episode"``, ``"replay"``, ``"picture"`` and ``"page"``.

    Raises:
        ArgumentError: the environment or the registry of detectors refuses an argument, or ``out`` can't be written to.
    """
    if not isinstance(console, Console | None):
        raise ArgumentError(f"console must be a Console of rich or None, got {quote(console)}.")
    if not isinstance(paper_example, bool):
        raise ArgumentError(f"paper_example must be True or False, got {quote(paper_example)}.")
    console = console or Console()
    folder = as_path("out", out)
    seed = whole_number("seed", (PAPER_SEED if paper_example else SEED) if seed is None else seed, 0)
    usual = "mc-gassl" if paper_example else "lagged-correlation"
    player = make_detector(usual if detector is None else detector)
    game = (PAPER_EXAMPLE if paper_example else DEMO) | arguments
    with closing(gym.make("USNET/MultiCluster-v0", **game)) as env, reserve_folder(folder, "episode.npz"):
        return _play(env, game, seed, player, folder, console)


def _play(
    env: gym.Env[Any, Any], game: Mapping[str, Any], seed: int, player: DetectorLike, folder: Path, console: Console
) -> dict[str, Path]:
    """Play the game, print it, and write its files; the result is that of :func:`run_demo`."""

    def say(text: str = "", style: str | None = None) -> None:
        console.print(text, style=style, markup=False, highlight=False, soft_wrap=True)

    detector_seed = int(np.random.SeedSequence(seed, spawn_key=(1,)).generate_state(1)[0])
    say("Who leads this swarm?", style="bold")
    say(
        f"{game['uavs']} UAVs in {game['clusters']} clusters, follow strategy {game['follow']}, seed {seed}; "
        f"detector {detector_label(player)}."
    )
    say()
    say(_ROW.format("round", "candidates", "heads hit", "redundant", "heads left", "seconds"), style="dim")
    with console.status("playing the episode"):
        record = record_episode(env, player, seed, detector_seed, lambda this: say(_format_row(this)))
    say(f"\n{describe_outcome(record)}\n", style="bold")

    written = {"episode": record.save(folder / "episode.npz")}
    say(f"episode  {written['episode']}  (the whole record; read it with usnet_env.replay.EpisodeRecord.load)")
    makers: dict[str, tuple[Callable[..., Path], str]] = {
        "replay": (write_recording, "replay.rrd"),
        "picture": (write_picture, "episode.png"),
        "page": (write_episode_page, "report.html"),
    }
    for name, (make, file) in makers.items():
        try:
            with console.status(f"writing the {name}"):
                written[name] = make(record, folder / file)
        except MissingExtraError as missing:
            say(f"{name:<7}  left out. {missing}")
        else:
            say(
                f"{name:<7}  {written[name]}"
                + (f"  (open: {find_viewer()} {written[name]})" if name == "replay" else "")
            )
    return written
