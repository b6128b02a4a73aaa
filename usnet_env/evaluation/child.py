"""A detector in a child process, which guards a run against accidents: a crash, an endless loop, too much memory.

Parent and child exchange arrays as ``npz`` bytes. What comes from the child is never unpickled.
"""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import time
from collections.abc import Mapping
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from typing import Any

import numpy as np

from usnet_env.detection import Detection
from usnet_env.evaluation.agents import Answer, as_agent
from usnet_env.evaluation.errors import ChildError, describe_failure
from usnet_env.evaluation.tasks import become_worker, dumps, limit_memory, loads, pack, unpack
from usnet_env.window import Window

_ALONE = "observation"  # the name of an observation that is no mapping

Arrays = Mapping[str, Any]


class ChildDetector:
    """A detector or a policy in a process of its own, as a detector and as an agent.

    The process starts with the first call, and again after it has ended. It gets a copy of the detector. The seconds of
    an answer include the way there and back.

    Args:
        detector: a name as :func:`usnet_env.make_detector` takes it, or an object.
        seconds: largest wall time of one call; ``None``: no limit. A process that exceeds it is killed.
        megabytes: memory in 10^6 bytes that one call may allocate beyond what the process holds; ``None``: no limit.
            Linux only.

    Raises:
        ChildError: by each call: the detector raised an exception, exceeded a limit, or ended its process.
    """

    def __init__(self, detector: Any, seconds: float | None = None, megabytes: float | None = None) -> None:
        self._payload = np.frombuffer(dumps(detector), np.uint8)
        self._seconds, self._megabytes = seconds, megabytes
        self._process: subprocess.Popen[bytes] | None = None

    def start(self) -> None:
        """Start the process, and make the detector there."""
        self._connection, theirs = Pipe()
        command = "import sys; sys.path[:] = sys.argv[2:]; from usnet_env.evaluation import child; child.serve()"
        with theirs:
            self._process = subprocess.Popen(
                [sys.executable, "-c", command, str(theirs.fileno()), *sys.path],
                stdin=subprocess.DEVNULL,
                pass_fds=[theirs.fileno()],
                env={"OMP_NUM_THREADS": "1", **os.environ},
            )
        try:
            self._receive(None)  # it has imported what it needs
            self._connection.send_bytes(pack({"megabytes": self._megabytes}, {"detector": self._payload}))
            self._receive(None)
        except ChildError:
            self.close()
            raise

    @property
    def running(self) -> bool:
        """Whether the process has started, and has not ended."""
        return self._process is not None

    def reset(self, seed: int | None = None) -> None:
        """Start an episode."""
        self._call("reset", seed=seed)

    def detect(self, window: Window) -> Detection:
        """Return the candidates, scores and clusters of the answer to a window."""
        fields = {name: getattr(window, name) for name in ("position", "velocity", "seen", "alive", "round", "step")}
        return Detection(**self._call("answer", {name: part for name, part in fields.items() if part is not None}))

    def answer(self, observation: Any) -> Answer:
        """Return the answer to one observation."""
        begin = time.perf_counter()
        parts = self._call("answer", observation)
        return Answer(**{"clusters": None, **parts}, seconds=time.perf_counter() - begin)

    def warm_up(self, observation: Any) -> None:
        """Answer once without being timed."""
        self._call("warm_up", observation)

    def close(self) -> None:
        """End the process."""
        if self._process is not None:
            self._process.kill()
            self._process.wait()
            self._connection.close()
            self._process = None

    def _call(self, name: str, observation: Any = None, seed: int | None = None) -> dict[str, Any]:
        if not self.running:
            self.start()
        single = observation is not None and not isinstance(observation, Mapping)
        with contextlib.suppress(BrokenPipeError):  # it has ended: receiving says why
            arrays = {_ALONE: observation} if single else observation or {}
            self._connection.send_bytes(pack({"call": name, "seed": seed}, arrays))
        return self._receive(self._seconds)

    def _receive(self, seconds: float | None) -> dict[str, Any]:
        try:
            if not self._connection.poll(seconds):
                self.close()
                raise ChildError(f"it took longer than {seconds:g} seconds, the time limit")
            header, arrays = unpack(self._connection.recv_bytes())
        except (EOFError, ConnectionError):
            status = self._process.wait() if self._process else 0
            self.close()
            how = f"was ended by {signal.Signals(-status).name}" if status < 0 else f"ended itself with status {status}"
            raise ChildError(f"its process {how}") from None
        if "error" in header:
            raise ChildError(header["error"])
        return arrays


def serve() -> None:
    """Answer calls until the connection closes; the main function of the child process."""
    become_worker()
    connection = Connection(int(sys.argv[1]))
    connection.send_bytes(pack({}, {}))
    made: Any = None
    megabytes: float | None = None
    with contextlib.suppress(EOFError, ConnectionError):
        while True:
            values, arrays = unpack(connection.recv_bytes())
            try:
                if made is None:
                    megabytes, made = values["megabytes"], as_agent(loads(arrays["detector"].tobytes()))
                    found: Arrays = {}
                else:
                    with limit_memory(megabytes):
                        found = _answer(made, values, arrays)
                reply = pack({}, found)
            except (Exception, SystemExit) as error:
                reply = pack({"error": describe_failure(error)}, {})
            connection.send_bytes(reply)


def _answer(agent: Any, values: Mapping[str, Any], arrays: Arrays) -> Arrays:
    """Answer one call."""
    if values["call"] == "reset":
        agent.reset(values["seed"])
        return {}
    answer = getattr(agent, values["call"])(arrays.get(_ALONE, arrays))
    parts = {name: getattr(answer, name, None) for name in ("candidates", "scores", "clusters")}
    return {name: part for name, part in parts.items() if part is not None}
