"""Draw a picture of each environment and game, docs/images/environments/*.webp: ``python docs/pictures.py``.

Each shows the first window of an episode with the truth: heads as stars, followers in the colour of their head with a
line to it. Names of environments may follow, to draw only these. ``replay`` is none: it takes a picture of the replay
in ``runs/demo``, docs/images/replay-answer.webp, in a viewer without a screen, which needs a driver of Vulkan. Recorded
tracks are those of ``merging.csv``, which ``python examples/make_tracks.py`` writes into the present folder.
"""

from __future__ import annotations

import importlib
import io
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from PIL import Image

import usnet_env.envs  # noqa: F401  # registers the environments
from usnet_env.drawing import draw_round, new_figure, pixels_of
from usnet_env.envs import ENVIRONMENTS
from usnet_env.multiagent import GAMES
from usnet_env.registration import LADDER, TRACKS
from usnet_env.replay.rerun import find_viewer
from usnet_env.tracks import find_leaders, read_tracks

IMAGES = Path(__file__).parent / "images"
FOLDER = IMAGES / "environments"
WALL = ("SingleCluster-Decoy-v0", "MultiCluster-Smooth-v0", "Field-v1")
WALL += ("Field-Chain-v0", "Field-Flock-v0", "usnet_observers_v0")
SEED = 5
TRACKS_SHOWN = "merging.csv"
#: Arguments that let a picture show how UAVs move: heads that turn smoothly, in clusters that stand together.
SMOOTH: dict[str, Any] = {"mobility": "gauss_markov", "head_jitter": True, "formation": "gathered"}
SHOWN = {"SingleCluster-v0": SMOOTH, "SingleCluster-Decoy-v0": SMOOTH, "Tracks-v0": {"path": TRACKS_SHOWN}}
GAMES_SHOWN = {"usnet_observers_v0": SMOOTH, "usnet_evasion_v0": {"formation": "gathered"}}


def start(name: str) -> tuple[dict[str, Any], Any]:
    """The scene that an episode begins with, as arguments of ``draw_round``, and its environment."""
    if name in GAMES:
        game = importlib.import_module(f"usnet_env.multiagent.{name}").parallel_env(
            clusters=3, uavs=30, **GAMES_SHOWN[name]
        )
        windows = game.reset(seed=SEED)[0]
        if name == "usnet_evasion_v0":  # its heads choose how they fly before any UAV is seen; none is named
            zero = {agent: np.zeros_like(game.action_space(agent).sample()) for agent in game.agents}
            windows = game.step(zero)[0]
        windows = [window for window in windows.values() if "seen" in window]
        seen = np.stack([window["seen"] for window in windows]).astype(bool)
        position = np.stack([window["position"] for window in windows]).max(axis=0, where=seen[..., None], initial=-1e9)
        return {"position": position, "seen": seen.any(axis=0), **game.swarm.roles()}, game
    env = gym.make(f"USNET/{name}", **SHOWN.get(name, {})).unwrapped
    window = env.reset(seed=SEED)[0]
    return {"position": window["position"], "seen": window["seen"].astype(bool), **env.swarm.roles()}, env


def draw(name: str) -> Image.Image:
    """A square picture of 480 pixels."""
    from matplotlib.patches import Circle

    scene, env = start(name)
    axes = new_figure(4.8, 4.8).add_axes((0, 0, 1, 0.93))
    figure = draw_round(**scene, axes=axes, legend=False)
    axes.set(xticks=[], yticks=[], xlabel="", ylabel="")
    axes.set_title(f" {name}", fontsize=13)
    observers = env.list_observers() if name in GAMES else None
    for x, y, _, reach in [] if observers is None else observers:
        axes.add_patch(Circle((x, y), reach, fill=False, linestyle="--", color="#0072b2"))
        axes.plot(x, y, marker="^", color="#0072b2", markersize=12)
    return Image.fromarray(pixels_of(figure))


def shoot_replay(replay: str = "runs/demo/replay.rrd", seconds: float = 7.0, port: int = 19876) -> Image.Image:
    """The viewer with a replay at a time of it, without the viewer's own bar."""
    from rerun.experimental import ViewerClient

    words = ["--headless", "--hide-welcome-screen", "--window-size", "1440x760", "--bind", "127.0.0.1"]
    until, client, shot = time.monotonic() + 300, None, None
    with subprocess.Popen([find_viewer(), *words, "--port", str(port), replay]) as viewer:
        while shot is None and time.monotonic() < until and viewer.poll() is None:
            time.sleep(2)
            with suppress(Exception):  # it doesn't listen, or hasn't drawn, yet
                if client is None:
                    client = ViewerClient.connect(f"rerun+http://127.0.0.1:{port}/proxy")
                client.set_time("time", duration=seconds, play_state="paused")
                client.take_screenshot()
                time.sleep(10)  # messages go
                shot = client.take_screenshot()
        viewer.terminate()
    if shot is None:
        raise SystemExit("the viewer took no picture; it needs a driver such as mesa-vulkan-drivers")
    return Image.open(io.BytesIO(shot)).convert("RGB").crop((0, 37, 1440, 760))


def join(pictures: list[Image.Image]) -> Image.Image:
    """Pictures of one size in three columns."""
    width, height = pictures[0].size
    wall = Image.new("RGB", (3 * width, len(pictures) // 3 * height))
    for place, picture in enumerate(pictures):
        wall.paste(picture, (place % 3 * width, place // 3 * height))
    return wall


def main(names: list[str]) -> None:
    """Draw the pictures, the wall of six that README.md shows, that of the ladder, and the timeline of tracks."""
    if names == ["replay"]:
        shoot_replay().save(IMAGES / "replay-answer.webp", quality=80, method=6)
        return
    FOLDER.mkdir(exist_ok=True)
    ids = [name.removeprefix("USNET/") for name in (*ENVIRONMENTS, TRACKS) if name not in LADDER]
    for name in names or [*ids, *GAMES]:
        draw(name).save(FOLDER / f"{name}.webp", quality=80, method=6)
    if not names:
        ladder = [draw(name.removeprefix("USNET/")) for name in LADDER]
        join(ladder).save(IMAGES / "ladder.webp", quality=75, method=6)
        timeline = pixels_of(find_leaders(read_tracks(TRACKS_SHOWN)).plot_timeline())
        Image.fromarray(timeline).save(IMAGES / "timeline.webp", quality=80, method=6)
    wall = [Image.open(FOLDER / f"{name}.webp") for name in WALL]
    join(wall).save(IMAGES / "environments.webp", quality=75, method=6)


if __name__ == "__main__":
    main(sys.argv[1:])
