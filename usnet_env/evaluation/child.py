"""A detector in a child process, which guards a run against accidents: a crash, an endless loop, too much memory."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from typing import Any

from usnet_env.detection import Detection
from usnet_env.evaluation.agents import DetectorAgent
from usnet_env.evaluation.tasks import EvaluationError, become_worker, describe_failure, dumps, loads

_MEGABYTE = 1_000_000


class ChildDetector:
    """A copy of a detector in a process of its own, as an agent.

    Args:
        detector: a name as :func:`usnet_env.make_detector` takes it, or an object.
        seconds: largest wall time of one call. A process that exceeds it is killed.
        megabytes: memory in 10^6 bytes that one call may allocate beyond what the process holds. Linux only.

    Each call raises an :class:`EvaluationError` if the detector fails, exceeds a limit, or ends its process.
    """

    def __init__(self, detector: Any, seconds: float | None = None, megabytes: float | None = None) -> None:
        self._connection, child_end = Pipe()
        command = "import sys; sys.path[:] = sys.argv[2:]; from usnet_env.evaluation import child; child.serve()"
        with child_end:
            self._process = subprocess.Popen(
                [sys.executable, "-c", command, str(child_end.fileno()), *sys.path],
                stdin=subprocess.DEVNULL,
                pass_fds=[child_end.fileno()],
                env={"OMP_NUM_THREADS": "1", **os.environ},
            )
        self.running = True
        self._seconds: float | None = None  # importing and making it takes as long as it takes
        try:
            self._exchange("make", dumps((detector, megabytes)))
        except EvaluationError:
            self.close()
            raise
        self._seconds = seconds

    def reset(self, seed: int) -> None:
        """Start an episode."""
        self._exchange("reset", seed)

    def answer(self, observation: Any) -> tuple[Detection, float]:
        """Return the answer to one observation, and its seconds."""
        begin = time.perf_counter()
        detection, _ = self._exchange("answer", observation)
        return detection, time.perf_counter() - begin

    def warm_up(self, observation: Any) -> None:
        """Answer once without being timed."""
        self._exchange("warm_up", observation)

    def close(self) -> None:
        """End the process."""
        self.running = False
        self._process.kill()
        self._process.wait()
        self._connection.close()

    def _exchange(self, name: str, argument: Any) -> Any:
        """Call a method of the agent there, and return what it returns."""
        try:
            with contextlib.suppress(BrokenPipeError):  # it has ended: receiving says so
                self._connection.send((name, argument))
            if not self._connection.poll(self._seconds):
                self.close()
                raise EvaluationError(f"it took longer than {self._seconds:g} seconds, the time limit")
            answer, error = self._connection.recv()
        except (EOFError, ConnectionError):
            status = self._process.wait()
            self.close()
            end = f"was ended by {signal.Signals(-status).name}" if status < 0 else f"ended itself with status {status}"
            raise EvaluationError(f"its process {end}") from None
        if error:
            raise EvaluationError(error)
        return answer


def serve() -> None:
    """Answer calls until the connection closes; the main function of the child process."""
    become_worker()
    connection = Connection(int(sys.argv[1]))
    agent: Any = None
    megabytes: float | None = None
    with contextlib.suppress(EOFError, ConnectionError):
        while True:
            (name, argument), answer, error = connection.recv(), None, ""
            try:
                if name == "make":
                    detector, megabytes = loads(argument)
                    agent = DetectorAgent(detector)
                else:
                    with limit_memory(megabytes):
                        answer = getattr(agent, name)(argument)
            except (Exception, SystemExit) as failure:
                error = describe_failure(failure)
            connection.send((answer, error))


@contextlib.contextmanager
def limit_memory(megabytes: float | None) -> Iterator[None]:
    """Limit what this process may allocate in the block beyond what it holds; ``None``: no limit. Linux only."""
    if megabytes is None:
        yield
        return
    import resource

    soft, hard = resource.getrlimit(resource.RLIMIT_DATA)
    with open("/proc/self/statm", "rb") as file:
        allocated = int(file.read().split()[5]) * resource.getpagesize()
    limit = allocated + int(megabytes * _MEGABYTE)
    resource.setrlimit(resource.RLIMIT_DATA, (limit if hard == resource.RLIM_INFINITY else min(limit, hard), hard))
    try:
        yield
    except MemoryError:
        raise MemoryError(f"it needed more than {megabytes:g} MB, the memory limit") from None
    finally:
        resource.setrlimit(resource.RLIMIT_DATA, (soft, hard))
