"""Draw a picture of each environment and game, docs/images/environments/*.webp: ``python docs/pictures.py``.

Each shows the first window of an episode with the truth: heads as stars, followers in the colour of their head with a
line to it. Those named ``…-moving`` show a whole game. Names of pictures may follow, to draw only these. ``replay`` is
none: it takes pictures of the replay in ``runs/demo`` and of one of evasion, docs/images/replay-*.webp, in a viewer
without a screen, which needs a driver of Vulkan. Recorded tracks are those of ``merging.csv``, which ``python
examples/make_tracks.py`` writes into the present folder.
"""

from __future__ import annotations

import importlib
import io
import os
import signal
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
from usnet_env import make_detector
from usnet_env.drawing import Limits, draw_round, limits_around, new_figure, pixels_of
from usnet_env.envs import ENVIRONMENTS
from usnet_env.envs.probers import Prober
from usnet_env.multiagent import GAMES, usnet_evasion_v0, usnet_observers_v0
from usnet_env.multiagent.play import play_game
from usnet_env.multiagent.policies import DetectorObserver, RandomHead
from usnet_env.registration import LADDER, TRACKS
from usnet_env.replay import EpisodeRecord, record_episode, write_recording
from usnet_env.replay.animate import VERDICT, WATCH, describe_frame, list_scenes
from usnet_env.replay.record import record_probe
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
GAME_SEED, RANGE = 0, 200.0


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


def paint(title: str, scene: dict[str, Any], observers: Any = None, limits: Limits | None = None) -> Image.Image:
    """A square picture of 480 pixels; ``observers`` ``(K, 4)`` are their places and ranges."""
    from matplotlib.patches import Circle

    axes = new_figure(4.8, 4.8).add_axes((0.01, 0.01, 0.98, 0.92))
    limits = limits or limits_around(scene["position"][scene["seen"] & scene["alive"]], 0.08)
    figure = draw_round(**scene, axes=axes, legend=False, limits=limits)
    axes.set(xticks=[], yticks=[], xlabel="", ylabel="")
    axes.set_title(f" {title}", fontsize=13)
    for x, y, _, reach in [] if observers is None else observers:
        axes.add_patch(Circle((x, y), reach, fill=False, linestyle="--", color="#0072b2"))
        axes.plot(x, y, marker="^", color="#0072b2", markersize=12)
    return Image.fromarray(pixels_of(figure))


def draw(name: str) -> Image.Image:
    """The first window of an environment or game."""
    scene, env = start(name)
    return paint(name, scene, env.list_observers() if name in GAMES else None)


class Sweeper(DetectorObserver):
    """Names what a detector names in its own window, and flies to and fro along the second axis."""

    def reset(self, seed: int, action_space: Any) -> None:
        """Start a game, in which ``places`` are those at the end of each window."""
        super().reset(seed, action_space)
        self.places, self.way = list[Any](), 1.0

    def act(self, observation: Any) -> Any:
        """Vote, and fly on; turn before the border is nearer than the range."""
        self.places.append(observation["place"])
        if not 200 < observation["place"][1] + 100 * self.way < 800:
            self.way = -self.way
        action = super().act(observation)
        action[-2] = self.way
        return action


def play_rounds() -> tuple[EpisodeRecord, Any]:
    """P2 with a detector that needs several rounds."""
    game = {"clusters": 4, "uavs": 40, "follow": "f3", "formation": "gathered", "observation_steps": 60}
    env = gym.make("USNET/MultiCluster-Smooth-v0", **game)
    return record_episode(env, make_detector("lagged-correlation"), seed=GAME_SEED, detector_seed=1), None


def play_probing() -> tuple[EpisodeRecord, Any]:
    """An intruder tests decoys that fly as the head."""
    env = gym.make("USNET/Probing-v1", followers=9, decoys=3, mobility="alike")
    return record_probe(env, Prober(), seed=GAME_SEED), None


