"""Open recordings in the Rerun viewer, or take pictures of it without a screen."""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

from usnet_env.config import ArgumentError, how_to_install, quote, whole_number
from usnet_env.drawing import MissingExtraError
from usnet_env.files import as_path, atomic_write
from usnet_env.replay.episode import EpisodeRecord
from usnet_env.replay.scribe import Clock

_START_SECONDS, _LEAST_SECONDS, _MOST_SECONDS = 60.0, 4.0, 30.0


def find_viewer() -> str:
    """The command that opens a replay: ``rerun`` if the shell finds it, else the path of the one beside this Python."""
    beside = Path(sys.executable).with_name("rerun")
    return "rerun" if shutil.which("rerun") or not beside.exists() else os.path.relpath(beside)


def _start(*words: str) -> subprocess.Popen[bytes]:
    """Start the viewer; its output is discarded, so that it writes nothing into the terminal of another program."""
    try:
        return subprocess.Popen(
            [find_viewer(), *words],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )
    except FileNotFoundError:
        raise MissingExtraError(f"The viewer needs rerun-sdk; {how_to_install('replay')}.") from None


def open_replay(*paths: str | os.PathLike[str]) -> None:
    """Open recordings in the Rerun viewer, in a process that continues after this one.

    Args:
        paths: their files.
    """
    _start(*(os.fspath(path) for path in paths))


def find_time(record: EpisodeRecord, number: int, step: int | None = None) -> float:
    """The time in a recording, in seconds, of a step of a round.

    Args:
        record: the episode of the recording.
        number: the round, from 1.
        step: the step in the window of the round, from 0; ``None``: when the answer has been given.

    Raises:
        ArgumentError: no such round or step.
    """
    r = whole_number("round", number, 1, record.rounds) - 1
    clock = Clock(record)
    if step is None:
        return float(clock.seconds[r, clock.answer])
    flown = clock.steps[r, : clock.samples] - clock.steps[r, 0]
    whole_number("step", step, 0, int(flown[-1]))
    return float(clock.seconds[r, int(np.searchsorted(flown, step, side="right")) - 1])


def check_screenshot(path: str | os.PathLike[str]) -> Path:
    """The place of a screenshot, which is a PNG.

    Raises:
        ArgumentError: the name has another ending.
    """
    place = as_path("screenshot", path)
    if place.suffix.lower() != ".png":
        raise ArgumentError(f"screenshot must end in .png, got {quote(str(place))}.")
    return place


def take_screenshot(recordings: list[Path], path: str | os.PathLike[str], seconds: float) -> Path:
    """Take a picture of the viewer at a time of the timeline ``time``; no screen is needed, but a Vulkan driver is.

    The viewer listens on the loopback address only, and ends with the call.

    Args:
        recordings: the files that it opens.
        path: the file to write, ``.png``; an existing file is replaced.
        seconds: the time in the recording.

    Returns:
        The path.

    Raises:
        ArgumentError: the name has another ending, the viewer cannot be started, for example because there is no
            graphics driver, or the place can't be written to.
        MissingExtraError: rerun-sdk is not installed.
    """
    place = check_screenshot(path)
    try:
        import rerun  # noqa: F401
    except ImportError:
        raise MissingExtraError(f"The viewer needs rerun-sdk; {how_to_install('replay')}.") from None
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    options = ("--headless", "--hide-welcome-screen", "--bind", "127.0.0.1", "--port", str(port))
    viewer = _start(*options, *(os.fspath(each) for each in recordings))
    try:
        client = _connect(f"rerun+http://127.0.0.1:{port}/proxy", viewer, len(recordings))
        client.set_time("time", duration=seconds, play_state="paused")
        picture = _wait_for_picture(client)
    finally:
        with contextlib.suppress(ProcessLookupError):  # it has ended
            os.killpg(viewer.pid, signal.SIGKILL)  # the command and the viewer that it starts
        viewer.wait()
    with atomic_write(place) as aside:
        aside.write_bytes(picture)
    return place


def _wait_for_picture(client: Any) -> bytes:
    """Wait until the viewer has loaded all data and its messages have gone: two pictures in a row are equal."""
    began, last = time.monotonic(), b""
    while True:
        time.sleep(1.0)
        picture: bytes = client.take_screenshot()
        spent = time.monotonic() - began
        if (picture == last and spent > _LEAST_SECONDS) or spent > _MOST_SECONDS:
            return picture
        last = picture


def _connect(url: str, viewer: subprocess.Popen[bytes], count: int) -> Any:
    """Wait until the viewer has opened ``count`` recordings, and return a client of it."""
    from rerun.experimental import ViewerClient

    until = time.monotonic() + _START_SECONDS
    while time.monotonic() < until and viewer.poll() is None:
        try:
            client = ViewerClient.connect(url)
            opened = client.get_state().recordings
            if len(opened) >= count and all(each.timelines for each in opened):
                return client
        except Exception:  # it does not listen yet
            pass
        time.sleep(0.2)
    raise ArgumentError(
        f"screenshot must be taken where the Rerun viewer starts without a screen, got {quote(find_viewer())}, which "
        "did not start; it needs a Vulkan driver, such as Debian's mesa-vulkan-drivers."
    )