def play_search() -> tuple[EpisodeRecord, Any]:
    """Observers that fly, and where each is at the end of each window ``(R, K, 3)``."""
    game = {"observers": 3, "sensing_range": RANGE, "observer_speed": 4.0, "observation_steps": 30}
    env = usnet_observers_v0.parallel_env(**game, clusters=3, uavs=30, formation="gathered")
    agents = {name: Sweeper("reader(policy='map')") for name in env.possible_agents}
    record = EpisodeRecord(**play_game(env, agents, GAME_SEED).record)
    return record, np.stack([agent.places for agent in agents.values()], axis=1)


def draw_moving(name: str) -> None:
    """Write the game of a picture that moves; it begins with the last frame, which stays where nothing may move."""
    record, places = MOVING[name]()
    visible = record.position[record.seen & record.alive[:, None]]
    limits = limits_around(visible, 0.1) if places is None else (500.0, 500.0, 550.0)
    frames, times = list[Image.Image](), list[int]()
    for scene in list_scenes(record, 12 if record.rounds > 1 else 30):
        shown, observers, r = describe_frame(record, scene), None, scene.round - 1
        if scene.phase == WATCH and not record.seen[r, scene.samples - 1].any():  # the head was named before
            continue
        if scene.phase == VERDICT:
            shown["candidates"] = record.candidates[r]
        if places is not None:
            share = (scene.samples - 1) / (record.position.shape[1] - 1)
            here = places[max(r - 1, 0)] * (1 - share) + places[r] * share
            observers = np.insert(here, 3, RANGE, axis=1)
        title = name.removesuffix("-moving") + f": round {scene.round}" * (record.rounds > 1)
        frames.append(paint(title, shown, observers, limits))
        times.append(1800 if scene.phase == VERDICT else 200)
    style: dict[str, Any] = {"quality": 60, "method": 6, "minimize_size": True, "loop": 0}
    style |= {"append_images": frames[:-1], "duration": [times[-1], *times[:-1]]}
    frames[-1].save(FOLDER / f"{name}.webp", save_all=True, **style)


MOVING = {
    "MultiCluster-Smooth-v0-moving": play_rounds,
    "Probing-v1-moving": play_probing,
    "usnet_observers_v0-moving": play_search,
}


def shoot_replay(replay: str, seconds: float, port: int = 19876) -> Image.Image:
    """The viewer with a replay at a time of it, without the viewer's own bar."""
    from rerun.experimental import ViewerClient

    words = ["--headless", "--hide-welcome-screen", "--window-size", "1440x760", "--bind", "127.0.0.1"]
    until, client, shot = time.monotonic() + 300, None, None
    command = [find_viewer(), *words, "--port", str(port), replay]
    with subprocess.Popen(command, start_new_session=True) as viewer:  # a script, which starts the viewer
        while shot is None and time.monotonic() < until and viewer.poll() is None:
            time.sleep(2)
            with suppress(Exception):  # it doesn't listen, or hasn't drawn, yet
                if client is None:
                    client = ViewerClient.connect(f"rerun+http://127.0.0.1:{port}/proxy")
                client.set_time("time", duration=seconds, play_state="paused")
                client.take_screenshot()
                time.sleep(10)  # messages go
                shot = client.take_screenshot()
        os.killpg(viewer.pid, signal.SIGTERM)
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
        game = usnet_evasion_v0.parallel_env(clusters=3, uavs=40, formation="gathered", max_rounds=5)
        policies = {"observer": DetectorObserver("lagged-correlation"), "head": RandomHead()}
        record = EpisodeRecord(**play_game(game, policies, GAME_SEED).record)
        write_recording(record, "runs/demo/evasion.rrd")
        for name, replay, seconds in (("answer", "replay", 22.0), ("evasion", "evasion", 9.0)):
            picture = shoot_replay(f"runs/demo/{replay}.rrd", seconds)
            picture.save(IMAGES / f"replay-{name}.webp", quality=80, method=6)
        return
    FOLDER.mkdir(exist_ok=True)
    ids = [name.removeprefix("USNET/") for name in (*ENVIRONMENTS, TRACKS) if name not in LADDER]
    for name in names or [*ids, *GAMES, *MOVING]:
        if name in MOVING:
            draw_moving(name)
        else:
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
